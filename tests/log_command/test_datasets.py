"""Recorded flights as datasets of LeRobot and Minari."""

import json
import os
import subprocess

import numpy as np
import polars as pl
import pytest
import torch
from small_run import record
from street import fly_street

from resc import keys
from resc.errors import RecordingError
from resc.flying.transitions import transitions
from resc.log_command import main
from resc.setup import build_stages

pytest.importorskip("pandas")
READ_BACK = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("resc/flights", root=sys.argv[1])
rows = [data[i] for i in range(len(data))]
print(json.dumps({
    "episodes": data.num_episodes, "fps": data.fps, "task": rows[0]["task"],
    "action": [row["action"].tolist() for row in rows],
    "seen": [row["observation.environment_state"].tolist() for row in rows],
    "done": [bool(row["next.done"]) for row in rows],
    "mean": data.meta.stats["action"]["mean"].tolist(),
}))
"""


@pytest.fixture(scope="module")
def street(compose, tmp_path_factory):
    """Two flights of 0.2 s."""
    limits = ("task=from_rest", "termination.time_limit.limit_s=0.2", "obstacle_observation=none")
    config = compose("num_envs=2", "recorder=mcap", *limits)
    return fly_street(config, tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def whole(street):
    """The same as transitions [S]."""
    return transitions(street.where())


@pytest.fixture
def call(capsys, monkeypatch, tmp_path):
    """Calls a command in an empty folder: exit code or sentence, and output."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        return ended.value.code, capsys.readouterr().out

    return called


@pytest.fixture
def lerobot(street, call, tmp_path):
    assert call("lerobot", street.files[0])[0] == 0
    return tmp_path / "lerobot"


def test_lerobot_steps_are_the_transitions_and_the_recorded_state(lerobot, street, whole):
    table = pl.read_parquet(lerobot / "data" / "chunk-000" / "file-000.parquet")
    seen = table["observation.environment_state"].to_numpy()
    np.testing.assert_array_equal(seen, whole["observation"].numpy())
    np.testing.assert_array_equal(table["action"].to_numpy(), whole["action"].numpy())
    state = street.where().to_tensordict()
    parts = [keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB, keys.BODY_RATE_B]
    together = torch.cat([state[key] for key in parts], -1)
    np.testing.assert_array_equal(table["observation.state"].to_numpy(), together.numpy())
    assert table["next.done"].to_list() == whole["next", "done"][:, 0].tolist()
    length = len(whole) // 2
    assert table["frame_index"].to_list() == [*range(length)] * 2
    assert table["index"].to_list() == [*range(2 * length)]
    np.testing.assert_array_equal(table["timestamp"][:3], np.float32([0, 0.02, 0.04]))


