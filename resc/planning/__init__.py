"""Planning: from an occupancy grid to a shortest path, and from the path to control points."""
