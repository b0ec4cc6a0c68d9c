"""Whatever hangs comes to an end: tests with all that they started, and every wait on a program."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from source_trees import parsed

from benchmarks.measure import Job

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path
    for place in ("benchmarks", "examples", "hydra_plugins", "resc", "tests")
    for path in (ROOT / place).rglob("*.py")
)
RUN = ("run", "call", "check_call", "check_output")
"""Of `subprocess`: what starts a program and waits for it."""
HANGING = """
import subprocess
import pytest

@pytest.mark.timeout(1)
def test_that_hangs():
    subprocess.run(["sh", "-c", "echo $$ > number; exec sleep 1234"], timeout=100)

def test_that_comes_after():
    pass
"""


def waits_for_ever(path):
    """Where a file runs another program without saying how long it may take."""
    for node in ast.walk(parsed(path)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        runs = isinstance(node.func.value, ast.Name) and node.func.value.id == "subprocess"
        if (
            node.func.attr == "communicate" or (runs and node.func.attr in RUN)
        ) and "timeout" not in [keyword.arg for keyword in node.keywords]:
            yield f"{path.relative_to(ROOT)}:{node.lineno}"


def test_every_wait_for_another_program_has_an_end():
    assert [place for path in FILES for place in waits_for_ever(path)] == []


@pytest.mark.slow
def test_a_hanging_test_fails_and_leaves_no_child(tmp_path):
    (tmp_path / "test_hanging.py").write_text(HANGING)
    command = [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "-n", "1"]
    command += ["--rootdir", tmp_path, "-p", "no:cacheprovider", tmp_path]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert "1 failed, 1 passed" in done.stdout
    assert "Timeout (>1.0s) from pytest-timeout" in done.stdout
    assert not Path("/proc", (tmp_path / "number").read_text().strip()).exists()


def test_a_benchmark_does_not_take_half_a_number_of_a_job_that_died(tmp_path):
    (tmp_path / "job.py").write_text("import os; input(); os.write(1, b'12')")
    job = Job(str(tmp_path / "job.py"), [])
    job.start_block("fly")
    with pytest.raises(SystemExit, match="A job ended early"):
        job.rate()
    job.close()
