import torch

from resc.math.sampling import generator_for, uniform


def draw(seed, path):
    return torch.rand(1000, generator=generator_for(seed, path))


def test_the_same_seed_and_path_give_the_same_numbers():
    assert torch.equal(draw(7, "randomization.mass"), draw(7, "randomization.mass"))


def test_another_seed_or_path_gives_other_numbers():
    base = draw(7, "randomization.mass")
    assert not torch.equal(base, draw(8, "randomization.mass"))
    assert not torch.equal(base, draw(7, "randomization.inertia"))


def test_uniform_fills_its_interval():
    numbers = uniform((10_000,), -0.5, 2.0, torch.Generator().manual_seed(0))
    assert numbers.min() >= -0.5
    assert numbers.max() < 2.0
    assert abs(float(numbers.mean()) - 0.75) < 0.03
