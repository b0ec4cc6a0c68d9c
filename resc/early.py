"""What holds while a script starts: no garbage is collected, and Ctrl-C ends it in a word.

A start makes more than a million objects that stay: modules, and what torch's compiler notes of the
code that it reads. Looking through all of them again and again for those that only refer to each
other takes a fifth of the start. Scripts import this first; `resc.garbage` ends it.
"""

import gc
import sys
from types import TracebackType

gc.disable()


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Python's answer to what nobody has caught, but of an interruption one word."""
    if issubclass(kind, KeyboardInterrupt):
        print("Stopped.", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _tell
