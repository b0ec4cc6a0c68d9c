"""What test_compiled.py runs in a process of its own: `graph`, `difficulty`, `compare` or several.

Arguments with an = are overrides.

torch.compile cannot trace the wrappers of the tests' type checker, and an imported module cannot
get rid of them.
"""

import functools
import sys
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

import resc.schema
from resc.setup import set_up

ROWS = 3
OVERRIDES = [argument for argument in sys.argv[1:] if "=" in argument]


@functools.cache
def make_env(*, compiled):
    resc.schema.register()
    with initialize_config_dir(str(Path(__file__).parents[2] / "conf"), version_base="1.3"):
        config = compose("train", [*OVERRIDES, f"num_envs={ROWS}", f"compile={compiled}"])
    return set_up(config, size=8, seed=0).env(config["num_envs"], compiled=config["compile"])


def graph():
    """Traces the step without compiling it: one graph, or an error."""
    env = make_env(compiled=False)
    env.restart(torch.arange(ROWS))
    world = {key: env.value_of(key) for key in env.stages.persistent}
    step = torch.compile(env.stages.step, fullgraph=True, dynamic=False, backend="eager")
    with torch.no_grad():
        traced = step(world, env.pool.shared, torch.zeros(ROWS, 4), {})
        plain = env.stages.step(world, env.pool.shared, torch.zeros(ROWS, 4), {})
    same("observation", traced[1].observation, plain[1].observation)


def difficulty():
    """Traces the reset once: an error if another difficulty wants another trace."""
    torch._dynamo.config.error_on_recompile = True
    env = make_env(compiled=False)
    env._restart_function = torch.compile(
        env.stages.restart_rows, fullgraph=True, dynamic=False, backend="eager"
    )
    for value in (1.0, 0.5, 0.0):
        env.set_difficulty("initial_state", value)
        env.restart(torch.arange(ROWS))
        assert (env.value_of(("difficulty", "initial_state")) == value).all()
    assert (env.value_of(("state", "velocity_w")) == 0).all()


def compare():
    """Flies the compiled and the uncompiled environment, each step from the same world.

    Step and reset are compiled once each: an error if another call wants another program.
    """
    torch._dynamo.config.error_on_recompile = True
    eager, compiled = make_env(compiled=False), make_env(compiled=True)
    everyone = torch.arange(ROWS)
    same("restart", compiled.restart(everyone), eager.restart(everyone))
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        compiled.world = eager.world
        action = 2 * torch.rand(ROWS, 4, generator=generator) - 1
        ours, theirs = compiled.advance(action), eager.advance(action)
        for name in theirs._fields:
            same(name, getattr(ours, name), getattr(theirs, name))
        for key in eager.stages.persistent:
            same(key, compiled.value_of(key), eager.value_of(key))
    before = compiled.world.clone()
    compiled.restart(torch.tensor([1]))
    for key in compiled.stages.persistent:
        assert torch.equal(compiled.value_of(key)[[0, 2]], before[key][[0, 2]]), key
    check_env_specs(compiled, seed=0)


def same(name, ours, theirs):
    """Close, for rounding differs where operations are fused; flags and counts are equal."""
    assert_close(ours, theirs, atol=2e-5, rtol=2e-5, msg=lambda text: f"{name}: {text}")


if __name__ == "__main__":
    torch.set_num_threads(1)
    for what in [argument for argument in sys.argv[1:] if "=" not in argument]:
        {"graph": graph, "difficulty": difficulty, "compare": compare}[what]()
