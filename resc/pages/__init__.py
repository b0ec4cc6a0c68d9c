"""One page for a run, an evaluation or a sweep, in one file that needs no network."""
