"""Every command that is printed can be pasted: the shell and Hydra read back what was meant."""

import ast
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from source_trees import parsed

from resc.command_line import command, override
from resc.errors import ConfigError, SweepError
from resc.flying.held_out import read_episodes
from resc.starting.arguments import quoted_paths, resumed_sweep
from resc.starting.origin import claim
from resc.studies.ablation import write_report
from resc.sweeps.jobs import Job, Outcome
from resc.sweeps.sweep import require_success

ROOT = Path(__file__).parents[1]
COMMAND = re.compile(r"python \S+\.py |\b(resume|policy|replay|run\.dir|sweep\.dir)=$")
NASTY = "lr=0.1, \"b\" {c}[d] #e 'f' \\ ü"
MEANT = list("\\\"'${}=, #[]():;&|*?!<>~`+-@%./\n\tab1é")
"""Characters that mean something to Hydra, to OmegaConf or to a shell, and some that do not."""


def begin(folder, *arguments):
    """Writes down that a sweep was begun with these arguments."""
    command = shlex.join(["python", "train.py", *arguments])
    (folder / "origin.json").write_text(json.dumps({"command": command}))


def read(argument):
    """Key and value as a script gets them."""
    parsed = OverridesParser.create().parse_override(argument)
    config = OmegaConf.create({})
    OmegaConf.update(config, parsed.key_or_group, parsed.value())
    return parsed.key_or_group, OmegaConf.select(config, parsed.key_or_group)


def resumed(line):
    """The folder with which a printed line goes on."""
    program, script, argument = shlex.split(line)
    assert (program, script) == ("python", "train.py")
    key, value = read(argument)
    assert key == "resume"
    return Path(value)


@given(st.text(st.sampled_from(MEANT) | st.characters(codec="utf-8", exclude_characters="\0")))
def test_every_text_is_read_back_by_the_shell_and_hydra(text):
    *head, argument = shlex.split(command("train.py", {"resume": text}))
    assert head == ["python", "train.py"]
    assert read(argument) == ("resume", text)


@pytest.mark.parametrize("text", ["null", "1_000", "1e3", "007", "true", "nan", " a ", "", "'a'"])
def test_texts_that_look_like_something_else_stay_texts(text):
    assert read(override("name", text)) == ("name", text)


def test_numbers_and_truth_values_are_read_back_as_such():
    values = {"a": 3, "b": -1.5e-7, "c": True, "d": None, "e": ["mine.", "a, b"]}
    assert dict(read(override(*item)) for item in values.items()) == values


def test_a_plain_path_is_not_quoted():
    assert (
        command("train.py", {"resume": Path("runs/a_b/1")}) == "python train.py resume=runs/a_b/1"
    )


@pytest.mark.parametrize("key", ["resume", "policy", "replay"])
@pytest.mark.parametrize(
    "text", ["runs/x#7", "runs/lr=0.1, b", "12", "1e3", "[a]", 'say "so"', "it's", "a b", "x,y"]
)
def test_paths_are_understood_bare_and_quoted(key, text):
    bare, quoted = quoted_paths([f"{key}={text}", override(key, text)])
    assert read(bare) == (key, text)
    assert read(quoted) == (key, text)


def test_what_is_no_bare_path_is_left_to_hydra():
    arguments = ["resume=null", "resume='a#b'", "name=a#b", "policy=${oc.env:HOME}"]
    assert quoted_paths(arguments) == arguments
    swept = ["-m", "policy=runs/a,runs/b"]
    assert quoted_paths(swept) == swept


@pytest.fixture
def folder(tmp_path):
    """A folder of a nasty name."""
    found = tmp_path / NASTY
    found.mkdir()
    return found


def test_sweep_of_a_nasty_name_is_resumed_by_the_command_it_prints(folder):
    outcome = Outcome(Job(folder / "0", ()), "stopped", "not begun")
    with pytest.raises(SweepError) as raised:
        require_success([outcome], folder)
    line = str(raised.value).partition("Go on with: ")[2]
    assert resumed(line) == folder
    begin(folder, "-m", "seed=0,1")
    *rest, into = resumed_sweep(quoted_paths(shlex.split(line)[2:]))
    assert rest == ["-m", "seed=0,1"]
    assert read(into) == ("hydra.sweep.dir", str(folder))


def test_job_of_a_nasty_name_is_started_in_its_folder(folder):
    for name in ("checkpoint.pt", "config.yaml"):
        (folder / name).touch()
    *_, resume, into = Job(folder, ("seed=0",)).command
    assert read(into) == ("hydra.run.dir", str(folder))
    assert read(resume) == ("resume", str(folder))


def test_command_of_a_sweep_is_noted_as_it_was_typed(folder, monkeypatch):
    typed = ["-m", 'name="lr=0.1, b"', "seed=0,1"]
    monkeypatch.setattr(sys, "argv", ["train.py", *typed])
    claim(folder)
    noted = json.loads((folder / "origin.json").read_text())["command"]
    assert shlex.split(noted) == ["python", "train.py", *typed]


def test_repairs_of_damaged_files_are_commands_that_work(folder):
    run = folder / "0"
    run.mkdir()
    begin(folder, "-m", "seed=0,1")
    (run / "job.json").write_text("{}")
    with pytest.raises(ConfigError) as raised:
        write_report(folder)
    assert resumed(str(raised.value).partition("go on with: ")[2]) == folder
    (run / "job.json").write_text('{"overrides": []}')
    (run / "evaluation.csv").write_text("cut")
    with pytest.raises(ConfigError) as raised:
        read_episodes(run / "evaluation.csv", 8)
    assert resumed(str(raised.value).partition("goes on with: ")[2]) == folder
    with pytest.raises(ConfigError) as raised:
        write_report(folder)
    assert resumed(str(raised.value).partition("go on with: ")[2]) == folder
    (run / "summary.json").write_text("{")
    with pytest.raises(ConfigError) as raised:
        write_report(folder)
    assert resumed(str(raised.value).partition("go on with: ")[2]) == folder


def test_no_command_is_put_together_but_by_the_function_that_quotes():
    scripts = [ROOT / "train.py", ROOT / "evaluate.py"]
    for path in [*scripts, *ROOT.glob("resc/**/*.py"), *ROOT.glob("hydra_plugins/*.py")]:
        for node in ast.walk(parsed(path)):
            parts = node.values if isinstance(node, ast.JoinedStr) else []
            texts = [part.value for part in parts if isinstance(part, ast.Constant)]
            assert not any(map(COMMAND.search, texts)), f"{path}:{node.lineno}"
