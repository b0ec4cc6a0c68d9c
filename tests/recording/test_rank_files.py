"""What several processes of a training recorded is read as one run."""

import polars as pl
import pytest
import torch
from small_run import BATCHES, ENVS, EPISODES, STEPS, record, rollout
from test_resumed import differently, killed

from resc import keys
from resc.errors import RecordingError
from resc.recording import RolloutLog
from resc.recording.check import check

TOTAL = len(EPISODES)


def recorded(folder, **options):
    """Two ranks: the second one's flights are at other places. Both as they fly."""
    flights = [rollout(), differently(rollout())]
    for rank, flown in enumerate(flights):
        facts = {"seed": "7", "rank": str(rank), "ranks": "2"}
        place = folder / "rank_001" if rank else folder
        record(place, flown, metadata=facts, session="both", **options)
    return torch.cat(flights, 1)


def test_environments_of_ranks_are_side_by_side(tmp_path):
    whole = recorded(tmp_path / "rollouts")
    log = RolloutLog(tmp_path)
    assert [path.parent.name for path in log.files] == ["rollouts", "rank_001"]
    assert (log.num_envs, log.num_batches, log.num_steps) == (2 * ENVS, BATCHES, BATCHES * STEPS)
    for key in (keys.POSITION_W, keys.ACTION, keys.REWARD):
        assert torch.equal(log.to_tensordict()[key], whole[key])
        assert torch.equal(log.batch(1)[key], whole[key][STEPS : 2 * STEPS])
        assert torch.equal(log.env(4)[key], whole[key][:, 4])
    assert not check(tmp_path).faults


def test_episodes_and_how_they_began_are_those_of_their_rank(tmp_path):
    whole = recorded(tmp_path)
    log = RolloutLog(tmp_path)
    assert len(log) == 2 * TOTAL
    assert log.episodes["env_id"].to_list()[TOTAL:] == [e + ENVS for _, e, _ in EPISODES]
    assert log.episodes["complete"].all()
    for row in log.episodes.iter_rows(named=True):
        steps = slice(row["start_step"], row["end_step"] + 1)
        flown = log.episode(row["index"])[keys.POSITION_W]
        assert torch.equal(flown, whole[keys.POSITION_W][steps, row["env_id"]])
        assert float(log.start(row["index"])["params", "action_delay"]) == 2.0
        assert log.scene(row["index"])["size"].tolist() == [6.0, 6.0]
    table = log.where(pl.col("env_id") >= ENVS).to_polars()
    assert table["state.position_w.y"].min() > whole[keys.POSITION_W][:, :ENVS, 1].min() + 4


def test_batch_that_a_rank_has_not_written_is_not_there(tmp_path):
    record(tmp_path, metadata={"rank": "0"}, session="both")
    record(tmp_path / "rank_001", metadata={"rank": "1"}, session="both", batches=range(2))
    killed(tmp_path / "rank_001")
    log = RolloutLog(tmp_path)
    assert (log.num_envs, log.start_steps) == (2 * ENVS, [0, STEPS])
    assert log.episodes.filter(pl.col("env_id") >= ENVS)["end_step"].max() < 2 * STEPS
    assert not log.complete
    alone = RolloutLog(tmp_path / "rank_001")
    assert (alone.num_envs, alone.num_batches) == (ENVS, 2)


def test_resumed_ranks_are_read_once(tmp_path):
    for rank, place in enumerate((tmp_path, tmp_path / "rank_001")):
        facts = {"rank": str(rank)}
        record(place, metadata=facts, session="before", batches=range(3))
        killed(place)
        changed = differently(rollout())
        record(place, changed, metadata=facts, session="after", batches=range(2, BATCHES))
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 10, 20, 30]
    assert [part.step for part in log.superseded] == [2 * STEPS] * 2
    moved = (
        log.to_tensordict()[keys.POSITION_W][..., 1]
        - rollout()[keys.POSITION_W].repeat(1, 2, 1)[..., 1]
    )
    assert moved[: 2 * STEPS].abs().max() == 0
    torch.testing.assert_close(moved[2 * STEPS :], torch.full((2 * STEPS, 2 * ENVS), 5.0))
    assert not [fault for fault in check(tmp_path).faults if "not complete" not in fault]


def test_runs_of_other_numbers_of_processes_are_not_read_together(tmp_path):
    recorded(tmp_path / "two" / "rollouts")
    record(tmp_path / "one" / "rollouts")
    with pytest.raises(RecordingError, match="of runs of different numbers of processes; open"):
        RolloutLog(f"{tmp_path}/*")
