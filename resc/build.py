"""From configuration to objects: every name and number is checked before anything runs.

A stored configuration is data: only targets under an allowed prefix are built, so reading one runs
no foreign code.
"""

import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from yaml import YAMLError

from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages, Terms
from resc.errors import ConfigError, nearest
from resc.math.sampling import generator_for
from resc.quantities import checked
from resc.scenes.layout import Layout
from resc.scenes.pool import ScenePool
from resc.term import Curriculum, Observation, Reward, Term
from resc.terms.randomizations.action_delay import ActionDelay

ALLOWED = ("resc.", "torch.optim.")
"""Prefixes of `_target_` that may be built; a user's own package is added by `allowed_targets`."""
FUNCTIONS = ("resc.learning.networks.build_networks",)
"""Our only targets that are functions: others, `build` for one, would build what they are told."""


def build(
    config: Mapping[str, Any], path: str, *, allowed: Iterable[str] = (), **extra: Any
) -> Any:
    """The object that one configuration node describes.

    Args:
        config: A mapping with `_target_` and keyword arguments.
        path: Where the node stands, for messages.
        allowed: Further prefixes of `_target_`.
        **extra: Arguments that come from the program, not from the configuration.

    Raises:
        ConfigError: The target is unknown or not allowed, an argument is unknown, missing, of the
            wrong type or out of range.
    """
    if not isinstance(config, Mapping) or "_target_" not in config:
        raise ConfigError(
            f"{path} has no _target_; name the class to build, e.g. "
            "resc.terms.rewards.progress.Progress."
        )
    target = locate(str(config["_target_"]), path, (*ALLOWED, *allowed))
    arguments = {key: _plain(value) for key, value in config.items() if key != "_target_"}
    parameters = _arguments_of(target)
    known = [name for name in parameters if name not in extra]
    for name, value in arguments.items():
        if name not in known:
            raise ConfigError(
                f"{path}.{name} is not an argument of {target.__name__}.{nearest(name, known)}"
            )
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
        return target(**arguments, **extra)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def locate(target: str, path: str, allowed: Iterable[str]) -> Callable[..., Any]:
    """The class or function a `_target_` names, if its prefix is allowed."""
    if not target.startswith(tuple(allowed)):
        raise ConfigError(
            f"{path}._target_ is '{target}', outside {', '.join(allowed)}; opt in with "
            "allowed_targets=[yourpackage.]"
        )
    module_name, _, name = target.rpartition(".")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise ConfigError(f"{path}._target_ is '{target}', but {error}.") from None
    found = getattr(module, name, None)
    if not callable(found):
        raise ConfigError(
            f"{path}._target_ is '{target}'; {module_name} has no "
            f"'{name}'.{nearest(name, _public(module))}"
        )
    ours = inspect.isclass(found) and found.__module__.startswith(ALLOWED)
    if target.startswith(ALLOWED) and not ours and target not in FUNCTIONS:
        raise ConfigError(f"{path}._target_ is '{target}', which is no class of ours; name one.")
    return found


def build_terms(
    group: Mapping[str, Any] | None, path: str, kind: type[Term], allowed: Iterable[str] = ()
) -> list[Any]:
    """The terms of one group, in the order of the configuration, each with its name."""
    terms = []
    for name, node in (group or {}).items():
        if node is None:
            continue
        term = _build_term(node, f"{path}.{name}", allowed)
        if not isinstance(term, kind):
            raise ConfigError(
                f"{path}.{name} builds a {type(term).__name__}, which is no {kind.__name__}."
            )
        terms.append(term.named(name))
    return terms


def _build_term(node: Any, path: str, allowed: Iterable[str]) -> Any:
    """One term, and the difficulty that eases it, which is no argument of its class."""
    if not isinstance(node, Mapping) or "difficulty" not in node:
        return build(node, path, allowed=allowed)
    eased = node["difficulty"]
    rest = {key: value for key, value in node.items() if key != "difficulty"}
    term = build(rest, path, allowed=allowed)
    if eased is None:
        return term
    if not getattr(term, "eases", False):
        raise ConfigError(
            f"{path}.difficulty is {eased!r}, but {type(term).__name__} has nothing that a "
            "difficulty eases; drop it."
        )
    if not isinstance(eased, str):
        raise ConfigError(
            f"{path}.difficulty is {eased!r}; expected the name of a difficulty, such as obstacles."
        )
    term.difficulty = eased
    return term


