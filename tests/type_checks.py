"""Checks the types and shapes that `resc` declares, at every call; imported before it.

As jaxtyping's own hook with beartype, at a quarter of the cost: a function that declares no shapes
is left to beartype alone; one that does is checked when it is given or returns tensors of shapes
and types that it has not passed with before.
"""

import ast
import functools
import hashlib
import sys
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import Any

from beartype import BeartypeConf, beartype
from jaxtyping import jaxtyped
from numpy import ndarray
from torch import Tensor

PACKAGE = "resc"
checks_types = beartype(conf=BeartypeConf(violation_type=TypeError))
VERSION = hashlib.sha1(Path(__file__).read_bytes()).hexdigest()[:8]


def checked(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that checks what it is given and returns.

    Hints in quotes are for the static type checker alone: what they name may not be imported.
    """
    hints = function.__annotations__
    function.__annotations__ = {n: hint for n, hint in hints.items() if not isinstance(hint, str)}
    checks = checks_types(function)
    if any("jaxtyping." in str(hint) for hint in hints.values()):
        checks = checked_once(function, checks)
    function.__annotations__ = checks.__annotations__ = hints
    return checks


def checked_once(function: Callable[..., Any], checks: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose shapes are checked once for every form of what it is given and returns."""
    passed: set[Any] = set()
    returned: list[Any] = []

    @checks_types
    @functools.wraps(function)
    def checks_returned(*args: Any, **kwargs: Any) -> Any:
        return returned.pop()

    @functools.wraps(function)
    def within_its_shapes(*args: Any, **kwargs: Any) -> Any:
        given = (*map(form, args), form(kwargs)) if kwargs else (*map(form, args),)
        known = given in passed
        if known:
            result = function(*args, **kwargs)
            if (given, form(result)) in passed:
                return result
            returned.append(result)
        with jaxtyped("context"):  # in which one letter stands for one length
            result = (checks_returned if known else checks)(*args, **kwargs)
        passed.update((given, (given, form(result))))
        return result

    return within_its_shapes


def form(value: Any) -> Any:
    """What the checks depend on: types and shapes, down to what lists and mappings hold."""
    kind = type(value)
    if kind is Tensor:  # before the others, for most are
        return value.dtype, value.shape
    if kind in (tuple, list):
        return kind, *map(form, value)
    if kind is dict:
        return kind, *((name, form(item)) for name, item in value.items())
    if kind in (str, type):  # a word or a class may be meant
        return value
    return (kind, value.dtype, value.shape) if has_shape(kind) else kind


@functools.cache
def has_shape(kind: type) -> bool:
    """Whether a type is one of tensors or arrays."""
    return issubclass(kind, Tensor | ndarray)


class Decorating(ast.NodeTransformer):
    """Decorates every function, and the dataclasses, whose __init__ is nobody's function."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Innermost, where the annotations are; nothing within `no_type_check`."""
        if any("no_type_check" in ast.unparse(decorator) for decorator in node.decorator_list):
            return node
        node.decorator_list.append(self._named("checked"))
        return self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """Outermost, after `dataclass`."""
        if any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
            node.decorator_list.insert(0, self._named("checked_dataclass"))
        return self.generic_visit(node)

    def _named(self, name: str) -> ast.expr:
        return ast.parse(f"__import__({__name__!r}).{name}", mode="eval").body


checked_dataclass = jaxtyped(typechecker=checks_types)


class Loader(SourceFileLoader):
    """Reads a module with its functions decorated, and keeps its bytecode apart."""

    def source_to_code(self, data: Any, path: Any, *, _optimize: int = -1) -> Any:
        """The code of the decorated source."""
        tree = ast.fix_missing_locations(Decorating().visit(ast.parse(data)))
        return super().source_to_code(tree, path, _optimize=_optimize)

    def get_data(self, path: str) -> bytes:
        """What a file holds."""
        return super().get_data(self._own(path))

    def set_data(self, path: str, data: Any, **options: Any) -> None:
        """Writes a file."""
        super().set_data(self._own(path), data, **options)

    def _own(self, path: str) -> str:
        return f"{path.removesuffix('.pyc')}.{VERSION}.pyc" if path.endswith(".pyc") else path


class Finder(MetaPathFinder):
    """Finds the modules of the package for the loader."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Where a module is, if it is one of the package."""
        if name.partition(".")[0] != PACKAGE:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec and isinstance(spec.loader, SourceFileLoader):
            spec.loader = Loader(spec.loader.name, spec.loader.path)
        return spec


assert PACKAGE not in sys.modules
sys.meta_path.insert(0, Finder())
