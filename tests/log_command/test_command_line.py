"""The command line: what it prints and writes, and what it says to wrong input."""

import errno
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from small_run import record
from street import copy_of, fly_street

from resc.log_command import build_parser, main
from resc.recording import RolloutLog


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "one"
    record(folder / "rollouts")
    return folder


@pytest.fixture
def call(capsys, monkeypatch, tmp_path):
    """Calls a command in an empty folder: exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main([str(argument) for argument in arguments])
        code, (out, errors) = exit_.value.code, capsys.readouterr()
        return (1, out, code) if isinstance(code, str) else (code or 0, out, errors)

    return called


def commands():
    actions = build_parser()._subparsers._group_actions[0]
    return sorted(actions.choices)


def test_all_commands_are_there():
    expected = "check episodes from-ulog identify info lerobot merge minari parquet plot recover"
    assert commands() == [*expected.split(), "rerun", "scene", "schema", "smooth", "video"]


@pytest.mark.parametrize("command", commands())
def test_help_of_a_command_ends_with_an_example_of_it(command, call):
    code, out, _ = call(command, "--help")
    assert code == 0
    assert f"resc-log {command}" in out.partition("example:")[2]


def test_info_tells_steps_outcomes_columns_and_facts(run, call):
    code, out, _ = call("info", run)
    assert code == 0
    assert "120 of 3 environments in 4 batches" in out
    assert "6 finished: 33.3% success, 33.3% collision, 33.3% time_limit" in out
    assert "state.velocity_w      float32  m/s    world          x, y, z" in out
    assert "seed         7" in out


def test_info_tells_every_command_of_a_run_of_several_processes_once(call, tmp_path):
    begun = {"overrides": "seed=7", "git_commit": "a" * 40, "begun": "2026-01-01 10:00 UTC"}
    again = {"overrides": "total_frames=9", "git_commit": "b" * 40, "begun": "2026-01-02 10:00 UTC"}
    for rank, place in enumerate((tmp_path / "rollouts", tmp_path / "rollouts" / "rank_001")):
        own = {"rank": str(rank), "ranks": "2"}
        record(place, metadata=begun | own, session="before", batches=range(2))
        record(place, metadata=again | own, session="after", batches=range(2, 4))
    code, out, _ = call("info", tmp_path)
    assert code == 0
    told = [line.split(maxsplit=1) for line in out.partition("\ncolumns")[0].splitlines()]
    facts = {name: value for name, value in told}
    assert (facts["overrides"], facts["begun"], facts["ranks"]) == (
        "seed=7",
        "2026-01-01 10:00 UTC",
        "2",
    )
    assert "rank" not in facts
    resumed = [" ".join(value.split()) for name, value in told if name == "resumed"]
    assert resumed == ["1 2026-01-02 10:00 UTC, commit bbbbbbbbbbbb: total_frames=9"]


def test_episodes_are_filtered_sorted_and_limited(run, call, tmp_path):
    where = "outcome != 'success' and length > 10"
    code, out, _ = call("episodes", run, "--where", where, "--sort", "return_", "--csv")
    assert code == 0
    assert pl.read_csv(out.encode())["index"].to_list() == [1, 2, 4, 5]
    table = ("episodes", run, "--sort", "length", "--reverse", "--limit", 1)
    _, out, _ = call(*table)
    assert out.splitlines()[1].split()[:5] == ["3", "2", "0", "0", "25"]
    assert out.splitlines()[-1] == "1 of 6 shown, 6 in the recording"
    assert call(*table, "--csv", "--out", "best.csv")[:2] == (0, "")
    assert pl.read_csv(tmp_path / "best.csv")["outcome"].to_list() == ["success"]
    assert call("episodes", run, "--out", "all.csv")[:2] == (0, "")
    assert len(pl.read_csv(tmp_path / "all.csv")) == 6
    assert call("episodes", run, "--limit", 0)[1].splitlines()[-1].startswith("0 of 6 shown")


def test_a_limit_below_zero_is_a_usage_error(run, call):
    code, _, errors = call("episodes", run, "--limit", -1)
    assert code == 2
    assert "--limit: '-1' is not a whole number of 0 or more" in errors


@pytest.mark.parametrize(
    ("command", "owner", "method"),
    [
        (("episodes",), Path, "write_text"),
        (("plot", "--episode", "0"), Figure, "savefig"),
        (("merge",), "resc.recording.rewrite.Segment", "append"),
        (("parquet",), "pyarrow.parquet.ParquetWriter", "write_table"),
        (("rerun", "--episode", "0"), Path, "write_bytes"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else None,
)
def test_a_full_disk_is_told_with_the_name_of_the_output(
    command, owner, method, run, street, call, tmp_path, monkeypatch
):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    output = tmp_path / "mine.png"
    output.write_bytes(b"precious")
    if command[0] == "rerun":
        pytest.importorskip("rerun")
    if isinstance(owner, str):
        pytest.importorskip(owner.rpartition(".")[0])
        monkeypatch.setattr(f"{owner}.{method}", full)
    else:
        monkeypatch.setattr(owner, method, full)
    recording = street.files[0] if command[0] == "rerun" else run
    code, _, error = call(command[0], recording, *command[1:], "--out", "mine.png", "--force")
    assert code == 1
    assert error == (
        "error: mine.png cannot be written (No space left on device); choose another folder or "
        "free some space."
    )
    assert [path.name for path in tmp_path.iterdir()] == ["mine.png"]
    assert output.read_bytes() == b"precious"


@pytest.fixture(scope="module")
def street(compose, tmp_path_factory):
    """Flights whose configuration scenes can be drawn with."""
    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    return fly_street(config, tmp_path_factory.mktemp("street"))


@pytest.mark.parametrize("command", ["scene", "rerun"])
def test_a_class_of_the_users_own_package_is_built_only_if_allowed(
    command, street, call, tmp_path, monkeypatch
):
    if command == "rerun":
        pytest.importorskip("rerun")
    (tmp_path / "own_vehicles.py").write_text(
        "from resc.simulation.vehicle import Vehicle\n\n\nclass Own(Vehicle):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    config = street.config
    config["vehicle"]["_target_"] = "own_vehicles.Own"
    copy_of(street, tmp_path / "own", config=config)
    code, _, error = call(command, "own", "--episode", 0)
    assert code == 1
    assert "vehicle._target_ is 'own_vehicles.Own'" in error
    allow = ("--allow", "another.", "--allow", "own_vehicles.")
    assert call(command, "own", "--episode", 0, *allow)[0] == 0


def test_recover_does_not_overwrite_what_it_reads(run, call, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((run / "rollouts" / "rollouts_00000.mcap").read_bytes()[:-400])
    before = cut.read_bytes()
    code, _, error = call("recover", "cut.mcap", "--out", cut, "--force")
    assert code == 1
    assert error == f"error: {cut} is the input; name another file with --out."
    assert cut.read_bytes() == before


def test_plot_draws_an_episode(run, call, tmp_path):
    assert call("plot", run, "--episode", 5)[:2] == (0, "episode_5.png\n")
    height, width, _ = plt.imread(tmp_path / "episode_5.png").shape
    assert width > height > 1000


def test_plot_draws_an_episode_of_one_step(call, tmp_path):
    record(tmp_path / "short", listed=shortened)
    assert call("plot", "short", "--episode", 0, "--out", "short.png")[0] == 0


def shortened(first, last):
    from small_run import episodes

    table = episodes(first, last)
    table["end_step"], table["length"] = table["start_step"], table["length"] * 0 + 1
    return table


def test_commanded_rates_are_actions_scaled_and_delayed(run):
    from resc.recording.commands import rate_command

    log = RolloutLog(run)
    steps = log.episode(2)
    rates = rate_command(log, 2, steps)
    action = steps["action"][:, :3].clamp(-1, 1).numpy()
    assert rates[:2, 0].tolist() == pytest.approx([0.4, 0.2])  # 0.2 and 0.1 waited, limit 2 rad/s
    assert rates[2:, 1] == pytest.approx(2 * action[:-2, 1])
    assert rates[2:, 2] == pytest.approx(action[:-2, 2])


def test_parquet_holds_the_rows_of_the_table(run, call, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    assert call("parquet", run)[0] == 0
    assert pl.read_parquet(tmp_path / "steps.parquet").equals(RolloutLog(run).to_polars())
    file = parquet.ParquetFile(tmp_path / "steps.parquet")
    column = file.metadata.row_group(0).column(4)
    assert (column.path_in_schema, column.compression) == ("state.position_w.x", "ZSTD")
    assert "BYTE_STREAM_SPLIT" in column.encodings
    assert file.schema_arrow.metadata[b"seed"] == b"7"
    where = ("--where", "outcome = 'collision'", "--out", "some.parquet")
    assert call("parquet", run, *where)[0] == 0
    expected = RolloutLog(run).where(outcome="collision").to_polars()
    assert pl.read_parquet(tmp_path / "some.parquet").equals(expected)


def test_a_cut_file_is_recovered_merged_and_checked(run, call, tmp_path):
    cut = tmp_path / "rollouts_00000.mcap.active"
    cut.write_bytes((run / "rollouts" / "rollouts_00000.mcap").read_bytes()[:-400])
    code, out, _ = call("check", cut)
    assert code == 1
    assert "is not complete" in out
    assert out.splitlines()[-1].startswith("1 fault(s): 1 file(s), 4 batches")
    assert call("recover", cut)[0] == 0
    code, out, _ = call("check", "recovered_rollouts_00000.mcap")
    assert (code, out) == (
        0, "fine: 1 file(s), 4 batches, 120 environment steps, 6 episodes read\n"
    )  # fmt: skip
    assert call("merge", "recovered_rollouts_00000.mcap", "--out", "one.mcap")[0] == 0
    assert len(RolloutLog(tmp_path / "one.mcap")) == 6


def test_damage_makes_recover_end_with_3(run, call, tmp_path):
    data = bytearray((run / "rollouts" / "rollouts_00000.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    assert call("check", "bad.mcap")[0] == 1
    code, out, _ = call("recover", "bad.mcap")
    assert code == 3
    assert out.startswith("recovered_bad.mcap: 3 batches, ")
    assert "; left out: /rollout: bad.mcap is damaged at byte " in out


def test_recover_mends_every_file_of_a_folder_and_ends_as_the_worst(run, call, tmp_path):
    data = (run / "rollouts" / "rollouts_00000.mcap").read_bytes()
    damaged = bytearray(data)
    damaged[len(data) // 2] ^= 0xFF
    files = {"rollouts_00000.mcap": data, "rollouts_00001.mcap": damaged}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert call("recover", tmp_path, "--out", "all.mcap")[0] == 1
    code, out, _ = call("recover", tmp_path)
    assert code == 3
    first, second = out.splitlines()
    assert first.startswith(f"{tmp_path}/recovered_rollouts_00000.mcap: 4 batches, ")
    assert "; left out: " not in first
    assert "; left out: " in second
    (tmp_path / "rollouts_00002.mcap").write_text("a text, not a recording")
    code, out, errors = call("recover", f"{tmp_path}/rollouts_*.mcap", "--force")
    assert (code, len(out.splitlines())) == (1, 2)
    assert errors.startswith("error: ")
    assert "rollouts_00002.mcap is not an MCAP file" in errors


def test_an_output_that_exists_is_kept_unless_forced(run, call, tmp_path):
    (tmp_path / "mine.png").write_text("precious")
    command = ("plot", run, "--episode", 0, "--out", "mine.png")
    code, _, errors = call(*command)
    assert (code, errors) == (
        1, "error: mine.png exists; name another file with --out, or add --force."
    )  # fmt: skip
    assert (tmp_path / "mine.png").read_text() == "precious"
    assert call(*command, "--force")[0] == 0
    assert plt.imread(tmp_path / "mine.png").shape[2] == 4


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("info", "nowhere"), "No recording at nowhere"),
        (("info", "text.mcap"), "is not an MCAP file"),
        (("episodes", "RUN", "--where", "lenght > 3"), "lenght"),
        (("episodes", "RUN", "--where", "length >"), "is not a condition in SQL"),
        (("episodes", "RUN", "--where", "length"), "cannot be filtered like this"),
        (("episodes", "RUN", "--where", "outcome = 'colision'"), "Did you mean 'collision'?"),
        (("parquet", "RUN", "--where", "outcome = 'colision'"), "Did you mean 'collision'?"),
        (("episodes", "RUN", "--sort", "retrun_"), "no 'retrun_'. Did you mean 'return_'"),
        (("plot", "RUN", "--episode", "6"), "no episode 6; the recording holds 6"),
        (("scene", "RUN", "--episode", "-1"), "no episode -1; the recording holds 6"),
        (("plot", "RUN", "--episode", "0", "--out", "no/a.png"), "no is not a folder"),
        (("plot", "RUN", "--episode", "0", "--out", "a.xyz"), "end with .png, .pdf, .svg; name"),
        (("plot", "bare", "--episode", "0"), "no attachment 'config.yaml'"),
        (("plot", "stateless", "--episode", "0"), "state.position_w"),
        (
            ("merge", "RUN", "--out", "RUN/rollouts/rollouts_00000.mcap", "--force"),
            "is the input",
        ),
        (("recover", "text.mcap"), "is not an MCAP file"),
        (("check", "nowhere"), "No recording at nowhere"),
    ],
)
def test_wrong_input_is_answered_in_one_sentence(arguments, sentence, run, call, tmp_path):
    (tmp_path / "text.mcap").write_text("a text, not a recording")
    record(tmp_path / "bare", attachments={})
    record(tmp_path / "stateless", fields=["action", "reward"])
    code, out, errors = call(*(argument.replace("RUN", str(run)) for argument in arguments))
    assert code == 1
    assert errors.startswith("error: ")
    assert sentence in errors
    assert "\n" not in errors
    assert out == ""


def test_a_missing_argument_is_a_usage_error(call):
    code, _, errors = call("plot", "somewhere")
    assert code == 2
    assert "--episode" in errors


def test_schema_of_a_recording_names_its_reward_terms(run, call):
    code, out, _ = call("schema", run)
    assert code == 0
    assert "| `reward_terms.progress`, `reward_terms.time` | repeated float | - |" in out


def test_the_picture_shows_where_a_flight_counts_as_a_collision(street, tmp_path):
    from resc.viewing.map_picture import draw_obstacles, ring_entry
    from resc.viewing.plot import inflation_m

    assert inflation_m(street, 0) == 0.3
    axes = Figure().add_subplot()
    draw_obstacles(axes, [(3.0, 0.5, 0.4, 1.0), (0.0, 0.0, 0.0, 0.0)], [(5.0, 1.0, 0.2)], 0.3)
    ring, obstacles = axes.collections
    assert [len(shown.get_paths()) for shown in (ring, obstacles)] == [2, 2]
    around = [path.get_extents().extents for path in ring.get_paths()]
    np.testing.assert_allclose(around, [(2.7, 0.2, 3.7, 1.8), (4.5, 0.5, 5.5, 1.5)], atol=1e-9)
    assert ring_entry(0.3, ends=True).get_label() == "collision: within 0.3 m of an obstacle"


def test_a_crash_in_the_last_step_does_not_flatten_the_other_rewards():
    from resc.viewing.plot import _set_range

    axes = Figure().add_subplot()
    time = [0.0, 0.1, 0.2, 0.3]
    axes.plot(time, [0.0, 1.0, 2.0, 3.0], label="progress 3.00")
    axes.plot(time, [0.0, -0.5, -1.0, -1001.0], label="crash -1001.00")
    _set_range(axes, 0.3)
    low, high = axes.get_ylim()
    assert -2 < low < -1
    assert 2 < high < 4
    assert axes.get_lines()[-1].get_marker() == "v"
    calm = Figure().add_subplot()
    calm.plot(time, [0.0, 1.0, 2.0, 3.0], label="progress 3.00")
    before = calm.get_ylim()
    _set_range(calm, 0.3)
    assert calm.get_ylim() == before
