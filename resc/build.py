"""From configuration to objects: every name and number is checked before anything runs.

A stored configuration is data: only targets under an allowed prefix are built, so reading one runs
no foreign code.
"""

import functools
import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from resc.errors import ConfigError, RescError, nearest, shown
from resc.moved import today
from resc.quantities import checked
from resc.term import Curriculum, Term

ALLOWED = ("resc.",)
"""Prefixes of `_target_` that may be built; a user's own package is added by `allowed_targets`."""


def build(
    node: Any,
    path: str,
    *,
    allowed: Iterable[str] = (),
    kind: type | None = None,
    **extra: Any,
) -> Any:
    """The object that one configuration node describes.

    Args:
        node: A mapping with `_target_` and keyword arguments.
        path: Where the node stands, for messages.
        allowed: Further prefixes of `_target_`.
        kind: What the object must be.
        **extra: Arguments that come from the program, not from the configuration.

    Raises:
        ConfigError: The target is unknown, not allowed or of another kind, an argument is unknown,
            missing, of the wrong type or out of range.
    """
    if not isinstance(node, Mapping) or "_target_" not in node:
        raise ConfigError(
            f"{path} has no _target_, it is {shown(plain(node))}; name the class to build, e.g. "
            "resc.terms.rewards.progress.Progress."
        )
    node = resolved(node, path)
    if not isinstance(node["_target_"], str):
        raise ConfigError(
            f"{path}._target_ is {shown(node['_target_'])}; expected the name of a class."
        )
    target = locate(node["_target_"], path, (*ALLOWED, *allowed))
    arguments = {str(key): value for key, value in node.items() if key != "_target_"}
    parameters = _arguments_of(target)
    known = [name for name in parameters if name not in extra]
    for name, value in arguments.items():
        if name not in known:
            raise ConfigError(
                f"{path}.{name} is not an argument of {target.__name__}.{nearest(name, known)}"
            )
        if _is_part(value):
            value = build(value, f"{path}.{name}", allowed=allowed)
        elif _holds_parts(value):
            value = _build_parts(value, f"{path}.{name}", allowed)
        arguments[name] = checked(f"{path}.{name}", value, parameters[name].annotation)
    missing = [
        n for n in known if parameters[n].default is inspect.Parameter.empty and n not in arguments
    ]
    if missing:
        raise ConfigError(
            f"{path} lacks {', '.join(missing)}, which {target.__name__} needs; set "
            f"{path}.{missing[0]}."
        )
    try:
        made = target(**arguments, **extra)
    except RescError as error:
        raise type(error)(f"{path}: {error}") from None
    except Exception as error:  # whatever a user's class raises is theirs to know
        raise ConfigError(
            f"{path} cannot be built: {target.__name__} raises {_reason(error)}."
        ) from error
    if kind is not None and not isinstance(made, kind):
        raise ConfigError(f"{path} builds a {type(made).__name__}, which is not a {kind.__name__}.")
    return made


def _is_part(value: Any) -> bool:
    """Whether a setting is itself a node to be built."""
    return isinstance(value, Mapping) and "_target_" in value


def _holds_parts(value: Any) -> bool:
    """Whether a setting is a mapping of nodes, each to be built; null leaves one out."""
    nodes = [node for node in value.values() if node] if isinstance(value, Mapping) else []
    return any(_is_part(node) for node in nodes)


def _build_parts(nodes: Mapping[str, Any], path: str, allowed: Iterable[str]) -> dict[str, Any]:
    """The objects of a mapping of nodes, by name."""
    there = {name: node for name, node in nodes.items() if node is not None}
    return {name: build(node, f"{path}.{name}", allowed=allowed) for name, node in there.items()}


def locate(target: str, path: str, allowed: Iterable[str]) -> Callable[..., Any]:
    """The class or function a `_target_` names, if its prefix is allowed."""
    target = today(target)
    allowed = tuple(allowed)
    package = target.partition(".")[0]
    if not target.startswith(allowed):
        opted = [prefix for prefix in allowed if prefix not in ALLOWED]
        listed = ",".join([*opted, f"{package}."])
        begun = f"{package}. is not among them; " if opted else ""
        raise ConfigError(
            f"{path}._target_ is '{target}', outside {', '.join(allowed)}; {begun}opt in with "
            f"allowed_targets=[{listed}]"
        )
    module_name, _, name = target.rpartition(".")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        where = "" if target.startswith(ALLOWED) or error.name != package else _search_help(package)
        raise ConfigError(f"{path}._target_ is '{target}', but {error}{where}.") from None
    except Exception as error:  # a module that is there, but cannot be imported
        raise ConfigError(
            f"{path}._target_ is '{target}', but {module_name} cannot be imported: "
            f"{_reason(error)}."
        ) from error
    found = getattr(module, name, None)
    if not callable(found):
        raise ConfigError(
            f"{path}._target_ is '{target}'; {module_name} has no "
            f"'{name}'.{nearest(name, _public(module))}"
        )
    ours = inspect.isclass(found) and found.__module__.startswith(ALLOWED)
    if target.startswith(ALLOWED) and not ours:  # build, for one, would build what it is told
        raise ConfigError(f"{path}._target_ is '{target}', which is not a class of ours; name one.")
    return found


