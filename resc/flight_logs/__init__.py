"""Logs of real flights: PX4's ULog as a recording, and what the rate loop did in it."""
