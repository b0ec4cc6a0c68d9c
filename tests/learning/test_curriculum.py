"""Curricula in a run: who reads what, what is eased, and that nothing else changes."""

import pytest
import torch
from matplotlib import pyplot as plt
from test_ppo import SMALL, weights

from resc import keys
from resc.build import build_terms
from resc.errors import ConfigError
from resc.flying.episodes import EpisodeStatistics
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.learning_curve import draw_learning_curve
from resc.learning.training_run import TrainingRun
from resc.term import Curriculum

FIXED = "resc.terms.curricula.fixed.Fixed"
UNREAD = ("scene.difficulty=null", "task.initial_state.difficulty=null")
LINEAR = (
    "curriculum=linear",
    "curriculum.obstacles.share=0.5",
    "~curriculum.initial_state.value",
    "curriculum.initial_state._target_=resc.terms.curricula.linear.Linear",
    "+curriculum.initial_state.share=0.5",
)
SUCCESS = (
    "curriculum=success",
    "curriculum.obstacles.episodes=2",
    "curriculum.obstacles.raise_above=0.02",
    "curriculum.obstacles.lower_below=0.01",
)
SWITCH = ("curriculum=free_then_obstacles", "curriculum.obstacles.share=0.25")
KINDS = {"linear": LINEAR, "success": SUCCESS, "free_then_obstacles": SWITCH}


@pytest.fixture
def make_trainer(compose):
    return lambda *overrides: TrainingRun(
        compose(*SMALL, "obstacle_observation=none", "reward=paper2025", *overrides)
    ).trainer()


def at(value, *names):
    """Overrides that fix difficulties at a value."""
    return [f"curriculum.{name}.value={value}" for name in names or ("obstacles", "initial_state")]


def test_a_difficulty_that_nothing_reads_is_refused(make_trainer):
    with pytest.raises(
        ConfigError,
        match=r"curriculum\.obstacle writes the difficulty 'obstacle', which nothing reads; drop "
        r"it \(~curriculum\.obstacle\).*Did you mean 'obstacles'",
    ):
        make_trainer(f"+curriculum.obstacle={{_target_:{FIXED}}}")


def test_an_optional_difficulty_rests_where_nothing_reads_it(make_trainer):
    trainer = make_trainer(f"+curriculum.obstacle={{_target_:{FIXED},optional:true}}")
    assert "obstacle" not in trainer.curricula.difficulties
    assert "obstacles" in trainer.curricula.difficulties


def test_optional_is_true_or_false(make_trainer):
    with pytest.raises(ConfigError, match=r"curriculum\.obstacle\.optional is 'perhaps'; expected"):
        make_trainer(f"+curriculum.obstacle={{_target_:{FIXED},optional:perhaps}}")


@pytest.mark.parametrize("path", ["scene", "task.initial_state", "reward.crash"])
def test_a_difficulty_that_nothing_writes_is_refused_with_its_reader(make_trainer, path):
    with pytest.raises(
        ConfigError,
        match=rf"{path}\.difficulty is 'winds', which no curriculum writes; add curriculum\.winds",
    ):
        make_trainer("~curriculum", *UNREAD, f"++{path}.difficulty=winds")


def test_a_part_that_cannot_be_eased_is_refused(make_trainer):
    with pytest.raises(
        ConfigError, match=r"sensor\.euler\.difficulty is 'obstacles', but Euler has nothing"
    ):
        make_trainer("+sensor.euler.difficulty=obstacles")


@pytest.mark.parametrize("path", ["scene", "task.initial_state", "reward.crash"])
def test_the_name_of_a_difficulty_is_a_name(make_trainer, path):
    with pytest.raises(ConfigError, match=rf"{path}\.difficulty is 0\.5; expected"):
        make_trainer(f"++{path}.difficulty=0.5")


def test_without_a_curriculum_training_is_what_it_is_with_full_difficulty(make_trainer):
    plain = make_trainer("~curriculum", *UNREAD)
    fixed = make_trainer()
    for _ in range(3):
        plain.iterate()
        fixed.iterate()
    assert torch.equal(weights(plain), weights(fixed))
    assert torch.equal(plain.env.observation, fixed.env.observation)


def test_at_difficulty_zero_episodes_begin_level_at_rest_and_among_no_obstacles(make_trainer):
    env = make_trainer(*at(0.0)).env
    assert (env.value_of(keys.VELOCITY_W) == 0).all()
    assert (env.value_of(keys.BODY_RATE_B) == 0).all()
    assert (env.value_of(keys.ATTITUDE_WB)[:, 1:3] == 0).all()
    assert (env.pool.shared[keys.ESDF] == 3.0).all()


