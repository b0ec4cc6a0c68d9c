"""Reading: episodes, environments, worlds, files that are cut or foreign, the documentation."""

import random
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
import zstandard
from mcap.writer import Writer
from tensordict import TensorDict

from resc.errors import RecordingError
from resc.recording import Column, RolloutLog, RolloutRecorder
from resc.recording.indexing import open_source

OUTCOMES = ("success", "collision", "time_limit")
COLUMNS = (
    Column(("state", "position_w"), ("x", "y", "z"), torch.float32, "m", "w"),
    Column(("next", "reward"), (), torch.float32),
    Column(("step",), (), torch.int32),
    Column(("done",), (), torch.bool),
)


def recorder(directory, num_envs, config=b"env:\n  num_envs: 4\n", **options):
    return RolloutRecorder(
        directory=directory,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=num_envs,
        metadata={"task": "racing"},
        attachments={"config.yaml": config, "notes.txt": b"hello"},
        outcomes=OUTCOMES,
        **options,
    )


def rollout(steps, num_envs, seed=0):
    generator = torch.Generator().manual_seed(seed)
    shape = (steps, num_envs)
    return TensorDict(
        {
            "state": {"position_w": torch.randn(*shape, 3, generator=generator)},
            "next": {"reward": torch.randn(*shape, 1, generator=generator)},
            "step": torch.arange(steps, dtype=torch.int32)[:, None, None].expand(*shape, 1),
            "done": torch.rand(*shape, 1, generator=generator) < 0.05,
        },
        shape,
    )


def finished(whole, lower, upper):
    """The episodes that end in a part of a rollout, one for each done flag."""
    done = whole["done"][..., 0]
    entries = []
    for step, env_id in done[lower:upper].nonzero().tolist():
        end = step + lower
        earlier = done[:end, env_id].nonzero().flatten().tolist()
        start = earlier[-1] + 1 if earlier else 0
        total = whole["next", "reward"][start : end + 1, env_id].sum()
        outcome = end % 3
        number, length = len(earlier), end + 1 - start
        scene, success = env_id + 10, outcome == 0
        entry = (env_id, number, start, end, length, scene, outcome, float(total), success)
        entries.append(entry)
    names = ("env_id", "episode", "start_step", "end_step", "length", "scene", "outcome")
    columns = list(zip(*entries, strict=True)) or [()] * 9
    data = {n: torch.tensor(v, dtype=torch.int64) for n, v in zip(names, columns[:7], strict=True)}
    data["return_"] = torch.tensor(columns[7], dtype=torch.float32)
    data["difficulty"] = torch.tensor(columns[3], dtype=torch.float32) / 128  # of its last step
    data["success"] = torch.tensor(columns[8], dtype=torch.bool)
    return TensorDict(data, [len(entries)])


def put_all(target, whole, steps_per_batch, first_step=0):
    for lower in range(0, whole.shape[0], steps_per_batch):
        upper = lower + steps_per_batch
        episodes = finished(whole, lower, upper)
        target.put(whole[lower:upper], first_step + lower, episodes)


def test_episodes_agree_with_the_done_flags(tmp_path):
    whole = rollout(96, 6)
    with recorder(tmp_path, 6) as target:
        put_all(target, whole, 16)
    log = RolloutLog(tmp_path)
    assert len(log.episodes) == int(whole["done"].sum())
    expected = torch.cat([finished(whole, i, i + 16) for i in range(0, 96, 16)])
    expected["outcome"] = expected["end_step"] % 3
    for key, values in expected.items():
        found = log.episodes[key].to_physical() if key == "outcome" else log.episodes[key]
        assert found.to_list() == values.tolist()
    for entry in log.episodes.iter_rows(named=True):
        episode = log.episode(entry["index"])
        steps = torch.arange(entry["start_step"], entry["end_step"] + 1)
        assert torch.equal(episode["step"].flatten().long(), steps)
        assert episode["done"].flatten().tolist() == [False] * (len(steps) - 1) + [True]
        total = float(episode["next", "reward"].sum())
        assert total == pytest.approx(entry["return_"], rel=1e-5, abs=1e-5)
        assert entry["outcome"] == OUTCOMES[entry["end_step"] % 3]


