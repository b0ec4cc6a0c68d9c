"""Routes that are planned again in flight."""

import itertools

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import TRUNCATION_M
from resc.maps.distance_transform import distance_transform
from resc.maps.known_map import UNKNOWN
from resc.planning.replanning import InFlight
from resc.planning.replanning_kernels import CLOSED_OFF, ON_ROUTE, RENEWED
from resc.setup import build_stages
from resc.term import Context
from resc.terms.tasks.control_points import ControlPoints

GOAL = (5.0, 0.0, 1.2)


def known(*boxes):
    """The known field of a map of 12 x 12 m around (0, 0), with boxes (x0, x1, y0, y1) [m]."""
    occupied = torch.zeros(1, 120, 120, dtype=torch.bool)
    for box in boxes:
        x0, x1, y0, y1 = (round((value + 6) * 10) for value in box)
        occupied[0, y0:y1, x0:x1] = True
    return distance_transform(occupied, 0.1, TRUNCATION_M)


class Flight:
    """One vehicle at rest at (-4, 0), its route straight to the goal, and the term."""

    def __init__(self, **options):
        self.term = InFlight(**options).named("replanning")
        self.term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
        route = torch.tensor([[[-2.0, 0.0, 1.2], [2.0, 0.0, 1.2], GOAL]])
        self.tensors = {
            keys.POSITION_W: torch.tensor([[-4.0, 0.0, 1.0]]),
            keys.VELOCITY_W: torch.zeros(1, 3),
            keys.SCENE_INDEX: torch.zeros(1, 1, dtype=torch.int64),
            keys.MAP_ORIGIN_W: torch.tensor([[-6.0, -6.0]]),
            keys.MAP_SIZE: torch.tensor([[12.0, 12.0]]),
            keys.ROUTE_W: route,
            keys.ROUTE_LENGTH: torch.tensor([[3]]),
            keys.ROUTE_INDEX: torch.tensor([[0]]),
            keys.CONTROL_POINTS_W: route[:, :2],
            keys.ROUTE_CLEARANCE: torch.tensor([[torch.inf]]),
        }
        self.tensors |= {keys.DONE: torch.zeros(1, 1, dtype=torch.bool)}
        self.tensors |= self.term.begin(self.tensors)

    def check(self, clock, field, unseen=(0, 0, 0, 0)):
        """The status after a step, with a box [m] that was never seen."""
        evidence = torch.full((1, 120, 120), -20, dtype=torch.int8)
        x0, x1, y0, y1 = (round((value + 6) * 10) for value in unseen)
        evidence[0, y0:y1, x0:x1] = UNKNOWN
        self.tensors |= {keys.CLOCK: torch.full((1, 1), float(clock)), keys.KNOWN_ESDF: field}
        self.tensors[keys.KNOWN_EVIDENCE] = evidence
        self.term.run(self.tensors)
        return int(self.tensors[keys.REPLAN_STATUS])

    @property
    def route(self):
        return self.tensors[keys.ROUTE_W][0, : int(self.tensors[keys.ROUTE_LENGTH])]


def clearance_along(flight, field):
    """The least known distance on the lines from the vehicle through its route [m]."""
    points = torch.cat((flight.tensors[keys.POSITION_W], flight.route))[:, :2]
    least = TRUNCATION_M
    for a, b in itertools.pairwise(points):
        at = a + (b - a) * torch.linspace(0, 1, 200).unsqueeze(-1)
        cell = ((at + 6) * 10).floor().long()
        least = min(least, float(field[0, cell[:, 1], cell[:, 0]].min()))
    return least


WALL = (-0.1, 0.1, -2.0, 1.0)


def test_the_first_route_is_planned_at_once_whatever_the_scene_gave():
    flight = Flight(latency_steps=5)
    assert flight.check(0, known(WALL)) == RENEWED
    assert_close(flight.route[-1], torch.tensor(GOAL))
    assert clearance_along(flight, known(WALL)) >= 0.4
    assert int(flight.tensors[keys.REPLANS]) == 0


def test_a_free_route_stays():
    flight = Flight()
    flight.check(0, known())
    before = flight.route.clone()
    for clock in range(1, 12):
        assert flight.check(clock, known((-0.1, 0.1, 1.0, 3.0))) == (ON_ROUTE if clock > 1 else 1)
    assert torch.equal(flight.route, before)


