"""Observations terms, one a file."""
