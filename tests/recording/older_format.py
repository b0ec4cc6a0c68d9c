"""Files as older versions wrote them."""

import pytest

from resc.recording import specification
from resc.recording.decode import batches, read_environments
from resc.recording.indexing import open_source
from resc.recording.schema import ACTION, SAMPLED_ACTION
from resc.recording.segment import ACTIVE, FileHead, Segment
from resc.recording.wire import encode_fragments


@pytest.fixture
def as_format_3(tmp_path_factory, monkeypatch):
    """Writes a recording again as it was before format 4: the sample as `action`, no history."""

    def rewrite(path):
        source = open_source(path)
        old = [c for c in source.specification.columns if c != SAMPLED_ACTION]
        target = tmp_path_factory.mktemp("old") / "old.mcap"
        known = specification._entries
        head = FileHead(_replaced(source.specification, old), source.metadata, source.attachments())
        with monkeypatch.context() as patched:
            patched.setattr(specification, "FORMAT", "3")
            patched.setattr(specification, "_entries", lambda: known()[:-2])
            segment = Segment(target, head, "zstd")
        for batch in batches(source):
            segment.append("/rollout", _fragments(source, batch, old), 0)
        for topic in source.topics.keys() - {"/rollout"}:
            for chunk in source.chunks_of(topic):
                found = source.messages_in(chunk, topic)
                segment.append(topic, [(t, n, data) for t, n, _, data in found], 0)
        segment.finish()
        data = target.read_bytes()
        path.write_bytes(data[:-100] if path.suffix == ACTIVE else data)

    return rewrite


def _replaced(spec, columns):
    from dataclasses import replace

    return replace(spec, columns=tuple(columns), earlier=None)


def _fragments(source, batch, old):
    columns = source.specification.columns
    arrays = read_environments(columns, [batch], 0, source.specification.num_envs - 1)
    named = dict(zip(columns, arrays, strict=True))
    if SAMPLED_ACTION in named:
        named[ACTION] = named[SAMPLED_ACTION]
    data = encode_fragments(tuple(old), [named[c] for c in old], 0, batch.start_step)
    origin = batch.start_step * source.specification.dt_ns
    return [(origin + i, i, fragment) for i, fragment in enumerate(data)]