@pytest.mark.parametrize("latency", [0, 1, 4])
def test_a_blocked_route_is_renewed_and_arrives_late(latency):
    flight = Flight(latency_steps=latency, check_hz=50.0)
    flight.check(0, known())
    before = flight.route.clone()
    assert flight.check(1, known(WALL)) == RENEWED
    for step in range(latency):
        assert torch.equal(flight.route, before)
        flight.check(2 + step, known(WALL))
    assert not torch.equal(flight.route[:1], before[:1])
    assert clearance_along(flight, known(WALL)) >= 0.4
    assert int(flight.tensors[keys.REPLANS]) == 1
    assert_close(flight.tensors[keys.CONTROL_POINTS_W][0, 0], flight.route[0])
    assert int(flight.tensors[keys.ROUTE_INDEX]) == 0
    for clock in range(10, 20):
        assert flight.check(clock, known(WALL)) == ON_ROUTE


def test_checks_come_at_their_rate_and_look_only_so_far_ahead():
    flight = Flight(check_hz=10.0)
    flight.check(0, known())
    found = [flight.check(clock, known(WALL)) for clock in range(1, 6)]
    assert found == [1, 1, 1, 1, RENEWED]
    assert int(flight.tensors[keys.REPLANS]) == 1
    near = Flight(check_hz=50.0, ahead_m=3.0)
    near.check(0, known())
    assert near.check(1, known(WALL)) == ON_ROUTE
    near.tensors[keys.POSITION_W] = torch.tensor([[-2.5, 0.0, 1.0]])
    assert near.check(2, known(WALL)) == RENEWED


def test_a_goal_that_closes_off_makes_the_vehicle_wait_and_the_way_that_opens_go_on():
    flight = Flight(check_hz=50.0)
    flight.check(0, known())
    closed = known((-0.1, 0.1, -6.0, 6.0))
    assert flight.check(1, closed) == CLOSED_OFF
    for clock in range(2, 30):
        assert flight.check(clock, closed) == CLOSED_OFF
    assert len(flight.route) == 0
    assert_close(flight.tensors[keys.CONTROL_POINTS_W][0], torch.tensor([[-4.0, 0.0, 1.0]] * 2))
    for clock in range(30, 34):
        flight.check(clock, known(WALL))
    assert int(flight.tensors[keys.REPLAN_STATUS]) == ON_ROUTE
    assert_close(flight.route[-1], torch.tensor(GOAL))


@pytest.mark.parametrize("options", [{}, {"latency_steps": 50, "check_hz": 2.0}, {"points": 8}])
def test_a_vehicle_that_waits_passes_nothing_and_does_not_arrive(options):
    ring = known(
        (-5, -3, -1.1, -1.0), (-5, -3, 1, 1.1), (-5, -4.9, -1.1, 1.1), (-3.1, -3, -1.1, 1.1)
    )
    flight, task = Flight(**options), ControlPoints().named("control_points")
    flight.check(0, known())
    for clock in range(1, 200):
        task.run(flight.tensors)
        assert not flight.tensors[keys.PASSED]
        assert not flight.tensors[keys.FINISHED]
        flight.check(clock, ring)
    assert len(flight.route) == 0


def test_the_time_to_the_goal_is_that_to_the_goal_of_the_episode(compose):
    within = "+metric.within={_target_: resc.terms.metrics.flight.TimeWithin, radius_m: 0.5}"
    stages = build_stages(compose("sensing=depth", "replanning=in_flight", within))
    (metric,) = (term for term in stages.terms.metrics if term.name == "within")
    here, elsewhere = torch.zeros(1, 3), torch.full((1, 3), 3.0)
    never, clock = torch.full((1, 1), torch.inf), torch.ones(1, 1)
    assert metric.compute(never, here, here[None], clock, elsewhere).isinf()
    assert_close(metric.compute(never, here, elsewhere[None], clock, here), 0.02 * clock)
    assert keys.REPLAN_GOAL_W in metric.reads
    (metric,) = (t for t in build_stages(compose(within)).terms.metrics if t.name == "within")
    assert keys.REPLAN_GOAL_W not in metric.reads
    assert_close(metric.compute(never, here, here[None], clock), 0.02 * clock)


def test_an_end_inside_the_clearance_is_moved_and_flagged():
    flight = Flight()
    field = known((4.5, 4.8, -0.3, 0.3))
    assert flight.check(0, field) == RENEWED
    assert bool(flight.tensors[keys.REPLAN_MOVED])
    end = flight.route[-1]
    assert torch.linalg.vector_norm(end - torch.tensor(GOAL)) < 0.5
    assert field[0, int((end[1] + 6) * 10), int((end[0] + 6) * 10)] > 0.4
    walled = known((4.0, 6.0, -1.5, 1.5))
    assert Flight().check(0, walled) == CLOSED_OFF


def test_nothing_is_planned_once_an_episode_is_over():
    flight = Flight(check_hz=50.0)
    flight.check(0, known())
    flight.tensors[keys.DONE] = torch.ones(1, 1, dtype=torch.bool)
    flight.check(1, known(WALL))
    flight.tensors[keys.DONE] = torch.zeros(1, 1, dtype=torch.bool)
    flight.check(2, known(WALL))
    assert int(flight.tensors[keys.REPLANS]) == 0


