"""What other programs make of a recording: the same messages, the same bits.

The stock Python packages are always asked. `rerun` is asked where it is installed (extra `rerun`),
and `@mcap/core` where node finds it (see list_messages.cjs).
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tensordict import TensorDict

from resc.recording import Column, RolloutLog, RolloutRecorder

COLUMNS = (
    Column(("state", "position_w"), ("x", "y", "z"), torch.float32, "m", "w"),
    Column(("reward",), (), torch.float32),
    Column(("counter",), (), torch.int32),
    Column(("scene",), (), torch.uint32, shape=()),
    Column(("terminated",), (), torch.bool),
)
OUTCOMES = ("success", "collision")
STEPS, ENVS, BATCHES = 16, 6, 3
MESSAGES = {"/rollout": ENVS * BATCHES, "/episodes": ENVS * BATCHES, "/world": 1, "/starts": 3}
WORLD = {
    "boxes_w": torch.arange(24.0).reshape(2, 3, 4) / 7,
    "entry": torch.arange(2),
    "count": torch.tensor([3, -1], dtype=torch.int32),
    "open": torch.tensor([[True, False], [False, False]]),
    "colour": torch.tensor([7, 8], dtype=torch.int32).view(torch.uint32),
    "none": torch.zeros(2, 0),
}
BATCH = torch.Generator().manual_seed(0)


def rollout():
    shape = (STEPS, ENVS)
    bits = torch.randint(-(2**31), 2**31, (*shape, 1), generator=BATCH, dtype=torch.int32)
    data = {
        "state": {"position_w": torch.randn(*shape, 3, generator=BATCH)},
        "reward": torch.randn(*shape, 1, generator=BATCH) * 1e-40,  # subnormal
        "counter": bits,
        "scene": bits[..., 0].view(torch.uint32),
        "terminated": bits > 0,
    }
    return TensorDict(data, shape)


def ended(number):
    ids = torch.arange(ENVS)
    data = {
        "env_id": ids,
        "episode": ids + 100 * number,
        "start_step": ids + 2**30,
        "end_step": ids + 2**31 + 1000 * number,
        "length": ids + 2**31,
        "scene": ids * 7,
        "outcome": ids % 2,
        "return_": torch.randn(ENVS, generator=BATCH),
        "difficulty": torch.rand(ENVS, generator=BATCH),
        "success": ids % 2 == 0,
    }
    return TensorDict(data, [ENVS])


def begun(number):
    step = torch.full((ENVS,), number * STEPS)
    state = torch.randn(ENVS, 4, generator=BATCH)
    return {"env_id": torch.arange(ENVS), "step": step, "state.attitude_wb": state}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A file with every topic, type and kind of number, and what was put into it."""
    directory = tmp_path_factory.mktemp("recorded")
    put = [(rollout(), ended(number), begun(number)) for number in range(BATCHES)]
    with RolloutRecorder(
        directory=directory,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=ENVS,
        metadata={"seed": "7"},
        attachments={"config.yaml": b"seed: 7\n"},
        outcomes=OUTCOMES,
    ) as recorder:
        recorder.put_world(WORLD, 0)
        for number, (batch, episodes, starts) in enumerate(put):
            recorder.put(batch, number * STEPS, episodes, starts)
    return directory / "rollouts_00000.mcap", put


def decoded(path, topic):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return list(reader.iter_decoded_messages(topics=topic))


def same_bits(stock, ours):
    assert np.array(stock, ours.dtype).tobytes() == np.ascontiguousarray(ours).tobytes()


def test_stock_readers_find_every_message_of_every_topic(recorded):
    path, _ = recorded
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    counts = summary.statistics.channel_message_counts
    assert {c.topic: counts[number] for number, c in summary.channels.items()} == MESSAGES
    for topic, count in MESSAGES.items():
        assert len(decoded(path, topic)) == count


def test_stock_rollouts_equal_the_fast_reader_bit_for_bit(recorded):
    path, put = recorded
    everything = RolloutLog(path).to_tensordict()
    for _, _, _, fragment in decoded(path, "/rollout"):
        steps = slice(fragment.start_step, fragment.start_step + STEPS)
        for column in COLUMNS:
            node = fragment
            for part in column.key:
                node = getattr(node, part)
            fast = everything[column.key][steps, fragment.env_id].reshape(STEPS, -1).numpy()
            for i, name in enumerate(column.components or (None,)):
                same_bits(getattr(node, name) if name else node, fast[:, i])
    expected = torch.cat([batch for batch, *_ in put])
    assert all(
        torch.equal(everything[c.key].view(torch.uint8), expected[c.key].view(torch.uint8))
        for c in COLUMNS
    )


