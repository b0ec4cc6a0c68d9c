"""What vehicles see of the map, and who goes by it."""

import math

import pytest
import torch
from torch.testing import assert_close

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import TRUNCATION_M
from resc.maps.distance_transform import distance_transform
from resc.maps.known_map import UNKNOWN
from resc.math.rotation import quaternion_from_euler
from resc.setup import build_stages
from resc.term import Context
from resc.terms.sensing.depth import Depth
from resc.terms.sensing.lidar2d import Lidar2d
from resc.terms.sensing.local import Local

KINDS = ("local", "depth", "lidar2d")
SURE = {"hit": 22}
"""One hit is enough."""


def place(x0, x1, y0, y1):
    """A map of 12 x 12 m around the vehicle with one box [m]; its middle is (0, 0)."""
    occupied = torch.zeros(1, 120, 120, dtype=torch.bool)
    span = [round((v + 6) * 10) for v in (x0, x1, y0, y1)]
    occupied[0, span[2] : span[3], span[0] : span[1]] = True
    truth = distance_transform(occupied, 0.1, TRUNCATION_M)
    corner, size = torch.tensor([[-6.0, -6.0]]), torch.tensor([[12.0, 12.0]])
    return torch.zeros(1, 1, dtype=torch.int64), truth, corner, size


NOTHING_MOVES = torch.empty(1, 0, 10)


def looked(
    term,
    field,
    *,
    euler=(0.0, 0.0, 0.0),
    height=1.0,
    step=0.0,
    unit=(0.3, 0.6),
    movers=NOTHING_MOVES,
    evidence=None,
):
    """Evidence after one look from the middle."""
    term.bind(Context(dt_s=0.02, resolution_m=0.1, vehicle=None))
    if evidence is None:
        evidence = torch.full((1, 120, 120), UNKNOWN, dtype=torch.int8)
    esdf = torch.full((1, 120, 120), TRUNCATION_M)
    noisy = [torch.zeros(1, 1, dtype=torch.int64), torch.tensor([unit])]
    term.compute(
        torch.full((1, 1), step),
        torch.tensor([[0.01, 0.01, height]]),
        quaternion_from_euler(torch.tensor([euler])),
        *field,
        movers,
        evidence,
        esdf,
        *(noisy if term.step_draws else []),
    )
    return evidence[0]


def at(evidence, x, y):
    return int(evidence[int((y + 6) * 10), int((x + 6) * 10)])


CLEAR = {"lost_share": 0.0}
EXACT = {**CLEAR, "noise_1pm": 0.0, **SURE}


def test_a_camera_sees_the_face_of_a_box_and_nothing_behind_it():
    seen = looked(Depth(**EXACT), place(2.0, 3.0, -0.5, 0.5))
    assert at(seen, 2.01, 0.0) >= 14
    assert at(seen, 1.5, 0.0) < 0
    assert at(seen, 2.5, 0.0) == UNKNOWN
    assert at(seen, 4.0, 0.0) == UNKNOWN
    assert at(seen, 3.0, 2.0) < 0  # past the box, within the field of view
    assert at(seen, 1.0, 2.0) == UNKNOWN  # beyond it
    assert at(seen, -1.0, 0.0) == UNKNOWN
    assert at(seen, 4.9, 0.6) == UNKNOWN  # in the shadow
    assert at(seen, 5.3, 4.0) == UNKNOWN  # deeper than the range


def test_local_sees_behind_and_only_so_far():
    seen = looked(Local(radius_m=3.0), place(2.0, 2.5, -0.5, 0.5))
    assert at(seen, 2.3, 0.0) >= 14
    assert at(seen, 2.8, 0.0) < 0
    assert at(seen, -2.8, 0.0) < 0
    assert at(seen, 3.2, 0.0) == UNKNOWN


def test_yaw_turns_the_camera():
    seen = looked(Depth(**EXACT), place(-0.5, 0.5, 2.0, 3.0), euler=(0.0, 0.0, math.pi / 2))
    assert at(seen, 0.0, 2.01) >= 14
    assert at(seen, 2.0, 0.0) == UNKNOWN