def test_listing_episodes_reads_no_rollout_chunk(tmp_path, monkeypatch):
    whole = rollout(512, 256)
    with recorder(tmp_path, 256, rotate_mb=512) as target:
        put_all(target, whole, 256)
    log, sizes = RolloutLog(tmp_path), []
    decompress = zstandard.decompress

    def counting(data, size):
        sizes.append(size)
        return decompress(data, size)

    monkeypatch.setattr(zstandard, "decompress", counting)
    assert len(log.episodes) == int(whole["done"].sum())
    assert len(sizes) == 2  # one chunk of episodes for each batch


def test_one_environment_takes_at_most_two_chunks_of_a_batch(tmp_path, monkeypatch):
    whole = rollout(512, 1024)
    with recorder(tmp_path, 1024) as target:
        target.put(whole[:256], 0)
        target.put(whole[256:], 256)
    log, count = RolloutLog(tmp_path), []
    decompress = zstandard.decompress
    monkeypatch.setattr(
        zstandard, "decompress", lambda data, size: count.append(size) or decompress(data, size)
    )
    for env_id in (0, 511, 1023):
        count.clear()
        single = log.env(env_id)
        assert len(count) <= 4
        assert torch.equal(single["state", "position_w"], whole["state", "position_w"][:, env_id])
    count.clear()
    log.to_tensordict()
    assert len(count) >= 8


def test_episodes_and_environments_span_rotated_files(tmp_path):
    whole = rollout(120, 8)
    whole["done"].zero_()
    whole["done"][100, 3] = True
    with recorder(tmp_path, 8, rotate_mb=0.002) as target:
        put_all(target, whole, 15)
    log = RolloutLog(tmp_path)
    assert len(log.files) == 8
    assert torch.equal(log.env(3)["step"], whole["step"][:, 3])
    assert torch.equal(log.episode(0)["step"].flatten(), torch.arange(101, dtype=torch.int32))


def test_a_pattern_or_one_file_selects_part_of_a_run(tmp_path):
    whole = rollout(60, 8)
    with recorder(tmp_path, 8, rotate_mb=0.002) as target:
        put_all(target, whole, 15)
    assert RolloutLog(str(tmp_path / "*_0000[12].mcap")).start_steps == [15, 30]
    assert RolloutLog(tmp_path / "rollouts_00003.mcap").start_steps == [45]


def test_an_episode_that_is_only_partly_recorded_is_an_error(tmp_path):
    whole = rollout(60, 2)
    whole["done"].zero_()
    whole["done"][[5, 40], 0] = True
    with recorder(tmp_path, 2, every_n_batches=2) as target:
        put_all(target, whole, 10)
    log = RolloutLog(tmp_path)
    assert log.start_steps == [0, 20, 40]
    assert len(log.episodes) == 2
    assert len(log.episode(0)) == 6
    assert log.episodes["complete"].to_list() == [True, False]
    with pytest.raises(RecordingError, match="are not recorded in these files"):
        log.episode(1)


def test_runs_in_several_directories_are_not_mixed(tmp_path):
    runs = [rollout(40, 3, seed) for seed in range(2)]
    for number, whole in enumerate(runs):
        with recorder(tmp_path / str(number), 3) as target:
            put_all(target, whole, 20)
    log = RolloutLog(str(tmp_path / "*"))
    assert [path.parent.name for path in log.files] == ["0", "1"]
    first = int(runs[0]["done"].sum())
    for index, whole in ((0, runs[0]), (first, runs[1])):
        entry = log.episodes.row(index, named=True)
        rows = slice(entry["start_step"], entry["end_step"] + 1)
        expected = whole["state", "position_w"][rows, entry["env_id"]]
        assert torch.equal(log.episode(index)["state", "position_w"], expected)


