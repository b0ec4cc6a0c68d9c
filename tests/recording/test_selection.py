"""Episodes as tables and as views: filtered, iterated, exported."""

import polars as pl
import pytest
import torch
from small_run import COLUMNS, ENDS, record, rollout
from torchrl.data import LazyTensorStorage, ReplayBuffer, SliceSampler

from resc import keys
from resc.errors import RecordingError
from resc.log_command.arguments import selected
from resc.recording import Column, RolloutLog


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return RolloutLog(record(tmp_path_factory.mktemp("run")))


def same(one, other):
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    return all(torch.equal(one[key], other[key]) for key in one.keys(True, True))


def test_episodes_are_a_table_in_the_order_of_their_ends(log):
    table = log.episodes
    assert table["index"].to_list() == [0, 1, 2, 3, 4, 5]
    assert table["env_id"].to_list() == [0, 1, 0, 2, 1, 0]
    assert table["length"].to_list() == [5, 13, 13, 26, 18, 22]
    assert table["return_"].to_list() == [2.5, 6.5, 6.5, 13.0, 9.0, 11.0]
    assert table["outcome"].to_list() == ["success", "collision", "time_limit"] * 2
    assert table["seed"].to_list() == [7] * 6
    assert table["complete"].all()
    # A difference of unsigned integers would be 2^32 - 5.
    assert (table["episode"] - table["length"])[0] == -5


def test_conditions_are_joined_and_episodes_keep_their_numbers(log):
    view = log.where(pl.col("length") > 10, outcome="collision")
    assert view.episodes["index"].to_list() == [1, 4]
    assert view.where(env_id=1, start_step=13).episodes["index"].to_list() == [4]
    assert len(log.where(outcome="collision", env_id=2)) == 0
    assert same(view.episode(4), log.episode(4))
    with pytest.raises(RecordingError, match="Episode 2 is not among these 2"):
        view.episode(2)


def test_conditions_on_what_is_not_there_are_refused(log):
    with pytest.raises(RecordingError, match=r"no 'lenght'\. Did you mean 'length'"):
        log.where(lenght=3)
    with pytest.raises(
        RecordingError, match=r"No outcome is 'colision'\. Did you mean 'collision'"
    ):
        log.where(outcome="colision")
    with pytest.raises(RecordingError, match=r"no 'lenght'\. Did you mean 'length'"):
        log.where(pl.col("lenght") > 3)


@pytest.mark.parametrize(
    "condition",
    [
        "outcome = 'colision'",
        "outcome == 'colision' and length > 3",
        "outcome != 'colision'",
        "'colision' = outcome",
        "outcome in ('success', 'colision')",
        "length = 3 or not (outcome not in ('colision'))",
        pl.col("outcome") == "colision",
        pl.col("outcome").is_in(["colision"]) | (pl.col("length") > 3),
        ~(pl.col("outcome") == pl.lit("colision")),
    ],
)
def test_a_misspelt_outcome_in_a_condition_is_refused_with_a_hint(log, condition):
    with pytest.raises(
        RecordingError, match=r"No outcome is 'colision'\. Did you mean 'collision'"
    ):
        selected(log, condition) if isinstance(condition, str) else log.where(condition)


def test_other_misspelt_names_in_a_condition_are_refused_with_a_hint(log):
    with pytest.raises(RecordingError, match=r"write outcome == 'collision', with the name in"):
        selected(log, "outcome = collision")
    with pytest.raises(RecordingError, match=r"No file is 'rollouts_00001.mcap'\. Available"):
        selected(log, "file = 'rollouts_00001.mcap'")
    with pytest.raises(RecordingError, match=r"no 'retrun_'\. Did you mean 'return_'"):
        selected(log, "length > 3 and retrun_ > 0")
    file = str(log.files[0])
    assert len(log.where(pl.col("file") == file)) == 6
    assert len(selected(log, "outcome in ('success', 'collision') and length < 10")) == 1
    assert len(selected(log, "file like '%00000%'")) == 6
    assert len(log.where(pl.col("outcome").cast(pl.String).str.contains("coll"))) == 2


@pytest.mark.parametrize("outcome", [3, None, True, ["collision", "success"]])
def test_an_outcome_that_is_no_name_is_refused(log, outcome):
    with pytest.raises(RecordingError, match=r"No outcome is .* Available: collision, success"):
        log.where(outcome=outcome)


def test_what_is_no_condition_is_refused(log):
    with pytest.raises(RecordingError, match="cannot be filtered like this: cannot create"):
        log.where(env_id=object())
    assert len(log.where(outcome=pl.lit("success"))) == 2


