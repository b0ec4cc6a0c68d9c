"""Every rollout as MCAP: the writer, the reader, the format."""

from resc.recording.reader import RolloutLog
from resc.recording.schema import Column
from resc.recording.writer import RolloutRecorder

__all__ = ["Column", "RolloutLog", "RolloutRecorder"]
