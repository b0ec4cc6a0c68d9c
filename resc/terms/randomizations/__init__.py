"""Randomizations terms, one a file."""
