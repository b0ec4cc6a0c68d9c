"""Obstacle layouts and the pool that environments draw them from."""
