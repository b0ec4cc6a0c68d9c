"""Flying a vehicle behind a MAVLink connection with a trained policy."""
