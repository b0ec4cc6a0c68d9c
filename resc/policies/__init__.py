"""Policies: networks, and how they are stored."""
