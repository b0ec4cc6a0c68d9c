"""When Python looks for garbage: not while a command starts.

A start makes more than a million objects that stay: modules, and what torch's compiler notes of the
code that it reads. Looking through all of them again and again for those that only refer to each
other takes a fifth of the start. Scripts import this first; what flies says when a start is over.
"""

import atexit
import gc

gc.disable()


def collect() -> None:
    """Collects garbage from now on, but among what is made from now on: the rest stays."""
    if not gc.isenabled():
        gc.freeze()
        atexit.register(gc.unfreeze)  # what counts its own objects at the end finds them gone
        gc.enable()