@pytest.mark.parametrize("sign", [1, -1])
def test_a_camera_that_pitches_out_of_its_field_sees_no_level_direction_ahead(sign):
    box = place(2.0, 3.0, -0.5, 0.5)
    half = 1.027 / 2
    just = looked(Depth(**EXACT), box, euler=(0.0, sign * (half - 0.02), 0.0))
    beyond = looked(Depth(**EXACT), box, euler=(0.0, sign * (half + 0.02), 0.0))
    assert at(just, 2.01, 0.0) >= 14
    assert at(beyond, 2.01, 0.0) == UNKNOWN


def test_a_camera_that_banks_loses_the_side_where_the_horizon_leaves_the_image():
    level = looked(Depth(**EXACT), place(5.0, 5.5, -6, 6))
    banked = looked(Depth(**EXACT), place(5.0, 5.5, -6, 6), euler=(1.0, 0.0, 0.0))
    assert at(level, 3.0, 2.4) < 0
    assert at(banked, 3.0, 2.4) == UNKNOWN
    assert at(banked, 3.0, 0.5) < 0


def test_a_lidar_sees_all_round_and_hits_the_floor_where_it_tilts():
    exact = {**CLEAR, "noise_m": 0.0, **SURE}
    box = place(-4.5, -4.0, -1.0, 1.0)
    level = looked(Lidar2d(**exact), box)
    assert at(level, -4.01, 0.0) >= 14
    assert at(level, 3.0, 3.0) < 0
    tilted = looked(Lidar2d(**exact), box, euler=(0.0, -0.5, 0.0))  # the tail is down
    reach = 1.0 / math.tan(0.5)  # where a beam meets the floor
    assert at(tilted, -reach + 0.2, 0.0) < 0
    assert at(tilted, -reach - 0.2, 0.0) == UNKNOWN
    assert at(tilted, -4.01, 0.0) == UNKNOWN


def test_errors_grow_with_the_square_of_the_depth():
    spread = []
    for wall in (2.0, 4.0):
        found = []
        for seed in range(40):
            term = Depth(**CLEAR, noise_1pm=0.03, beams=31, horizontal_rad=0.1, **SURE)
            seen = looked(term, place(wall, wall + 0.1, -6, 6), unit=(seed / 40, 0.5))
            found += (seen >= 14).nonzero()[:, 1].tolist()
        spread.append(torch.tensor(found, dtype=torch.float32).std())
    assert 3.0 < spread[1] / spread[0] < 5.0


def test_what_moves_is_seen_where_it_is_and_forgotten_where_it_was():
    free = torch.zeros(1, 1, dtype=torch.int64), torch.full((1, 120, 120), TRUNCATION_M)
    field = (*free, torch.tensor([[-6.0, -6.0]]), torch.tensor([[12.0, 12.0]]))
    # 0.5 m wide, from (2, 0) to the left at 1 m/s: it goes behind itself, as seen from the middle
    mover = torch.tensor([[[2.0, 0.0, 0.0, 1.0, 0.25, 0.25, 2.0, 0.0, 2.0, 0.0]]])
    term = Lidar2d(**CLEAR, noise_m=0.0, **SURE)
    evidence = torch.full((1, 120, 120), UNKNOWN, dtype=torch.int8)
    first, _, later = (  # one miss is less than a hit
        looked(term, field, movers=mover, step=step, evidence=evidence).clone()
        for step in (0.0, 45.0, 50.0)
    )
    assert at(first, 1.76, 0.0) >= 14
    assert at(first, 1.76, 1.0) < 0
    assert at(later, 1.76, 1.0) >= 14
    assert at(later, 1.76, 0.0) < 14  # beams have passed there


