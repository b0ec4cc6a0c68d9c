import itertools
import math

import pytest
import torch
from torch.testing import assert_close

from resc.errors import ConfigError
from resc.math.rotation import quaternion_from_euler
from resc.simulation.vehicle import Vehicle
from resc.term import Context
from resc.terms.rewards.action_rate import ActionRate
from resc.terms.rewards.active_yaw import LookAlongVelocity, LookAtControlPoint
from resc.terms.rewards.arrival import Arrival
from resc.terms.rewards.body_rate import BodyRateNorm
from resc.terms.rewards.clearance_margin import ClearanceMargin
from resc.terms.rewards.collision import Collision
from resc.terms.rewards.crash import Crash
from resc.terms.rewards.dynamics_limits import DynamicsLimits
from resc.terms.rewards.energy import Energy
from resc.terms.rewards.field_of_view import FieldOfView
from resc.terms.rewards.finish import Finish
from resc.terms.rewards.jerk import Jerk
from resc.terms.rewards.progress import Progress
from resc.terms.rewards.route_progress import RouteProgress
from resc.terms.rewards.time import Time

LONGEST = 3.0 * 0.02
"""The longest step [m]: top speed times the control period."""


def row(*values):
    return torch.tensor([values], dtype=torch.float32)


def flags(*values):
    return torch.tensor(values).unsqueeze(-1)


def progress(previous, position, target, **options):
    term = Progress(weight=1.0, **options)
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    return float(term.compute(row(*position), row(*previous), row(*target)))


def test_full_speed_toward_the_control_point_earns_one():
    assert progress((0.0, 0.0, 1.0), (LONGEST, 0.0, 1.0), (2.0, 0.0, 1.0)) == pytest.approx(
        1.0, abs=1e-4
    )


def test_full_speed_away_from_it_costs_one():
    assert progress((0.0, 0.0, 1.0), (-LONGEST, 0.0, 1.0), (2.0, 0.0, 1.0)) == pytest.approx(
        -1.0, abs=1e-4
    )


@pytest.mark.parametrize(
    "place", [(0.0, 0.0, 1.0), (2.0, 0.1, 1.0), (2.0, 0.0, 0.4), (2.0, 0.0, 1.9), (2.5, 0.0, 1.2)]
)
@pytest.mark.parametrize("radius", [0.5, None])
def test_hovering_forever_earns_no_progress(place, radius):
    assert progress(place, place, (2.0, 0.0, 1.0), column_radius_m=radius) == 0.0


def test_a_ray_into_the_column_counts_in_full_although_it_misses_the_point():
    start, target = (0.0, 0.4, 1.0), (2.0, 0.0, 1.0)
    end = (LONGEST, 0.4, 1.0)
    assert progress(start, end, target) == pytest.approx(1.0, abs=1e-4)
    closed = math.dist(start, target) - math.dist(end, target)
    assert progress(start, end, target, column_radius_m=None) == pytest.approx(
        closed / LONGEST, abs=1e-4
    )
    assert closed / LONGEST < 0.99


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((0.0, 0.6, 1.0), (0.06, 0.6, 1.0)),  # passes beside the column
        ((0.0, 0.4, 1.3), (0.06, 0.4, 1.3)),  # passes above it
        ((0.0, 0.4, 1.0), (-0.06, 0.4, 1.0)),  # flies away from it
        ((1.9, 0.2, 1.1), (1.96, 0.2, 1.1)),  # is inside already
        ((0.0, 0.1, 1.0), (0.05, 0.1, 1.04)),  # enters the cylinder above the band
    ],
)
def test_a_ray_that_does_not_enter_the_column_aims_at_the_point(start, end):
    target = (2.0, 0.0, 1.0)
    closed = math.dist(start, target) - math.dist(end, target)
    assert progress(start, end, target) == pytest.approx(closed / LONGEST, abs=1e-4)


@pytest.mark.parametrize(("height", "drop"), [(1.6, -0.06), (0.5, 0.06)])
def test_a_ray_through_the_top_or_the_bottom_enters_the_column(height, drop):
    start, end = (2.2, 0.0, height), (2.2, 0.0, height + drop)
    assert progress(start, end, (2.0, 0.0, 1.0)) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("run", [0.5, 0.9])  # with 0.9 it leaves through the side, above the bottom