def test_worlds_keep_names_shapes_types_and_their_step(tmp_path):
    first = {
        "boxes_w": torch.randn(3, 5, 4),
        "count": torch.tensor([1, 2, 5], dtype=torch.int32),
        "route_length": torch.tensor([[2**40], [-1]]),
        "open": torch.tensor([[True, False]]),
        "radius_m": torch.tensor(0.25),
        "holes": torch.zeros(3, 0, 2),
    }
    second = {"boxes_w": torch.randn(2, 5, 4).transpose(0, 1)}
    with recorder(tmp_path, 2, rotate_mb=0.001) as target:
        target.put_world(first, 0)
        for step in range(0, 40, 10):
            target.put(rollout(10, 2), step)
        target.put_world(second, 40)
        target.put(rollout(10, 2), 40)
    log = RolloutLog(tmp_path)
    assert len(log.files) > 3
    assert [step for step, _ in log.worlds] == [0, 40]
    for (_, world), expected in zip(log.worlds, (first, second), strict=True):
        assert world.keys() == expected.keys()
        for name, tensor in expected.items():
            torch.testing.assert_close(world[name], tensor, rtol=0, atol=0)
    assert torch.equal(log.world["boxes_w"], second["boxes_w"])
    middle = RolloutLog(log.files[2])  # each file stands on its own
    assert torch.equal(middle.world["boxes_w"], first["boxes_w"])
    assert middle.attachments["notes.txt"] == b"hello"


