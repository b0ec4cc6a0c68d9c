"""A first flight of a few environments that checks every term with real tensors.

A user's term is a few lines of Python that nothing has run before. Once compiled and among
a thousand environments, a wrong shape is broadcast, a wrong type converts what it meets, and an
error names neither the term nor what it should have given.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import torch
from torch import Tensor

from resc import keys
from resc.envs.stages import Stages
from resc.errors import ConfigError, RescError
from resc.keys import DECLARED, NestedKey
from resc.scenes.pool import ScenePool
from resc.term import Curriculum, Metric, Observation, Reward, Sensing, Term, Termination

COUNT = 7
"""Environments of the trial: no shape that is declared has this length by accident."""
STEPS = 2
LARGE = 1 << 16
"""Numbers above which an input is taken for a map, which one look at its version has to do for."""
HELP = "docs/add-a-term.md lists what each kind of term returns"


def check_terms(stages: Stages, pool: ScenePool) -> None:
    """Begins `COUNT` episodes and flies `STEPS` steps, uncompiled, looking at what terms give.

    It has draws of its own, and those of torch's global generator are given back.

    Raises:
        ConfigError: A term raises, gives another number, shape, type or device of tensors than its
            kind has to, a number that is not finite, or changes what it reads.
    """
    device = pool.tasks[keys.START_W].device
    with torch.no_grad(), torch.random.fork_rng(_accelerators(device)), watched(list(stages.terms)):
        _fly(stages, pool, device)


@contextmanager
def watched(terms: Sequence[Term], batch: int = COUNT) -> Iterator[None]:
    """Within it, every `compute` of the terms checks what it is given and what it gives."""
    for term in terms:
        _require_names(term)
        vars(term)["compute"] = partial(_checked, term, term.compute, batch)
    try:
        yield
    finally:
        for term in terms:
            del vars(term)["compute"]


def _fly(stages: Stages, pool: ScenePool, device: torch.device) -> None:
    entries = (torch.arange(COUNT) % len(pool)).unsqueeze(-1).to(device)
    some = slice(0, COUNT)  # of all maps: their copies must stay cheap
    shared = {key: value[some] for key, value in pool.shared.items()}
    tasks = {key: value[some] for key, value in pool.tasks.items()}
    generator = torch.Generator().manual_seed(0)

    full = {name: torch.ones(1, 1, device=device) for name in stages.difficulties}
    at_reset = _drawn(stages.reset_draws | stages.step_draws, generator, device)
    world, _ = stages.restart(tasks, entries, shared, at_reset, full)
    for step in range(STEPS):
        action = 2 * torch.rand(COUNT, stages.terms.action.width, generator=generator) - 1
        draws = _drawn(stages.step_draws, generator, device)
        world, out = stages.step(world, shared, action.to(device), draws)
        if step == 0 and len(pool) >= COUNT and out.done.all():
            ends = ", ".join(sorted({stages.outcomes[int(code)] for code in out.outcome}))
            raise ConfigError(
                f"Every episode ends in its first step ({ends}); check the numbers of these "
                "terminations against where the scene's episodes start."
            )


def _drawn(
    widths: dict[str, int], generator: torch.Generator, device: torch.device
) -> dict[str, Tensor]:
    return {
        name: torch.rand(COUNT, width, generator=generator).to(device)
        for name, width in widths.items()
    }


def _checked(
    term: Term, compute: Callable[..., Tensor | tuple[Tensor, ...]], batch: int, *given: Tensor
) -> Tensor | tuple[Tensor, ...]:
    """What a term's `compute` gives, having checked it."""
    before = [None if value.numel() > LARGE else value.clone() for value in given]
    versions = [value._version for value in given]
    try:
        result = compute(*given)
    except RescError as error:
        raise ConfigError(f"{term.path}: {error}") from None
    except Exception as error:  # whatever a user's lines raise is theirs to know
        raise ConfigError(_failure(term, given, error)) from error
    values = result if isinstance(result, tuple) else (result,)
    _require_unchanged(term, given, before, versions)
    if len(values) != len(term.outputs):
        raise ConfigError(
            f"{term.path} gives {len(values)} tensors; expected {len(term.outputs)}, one for "
            f"each key it writes: {', '.join(map('.'.join, term.outputs))}."
        )
    for key, value in zip(term.outputs, values, strict=True):
        _require_fit(term, key, value, batch, given)
    return result


def _failure(term: Term, given: Sequence[Tensor], error: Exception) -> str:
    """What a compute that raises is told: the reason and what it was given."""
    names = [".".join(key) for key in term.reads]
    if isinstance(term, Metric):
        names = ["its last value", *names]
    names += ["uniform draws", "difficulty"][: len(given) - len(names)]
    shapes = [list(value.shape) for value in given]
    inputs = ", ".join(f"{n} {_written(s)}" for n, s in zip(names, shapes, strict=False))
    reason = (str(error).splitlines() or [""])[0]
    return (
        f"{term.path} cannot be computed ({type(error).__name__}: {reason}); "
        f"{type(term).__name__}.compute gets {inputs or 'nothing'}."
    )