def test_a_slanted_ray_through_the_top_enters_the_column(run):
    start = (1.4, 0.0, 1.6)
    step = LONGEST / math.hypot(run, 0.4)  # meets the top, 0.2 m above the point, at x = 1.4 + run
    end = (1.4 + run * step, 0.0, 1.6 - 0.4 * step)
    assert progress(start, end, (2.0, 0.0, 1.0)) == pytest.approx(1.0, abs=1e-4)


def fly_route(places, route, length):
    """Sum of the progress along a route padded with its last point, passed within half a metre."""
    term = RouteProgress(weight=1.0)
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    route, length = row(*route), torch.tensor([[length]])
    index, total = torch.tensor([[0]]), 0.0
    for before, place in itertools.pairwise(places):
        before, place, passed = row(*before), row(*place), index
        if index < length and (place - route[:, index[0, 0]]).norm() <= 0.5:
            index = index + 1
        total += float(term.compute(place, before, route, length, index, passed))
    return total * LONGEST, int(index)


ROUTE = ((2.0, 0.0, 1.0), (2.0, 2.0, 1.0), (4.0, 2.0, 1.0), (4.0, 2.0, 1.0))


@pytest.mark.parametrize("corners", [[(2.0, 0.0), (2.0, 2.0)], [(1.6, 0.3), (2.4, 1.8)]])
def test_progress_along_the_route_is_its_length_however_it_is_flown(corners):
    stops = [(0.0, 0.0), *corners, (3.6, 2.0)]
    places = [
        (a[0] + (b[0] - a[0]) * n / 40, a[1] + (b[1] - a[1]) * n / 40, 1.0)
        for a, b in itertools.pairwise(stops)
        for n in range(40)
    ]
    total, passed = fly_route([*places, (3.6, 2.0, 1.0)], ROUTE, 3)
    assert passed == 3
    assert total == pytest.approx(6.0 - 0.4, abs=1e-4)  # the end is 0.4 m before the last point


def test_hovering_at_a_point_that_is_passed_earns_nothing_more():
    total, passed = fly_route([(1.7, 0.0, 1.0)] * 5, ROUTE, 3)
    assert passed == 1
    detour = 0.3 + 2.0 - math.dist((1.7, 0.0), (2.0, 2.0))  # the corner that is now cut
    assert total == pytest.approx(detour, abs=1e-5)


def test_progress_telescopes_so_loops_earn_nothing():
    angle = torch.linspace(0, 2 * math.pi, 61)
    loop = [(float(a.cos()), float(a.sin()), 1.0 + 0.1 * float((2 * a).sin())) for a in angle]
    total = sum(
        progress(a, b, (3.0, 0.5, 1.0), column_radius_m=None) for a, b in itertools.pairwise(loop)
    )
    assert total == pytest.approx(0.0, abs=1e-3)


def test_progress_sums_to_the_distance_closed():
    path = [(0.02 * i, 0.3 * math.sin(0.1 * i), 1.0) for i in range(50)]
    target = (3.0, 0.5, 1.0)
    total = sum(progress(a, b, target, column_radius_m=None) for a, b in itertools.pairwise(path))
    closed = math.dist(path[0], target) - math.dist(path[-1], target)
    assert total * LONGEST == pytest.approx(closed, abs=1e-5)


def test_progress_needs_a_speed_above_zero():
    with pytest.raises(ConfigError, match="speed_mps is 0"):
        Progress(weight=1.0, speed_mps=0.0)


def test_every_step_costs_one_time():
    assert_close(Time(weight=3.0).compute(torch.rand(3, 3)), -torch.ones(3, 1))


def test_only_an_end_that_is_no_finish_is_a_crash():
    terminated, finished = flags(True, True, False, False), flags(False, True, False, True)
    assert Crash(weight=350.0).compute(terminated, finished)[:, 0].tolist() == [-1, 0, 0, 0]


def test_only_the_last_passing_finishes():
    passed, finished = flags(True, True, False, False), flags(False, True, False, True)
    assert Finish(weight=20.0).compute(passed, finished, torch.rand(4, 3))[:, 0].tolist() == [
        0,
        1,
        0,
        0,
    ]


def test_every_passing_is_an_arrival():
    assert Arrival(weight=10.0).compute(flags(True, False), torch.rand(2, 3))[:, 0].tolist() == [
        1,
        0,
    ]


