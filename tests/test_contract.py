"""What every part of `conf/` keeps, one case per YAML file: a new file needs no test of its own.

It builds; it writes only what it declares, in the declared shape; its numbers are finite; the same
inputs give the same bits; permuting the environments permutes the result; one environment alone
gives what it gives among others; and resetting one leaves the others untouched.
"""

import itertools
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from torch.testing import assert_close

from resc import term as kinds
from resc.build import build, build_terms
from resc.groups import GROUPS, TASK
from resc.keys import (
    ACTION,
    CURRICULUM_DIFFICULTY,
    DECLARED,
    DONE,
    EPISODE_DIFFICULTY,
    EPISODE_SUCCESS,
    TERMINATED,
    TRAINED_SHARE,
    TRUNCATED,
)
from resc.learning.progress import Logger
from resc.planning.route import planner_for
from resc.policies.heads import Gaussian
from resc.policies.networks import Model
from resc.policies.policy import Policy
from resc.setup import scene_of
from resc.simulation.vehicle import Vehicle

CONF = Path(__file__).parents[1] / "conf"
COUNT = 6
PERMUTATION = torch.tensor([3, 0, 5, 1, 4, 2])

STEP = [group for group in GROUPS if group.stage and group.own_folder]
LISTS = {folder: g.kind for g in STEP if g.several for folder in (g.name, *g.folders)}
FURTHER = [folder for group in STEP for folder in group.folders]
SINGLES = {g.name: g.kind for g in STEP if not g.several}


def names(group):
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def is_set(group, name):
    """Whether a file is a named set: a list of other files of its group."""
    return "defaults" in OmegaConf.load(CONF / group / f"{name}.yaml")


def cases(groups):
    return [
        pytest.param(group, name, id=f"{group}/{name}") for group in groups for name in names(group)
    ]


DRAWN_BY = ["rate_loop=px4", "dynamics=on_battery", "dynamics.in_wind=true"]
"""Readers of everything that a randomisation may draw."""
TERMS = cases([*SINGLES, *LISTS, "task"])


@pytest.fixture(scope="module")
def parts(load_part):
    """`parts(group, name)`: the terms that a file describes, named and bound."""
    vehicle = build(load_part("vehicle", "imp250"), "vehicle")
    context = kinds.Context(dt_s=0.02, resolution_m=0.1, vehicle=vehicle)

    def make(group, name):
        node = load_part(group, name)
        if group in SINGLES:
            terms = [build(node, group).named(group)] if node else []
        elif group == "task":
            terms = [build(plain(node[part]), f"task.{part}").named(part) for part in TASK]
        else:
            terms = build_terms(node, group, LISTS[group])
        for term in terms:
            term.bind(context)
        return terms

    return make


def plain(node):
    """A node without the difficulty that may ease it: that is no argument of its class."""
    return {key: value for key, value in node.items() if key != "difficulty"}


def every_list():
    """Overrides that choose every part of every group that takes a list."""
    chosen = {group: names(group) for group in LISTS if group not in FURTHER}
    chosen = {g: [n for n in found if not is_set(g, n)] for g, found in chosen.items()}
    chosen["sensor"].sort(key=lambda name: name != "euler")  # others read it
    lists = [f"{group}=[{','.join(found)}]" for group, found in chosen.items()]
    # as the margins, the wind, the gains and the charge that are drawn want it, and what is seen
    return [*lists, "scene.clearance_m=[0.3,0.5]", "sensing=local", *DRAWN_BY]


@pytest.fixture(scope="module")
def flight(make_env):
    """All tensors there are in the middle of a step, of six environments in flight.

    What an estimator or another rate loop remembers is as in its first step.
    """
    env = make_env(f"num_envs={COUNT}", *every_list())
    generator = torch.Generator().manual_seed(0)
    env.restart(torch.arange(COUNT))
    for _ in range(3):
        env.advance(torch.rand(COUNT, 4, generator=generator) - 0.5)
    stages, terms = env.stages, env.stages.terms
    world = {key: env.value_of(key) for key in stages.persistent}
    tensors = {**env.pool.shared, **world, ACTION: torch.rand(COUNT, 4, generator=generator) - 0.5}
    tensors |= {key: world[key[1:]].clone() for key in stages.memory}
    for key in (("task", "start_w"), ("task", "start_motion"), ("task", "clearance")):
        tensors[key] = env.pool.tasks[key][world[("scene", "index")][:, 0]]
    for term in (
        terms.action,
        terms.rate_loop,
        terms.dynamics,
        terms.task,
        *terms.measuring,
        *terms.terminations,
    ):
        term.run(tensors, *draw(term))
    flags = torch.arange(COUNT).unsqueeze(-1)
    return tensors | {TERMINATED: flags % 2 == 0, TRUNCATED: flags % 3 == 1, DONE: flags % 6 != 3}


