"""A policy as plain layers, and the files that hold them: ONNX and torch.export.

What is traced has no shapes in its signatures: of a batch of any size there is no number to check.
"""

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.export import ExportedProgram
from torchrl.modules import GRUModule, IndependentNormal, TanhDelta, TanhNormal

from resc.errors import ConfigError
from resc.policies.networks import BOUND, EPSILON, FEATURES, NORMALIZED, RunningNormalization
from resc.policies.policy import Policy

ONNX, TORCH, HEADER, CARD = "policy.onnx", "policy.pt2", "policy.h", "policy.json"
OPSET = 25
"""The newest that torch writes by itself."""
SQUASHED = {IndependentNormal: False, TanhNormal: True, TanhDelta: True}
"""By the distribution of a policy's head: whether a hyperbolic tangent makes its actions."""
TALKING = ("torch.onnx", "onnxscript", "onnx_ir")
"""Packages that log every step of what they do."""
EXAMPLES = 2
"""Rows of the batch that is traced: torch takes a batch of one for one that stays so."""


class Normalization(nn.Module):
    """`RunningNormalization` with what it has seen: constants, in float32.

    Args:
        seen: The statistics.
    """

    mean: Tensor
    inverse_std: Tensor

    def __init__(self, seen: RunningNormalization) -> None:
        super().__init__()
        self.register_buffer("mean", seen.mean.float())
        self.register_buffer("inverse_std", (seen.variance + EPSILON).rsqrt().float())

    def forward(self, observation: Tensor) -> Tensor:
        """The observation [n, d], normalised."""
        return ((observation - self.mean) * self.inverse_std).clamp(-BOUND, BOUND)


