"""Files that the stock writer wrote again, with other chunks, indexes and checksums: read whole."""

import copy
import itertools
import random
import shutil

import pytest
import torch
from mcap.reader import NonSeekingReader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from small_run import COLUMNS, ENVS, record, rollout

from resc import keys
from resc.errors import RecordingError
from resc.log_command import main
from resc.recording import RolloutLog
from resc.recording.check import check
from resc.recording.rewrite import merge, recover


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run")) / "rollouts_00000.mcap"


def rewrite(path, target, *, library="", order=None, beside=False, late=False, **options):
    """Writes a file's messages, metadata and attachments again with the stock writer."""
    with path.open("rb") as file:
        messages = list(NonSeekingReader(file).iter_messages(log_time_order=False))
    with path.open("rb") as file:
        rest = [r for r in StreamReader(file).records if type(r).__name__ != "Message"]
    if order is not None:
        order(messages)
    with target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(**({"library": library} if library is not None else {}))
        if beside:
            foreign(writer)
        if not late:
            describe(writer, rest)
        channels = {}
        for schema, channel, message in messages:
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time,
                message.sequence,
            )  # fmt: skip
        if late:
            describe(writer, rest)
        writer.finish()
    return target


def describe(writer, rest):
    for record_ in rest:
        if type(record_).__name__ == "Metadata":
            writer.add_metadata(record_.name, record_.metadata)
        elif type(record_).__name__ == "Attachment":
            writer.add_attachment(0, 0, record_.name, record_.media_type, record_.data)


def foreign(writer):
    """A camera, a topic of the same name with other messages, documents."""
    schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"uint8[] data")
    for topic in ("/camera", "/rollout"):
        number = writer.register_channel(topic, "cdr", schema)
        for time in range(5):
            writer.add_message(number, time * 1000, b"\0\1\0\0image", time)
    writer.add_metadata("rosbag2", {"serialized_metadata": "rosbag2_bagfile_information"})
    writer.add_attachment(0, 0, "calibration.yaml", "text/yaml", b"k: 1")


INDEXES = {
    "all": IndexType.ALL,
    "no message index": IndexType.ALL & ~IndexType.MESSAGE,
    "no chunk index": IndexType.ALL & ~IndexType.CHUNK,
    "none": IndexType.NONE,
}
SWITCHES = ("use_chunking", "enable_crcs", "repeat_schemas", "repeat_channels", "use_statistics",
            "use_summary_offsets")  # fmt: skip


def same_content(path, original):
    log, first = RolloutLog(path), RolloutLog(original)
    assert log.complete
    assert log.metadata == first.metadata
    assert log.attachments.items() >= first.attachments.items()
    assert log.start_steps == first.start_steps
    whole, expected = log.to_tensordict(), rollout()
    assert all(torch.equal(whole[c.key], expected[c.key]) for c in COLUMNS)
    assert log.episodes.drop("file").equals(first.episodes.drop("file"))
    assert (log.start(4) == first.start(4)).all()
    assert torch.equal(log.scene(3)["boxes_w"], first.scene(3)["boxes_w"])


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.parametrize("index", INDEXES)
def test_a_file_without_what_the_format_leaves_out_is_read_whole(switch, index, original, tmp_path):
    path = rewrite(original, tmp_path / "x.mcap", index_types=INDEXES[index], **{switch: False})
    same_content(path, original)


def test_any_combination_of_options_and_compressions_is_read_whole(original, tmp_path):
    rng = random.Random(0)
    for number in range(25):
        options = {name: rng.random() < 0.5 for name in SWITCHES}
        path = rewrite(
            original,
            tmp_path / f"{number}.mcap",
            library=rng.choice(("", "resc", None)),
            compression=rng.choice(list(CompressionType)),
            index_types=rng.choice(list(INDEXES.values())),
            chunk_size=rng.choice((1, 1000, 5000, 1 << 22)),
            enable_data_crcs=rng.random() < 0.5,
            order=rng.choice((None, lambda m: m.sort(key=lambda x: x[2].log_time))),
            beside=rng.random() < 0.5,
            late=rng.random() < 0.5,
            **options,
        )
        same_content(path, original)


@pytest.mark.parametrize("order", ["reverse", "shuffle"])
def test_messages_in_any_order_are_put_in_order(order, original, tmp_path):
    change = list.reverse if order == "reverse" else random.Random(1).shuffle
    same_content(rewrite(original, tmp_path / "x.mcap", order=change), original)