def test_a_file_cut_anywhere_gives_a_prefix_of_its_batches(tmp_path):
    whole = rollout(60, 3)
    with recorder(tmp_path / "whole", 3) as target:
        put_all(target, whole, 10)
    data = (tmp_path / "whole" / "rollouts_00000.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    found, head = set(), data.index(b"config.yaml") - 29  # the attachment follows the metadata
    rng = random.Random(0)
    for size in [0, 5, 8, *rng.sample(range(8, len(data)), 120), len(data) - 1, len(data)]:
        cut.write_bytes(data[:size])
        if size < head:
            with pytest.raises(RecordingError, match="nothing to read"):
                RolloutLog(cut)
            continue
        log = RolloutLog(cut)
        found.add(log.num_batches)
        assert log.metadata == {"task": "racing"}
        everything = log.to_tensordict()
        assert len(everything) == 10 * log.num_batches
        for key in (("state", "position_w"), "step", "done"):
            assert torch.equal(everything[key], whole[key][: len(everything)])
        # A file may be cut between the last batch and its episodes.
        assert len(log.episodes) in {int(whole["done"][:rows].sum()) for rows in range(0, 70, 10)}
    assert found == set(range(7))


def test_a_batch_of_which_some_chunks_are_missing_is_left_out(tmp_path):
    whole = rollout(128, 2048)  # two chunks a batch
    with recorder(tmp_path, 2048, compression="none") as target:
        put_all(target, whole, 64)
    path = tmp_path / "rollouts_00000.mcap"
    chunks = open_source(path).chunks_of("/rollout")
    data = path.read_bytes()
    for count, kept in ((1, 0), (len(chunks) // 2, 1), (len(chunks) - 1, 1), (len(chunks), 2)):
        path.write_bytes(data[: chunks[count - 1].offset + chunks[count - 1].length + 40_000])
        log = RolloutLog(path)
        assert log.num_batches == kept
        assert torch.equal(log.to_tensordict()["step"], whole["step"][: 64 * kept])


def test_a_growing_file_is_read_up_to_its_last_batch_and_survives_its_renaming(tmp_path):
    whole = rollout(30, 2)
    target = recorder(tmp_path, 2)
    target.put(whole[:10], 0)
    target.put(whole[10:20], 10)
    target.flush()
    growing = RolloutLog(tmp_path)
    assert growing.files == [tmp_path / "rollouts_00000.mcap.active"]
    assert growing.start_steps == [0, 10]
    target.put(whole[20:], 20)
    target.close()
    assert torch.equal(growing.batch(1)["step"], whole["step"][10:20])
    assert growing.attachments["notes.txt"] == b"hello"
    assert RolloutLog(tmp_path).start_steps == [0, 10, 20]


def test_a_run_without_batches_is_empty_not_broken(tmp_path):
    recorder(tmp_path, 4).close()
    log = RolloutLog(tmp_path)
    assert log.to_tensordict()["state", "position_w"].shape == (0, 4, 3)
    assert log.env(0)["done"].shape == (0, 1)
    assert len(log.episodes) == 0
    assert log.world == {}
    assert log.config.env.num_envs == 4


def test_a_damaged_chunk_is_reported_with_its_place(tmp_path):
    with recorder(tmp_path, 64) as target:
        target.put(rollout(64, 64), 0)
    path = tmp_path / "rollouts_00000.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged at byte"):
        RolloutLog(path).to_tensordict()


def foreign_file(path, metadata):
    writer = Writer(str(path))
    writer.start()
    for name, entries in metadata.items():
        writer.add_metadata(name, entries)
    writer.finish()


def test_what_is_not_a_recording_is_named_in_one_sentence(tmp_path):
    text, other, newer = (tmp_path / name for name in ("notes.txt", "other.mcap", "newer.mcap"))
    text.write_text("not a recording at all")
    foreign_file(other, {"camera": {"rate": "30"}})
    foreign_file(newer, {"resc.spec": {"format": "99"}})
    for location, complaint in (
        (text, "not an MCAP file"),
        (other, r"no metadata 'resc.spec' and no topic of .* \(a scene file is opened in a"),
        (newer, "has recording format 99"),
        (tmp_path, "No recording at"),
        (tmp_path / "missing.mcap", "No recording at"),
        (str(tmp_path / "none_*.mcap"), "No recording at"),
    ):
        with pytest.raises(RecordingError, match=complaint):
            RolloutLog(location)


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        (b"env: [1", "expected ',' or ']'"),
        (b"- 1\n- 2\n", "it holds no mapping"),
        (b"hello", "it holds no mapping"),
        (b"3", "it holds no mapping"),
        (b"", "it holds no mapping"),
        (b"env: \xff", "can't decode byte"),
        (b"env: ${", "no viable alternative"),
        (b"env: !!int x", "invalid literal"),
        (b"env: &env [*env]", "recursion"),
    ],
)
def test_a_stored_document_that_is_no_configuration_is_refused(tmp_path, config, reason):
    recorder(tmp_path, 4, config).close()
    log = RolloutLog(tmp_path)
    complaint = rf"_00000.mcap: its attachment 'config.yaml' is not a .*{reason}.*; take the config"
    with pytest.raises(RecordingError, match=complaint):
        _ = log.config


def test_of_several_files_the_one_that_cannot_be_read_is_named_with_a_way_on(tmp_path):
    with recorder(tmp_path, 4) as target:
        target.put(rollout(8, 4), 0)
    bad = tmp_path / "rollouts_00001.mcap"
    bad.write_text("not a recording at all")
    with pytest.raises(RecordingError, match=r"^\S*_00001.mcap is not an MCAP file; .*by RESC\.$"):
        RolloutLog(bad)
    for location in (tmp_path, str(tmp_path / "*.mcap")):
        with pytest.raises(RecordingError, match=r"is not .* leave it out, or open the others by"):
            RolloutLog(location)
    assert RolloutLog(tmp_path / "rollouts_00000.mcap").num_batches == 1


def test_recordings_that_differ_are_not_joined(tmp_path):
    recorder(tmp_path, 4).close()
    recorder(tmp_path, 5).close()
    with pytest.raises(RecordingError, match="differ in columns, environments or time step"):
        RolloutLog(tmp_path)


