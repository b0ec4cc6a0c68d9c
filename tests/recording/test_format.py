"""What is on the disk: exact values, schemas that other readers understand, rounding."""

import struct

import numpy as np
import pytest
import torch
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tensordict import TensorDict

from resc.errors import ConfigError
from resc.recording import Column, RolloutLog, RolloutRecorder
from resc.recording.wire import round_mantissa

XYZ = ("x", "y", "z")
COLUMNS = (
    Column(("state", "position_w"), XYZ, torch.float32, "m", "w"),
    Column(("next", "reward"), (), torch.float32),
    Column(("state", "deep", "counter"), (), torch.int32, "steps"),
    Column(("next", "done"), (), torch.bool),
    Column(("scene",), (), torch.uint32, shape=()),
    Column(
        ("task", "control_points_w"),
        ("x_0", "y_0", "z_0", "x_1", "y_1", "z_1"),
        torch.float32,
        "m",
        "w",
        shape=(2, 3),
    ),
    Column(("flags",), ("a", "b"), torch.bool),
)
DT_NS = 20_000_000


def random_batch(steps, num_envs, seed=0):
    """Random bits in every column, so NaN payloads, infinities and subnormals occur."""
    generator = torch.Generator().manual_seed(seed)
    batch = TensorDict({}, [steps, num_envs])
    for column in COLUMNS:
        shape = (steps, num_envs, *column.shape)
        bits = torch.randint(-(2**31), 2**31, shape, generator=generator, dtype=torch.int32)
        batch[column.key] = bits > 0 if column.dtype == torch.bool else bits.view(column.dtype)
    return batch


def record(directory, batches, **options):
    num_envs, step = batches[0].shape[1], 0
    arguments = {"metadata": {"seed": "7"}, "attachments": {"config.yaml": b"seed: 7\n"}}
    with RolloutRecorder(
        directory=directory,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=num_envs,
        **arguments,
        **options,
    ) as recorder:
        for batch in batches:
            recorder.put(batch, step)
            step += batch.shape[0]
    return RolloutLog(directory)


def bits(tensor):
    return tensor if tensor.dtype == torch.bool else tensor.view(torch.int32)


def assert_same_bits(actual, expected):
    assert actual.shape == expected.shape
    for column in COLUMNS:
        got, wanted = actual[column.key], expected[column.key]
        assert got.dtype == wanted.dtype == column.dtype
        assert got.shape == wanted.shape
        assert torch.equal(bits(got), bits(wanted)), column.key


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_what_is_read_back_is_what_was_put_bit_for_bit(tmp_path, compression):
    batches = [random_batch(16, 70, seed) for seed in range(3)]
    log = record(tmp_path, batches, compression=compression)
    assert log.columns == COLUMNS
    for i, batch in enumerate(batches):
        assert_same_bits(log.batch(i), batch)
    assert_same_bits(log.to_tensordict(), torch.cat(batches))
    assert_same_bits(log.env(69), torch.cat(batches)[:, 69])


@pytest.mark.parametrize(("steps", "num_envs"), [(1, 1), (1, 5), (31, 3), (200, 2), (20_000, 1)])
def test_every_length_of_batch_reads_back(tmp_path, steps, num_envs):
    batch = random_batch(steps, num_envs)
    assert_same_bits(record(tmp_path, [batch]).batch(0), batch)


def test_batches_of_different_lengths_share_a_file(tmp_path):
    batches = [random_batch(steps, 4, seed=steps) for steps in (7, 130, 1)]
    log = record(tmp_path, batches)
    assert log.start_steps == [0, 7, 137]
    assert_same_bits(log.to_tensordict(), torch.cat(batches))


def test_transposed_collector_batches_are_recorded(tmp_path):
    batch = random_batch(9, 6)
    environments_first = batch.transpose(0, 1).clone()
    assert_same_bits(record(tmp_path, [environments_first.transpose(0, 1)]).batch(0), batch)


def test_stock_protobuf_decoding_equals_the_fast_reader(tmp_path):
    log = record(tmp_path, [random_batch(12, 5, seed) for seed in range(2)])
    everything = log.to_tensordict()
    with log.files[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages(topics="/rollout"))
    assert len(messages) == 10
    for schema, _, raw, fragment in messages:
        assert schema.name == "resc.RolloutFragment"
        assert raw.log_time == fragment.start_step * DT_NS + fragment.env_id
        assert raw.sequence == fragment.env_id
        assert fragment.batch == fragment.start_step // 12
        steps = slice(fragment.start_step, fragment.start_step + 12)
        for column in COLUMNS:
            node = fragment
            for part in column.key:
                node = getattr(node, part)
            fast = everything[column.key][steps, fragment.env_id].reshape(12, column.width)
            for i in range(column.width):
                stock = getattr(node, column.components[i]) if column.components else node
                expected = np.array(stock, column.numpy_dtype)
                # protobuf hands floats over as doubles, which may change the bits of a NaN
                number = expected == expected
                found = fast[:, i].contiguous().numpy()
                assert found[number].tobytes() == expected[number].tobytes()
                assert (found[~number] != found[~number]).all()


