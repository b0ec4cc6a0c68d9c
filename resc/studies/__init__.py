"""What a sweep asks, and its report."""