def test_stock_episodes_equal_the_fast_reader(recorded):
    path, put = recorded
    episodes = RolloutLog(path).episodes
    expected = torch.cat([ended for _, ended, _ in put])
    for index, (_, _, raw, stock) in enumerate(decoded(path, "/episodes")):
        row = episodes.row(index, named=True)
        for field in stock.DESCRIPTOR.fields:
            value = getattr(stock, field.name)
            assert row[field.name] == value, field.name
            if field.name != "outcome":
                assert expected[field.name][index].item() == value
        assert stock.outcome == OUTCOMES[expected["outcome"][index]]
        assert raw.log_time == stock.end_step * 20_000_000 + stock.env_id


def arrays_of(message):
    """The named arrays of a `resc.World` or `resc.Starts`, by stock protobuf."""
    types = {"floats": "f4", "bools": "?", "ints": "i4", "uints": "u4", "longs": "i8"}
    found = {}
    for array in message.arrays:
        filled = [name for name in types if len(getattr(array, name))]
        assert len(filled) <= 1
        name = filled[0] if filled else "floats"
        values = np.array(getattr(array, name), types[name])
        found[array.name] = values.reshape(tuple(array.shape))
    return found


def test_stock_worlds_equal_the_fast_reader_bit_for_bit(recorded):
    path, _ = recorded
    ((_, _, _, message),) = decoded(path, "/world")
    ours, stock = RolloutLog(path).world, arrays_of(message)
    assert ours.keys() == stock.keys() == WORLD.keys()
    for name, array in stock.items():
        assert array.shape == ours[name].shape == WORLD[name].shape
        same_bits(array, ours[name].numpy())
        assert ours[name].numpy().tobytes() == WORLD[name].numpy().tobytes()


def test_stock_starts_equal_what_was_put_bit_for_bit(recorded):
    path, put = recorded
    for (_, _, _, message), (_, _, starts) in zip(decoded(path, "/starts"), put, strict=True):
        stock = arrays_of(message)
        assert stock.keys() == starts.keys()
        for name, array in stock.items():
            same_bits(array, starts[name].numpy())


def numbers_in(message):
    """How many numbers and truth values a protobuf message holds, zeros included."""
    total = 0
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        parts = value if field.is_repeated else [value]
        if field.message_type is not None:
            total += sum(numbers_in(part) for part in parts)
        elif field.type != field.TYPE_STRING:
            total += len(parts)
    return total


def test_node_lists_the_same_messages_and_as_many_numbers(recorded):
    wanted = "for (const p of ['@mcap/core', '@mcap/support', 'protobufjs']) require(p)"
    node = shutil.which("node")
    if (
        node is None
        or subprocess.run([node, "-e", wanted], capture_output=True, timeout=60).returncode
    ):
        pytest.skip("node or its packages are not installed; make readers does it")
    path, _ = recorded
    script = Path(__file__).with_name("list_messages.cjs")
    command = [node, script, path]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    expected = {
        topic: {
            "messages": count,
            "numbers": sum(numbers_in(message) for *_, message in decoded(path, topic)),
        }
        for topic, count in MESSAGES.items()
    }
    assert json.loads(done.stdout) == expected


def test_rerun_has_nothing_to_complain_about_and_loads_every_message(recorded, tmp_path):
    pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
    path, _ = recorded
    target = tmp_path / "out.rrd"

    def rerun(*arguments):
        command = [Path(sys.executable).with_name("rerun"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
        return done.stdout

    fine = re.findall(r"^ok +\d+ +\d+ +(/\w+) +—$", rerun("mcap", "check", path), re.MULTILINE)
    assert fine == list(MESSAGES)
    rerun("mcap", "convert", path, "-o", target)
    loaded = dict.fromkeys(MESSAGES, 0)
    rows = r"with (\d+) rows .* - (/\w+) - data columns: \[resc\.\w+:message\]"
    for count, topic in re.findall(rows, rerun("rrd", "print", target)):
        loaded[topic] += int(count)
    assert loaded == MESSAGES
