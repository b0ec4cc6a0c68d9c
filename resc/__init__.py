"""RESC: search-to-control quadrotor planning, trained, ablated, recorded and compared."""

import os

# Before torch is loaded, which reads it once. Threads that wait for the next piece of work by
# spinning take the cores from the threads of the rays and from other processes.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
