"""Files written anew: recovered and merged; and whether they are right."""

from pathlib import Path

import pytest
import torch
from small_run import BATCHES, EPISODES, STEPS, episodes, record, rollout

from resc import keys
from resc.errors import RecordingError
from resc.recording import RolloutLog
from resc.recording.check import check
from resc.recording.decode import batches
from resc.recording.indexing import open_source
from resc.recording.rewrite import merge, recover
from resc.recording.segment import FileHead, Segment


@pytest.fixture
def path(tmp_path):
    return record(tmp_path / "run") / "rollouts_00000.mcap"


def damage(path: Path, topic: str, number: int) -> None:
    """Flips a byte in the middle of a chunk."""
    chunk = open_source(path).chunks_of(topic)[number]
    data = bytearray(path.read_bytes())
    data[chunk.offset + chunk.length // 2] ^= 0xFF
    path.write_bytes(data)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_complete_file_is_recovered_byte_for_byte(tmp_path, compression):
    path = record(tmp_path, compression=compression) / "rollouts_00000.mcap"
    done = recover(path, tmp_path / "again.mcap")
    assert (done.batches, done.lost) == (4, [])
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()


def test_a_cut_file_is_recovered_up_to_its_last_whole_batch(path, tmp_path):
    third = open_source(path).chunks_of("/rollout")[2]
    cut, whole = tmp_path / "rollouts_00000.mcap.active", tmp_path / "saved.mcap"
    cut.write_bytes(path.read_bytes()[: third.offset + third.length // 2])
    assert recover(cut, whole).batches == 2
    log = RolloutLog(whole)
    assert log.complete
    assert log.start_steps == [0, 10]
    assert torch.equal(log.to_tensordict()[keys.ACTION], rollout()[keys.ACTION][:20])
    assert log.episodes["index"].to_list() == [0, 1, 2]
    assert log.metadata == {"seed": "7"}
    assert log.config.action.rate_limit_radps == [2.0, 2.0, 1.0]
    assert check(whole).faults == []
    assert cut.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "rollouts_00000.mcap.active",
        "run",
        "saved.mcap",
    ]


def test_a_damaged_batch_is_left_out_and_named_the_others_are_kept(path, tmp_path):
    damage(path, "/rollout", 1)
    done = recover(path, tmp_path / "saved.mcap")
    assert done.batches == 3
    assert len(done.lost) == 1
    assert "damaged at byte" in done.lost[0]
    assert RolloutLog(tmp_path / "saved.mcap").start_steps == [0, 20, 30]


def test_a_batch_without_all_its_fragments_is_left_out_and_said(path, tmp_path):
    """In a complete file, so that it was not cut: another program left one out."""
    source, changed = open_source(path), tmp_path / "changed.mcap"
    head = FileHead(source.specification, source.metadata, source.attachments())
    segment = Segment(changed, head, "zstd")
    for number, batch in enumerate(batches(source)):
        rows = next(source.rows(batch.chunks[0], "/rollout"))
        origin = batch.start_step * source.specification.dt_ns
        messages = [(origin + i, i, rows.message(i)) for i in range(3 - (number == 1))]
        segment.append("/rollout", messages, 0)
    segment.finish()
    log = RolloutLog(changed)
    assert log.start_steps == [0, 20, 30]
    told = f"{changed}: the batch from step 10 has 2 of 3 environments and is left out"
    assert log.lacking == [told]
    done = recover(changed, tmp_path / "saved.mcap")
    assert (done.batches, done.lost) == (3, [told])
    assert RolloutLog(tmp_path / "saved.mcap").start_steps == [0, 20, 30]


def test_damaged_episodes_are_refused_and_left_out_by_recover(path, tmp_path):
    damage(path, "/episodes", 1)
    with pytest.raises(RecordingError, match="save what is readable"):
        len(RolloutLog(path))
    done = recover(path, tmp_path / "saved.mcap")
    assert (done.batches, len(done.lost)) == (4, 1)
    lost = episodes(10, 20)["end_step"].tolist()
    kept = [end for end, _, _ in EPISODES if end not in lost]
    assert RolloutLog(tmp_path / "saved.mcap").episodes["end_step"].to_list() == kept
    faults = check(tmp_path / "saved.mcap").faults
    assert any("an end is flagged and no episode listed" in fault for fault in faults)


def test_files_of_a_run_become_one_with_the_same_content(tmp_path):
    record(tmp_path / "run", rotate_mb=0.001)
    files = sorted((tmp_path / "run").glob("*.mcap"))
    assert len(files) == 5  # the first holds nothing but the scenes
    merge(files[::-1], tmp_path / "one.mcap")
    one, four = RolloutLog(tmp_path / "one.mcap"), RolloutLog(tmp_path / "run")
    assert (one.to_tensordict() == four.to_tensordict()).all()
    assert one.episodes.drop("file").equals(four.episodes.drop("file"))
    assert torch.equal(one.start(4)[keys.ACTION_QUEUE], four.start(4)[keys.ACTION_QUEUE])
    assert check(tmp_path / "one.mcap").faults == []


def test_a_resumed_run_is_merged_and_keeps_the_facts_of_both_parts(tmp_path):
    record(tmp_path, batches=range(2))
    record(tmp_path, batches=range(2, 4), metadata={"seed": "7", "git_commit": "later"},
           attachments={"config.yaml": b"resume: true\n"})  # fmt: skip
    merge(sorted(tmp_path.glob("rollouts_*.mcap")), tmp_path / "one.mcap")
    log = RolloutLog(tmp_path / "one.mcap")
    assert log.num_batches == BATCHES
    assert log.metadata == {"seed": "7", "merged": '[{"seed": "7", "git_commit": "later"}]'}
    assert log.attachments["config.1.yaml"] == b"resume: true\n"


def test_files_that_do_not_belong_together_are_not_merged(tmp_path):
    one = record(tmp_path / "a", batches=range(2)) / "rollouts_00000.mcap"
    overlapping = record(tmp_path / "b", batches=range(1, 3)) / "rollouts_00000.mcap"
    rounded = record(tmp_path / "c", batches=range(2, 4), round_bits=12) / "rollouts_00000.mcap"
    with pytest.raises(RecordingError, match="both hold step 10"):
        merge([one, overlapping], tmp_path / "x.mcap")
    with pytest.raises(RecordingError, match="differ in round_bits"):
        merge([one, rounded], tmp_path / "x.mcap")
    assert not (tmp_path / "x.mcap").exists()


def test_a_right_recording_has_no_faults(path):
    done = check(path.parent)
    assert done.faults == []
    assert (done.files, done.batches, done.env_steps, done.episodes) == (1, 4, 120, 6)


def test_numbers_that_are_not_finite_are_found(tmp_path):
    whole = rollout()
    whole[keys.VELOCITY_W][14, 2, 1] = float("nan")
    whole[keys.VELOCITY_W][17, 0, 1] = float("inf")
    record(tmp_path, whole)
    assert [fault.partition(": ")[2] for fault in check(tmp_path).faults] == [
        "state.velocity_w.y of environment 2 is nan in step 14 (1 more like this)."
    ]


def test_flags_and_listed_episodes_must_agree(tmp_path):
    whole = rollout()
    whole[keys.TERMINATED][12, 1] = False
    whole[keys.TRUNCATED][33, 2] = True
    record(tmp_path, whole)
    first, second = (fault.partition(": ")[2] for fault in check(tmp_path).faults)
    assert first == "in step 12 of environment 1 an episode ends that is not flagged as ended."
    assert second == "in step 33 of environment 2 an end is flagged and no episode listed."


def test_returns_and_lengths_must_be_those_of_the_steps(tmp_path):
    def listed(first, last):
        table = episodes(first, last)
        if first == 2 * STEPS:
            table["return_"] = table["return_"] + 1
        if first == 3 * STEPS:
            table["length"] = table["length"] - 1
        return table

    record(tmp_path, listed=listed)
    assert check(tmp_path).faults == [
        "Episode 4 has another length than its first and last step say (1 more like this).",
        "Episode 3 lists a return of 14, and its rewards sum to 13.",
    ]


def test_damage_and_what_is_cut_are_found_and_the_rest_is_checked(path):
    damage(path, "/rollout", 2)
    damage(path, "/starts", 0)
    done = check(path)
    assert done.batches == 3
    starts, steps = done.faults
    assert "is damaged at byte" in starts
    assert "is damaged at byte" in steps
    path.write_bytes(path.read_bytes()[:-30])
    assert "is not complete" in check(path).faults[0]


def test_files_beside_one_that_cannot_be_read_are_checked(tmp_path):
    whole = rollout()
    whole[keys.TERMINATED][12, 1] = False
    record(tmp_path, whole, batches=range(2))
    bad = tmp_path / "rollouts_00001.mcap"
    bad.write_text("not a recording at all")
    done = check(tmp_path)
    assert (done.files, done.batches, done.env_steps, done.episodes) == (2, 2, 60, 3)
    unread, unflagged = done.faults
    assert unread == f"{bad} is not an MCAP file; give a recording made by RESC."
    assert unflagged.startswith(f"{tmp_path / 'rollouts_00000.mcap'}: in step 12 of environment 1")


def test_files_that_do_not_fit_together_are_checked_one_by_one(tmp_path):
    def listed(first, last):
        table = episodes(first, last)
        table["return_"] = table["return_"] + (first == 0)
        return table

    first = record(tmp_path / "a", batches=range(2), listed=listed) / "rollouts_00000.mcap"
    second = record(tmp_path / "b", batches=range(2)) / "rollouts_00000.mcap"
    (tmp_path / "rollouts_00000.mcap").write_bytes(first.read_bytes())
    (tmp_path / "rollouts_00001.mcap").write_bytes(first.read_bytes())
    (tmp_path / "rollouts_00002.mcap").write_bytes(second.read_bytes())
    done = check(tmp_path)
    assert (done.files, done.batches) == (3, 6)
    one, other, together = done.faults
    for number, fault in enumerate((one, other)):
        assert fault.startswith(f"{tmp_path / f'rollouts_0000{number}.mcap'}: Episode 0 lists")
    assert "hold the same steps" in together
