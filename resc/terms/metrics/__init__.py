"""Metrics terms, one a file."""