class First(nn.Module):
    """The first columns: of the numbers that a distribution is made of, those that say where it is.

    Args:
        width: How many.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.width = width

    def forward(self, features: Tensor) -> Tensor:
        """Columns [n, a] of features [n, b]."""
        return features[:, : self.width]


class PlainPolicy(nn.Module):
    """The most likely action of a policy, clipped to [-1, 1]: layers, one after the other.

    A policy that remembers also takes its state [n, m], zeros as an episode begins, and returns the
    next one.

    Args:
        policy: The trained one.

    Raises:
        ConfigError: A part of the policy is none of those that can be exported.
    """

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.layers = nn.ModuleList(_layers(policy))
        self.observation_width = policy.observation_width
        self.action_width = policy.action_width
        self.state_width = policy.state_width

    def forward(
        self, observation: Tensor, state: Tensor | None = None
    ) -> Tensor | tuple[Tensor, Tensor | None]:
        """The action [n, a] for observations [n, d] and, of one that remembers, the next state."""
        value = observation
        for layer in self.layers:
            if isinstance(layer, nn.GRUCell):
                value = state = layer(value, state)
            else:
                value = layer(value)
        return value if state is None else (value, state)

    @property
    def inputs(self) -> list[str]:
        """Names of the tensors that it takes."""
        return ["observation", *(["state"] if self.state_width else [])]

    @property
    def outputs(self) -> list[str]:
        """Names of the tensors that it returns."""
        return ["action", *(["next_state"] if self.state_width else [])]

    @property
    def examples(self) -> tuple[Tensor, ...]:
        """Tensors to trace it with."""
        widths = (self.observation_width, self.state_width)
        return tuple(torch.zeros(EXAMPLES, width) for width in widths if width)


def _layers(policy: Policy) -> Iterator[nn.Module]:
    """What an observation goes through, from the normalisation to the bounds of the action."""
    head = policy.head
    if head.distribution not in SQUASHED:
        raise _cannot("algorithm", head, "one with the distribution of Gaussian or TanhGaussian")
    yield from _flat(policy.normalization)
    carried = NORMALIZED
    for module in (policy[number] for number in range(1, len(policy) - 2)):
        keys = list(module.in_keys)
        if isinstance(module, GRUModule):
            yield _cell(module.gru)
        elif keys == [carried]:
            yield from _flat(cast(nn.Module, module.module))
        else:
            raise _cannot("model", module, "Mlp or Gru, or modules that read one tensor each")
        carried = module.out_keys[0]
    if carried != FEATURES:
        raise _cannot("model", policy[len(policy) - 3], f"one whose last module writes {FEATURES}")
    yield First(policy.action_width)
    if SQUASHED[head.distribution]:
        yield nn.Tanh()
    yield nn.Hardtanh(-1.0, 1.0)


def _flat(module: nn.Module) -> Iterator[nn.Module]:
    """The layers of a sequence, and a normalisation with what it has seen."""
    if isinstance(module, nn.Sequential):
        for layer in module:
            yield from _flat(layer)
    elif isinstance(module, RunningNormalization):
        yield Normalization(module)
    elif not isinstance(module, nn.Identity):
        yield module


def _cell(gru: nn.Module) -> nn.GRUCell:
    """One step of a gated recurrent unit."""
    if not isinstance(gru, nn.GRU) or gru.num_layers != 1 or gru.bidirectional or not gru.bias:
        raise _cannot("model", gru, "a GRU of one layer that reads forward")
    cell = nn.GRUCell(gru.input_size, gru.hidden_size)
    weights = gru.state_dict().items()
    cell.load_state_dict({name.removesuffix("_l0"): value for name, value in weights})
    return cell


def _cannot(setting: str, part: object, instead: str) -> ConfigError:
    return ConfigError(
        f"{setting}: the policy's {type(part).__name__} cannot be exported; train one with "
        f"{instead}."
    )


def traced(plain: PlainPolicy) -> ExportedProgram:
    """The policy as a graph, for any batch.

    Raises:
        ConfigError: A layer cannot be traced.
    """
    batch = torch.export.Dim("batch")
    try:
        return torch.export.export(
            plain, plain.examples, dynamic_shapes=tuple({0: batch} for _ in plain.examples)
        )
    except (RuntimeError, TypeError, ValueError, AttributeError) as error:
        told = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ConfigError(
            f"model: torch.export cannot trace the policy ({told}); write its layers so that "
            "nothing in Python depends on a value."
        ) from error


def write_torch(program: ExportedProgram, path: Path, facts: Mapping[str, Any]) -> None:
    """Writes the file of torch.export, which holds the facts as the extra file policy.json."""
    torch.export.save(program, path, extra_files={CARD: json.dumps(facts)})


def write_onnx(
    program: ExportedProgram, plain: PlainPolicy, path: Path, facts: Mapping[str, Any]
) -> None:
    """Writes the ONNX file: float32, any batch, the facts as JSON in its metadata.

    Raises:
        ConfigError: A layer has no form in ONNX.
    """
    onnx, _ = onnx_packages()
    for name in TALKING:
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        made = torch.onnx.export(
            program,
            dynamo=True,
            verbose=False,
            opset_version=OPSET,
            input_names=plain.inputs,
            output_names=plain.outputs,
        )
    except torch.onnx.errors.OnnxExporterError as error:
        raise ConfigError(
            f"model: a layer of the policy has no form in ONNX ({error.__cause__}); leave out the "
            "file: files=[pt2,h]."
        ) from error
    assert made is not None
    model = made.model_proto
    model.producer_name = "resc"
    onnx.helper.set_model_props(model, {name: json.dumps(value) for name, value in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)


def onnx_packages() -> Sequence[Any]:
    """The modules onnx and onnxruntime.

    Raises:
        ConfigError: They are not installed, or onnxscript, which torch writes ONNX with, is not.
    """
    try:
        import onnx
        import onnxruntime
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"policy.onnx needs {error.name}, which is not installed; install it: pip install -e "
            "'.[export]', or leave it out: files=[pt2,h]."
        ) from None
    return onnx, onnxruntime
