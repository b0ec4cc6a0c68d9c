"""docs/add-a-part.md, followed word by word: its files, its command."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "add-a-part.md").read_text()
BLOCKS = re.findall(r"^(?:`(\S+)`\n\n)?```(\w*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
FILES = {name: text for name, _, text in BLOCKS if name}
(COMMAND,) = (shlex.split(text) for _, language, text in BLOCKS if language == "bash")
EMPTY = ("mypackage/__init__.py", "mypackage/conf/__init__.py")


def evaluate(folder, *arguments):
    for name, text in {**FILES, **dict.fromkeys(EMPTY, "")}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    environment = {
        "PYTHONPATH": f"{folder}:{ROOT}",
        "PATH": "/usr/bin:/bin",
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, ROOT / "evaluate.py", *arguments, f"hydra.run.dir={folder / 'run'}"]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=200
    )


def test_the_command_of_the_page_compares_the_new_pilot(tmp_path):
    assert COMMAND[:3] == ["PYTHONPATH=.", "python", "evaluate.py"]
    small = (
        "scenes=paper4_map15",
        "flights=1",
        "recorder=none",
        "termination.time_limit.limit_s=6.0",
    )
    done = evaluate(tmp_path, *COMMAND[3:], *small)
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["pilots"]["climb"]["pilot"] == {"height_m": "1.5"}
    assert summary["pilots"]["climb"]["success_rate"] == 0.0
    assert summary["pilots"]["policy"]["success_rate"] == 1.0


@pytest.mark.slow
def test_without_the_permission_it_is_one_sentence(tmp_path):
    done = evaluate(tmp_path, *(text for text in COMMAND[3:] if "allowed" not in text))
    assert done.returncode == 1
    assert done.stderr.startswith(
        "error: pilot.climb._target_ is 'mypackage.climb.Climb', outside "
    )
