"""Exported files run beside the policy that they are of."""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from resc.deployment.exported import HEADER, ONNX, TORCH, PlainPolicy, onnx_packages
from resc.errors import ConfigError, NumericalError
from resc.math.sampling import generator_for
from resc.policies.networks import RunningNormalization
from resc.policies.policy import Policy

State = Float[Tensor, "n m"] | None
Step = Callable[[Float[Tensor, "n d"], State], tuple[Float[Tensor, "n a"], State]]
"""Actions and next states for observations and states."""
ROWS, STEPS = 100, 100
GREATEST = 1e-5
"""Largest deviation of an action or of a state."""
SPREAD = 3.0
"""Of the observations that are drawn, in standard deviations of those seen in training."""
COMPILING_S = 300
SOURCE = """\
#include "policy.h"
void act(const float *observation, float *state, float *action, int rows) {
    for (int i = 0; i < rows; ++i)
        policy_act(observation + i * POLICY_OBSERVATIONS, state + i * POLICY_STATE,
                   action + i * POLICY_ACTIONS);
}
"""


def deviations(policy: Policy, steps: Mapping[str, Step], seed: int) -> dict[str, float]:
    """Largest deviation of each from the policy, over 100 flights of 100 steps.

    Each carries on its own state. Observations are drawn at random, three times as wide as those of
    training, or with a standard deviation of 3 where nothing normalises them.

    Args:
        policy: The trained one.
        steps: What is compared with it, by name.
        seed: Of the observations.
    """
    observations = _drawn(policy, seed)
    expected = _flown(_of_policy(policy), observations, policy.state_width)
    found = {}
    for name, step in steps.items():
        got = _flown(step, observations, policy.state_width)
        found[name] = float((got - expected).abs().max())
    return found


def require_equal(found: Mapping[str, float]) -> None:
    """Raises NumericalError, naming the file, if one deviates; so does what is not a number."""
    for name, deviation in found.items():
        if not deviation <= GREATEST:
            raise NumericalError(
                f"{name} deviates from the policy by {deviation:.1e} over {ROWS * STEPS} "
                f"observations, more than {GREATEST:.0e}, so nothing is written; leave {name} out "
                "of files, or train with running normalisation and a smaller learning rate."
            )


def _drawn(policy: Policy, seed: int) -> Float[Tensor, "t n d"]:
    """Observations of each step and flight."""
    size = (STEPS, ROWS, policy.observation_width)
    unit = torch.randn(size, generator=generator_for(seed, "export")) * SPREAD
    seen = policy.normalization
    if not isinstance(seen, RunningNormalization):
        return unit
    return (seen.mean + seen.variance.sqrt() * unit).float()


@torch.no_grad()
def _flown(step: Step, observations: Float[Tensor, "t n d"], width: int) -> Tensor:
    """Actions and states [t, n, a + m] of every step."""
    state = observations.new_zeros(observations.shape[1], width) if width else None
    told = []
    for observation in observations:
        action, state = step(observation, state)
        told.append(action if state is None else torch.cat((action, state), -1))
    return torch.stack(told)


def _of_policy(policy: Policy) -> Step:
    def step(observation: Tensor, state: State) -> tuple[Tensor, State]:
        action, following = policy.decide(observation, None if state is None else state[:, None])
        return action, None if following is None else following[:, 0]

    return step


def steps_of(folder: Path, plain: PlainPolicy) -> dict[str, Step]:
    """What runs each file of a folder that there is, by the file's name."""
    made = {ONNX: of_onnx, TORCH: of_torch, HEADER: of_header}
    return {
        name: run(folder / name, plain) for name, run in made.items() if (folder / name).exists()
    }


def of_onnx(path: Path, plain: PlainPolicy) -> Step:
    """Runs an ONNX file by onnxruntime, in one thread."""
    session = onnx_session(path)

    def step(observation: Tensor, state: State) -> tuple[Tensor, State]:
        given = [observation] if state is None else [observation, state]
        named = {name: value.numpy() for name, value in zip(plain.inputs, given, strict=True)}
        action, *following = map(torch.from_numpy, session.run(None, named))
        return action, following[0] if following else None

    return step


def onnx_session(path: Path) -> Any:  # noqa: ANN401 - of a package that may be missing
    """A session of onnxruntime on one core."""
    _, runtime = onnx_packages()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def of_torch(path: Path, plain: PlainPolicy) -> Step:
    """Runs a file of torch.export."""
    module = torch.export.load(path).module()

    def step(observation: Tensor, state: State) -> tuple[Tensor, State]:
        if plain.state_width:
            return module(observation, state)
        return module(observation), None

    return step


def of_header(path: Path, plain: PlainPolicy) -> Step:
    """Compiles a header, and calls it.

    Raises:
        ConfigError: There is no compiler, or it refuses the header.
    """
    act = compiled(path)

    def step(observation: Tensor, state: State) -> tuple[Tensor, State]:
        rows, following = len(observation), np.zeros(1) if state is None else state.numpy().copy()
        action = np.empty((rows, plain.action_width), np.float32)
        given = observation.contiguous().numpy()
        act(given.ctypes.data, following.ctypes.data, action.ctypes.data, rows)
        return torch.from_numpy(action), None if state is None else torch.from_numpy(following)

    return step


def compiled(path: Path) -> Any:  # noqa: ANN401 - a function of a library
    """The C function act(observation, state, action, rows) on the header at `path`."""
    compiler = os.environ.get("CXX") or shutil.which("g++") or "g++"
    with TemporaryDirectory() as folder:
        source, library = Path(folder, "act.c"), Path(folder, "act.so")
        source.write_text(SOURCE)
        command = [compiler, "-x", "c", "-std=c99", "-O3", "-shared", "-fPIC", f"-I{path.parent}"]
        try:
            subprocess.run(
                [*command, str(source), "-o", str(library), "-lm"],
                check=True,
                capture_output=True,
                text=True,
                timeout=COMPILING_S,
            )
        except FileNotFoundError:
            raise ConfigError(
                f"{path.name} is checked with a compiler, but there is no {compiler}; install g++, "
                "or leave the file out: files=[onnx,pt2]."
            ) from None
        except subprocess.CalledProcessError as error:
            told = (error.stderr.strip().splitlines() or ["no reason given"])[0]
            raise ConfigError(f"{path.name} does not compile ({told}); please report it.") from None
        act = ctypes.CDLL(str(library)).act
    act.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int]
    act.restype = None
    return act