def test_an_index_that_does_not_exist_is_named(tmp_path):
    with recorder(tmp_path, 4) as target:
        target.put(rollout(8, 4), 0)
    log = RolloutLog(tmp_path)
    for call, index in ((log.batch, 1), (log.env, 4), (log.env, -1), (log.episode, 0)):
        with pytest.raises(RecordingError, match=f"no .* {index}; the recording holds"):
            call(index)


def test_the_examples_of_reading_in_the_documentation_run(tmp_path, monkeypatch):
    with recorder(tmp_path / "rollouts" / "train", 4) as target:
        target.put_world({"boxes_w": torch.zeros(2, 3, 4)}, 0)
        put_all(target, rollout(200, 4), 50)
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "recording.md"
    reading = page.read_text().partition("## Command line")[0]
    blocks = re.findall(r"```python\n(.*?)```", reading, re.DOTALL)
    assert len(blocks) == 6
    for block, package in zip(blocks, (None, None, "pandas", None, None, "rerun"), strict=True):
        if package is None or find_spec(package) is not None:
            exec(compile(block, str(page), "exec"), {})


def test_a_run_is_read_once_whatever_names_it_has(tmp_path):
    whole = rollout(40, 4)
    with recorder(tmp_path / "a" / "rollouts", 4) as target:
        put_all(target, whole, 20)
    (tmp_path / "latest").symlink_to(tmp_path / "a")
    (tmp_path / "b").mkdir()
    for location in (tmp_path / "a", tmp_path / "latest", str(tmp_path / "*")):
        assert RolloutLog(location).start_steps == [0, 20]
    copy = tmp_path / "copy.mcap"
    copy.write_bytes((tmp_path / "a" / "rollouts" / "rollouts_00000.mcap").read_bytes())
    with pytest.raises(RecordingError, match="hold the same steps; leave one of them out"):
        RolloutLog(str(tmp_path / "*"))


def test_a_log_says_what_it_holds(tmp_path):
    whole = rollout(60, 8)
    with recorder(tmp_path, 8, rotate_mb=0.002) as target:
        put_all(target, whole, 15)
    assert repr(RolloutLog(tmp_path)) == (
        f"RolloutLog('{tmp_path}/rollouts_00000.mcap' and 3 more file(s): 60 steps of 8 "
        f"environments in 4 batches, {int(whole['done'].sum())} episodes)"
    )
    path = tmp_path / "rollouts_00003.mcap"
    path.write_bytes(path.read_bytes()[:-50])
    assert repr(RolloutLog(path)).endswith("cut or being written)")


@pytest.mark.parametrize("number", [-1, -7, 10**30, True])
def test_a_number_that_counts_nothing_is_refused(number, tmp_path):
    with recorder(tmp_path, 4) as target:
        put_all(target, rollout(60, 4), 15)
    log = RolloutLog(tmp_path)
    assert len(log) > 3
    for read in (log.episode, log.start, log.scene, log.batch, log.env):
        with pytest.raises(RecordingError, match=rf"There is no \w+ {number}; .* counted from 0"):
            read(number)
    with pytest.raises(RecordingError, match="counted from 0"):
        log.starts([0, number])


def test_looking_at_a_recording_imports_no_torch(tmp_path):
    with recorder(tmp_path / "run", 4) as target:
        put_all(target, rollout(60, 4), 15)
    script = """
import sys
from resc.log_command import main
path = sys.argv[1]
file = path + "/run/rollouts_00000.mcap"
for command in (["info"], ["episodes", "--where", "length > 3"], ["check"], ["merge"]):
    rest = ["--out", path + "/m.mcap"] if command == ["merge"] else []
    try:
        main([command[0], path + "/run", *command[1:], *rest])
    except SystemExit as ended:
        assert not ended.code, ended.code
try:
    main(["recover", file, "--out", path + "/r.mcap"])
except SystemExit as ended:
    assert not ended.code
heavy = {"torch", "tensordict", "hydra", "matplotlib", "foxglove", "numba", "scipy"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)],
        capture_output=True, text=True, timeout=60, check=False, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