def build_terms(group: Any, path: str, kind: type[Term], allowed: Iterable[str] = ()) -> list[Any]:
    """The terms of one group, in the order of the configuration, each with its name."""
    if not isinstance(group, Mapping | None):
        raise ConfigError(
            f"{path} is {shown(plain(group))}; expected terms by their names, as the files of "
            f"conf/{path} have them."
        )
    return [
        build_term(node, f"{path}.{name}", allowed, kind).named(str(name))
        for name, node in (group or {}).items()
        if node is not None
    ]


def build_term(node: Any, path: str, allowed: Iterable[str], kind: type[Term]) -> Any:
    """One term, and what is no argument of its class: the difficulty that eases it, `optional`."""
    if isinstance(node, Mapping) and "optional" in node and kind is Curriculum:
        rest = {key: value for key, value in node.items() if key != "optional"}
        term = build(rest, path, allowed=allowed, kind=kind)
        if not isinstance(node["optional"], bool):
            raise ConfigError(f"{path}.optional is {node['optional']!r}; expected true or false.")
        term.optional = node["optional"]
        return term
    rest, eased = without_difficulty(node, path)
    term = build(rest, path, allowed=allowed, kind=kind)
    if eased is not None and not getattr(term, "eases", False):
        raise ConfigError(
            f"{path}.difficulty is {eased!r}, but {type(term).__name__} has nothing that a "
            "difficulty eases; drop it."
        )
    if eased is not None:
        term.difficulty = eased
    return term


def without_difficulty(node: Any, path: str) -> tuple[Any, str | None]:
    """A node without `difficulty`, which is no argument of its class, and what that names.

    Raises:
        ConfigError: It is no name.
    """
    if not isinstance(node, Mapping) or "difficulty" not in node:
        return node, None
    eased = node["difficulty"]
    if not isinstance(eased, str | None):
        raise ConfigError(
            f"{path}.difficulty is {eased!r}; expected the name of a difficulty, such as obstacles."
        )
    return {key: value for key, value in node.items() if key != "difficulty"}, eased


@functools.cache
def _arguments_of(target: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The named arguments of a function, or of a class's `__init__`.

    An `__init__` that ends in `**options` takes those of its base class, too. Not the class's own
    signature: TensorDict's modules have a `__new__` that hides it in Python before 3.11.4.
    """
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    bases = [c for c in target.__mro__ if "__init__" in vars(c)] if inspect.isclass(target) else []
    found: dict[str, inspect.Parameter] = {}
    for function in [vars(base)["__init__"] for base in bases] or [target]:
        parameters = inspect.signature(function).parameters
        found |= {
            name: p
            for name, p in parameters.items()
            if p.kind in named and name not in ("self", *found)
        }
        if not any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()):
            break
    return found


def load_config(path: Path) -> DictConfig:
    """A stored configuration, read as data.

    Raises:
        ConfigError: The file is missing or holds no configuration.
    """
    if not path.exists():
        raise ConfigError(
            f"{path} does not exist; give the folder of a finished run or of a shipped policy."
        )
    try:
        config = OmegaConf.load(path)
    except (YAMLError, UnicodeDecodeError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"{path} cannot be read ({reason}); restore it from its run.") from None
    if not isinstance(config, DictConfig):
        raise ConfigError(f"{path} holds no configuration; restore it from its run.")
    return config


def _reason(error: Exception) -> str:
    """An error's type and the first line of what it says."""
    return f"{type(error).__name__}: {(str(error).splitlines() or ['nothing'])[0]}"


def _search_help(package: str) -> str:
    return (
        f" where Python looks for packages; set PYTHONPATH to the folder that holds {package}/, "
        "or install it"
    )


def resolved(node: Any, path: str) -> dict[Any, Any]:
    """A mapping with its interpolations filled in."""
    try:
        settings = plain(node)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{path} cannot be resolved ({_reason(error)}).") from None
    if not isinstance(settings, Mapping):
        raise ConfigError(f"{path} is {shown(settings)}; expected settings by their names.")
    return {key: plain(value) for key, value in settings.items()}


def plain(value: Any) -> Any:
    """A value without OmegaConf: its interpolations filled in, its mappings and lists Python's."""
    return (
        OmegaConf.to_container(value, resolve=True, throw_on_missing=True)
        if OmegaConf.is_config(value)
        else value
    )


def _public(module: Any) -> list[str]:
    return [
        name
        for name, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module.__name__ and name[0] != "_"
    ]