def test_check_finds_nothing_wrong_and_recover_gives_a_file_as_resc_writes_it(original, tmp_path):
    path = rewrite(
        original, tmp_path / "x.mcap", use_chunking=False, enable_crcs=False, beside=True
    )
    done = check(path)
    assert done.faults == []
    assert "was written again by another program" in done.notes[0]
    assert (done.batches, done.env_steps, done.episodes) == (4, 120, 6)
    assert recover(path, tmp_path / "y.mcap").batches == 4
    assert check(tmp_path / "y.mcap").notes == []
    same_content(tmp_path / "y.mcap", original)
    merge([path], tmp_path / "z.mcap")
    same_content(tmp_path / "z.mcap", original)


def test_info_tells_of_a_rearranged_file_what_it_tells_of_the_original(original, tmp_path, capsys):
    path = rewrite(original, tmp_path / "x.mcap", index_types=IndexType.NONE)
    told = []
    for location in (original, path):
        with pytest.raises(SystemExit) as ended:
            main(["info", str(location)])
        assert not ended.value.code
        told.append(capsys.readouterr().out.splitlines()[1:])
    assert told[0] == told[1]


def test_a_rearranged_file_that_was_cut_is_read_up_to_there(original, tmp_path):
    path = rewrite(original, tmp_path / "x.mcap", use_chunking=False)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    log = RolloutLog(path)
    assert not log.complete
    assert 1 <= log.num_batches < 4
    action = log.to_tensordict()[keys.ACTION]
    assert torch.equal(action, rollout()[keys.ACTION][: len(action)])
    assert "is not complete" in check(path).faults[0]
    assert recover(path, tmp_path / "y.mcap").batches == log.num_batches


def test_damage_to_a_rearranged_file_is_found_or_harmless(original, tmp_path):
    path = rewrite(original, tmp_path / "whole.mcap", chunk_size=3000)
    data, rng, counts = path.read_bytes(), random.Random(2), []
    for _ in range(40):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        try:
            found = RolloutLog(path).to_tensordict()
        except RecordingError:
            counts.append(0)
            continue
        expected = rollout()[: len(found)]
        assert all(torch.equal(found[c.key], expected[c.key]) for c in COLUMNS)
        counts.append(len(found))
    assert max(counts) == 40


def test_recover_of_a_file_without_a_batch_is_refused(tmp_path):
    record(tmp_path / "run")
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        with (tmp_path / "run" / "rollouts_00000.mcap").open("rb") as source:
            describe(writer, [r for r in StreamReader(source).records if "etadata" in str(type(r))])
        writer.finish()
    with pytest.raises(RecordingError, match="nothing to recover"):
        recover(tmp_path / "x.mcap", tmp_path / "y.mcap")
    assert not (tmp_path / "y.mcap").exists()


def test_the_same_step_twice_is_read_once(original, tmp_path):
    def twice(messages):
        messages += messages

    same_content(rewrite(original, tmp_path / "x.mcap", order=twice), original)


def test_runs_recorded_at_one_time_are_refused(original, tmp_path):
    def mixed(messages):
        rollouts = [m for m in messages if m[1].topic == "/rollout"]
        other = [copy.copy(message) for *_, message in rollouts]
        for message in other:
            message.data = message.data[:-1] + bytes([message.data[-1] ^ 1])
        messages += [(*rollouts[0][:2], message) for message in other]

    with pytest.raises(RecordingError, match=r"more than once, of runs .* at the same time"):
        RolloutLog(rewrite(original, tmp_path / "x.mcap", order=mixed))


def test_no_room_for_the_copy_is_told(original, tmp_path, monkeypatch):
    path = rewrite(original, tmp_path / "x.mcap", use_chunking=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    with pytest.raises(RecordingError, match="name another folder in TMPDIR"):
        RolloutLog(path)


def test_a_resumed_run_of_rearranged_files_is_read_once(tmp_path):
    folder = record(tmp_path / "run", batches=range(3))
    record(folder, batches=range(2, 4))
    for path in sorted(folder.glob("*.mcap")):
        shutil.move(rewrite(path, tmp_path / "x.mcap", use_chunking=False), path)
    log = RolloutLog(folder)
    assert log.start_steps == [0, 10, 20, 30]
    assert len(log.to_polars()) == 40 * ENVS
    assert list(itertools.accumulate(batch.steps for batch in log.batches)) == [10, 20, 30, 40]
