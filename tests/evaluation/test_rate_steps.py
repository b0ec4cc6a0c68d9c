"""Our loop and the plant against every step recorded from PX4's firmware; nothing is fitted."""

from pathlib import Path

import numpy as np
import pytest

from resc.errors import ConfigError
from resc.evaluation.rate_steps import table
from resc.flight_logs.rate_steps import compare, read_steps
from resc.viewing.rate_steps_picture import draw_steps

FILE = Path(__file__).parents[1] / "data" / "px4_rate_steps.npz"
KINDS = {"roll_1": 0.03, "roll_3": 0.03, "roll_5": 0.03, "pitch_1": 0.03, "yaw_0.5": 0.02}


@pytest.fixture(scope="module")
def steps():
    return compare(read_steps(FILE), "iris_sih", "px4", "sih")


@pytest.mark.parametrize(("kind", "most"), KINDS.items())
def test_the_model_follows_the_recorded_steps(steps, kind, most):
    found = [step for step in steps if step.kind == kind]
    assert len(found) == 3
    assert np.mean([step.error for step in found]) <= most
    assert max(step.error for step in found) <= 0.05
    assert abs(np.mean([step.later_s for step in found])) <= 0.01


def test_all_five_kinds_are_in_the_table(steps):
    assert [row.split("|")[1].strip() for row in table(steps).splitlines()[2:]] == [*KINDS]


@pytest.mark.parametrize(
    ("loop", "dynamics", "kind"), [("px4_paper", "sih", "yaw_0.5"), ("px4", "rigid_body", "roll_1")]
)
def test_another_firmware_or_instant_rotors_do_not_follow(loop, dynamics, kind):
    recorded = {name: array for name, array in read_steps(FILE).items() if name == f"{kind}/0"}
    assert compare(recorded, "iris_sih", loop, dynamics)[0].error > 0.05


def test_the_picture_is_drawn(steps, tmp_path):
    draw_steps(steps, tmp_path / "steps.png")
    assert (tmp_path / "steps.png").stat().st_size > 10_000


def test_a_file_of_something_else_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot be read .*give a file of steps"):
        read_steps(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ConfigError, match=r"cannot be read"):
        read_steps(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", flights=np.zeros(3))
    with pytest.raises(ConfigError, match="holds 'flights'; expected names such as roll_1/0"):
        read_steps(tmp_path / "other.npz")
    np.savez(tmp_path / "narrow.npz", **{"roll_1/0": np.zeros((5, 3))})
    with pytest.raises(ConfigError, match=r"roll_1/0 is \[5, 3\]; expected rows of 12"):
        read_steps(tmp_path / "narrow.npz")


def test_a_part_that_is_not_there_is_named():
    with pytest.raises(ConfigError, match=r"vehicle has no 'iris_shi'.*iris_sih"):
        compare(read_steps(FILE), "iris_shi", "px4", "sih")
