"""How recorded episodes began: the world at their first step, and the scene they were flown in."""

from collections.abc import Iterator, Sequence

from tensordict import TensorDict
from torch import Tensor

from resc.errors import RecordingError
from resc.recording.events import decode_arrays
from resc.recording.schema import STARTS, WORLD
from resc.recording.source import Source


def world_at_start(sources: Sequence[Source], env_id: int, step: int) -> TensorDict:
    """All mutable state of one environment before the first step of its episode `[]`.

    Args:
        sources: The files of one recorder, oldest first.
        env_id: The environment.
        step: The first step, counted since the run began.

    Raises:
        RecordingError: No file has it.
    """
    for _, starts in _backwards(sources, STARTS, step):
        rows = ((starts["env_id"] == env_id) & (starts["step"] == step)).nonzero()[:, 0]
        if len(rows):
            names = sorted(starts.keys() - {"env_id", "step"})
            world = {tuple(name.split(".")): starts[name][rows[0]] for name in names}
            return TensorDict(world, batch_size=[])
    raise RecordingError(
        f"How environment {env_id} began its episode in step {step} is not recorded; choose an "
        "episode that began after the oldest file."
    )


def scene_in_use(sources: Sequence[Source], scene: int, step: int) -> dict[str, Tensor]:
    """The arrays of one scene of the pool as it was in `step`, without the pool's axis.

    Raises:
        RecordingError: No file has it.
    """
    for first_step, arrays in _backwards(sources, WORLD, step):
        rows = (arrays["entry"] == scene).nonzero()[:, 0]
        if len(rows) and first_step <= step:
            return {name: values[rows[0]] for name, values in arrays.items() if name != "entry"}
    raise RecordingError(
        f"Scene {scene}, in use in step {step}, is not recorded; choose an episode that began "
        "after the oldest file."
    )


def _backwards(
    sources: Sequence[Source], topic: str, step: int
) -> Iterator[tuple[int, dict[str, Tensor]]]:
    """First steps and arrays of a topic's messages up to `step`, the last first."""
    for source in reversed(sources):
        for chunk in reversed(source.chunks_of(topic)):
            if chunk.start_time <= step * source.specification.dt_ns:
                runs = list(source.rows(chunk, topic))
                for rows in reversed(runs):
                    for i in reversed(range(rows.count)):
                        yield decode_arrays(topic, rows.message(i))
