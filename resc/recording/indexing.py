"""From a file to its index: of RESC's own by their summary, of others by an arranged copy."""

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import IO

from mcap.writer import MCAP0_MAGIC

from resc.errors import RecordingError
from resc.recording import records
from resc.recording.contents import Contents, is_summed, places, read_summary, scan
from resc.recording.rearranged import arranged
from resc.recording.records import Place
from resc.recording.schema import ROLLOUT
from resc.recording.segment import ACTIVE, LIBRARY, NUMBERED
from resc.recording.source import Source, blaming, open_recording
from resc.recording.specification import Specification, unsealed


def open_source(path: Path) -> Source | None:
    """Index of a file with one run; None for one that was cut before its description was written.

    Raises:
        RecordingError: It cannot be read, or another program put several runs into it.
    """
    found = open_sources(path)
    if len(found) > 1:
        raise RecordingError(
            f"{path} holds {len(found)} runs, which another program merged; take the files that it "
            "was made of, or read it with RolloutLog."
        )
    return found[0] if found else None


def open_sources(path: Path) -> list[Source]:
    """Index of each run in a file: one, unless another program merged several."""
    found = _described(path)
    if found is None:
        return []
    metadata, contents, as_recorded = found
    lacking, status = [], path.stat()
    if "resc.spec" in metadata:
        specification = Specification.from_metadata(metadata["resc.spec"], str(path))
        as_recorded = as_recorded and not _is_thinned(contents, specification)
    else:
        specification, as_recorded = _rebuilt(path, status.st_size), False
        lacking.append(
            f"the metadata 'resc.spec' is gone: {specification.num_envs} environments, as many as "
            "its messages name, and columns by its schemas"
        )
    if "resc.run" in metadata:
        run = unsealed(metadata["resc.run"], "resc.run", str(path))
    else:
        run = {}
        lacking.append("the metadata 'resc.run' is gone: nothing is known about the run")
    if as_recorded:
        return [_source(path, specification, run, contents, contents.attachments)]
    found = []
    for copy in arranged(path, status.st_mtime_ns, status.st_size, specification):
        with copy.path.open("rb") as file:
            inner = read_summary(file, copy.path.stat().st_size)
        inner.complete, inner.counts, inner.read_to = copy.complete, None, copy.read_to
        source = _source(path, copy.specification, run, inner, contents.attachments)
        said = [f"{path}: {sentence}" for sentence in (*lacking, *copy.lacking)]
        found.append(replace(source, copy=copy, lacking=tuple(said)))
    return found


def _source(
    path: Path,
    specification: Specification,
    run: dict[str, str],
    contents: Contents,
    attached: list[Place],
) -> Source:
    return Source(
        path,
        specification,
        run,
        contents.topics,
        contents.chunks,
        contents.complete,
        attached,
        contents.counts,
        read_to=contents.read_to,
    )


def _is_thinned(contents: Contents, specification: Specification) -> bool:
    """Whether batches of a complete file lack environments: another program took them out."""
    counts: dict[int, int] = {}
    for chunk in contents.chunks:
        if contents.topics.get(ROLLOUT) in chunk.channels:
            step = chunk.start_time // specification.dt_ns
            counts[step] = counts.get(step, 0) + chunk.count
    return contents.complete and any(n != specification.num_envs for n in counts.values())


def _rebuilt(path: Path, size: int) -> Specification:
    """The specification of a file that lost it."""
    from resc.recording.rebuilt import rebuilt  # needs torch, which takes seconds to import

    with open_recording(path) as file:
        specification = rebuilt(file, size, path)
    if specification is None:
        raise RecordingError(
            f"{path} holds no metadata 'resc.spec' and no topic of RESC's recorder (a scene file "
            "is opened in a viewer); give a file of a run's folder rollouts."
        )
    return specification


def sessions_in(folder: Path) -> tuple[str, ...]:
    """The sessions that recorded to a folder, oldest first; files that cannot be read have none."""
    found: dict[str, None] = {}
    for path in sorted([*folder.glob(NUMBERED), *folder.glob(NUMBERED + ACTIVE)]):
        with suppress(RecordingError):
            metadata, *_ = _described(path) or ({},)
            if "resc.spec" in metadata:
                specification = Specification.from_metadata(metadata["resc.spec"], str(path))
                sessions = (*(specification.earlier or ()), specification.session)
                found |= dict.fromkeys(sessions)
    return tuple(found)


def _described(path: Path) -> tuple[dict[str, dict[str, str]], Contents, bool] | None:
    """Metadata, contents and whether these are as RESC records them; None for a stump."""
    with open_recording(path) as file:
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC[: len(magic)]:
            raise RecordingError(f"{path} is not an MCAP file; give a recording made by RESC.")
        size = os.fstat(file.fileno()).st_size
        contents = _contents(file, path, size)
        as_recorded = contents is not None
        if contents is None:
            contents = places(file, size)
        metadata = {}
        for place in contents.metadata:
            with blaming(path, place.offset, "its description is there; copy it again"):
                name, entries = records.read_metadata(file, place)
            metadata[name] = entries
    stump = "resc.spec" not in metadata and not contents.complete and not contents.chunks
    return None if stump else (metadata, contents, as_recorded)


def _contents(file: IO[bytes], path: Path, size: int) -> Contents | None:
    """What a file of RESC's recorder holds; None for one that another program wrote.

    From its summary, or record by record if that is not there or damaged.
    """
    if records.library(file, size) not in (None, LIBRARY):
        return None
    try:
        contents = read_summary(file, size)
    except ValueError:
        if records.ends(file, size) and not is_summed(file, size):
            return None
        with blaming(path, 0, "neither its summary nor its first chunk can be read; copy it again"):
            return scan(file, size)
    return contents if _as_recorded(contents) else None


def _as_recorded(contents: Contents) -> bool:
    """Whether chunks and index are those of RESC's recorder, as far as the summary says."""
    found = dict.fromkeys(contents.topics.values(), 0)
    rollout = contents.topics.get(ROLLOUT)
    for chunk in contents.chunks:
        if len(chunk.channels) != 1 or not chunk.channels <= found.keys():
            return False
        (channel,) = chunk.channels
        found[channel] += chunk.count
        if channel == rollout and chunk.count != chunk.end_time - chunk.start_time + 1:
            return False
    counts = contents.counts
    return counts is not None and counts == {n: count for n, count in found.items() if count}