def test_near_the_vehicle_a_route_leads_through_cells_that_were_seen():
    beside = (-3.6, 0.0, -1.0, 0.5)
    flight = Flight(check_hz=50.0, seen_m=2.0)
    flight.check(0, known(), beside)
    first = flight.route[0]
    assert first[1] > 0.4
    assert flight.check(1, known(), beside) == ON_ROUTE
    far = Flight(check_hz=50.0, seen_m=0.35)
    far.check(0, known(), beside)
    assert far.route[0, 1].abs() < 0.01


def test_beside_what_is_unseen_a_route_keeps_more_if_there_is_such_a_way():
    between = (-0.1, 0.1, -6.0, 6.0)
    field = known((-0.1, 0.1, -6.0, -0.5), (-0.1, 0.1, 0.5, 1.5), (-0.1, 0.1, 3.0, 6.0))

    def passed(unseen, **options):
        """Where the wall, whose gaps are 1 and 1.5 m wide, is crossed [m]."""
        flight = Flight(clearance_m=0.35, **options)
        flight.check(0, field, unseen)
        points = torch.cat((flight.tensors[keys.POSITION_W], flight.route))
        after = int((points[:, 0] > 0).float().argmax())
        (x0, y0), (x1, y1) = points[after - 1, :2].tolist(), points[after, :2].tolist()
        return y0 - x0 * (y1 - y0) / (x1 - x0)

    assert abs(passed(between)) < 0.2
    assert 1.9 < passed(between, unseen_m=0.2) < 2.6
    assert abs(passed((0, 0, 0, 0), unseen_m=0.2)) < 0.2  # seen, it is wide enough
    assert abs(passed(between, unseen_m=0.6)) < 0.2  # for both too narrow


def test_where_all_round_is_unseen_a_route_leads_through_it():
    flight = Flight(seen_m=2.0)
    assert flight.check(0, known(), (-6, 6, -6, 6)) == RENEWED
    assert_close(flight.route[-1], torch.tensor(GOAL))


def test_a_moving_vehicle_turns_back_only_for_a_much_shorter_way():
    across = (0.0, 0.2, -4.0, 3.0)  # the shortest way goes through the gap above
    routes = {}
    for turn_m in (0.0, 8.0):
        flight = Flight(check_hz=50.0, turn_m=turn_m)
        flight.check(0, known())
        flight.tensors[keys.POSITION_W] = torch.tensor([[-0.8, 0.5, 1.0]])
        flight.tensors[keys.VELOCITY_W] = torch.tensor([[0.5, -2.5, 0.0]])
        assert flight.check(1, known(across)) == RENEWED
        flight.check(2, known(across))
        routes[turn_m] = flight.route[0, 1] - 0.5
    assert routes[0.0] > 0 > routes[8.0]


def place(flight, position, velocity):
    """Puts the vehicle onto its route, behind the control points that it has passed."""
    flight.tensors[keys.POSITION_W] = torch.tensor([[*position, 1.0]])
    flight.tensors[keys.VELOCITY_W] = torch.tensor([[*velocity, 0.0]])
    passed = int((flight.route[:, 0] < position[0]).sum())
    flight.tensors[keys.ROUTE_INDEX] = torch.tensor([[passed]])


def test_a_fast_vehicle_turns_sharply_only_for_a_much_shorter_way():
    across = (0.0, 0.2, -0.6, 1.8)  # the shortest way leads round its lower end
    turned = {}
    for lateral_mps2, speed in itertools.product((0.0, 6.0), (1.0, 2.5)):
        flight = Flight(check_hz=50.0, lateral_mps2=lateral_mps2)
        flight.check(0, known())
        place(flight, (-1.2, 0.4), (0.95 * speed, 0.31 * speed))
        assert flight.check(1, known(across)) == RENEWED
        flight.check(2, known(across))
        turned[lateral_mps2, speed] = bool(flight.route[0, 1] < 0.4)
    assert turned == {(0.0, 1.0): True, (0.0, 2.5): True, (6.0, 1.0): True, (6.0, 2.5): False}


def test_what_is_entered_is_flown_through_though_it_is_narrower_than_it_looked():
    gap = known((0.0, 0.2, -6.0, -0.2), (0.0, 0.2, 0.2, 6.0))  # 0.2 m to each side

    def found(x, speed, **options):
        flight = Flight(check_hz=50.0, **options)
        flight.check(0, known())
        place(flight, (x, 0.0), (speed, 0.0))
        return flight.check(1, gap)

    entered = {"entered_s": 1.0, "entered_m": 0.15}
    assert found(-1.0, 2.0) == CLOSED_OFF
    assert found(-1.0, 2.0, **entered) == ON_ROUTE
    assert found(-3.0, 2.0, **entered) == CLOSED_OFF  # it is too far away yet
    assert found(-1.0, 0.5, **entered) == CLOSED_OFF  # there is time to turn
    assert found(-1.0, 2.0, **entered | {"entered_m": 0.25}) == CLOSED_OFF


