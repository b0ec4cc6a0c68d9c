"""README and docs show what is there: the table of parts is conf/, the example is a reward."""

import re
from itertools import permutations
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from resc.run_folder import link_latest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PARTS = (ROOT / "docs" / "parts.md").read_text()
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *ROOT.glob("*.py")]
LEFT = {
    "train": ("report.html", "rollouts", "held_out", "policy.pt"),
    "sweep": ("report.html", "multirun.yaml"),
    "evaluation": ("report.html", "rollouts", "scenes"),
    "replay": ("replay.md",),
}
"""What a run of each kind leaves."""
NO_PARTS = {"env", "experiment", "hydra"}


def test_table_of_parts_lists_every_file_of_conf():
    rows = re.findall(r"^\| `(\w+)`(?: \*)? \|[^|]*\|([^|]*)\|$", PARTS, re.MULTILINE)
    listed = {group: set(re.findall(r"`(\w+)`", choices)) for group, choices in rows}
    folders = {path for path in (ROOT / "conf").iterdir() if path.is_dir()}
    there = {folder.name: {path.stem for path in folder.glob("*.yaml")} for folder in folders}
    assert listed == {group: files for group, files in there.items() if group not in NO_PARTS}


def test_example_reward_falls_with_the_difference_in_height():
    namespace = {}
    exec(re.search(r"```python\n(.*?)```", README, re.DOTALL).group(1), namespace)
    position = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    target = torch.tensor([[5.0, 5.0, 1.0], [5.0, 5.0, 1.0]])
    assert_close(
        namespace["Height"](weight=1.0).compute(position, target), torch.tensor([[0.0], [-2.0]])
    )


def test_example_of_use_from_python_runs_as_it_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    example = next(block for block in blocks if "resc.make_env" in block)
    assert len([line for line in example.splitlines() if line]) <= 5
    namespace = {}
    exec(example, namespace)
    assert namespace["flown"].batch_size == (64, 100)
    assert namespace["flown"]["next", "terminated"].any()


@pytest.mark.parametrize("order", [*permutations(LEFT)], ids="-".join)
def test_paths_of_shown_commands_are_there_whatever_was_run_in_between(order, tmp_path):
    for kind in order:
        folder = tmp_path / "runs" / "2025-11-22" / kind
        for name in LEFT[kind]:
            (folder / name).mkdir(parents=True)
        link_latest(folder, kind)
    shown = {path for page in PAGES for path in re.findall(r"runs/latest[\w/.]*", page.read_text())}
    assert {"runs/latest_train", "runs/latest_evaluation/scenes"} < shown
    for path in shown - {"runs/latest"}:
        assert (tmp_path / path.rstrip(".")).exists(), path


def test_no_shown_command_depends_on_what_was_run_last():
    """`runs/latest` alone may be an evaluation, a training or a sweep."""
    for page in PAGES:
        commands = re.findall(r"^.*(?:python |resc-log ).*$", page.read_text(), re.MULTILINE)
        bare = [line for line in commands if re.search(r"runs/latest(?![_\w])", line)]
        assert not bare, page.name
