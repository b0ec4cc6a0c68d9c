"""From configuration to objects: every name and number is checked before anything runs.

A stored configuration is data: only targets under an allowed prefix are built, so reading one runs
no foreign code.
"""

import importlib
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages, Terms
from resc.errors import ConfigError, RescError, nearest, shown
from resc.maps.cells import require_room
from resc.math.sampling import generator_for
from resc.quantities import NotNegative, checked
from resc.scenes.layout import PARKED_M, Layout, Scene
from resc.scenes.pool import ScenePool
from resc.term import CellSize, Curriculum, Observation, Reward, Term
from resc.terms.randomizations.action_delay import ActionDelay
from resc.terms.randomizations.limits import Margin

ALLOWED = ("resc.", "torch.optim.")
"""Prefixes of `_target_` that may be built; a user's own package is added by `allowed_targets`."""
PROBED = 32
"""Scenes laid out to look at, before a whole pool is."""
FUNCTIONS = ("resc.policies.networks.build_networks",)
"""Our only targets that are functions: others, `build` for one, would build what they are told."""


MOVED = {
    "resc.learning.networks.": "resc.policies.networks.",
    "resc.sweeps.Joblib": "resc.sweeps.sweep.Joblib",
    "resc.sweeps.Ray": "resc.sweeps.sweep.Ray",
    "resc.sweeps.Serial": "resc.sweeps.sweep.Serial",
    "resc.sweeps.Slurm": "resc.sweeps.sweep.Slurm",
}
"""Targets of stored configurations, by how they begin, and where they are today."""


def build(
    config: Any,
    path: str,
    *,
    allowed: Iterable[str] = (),
    kind: type | None = None,
    **extra: Any,
) -> Any:
    """The object that one configuration node describes.

    Args:
        config: A mapping with `_target_` and keyword arguments.
        path: Where the node stands, for messages.
        allowed: Further prefixes of `_target_`.
        kind: What the object must be.
        **extra: Arguments that come from the program, not from the configuration.

    Raises:
        ConfigError: The target is unknown, not allowed or of another kind, an argument is unknown,
            missing, of the wrong type or out of range.
    """
    if not isinstance(config, Mapping) or "_target_" not in config:
        raise ConfigError(
            f"{path} has no _target_, it is {shown(_plain(config))}; name the class to build, e.g. "
            "resc.terms.rewards.progress.Progress."
        )
    node = _resolved(config, path)
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
        if _holds_parts(value):
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
        raise ConfigError(f"{path} builds a {type(made).__name__}, which is no {kind.__name__}.")
    return made


def _holds_parts(value: Any) -> bool:
    """Whether a setting is a mapping of nodes, each to be built; null leaves one out."""
    nodes = [node for node in value.values() if node] if isinstance(value, Mapping) else []
    return bool(nodes) and any(isinstance(node, Mapping) and "_target_" in node for node in nodes)


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
    if target.startswith(ALLOWED) and not ours and target not in FUNCTIONS:
        raise ConfigError(f"{path}._target_ is '{target}', which is no class of ours; name one.")
    return found


def today(target: str) -> str:
    """The name that a target of a stored configuration has now."""
    for begins, now in MOVED.items():
        if target.startswith(begins):
            return now + target.removeprefix(begins)
    return target


def build_terms(group: Any, path: str, kind: type[Term], allowed: Iterable[str] = ()) -> list[Any]:
    """The terms of one group, in the order of the configuration, each with its name."""
    if not isinstance(group, Mapping | None):
        raise ConfigError(
            f"{path} is {shown(_plain(group))}; expected terms by their names, as the files of "
            f"conf/{path} have them."
        )
    return [
        _build_term(node, f"{path}.{name}", allowed, kind).named(str(name))
        for name, node in (group or {}).items()
        if node is not None
    ]


