"""Estimators of the state, one a file."""
