"""What vehicles see of the map, one way a file."""
