"""The digest that tells which network flew."""

import torch
from torch import nn

from resc.recording.rollouts import digest


def test_the_digest_tells_networks_apart_by_their_weights():
    torch.manual_seed(0)
    first, second = nn.Linear(3, 2), nn.Linear(3, 2)
    assert digest(first) != digest(second)
    second.load_state_dict(first.state_dict())
    assert digest(first) == digest(second)
    with torch.no_grad():
        second.bias[1] += 1e-7
    assert digest(first) != digest(second)
    assert len(digest(first)) == 64