def test_half_the_difficulty_halves_the_initial_speed(make_trainer):
    full, half = make_trainer().env, make_trainer(*at(0.5)).env
    torch.testing.assert_close(
        half.value_of(keys.VELOCITY_W).norm(dim=-1),
        full.value_of(keys.VELOCITY_W).norm(dim=-1) / 2,
    )


def test_a_difficulty_scales_the_weight_of_a_reward_alone(make_trainer):
    eased = ["reward.time.difficulty=hurry", f"+curriculum.hurry={{_target_:{FIXED},value:0.25}}"]
    full, quarter = make_trainer("reward.time.difficulty=null"), make_trainer(*eased)
    full.collector.collect()
    quarter.collector.collect()
    names = [term.name for term in full.env.stages.terms.rewards]
    scale = torch.tensor([0.25 if name == "time" else 1.0 for name in names])
    torch.testing.assert_close(quarter.batch["reward_terms"], full.batch["reward_terms"] * scale)


def test_a_difficulty_widens_limits(make_trainer):
    eased = (
        "+termination.attitude.difficulty=limits",
        "+sensor.limit_violations.difficulty=limits",
        f"+curriculum.limits={{_target_:{FIXED},value:0.5}}",
    )
    env = make_trainer(*eased).env
    tilted = torch.tensor([[1.5, 0.0, 0.0], [1.6, 0.0, 0.0]])  # limit 1.0472 x 1.5 = 1.5708
    attitude = next(t for t in env.stages.terms.terminations if t.name == "attitude")
    tensors = {keys.EULER: tilted, keys.difficulty("limits"): torch.full((2, 1), 0.5)}
    attitude.run(tensors)
    assert tensors["termination", "attitude"].tolist() == [[False], [True]]
    tensors |= {keys.VELOCITY_W: torch.tensor([[4.4, 0.0, 0.0], [4.6, 0.0, 0.0]])}  # 3 x 1.5
    tensors |= {keys.ACCELERATION_W: torch.tensor([[0.0, 0.0, 8.9], [0.0, 0.0, 9.1]])}  # 6 x 1.5
    next(t for t in env.stages.terms.sensors if t.name == "limit_violations").run(tensors)
    assert tensors[keys.LIMIT_VIOLATIONS][:, :2].tolist() == [[0, 0], [1, 1]]


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_resuming_a_curriculum_equals_the_run_that_never_stopped(make_trainer, kind, tmp_path):
    whole, resumed = make_trainer(*kind), make_trainer(*kind)
    for _ in range(3):
        whole.iterate()
    save_checkpoint(tmp_path / "checkpoint.pt", whole)
    load_checkpoint(tmp_path / "checkpoint.pt", resumed)
    assert resumed.curricula.state() == whole.curricula.state()
    for _ in range(2):
        whole.iterate()
        resumed.iterate()
    assert resumed.curricula.difficulties == whole.curricula.difficulties
    assert resumed.curricula.state() == whole.curricula.state()
    assert torch.equal(weights(whole), weights(resumed))
    assert torch.equal(whole.env.observation, resumed.env.observation)
    assert whole.statistics.success_by_difficulty(whole.curricula.active) == (
        resumed.statistics.success_by_difficulty(resumed.curricula.active)
    )


def test_a_curriculum_changes_no_random_draw_of_another_part(make_trainer):
    states = []
    for kind in ((), *KINDS.values()):
        trainer = make_trainer("randomization=[mass,inertia]", *kind)
        env = trainer.env
        draws = {name: generator.get_state() for name, generator in env.generators.items()}
        routes, mass = env.pool.tasks[keys.ROUTE_W], env.value_of(keys.MASS).clone()
        states.append((draws, env.pool.generator.get_state(), routes, mass, weights(trainer)))
    for other in states[1:]:
        torch.testing.assert_close(other, states[0], rtol=0, atol=0)


def test_linear_is_where_its_frames_are_and_new_episodes_begin_there(make_trainer):
    trainer = make_trainer(*LINEAR)  # batches of 128 frames
    for expected in (0.25, 0.5, 0.75, 1.0, 1.0):
        trainer.iterate()
        assert trainer.curricula.difficulties == {"obstacles": expected, "initial_state": expected}
    trainer.env.restart(torch.arange(8))
    assert (trainer.env.value_of(("difficulty", "initial_state")) == 1.0).all()
    assert (trainer.env.value_of(("difficulty", "obstacles")) == 1.0).all()


