"""Terms of one's own that are wrong: named before anything flies, with what was expected."""

import pytest
import torch

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.envs.terms import Terms
from resc.errors import ConfigError
from resc.learning.curriculum import Curricula
from resc.setup import build_stages, set_up
from resc.simulation.vehicle import hovering
from resc.term import (
    Action,
    Curriculum,
    Metric,
    Observation,
    Randomization,
    Reward,
    Sensor,
    Term,
    Termination,
)


@pytest.fixture(scope="module")
def try_out(compose):
    """`try_out(term, group)`: builds the default environment with one more term in a group."""
    config = compose("scene=free", "scene.proposals=1")
    pool = set_up(config, size=2, seed=0).pool

    def make(term, group):
        stages = build_stages(config)
        terms = {name: getattr(stages.terms, name) for name in Terms.__dataclass_fields__}
        single = isinstance(terms[group], Term)
        named = term.named(group if single else "mine")
        terms[group] = named if single else [*terms[group], named]
        return QuadrotorEnv(
            Stages(Terms(**terms), stages.context), pool, num_envs=2, compiled=False
        )

    return make


def a(kind, compute, **attributes):
    """A term of a kind whose `compute` is the function, reading the position unless told."""
    members = {"reads": (keys.POSITION_W,), "compute": staticmethod(compute), **attributes}
    made = type("Mine", (kind,), members)
    return made(weight=1.0) if kind is Reward else made()


def column(position):
    return position[:, :1]


REWARDS = {
    "flat": (lambda p: p[:, 0], r"^reward\.mine gives \[n\]; expected \[n, 1\]"),
    "broadcast": (lambda p: p[:1, :1] * 1, r"reward\.mine gives \[1, 1\]; expected \[n, 1\]"),
    "crossed": (lambda p: p[:, :1] - p[:, 0], r"reward\.mine gives \[n, n\]; expected \[n, 1\]"),
    "vector": (lambda p: p * 1, r"reward\.mine gives \[n, 3\]; expected \[n, 1\]"),
    "double": (lambda p: column(p).double(), r"reward\.mine gives float64; expected float32"),
    "flag": (lambda p: column(p) > 0, r"reward\.mine gives bool; expected float32"),
    "nan": (lambda p: column(p) * float("nan"), r"reward\.mine gives nan .*expected finite"),
    "infinite": (lambda p: 1 / (0 * column(p)), r"reward\.mine gives inf .*expected finite"),
    "number": (lambda p: 1.0, r"reward\.mine gives float; expected a tensor"),
    "nothing": (lambda p: None, r"reward\.mine gives NoneType; expected a tensor"),
    "two": (lambda p: (column(p), column(p)), r"reward\.mine gives 2 tensors; expected 1"),
    "raises": (
        lambda p: column(p) @ p,
        r"reward\.mine cannot be computed \(RuntimeError: .*gets state\.position_w \[n, 3\]\.$",
    ),
    "signature": (
        lambda p, q: p,
        r"reward\.mine cannot be computed \(TypeError: .*gets state\.position_w \[n, 3\]\.$",
    ),
    "in place": (
        lambda p: p.add_(1.0)[:, :1] * 1,
        r"reward\.mine changes state\.position_w in place",
    ),
}


@pytest.mark.parametrize("case", REWARDS)
def test_a_wrong_reward_is_named_with_what_was_expected(try_out, case):
    compute, message = REWARDS[case]
    with pytest.raises(ConfigError, match=message):
        try_out(a(Reward, compute), "rewards")


def test_a_term_without_a_compute_is_named(try_out):
    made = type("Mine", (Reward,), {"reads": (keys.POSITION_W,)})
    with pytest.raises(ConfigError, match=r"reward\.mine: Mine has no compute\(\)"):
        try_out(made(weight=1.0), "rewards")


