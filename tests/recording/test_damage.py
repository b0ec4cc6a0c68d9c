"""Damaged files: whatever is flipped or cut, what is read is right, or refused in a sentence."""

import functools
import random
import shlex
import struct
import time
import uuid

import pytest
import torch
from tensordict import TensorDict

from resc.errors import RecordingError
from resc.recording import Column, RolloutLog, RolloutRecorder
from resc.recording.indexing import open_source

COLUMNS = (
    Column(("state", "position_w"), ("x", "y", "z"), torch.float32, "m", "w"),
    Column(("reward",), (), torch.float32),
    Column(("terminated",), (), torch.bool),
)
STEPS, ENVS, BATCHES = 8, 6, 4
OUTCOMES = ("success", "collision")
RUN = {"seed": "7", "task": "racing"}
DOCUMENTS = {"config.yaml": b"seed: 7\n", "notes.txt": b"hello" * 20}


@functools.cache
def rollout(number):
    generator = torch.Generator().manual_seed(number)
    shape = (STEPS, ENVS)
    data = {
        "state": {"position_w": torch.randn(*shape, 3, generator=generator)},
        "reward": torch.full((*shape, 1), -0.25),
        "terminated": torch.rand(*shape, 1, generator=generator) < 0.2,
    }
    return TensorDict(data, shape)


def ended(number):
    """One episode of each environment, of the length of the batch."""
    first = number * STEPS
    data = {
        "env_id": torch.arange(ENVS),
        "episode": torch.full((ENVS,), number),
        "start_step": torch.full((ENVS,), first),
        "end_step": torch.full((ENVS,), first + STEPS - 1),
        "length": torch.full((ENVS,), STEPS),
        "scene": torch.arange(ENVS) + number,
        "outcome": torch.arange(ENVS) % 2,
        "return_": torch.arange(ENVS) * 0.5 + number,
        "difficulty": torch.ones(ENVS),
        "success": torch.arange(ENVS) % 2 == 0,
    }
    return TensorDict(data, [ENVS])


def scenes(number):
    return {"boxes_w": torch.full((3, 2), float(number)), "entry": torch.arange(3)}


def starts(number):
    step = torch.full((ENVS,), number * STEPS)
    state = torch.arange(ENVS * 3.0).reshape(ENVS, 3) + number
    return {"env_id": torch.arange(ENVS), "step": step, "state": state}


def write(directory, compression):
    """A recording that is the same to the last bit every time."""
    with pytest.MonkeyPatch.context() as fixed:
        fixed.setattr(uuid, "uuid4", lambda: uuid.UUID(int=7))
        fixed.setattr(time, "time_ns", lambda: 1_700_000_000_000_000_000)
        record(directory, compression)
    return (directory / "rollouts_00000.mcap").read_bytes()


def record(directory, compression):
    with RolloutRecorder(
        compression=compression,
        directory=directory,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=ENVS,
        metadata=RUN,
        attachments=DOCUMENTS,
        outcomes=OUTCOMES,
    ) as recorder:
        for number in range(BATCHES):
            recorder.put_world(scenes(number), number * STEPS)
            recorder.put(rollout(number), number * STEPS, ended(number), starts(number))


def cut(data, rng):
    return data[: rng.randrange(len(data))]


def flip(data, rng):
    """1 to 8 flipped bits, all over the file."""
    damaged = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def overwrite(data, rng):
    """A run of zeros, of ones or of noise, as bad sectors and half-written pages leave it."""
    start, length = rng.randrange(len(data)), rng.choice((1, 4, 8, 64, 512))
    run = rng.choice((b"\0" * length, b"\xff" * length, rng.randbytes(length)))
    return data[:start] + run[: len(data) - start] + data[start + length :]


def splice(data, rng):
    """Bytes left out or repeated."""
    start = rng.randrange(len(data))
    end = min(len(data), start + rng.randrange(1, 200))
    return data[:start] + (data[end:] if rng.random() < 0.5 else data[start:end] + data[start:])


def flip_and_cut(data, rng):
    return flip(cut(data, rng), rng) if len(data) else data


