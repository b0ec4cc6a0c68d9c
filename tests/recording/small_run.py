"""A small recording with all that one of RESC's holds: 40 steps of 3 environments, 6 episodes."""

import torch
from tensordict import TensorDict

from resc import keys
from resc.recording import RolloutRecorder
from resc.recording.columns import REWARD_TERMS, STATE_COLUMNS, usual_columns
from resc.recording.schema import SAMPLED_ACTION

ENVS, STEPS, BATCHES = 3, 10, 4
ENDS = {0: (4, 17, 39), 1: (12, 30), 2: (25,)}
OUTCOMES = ("success", "collision", "time_limit")
COLUMNS = usual_columns(("progress", "time"))
CONFIG = b"action:\n  rate_limit_radps: [2.0, 2.0, 1.0]\n"
EPISODES = sorted((end, env_id, i) for env_id, ends in ENDS.items() for i, end in enumerate(ends))


def rollout():
    """All steps: rewards of 0.5, -0.25 of it for time; positions count the steps."""
    shape = (BATCHES * STEPS, ENVS)
    generator = torch.Generator().manual_seed(0)
    drawn = (*STATE_COLUMNS, SAMPLED_ACTION)
    data = {c.key: torch.randn(*shape, c.width, generator=generator) for c in drawn}
    data[keys.ACTION] = data[SAMPLED_ACTION.key].clamp(-1, 1)
    data[keys.POSITION_W][..., 0] = torch.arange(shape[0])[:, None] / 10
    data[keys.ATTITUDE_WB] /= data[keys.ATTITUDE_WB].norm(dim=-1, keepdim=True)
    data[keys.REWARD] = torch.full((*shape, 1), 0.5)
    data[REWARD_TERMS] = torch.tensor([0.75, -0.25]).expand(*shape, 2).clone()
    ended = torch.zeros(*shape, 1, dtype=torch.bool)
    for env_id, ends in ENDS.items():
        ended[list(ends), env_id] = True
    data[keys.TERMINATED], data[keys.TRUNCATED] = ended, torch.zeros_like(ended)
    return TensorDict(data, shape)


def episodes(first, last):
    """Those that end in steps `first` up to `last`; outcomes in turn, in the order of ends."""
    rows = []
    for number, (end, env_id, i) in enumerate(EPISODES):
        start = ENDS[env_id][i - 1] + 1 if i else 0
        if first <= end < last:
            rows.append((env_id, i, start, end, end + 1 - start, env_id, number % 3))
    names = ("env_id", "episode", "start_step", "end_step", "length", "scene", "outcome")
    data = dict(zip(names, torch.tensor(rows).reshape(-1, 7).unbind(1), strict=True))
    data["return_"] = data["length"] * 0.5
    data["difficulty"] = torch.ones(len(rows))
    data["success"] = data["outcome"] == 0
    return TensorDict(data, [len(rows)])


def world():
    return {
        "entry": torch.arange(ENVS),
        "origin_w": torch.zeros(ENVS, 2),
        "size": torch.full((ENVS, 2), 6.0),
        "boxes_w": torch.tensor([[2.0, 1.0, 0.5, 0.5], [0, 0, 0, 0]]).expand(ENVS, 2, 4).clone(),
        "start_w": torch.zeros(ENVS, 3),
        "route_w": torch.tensor([[2.0, 0, 1], [4.0, 0, 1]]).expand(ENVS, 2, 3).clone(),
        "route_length": torch.full((ENVS, 1), 2),
    }


def starts(first, last):
    """Of the episodes that begin in steps `first` up to `last`: delay 2, a queue of 0.1, 0.2, …"""
    rows = [(e, s) for e, ends in ENDS.items() for s in (0, *(end + 1 for end in ends))]
    rows = [(env_id, step) for env_id, step in rows if first <= step < last]
    env_id, step = torch.tensor(rows).reshape(-1, 2).unbind(1)
    queue = torch.tensor([0.1, 0.2, 0.3, 0.4])[:, None].expand(4, 4)
    return {
        "env_id": env_id,
        "step": step,
        "command.action_queue": queue.expand(len(rows), 4, 4).clone(),
        "params.action_delay": torch.full((len(rows), 1), 2.0),
    }


def record(folder, whole=None, *, batches=range(BATCHES), listed=episodes, **options):
    """Records the batches of the run, or of a changed one, in a folder."""
    whole = rollout() if whole is None else whole
    known = {
        "columns": COLUMNS,
        "metadata": {"seed": "7"},
        "attachments": {"config.yaml": CONFIG},
        "compression": "zstd",
    }
    with RolloutRecorder(
        directory=folder, dt_s=0.02, num_envs=ENVS, outcomes=OUTCOMES, **{**known, **options}
    ) as recorder:
        recorder.put_world(world(), batches[0] * STEPS)
        for number in batches:
            first, last = number * STEPS, (number + 1) * STEPS
            recorder.put(whole[first:last], first, listed(first, last), starts(first, last))
    return folder
