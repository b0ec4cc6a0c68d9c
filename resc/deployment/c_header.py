"""A policy as one header of plain C: weights as arrays, and the functions that use them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from resc.deployment.exported import First, Normalization, PlainPolicy
from resc.errors import ConfigError
from resc.policies.networks import BOUND, Tanh

NUMBERS_A_LINE = 8
EACH: Mapping[type[nn.Module], Callable[[Any], str]] = {
    Tanh: lambda _: "2.0f / (1.0f + expf(-2.0f * v)) - 1.0f",
    nn.Tanh: lambda _: "tanhf(v)",
    nn.ReLU: lambda _: "v > 0.0f ? v : 0.0f",
    nn.ELU: lambda layer: f"v > 0.0f ? v : {_number(layer.alpha)} * expm1f(v)",
    nn.Hardtanh: lambda layer: _bounded(layer.min_val, layer.max_val),
}
"""By the kind of a layer: what it makes of each number v. A number that is none stays so."""
TOP = """\
/* {title}

Plain C99, also C++: it needs nothing but the mathematics library (-lm).
Of each observation the policy sees clip(scale * x); the scaling is left to the caller:

{inputs}

policy_act      observation [POLICY_OBSERVATIONS] -> action [POLICY_ACTIONS] in [-1, 1]; it renews
                state [POLICY_STATE], which is zero where a flight begins (NULL if there is none)
policy_command  action -> {command}
*/
#ifndef RESC_POLICY_H
#define RESC_POLICY_H

#include <math.h>

#define POLICY_OBSERVATIONS {observations}
#define POLICY_ACTIONS {actions}
#define POLICY_STATE {state}
#define POLICY_RATE_HZ {rate_hz}

/* y = x W + b, W row by row: a row for each of the inputs. */
static inline void policy_linear(const float *x, int inputs, const float *weight,
                                 const float *bias, int outputs, float *y)
{{
    for (int j = 0; j < outputs; ++j) y[j] = bias[j];
    for (int i = 0; i < inputs; ++i)
        for (int j = 0; j < outputs; ++j) y[j] += x[i] * weight[i * outputs + j];
}}
"""
BOTTOM = """
static inline void policy_act(const float *observation, float *state, float *action)
{{
    float x[{widest}], y[{widest}];
    for (int i = 0; i < POLICY_OBSERVATIONS; ++i) x[i] = observation[i];
{body}
    for (int i = 0; i < POLICY_ACTIONS; ++i) action[i] = x[i];
    (void)state;
    (void)y;
}}

static inline void policy_command(const float *action, float *command)
{{
    for (int i = 0; i < POLICY_ACTIONS; ++i)
        command[i] = policy_offset[i] + policy_slope[i] * action[i];
}}

