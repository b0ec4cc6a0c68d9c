"""RESC: search-to-control quadrotor planning, trained, ablated, recorded and compared.

`make_env`, `load` and `load_policy` are for use from Python; they are read, and torch with them,
when they are first asked for. Gymnasium knows `resc/Flight-v0` (docs/gymnasium.md).
"""

import os
import time
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from resc.door import load, load_policy, make_env

BEGAN_S = time.time()
"""When the package was imported, all but this file of it later."""

__all__ = ["load", "load_policy", "make_env"]

# Before torch is loaded, which reads it once. Threads that wait for the next piece of work by
# spinning take the cores from the threads of the rays and from other processes.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

gymnasium.register(
    "resc/Flight-v0", entry_point="resc.gym:Flight", vector_entry_point="resc.gym:Flights"
)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - one of __all__
    if name not in __all__:
        raise AttributeError(f"module 'resc' has no attribute '{name}'")
    from resc import door

    return getattr(door, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
