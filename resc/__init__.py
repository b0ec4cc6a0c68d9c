"""RESC: search-to-control quadrotor planning, trained, ablated, recorded and compared."""
