"""Compares the compiled with the uncompiled environment; run by test_compiled.py in a process of its own.

The wrappers of the tests' type checker cannot be traced by torch.compile, and an imported module cannot get rid of them.
"""

import sys
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

import resc.schema
from resc.build import build_env, build_pool

ROWS = 3


def main(overrides):
    torch.set_num_threads(1)
    resc.schema.register()
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base="1.3"):
        config = compose("train", [f"num_envs={ROWS}", *overrides])
    eager, compiled = (
        build_env({**config, "compile": compile}, build_pool(config, size=8, seed=0)) for compile in (False, True)
    )
    everyone = torch.arange(ROWS)
    same("restart", eager.restart(everyone), compiled.restart(everyone))
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        compiled.world = eager.world
        action = 2 * torch.rand(ROWS, 4, generator=generator) - 1
        out, expected = compiled.advance(action), eager.advance(action)
        for name in expected._fields:
            same(name, getattr(out, name), getattr(expected, name))
        for key in eager.stages.persistent:
            same(key, compiled.value_of(key), eager.value_of(key))
    before = compiled.world.clone()
    compiled.restart(torch.tensor([1]))
    for key in compiled.stages.persistent:
        assert torch.equal(compiled.value_of(key)[[0, 2]], before[key][[0, 2]]), key
    check_env_specs(compiled, seed=0)


def same(name, ours, theirs):
    """Close, for rounding differs when operations are fused; flags and counts are equal."""
    assert_close(ours, theirs, atol=2e-5, rtol=2e-5, msg=lambda text: f"{name}: {text}")


if __name__ == "__main__":
    main(sys.argv[1:])
