"""Adam over weights side by side: torch's, step for step."""

import copy

import pytest
import torch
from torch import nn

from resc.learning.flat_adam import FlatAdam, side_by_side


@pytest.fixture
def networks():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(5, 7), nn.Tanh(), nn.Linear(7, 3))


def gradients(network, seed, scale):
    noise = torch.Generator().manual_seed(seed)
    return [scale * torch.randn(p.shape, generator=noise) for p in network.parameters()]


def step_with(optimizer, network, parts, max_norm):
    for weight, part in zip(network.parameters(), parts, strict=True):
        weight.grad = part.clone()
    nn.utils.clip_grad_norm_(network.parameters(), max_norm)
    optimizer.step()


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_it_steps_as_torch_does_and_goes_on_from_torchs_state(networks, scale):
    theirs = copy.deepcopy(networks)
    adam = torch.optim.Adam(theirs.parameters(), lr=0.01, eps=1e-5)
    ours = FlatAdam(list(networks.parameters()), 0.5, epsilon=1e-5)
    for seed in range(5):
        step_with(adam, theirs, gradients(theirs, seed, scale), 0.5)
        ours.step(side_by_side(gradients(networks, seed, scale)), 0.01)
    late = copy.deepcopy(theirs)
    goes_on = FlatAdam(list(late.parameters()), 0.5, epsilon=1e-5)
    goes_on.load_state_dict(adam.state_dict())
    step_with(adam, theirs, gradients(theirs, 9, scale), 0.5)
    for optimizer, network in ((ours, networks), (goes_on, late)):
        optimizer.step(side_by_side(gradients(network, 9, scale)), 0.01)
        for mine, other in zip(network.parameters(), theirs.parameters(), strict=True):
            torch.testing.assert_close(mine, other)


def test_weights_are_aligned_and_keep_their_values(networks):
    before = [p.clone() for p in networks.parameters()]
    optimizer = FlatAdam(list(networks.parameters()), 0.5, epsilon=1e-5)
    for now, then in zip(networks.parameters(), before, strict=True):
        assert torch.equal(now, then)
        assert now.storage_offset() % 16 == 0
        assert now.untyped_storage().data_ptr() == optimizer.values.untyped_storage().data_ptr()
