"""Terminations terms, one a file."""
