"""What a command answers where something is wrong."""

import errno

import pytest
import torch

from resc.errors import ExitCode
from resc.starting.answers import answering


def answer(error: BaseException, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ending, answering():
        raise error
    assert ending.value.code == ExitCode.ERROR
    return capsys.readouterr().err


def test_a_full_disk_is_told_without_a_file(capsys):
    said = answer(OSError(errno.ENOSPC, "No space left on device"), capsys)
    assert said == "error: The disk is full; make room, then run the command again.\n"


def test_a_part_that_cannot_be_compiled_is_told_with_its_line(capsys):
    def compute(position: torch.Tensor) -> torch.Tensor:
        return position if float(position.sum()) > 0 else -position

    with pytest.raises(Exception, match="data-dependent") as caught:
        torch.compile(compute, fullgraph=True)(torch.ones(3))
    said = answer(caught.value, capsys)
    assert said.count("\n") == 1
    assert f"{__file__}, line 26 (compute)" in said
    assert "torch.where" in said


def test_other_errors_are_left_alone():
    with pytest.raises(ZeroDivisionError), answering():
        raise ZeroDivisionError