DAMAGE = (cut, flip, overwrite, splice, flip_and_cut)


def readable(read):
    """What a call gives; None where it is refused in a sentence."""
    try:
        return read()
    except RecordingError as error:
        sentence = str(error)
    assert len(sentence) > 20
    assert sentence.endswith(".")
    return None


def check(path):
    """Everything the file still gives equals what was put; how many of its parts it gives."""
    log = readable(lambda: RolloutLog(path))
    if log is None:
        return 0
    assert (log.columns, log.num_envs, log.dt_s) == (COLUMNS, ENVS, 0.02)
    assert log.metadata == RUN
    parts = 1
    for index, start_step in enumerate(log.start_steps):
        found = readable(lambda index=index: log.batch(index))
        if found is not None:
            assert start_step % STEPS == 0
            expected = rollout(start_step // STEPS)
            assert all(torch.equal(found[c.key], expected[c.key]) for c in COLUMNS)
            parts += 1
    whole = readable(log.to_tensordict)
    if whole is not None:
        expected = [rollout(step // STEPS) for step in log.start_steps]
        expected = torch.cat(expected) if expected else rollout(0)[:0]
        assert torch.equal(whole["state", "position_w"], expected["state", "position_w"])
        parts += 1
    episodes = readable(lambda: log.episodes)
    if episodes is not None:
        for row in episodes.iter_rows(named=True):
            expected = ended(row["episode"])[row["env_id"]]
            for name in ("start_step", "end_step", "length", "scene", "return_", "difficulty"):
                assert row[name] == expected[name].item()
            assert row["outcome"] == OUTCOMES[expected["outcome"]]
            assert row["success"] == (row["outcome"] == "success")
        parts += 1
    steps = readable(lambda: log.env(ENVS - 1))
    if steps is not None and len(steps):
        expected = torch.cat([rollout(step // STEPS)[:, -1] for step in log.start_steps])
        assert torch.equal(steps["state", "position_w"], expected["state", "position_w"])
    started = readable(lambda: log.start(0))
    if started is not None:
        assert torch.equal(started["state"], starts(0)["state"][0])
    documents = readable(lambda: log.attachments)
    if documents is not None:
        assert documents.items() <= DOCUMENTS.items()
        parts += 1
    worlds = readable(lambda: log.worlds)
    if worlds is not None:
        for step, arrays in worlds:
            assert torch.equal(arrays["boxes_w"], scenes(step // STEPS)["boxes_w"])
        parts += 1
    return parts


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def whole(request, tmp_path_factory):
    """A small recording, as bytes."""
    return write(tmp_path_factory.mktemp(request.param), request.param)


def fuzz(data, path, cases):
    counts = []
    for seed in cases:
        rng = random.Random(seed)
        path.write_bytes(DAMAGE[seed % len(DAMAGE)](data, rng))
        counts.append(check(path))
    return counts


def test_a_whole_file_gives_everything(whole, tmp_path):
    path = tmp_path / "whole.mcap"
    path.write_bytes(whole)
    assert check(path) == BATCHES + 5


def test_damaged_files_give_what_was_put_or_a_sentence(whole, tmp_path):
    counts = fuzz(whole, tmp_path / "damaged.mcap", range(100))
    assert sum(counts) > 300  # and much is still read


@pytest.mark.slow
def test_thousands_of_damaged_files_give_what_was_put_or_a_sentence(whole, tmp_path):
    fuzz(whole, tmp_path / "damaged.mcap", range(1000, 3000))


@pytest.mark.slow
def test_every_single_flipped_bit_is_found(whole, tmp_path):
    path = tmp_path / "damaged.mcap"
    for position in range(len(whole)):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << position % 8
        path.write_bytes(damaged)
        check(path)


def test_a_damaged_summary_costs_nothing(whole, tmp_path):
    path = tmp_path / "damaged.mcap"
    (start,) = struct.unpack_from("<Q", whole, len(whole) - 28)
    for position in (start, start + 100, len(whole) - 20, len(whole) - 9, len(whole) - 1):
        damaged = bytearray(whole)
        damaged[position] ^= 4
        path.write_bytes(damaged)
        assert check(path) == BATCHES + 5


def test_a_file_cut_in_its_header_holds_nothing_to_read(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    for size in (0, 3, 8, 12, 30):
        path.write_bytes(whole[:size])
        with pytest.raises(RecordingError, match="was cut before the recording began"):
            RolloutLog(path)


def test_a_file_cut_in_a_chunk_gives_the_batches_before(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole)
    chunk = open_source(path).chunks_of("/rollout")[2]
    path.write_bytes(whole[: chunk.offset + chunk.length // 2])
    log = RolloutLog(path)
    assert log.start_steps == [0, STEPS]
    assert len(log.episodes) == 2 * ENVS
    assert torch.equal(log.batch(1)["reward"], rollout(1)["reward"])


def test_a_file_cut_in_its_footer_gives_everything(whole, tmp_path):
    path = tmp_path / "cut.mcap"
    for missing in (1, 8, 9, 20, 37, 38, 200):
        path.write_bytes(whole[:-missing])
        assert check(path) == BATCHES + 5


def test_a_damaged_batch_is_named_and_the_others_are_read(whole, tmp_path):
    path = tmp_path / "lr=0.1, b.mcap"
    path.write_bytes(whole)
    chunk = open_source(path).chunks_of("/rollout")[1]
    damaged = bytearray(whole)
    damaged[chunk.offset + chunk.length - 20] ^= 1
    path.write_bytes(damaged)
    log = RolloutLog(path)
    with pytest.raises(
        RecordingError, match=f"damaged at byte {chunk.offset}; .* other batches"
    ) as raised:
        log.batch(1)
    rescue = str(raised.value).partition("(")[2].partition(")")[0]
    assert shlex.split(rescue) == ["resc-log", "recover", str(path), "--out", "saved.mcap"]
    for index in (0, 2, 3):
        expected = rollout(index)["state", "position_w"]
        assert torch.equal(log.batch(index)["state", "position_w"], expected)
    assert len(log.episodes) == BATCHES * ENVS


def test_damaged_documents_are_named_and_the_rest_is_read(whole, tmp_path):
    path = tmp_path / "damaged.mcap"
    for part, complaint in ((b"seed: 7", "damaged at byte"), (b"racing", "'resc.run' is damaged")):
        damaged = bytearray(whole)
        damaged[whole.index(part) + 1] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match=complaint):
            _ = RolloutLog(path).config


def test_a_description_of_another_version_or_with_a_changed_number_is_refused(whole, tmp_path):
    path = tmp_path / "changed.mcap"
    assert b"0.02" in whole
    path.write_bytes(whole.replace(b"0.02", b"0.03"))
    with pytest.raises(RecordingError, match=r"metadata 'resc.spec' is damaged; copy"):
        RolloutLog(path)
    older = whole.replace(b"format\1\0\0\0" + b"4", b"format\1\0\0\0" + b"2")
    path.write_bytes(older)
    with pytest.raises(RecordingError, match="has recording format 2, and this RESC reads format"):
        RolloutLog(path)


def test_a_recording_without_a_configuration_says_what_it_has(tmp_path):
    with RolloutRecorder(
        directory=tmp_path,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=ENVS,
        metadata=RUN,
        attachments={"notes.txt": b"hello"},
    ) as recorder:
        recorder.put(rollout(0), 0)
    with pytest.raises(
        RecordingError, match=r"no attachment 'config.yaml'; it has \['notes.txt'\]"
    ):
        _ = RolloutLog(tmp_path).config


def test_a_chunk_that_contradicts_its_index_ends_what_is_read(whole, tmp_path):
    path = tmp_path / "damaged.mcap"
    path.write_bytes(whole)
    chunks = open_source(path).chunks
    start_time, end_time, size = 9, 17, 25  # places in the head of a chunk, which has no checksum
    for number, chunk in enumerate(chunks):
        for field in (start_time, end_time, size):
            damaged = bytearray(whole[:-40])  # without a summary
            damaged[chunk.offset + field + 3] ^= 1
            path.write_bytes(damaged)
            assert open_source(path).chunks == chunks[:number]