def _require_names(term: Term) -> None:
    """Names that Python takes for something else: a tuple without its comma is a string."""
    columns = getattr(term, "columns", ())
    if isinstance(columns, str) or not all(isinstance(name, str) for name in columns):
        raise ConfigError(
            f"{term.path} has the columns {columns!r}; expected a tuple of names, such as "
            "('x',) with its comma."
        )
    if isinstance(term, Observation) and not columns:
        raise ConfigError(f"{term.path} has no columns; name the numbers that it returns.")


def _require_unchanged(
    term: Term, given: Sequence[Tensor], before: Sequence[Tensor | None], versions: Sequence[int]
) -> None:
    for number, (value, old, version) in enumerate(zip(given, before, versions, strict=True)):
        if isinstance(term, Sensing) and set(term.reads[number : number + 1]) & set(term.writes):
            continue
        if value._version == version and (old is None or torch.equal(value, old)):
            continue
        first = len(given) - len(term.reads) if isinstance(term, Metric) else 0
        read = number - first
        name = ".".join(term.reads[read]) if 0 <= read < len(term.reads) else f"argument {number}"
        raise ConfigError(
            f"{term.path} changes {name} in place, which others read; let compute return a new "
            "tensor (no +=, no .clamp_() on what it is given)."
        )


def _require_fit(
    term: Term, key: NestedKey, value: object, batch: int, given: Sequence[Tensor]
) -> None:
    """Whether one output is the tensor that its kind or its key asks for."""
    name = term.path if len(term.outputs) == 1 else f"{term.path} for {'.'.join(key)}"
    if not isinstance(value, Tensor):
        raise ConfigError(f"{name} gives {type(value).__name__}; expected a tensor ({HELP}).")
    shape, dtypes = _wanted(term, key)
    found = tuple(value.shape)
    fits = found[:1] == (batch,) and (
        shape is None
        or (
            len(found) == 1 + len(shape)
            and all(n in (None, m) for n, m in zip(shape, found[1:], strict=True))
        )
    )
    if not fits:
        rest = ["..."] if shape is None else [size or "k" for size in shape]
        wanted = _written([batch, *rest], batch)
        raise ConfigError(f"{name} gives {_written(found, batch)}; expected {wanted} ({HELP}).")
    if value.dtype not in dtypes:
        types = " or ".join(str(dtype).removeprefix("torch.") for dtype in dtypes)
        raise ConfigError(
            f"{name} gives {str(value.dtype).removeprefix('torch.')}; expected {types} ({HELP})."
        )
    if given and value.device != given[0].device:
        raise ConfigError(
            f"{name} is on {value.device}, but what it reads on {given[0].device}; make new "
            "tensors with device=, or register_buffer for constants."
        )
    finite = ~value.isnan() if isinstance(term, Metric) else value.isfinite()
    if not finite.all():
        wrong = value[~finite][0].item()
        several = value.ndim == 2 and value.shape[1] > 1
        column = f" in column {int((~finite.all(0)).nonzero()[0])}" if several else ""
        raise ConfigError(
            f"{name} gives {wrong}{column} at the beginning of an episode; expected finite "
            "numbers: look for a division by zero, a root or logarithm of a number below zero."
        )


def _wanted(
    term: Term, key: NestedKey
) -> tuple[tuple[int | None, ...] | None, tuple[torch.dtype, ...]]:
    """Shape per environment (None: any) and types of an output."""
    if isinstance(term, Observation):
        return (len(term.columns),), (torch.float32,)
    if isinstance(term, Reward | Metric):
        return (1,), (torch.float32,)
    if isinstance(term, Termination) and key == (term.group, term.name):
        return (1,), (torch.bool,)
    if key in DECLARED:
        declared = DECLARED[key]
        shape = tuple(term.dims.get(d) if isinstance(d, str) else d for d in declared.shape)
        return shape, (declared.dtype,)
    if key in term.initial or isinstance(term, Curriculum):
        return (1,), (torch.float32,)
    return None, (torch.float32, torch.bool, torch.int64)


def _written(shape: Sequence[int | str], batch: int = COUNT) -> str:
    """A shape as documentation writes it: the number of environments is n."""
    sizes = ["n" if size == batch == COUNT else str(size) for size in shape]
    return f"[{', '.join(sizes)}]"


def _accelerators(device: torch.device) -> list[int]:
    if device.type != "cuda":
        return []
    return [torch.cuda.current_device() if device.index is None else device.index]


def require_torch(stages: Stages) -> None:
    """Refuses to compile what calls other code than torch."""
    if foreign := [term.path for term in stages.terms if not term.compiles]:
        raise ConfigError(
            f"{', '.join(foreign)} cannot be compiled: it calls a simulator outside of torch; set "
            "compile=false, or choose another."
        )
