"""Grids: exact distance transform, look-ups, rays."""