def build_stages(config: Mapping[str, Any]) -> Stages:
    """The step and the reset of a run's configuration."""
    from resc import term as kinds  # the kinds by name; a flat import list would repeat them

    allowed = config.get("allowed_targets", ())
    vehicle = build(config["vehicle"], "vehicle", allowed=allowed)
    constants = {name: value for name, value in config["env"].items() if name != "layout"}
    context = build({"_target_": "resc.term.Context", **constants}, "env", vehicle=vehicle)

    def group(name: str, kind: type[Term]) -> list[Any]:
        return build_terms(config.get(name), name, kind, allowed)

    def one(name: str) -> Any:
        return build(config[name], name, allowed=allowed).named(name)

    task = config["task"]
    terms = Terms(
        action=one("action"),
        rate_loop=one("rate_loop"),
        dynamics=one("dynamics"),
        task=build(task["control_points"], "task.control_points", allowed=allowed).named(
            "control_points"
        ),
        initial_state=_build_term(task["initial_state"], "task.initial_state", allowed).named(
            "initial_state"
        ),
        sensors=group("sensor", kinds.Sensor),
        terminations=group("termination", kinds.Termination),
        rewards=group("reward", Reward),
        observations=_in_layout(group("observation", Observation), config["env"]["layout"]),
        randomizations=group("randomization", kinds.Randomization),
        metrics=group("metric", kinds.Metric),
    )
    if not terms.rewards or not terms.observations or not terms.terminations:
        raise ConfigError("reward, observation and termination need at least one term each.")
    _check_delays(terms)
    return Stages(terms, context, (config.get("scene") or {}).get("difficulty"))


def build_pool(
    config: Mapping[str, Any],
    *,
    size: int,
    seed: int,
    device: torch.device | str = "cpu",
    plan: Callable[[Layout], Layout] | None = None,
    curricula: Iterable[Curriculum] = (),
) -> ScenePool:
    """The scene pool of a run's configuration, at full difficulty unless a curriculum eases it."""
    scene = build(config["scene"], "scene", allowed=config.get("allowed_targets", ()))
    levels = {term.name: term.levels for term in curricula}
    return ScenePool(
        scene,
        size=size,
        resolution_m=config["env"]["resolution_m"],
        generator=generator_for(seed, "scene_layout"),
        device=device,
        plan=plan,
        levels=levels.get(config["scene"].get("difficulty"), (1.0,)),
    )


def build_env(config: Mapping[str, Any], pool: ScenePool, **options: Any) -> QuadrotorEnv:
    """The environment of a run's configuration, resetting into `pool`."""
    return QuadrotorEnv(
        build_stages(config),
        pool,
        num_envs=config["num_envs"],
        device=config["device"],
        compiled=config["compile"],
        **options,
    )


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


def _check_delays(terms: Terms) -> None:
    """A delay that the action's queue cannot hold would be cut without a word."""
    held = getattr(terms.action, "dims", {}).get("d", 1) - 1
    for term in terms.randomizations:
        if isinstance(term, ActionDelay) and term.longest_steps > held:
            raise ConfigError(
                f"randomization.{term.name}.longest_steps is {term.longest_steps}, but the "
                f"action's queue holds {held}; raise action.longest_delay_steps."
            )


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


def _in_layout(observations: list[Observation], layout: Iterable[str]) -> list[Observation]:
    """Observations in the order of `layout`; those it does not name follow as configured."""
    order = {name: number for number, name in enumerate(layout)}
    return sorted(observations, key=lambda term: order.get(term.name, len(order)))


def _plain(value: Any) -> Any:
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def _public(module: Any) -> list[str]:
    return [
        name
        for name, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module.__name__ and name[0] != "_"
    ]
