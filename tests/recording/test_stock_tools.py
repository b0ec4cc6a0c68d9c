"""Files that stock tools filtered or merged: read, with a sentence for what is gone."""

import pytest
import torch
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from small_run import BATCHES, COLUMNS, ENVS, STEPS, record, rollout

from resc import keys
from resc.errors import RecordingError
from resc.log_command import main
from resc.recording import RolloutLog
from resc.recording.check import check
from resc.recording.indexing import open_sources
from resc.recording.rebuilt import columns_of
from resc.recording.rewrite import recover
from resc.recording.schema import Column, schema_data

DT_NS = 20_000_000
TOPICS = ("/rollout", "/episodes", "/world", "/starts")


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return record(tmp_path_factory.mktemp("run")) / "rollouts_00000.mcap"


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A later run of the same kind that flew other actions."""
    whole = rollout()
    whole[keys.BODY_RATE_B] += 1
    return record(tmp_path_factory.mktemp("other"), whole) / "rollouts_00000.mcap"


def rewritten(target, *paths, metadata=False, keep=lambda topic, time: True, offset=0, **options):
    """As `mcap filter` and `mcap merge` do: messages in order of time, new numbers of channels."""
    messages, described = [], []
    for path in paths:
        with path.open("rb") as file:
            reader = make_reader(file)
            messages += reader.iter_messages()
            described += reader.iter_metadata() if metadata else []
    messages.sort(key=lambda m: m[2].log_time)
    with target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(library="another tool")
        for _ in range(offset):
            writer.register_channel("/foreign", "json", 0)
        for entry in described:
            writer.add_metadata(entry.name, entry.metadata)
        channels = {}
        for schema, channel, message in messages:
            if not keep(channel.topic, message.log_time):
                continue
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time,
                message.sequence,
            )  # fmt: skip
        writer.finish()
    return target


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"offset": 7},
        {"chunk_size": 2000},
        *({"compression": compression} for compression in CompressionType),
    ],
    ids=str,
)
def test_messages_alone_give_all_steps_and_episodes(original, tmp_path, options):
    log, first = (
        RolloutLog(rewritten(tmp_path / "x.mcap", original, **options)),
        RolloutLog(original),
    )
    assert (log.num_envs, log.dt_s, log.columns) == (ENVS, 0.02, COLUMNS)
    whole, expected = log.to_tensordict(), rollout()
    assert all(torch.equal(whole[c.key], expected[c.key]) for c in COLUMNS)
    assert log.episodes.drop("file", "seed", "outcome").equals(
        first.episodes.drop("file", "seed", "outcome")
    )
    assert log.episodes["outcome"].cast(str).equals(first.episodes["outcome"].cast(str))
    assert torch.equal(log.scene(3)["boxes_w"], first.scene(3)["boxes_w"])
    assert (log.start(4) == first.start(4)).all()
    assert log.metadata == {}
    told = " ".join(log.lacking)
    assert "'resc.spec' is gone: 3 environments" in told
    assert "'resc.run' is gone" in told
    with pytest.raises(RecordingError, match=r"has no attachment 'config\.yaml'"):
        log.config  # noqa: B018


def test_a_rebuilt_description_does_not_tell_where_the_file_lay(original, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    sessions = []
    for folder in (here, here, there):
        folder.mkdir(exist_ok=True)
        path = rewritten(folder / f"{len(sessions)}.mcap", original)
        recover(path, folder / "saved.mcap")
        (source,) = open_sources(folder / "saved.mcap")
        sessions.append(source.specification.session)
        assert str(tmp_path).encode() not in (folder / "saved.mcap").read_bytes()
    assert sessions[0] == sessions[1] != sessions[2]


@pytest.mark.parametrize("metadata", [True, False])
def test_episodes_that_a_filter_of_time_cut_are_incomplete(original, tmp_path, metadata):
    """From step 10, environment 1, up to step 35: the first batch kept is not whole."""
    first, last = 10 * DT_NS + 1, 35 * DT_NS
    path = rewritten(
        tmp_path / "x.mcap",
        original,
        metadata=metadata,
        keep=lambda topic, time: first <= time < last,
    )
    log = RolloutLog(path)
    assert log.start_steps == [20, 30]
    assert any("the batch from step 10 has 2 of 3 environments" in text for text in log.lacking)
    whole = log.to_tensordict()
    assert torch.equal(whole[keys.ACTION], rollout()[20:][keys.ACTION])
    listed = log.episodes.select("start_step", "end_step", "complete").rows()
    assert listed == [(0, 12, False), (5, 17, False), (0, 25, False), (13, 30, False)]
    with pytest.raises(RecordingError, match=r"where\(complete=True\)"):
        log.episode(0)
    assert "not all of it there" in repr(log)
    assert any("is left out" in fault for fault in check(path).faults)


@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("metadata", [True, False])
def test_one_topic_alone_is_read(original, tmp_path, topic, metadata):
    path = rewritten(
        tmp_path / "x.mcap", original, metadata=metadata, keep=lambda name, _: name == topic
    )
    if topic == "/world" and not metadata:
        with pytest.raises(
            RecordingError, match="it holds nothing after step 0, so its time step is unknown"
        ):
            RolloutLog(path)
        return
    log = RolloutLog(path)
    assert log.num_batches == (BATCHES if topic == "/rollout" else 0)
    assert len(log) == (6 if topic == "/episodes" else 0)
    assert not log.episodes["complete"].any()


@pytest.mark.parametrize("metadata", [True, False])
def test_two_runs_in_one_file_are_two_runs(original, other, tmp_path, metadata):
    path = rewritten(tmp_path / "x.mcap", original, other, metadata=metadata)
    log = RolloutLog(path)
    assert log.files == [path]
    assert log.start_steps == [0, 10, 20, 30] * 2
    for number, source in enumerate((original, other)):
        first = RolloutLog(source)
        for index in range(len(first)):
            ours, theirs = log.episode(index + number * len(first)), first.episode(index)
            assert all(torch.equal(ours[c.key], theirs[c.key]) for c in COLUMNS)
        assert torch.equal(log.scene(number * 6)["boxes_w"], first.scene(0)["boxes_w"])
    with pytest.raises(RecordingError, match="holds 2 runs, which another program merged"):
        recover(path, tmp_path / "y.mcap")


@pytest.fixture(scope="module")
def overlapping(tmp_path_factory):
    """Three runs, each begun at the last batch of the one before it: steps 0, 10; 10, 20; 20, 30.

    No step is in all of them.
    """
    paths = []
    for number in range(3):
        whole = rollout()
        whole[keys.BODY_RATE_B] += number
        folder = tmp_path_factory.mktemp("part")
        record(folder, whole, batches=range(number, number + 2))
        paths.append(folder / "rollouts_00000.mcap")
    return paths


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
@pytest.mark.parametrize("metadata", [True, False])
def test_runs_that_overlap_in_turn_are_as_many_runs(overlapping, tmp_path, metadata, order):
    paths = [overlapping[number] for number in order]
    log = RolloutLog(rewritten(tmp_path / "x.mcap", *paths, metadata=metadata))
    assert log.start_steps == [0, 10, 10, 20, 20, 30]
    for number, batch in enumerate((0, 0, 1, 1, 2, 2)):
        expected = rollout()[log.start_steps[number] :][:STEPS][keys.BODY_RATE_B]
        assert torch.equal(log.batch(number)[keys.BODY_RATE_B], expected + batch)


def test_runs_that_took_turns_in_recording_are_refused(original, other, tmp_path):
    """Batch after batch, one of each: as if one run had been begun again at each step."""
    messages = []
    for number, path in enumerate((original, other)):
        turned = rewritten(
            tmp_path / f"{number}.mcap", path, keep=lambda topic, _: topic == "/rollout"
        )
        with turned.open("rb") as file:
            found = make_reader(file).iter_messages()
            messages += [(m.log_time // DT_NS * 2 + number, m) for *_, m in found]
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(library="another tool")
        columns = schema_data("/rollout", COLUMNS)
        schema = writer.register_schema("resc.RolloutFragment", "protobuf", columns)
        channel = writer.register_channel("/rollout", "protobuf", schema)
        for time, message in messages:
            writer.add_message(channel, message.log_time, message.data, time)
        writer.finish()
    with pytest.raises(RecordingError, match=r"more than once, of runs .* at the same time"):
        RolloutLog(tmp_path / "x.mcap")


def test_file_merged_with_itself_is_read_once(original, tmp_path):
    log = RolloutLog(rewritten(tmp_path / "x.mcap", original, original, metadata=True))
    assert log.start_steps == [0, 10, 20, 30]
    assert len(log) == 6


def test_columns_of_other_parts_come_back_from_the_schema(tmp_path):
    columns = (
        Column(("state", "position_w"), ("x", "y", "z"), "float32", "m", "world"),
        Column(("metric", "energy"), (), "float32"),
        Column(("metric", "steps"), (), "uint32"),
        Column(("reward",), (), "float32"),
        Column(("mine", "deep", "vector"), ("a", "b"), "int32"),
    )
    found = columns_of({"/rollout": schema_data("/rollout", columns)}, tmp_path)
    assert [(c.key, c.components, c.dtype_name) for c in found] == [
        (c.key, c.components, c.dtype_name) for c in columns
    ]


def test_recover_of_what_a_filter_left_says_what_is_lost(original, tmp_path, capsys):
    path = rewritten(
        tmp_path / "x.mcap", original, metadata=True, keep=lambda _, time: time != 10 * DT_NS
    )
    with pytest.raises(SystemExit) as ended:
        main(["recover", str(path), "--out", str(tmp_path / "y.mcap")])
    assert ended.value.code == 3
    assert "the batch from step 10 has 2 of 3 environments" in capsys.readouterr().out
    assert RolloutLog(tmp_path / "y.mcap").start_steps == [0, 20, 30]
    assert RolloutLog(tmp_path / "y.mcap").num_steps == STEPS * 3


def test_merge_of_what_a_filter_left_says_what_is_lost(original, tmp_path, capsys):
    path = rewritten(
        tmp_path / "x.mcap", original, metadata=True, keep=lambda _, time: time != 10 * DT_NS
    )
    with pytest.raises(SystemExit) as ended:
        main(["merge", str(path), "--out", str(tmp_path / "y.mcap")])
    assert ended.value.code == 3
    assert "the batch from step 10 has 2 of 3 environments" in capsys.readouterr().out


@pytest.mark.parametrize("byte", [0.3, 0.5, 0.7])
def test_recover_of_a_damaged_file_of_another_tool_says_from_where_on(original, tmp_path, byte):
    path = rewritten(tmp_path / "x.mcap", original, metadata=True, chunk_size=2000)
    data = bytearray(path.read_bytes())
    data[int(byte * len(data))] ^= 0xFF
    path.write_bytes(data)
    done = recover(path, tmp_path / "y.mcap")
    assert done.batches < BATCHES
    assert "on, where it was cut or is damaged" in done.lost[-1]
