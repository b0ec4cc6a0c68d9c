"""Path search: one way to ask for a path on a map, and a file for each method of finding it."""
