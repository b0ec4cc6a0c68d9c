"""Rewards terms, one a file."""
