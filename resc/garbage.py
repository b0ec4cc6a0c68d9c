"""When a script begins to collect garbage: as it begins to fly (`resc.early`)."""

import atexit
import gc


def collect() -> None:
    """Collects garbage from now on, but among what is made from now on: the rest stays."""
    if not gc.isenabled():
        gc.freeze()
        atexit.register(gc.unfreeze)  # what counts its own objects at the end finds them gone
        gc.enable()
