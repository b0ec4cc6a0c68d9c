import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("compiled_flight.py")
ROOT = Path(__file__).parents[2]


def run(*what):
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, SCRIPT, *what],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.slow  # 15 s of tracing
def test_the_step_is_one_graph_and_another_difficulty_needs_no_other():
    run("graph", "difficulty")


@pytest.mark.slow  # some 45 s for the compiler, once; 15 s from its cache
def test_the_compiled_environment_agrees_with_the_uncompiled_one_and_with_its_specs():
    run("compare")


@pytest.mark.slow  # the runs of PX4's loop are one loop of the compiled program
def test_the_compiled_loop_of_px4_agrees_with_the_uncompiled_one():
    run("compare", "rate_loop=px4", "vehicle=iris_px4", "dynamics=gazebo")


@pytest.mark.slow
def test_a_compiled_vehicle_with_everything_drawn_agrees_with_the_uncompiled_one():
    run("compare", "randomization=wild", "rate_loop=px4", "dynamics=in_wind")
    run("compare", "randomization=[battery,mass]", "rate_loop=px4", "dynamics=on_battery")


@pytest.mark.slow  # 1.5 minutes each for the compiler
@pytest.mark.parametrize("estimator", ["kf_imu", "ekf"])
def test_a_compiled_estimator_agrees_with_the_uncompiled_one(estimator):
    run("compare", f"estimator={estimator}")