def test_rows_are_taken_in_the_order_given_and_must_be_there(log):
    view = log.where(pl.col("length") > 10)
    assert view.take([2, 4, 0]).episodes["index"].to_list() == [3, 5, 1]
    assert len(view.take([])) == 0
    for row in (500, 5, -1, True):
        with pytest.raises(RecordingError, match=r"Row .* is not in the table of these 5 episodes"):
            view.take([row])


def test_iterating_gives_every_episode_from_its_first_to_its_last_step(log):
    whole, found = rollout(), list(log)
    assert len(log) == len(found) == 6
    for row, steps in zip(log.episodes.iter_rows(named=True), found, strict=True):
        expected = whole[row["start_step"] : row["end_step"] + 1, row["env_id"]]
        assert same(steps, expected)
        assert same(steps, log.episode(row["index"]))
    assert [len(steps) for steps in log.where(env_id=1)] == [13, 18]


def test_a_view_is_a_store_of_trajectories_for_torchrl(log):
    steps = log.where(env_id=0).to_tensordict()
    numbers = steps["collector", "traj_ids"]
    assert numbers.tolist() == [0] * 5 + [2] * 13 + [5] * 22
    assert same(steps[5:18].exclude("collector"), log.episode(2))
    sampler = SliceSampler(slice_len=4, traj_key=("collector", "traj_ids"), strict_length=True)
    buffer = ReplayBuffer(storage=LazyTensorStorage(len(steps)), sampler=sampler, batch_size=32)
    buffer.extend(steps)
    drawn = buffer.sample()["collector", "traj_ids"].reshape(8, 4)
    assert (drawn == drawn[:, :1]).all()


def test_a_table_has_one_row_for_each_environment_and_step(log):
    table, whole = log.to_polars(), rollout()
    assert table.columns[:5] == ["index", "env_id", "episode", "step", "state.position_w.x"]
    assert table["env_id"].to_list() == [0] * 40 + [1] * 40 + [2] * 40
    assert table["step"].to_list() == list(range(40)) * 3
    last = {env_id: ends[-1] for env_id, ends in ENDS.items()}
    assert table["index"][40:53].to_list() == [1] * 13
    assert table["episode"][53:71].to_list() == [1] * 18
    assert table["index"][40 + last[1] + 1 : 80].is_null().all()
    assert table["index"].null_count() == 120 - 97
    for name, key, part in (
        ("action.thrust", keys.ACTION, 3),
        ("state.velocity_w.y", keys.VELOCITY_W, 1),
        ("terminated", keys.TERMINATED, 0),
    ):
        expected = whole[key][..., part].T.flatten()
        assert torch.equal(table[name].to_torch(), expected)


def test_the_table_of_a_view_has_the_rows_of_its_episodes(log):
    part = log.where(outcome="time_limit").to_polars()
    every = log.to_polars()
    expected = pl.concat([every.filter(pl.col("index") == index) for index in (2, 5)])
    assert part.equals(expected)
    assert log.where(outcome="time_limit", env_id=1).to_polars().schema == part.schema


def test_pandas_gets_the_same_numbers(log):
    pytest.importorskip("pandas")
    frame = log.where(env_id=2).to_pandas()
    assert frame.shape == (26, 4 + sum(column.width for column in COLUMNS))
    assert frame["state.position_w.x"].iloc[-1] == pytest.approx(2.5)


def test_pieces_of_a_table_are_its_rows(log, monkeypatch):
    monkeypatch.setattr("resc.recording.reader.ROWS", 60)
    monkeypatch.setattr("resc.recording.selection.ROWS", 60)
    order = ("env_id", "step")
    pieces = list(log.tables())
    assert [len(piece) for piece in pieces] == [30, 60, 30]
    assert pl.concat(pieces).sort(order).equals(log.to_polars().sort(order))
    view = log.where(success=False)
    parts = list(view.tables())
    assert len(parts) == 2
    assert pl.concat(parts).equals(view.to_polars())


def test_a_recorded_column_called_step_does_not_hide_the_step(tmp_path):
    whole = rollout()
    whole["step"] = torch.zeros(40, 3, 1, dtype=torch.int32)
    columns = (*COLUMNS, Column(("step",), (), torch.int32))
    table = RolloutLog(record(tmp_path, whole, columns=columns)).to_polars()
    assert table["step"].max() == 39
    assert table["rollout.step"].max() == 0


def test_episodes_of_which_steps_are_missing_are_named_and_can_be_left_out(tmp_path):
    record(tmp_path, every_n_batches=2)
    log = RolloutLog(tmp_path)
    assert log.episodes["complete"].to_list() == [True] + [False] * 5
    with pytest.raises(RecordingError, match="Some steps of 5 of these 6 episodes, such as 1, are"):
        log.where().to_polars()
    assert [len(steps) for steps in log.where(complete=True)] == [5]
    # Steps 0 to 9 and 20 to 29: only those after the one episode of environment 2 belong to none.
    assert log.to_polars()["index"].null_count() == 4
