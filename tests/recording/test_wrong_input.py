"""Whatever a command is given: an answer or a sentence, never a traceback."""

import os
import random

import pytest
from small_run import record
from test_damage import DAMAGE

from resc.errors import RecordingError
from resc.log_command import main
from resc.recording.location import recordings_at

LOOKING = (("info",), ("episodes", "--where", "length > 3"), ("check",))
WRITING = (("recover",), ("merge",), ("parquet",))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording, and much that is none."""
    folder = tmp_path_factory.mktemp("wrong")
    record(folder / "run")
    data = (folder / "run" / "rollouts_00000.mcap").read_bytes()
    noise = random.Random(0).randbytes(3000)
    for name, content in {
        "text": b"hello", "empty": b"", "zeros": bytes(900), "magic": data[:8], "noise": noise,
        "magic_and_noise": data[:8] + noise, "ends": data[:8] + data[-8:],
        "header": data[:29] + data[-8:],
    }.items():  # fmt: skip
        (folder / f"{name}.mcap").write_bytes(content)
    (folder / "folder.mcap").mkdir()
    (folder / "loop").symlink_to("loop")
    (folder / "dangling.mcap").symlink_to("nowhere")
    os.mkfifo(folder / "pipe")
    return folder


@pytest.fixture
def answer(capsys, monkeypatch, folder):
    """Calls a command in the folder: its exit code, and the sentence that it ends with."""
    monkeypatch.chdir(folder)

    def answered(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        capsys.readouterr()
        code = ended.value.code
        if isinstance(code, str):
            assert code.startswith("error: ")
            assert "\n" not in code
            assert len(code) > 20
            return 1, code
        return code or 0, ""

    return answered


PLACES = [
    "text.mcap", "empty.mcap", "zeros.mcap", "magic.mcap", "noise.mcap", "magic_and_noise.mcap",
    "ends.mcap", "header.mcap", "folder.mcap", "loop", "dangling.mcap", "pipe", "", "[", "/",
    "/dev/null", "/dev/zero", "nope*", "a" * 300, "run/rollouts_00000.mcap/x", "nowhere/#/..",
]  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_a_place_without_a_recording_is_answered_in_a_sentence(place, answer):
    for command, *rest in (*LOOKING, *WRITING, ("schema",), ("plot", "--episode", "0")):
        code, sentence = answer(command, place, *rest)
        assert code == 1
        assert sentence or command == "check"


def test_damaged_files_are_read_or_answered_in_a_sentence(folder, answer):
    data = (folder / "run" / "rollouts_00000.mcap").read_bytes()
    codes = []
    for seed in range(18):
        rng = random.Random(seed)
        (folder / "damaged.mcap").write_bytes(DAMAGE[seed % len(DAMAGE)](data, rng))
        for command, *rest in LOOKING:
            codes.append(answer(command, "damaged.mcap", *rest)[0])
        for command, *rest in WRITING:
            codes.append(answer(command, "damaged.mcap", *rest, "--out", "out", "--force")[0])
    assert {0, 1, 3} == set(codes)


CONDITIONS = [
    "", "'", "length", "1=1", "length > 3;", "select 1", "outcome", "outcome = NULL",
    "outcome is null", "length > 1e400", "length/0 > 1", "sum(length) > 3", "length in ()",
    "length > (select 1)", "nonsense(length)", "count(*) > 1", "length > 'a'", "-- x", "*",
    "length > 99999999999999999999999999", "row_number() over () > 1", "length[0]",
    "explode(length)", "outcome in (1, 2)", "x'ab' = 1", "length > interval '1 day'",
    "cast(outcome as int) > 1", "length between 3", "((((1", "length > 3\0", "index = -1",
]  # fmt: skip


@pytest.mark.parametrize("condition", CONDITIONS)
def test_any_condition_is_applied_or_answered_in_a_sentence(condition, answer):
    answer("episodes", "run", "--where", condition)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("episodes", "run", "--limit", "9" * 30), 0),
        (("episodes", "run", "--limit", "1e3"), 2),
        (("episodes", "run", "--sort", ""), 1),
        (("episodes", "run", "--out", ""), 1),
        (("episodes", "run", "--out", "/proc/x.csv"), 1),
        (("episodes", "run", "--out", "a" * 300), 1),
        (("plot", "run", "--episode", "9" * 40), 1),
        (("plot", "run", "--episode", "-1"), 1),
        (("plot", "run", "--episode", "9" * 5000), 2),
        (("plot", "run", "--episode", "1.5"), 2),
        (("parquet", "run", "--out", "folder.mcap", "--force"), 1),
        (("parquet", "run", "--out", "/proc/nope/x"), 1),
        (("merge", "run", "text.mcap", "--out", "m"), 1),
        (("merge", "run", "--out", ".", "--force"), 1),
        (("merge", "run", "--out", "loop"), 1),
        (("merge", "run", "--out", "/proc/x.mcap"), 1),
        (("recover", "run", "--force"), 0),
        (("recover", "/"), 1),
        (("recover", "run/rollouts_00000.mcap", "--out", "/proc/x.mcap"), 1),
        (("info", "run", "extra"), 2),
        (("bogus",), 2),
        ((), 2),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, tuple) else None,
)
def test_wrong_arguments_and_outputs_are_answered(arguments, code, answer):
    assert answer(*arguments)[0] == code


def test_the_folder_of_a_sweep_is_named_as_one_with_a_run_to_give(tmp_path):
    (tmp_path / "origin.json").write_text("{}")
    with pytest.raises(RecordingError, match="sweep, none of whose runs holds a recording yet"):
        recordings_at(tmp_path)
    for name in ("10", "2"):
        record(tmp_path / name / "rollouts")
    with pytest.raises(RecordingError) as caught:
        recordings_at(tmp_path)
    assert str(caught.value) == (
        f"{tmp_path} is the folder of a sweep, of which 2 runs hold recordings; give one of them, "
        f"such as {tmp_path / '2'}."
    )