def test_lerobot_is_described_as_its_files_are(lerobot, street, whole):
    info = json.loads((lerobot / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["video_path"]) == ("v3.0", 50, None)
    assert (info["total_episodes"], info["total_frames"]) == (2, len(whole))
    assert info["splits"] == {"train": "0:2"}
    table = pl.read_parquet(lerobot / info["data_path"].format(chunk_index=0, file_index=0))
    assert list(info["features"]) == table.columns
    seen = info["features"]["observation.environment_state"]
    names = build_stages(street.config).observation_columns
    assert seen == {"dtype": "float32", "shape": [len(names)], "names": names}
    tasks = pl.read_parquet(lerobot / "meta" / "tasks.parquet")
    assert tasks["task_index"].to_list() == [0]
    episodes = pl.read_parquet(lerobot / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes["dataset_from_index"].to_list() == [0, len(whole) // 2]
    assert episodes["dataset_to_index"].to_list() == [len(whole) // 2, len(whole)]
    assert episodes["recorded_index"].to_list() == [0, 1]


def test_lerobot_statistics_are_those_of_the_numbers(lerobot, whole):
    found = json.loads((lerobot / "meta" / "stats.json").read_text())["action"]
    actions = whole["action"].double().numpy()
    np.testing.assert_allclose(found["mean"], actions.mean(0))
    np.testing.assert_allclose(found["std"], actions.std(0), atol=1e-15)
    np.testing.assert_allclose(found["q90"], np.quantile(actions, 0.9, axis=0))
    assert found["count"] == [len(whole)]
    episodes = pl.read_parquet(lerobot / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    first = episodes["stats/action/max"][0].to_list()
    np.testing.assert_array_equal(first, actions[: len(whole) // 2].max(0))


def test_a_file_is_full_before_the_next_one_is_begun(street, whole, tmp_path, monkeypatch):
    from resc.recording import lerobot

    monkeypatch.setattr(lerobot, "FILE_MB", 1e-6)
    monkeypatch.setattr(lerobot, "CHUNK_FILES", 1)
    lerobot.write_lerobot(tmp_path, street.where(), whole, ["a"], 0.02)
    files = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("data/*/*"))
    assert files == ["data/chunk-000/file-000.parquet", "data/chunk-001/file-000.parquet"]
    assert pl.read_parquet(tmp_path / files[1])["episode_index"].unique().to_list() == [1]


def test_only_a_whole_number_of_frames_in_a_second_is_lerobots():
    from resc.recording.lerobot import frames_per_second

    assert frames_per_second(0.02) == 50
    with pytest.raises(RecordingError, match=r"control step is 0.03 s, .* resc-log minari"):
        frames_per_second(0.03)


def test_minari_gives_the_transitions_back(street, whole, call, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    assert call("minari", street.files[0], "--where", "index = 1")[0] == 0
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    data = minari.load_dataset("flights-v0")
    assert (data.total_episodes, data.total_steps) == (1, len(whole) // 2)
    (episode,) = data.iterate_episodes()
    mine = whole[len(whole) // 2 :]
    np.testing.assert_array_equal(episode.observations[:-1], mine["observation"].numpy())
    np.testing.assert_array_equal(episode.observations[1:], mine["next", "observation"].numpy())
    np.testing.assert_array_equal(episode.actions, mine["action"].numpy())
    np.testing.assert_array_equal(episode.rewards, mine["next", "reward"][:, 0].numpy())
    np.testing.assert_array_equal(episode.truncations, mine["next", "truncated"][:, 0].numpy())
    (told,) = data.storage.get_episode_metadata([0])
    assert (told["recorded_index"], told["outcome"]) == (1, street.episodes["outcome"][1])


@pytest.mark.slow
def test_lerobot_itself_reads_what_is_written(lerobot, whole, tmp_path):
    python = os.environ.get("LEROBOT_PYTHON")
    if python is None:
        pytest.skip("LEROBOT_PYTHON names no interpreter that has lerobot, which wants its own")
    done = subprocess.run(
        [python, "-c", READ_BACK, lerobot],
        env={"HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)},
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert (found["episodes"], found["fps"]) == (2, 50)
    assert torch.equal(torch.tensor(found["action"]), whole["action"])
    assert torch.equal(torch.tensor(found["seen"]), whole["observation"])
    np.testing.assert_allclose(found["mean"], whole["action"].double().mean(0), rtol=1e-12)
    assert found["done"] == whole["next", "done"][:, 0].tolist()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("lerobot", "nowhere"), "No recording at nowhere"),
        (("lerobot", "RUN", "--where", "outcome = 'sucess'"), "Did you mean 'success'?"),
        (("lerobot", "RUN", "--where", "length > 1e6"), "No episode is left to learn from"),
        (("lerobot", "RUN", "--out", "taken"), "taken exists; name a new folder with --out"),
        (("lerobot", "RUN", "--out", "no/where"), "no is not a folder"),
        (("lerobot", "poor"), "no column sampled_action, which a dataset needs"),
        (("minari", "RUN", "--out", "flights"), "end it in a version, such as flights-v0"),
    ],
)
def test_wrong_input_is_answered_in_one_sentence(arguments, sentence, street, call, tmp_path):
    pytest.importorskip("minari")
    (tmp_path / "taken").mkdir()
    record(tmp_path / "poor", fields=["action", "reward"])
    given = [str(street.files[0]) if text == "RUN" else text for text in arguments]
    code, out = call(*given)
    assert str(code).startswith("error: ")
    assert sentence in code
    assert "\n" not in code
    assert out == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["poor", "taken"]
