"""Swapping one part changes no other part's random draws.

A part draws from its own generator. If that stands at the same state after the same flight, it has
given the same numbers; the parts here are all that draw: scenes and their choice, initial states,
randomisations, sensor noise, exploration, the order of minibatches.
"""

import pytest
import torch

from resc.learning.training_run import TrainingRun

DRAWING = [
    "num_envs=4",
    "pool_size=16",
    "renew_scenes=0",
    "total_frames=12",
    "algorithm.steps=3",
    "algorithm.minibatch=12",
    "algorithm.epochs=1",
    "model.hidden=[8]",
    "obstacle_observation=depth_scan",
    "observation.velocity.noise=0.1",
    "observation.attitude.noise=0.05",
    "randomization=[mass,inertia,thrust_map,action_delay]",
]
EVERYBODY = {
    "pool",
    "scene",
    "initial_state",
    "mass",
    "inertia",
    "thrust_map",
    "action_delay",
    "observation.depth_scan",
    "observation.velocity.noise",
    "observation.attitude.noise",
    "exploration",
    "minibatches",
}
SWAPS = {
    # override: the parts whose draws it may change
    "obstacle_observation=kgp_esdf": {"observation.depth_scan"},
    "obstacle_observation=none": {"observation.depth_scan"},
    "observation.depth_scan.beams=8": {"observation.depth_scan"},
    "observation.depth_scan.noise=0.1": {"observation.depth_scan.noise"},
    "observation.velocity.noise=0.0": {"observation.velocity.noise"},
    "observation.velocity.noise=0.3": set(),
    "~observation.velocity": {"observation.velocity.noise"},
    "~observation.body_x": set(),
    "env.observation_frame=world": set(),
    "env.history=2": set(),
    "randomization=[inertia,thrust_map,action_delay]": {"mass"},
    "randomization=[mass,thrust_map,action_delay]": {"inertia"},
    "randomization=[action_delay,thrust_map,inertia,mass]": set(),
    "randomization=[]": {"mass", "inertia", "thrust_map", "action_delay"},
    "task=from_rest": {"initial_state"},
    "scene=free": {"pool"},
    "scene.clearance_m=[0.3,0.4]": {"pool"},
    "curriculum=linear": {"pool"},
    "curriculum=success": {"pool"},
    "reward=paper2024": set(),
    "~reward.progress": set(),
    "termination=[height,time_limit]": set(),
    "metric=[energy,top_speed]": set(),
    "dynamics=lag_and_drag": set(),
    "rate_loop=torque": set(),
    "vehicle=iris": set(),
    "model.hidden=[16,16]": set(),
    "model.normalization=running": set(),
    "algorithm.gamma=0.9": set(),
}


@pytest.fixture(scope="module")
def states(compose):
    """`states(*overrides)`: the states of all generators when built and after one batch."""

    def flown(*overrides):
        trainer = TrainingRun(compose(*DRAWING, *overrides)).trainer()
        seen = []
        for _ in range(2):
            states = {name: g.get_state() for name, g in trainer.env.generators.items()}
            states |= {"exploration": trainer.algorithm.noise.get_state()}
            states |= {"minibatches": trainer.algorithm.order.get_state()}
            states |= {"pool": trainer.env.pool.generator.get_state()}
            seen.append(states)
            trainer.iterate()
        assert not trainer.batch["next", "done"][:-1].any()  # else resets would differ, too
        return seen

    return flown


@pytest.fixture(scope="module")
def usual(states):
    return states()


def changed(ours, theirs):
    """Names of the generators that do not stand where they stood in the other run."""
    return {
        name
        for before, after in zip(ours, theirs, strict=True)
        for name in before.keys() | after.keys()
        if name not in after or name not in before or not torch.equal(before[name], after[name])
    }


def test_all_that_draws_is_watched_and_draws(usual):
    built, flown = usual
    assert set(built) == EVERYBODY
    assert len({state.numpy().tobytes() for state in built.values()}) == len(EVERYBODY)
    assert changed([built], [flown]) == EVERYBODY - {"pool"} - {
        "scene",
        "initial_state",
        "mass",
        "inertia",
        "thrust_map",
        "action_delay",
    }


def test_another_seed_changes_every_draw(states, usual):
    assert changed(usual, states("seed=1")) == EVERYBODY


@pytest.mark.slow
@pytest.mark.parametrize("override", SWAPS)
def test_swapping_a_part_leaves_the_draws_of_the_others_alone(states, usual, override):
    assert changed(usual, states(override)) <= SWAPS[override]