def _build_term(node: Any, path: str, allowed: Iterable[str], kind: type[Term]) -> Any:
    """One term, and what is no argument of its class: the difficulty that eases it, `optional`."""
    if isinstance(node, Mapping) and "optional" in node and kind is Curriculum:
        rest = {key: value for key, value in node.items() if key != "optional"}
        term = build(rest, path, allowed=allowed, kind=kind)
        if not isinstance(node["optional"], bool):
            raise ConfigError(f"{path}.optional is {node['optional']!r}; expected true or false.")
        term.optional = node["optional"]
        return term
    if not isinstance(node, Mapping) or "difficulty" not in node:
        return build(node, path, allowed=allowed, kind=kind)
    eased = node["difficulty"]
    rest = {key: value for key, value in node.items() if key != "difficulty"}
    term = build(rest, path, allowed=allowed, kind=kind)
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
    env = _resolved(config["env"], "env")
    layout = checked("env.layout", env.pop("layout", []), Sequence[str])
    context = build({"_target_": "resc.term.Context", **env}, "env", vehicle=vehicle)

    def group(name: str, kind: type[Term]) -> list[Any]:
        return build_terms(config.get(name), name, kind, allowed)

    def one(name: str, kind: type[Term] = Term) -> Any:
        return build(config[name], name, allowed=allowed, kind=kind).named(name)

    def of_task(name: str) -> Any:
        node = _resolved(config["task"], "task").get(name)
        return _build_term(node, f"task.{name}", allowed, Term).named(name)

    terms = Terms(
        action=one("action", kinds.Action),
        rate_loop=one("rate_loop"),
        dynamics=one("dynamics"),
        task=of_task("control_points"),
        initial_state=of_task("initial_state"),
        sensors=group("sensor", kinds.Sensor),
        terminations=group("termination", kinds.Termination),
        rewards=group("reward", Reward),
        observations=_in_layout(group("observation", Observation), layout),
        randomizations=group("randomization", kinds.Randomization),
        metrics=group("metric", kinds.Metric),
    )
    if not terms.rewards or not terms.observations or not terms.terminations:
        raise ConfigError("reward, observation and termination need at least one term each.")
    scene = config.get("scene") or {}
    _check_delays(terms)
    _check_margins(terms, scene.get("clearance_m"))
    return Stages(terms, context, scene.get("difficulty"))


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
    scene = build(config["scene"], "scene", allowed=config.get("allowed_targets", ()), kind=Scene)
    resolution_m = cell_of(config)
    some = scene.sample(PROBED, generator_for(seed, "scene_layout"))
    require_room(size, some.size, resolution_m, device)
    _require_boxes(scene, some)
    levels = {term.name: term.levels for term in curricula}
    pool = ScenePool(
        scene,
        size=size,
        resolution_m=resolution_m,
        generator=generator_for(seed, "scene_layout"),
        device=device,
        plan=plan,
        levels=levels.get(config["scene"].get("difficulty"), (1.0,)),
    )
    _require_ways(pool.layout, config)
    return pool


def cell_of(config: Mapping[str, Any]) -> float:
    """Edge of a map cell [m] of a run's configuration."""
    env = _resolved(config["env"], "env")
    return checked("env.resolution_m", env.get("resolution_m"), CellSize)


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


def _require_boxes(scene: Scene, some: Layout) -> None:
    """Guards that leave no room for any box would make a free scene without a word."""
    wanted = getattr(scene, "boxes", 0)
    if isinstance(wanted, int) and wanted and not (some.boxes_w[..., 0] < PARKED_M).any():
        raise ConfigError(
            f"scene.boxes is {wanted}, but {len(some)} scenes have not a single one: none is far "
            "enough from start, goal or path; lower the distances to keep clear, or set "
            "scene.boxes=0."
        )


def arrival_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """What a configuration says of reaching a control point; nothing where it has no task."""
    node = _resolved(config.get("task") or {}, "task").get("control_points") or {}
    return _resolved(node, "task.control_points")


def _require_ways(layout: Layout, config: Mapping[str, Any]) -> None:
    """An arrival that reaches from all goals to their starts leaves nothing to fly."""
    radius_m = arrival_of(config).get("radius_m")
    last = layout.route_length.clamp(min=1).unsqueeze(-1).expand(-1, 1, 3) - 1
    goal = layout.route_w.gather(1, last)[:, 0]
    farthest_m = float(torch.linalg.vector_norm((goal - layout.start_w)[:, :2], dim=-1).max())
    if isinstance(radius_m, int | float) and farthest_m <= radius_m and len(layout) > 1:
        raise ConfigError(
            f"task.control_points.radius_m is {radius_m}, but no goal is farther than "
            f"{farthest_m:.3g} m from its start; lower it."
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


def _check_margins(terms: Terms, clearance_m: Any) -> None:
    """Margins that follow the scene's routes and are said to be others would be cut, or never met.

    Equal ends fix the margin whatever the routes keep.
    """
    if clearance_m is None:
        return
    kept = checked("scene.clearance_m", _plain(clearance_m), Sequence[NotNegative])
    for term in terms.randomizations:
        if not isinstance(term, Margin) or len(set(term.margin_m)) == 1:
            continue
        met = [round(end - term.headroom_m, 6) for end in kept]
        if met != [round(end, 6) for end in term.margin_m]:
            raise ConfigError(
                f"randomization.{term.name}.margin_m is {list(term.margin_m)}, but routes keep "
                f"scene.clearance_m={kept}, less {term.headroom_m:g} m of headroom "
                f"{met}; set scene.clearance_m="
                f"{[round(end + term.headroom_m, 6) for end in term.margin_m]}."
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


def _reason(error: Exception) -> str:
    """An error's type and the first line of what it says."""
    return f"{type(error).__name__}: {(str(error).splitlines() or ['nothing'])[0]}"


def _search_help(package: str) -> str:
    return (
        f" where Python looks for packages; set PYTHONPATH to the folder that holds {package}/, "
        "or install it"
    )


def _resolved(node: Any, path: str) -> dict[Any, Any]:
    """A mapping with its interpolations filled in."""
    try:
        plain = _plain(node)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{path} cannot be resolved ({_reason(error)}).") from None
    if not isinstance(plain, Mapping):
        raise ConfigError(f"{path} is {shown(plain)}; expected settings by their names.")
    return {key: _plain(value) for key, value in plain.items()}


def _plain(value: Any) -> Any:
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
