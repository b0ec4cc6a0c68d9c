"""What is said of the process itself."""

import signal
import subprocess
import sys

import numba
import pytest

from resc.process import say_compiling, tell_of_compiling


@pytest.fixture
def kernel():
    """A kernel as one of ours, compiled for no type yet."""

    def doubled(x):
        return 2 * x

    doubled.__module__ = "resc.maps.made_up"
    return numba.njit(doubled)


def test_compiling_is_told_once_and_what_is_compiled_is_used_in_silence(kernel, capsys):
    say_compiling.cache_clear()
    tell_of_compiling()
    tell_of_compiling()
    assert kernel(2) == 4
    assert capsys.readouterr().out == "Compiling kernels once: up to two minutes.\n"
    assert kernel(3) == 6
    assert kernel(0.5) == 1.0
    assert capsys.readouterr().out == ""


def test_what_others_compile_is_none_of_ours(capsys):
    say_compiling.cache_clear()
    tell_of_compiling()
    assert numba.njit(lambda x: x + 1)(1) == 2
    assert capsys.readouterr().out == ""


def test_an_interruption_while_a_script_imports_is_one_word():
    said = "import resc.early; raise KeyboardInterrupt"
    ended = subprocess.run(
        [sys.executable, "-c", said], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, "Stopped.\n")
