"""Sensors terms, one a file."""