def test_schemas_keep_the_names_of_the_keys(tmp_path):
    log = record(tmp_path, [random_batch(2, 2)])
    with log.files[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    fields = []
    for schema in summary.schemas.values():
        messages = list(FileDescriptorSet.FromString(schema.data).file[0].message_type)
        while messages:
            message = messages.pop()
            messages += message.nested_type
            fields += message.field
    assert {"position_w", "control_points_w", "x_1", "return_", "floats"} <= {
        f.name for f in fields
    }
    assert all(field.json_name == field.name for field in fields)


def test_run_and_specification_are_stored_in_the_file(tmp_path):
    log = record(tmp_path, [random_batch(2, 2)], round_bits=12)
    with log.files[0].open("rb") as file:
        metadata = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert log.metadata == {"seed": "7"}
    assert metadata["resc.run"] == {"seed": "7", "crc32": "3ba02a50"}
    assert metadata["resc.spec"]["format"] == "4"
    assert metadata["resc.spec"]["round_bits"] == "12"
    assert log.config.seed == 7
    assert (log.num_envs, log.dt_s) == (2, 0.02)


@pytest.mark.parametrize("kept", [1, 10, 12, 22])
def test_rounding_error_stays_below_half_a_unit_of_the_last_kept_bit(kept):
    generator = np.random.default_rng(0)
    exact = generator.standard_normal(100_000).astype(np.float32)
    exact *= np.float32(10.0) ** generator.integers(-30, 30, exact.shape).astype(np.float32)
    rounded = exact.copy()
    round_mantissa(rounded, kept)
    error = np.abs(rounded.astype(np.float64) - exact) / np.abs(exact.astype(np.float64))
    assert error.max() <= 2.0 ** -(kept + 1)
    assert not (rounded.view(np.uint32) & ((1 << (23 - kept)) - 1)).any()


def test_rounding_keeps_special_values():
    special = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 3.4e38, 1.0, -2.0], np.float32)
    rounded = special.copy()
    round_mantissa(rounded, 4)
    np.testing.assert_array_equal(rounded.view(np.uint32), special.view(np.uint32))
    ties = np.array([1 + 2**-3, 1 + 3 * 2**-3], np.float32)
    round_mantissa(ties, 2)
    np.testing.assert_array_equal(ties, np.array([1.0, 1.5], np.float32))


def test_only_float_columns_are_rounded(tmp_path):
    batch = random_batch(8, 4)
    log = record(tmp_path, [batch], round_bits=10)
    counter = ("state", "deep", "counter")
    assert torch.equal(log.batch(0)[counter], batch[counter])
    position, exact = (
        log.batch(0)["state", "position_w"].numpy(),
        batch["state", "position_w"].numpy(),
    )
    round_mantissa(exact, 10)
    np.testing.assert_array_equal(position.view(np.uint32), exact.view(np.uint32))


@pytest.mark.parametrize(
    ("columns", "complaint"),
    [
        ([], "at least one"),
        ([Column(("a",), (), torch.float32)] * 2, "clashes"),
        ([Column(("batch",), (), torch.float32)], "header field"),
        ([Column(("a",), ("x", "x"), torch.float32)], "clashes"),
        (
            [Column(("a",), (), torch.float32), Column(("a", "b"), (), torch.float32)],
            "clashes",
        ),
    ],
)
def test_columns_that_clash_are_refused(tmp_path, columns, complaint):
    with pytest.raises(ConfigError, match=complaint):
        RolloutRecorder(
            directory=tmp_path, columns=columns, dt_s=0.02, num_envs=2, metadata={}, attachments={}
        )
    assert not list(tmp_path.iterdir())


def test_a_column_that_protobuf_cannot_hold_is_refused():
    with pytest.raises(ConfigError, match="float64"):
        Column(("a",), (), torch.float64)
    with pytest.raises(ConfigError, match="'Up'"):
        Column(("Up",), (), torch.float32)
    with pytest.raises(ConfigError, match="name one for each value"):
        Column(("a",), ("x", "y"), torch.float32, shape=(3,))


def test_other_programs_see_a_valid_file_with_every_message_counted(tmp_path):
    log = record(tmp_path, [random_batch(4, 3, seed) for seed in range(5)])
    with log.files[0].open("rb") as file:
        statistics = make_reader(file).get_summary().statistics
        file.seek(0)
        data = file.read()
    assert data[:8] == data[-8:] == struct.pack("<8B", 137, 77, 67, 65, 80, 48, 13, 10)
    assert statistics.message_count == 15
    assert statistics.message_end_time == 16 * DT_NS + 2