def test_what_is_out_of_sight_fades_as_fast_as_asked():
    box = place(4.0, 4.5, -0.5, 0.5)
    term = Local(radius_m=5.0, fade=2)
    evidence = looked(term, box).unsqueeze(0)
    assert at(evidence[0], 4.2, 0.0) == 22
    near = Local(radius_m=3.0, fade=2)
    seen = []
    for step in range(0, 60, 5):
        looked(near, box, step=float(step), evidence=evidence)
        seen.append(at(evidence[0], 4.2, 0.0))
    assert seen == [20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0, 0]
    assert at(evidence[0], -4.2, 0.0) == -20  # what is free remains so


def test_where_what_moves_will_be_is_occupied_as_far_ahead_as_asked():
    free = torch.zeros(1, 1, dtype=torch.int64), torch.full((1, 120, 120), TRUNCATION_M)
    field = (*free, torch.tensor([[-6.0, -6.0]]), torch.tensor([[12.0, 12.0]]))
    mover = torch.tensor([[[2.0, 0.0, 0.0, 1.5, 0.2, 0.2, 2.0, 0.0, 2.0, 0.0]]])
    now, soon = (
        looked(Local(predict_s=s), field, movers=mover, step=50.0, evidence=unseen())
        for s in (0.0, 1.0)
    )
    way = [1.35 + 0.1 * cell for cell in range(18)]  # at 1 s it is at y = 1.5, at 2 s at 3
    assert [at(now, 2.0, y) == 22 for y in way] == [y < 1.7 for y in way]
    assert [at(soon, 2.0, y) == 22 for y in way] == [True] * 18
    assert at(soon, 2.0, 1.25) == at(soon, 2.0, 3.25) == -20


def unseen():
    return torch.full((1, 120, 120), UNKNOWN, dtype=torch.int8)


def test_lost_readings_say_nothing():
    full = looked(Depth(**EXACT), place(5.5, 5.9, -6, 6))
    half = looked(Depth(noise_1pm=0.0, lost_share=0.5, **SURE), place(5.5, 5.9, -6, 6))
    none = looked(Depth(noise_1pm=0.0, lost_share=1.0, **SURE), place(5.5, 5.9, -6, 6))
    counts = [int((seen != UNKNOWN).sum()) for seen in (full, half, none)]
    assert counts[0] > counts[1] > 0 == counts[2]


def test_scans_come_at_their_rate():
    due = [
        looked(Local(), place(2, 3, 0, 1), step=float(step)).max() > UNKNOWN for step in range(11)
    ]
    assert [step for step, is_due in enumerate(due) if is_due] == [0, 5, 10]


FLIGHT = ("scene=planned", "num_envs=8")


@pytest.mark.parametrize("kind", KINDS)
def test_the_policy_goes_by_the_known_map_and_rewards_by_the_true_one(make_env, kind):
    flown = {}
    near = ["sensing.round_m=0"]  # observations reach less than 5 m
    near += ["sensing.radius_m=1.0"] * (kind == "local")
    for name, more in (("global", []), (kind, near)):
        env = make_env(*FLIGHT, f"sensing={name}", *more)
        env.restart(torch.arange(8))
        first = env.observation.clone()
        outs = [env.advance(torch.zeros(8, 4)) for _ in range(3)]
        flown[name] = first, outs, env
    (_, whole, _), (_, seen, env) = flown["global"], flown[kind]
    for true, out in zip(whole, seen, strict=True):
        assert_close(out.reward, true.reward, rtol=0, atol=0)
        assert torch.equal(out.terminated, true.terminated)
    names = env.stages.observation_columns
    obstacles = [i for i, name in enumerate(names) if name.startswith(("kgp", "esdf"))]
    others = [i for i in range(len(names)) if i not in obstacles and "planar" not in names[i]]
    apart = (seen[-1].observation - whole[-1].observation).abs()
    assert apart[:, others].max() == 0
    assert apart[:, obstacles].max() > 0
    evidence, esdf = (env.value_of(key) for key in (keys.KNOWN_EVIDENCE, keys.KNOWN_ESDF))
    assert torch.equal(esdf, distance_transform(evidence >= 14, 0.1, TRUNCATION_M))


