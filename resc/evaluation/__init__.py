"""Closed-loop runs, tables and pictures."""
