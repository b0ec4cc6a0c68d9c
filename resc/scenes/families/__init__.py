"""Families of random maps, one a file."""