def test_the_switch_holds_for_the_very_next_episode_without_renewal(make_trainer):
    trainer = make_trainer(*SWITCH, "renew_scenes=0")
    assert (trainer.env.value_of(("difficulty", "obstacles")) == 0.0).all()
    for _ in range(2):
        trainer.iterate()
    trainer.env.restart(torch.arange(8))
    assert (trainer.env.value_of(("difficulty", "obstacles")) == 1.0).all()


def test_episodes_keep_the_difficulty_they_began_with(make_trainer):
    trainer = make_trainer(*LINEAR)
    trainer.env.set_difficulty("initial_state", 0.75)
    before = trainer.env.value_of(("difficulty", "initial_state")).clone()
    trainer.env.advance(torch.zeros(8, 4))
    trainer.env.restart(torch.tensor([3]))
    flown = trainer.env.value_of(("difficulty", "initial_state"))
    assert flown[3] == 0.75
    assert torch.equal(flown[[0, 1, 2, 4, 5, 6, 7]], before[[0, 1, 2, 4, 5, 6, 7]])


def test_finished_episodes_carry_the_difficulties_they_were_flown_at(make_trainer):
    trainer = make_trainer(*LINEAR, "renew_scenes=0")
    for _ in range(6):
        trainer.iterate()
        episodes = trainer.statistics.episodes()
        if episodes is None:
            continue
        flown = trainer.env.pool.tasks[keys.SCENE_DIFFICULTY][episodes["scene"], 0]
        assert torch.equal(episodes["difficulties", "obstacles"], flown)
        assert episodes["difficulty"].shape == episodes["scene"].shape
    assert trainer.statistics.total > 0


class Overshooting(Curriculum):
    """Asks for more than there is."""

    reads = (keys.TRAINED_SHARE,)
    initial = {keys.CURRICULUM_DIFFICULTY: 0.0}  # noqa: RUF012
    levels = (0.0, 1.0)

    def compute(self, trained):
        return 2 * trained


def test_a_difficulty_is_kept_between_zero_and_one(make_trainer):
    trainer = make_trainer()
    trainer.curricula.terms = [Overshooting().named("obstacles")]
    trainer.curricula.memory["obstacles"] = {keys.CURRICULUM_DIFFICULTY: torch.zeros(1, 1)}
    trainer.curricula.advance(1.0, None)
    assert trainer.curricula.difficulties["obstacles"] == 1.0


def test_figures_name_only_what_is_not_full_throughout(make_trainer):
    assert make_trainer().curricula.figures() == {}
    assert make_trainer(*SWITCH).curricula.figures() == {"difficulty/obstacles": 0.0}
    eased = make_trainer(*at(0.5, "obstacles")).curricula.figures()
    assert eased == {"difficulty/obstacles": 0.5}


def test_success_is_reported_by_bins_of_difficulty():
    statistics = EpisodeStatistics(
        1, ("success", "collision", "cut"), torch.device("cpu"), ("obstacles",)
    )
    flown = [(0, 0.0), (1, 0.0), (0, 0.1), (0, 0.6), (1, 1.0), (2, 1.0), (2, 0.3)]
    statistics.recent.extend((code, 0.0, 1, (level,)) for code, level in flown)
    shares = statistics.success_by_difficulty(["obstacles"])
    assert shares == {
        "success_by_obstacles/0.0-0.2": pytest.approx(2 / 3),
        "success_by_obstacles/0.6-0.8": 1.0,
        "success_by_obstacles/0.8-1.0": 0.0,
    }


def test_the_terms_of_a_curriculum_are_curricula(compose):
    with pytest.raises(ConfigError, match="which is not a Curriculum"):
        build_terms({"obstacles": compose().sensor.euler}, "curriculum", Curriculum)


def test_the_learning_curve_shows_difficulty_and_success_against_it(make_trainer, tmp_path):
    rows = []
    trainer = make_trainer(*LINEAR)
    for _ in range(4):
        trainer.iterate()
        figures = trainer.curricula.figures()
        figures |= trainer.statistics.success_by_difficulty(trainer.curricula.active)
        plain = {"frames": trainer.frames / 1, "outcome/success": 0.5, "reward/time": -1.0}
        rows.append({**plain, **figures})
    draw_learning_curve(rows, tmp_path / "eased.png")
    draw_learning_curve(
        [{name: row[name] for name in plain} for row in rows], tmp_path / "plain.png"
    )
    heights = [plt.imread(tmp_path / name).shape[0] for name in ("eased.png", "plain.png")]
    assert heights[0] == pytest.approx(2 * heights[1], abs=10)  # two more panels: a second row
