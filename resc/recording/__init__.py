"""Every rollout as MCAP: the writer, the reader, the format."""

from typing import TYPE_CHECKING

from resc.recording.schema import Column

if TYPE_CHECKING:
    from resc.recording.reader import RolloutLog
    from resc.recording.writer import RolloutRecorder

__all__ = ["Column", "RolloutLog", "RolloutRecorder"]


def __getattr__(name: str) -> object:
    """Reader and recorder, once they are asked for: polars and torch take long to import."""
    if name == "RolloutLog":
        from resc.recording.reader import RolloutLog

        return RolloutLog
    if name == "RolloutRecorder":
        from resc.recording.writer import RolloutRecorder

        return RolloutRecorder
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
