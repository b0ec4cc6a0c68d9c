"""Planners that RESC is compared with, each a pilot."""
