import pytest
import torch

from resc.errors import ConfigError
from resc.keys import CURRICULUM_DIFFICULTY
from resc.terms.curricula.fixed import Fixed
from resc.terms.curricula.linear import Linear
from resc.terms.curricula.success import EPISODES, SUCCESSES, Success
from resc.terms.curricula.switch import Switch


def after(term, *shares):
    return [float(term.compute(torch.tensor([[share]]))) for share in shares]


def decide(term, difficulty, flown_at, succeeded, tally=(0.0, 0.0)):
    """Difficulty, episodes and successes after a batch of finished episodes."""
    result = term.compute(
        torch.tensor([[difficulty]]),
        torch.tensor([[tally[0]]]),
        torch.tensor([[tally[1]]]),
        torch.tensor(flown_at).reshape(-1, 1),
        torch.tensor(succeeded, dtype=torch.bool).reshape(-1, 1),
    )
    return tuple(float(value) for value in result)


def test_fixed_stays_where_it_is():
    assert after(Fixed(), 0.0, 1.0) == [1.0, 1.0]
    assert after(Fixed(value=0.25), 0.0, 1.0) == [0.25, 0.25]
    assert Fixed(value=0.25).levels == (0.25,)


def test_linear_rises_evenly_and_stops_at_its_end():
    term = Linear(share=0.5)
    assert after(term, 0.0, 0.125, 0.25, 0.5, 1.0) == [0.0, 0.25, 0.5, 1.0, 1.0]
    assert term.initial == {CURRICULUM_DIFFICULTY: 0.0}
    assert term.levels == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_linear_falls_where_it_ends_lower():
    term = Linear(share=1.0, first=0.8, last=0.2, levels=3)
    assert after(term, 0.0, 0.5, 1.0) == pytest.approx([0.8, 0.5, 0.2])
    assert term.levels == pytest.approx([0.2, 0.5, 0.8])


def test_linear_keeps_its_first_value_for_a_while():
    term = Linear(share=0.75, after=0.25, first=1.0, last=0.5)
    assert after(term, 0.0, 0.25, 0.5, 0.75, 1.0) == [1.0, 1.0, 0.75, 0.5, 0.5]


@pytest.mark.parametrize("begins", [-0.1, 0.5, 0.6])
def test_linear_begins_before_it_ends(begins):
    with pytest.raises(ConfigError, match=f"after is {begins}; expected a share of the run below"):
        Linear(share=0.5, after=begins)


def test_switch_is_one_thing_and_then_the_other():
    assert after(Switch(share=0.25), 0.0, 0.249, 0.25, 1.0) == [0.0, 0.0, 1.0, 1.0]


def test_success_raises_the_difficulty_by_a_level_and_counts_anew():
    term = Success(episodes=4, raise_above=0.7, lower_below=0.3, levels=5)
    assert decide(term, 0.25, [0.25] * 4, [1, 1, 1, 0]) == (0.5, 0.0, 0.0)


def test_failure_lowers_the_difficulty_by_a_level():
    term = Success(episodes=4, raise_above=0.7, lower_below=0.3, levels=5)
    assert decide(term, 0.5, [0.5] * 4, [0, 0, 0, 1]) == (0.25, 0.0, 0.0)


def test_in_between_the_difficulty_stays_and_counting_begins_anew():
    term = Success(episodes=4, raise_above=0.7, lower_below=0.3, levels=5)
    assert decide(term, 0.5, [0.5] * 4, [1, 1, 0, 0]) == (0.5, 0.0, 0.0)


def test_too_few_episodes_decide_nothing_but_are_remembered():
    term = Success(episodes=4, raise_above=0.7, lower_below=0.3)
    assert decide(term, 0.0, [0.0] * 3, [1, 1, 1]) == (0.0, 3.0, 3.0)
    assert decide(term, 0.0, [0.0], [1], tally=(3.0, 3.0))[0] == pytest.approx(1 / 3, abs=1e-6)


def test_episodes_begun_at_another_difficulty_do_not_count():
    term = Success(episodes=2, raise_above=0.7, lower_below=0.3, levels=3)
    assert decide(term, 0.5, [0.0, 0.0, 1.0, 0.5], [1, 1, 1, 0]) == (0.5, 1.0, 0.0)


@pytest.mark.parametrize(("difficulty", "won", "expected"), [(1.0, 1, 1.0), (0.0, 0, 0.0)])
def test_difficulty_stays_in_its_bounds(difficulty, won, expected):
    term = Success(episodes=2)
    assert decide(term, difficulty, [difficulty] * 2, [won] * 2) == (expected, 0.0, 0.0)


def test_a_climb_level_by_level_ends_on_full_difficulty():
    term = Success(episodes=1, levels=8)
    difficulty = 0.0
    for _ in range(7):
        (difficulty, *_) = decide(term, difficulty, [difficulty], [1])
    assert difficulty == 1.0


def test_a_batch_without_a_finished_episode_changes_nothing():
    assert decide(Success(), 0.0, [], [], tally=(5.0, 2.0)) == (0.0, 5.0, 2.0)
    assert Success().initial == {CURRICULUM_DIFFICULTY: 0.0, EPISODES: 0.0, SUCCESSES: 0.0}


@pytest.mark.parametrize(
    ("kind", "wrong", "words"),
    [
        (Fixed, {"value": 1.5}, r"value is 1\.5"),
        (Linear, {"share": 0.0}, "share is 0.0"),
        (Linear, {"share": 5e6}, "share is 5000000.0; expected a share of the run"),
        (Linear, {"share": 0.5, "last": -0.1}, r"last is -0\.1"),
        (Linear, {"share": 0.5, "levels": 1}, "levels is 1"),
        (Linear, {"share": 0.5, "first": 1.0}, "two ends"),
        (Switch, {"share": 1.0}, "share is 1.0"),
        (Success, {"episodes": 0}, "episodes is 0"),
        (Success, {"lower_below": 0.9}, r"lower_below is 0\.9"),
        (Success, {"levels": 3, "first": 0.4}, r"first is 0\.4"),
    ],
)
def test_numbers_that_make_no_curriculum_are_refused(kind, wrong, words):
    with pytest.raises(ConfigError, match=words):
        kind(**wrong)
