"""The contract of algorithms: each learns with every model, and resumes as if never stopped."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from resc.errors import CallError, CheckpointError, ConfigError
from resc.learning.beginning import restore
from resc.learning.checkpoint import load_checkpoint, save_checkpoint
from resc.learning.training_run import TrainingRun
from resc.policies.stored import load_policy
from resc.run_folder import CHECKPOINT

CONF = Path(__file__).parents[2] / "conf"
SMALL = (
    "+experiment=obstacle_free",
    "compile=false",
    "num_envs=16",
    "pool_size=16",
    "renew_scenes=2",
    "total_frames=4096",
    "algorithm.steps=16",
    "algorithm.minibatch=64",
    "model.hidden=[16]",
)
OWN = {
    "ppo": ("algorithm.epochs=2",),
    "sac": ("algorithm.warm_up=64", "algorithm.capacity=600", "algorithm.updates=3"),
    "td3": ("algorithm.warm_up=64", "algorithm.capacity=600", "algorithm.updates=3"),
    "mlp": (),
    "gru": ("model.width=8",),
}
SELDOM = (("sac", "gru"), ("td3", "gru"))
"""Pairs whose parts are tried in others; they are slow."""
ALGORITHMS, MODELS = (
    sorted(path.stem for path in (CONF / group).glob("*.yaml")) for group in ("algorithm", "model")
)
PAIRS = [
    pytest.param(algorithm, model, marks=[pytest.mark.slow] if (algorithm, model) in SELDOM else [])
    for algorithm in ALGORITHMS
    for model in MODELS
]


@pytest.fixture
def begin(compose):
    """`begin(algorithm, model, *overrides)`: a trainer at its start."""

    def begun(algorithm, model, *overrides):
        own = (*OWN[algorithm], *OWN[model], *overrides)
        return TrainingRun(
            compose(f"algorithm={algorithm}", f"model={model}", *SMALL, *own)
        ).trainer()

    return begun


def weights(trainer):
    return torch.cat([p.detach().flatten().clone() for p in trainer.algorithm.parameters])


@pytest.mark.parametrize(("algorithm", "model"), PAIRS)
def test_every_algorithm_learns_with_every_model_and_goes_on_bit_for_bit(
    begin, algorithm, model, tmp_path
):
    trainer = begin(algorithm, model)
    first = weights(trainer)
    figures = trainer.iterate() | trainer.iterate()
    assert all(torch.isfinite(torch.tensor(value)) for value in figures.values())
    assert not torch.equal(weights(trainer), first)
    save_checkpoint(tmp_path / CHECKPOINT, trainer)
    for _ in range(2):  # the buffer of an algorithm that has one is full, then
        trainer.iterate()
    again = begin(algorithm, model)
    load_checkpoint(tmp_path / CHECKPOINT, again)
    for _ in range(2):
        again.iterate()
    assert torch.equal(weights(again), weights(trainer))
    assert torch.equal(again.env.observation, trainer.env.observation)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_stored_policy_acts_as_the_trained_one(begin, compose, algorithm, model, tmp_path):
    own = (*OWN[algorithm], *OWN[model])
    config = compose(f"algorithm={algorithm}", f"model={model}", *SMALL, *own)
    trainer = begin(algorithm, model)
    trainer.iterate()
    TrainingRun(config).save_policy(tmp_path, trainer.algorithm, trainer.env.stages)
    whole = load_policy(tmp_path)
    stored = whole.policy
    if model == "gru":
        for given in (
            trainer.env.observation,
            TensorDict({"observation": torch.zeros(1, 25)}, [1]),
        ):
            with pytest.raises(CallError, match="This policy remembers"):
                whole(given)
    state = ours = None
    for _ in range(2):  # what it remembers goes on, too
        wanted, ours = trainer.policy.decide(trainer.env.observation, ours)
        action, state = stored.decide(trainer.env.observation, state)
        assert torch.equal(action, wanted)
    assert action.abs().max() <= 1


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_exploring_draws_from_a_generator_of_its_own(begin, algorithm):
    one, two = (begin(algorithm, "mlp") for _ in range(2))
    seen = one.collector._seen()
    torch.manual_seed(1)
    first = one.algorithm.explore(seen.copy())["action"]
    torch.manual_seed(2)
    assert torch.equal(two.algorithm.explore(seen.copy())["action"], first)
    assert not torch.equal(one.algorithm.explore(seen.copy())["action"], first)


def test_weights_of_another_algorithm_are_refused_by_name(begin, compose, tmp_path):
    config = compose("algorithm=ppo", "model=mlp", *SMALL, *OWN["ppo"])
    trainer = begin("ppo", "mlp")
    TrainingRun(config).save_policy(tmp_path / "ppo", trainer.algorithm, trainer.env.stages)
    other = begin("sac", "mlp", f"init_from={tmp_path / 'ppo'}")
    with pytest.raises(CheckpointError, match=r"algorithm resc\.learning\.ppo\.Ppo"):
        restore(other, tmp_path, resumes=False, init_from=str(tmp_path / "ppo"))


def test_files_of_a_buffer_that_are_missing_are_missed(begin, tmp_path):
    trainer = begin("sac", "mlp")
    trainer.iterate()
    save_checkpoint(tmp_path / CHECKPOINT, trainer)
    for path in (tmp_path / "experience").iterdir():
        path.unlink()
    with pytest.raises(CheckpointError, match="holds the flights up to step 0 of 256"):
        load_checkpoint(tmp_path / CHECKPOINT, begin("sac", "mlp"))


def test_flights_written_after_the_checkpoint_are_flown_again(begin, tmp_path):
    trainer = begin("sac", "mlp")
    trainer.iterate()
    save_checkpoint(tmp_path / CHECKPOINT, trainer)
    trainer.iterate()
    trainer.algorithm.save_experience(tmp_path / "experience")  # killed before the checkpoint
    again = begin("sac", "mlp")
    load_checkpoint(tmp_path / CHECKPOINT, again)
    assert len(again.algorithm.buffer) == 256
    assert len(list((tmp_path / "experience").iterdir())) == 1
    again.iterate()
    assert torch.equal(weights(again), weights(trainer))


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("algorithm.capacity=100", "capacity is 100, less than a batch of 16 steps x 16"),
        ("algorithm.warm_up=5000", "warm_up is 5000, more than the buffer's capacity of 600"),
        ("algorithm.gamma=1.0", r"gamma is 1\.0 and polyak 0\.01; expected shares above zero"),
    ],
)
def test_numbers_of_a_buffer_that_cannot_be_are_refused(begin, override, sentence):
    with pytest.raises(ConfigError, match=sentence):
        begin("sac", "mlp", override)


def test_a_policy_that_remembers_needs_minibatches_of_whole_sequences(begin):
    with pytest.raises(ConfigError, match="minibatch is 8, but a policy that remembers"):
        begin("ppo", "gru", "algorithm.minibatch=8")


@pytest.mark.parametrize("algorithm", ["ppo", "sac", pytest.param("td3", marks=pytest.mark.slow)])
def test_what_the_critic_alone_sees_moves_the_value_and_not_the_action(begin, algorithm, tmp_path):
    options = ("observation@observation_critic=[heights]", "model.normalization=running")
    trainer = begin(algorithm, "mlp", *options)
    trainer.iterate()
    trainer.iterate()
    batch = trainer.batch
    assert batch["observation_critic"].shape[-1] == 2
    going = ~batch["next", "done"][:-1, :, 0]
    for name in ("observation", "observation_critic"):  # what follows is what is seen next
        assert torch.equal(batch["next", name][:-1][going], batch[name][1:][going])
    seen = trainer.collector._seen()
    other = seen.copy().update({"observation_critic": seen["observation_critic"] + 10})
    state = trainer.algorithm.noise.get_state()
    first = trainer.algorithm.explore(seen)
    trainer.algorithm.noise.set_state(state)
    second = trainer.algorithm.explore(other)
    assert torch.equal(first["action"], second["action"])
    if "state_value" in first:
        assert not torch.equal(first["state_value"], second["state_value"])
    save_checkpoint(tmp_path / CHECKPOINT, trainer)
    trainer.iterate()
    again = begin(algorithm, "mlp", *options)
    load_checkpoint(tmp_path / CHECKPOINT, again)
    again.iterate()
    assert torch.equal(weights(again), weights(trainer))