@pytest.mark.parametrize("kind", KINDS)
def test_an_episode_begins_with_one_look_and_leaves_the_others_alone(make_env, kind):
    env = make_env(*FLIGHT, f"sensing={kind}")
    env.restart(torch.arange(8))
    for _ in range(12):
        env.advance(torch.zeros(8, 4))
    before = env.value_of(keys.KNOWN_EVIDENCE).clone()
    env.restart(torch.tensor([2, 5]))
    after = env.value_of(keys.KNOWN_EVIDENCE)
    others = [0, 1, 3, 4, 6, 7]
    assert torch.equal(after[others], before[others])
    seen = (after != UNKNOWN).flatten(1).sum(1)
    assert (seen[[2, 5]] > 0).all()
    assert (after[[2, 5]].abs() <= 22)[after[[2, 5]] != UNKNOWN].all()


def test_a_vehicle_has_looked_round_before_its_episode_begins(make_env):
    seen = {}
    for round_m in (0, 2, 5):
        env = make_env(*FLIGHT, "sensing=depth", f"sensing.round_m={round_m}")
        env.restart(torch.arange(8))
        seen[round_m] = (env.value_of(keys.KNOWN_EVIDENCE) != UNKNOWN).flatten(1).sum(1)
    assert (seen[0] < seen[2]).all()
    assert (seen[2] < seen[5]).all()
    assert (seen[2] - seen[0] < math.pi * 2.1**2 * 100).all()


def test_the_value_function_sees_the_true_map(make_env):
    critic = "obstacle_observation@observation_critic=kgp_esdf"
    outs = []
    for name in ("global", "depth"):
        env = make_env(*FLIGHT, f"sensing={name}", critic)
        env.restart(torch.arange(8))
        outs.append(env.advance(torch.zeros(8, 4)))
    assert torch.equal(outs[0].observation_critic, outs[1].observation_critic)
    assert not torch.equal(outs[0].observation, outs[1].observation)


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (["sensing=depth", "sensing.range_m=0.2"], r"range_m is 0\.2, within the 0\.3 m of a coll"),
        (["sensing=lidar2d", "sensing.range_m=0.3"], r"range_m is 0\.3, within"),
        (["sensing=local", "sensing.radius_m=0.1"], r"radius_m is 0\.1, within"),
        (["sensing=depth", "sensing.rate_hz=99"], "rate_hz is 99, but there are 50 control steps"),
        (["sensing=depth", "sensing.miss=3"], r"expected hit > 0 > miss"),
        (["sensing=depth", "sensing.fade=-1"], r"sensing\.fade is -1"),
        (["sensing=depth", "sensing.beams=0"], r"sensing\.beams is 0"),
        (["sensing=depth", "sensing.lost_share=2"], r"sensing\.lost_share is 2"),
    ],
)  # fmt: skip
def test_a_sensor_that_cannot_be_is_refused(compose, overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build_stages(compose(*FLIGHT, *overrides))


@pytest.mark.parametrize("kind", KINDS)
def test_movers_are_in_the_known_map_from_the_first_look_on(make_env, kind):
    env = make_env("scene=dynamic", "num_envs=8", f"sensing={kind}")
    env.restart(torch.arange(8))
    seen = [env.value_of(keys.KNOWN_EVIDENCE) >= 14]
    for _ in range(10):
        env.advance(torch.zeros(8, 4))
    seen.append(env.value_of(keys.KNOWN_EVIDENCE) >= 14)
    assert (seen[0].flatten(1).sum(1) > 0).any()
    assert not torch.equal(*seen)


def test_movers_without_a_sensing_are_refused_but_for_who_is_told_of_them(make_env):
    with pytest.raises(ConfigError, match=r"scene\.movers are obstacles that move, but without a"):
        make_env("scene=dynamic", "num_envs=2")
    env = make_env("scene=dynamic", "num_envs=2", "observation=[velocity,nearest_movers]")
    env.restart(torch.arange(2))
    told = env.stages.observation_columns.index("nearest_movers.mover_0_size")
    assert (env.observation[:, told] > 0).any()
