"""Every rollout as MCAP: the writer, the reader, the format."""

from typing import TYPE_CHECKING

from resc.recording.reader import RolloutLog
from resc.recording.schema import Column

if TYPE_CHECKING:
    from resc.recording.writer import RolloutRecorder

__all__ = ["Column", "RolloutLog", "RolloutRecorder"]


def __getattr__(name: str) -> object:
    """The recorder, once it is asked for: it needs torch, which takes seconds to import."""
    if name == "RolloutRecorder":
        from resc.recording.writer import RolloutRecorder

        return RolloutRecorder
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
