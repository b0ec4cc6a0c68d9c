"""Tasks terms, one a file."""
