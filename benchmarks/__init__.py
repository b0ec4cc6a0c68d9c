"""Measurements of speed; each script prints a table and where it was taken."""
