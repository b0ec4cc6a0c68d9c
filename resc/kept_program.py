"""Compiled programs that the next process takes up as they are.

torch.compile keeps the machine code that it makes, but reads a function's Python again in every
process: most of what a start consists of. Here the whole program is kept, in a file that is named
by everything that the program is made of: every source file of this package, the configuration, the
versions and settings of Python and torch, the processor, the threads, the shapes of the arguments.
torch itself compares the source of what it has read, and at every call the shapes and the numbers
that the program has taken from objects. Where anything differs, or torch cannot keep a function,
that is compiled as ever.

The files lie beside torch's own and, like those, are for who may write there: `pickle` reads them.
"""

import functools
import hashlib
import json
import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

import resc

PACKAGE = Path(__file__).parent
READ = ("tensordict", "torchrl", "jaxtyping")
"""Packages whose functions are read beside ours and torch's."""
REFUSED = "GuardManager check failed"
"""What torch says, having done nothing, where a program does not fit what it is called with."""
JUST_NOW_S = 2.0
"""A file that changed as shortly before the process began may not be what was imported."""
Function = Callable[..., Any]


def compiled(function: Function, facts: str = "") -> Function:
    """The function, compiled as one program at its first call.

    Args:
        function: Of tensors and of what holds them.
        facts: All that the program depends on beside this package, its objects and its arguments,
            such as `facts_of`; empty where nobody knows, and then the program is not kept.
    """
    fresh = torch.compile(function, fullgraph=True, dynamic=False)
    return _Kept(function, fresh, facts if _is_as_imported() else "")


def facts_of(parts: Mapping[str, Any], *, allowed: Sequence[str], device: object) -> str:
    """Parts of a configuration as text; empty where others' code or a GPU belongs to them.

    Args:
        parts: By name; single settings, such as the seed, are left out.
        allowed: Prefixes of code outside this package that they may name.
        device: Where they run.
    """
    if allowed or str(device) != "cpu":
        return ""
    groups = {str(name): part for name, part in parts.items() if isinstance(part, Mapping)}
    return json.dumps(groups, default=repr)


class _Kept:
    """A function whose program is in a file, from its first call on."""

    def __init__(self, function: Function, fresh: Function, facts: str) -> None:
        self.function, self.fresh, self.facts = function, fresh, facts
        self.program: Function | None = None

    def __call__(self, *given: Any) -> Any:  # noqa: ANN401 - the function's
        if self.program is None:
            self.program = self._kept(given) or self.fresh
        if self.program is self.fresh:
            return self.fresh(*given)
        try:
            return self.program(*given)
        except RuntimeError as error:
            if REFUSED not in str(error):
                raise
        self.program = self.fresh
        return self.fresh(*given)

    def _kept(self, given: Sequence[Any]) -> Function | None:
        """The program in its file, which is made if it is not there; None where torch cannot."""
        if not self.facts:
            _say_compiling()
            return None
        name = "\n".join((_surroundings(), self.facts, self.function.__qualname__, _told(given)))
        owner = getattr(self.function, "__self__", None)
        try:
            path = _folder() / f"{hashlib.sha256(name.encode()).hexdigest()}.program"
            if not path.exists():
                _say_compiling()
                _write(cast(Any, self.fresh).aot_compile((tuple(given), {})), path)
            with path.open("rb") as file:
                program = torch.compiler.load_compiled_function(file)
        except Exception:  # torch says of this part that it may change; what is wrong, fresh tells
            return None
        return program if owner is None else functools.partial(program, owner)


def _write(made: Any, path: Path) -> None:  # noqa: ANN401 - torch's
    """Writes a program; other processes, such as runs of a sweep, may be writing the same one."""
    part = path.with_suffix(f".{os.getpid()}")
    try:
        made.save_compiled_function(str(part))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@functools.cache
def _say_compiling() -> None:
    """Prints a line, once in a process."""
    print("Compiling step and networks: up to a minute.", flush=True)


def _told(value: Any) -> str:  # noqa: ANN401 - any argument
    """An argument, as far as a program depends on it."""
    if isinstance(value, Tensor):
        return f"{value.dtype}{tuple(value.shape)}{value.stride()}{value.requires_grad}"
    if isinstance(value, Mapping):
        return repr([(key, _told(part)) for key, part in value.items()])
    if isinstance(value, Sequence) and not isinstance(value, str):
        return repr([_told(part) for part in value])
    return repr(value)


def _surroundings() -> str:
    """What every program is made of and in."""
    from torch._dynamo import config as reading
    from torch._inductor import config as writing

    given = (*reading.save_config_portable().items(), *writing.save_config_portable().items())
    settings = [(name, sorted(v, key=repr) if isinstance(v, set) else v) for name, v in given]
    threads, learns = torch.get_num_threads(), torch.is_grad_enabled()
    known = sorted(os.environ.get(name, "") for name in ("CXX", "CC"))
    return repr((_source(), _machine(), settings, threads, learns, known))


@functools.cache
def _source() -> str:
    """A number for all source files of this package."""
    told = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        told.update(f"\0{path.relative_to(PACKAGE)}\0".encode())
        told.update(path.read_bytes())
    return told.hexdigest()


@functools.cache
def _machine() -> tuple[str | None, ...]:
    """Python, torch and what else is read, the processor and what it can do."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    processor = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
    built = (torch.__version__, torch.version.git_version, torch.version.cuda)
    here = (sys.version, str(PACKAGE), platform.machine(), platform.processor())
    return (*here, *built, *map(version, READ), *sorted(processor))


def _is_as_imported() -> bool:
    """Whether no source file of this package has changed since, or just before, it was imported."""
    return all(path.stat().st_ctime < resc.BEGAN_S - JUST_NOW_S for path in PACKAGE.rglob("*.py"))


def _folder() -> Path:
    """Where programs are kept: beside what torch keeps."""
    from torch._inductor.runtime.cache_dir_utils import cache_dir

    folder = Path(cache_dir()) / "resc"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
