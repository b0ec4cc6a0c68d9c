"""What the environment can be called with; anything else is told in a sentence."""

import traceback
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from resc import keys
from resc.errors import CallError, NumericalError, TermError
from resc.keys import NestedKey
from resc.term import Estimator, Term


def require_action(action: object, shape: tuple[int, int], device: torch.device) -> None:
    """Raises CallError for what is no action: a wider type would make the whole world wider."""
    if not isinstance(action, Tensor):
        raise CallError(f"The action is a {type(action).__name__}; expected a tensor.")
    if tuple(action.shape) != shape:
        raise CallError(
            f"The action has the shape {list(action.shape)}; expected {list(shape)}: "
            "environments, then numbers per action."
        )
    if action.dtype != torch.float32:
        name = str(action.dtype).removeprefix("torch.")
        raise CallError(f"The action is {name}; expected float32: give action.float().")
    if action.device.type != device.type:
        raise CallError(
            f"The action is on {action.device}, the environment on {device}; give "
            "action.to(env.device)."
        )


def require_rows(rows: object, num_envs: int) -> None:
    """Raises CallError for what are no numbers of environments."""
    if not isinstance(rows, Tensor) or rows.dtype != torch.int64 or rows.ndim != 1:
        given = f"{rows.dtype}, {list(rows.shape)}" if isinstance(rows, Tensor) else repr(rows)
        raise CallError(
            f"rows is {given}; expected numbers of environments, int64 [k], such as "
            "done[:, 0].nonzero()[:, 0]."
        )
    if len(rows) and not 0 <= int(rows.min()) <= int(rows.max()) < num_envs:
        raise CallError(f"rows is {rows.tolist()}; expected numbers from 0 to {num_envs - 1}.")


def bad_action(action: Tensor, observation: Tensor, clock: Tensor, columns: list[str]) -> Exception:
    """The error for an action that is not finite: what was observed is looked at first.

    Args:
        action: [n, a].
        observation: What the actions answer [n, width].
        clock: Steps of the episodes [n, 1].
        columns: Names of the observation's numbers.
    """
    row = int((~action.isfinite().all(-1)).nonzero()[0, 0])
    where = f"environment {row} at step {int(clock[row, 0])} of its episode"
    seen = observation[row]
    if not seen.isfinite().all():
        column = int((~seen.isfinite()).nonzero()[0, 0])
        return NumericalError(
            f"observation.{columns[column]} is {float(seen[column])} in {where}, so the action is "
            f"{action[row].tolist()}; look for a division by zero, a root or logarithm of a number "
            "below zero."
        )
    return NumericalError(
        f"The action for {where} is {action[row].tolist()} although all that is observed is "
        "finite; if a policy gave it, its weights are not: train it again with a lower "
        "algorithm.learning_rate, or resume from an earlier checkpoint."
    )


def require_measured(devices: Sequence[Term], world: Mapping[NestedKey, Tensor]) -> None:
    """Raises NumericalError for a reading or an estimate that is not finite, the readings first."""
    values = [(term, key, world[key]) for term in devices for key in term.outputs]
    if torch.stack([value.sum(dtype=torch.float32) for *_, value in values]).isfinite().all():
        return
    for term, key, value in values:
        rows = value.flatten(1).isfinite().all(-1)
        if rows.all():
            continue
        row = int((~rows).nonzero()[0, 0])
        wrong = value[row][~value[row].isfinite()][0].item()
        reads = ", ".join(sorted({".".join(read) for read in term.reads if read[0] == "sensor"}))
        cause = f" although {reads} are finite" if isinstance(term, Estimator) and reads else ""
        raise NumericalError(
            f"{'.'.join(key)} is {wrong} in environment {row} at step "
            f"{int(world[keys.CLOCK][row, 0])} of its episode{cause}; look at the numbers of "
            f"{term.path} and at its compute."
        )


def blamed(error: Exception, when: str) -> Exception:
    """The error, or a TermError where a term raised it: with the term, the reason and the line."""
    frames = list(traceback.walk_tb(error.__traceback__))
    terms = [frame.f_locals.get("self") for frame, _ in frames]
    term = next((each for each in reversed(terms) if isinstance(each, Term)), None)
    if term is None:
        return error
    frame, line = frames[-1]
    reason = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
    return TermError(
        f"{term.path} cannot be computed in {when} of the environment ({reason}, "
        f"{frame.f_code.co_filename}:{line}); mend it."
    )