#endif
"""


def header(plain: PlainPolicy, card: Mapping[str, Any]) -> str:
    """The text of the header.

    Args:
        plain: The policy.
        card: See `resc.deployment.card`.

    Raises:
        ConfigError: A layer is of a kind that is not written in C.
    """
    action = card["action"]["numbers"]
    scaling = {name: [number[name] for number in action] for name in ("offset", "slope")}
    arrays = [_array(f"policy_{name}", values) for name, values in scaling.items()]
    body: list[str] = []
    width = widest = plain.observation_width
    for number, layer in enumerate(plain.layers):
        made, lines, width = _written(layer, number, width)
        arrays += made
        body += lines
        widest = max(widest, width)
    told = {
        "title": f"The policy {card['policy']}, as python -m resc.deployment.export writes it.",
        "inputs": "\n".join(_told(number) for number in card["observation"]["numbers"]),
        "command": ", ".join(f"{n['name']} [{n['unit']}]" for n in action),
    }
    top = TOP.format(
        **{name: text.replace("*/", "* /") for name, text in told.items()},
        observations=plain.observation_width,
        actions=plain.action_width,
        state=plain.state_width,
        rate_hz=_number(card["control_rate_hz"]),
    )
    end = BOTTOM.format(widest=widest, body="\n".join(f"    {line}" for line in body))
    return "\n".join([top, *arrays, end])


def _told(number: Mapping[str, Any]) -> str:
    """One number of the observation, in a line."""
    unit, frame = number["unit"] or "?", number["frame"]
    clip = "" if number["clip"] is None else f", clip {number['clip']}"
    where = f", {frame}" if frame else ""
    return f"{number['index']:3}  {number['name']} [{unit}]{where}, scale {number['scale']}{clip}"


def _written(layer: nn.Module, number: int, width: int) -> tuple[list[str], list[str], int]:
    """The arrays of a layer, the lines of its step from x to x, and the width of what it gives."""
    if isinstance(layer, First):
        return [], [], layer.width
    if isinstance(layer, Normalization):
        return (*_normalization(layer, number), width)
    if isinstance(layer, nn.Linear):
        return (*_linear(layer, f"{number}"), layer.out_features)
    if isinstance(layer, nn.GRUCell):
        return (*_gru(layer, f"{number}"), layer.hidden_size)
    if type(layer) in EACH:
        return [], [_each(width, EACH[type(layer)](layer))], width
    raise ConfigError(
        f"model: a layer of the policy is a {type(layer).__name__}, which has no form in C; leave "
        "policy.h out: files=[onnx,pt2]."
    )


def _normalization(layer: Normalization, number: int) -> tuple[list[str], list[str]]:
    mean, factor = f"policy_mean_{number}", f"policy_factor_{number}"
    value = _bounded(-BOUND, BOUND)
    loop = _each(len(layer.mean), value, f"(x[i] - {mean}[i]) * {factor}[i]")
    arrays = [_array(mean, layer.mean.tolist()), _array(factor, layer.inverse_std.tolist())]
    return arrays, [loop]


def _linear(layer: nn.Linear, name: str) -> tuple[list[str], list[str]]:
    bias = layer.weight.new_zeros(layer.out_features) if layer.bias is None else layer.bias
    call = _call(name, "x", "y", *layer.weight.shape)
    copy = f"for (int i = 0; i < {layer.out_features}; ++i) x[i] = y[i];"
    return _weights(name, layer.weight, bias), [call, copy]


def _gru(layer: nn.GRUCell, name: str) -> tuple[list[str], list[str]]:
    """r, z, n as of torch.nn.GRU; the state becomes (1 - z) n + z state."""
    width = layer.hidden_size
    new, old = f"{name}_new", f"{name}_old"
    arrays = [
        *_weights(new, layer.weight_ih, layer.bias_ih),
        *_weights(old, layer.weight_hh, layer.bias_hh),
    ]
    lines = [
        f"float gate_{new}[{3 * width}], gate_{old}[{3 * width}];",
        _call(new, "x", f"gate_{new}", *layer.weight_ih.shape),
        _call(old, "state", f"gate_{old}", *layer.weight_hh.shape),
        f"for (int i = 0; i < {width}; ++i) {{",
        f"    const float *a = gate_{new}, *b = gate_{old};",
        "    const float r = 1.0f / (1.0f + expf(-a[i] - b[i]));",
        f"    const float z = 1.0f / (1.0f + expf(-a[i + {width}] - b[i + {width}]));",
        f"    const float n = tanhf(a[i + {2 * width}] + r * b[i + {2 * width}]);",
        "    x[i] = state[i] = (1.0f - z) * n + z * state[i];",
        "}",
    ]
    return arrays, lines


def _weights(name: str, weight: Float[Tensor, "b a"], bias: Float[Tensor, " b"]) -> list[str]:
    """Arrays of a linear layer: a row for each input, so that compilers use vectors."""
    rows = weight.T.flatten().tolist()
    return [_array(f"policy_weight_{name}", rows), _array(f"policy_bias_{name}", bias.tolist())]


def _call(name: str, given: str, result: str, outputs: int, inputs: int) -> str:
    arrays = f"policy_weight_{name}, policy_bias_{name}"
    return f"policy_linear({given}, {inputs}, {arrays}, {outputs}, {result});"


def _each(width: int, value: str, start: str = "x[i]") -> str:
    """x[i] becomes what a formula makes of v, its start, for each i."""
    return f"for (int i = 0; i < {width}; ++i) {{ const float v = {start}; x[i] = {value}; }}"


def _bounded(low: float, high: float) -> str:
    least, most = _number(low), _number(high)
    return f"v < {least} ? {least} : (v > {most} ? {most} : v)"


def _array(name: str, values: Sequence[float]) -> str:
    lines = "\n".join(_lines(values))
    return f"static const float {name}[{len(values)}] = {{\n{lines}\n}};"


def _lines(values: Sequence[float]) -> Iterator[str]:
    for first in range(0, len(values), NUMBERS_A_LINE):
        row = values[first : first + NUMBERS_A_LINE]
        yield f"    {', '.join(map(_number, row))},"


def _number(value: float) -> str:
    """A float of C: nine digits say which it is."""
    text = f"{value:.9g}"
    return f"{text}f" if {"e", "."} & set(text) else f"{text}.0f"
