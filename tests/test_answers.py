"""What a command answers where something is wrong."""

import errno

import pytest
import torch
from hydra.errors import HydraException

from resc.errors import ExitCode
from resc.starting.answers import answering, refused


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
    assert f"{__file__}, line {compute.__code__.co_firstlineno + 1} (compute)" in said
    assert "torch.where" in said


def test_other_errors_are_left_alone():
    with pytest.raises(ZeroDivisionError), answering():
        raise ZeroDivisionError


@pytest.mark.parametrize(
    ("text", "config", "said"),
    [
        (
            "Could not delete from config. 'reward.progres' does not exist.",
            "train",
            "reward.progres is not a setting: reward has no 'progres'. Did you mean 'progress'?",
        ),
        (
            "Could not override 'obstacle_observation'.",
            "evaluate",
            "obstacle_observation is not a setting of evaluate: a policy keeps what it was trained",
        ),
    ],
)
def test_names_that_are_not_there_are_explained(text, config, said):
    assert str(refused(HydraException(text), config, [])).startswith(said)
