"""Actions terms, one a file."""