def test_a_new_route_keeps_to_what_is_entered():
    gap = known((0.0, 0.2, -6.0, -0.3), (0.0, 0.2, 0.3, 6.0), (3.0, 3.2, -2.0, 1.0))
    for entered_s in (0.0, 1.0):
        flight = Flight(check_hz=50.0, clearance_m=0.5, entered_s=entered_s)
        flight.check(0, known())
        place(flight, (-1.0, 0.0), (2.0, 0.0))
        assert flight.check(1, gap) == (RENEWED if entered_s else CLOSED_OFF)


def test_flights_replan_on_what_they_see_and_the_same_seed_gives_the_same_bits(make_env):
    chosen = ("scene=planned", "num_envs=8", "sensing=depth", "replanning=in_flight")
    ends = []
    for _ in range(2):
        env = make_env(*chosen)
        env.restart(torch.arange(8))
        assert (env.value_of(keys.REPLAN_STATUS) <= CLOSED_OFF).all()
        for _ in range(40):
            env.advance(torch.tensor([[0.0, 0.1, 0.0, 0.02]]).expand(8, 4))
        ends.append({key: value.clone() for key, value in env.tensors.items()})
    for key, value in ends[0].items():
        assert torch.equal(value, ends[1][key]), key
    assert ends[0][keys.REPLANS].sum() > 0
    begun = ends[0][keys.REPLANS][:, 0] * 0
    env.restart(torch.arange(8))
    assert torch.equal(env.value_of(keys.REPLANS)[:, 0], begun)


def test_the_released_rule_lays_a_point_every_metre_and_a_half():
    flight = Flight(rule="released", spacing_m=(0.5, 2.0))
    assert flight.check(0, known()) == RENEWED
    ahead = torch.tensor([-2.5, -1.0, 0.5, 2.0, 3.5, 5.0])
    assert_close(flight.route[:, 0], ahead, rtol=0, atol=1e-6)


def test_lines_of_the_released_rule_may_cross_what_those_of_the_other_keep_clear_of():
    slalom = known((-1.0, -0.8, -6.0, 0.3), (0.0, 0.2, -0.3, 6.0), (1.0, 1.2, -6.0, 0.3))
    least = {}
    for rule in ("visible", "released"):
        flight = Flight(rule=rule, spacing_m=(0.5, 2.0), clearance_m=0.3)
        assert flight.check(0, slalom) == RENEWED
        least[rule] = clearance_along(flight, slalom)
    assert least["visible"] > 0.2
    assert least["released"] < least["visible"]


def test_new_routes_stay_away_from_the_sides_of_the_map():
    wall = known((-0.1, 0.1, -6.0, 5.2))  # open for 0.8 m at the upper side
    assert Flight().check(0, wall) == RENEWED
    assert Flight(edge_m=0.5).check(0, wall) == CLOSED_OFF


@pytest.mark.parametrize("key", [keys.POSITION_W, keys.VELOCITY_W])
def test_routes_begin_at_the_estimated_state_and_not_at_the_true_one(make_env, key):
    env = make_env("num_envs=8", "sensing=local", "replanning=in_flight", "estimator=noise")
    env.restart(torch.arange(8))
    world = {name: env.value_of(name) for name in env.stages.persistent} | env.pool.shared
    world |= {keys.CLOCK: torch.zeros(8, 1), keys.REPLAN_OVER: torch.zeros(8, 1).bool()}
    routes = []
    for changed in (None, key, keys.ESTIMATES[key]):
        tensors = {name: value.clone() for name, value in world.items()}
        if changed is not None:
            far = 30.0 if key == keys.POSITION_W else 1.5
            tensors[changed][:, :2] = torch.tensor([[-far, far]])
        env.stages._replan(tensors)
        routes.append(tensors[keys.ROUTE_W])
    assert torch.equal(routes[0], routes[1])
    assert not torch.equal(routes[0], routes[2])


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        ([], "replanning goes by the map that a vehicle knows.* choose sensing=local"),
        (["sensing=depth", "replanning.clearance_m=0.2"], r"clearance_m is 0\.2, below margin_m"),
        (["sensing=depth", "replanning.entered_m=0.3"], r"entered_m is 0\.3, above margin_m"),
        (["sensing=depth", "replanning.spacing_m=[2,1]"], r"spacing_m is \[2.0, 1.0\]; expec"),
        (["sensing=depth", "replanning.latency_steps=-1"], r"replanning\.latency_steps is -1"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(compose, overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build_stages(compose("replanning=in_flight", *overrides))