OTHERS = {
    "an observation with a column too many": (
        a(Observation, lambda p: p * 1, columns=("x", "y")),
        "observations",
        r"observation\.mine gives \[n, 3\]; expected \[n, 2\]",
    ),
    "an observation with a column too few": (
        a(Observation, lambda p: p[:, :1] * 1, columns=("x", "y")),
        "observations",
        r"observation\.mine gives \[n, 1\]; expected \[n, 2\]",
    ),
    "an observation that is not finite": (
        a(Observation, lambda p: p.clone().fill_(float("nan")), columns=("x", "y", "z")),
        "observations",
        r"observation\.mine gives nan in column 0 .*expected finite",
    ),
    "columns that are a word": (
        a(Observation, column, columns="x"),
        "observations",
        r"observation\.mine has the columns 'x'; expected a tuple",
    ),
    "an observation without columns": (
        a(Observation, column),
        "observations",
        r"observation\.mine has no columns",
    ),
    "a termination of numbers": (
        a(Termination, column),
        "terminations",
        r"termination\.mine gives float32; expected bool",
    ),
    "a flat termination": (
        a(Termination, lambda p: p[:, 0] > 0),
        "terminations",
        r"termination\.mine gives \[n\]; expected \[n, 1\]",
    ),
    "a flat metric": (
        a(Metric, lambda so_far, p: p[:, 0]),
        "metrics",
        r"metric\.mine gives \[n\]; expected \[n, 1\]",
    ),
    "a metric that changes its last value": (
        a(Metric, lambda so_far, p: so_far.add_(p[:, :1])),
        "metrics",
        r"metric\.mine changes .* in place",
    ),
    "a sensor of another shape than its key": (
        a(Sensor, lambda p: p * 1, writes=(keys.SURFACE_CLEARANCE,)),
        "sensors",
        r"sensor\.mine gives \[n, 3\]; expected \[n, 1\]",
    ),
    "a sensor of one's own without environments": (
        a(Sensor, lambda p: p.sum()),
        "sensors",
        r"sensor\.mine gives \[\]; expected \[n, \.\.\.\]",
    ),
    "a sensor in double precision": (
        a(Sensor, lambda p: p.double()),
        "sensors",
        r"sensor\.mine gives float64; expected float32",
    ),
    "a randomization of another width": (
        a(Randomization, lambda m: m.expand(-1, 3), reads=(keys.MASS,), writes=(keys.MASS,)),
        "randomizations",
        r"randomization\.mine gives \[n, 3\]; expected \[n, 1\]",
    ),
    "an action of another type": (
        a(
            Action,
            lambda action, queue: (queue * 1, action[:, :3].double(), action[:, 3:]),
            reads=(keys.ACTION, keys.ACTION_QUEUE),
            writes=(keys.ACTION_QUEUE, keys.BODY_RATE_COMMAND_B, keys.COLLECTIVE_THRUST),
            width=4,
            initial={keys.ACTION_QUEUE: 0.0},
            dims={"d": 2},
        ),
        "action",
        r"action for command\.body_rate_b gives float64; expected float32",
    ),
    "dynamics that forget an output": (
        a(Term, lambda p: p * 1, writes=(keys.POSITION_W, keys.VELOCITY_W, keys.ATTITUDE_WB,
          keys.BODY_RATE_B, keys.ROTOR_THRUST, keys.ACCELERATION_W),
          begin=lambda _, t: hovering(t)),
        "dynamics",
        r"dynamics gives 1 tensors; expected 6",
    ),
    "dynamics without a beginning": (
        a(Term, lambda p: p * 1, writes=(keys.ROTOR_THRUST,)),
        "dynamics",
        r"dynamics does not say what state\.rotor_thrust is at the beginning of an episode",
    ),
    "a task that never ends": (
        a(Term, lambda p: p * 1, writes=(keys.CONTROL_POINTS_W,), section="task"),
        "task",
        r"does not write task\.finished, by which episodes succeed",
    ),
    "reads without a comma": (
        a(Reward, column, reads=keys.POSITION_W),
        "rewards",
        r"reward\.mine reads 'state', which is not a key",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", OTHERS)
def test_any_kind_of_wrong_term_is_named_with_what_was_expected(try_out, case):
    term, group, message = OTHERS[case]
    with pytest.raises(ConfigError, match=message):
        try_out(term, group)


CURRICULA = {
    "flat": (lambda s: s[:, 0], r"curriculum\.mine gives \[1\]; expected \[1, 1\]"),
    "nan": (lambda s: s * float("nan"), r"curriculum\.mine gives nan"),
    "raises": (lambda s: s.nowhere, r"curriculum\.mine cannot be computed \(AttributeError"),
}


@pytest.mark.parametrize("case", CURRICULA)
def test_a_wrong_curriculum_is_named_with_what_was_expected(make_env, case):
    compute, message = CURRICULA[case]
    term = a(
        Curriculum, compute, reads=(keys.TRAINED_SHARE,), levels=(0.0, 1.0),
        initial={keys.CURRICULUM_DIFFICULTY: 0.0},
    )  # fmt: skip
    env = make_env(
        "scene.difficulty=mine",
        "task.initial_state.difficulty=null",
        "scene=free",
        "reward=[progress,time]",
        "reward.progress.difficulty=null",
        "reward.time.difficulty=null",
    )
    with pytest.raises(ConfigError, match=message):
        Curricula([term.named("mine")], env)


def test_a_right_term_passes_and_keeps_its_own_compute(try_out):
    term = a(Reward, column)
    env = try_out(term, "rewards")
    assert term in env.stages.terms.rewards
    assert "compute" not in vars(term)


def test_the_trial_draws_nothing_from_anyone(compose):
    config = compose("randomization=[mass]", "observation.velocity.noise=0.1")
    torch.manual_seed(7)
    untouched = torch.rand(3)
    torch.manual_seed(7)
    setup = set_up(config, size=2, seed=0)
    pool = setup.pool
    state = pool.generator.get_state()
    env = setup.env(4, compiled=False)
    assert torch.equal(pool.generator.get_state(), state)
    assert torch.equal(torch.rand(3), untouched)
    fresh = setup.env(4, compiled=False).generator_states()
    for name, state in env.generator_states().items():
        assert torch.equal(state, fresh[name])
    assert not env._world