def test_every_broken_limit_costs_one_and_tilt_counts_once_or_by_axis():
    violations = torch.tensor([[0.0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0, 1, 1, 1]])
    once, apart = (
        DynamicsLimits(weight=5.0, roll_and_pitch_apart=apart).compute(violations)[:, 0].tolist()
        for apart in (False, True)
    )
    assert once == [0, -1, -1, -2]
    assert apart == [0, -1, -1, -3]


def test_the_norm_of_the_body_rate_is_a_cost():
    assert_close(BodyRateNorm(weight=0.01).compute(row(2.0, -3.0, 6.0)), row(-7.0))


def seen(first, second, yaw=0.0, pitch=0.0, **options):
    """Whether the field-of-view term sees a control point from the origin, 1 m high."""
    attitude = quaternion_from_euler(row(0.0, pitch, yaw))
    points = torch.tensor([[first, second]])
    reward = FieldOfView(weight=1.0, **options).compute(row(0.0, 0.0, 1.0), attitude, points)
    assert reward.shape == (1, 1)
    assert float(reward) in (0.0, -1.0)
    return float(reward) == 0.0


BEHIND = (-3.0, 0.0, 1.0)


def at(azimuth_deg, elevation_deg, far=3.0):
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    flat = far * math.cos(elevation)
    return (flat * math.cos(azimuth), flat * math.sin(azimuth), 1.0 + far * math.sin(elevation))


def test_one_control_point_in_sight_is_enough():
    assert seen(at(0, 0), BEHIND)
    assert seen(BEHIND, at(0, 0))
    assert not seen(BEHIND, BEHIND)


@pytest.mark.parametrize("sign", [1, -1])
def test_sight_ends_at_half_the_angles_of_the_camera(sign):
    assert seen(at(sign * 44, 0), BEHIND)
    assert not seen(at(sign * 46, 0), BEHIND)
    assert seen(at(0, sign * 29), BEHIND)
    assert not seen(at(0, sign * 30), BEHIND)


def test_the_camera_turns_and_tips_with_the_body():
    assert seen(at(90, 0), BEHIND, yaw=math.radians(80))
    assert not seen(at(0, 0), BEHIND, yaw=math.radians(80))
    assert not seen(at(0, 0), BEHIND, pitch=math.radians(35))
    assert seen(at(0, -35), BEHIND, pitch=math.radians(35))


def test_a_control_point_too_near_to_have_a_direction_counts_as_seen():
    assert seen((-0.3, 0.0, 1.0), BEHIND)
    assert not seen((-0.3, 0.0, 1.0), BEHIND, blind_m=0.2)
    assert seen((0.0, 0.0, 1.0), BEHIND)


@pytest.mark.parametrize("wrong", [{"horizontal_rad": 0.0}, {"vertical_rad": 4.0}])
def test_impossible_angles_of_view_are_refused(wrong):
    with pytest.raises(ConfigError, match="horizontal_rad"):
        FieldOfView(weight=1.0, **wrong)


def test_below_the_radius_of_a_collision_every_step_costs_one():
    clearance = torch.tensor([[0.2829], [0.3], [3.0]])
    assert Collision(weight=350.0).compute(clearance)[:, 0].tolist() == [-1, 0, 0]


def test_the_cost_of_clearance_falls_from_one_at_the_obstacle_to_none_at_the_margin():
    clearance = torch.tensor([[0.0], [0.3], [0.6], [3.0]])
    cost = ClearanceMargin(weight=1.0, margin_m=0.6).compute(clearance)
    assert_close(cost, torch.tensor([[-1.0], [-0.5], [0.0], [0.0]]))


def test_jerk_costs_its_square_times_the_period_from_the_second_step_on():
    term = Jerk(weight=1.0)
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    acceleration = torch.tensor([[0.1, 0.2, -0.2], [0.1, 0.2, -0.2]])
    cost = term.compute(acceleration, torch.zeros(2, 3), torch.tensor([[1.0], [2.0]]))
    assert_close(cost, torch.tensor([[0.0], [-(15.0**2) * 0.02]]))  # |(5, 10, -10)| m/s^3


def test_the_action_rate_compares_the_newest_actions_whatever_the_delay():
    queue = torch.tensor([[[0.5, -0.5, 1.0, 0.0], [9.0, 9.0, 9.0, 9.0]]])
    before = torch.tensor([[[0.5, 0.5, -1.0, 0.5], [7.0, 7.0, 7.0, 7.0]]])
    cost = ActionRate(weight=1.0).compute(queue, before)
    assert_close(cost, torch.tensor([[-(0.0 + 1.0 + 4.0 + 0.25)]]))


