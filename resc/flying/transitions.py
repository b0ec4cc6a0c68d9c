"""Recorded episodes as transitions in TorchRL's layout: flown again, for what they observe."""

from collections.abc import Iterator, Sequence
from typing import cast

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from resc import keys
from resc.console import progress
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.errors import RecordingError
from resc.flying.loop import flown
from resc.flying.replay import recorded_config
from resc.recording.columns import FLAGS, require_columns
from resc.recording.schema import SAMPLED_ACTION
from resc.recording.selection import TRAJECTORY, Selection
from resc.scenes.pool import layout_from
from resc.setup import among, build_stages

NEEDED = (keys.ACTION, SAMPLED_ACTION.key, *(flag.key for flag in FLAGS))
"""Columns that a dataset is made of."""
ROWS = 256
"""Episodes flown again at once."""


def transitions(episodes: Selection, *, stages: Stages | None = None) -> TensorDict:
    """The steps of recorded episodes one after the other `[S]`, as TorchRL lays them out.

    `observation`, `action`, `("collector", "traj_ids")` (the episode's `index`) and, under `next`,
    `observation`, `reward`, `terminated`, `truncated`, `done`. `action` is what was flown, in
    [-1, 1]. Observations are not recorded: the episodes are flown again, from their sampled
    actions. So `stages` may have others, and other rewards, than the recording; ends are the
    recorded ones. Noise and dropouts of observations are drawn again.

    Args:
        episodes: `RolloutLog(...).where(...)`.
        stages: The step that observes, as in `resc.make_env(...).stages`; that of the recording if
            None.

    Raises:
        RecordingError: Not all steps, or not the start, of an episode are recorded.
        ConfigError: The recorded configuration builds no environment today.
    """
    require_recorded(episodes)
    # Of similar length: a batch flies as long as its longest episode.
    order = episodes.episodes["length"].arg_sort().to_list()
    config = recorded_config(episodes)
    stages = stages or build_stages(config)
    parts: dict[int, TensorDict] = {}
    with progress(len(order), unit="episode") as bar:
        for start in range(0, len(order), ROWS):
            rows = order[start : start + ROWS]
            some = episodes.take(rows)
            recorded = list(some)
            # Uncompiled: a batch of another size, flown once, is not worth compiling for.
            setup = among(layout_from(some.scenes()), stages, config["device"])
            env = setup.env(len(some), compiled=False, in_order=True)
            parts |= zip(rows, _flown(some, recorded, env), strict=True)
            bar.update(len(rows))
    return cast(TensorDict, torch.cat([parts[row] for row in range(len(order))]))


def require_recorded(episodes: Selection) -> None:
    """Refuses episodes that no transitions can be made of.

    Raises:
        RecordingError: There is none, or a column is missing.
    """
    if len(episodes) == 0:
        raise RecordingError("No episode is left to learn from; loosen the condition of where().")
    shortest = episodes.episodes["length"].arg_sort().to_list()[:1]
    require_columns(next(iter(episodes.take(shortest))), NEEDED, "a dataset")


@torch.no_grad()
def _flown(
    episodes: Selection, recorded: Sequence[TensorDict], env: QuadrotorEnv
) -> Iterator[TensorDict]:
    """The transitions of each episode `[T]`, all flown at once."""
    count = len(recorded)
    sampled = [cast(Tensor, steps[SAMPLED_ACTION.key]) for steps in recorded]
    actions = pad_sequence(sampled).to(env.device)
    world = episodes.starts()
    world[keys.SCENE_INDEX] = torch.arange(count).unsqueeze(-1)
    observations, rewards = [env.begin(world)], []
    for _, _, out in flown(env, actions):
        observations.append(out.observation)
        rewards.append(out.reward)
    seen, earned = torch.stack(observations), torch.stack(rewards)
    for row, (number, steps) in enumerate(zip(episodes.episodes["index"], recorded, strict=True)):
        length = len(steps)
        ends = {name: steps[name].to(env.device) for name in ("terminated", "truncated")}
        yield TensorDict(
            {
                "observation": seen[:length, row],
                "action": steps[keys.ACTION].to(env.device),
                TRAJECTORY: torch.full((length,), number),
                "next": {
                    "observation": seen[1 : length + 1, row],
                    "reward": earned[:length, row],
                    "done": ends["terminated"] | ends["truncated"],
                    **ends,
                },
            },
            batch_size=[length],
        )