def widths(term):
    """Uniform blocks that it takes: those of every step, or that of a reset."""
    return [*term.blocks.values()] or [term.draws] * bool(term.draws)


def draw(term):
    generator = torch.Generator().manual_seed(1)
    return [torch.rand(COUNT, width, generator=generator) for width in widths(term)]


def run(term, flight, rows=None):
    """What the term writes for the given environments, checking that it writes nothing else."""
    shared = {key for key, declared in DECLARED.items() if declared.shared}
    chosen = torch.arange(COUNT) if rows is None else rows
    inputs = {key: value if key in shared else value[chosen] for key, value in flight.items()}
    if isinstance(term, kinds.Estimator) or set(term.reads).difference(inputs):
        inputs = {**term.begin(inputs), **inputs}
    if isinstance(term, kinds.Replanning):  # all is known
        known = flight[("map", "esdf")][inputs[("scene", "index")][:, 0]]
        inputs |= {("known", "esdf"): known, ("known", "evidence"): (known > 0).to(torch.int8)}
        inputs |= term.begin(inputs)
    inputs |= {
        key: torch.full((len(chosen), 1), term.start)
        for key in term.outputs
        if isinstance(term, kinds.Metric)
    }
    tensors, drawn = dict(inputs), [block[chosen] for block in draw(term)]
    copies = {key: inputs[key].clone() for key in term.reads}
    term.run(tensors, *drawn)
    changed = {key for key, value in tensors.items() if value is not inputs.get(key)}
    assert changed <= set(term.outputs)
    for key, value in copies.items():
        assert torch.equal(inputs[key], value), f"{key} was changed in place"
    return {key: tensors[key] for key in term.outputs}


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_a_term_builds_under_the_name_of_its_file(parts, group, name):
    terms = parts(group, name)
    if group in LISTS and group not in FURTHER and not is_set(group, name):
        assert [term.name for term in terms] == [name]
    for term in terms:
        assert isinstance(term, (LISTS | SINGLES).get(group, kinds.Term))
        assert type(term).__doc__


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_a_term_reads_only_what_is_declared(parts, group, name):
    for term in parts(group, name):
        for key in term.reads:
            known = key[1:] if key[0] == "memory" and key not in term.initial else key
            assert known in DECLARED or known in term.initial, key


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_a_term_writes_only_what_it_declares_in_the_declared_shape(parts, flight, group, name):
    for term in parts(group, name):
        for key, value in run(term, flight).items():
            assert value.shape[0] == COUNT
            if key in DECLARED:
                shape, wanted = value.shape[1:], DECLARED[key].shape
                assert value.dtype == DECLARED[key].dtype, key
                assert len(shape) == len(wanted), key
                assert all(
                    isinstance(w, str) or s == w for s, w in zip(shape, wanted, strict=True)
                ), key
            elif isinstance(term, kinds.Observation):
                assert value.shape == (COUNT, term.width)
            else:
                assert value.shape == (COUNT, 1)
            if key[0] == "termination":
                assert value.dtype == torch.bool


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_what_a_term_writes_is_finite(parts, flight, group, name):
    for term in parts(group, name):
        for key, value in run(term, flight).items():
            never_yet = (
                value == getattr(term, "start", torch.inf)
                if isinstance(term, kinds.Metric)
                else False
            )
            assert (value.isfinite() | never_yet).all(), key


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_the_same_inputs_give_the_same_bits(parts, flight, group, name):
    for term in parts(group, name):
        first, again = run(term, flight), run(term, flight)
        assert all(torch.equal(first[key], again[key]) for key in first)


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_permuting_the_environments_permutes_the_result(parts, flight, group, name):
    for term in parts(group, name):
        usual, turned = run(term, flight), run(term, flight, rows=PERMUTATION)
        for key, value in usual.items():
            assert_close(turned[key], value[PERMUTATION], atol=1e-6, rtol=1e-6)


