"""Every row flies one episode, and what is written down of it is what happened."""

import pytest
import torch

from resc import keys
from resc.errors import ConfigError
from resc.evaluation.setting import Rules
from resc.flying.flights import fly
from resc.flying.pilot import PolicyPilot
from resc.recording.reader import RolloutLog

STEP_M = 2.5 * 0.02
"""More than a flight covers in one step."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the flights are recorded."""
    return tmp_path_factory.mktemp("rollouts")


@pytest.fixture(scope="module")
def flights(corridor, flying, policy, evaluation, stored, folder):
    """Six flights round the wall; the last two straight into it."""
    course = corridor(6)
    env = flying([course])
    env.pool.tasks[keys.ROUTE_W][4:, 0] = torch.tensor([4.5, 1.0, 1.0])
    env.pool.tasks[keys.ROUTE_LENGTH][4:] = 1
    rules = Rules(evaluation("recorder=mcap"), stored, own_routes=False)
    recorder = rules.recorded.open(env.stages, directory=folder, num_envs=6)
    with recorder:
        return course, fly(env, PolicyPilot(policy), recorder=recorder)


@pytest.fixture(scope="module")
def log(flights, folder):
    """What was recorded of them."""
    del flights
    return RolloutLog(folder)


def test_flights_round_a_wall_arrive_and_flights_into_it_collide(flights):
    _, flown = flights
    assert flown.names == ["success"] * 4 + ["contact"] * 2
    assert flown.collided.tolist() == [False] * 4 + [True] * 2
    assert flown.success_rate == pytest.approx(4 / 6)
    assert flown.collision_rate == pytest.approx(2 / 6)


def test_collision_is_at_the_surface_of_the_wall(flights):
    course, flown = flights
    end = flown.position_w[int(flown.steps[5]), 5]
    assert end[0] == pytest.approx(2.5, abs=STEP_M)
    assert flown.metrics["least_clearance"][5] <= 0
    assert len(course.planned_m) == 6


def test_finished_flights_wait_in_their_last_state(flights):
    _, flown = flights
    assert len(set(flown.steps.tolist())) > 1
    for number, steps in enumerate(flown.steps.tolist()):
        assert (flown.position_w[steps:, number] == flown.position_w[steps, number]).all()
        moved = (flown.position_w[1 : steps + 1, number] - flown.position_w[:steps, number]).norm(
            dim=-1
        )
        assert (moved[5:] > 0).all()


def test_path_length_is_that_of_the_trajectory_up_to_the_finish(flights):
    _, flown = flights
    for number, counted in enumerate(flown.counted.tolist()):
        moved = flown.position_w[: counted + 1, number].diff(dim=0).norm(dim=-1).sum()
        torch.testing.assert_close(flown.metrics["path_length"][number], moved, atol=5e-3, rtol=0)


def test_flights_go_on_for_a_second_after_they_arrive(flights):
    _, flown = flights
    assert (flown.steps - flown.counted)[:4].tolist() == [50] * 4
    assert (flown.steps - flown.counted)[4:].tolist() == [0] * 2


def test_time_within_half_a_metre_is_when_the_trajectory_comes_that_near(flights):
    _, flown = flights
    goal = torch.tensor([4.5, 1.0, 1.0])
    near = (flown.position_w[:, 0] - goal).norm(dim=-1) <= 0.5
    assert flown.metrics["time_within_half_metre"][0] == pytest.approx(
        0.02 * int(near.int().argmax())
    )


def test_part_of_the_flights_keeps_their_numbers(flights):
    _, flown = flights
    part = flown.rows(4, 6)
    assert part.names == ["contact"] * 2
    assert torch.equal(part.position_w[:, 1], flown.position_w[:, 5])
    assert torch.equal(part.metrics["energy"], flown.metrics["energy"][4:])


def test_without_trace_only_the_start_is_kept(corridor, flying, policy):
    env = flying([corridor(1)], "termination.time_limit.limit_s=0.1")
    assert fly(env, PolicyPilot(policy), trace=False).position_w.shape == (1, 1, 3)


def test_flights_that_may_never_end_are_refused(corridor, flying, policy):
    with pytest.raises(ConfigError, match="no time limit"):
        fly(flying([corridor(1)], "~termination.time_limit"), PolicyPilot(policy))


def test_time_limit_ends_a_flight(corridor, flying, policy):
    env = flying([corridor(1)], "termination.time_limit.limit_s=0.5")
    flown = fly(env, PolicyPilot(policy))
    assert flown.names == ["time_limit"]
    assert flown.steps.tolist() == [25]


def test_recording_holds_the_trajectories(flights, log):
    _, flown = flights
    ended = log.episodes
    assert sorted(ended["env_id"]) == list(range(6))
    for number in range(6):
        episode = ended["env_id"].to_list().index(number)
        steps = int(flown.steps[number])
        assert ended["length"][episode] == steps
        recorded = log.episode(episode)
        assert torch.equal(recorded["state", "position_w"], flown.position_w[:steps, number])
        assert recorded["terminated"][:, 0].nonzero()[:, 0].tolist() == [steps - 1]


def test_recording_of_waiting_rows_ends_and_earns_nothing(flights, log):
    _, flown = flights
    whole = log.to_tensordict()
    assert int((whole["terminated"] | whole["truncated"]).sum()) == 6
    first = int(flown.steps.argmin())
    assert (whole["reward"][int(flown.steps[first]) :, first] == 0).all()


def test_recording_names_outcomes_and_returns(flights, log):
    _, flown = flights
    rows = log.episodes["env_id"].to_torch()
    assert torch.equal(log.episodes["success"].to_torch(), flown.success[rows])
    returns = log.to_tensordict()["reward"].sum((0, 2))[rows]
    torch.testing.assert_close(log.episodes["return_"].to_torch(), returns, atol=1e-4, rtol=1e-4)
