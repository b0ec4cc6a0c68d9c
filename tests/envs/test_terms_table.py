"""The table of active terms that a run prints."""

import pytest

from resc.envs.terms_table import describe

ROWS = (
    "-1 if neither of the next two control points is in view (2025 paper, eq. 6)",
    "-|omega| [rad/s] (2025 paper, eq. 6: k_s)",
    "exceed their limits (both papers: eq. 8)",
    "ideal rotor power over that of hovering; -1 in hover",
)


@pytest.fixture(scope="module")
def table(make_stages):
    return describe(
        make_stages(
            "reward=[progress,time,crash,collision,dynamics_limits,field_of_view,body_rate,finish,"
            "arrival,jerk,action_rate,energy,clearance_margin,look_along_velocity]",
            "randomization=[mass,inertia,thrust_map,torque_coefficient,action_delay]",
        )
    )


@pytest.mark.parametrize("row", ROWS)
def test_a_row_holds_the_whole_first_sentence_abbreviations_included(table, row):
    assert any(line.endswith(f" {row}") for line in table.splitlines())


def test_no_row_ends_in_the_middle_of_a_bracket(table):
    for line in table.splitlines():
        assert line.count("(") == line.count(")") or "(-pi, pi]" in line or "[0, 1)" in line, line