@pytest.mark.parametrize(("group", "name"), TERMS)
def test_one_environment_alone_gives_what_it_gives_among_others(parts, flight, group, name):
    for term in parts(group, name):
        among, alone = run(term, flight), run(term, flight, rows=torch.tensor([2]))
        for key, value in among.items():
            assert_close(alone[key], value[2:3], atol=1e-6, rtol=1e-6)


FLYING = [
    "obstacle_observation",
    "task",
    "action",
    "rate_loop",
    "dynamics",
    "vehicle",
    "estimator",
]
ENVIRONMENTS = [
    pytest.param(every_list(), id="every part of every list"),
    *(pytest.param([f"{g}={n}"], id=f"{g}/{n}") for g in FLYING for n in names(g)),
    *(
        pytest.param([f"{g}={n}", *(DRAWN_BY if g == "randomization" else [])], id=f"{g}/{n}")
        for g in LISTS
        for n in names(g)
        if is_set(g, n)
    ),
]


@pytest.fixture(scope="module")
def flown(make_env):
    """`flown(overrides)`: an environment of three, two steps into flight."""

    def fly(overrides):
        fast = [] if "obstacle_observation" in overrides[0] else ["obstacle_observation=none"]
        env = make_env("num_envs=3", *fast, *overrides, seed=5, scenes=4)
        generator = torch.Generator().manual_seed(0)
        env.restart(torch.arange(3))
        for _ in range(2):
            env.advance(torch.rand(3, 4, generator=generator) - 0.5)
        return env

    return fly


def leaves(env):
    """All that the environments are, and what is seen of them."""
    world = env.world.clone()
    seen = {("observation",): env.observation.clone()}
    return seen | {key: world[key] for key in world.keys(include_nested=True, leaves_only=True)}


@pytest.mark.parametrize("overrides", ENVIRONMENTS)
def test_the_same_seed_flies_the_same_bits_and_a_restart_touches_its_row_only(flown, overrides):
    env, same = flown(overrides), leaves(flown(overrides))
    before = leaves(env)
    env.restart(torch.tensor([1]))
    after = leaves(env)
    for key, value in before.items():
        assert torch.equal(value, same[key]), key
        assert torch.equal(value[[0, 2]], after[key][[0, 2]]), key
    assert after["clock", "step"][:, 0].tolist() == [2, 0, 2]


@pytest.mark.parametrize("name", names("search"))
def test_a_search_lays_finite_control_points(compose, name):
    config = compose(f"search={name}", "scene=random_boxes")
    layout = scene_of(config["scene"], "scene").sample(1, torch.Generator().manual_seed(0))
    planner = planner_for(search=config["search"], task=config["task"], env=config["env"])
    planned, again = planner(layout), planner(layout)
    assert planned.route_w.isfinite().all()
    assert torch.equal(planned.route_w, again.route_w)
    last = planned.route_w[0, int(planned.route_length) - 1]
    assert_close(last[:2], layout.route_w[0, -1, :2], atol=0.2, rtol=0)


@pytest.mark.parametrize("name", names("model"))
def test_a_model_gives_finite_actions_to_any_number_of_environments(load_part, name):
    model = build(load_part("model", name), "model", kind=Model)
    torch.manual_seed(3)
    policy = Policy(model, Gaussian(4), 25)
    observation = torch.rand(COUNT, 25, generator=torch.Generator().manual_seed(0))
    among, state = policy.decide(observation)
    assert among.shape == (COUNT, 4)
    assert among.isfinite().all()
    assert torch.equal(among, policy.decide(observation)[0])
    assert_close(policy.decide(observation[2:3])[0], among[2:3])
    assert (state is None) == (model.state_width == 0)
    if state is not None:  # what is remembered matters
        assert not torch.equal(policy.decide(observation, state)[0], among)


