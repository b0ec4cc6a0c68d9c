"""The body rates that were asked of the rate loop, from what is recorded."""

from typing import cast

import numpy as np
import torch
from jaxtyping import Float
from tensordict import TensorDictBase
from torch import Tensor

from resc import keys
from resc.recording.columns import require_columns
from resc.recording.configuration import numbers_at
from resc.recording.reader import RolloutLog

_RATE_LIMIT = "rate_limit_radps"


def rate_command(log: RolloutLog, episode: int, steps: TensorDictBase) -> Float[np.ndarray, "t 3"]:
    """Body rates [rad/s] asked of the rate loop in each step of an episode.

    Those recorded, of a real flight. Otherwise omega = clip(a, -1, 1) limit, of the action a as
    many steps ago as the episode's delay; before the first one those that waited in its queue.

    Raises:
        RecordingError: The stored configuration has no rate limits, or no start is recorded.
    """
    if keys.BODY_RATE_COMMAND_B in (column.key for column in log.columns):
        return cast(Tensor, steps[keys.BODY_RATE_COMMAND_B]).numpy()
    require_columns(steps, (keys.ACTION,), "the commanded rate")
    limit = numbers_at(log.config, f"action.{_RATE_LIMIT}", 3)
    start = log.start(episode)
    waiting = cast(Tensor, start[keys.ACTION_QUEUE])
    delay = min(int(cast(Tensor, start[keys.ACTION_DELAY])), len(waiting) - 1)
    actions = torch.cat((waiting[:delay].flip(0), cast(Tensor, steps[keys.ACTION])))[: len(steps)]
    return (actions[:, :3].clamp(-1, 1) * torch.tensor(limit)).numpy()
