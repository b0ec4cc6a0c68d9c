"""What is replayed as a CUDA graph does what its function does, whatever it is given."""

import pytest
import torch

from resc.cuda_graph import CudaGraph
from resc.learning.training_run import TrainingRun

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"),
]


SMALL = [
    "device=cuda",
    "compile=true",
    "num_envs=64",
    "pool_size=32",
    "renew_scenes=2",
    "algorithm.steps=8",
    "algorithm.minibatch=128",
]


def trainer_of(compose, *, graphed):
    """A trainer on the GPU, of an environment that replays graphs or calls what they hold."""
    trainer = TrainingRun(compose(*SMALL)).trainer()
    assert trainer.env.graphed
    trainer.env.graphed = graphed
    return trainer


def test_every_call_has_its_effect_once():
    total = torch.zeros(3, device="cuda")

    def add(number):
        total.add_(number)
        return total * 2

    graph = CudaGraph(add)
    for count in range(1, 9):
        returned = graph(torch.full((3,), float(count), device="cuda"))
        assert total.tolist() == [count * (count + 1) / 2] * 3
        assert returned.tolist() == [count * (count + 1.0)] * 3
    assert graph.calls == 8


def test_a_replayed_step_and_restart_equal_the_compiled_ones_over_changing_inputs(compose):
    with_graphs, without = (trainer_of(compose, graphed=graphed).env for graphed in (True, False))
    generator = torch.Generator(device="cuda").manual_seed(0)
    for step in range(12):
        action = 2 * torch.rand(with_graphs.num_envs, 4, generator=generator, device="cuda") - 1
        outs = [env.advance(action) for env in (with_graphs, without)]
        for name in outs[0]._fields:
            assert torch.equal(getattr(outs[0], name), getattr(outs[1], name)), name
        for key in without.before:
            assert torch.equal(with_graphs.before[key], without.before[key]), key
        rows = torch.arange(step % 3, with_graphs.num_envs, 7)
        seen = [env.restart(rows) for env in (with_graphs, without)]
        assert torch.equal(*seen)
        for key in without.tensors:
            assert torch.equal(with_graphs.tensors[key], without.tensors[key]), key


def test_training_in_a_graphed_environment_learns_the_same(compose):
    with_graphs, without = (trainer_of(compose, graphed=graphed) for graphed in (True, False))
    for _ in range(4):
        torch.testing.assert_close(with_graphs.iterate(), without.iterate(), rtol=1e-3, atol=1e-5)
    for ours, other in zip(
        with_graphs.algorithm.parameters, without.algorithm.parameters, strict=True
    ):
        torch.testing.assert_close(ours, other, rtol=1e-3, atol=1e-5)
