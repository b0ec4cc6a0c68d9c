"""Closed loops: collecting, flights, replay, pilots."""