def test_rotor_power_is_one_in_hover_and_grows_with_thrust_to_the_power_of_three_halves():
    term = Energy(weight=1.0)
    vehicle = Vehicle(
        mass_kg=2.0,
        inertia_kgm2=[0.01, 0.01, 0.01],
        arm_x_m=0.1,
        arm_y_m=[0.1, 0.1],
        torque_coefficient_m=0.01,
        thrust_polynomial_n=[0.0, 10.0, 0.0],
    )
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=vehicle))
    thrust = 4.9 * torch.tensor([[1.0, 1.0, 1.0, 1.0], [4.0, 4.0, 4.0, 4.0], [4.0, 0.0, 1.0, -1.0]])
    assert_close(term.compute(thrust), torch.tensor([[-1.0], [-8.0], [-2.25]]))


def looks(yaw_deg, direction, pitch_deg=0.0):
    """Both readings of active yaw, for a velocity and for a control point in the same direction."""
    attitude = quaternion_from_euler(row(0.0, math.radians(pitch_deg), math.radians(yaw_deg)))
    along = LookAlongVelocity(weight=1.0, slow_mps=0.5).compute(attitude, row(*direction))
    position = row(1.0, 2.0, 3.0)
    points = torch.stack((position + row(*direction), row(-9.0, -9.0, 1.0)), 1)
    toward = LookAtControlPoint(weight=1.0, near_m=0.5).compute(attitude, position, points)
    assert_close(along, toward)
    return float(along)


@pytest.mark.parametrize(
    ("yaw_deg", "direction", "value"),
    [
        (0, (2.0, 0.0, 0.0), 0.0),
        (90, (2.0, 0.0, 0.0), -1.0),
        (-180, (2.0, 0.0, 0.0), -2.0),
        (60, (0.0, 2.0, -5.0), math.cos(math.pi / 6) - 1),  # heights do not count
        (-180, (0.25, 0.0, 0.0), -1.0),  # half the length at which it fades
        (-180, (0.0, 0.0, 1.0), 0.0),
    ],
)
def test_looking_away_costs_up_to_two_and_nothing_without_a_direction(yaw_deg, direction, value):
    assert looks(yaw_deg, direction) == pytest.approx(value, abs=2e-4)


def test_the_nose_that_points_down_still_looks_ahead():
    assert looks(30, (2 * math.cos(math.pi / 6), 1.0, 0.0), pitch_deg=60) == pytest.approx(
        0.0, abs=2e-4
    )


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        (Collision, "radius_m"),
        (ClearanceMargin, "margin_m"),
        (LookAlongVelocity, "slow_mps"),
        (LookAtControlPoint, "near_m"),
    ],
)
def test_lengths_and_speeds_of_rewards_must_be_above_zero(kind, option):
    with pytest.raises(ConfigError, match=rf"{option} is 0.0; expected a number above zero"):
        kind(weight=1.0, **{option: 0.0})


PAPER = {"point_progress": 2.0, "time": 3.0, "crash": 350.0, "dynamics_limits": 5.0}
SETS = {
    "paper2025": PAPER | {"field_of_view": 0.5, "body_rate": 0.01, "finish": 20.0},
    "paper2024": PAPER | {"body_rate": 0.01, "arrival": 10.0},
}


@pytest.mark.parametrize("name", SETS)
def test_a_paper_is_a_named_set_of_rewards(make_stages, name):
    terms = {term.name: term for term in make_stages(f"reward={name}").terms.rewards}
    assert {term: terms[term].weight for term in terms} == SETS[name]
    assert terms["point_progress"].speed_mps == 3.0
    assert terms["point_progress"].column_radius_m == {"paper2025": 0.5, "paper2024": None}[name]
    assert terms["dynamics_limits"].roll_and_pitch_apart == (name == "paper2024")


def test_a_named_set_can_be_extended_and_ablated(make_stages):
    stages = make_stages("reward=[paper2024,energy]", "~reward.arrival")
    names = [term.name for term in stages.terms.rewards]
    assert names == [*(n for n in SETS["paper2024"] if n != "arrival"), "energy"]