@pytest.mark.parametrize("name", ["csv", "tensorboard"])  # trackers: learning/test_trackers.py
def test_a_logger_takes_figures(load_part, tmp_path, name):
    logger = build(load_part("logger", name), "logger", kind=Logger, folder=tmp_path)
    logger.log({"episode/return": 1.0}, 1000)
    logger.attach({"success_rate": 1.0})
    logger.close()


@pytest.mark.parametrize("name", names("vehicle"))
def test_a_vehicle_can_hover(load_part, name):
    vehicle = build(load_part("vehicle", name), "vehicle")
    assert isinstance(vehicle, Vehicle)
    throttle = float(vehicle.throttle(torch.tensor(vehicle.mass_kg * 9.8 / 4)))
    assert 0.05 < throttle < 0.95
    for key, value in vehicle.parameters().items():
        assert value.shape == (1, *DECLARED[key].shape)


def bodies():
    """Vehicles, rate loops and dynamics; slow but for one vehicle of each pair of the others."""
    vehicles = names("vehicle")
    for (i, rate_loop), (j, dynamics) in itertools.product(
        enumerate(names("rate_loop")), enumerate(names("dynamics"))
    ):
        for k, vehicle in enumerate(vehicles):
            marks = [] if k == (i + j) % len(vehicles) else [pytest.mark.slow]
            yield pytest.param(vehicle, rate_loop, dynamics, marks=marks)


@pytest.mark.parametrize(("vehicle", "rate_loop", "dynamics"), list(bodies()))
def test_vehicle_rate_loop_and_dynamics_combine(make_env, vehicle, rate_loop, dynamics):
    parts = (f"vehicle={vehicle}", f"rate_loop={rate_loop}", f"dynamics={dynamics}")
    env = make_env("num_envs=2", "obstacle_observation=none", "scene=free", *parts)
    env.restart(torch.arange(2))
    for _ in range(2):
        out = env.advance(torch.zeros(2, 4))
    assert out.observation.isfinite().all()
    assert env.value_of(("state", "acceleration_w")).norm(dim=-1).max() < 12


@pytest.mark.parametrize("name", names("curriculum"))
def test_a_curriculum_gives_difficulties_between_zero_and_one(load_part, name):
    for term in build_terms(load_part("curriculum", name), "curriculum", kinds.Curriculum):
        assert type(term).__doc__
        assert all(0 <= level <= 1 for level in term.levels)
        assert list(term.levels) == sorted(set(term.levels))
        before = {key: torch.full((1, 1), value) for key, value in term.initial.items()}
        assert set(before) == set(term.outputs)
        for share in (0.0, 0.4, 1.0):
            flown = {EPISODE_DIFFICULTY: torch.ones(3, 1), EPISODE_SUCCESS: torch.ones(3, 1).bool()}
            tensors = {**before, **flown, TRAINED_SHARE: torch.full((1, 1), share)}
            again = dict(tensors)
            term.run(tensors)
            term.run(again)
            for key, value in tensors.items():
                assert torch.equal(value, again[key]), key
                assert key in before or key in (*flown, TRAINED_SHARE)
            assert tensors[CURRICULUM_DIFFICULTY].shape == (1, 1)
            assert 0 <= float(tensors[CURRICULUM_DIFFICULTY]) <= 1


@pytest.mark.parametrize("name", names("scene"))
@pytest.mark.parametrize("count", [1, 5])
def test_a_scene_lays_out_finite_scenes(load_part, name, count):
    scene = scene_of(load_part("scene", name), "scene")
    layout, again = (scene.sample(count, torch.Generator().manual_seed(0)) for _ in range(2))
    assert len(layout) == count
    fields = ("boxes_w", "pillars_w", "origin_w", "size", "start_w", "route_w", "route_length")
    for field in fields:
        assert getattr(layout, field).shape[0] == count
        assert getattr(layout, field).isfinite().all()
        assert torch.equal(getattr(layout, field), getattr(again, field))
    inside = (layout.start_w[:, :2] > layout.origin_w) & (
        layout.start_w[:, :2] < layout.origin_w + layout.size
    )
    assert inside.all()


def test_every_file_says_what_it_is_for_or_what_it_builds():
    for path in CONF.glob("*/*.yaml"):
        said = path.read_text().startswith("#")
        assert said or "_target_" in OmegaConf.load(path).get(path.stem, {}), path
