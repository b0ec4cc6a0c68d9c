"""What the run at hand is composed from: its files, its suites, its scenes."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, combinations
from typing import Any, NamedTuple, cast

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.config_source import ConfigSource
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from resc.command_line import override, split_override
from resc.errors import ConfigError, nearest, shown
from resc.groups import names

PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
"""A name of a scene that may be part of Hydra's keys."""
CLEARANCE = ".clearance_m=[{0},{0}]"
"""What a scene that has a clearance of its own is given for one of the search."""
LISTS = names(lambda group: group.several)
"""Groups of which a configuration takes several files."""


def given() -> list[str]:
    """The overrides of the command, as they were typed."""
    return [str(text) for text in HydraConfig.get().overrides.task]


def sources_of_run() -> list[ConfigSource]:
    """Where the run's files of configuration are from, in the order in which they are searched."""
    plugins = cast(list[type[ConfigSource]], Plugins.instance().discover(ConfigSource))
    kinds = {kind.scheme(): kind for kind in plugins}
    return [
        kinds[source.schema](source.provider, f"{source.schema}://{source.path}")
        for source in HydraConfig.get().runtime.config_sources
    ]


class File(NamedTuple):
    """A file of the configuration: its path, group and content, and the file that lists it."""

    path: str
    group: str
    content: DictConfig
    listed_by: str


def files_of_lists(groups: Collection[str]) -> Iterator[File]:
    """The files that the run takes of some groups."""
    hydra = HydraConfig.get()
    overrides = [*hydra.overrides.hydra, *hydra.overrides.task]
    loader = GlobalHydra.instance().config_loader()
    listed = loader.compute_defaults_list(hydra.job.config_name, overrides, RunMode.RUN)
    sources = sources_of_run()
    every = ((d.config_path, d.package, d.parent or "") for d in listed.defaults)
    for path, package, parent in every:
        source = next((s for s in sources if path and s.is_config(path)), None)
        if path and package in groups and source:
            content = cast(DictConfig, source.load_config(path).config)
            yield File(path, package, content, parent)


def suites() -> dict[str, list[str]]:
    """The suites that the run takes, and the scenes that the file of each names."""
    found = files_of_lists(("suite",))
    return {
        path.rpartition("/")[2]: [str(name) for name in content] for path, _, content, _ in found
    }


def files_of(group: str) -> dict[str, DictConfig]:
    """All files of a folder of the configuration that the run can see, by name."""
    found: dict[str, DictConfig] = {}
    for source in sources_of_run():
        if source.is_group(group):
            for name in source.list(group, ObjectType.CONFIG):
                path = f"{group}/{name}"
                found.setdefault(name, cast(DictConfig, source.load_config(path).config))
    return found


def composed_with(overrides: Sequence[str]) -> DictConfig:
    """The run's configuration as it would be with these overrides after its own, resolved.

    Raises:
        ConfigError: One of them names nothing that there is.
    """
    hydra = HydraConfig.get()
    search = [text for text in hydra.overrides.hydra if "searchpath" in text]
    every = [*search, *given(), *overrides]
    try:
        config = compose(hydra.job.config_name, every)
    except (HydraException, OmegaConfBaseException) as error:
        told = str(error.__cause__ or error).partition("\n")[0]
        raise ConfigError(f"{', '.join(overrides)} cannot be composed: {told}") from None
    OmegaConf.resolve(config)
    return config


def compose_scenes(names: Sequence[str], numbers: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The scenes of these names with the numbers given in place of their own.

    Raises:
        ConfigError: A scene is unknown, named twice or cannot be composed, or all of them say
            themselves what the command says for the search.
    """
    listed = [s.list("scene", ObjectType.CONFIG) for s in sources_of_run() if s.is_group("scene")]
    known = set(chain.from_iterable(listed))
    for name, times in Counter(names).items():
        if name not in known:
            raise ConfigError(f"Unknown scene '{name}'.{nearest(name, known)}")
        if times > 1:
            raise ConfigError(f"scenes names '{name}' {times} times; raise flights instead.")
    together = _composed_together(names)
    scenes = {}
    for name in names:
        own = OmegaConf.create(together[name] if name in together else _composed_alone(name))
        both = OmegaConf.to_container(OmegaConf.merge(own, numbers), resolve=True)
        scenes[name] = cast(dict[str, Any], both)
    _refuse_idle("search", scenes, f"'+scene{CLEARANCE}'")
    return scenes


def _composed_together(names: Sequence[str]) -> dict[str, Any]:
    """Those of the scenes that mean the same beside each other: it takes as long as one alone.

    What a file interpolates may be read from `scene`, which then holds all of them by name.
    """
    plain = [name for name in names if PLAIN.fullmatch(name)]
    try:
        found = _composed_scene(override(f"+scene@scene.{name}", name) for name in plain)
    except (HydraException, OmegaConfBaseException):  # told by the one that cannot be composed
        return {}
    if set(found) != set(plain):  # a file puts something elsewhere
        return {}
    nodes = {name: OmegaConf.to_container(found[name]) for name in plain}
    return {name: node for name, node in nodes.items() if "${" not in str(node)}


def _composed_alone(name: str) -> Any:  # noqa: ANN401 - a node
    try:
        return OmegaConf.to_container(_composed_scene([override("+scene", name)]), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        told = str(error.__cause__ or error).partition("\n")[0].rstrip(".")
        raise ConfigError(f"scene/{name} cannot be composed: {told}; mend this file.") from None


def _composed_scene(overrides: Iterable[str]) -> DictConfig:
    """The group `scene` with these files, and nothing else of what the command says."""
    hydra = HydraConfig.get()
    search = [text for text in hydra.overrides.hydra if "searchpath" in text]
    return compose(hydra.job.config_name, [*search, *overrides])["scene"]


def refuse_idle_clearance(scene: object, held_out: Mapping[Any, Any] | None) -> None:
    """Refuses a clearance of the search that the command gives and no scene of a training keeps.

    A file may give one, such as that of an experiment, for whatever scenes are chosen beside it. A
    run that goes on keeps its settings.

    Args:
        scene: Its node.
        held_out: Nodes that take the place of the training's in held-out flights.

    Raises:
        ConfigError: It names the scene, and its own setting.
    """
    if dict(map(split_override, given())).get("resume", "null") != "null":
        return
    own, trained = held_out or {}, {_chosen("scene"): scene}
    place, flown = "scene", trained
    if own.get("scene"):
        place, flown = "held_out.scene", {_chosen("scene@held_out.scene"): own["scene"]}
    _refuse_idle("held_out.search", flown, place + CLEARANCE)
    scenes = trained if own.get("search") else {**trained, **flown}
    _refuse_idle("search", scenes, "scene" + CLEARANCE)


def _refuse_idle(search: str, scenes: Mapping[str, Any], instead: str) -> None:
    """Refuses the clearance that the command gives a search if all scenes have their own."""
    asked = dict(map(split_override, given())).get(f"{search}.clearance_m")
    own = [isinstance(n, Mapping) and n.get("clearance_m") is not None for n in scenes.values()]
    if asked is not None and own and all(own):
        say = "say themselves" if len(own) > 1 else "says itself"
        raise ConfigError(
            f"{search}.clearance_m would change nothing: {', '.join(scenes)} {say} what the routes "
            f"keep; leave it out, or give {instead.format(asked)}."
        )


def _chosen(group: str) -> str:
    """What the run takes of a group, as it is given."""
    name = HydraConfig.get().runtime.choices.get(group)
    path = group.rpartition("@")[2]
    return f"{path}={name}" if name else path


def refuse_doubles() -> None:
    """Refuses a composed configuration in which a term, or the numbers of a scene, are said twice.

    Hydra would merge the two without a word: the numbers of the later one would count.

    Raises:
        ConfigError: The term and the files that define it, or the scene and its suites.
    """
    defined: dict[str, File] = {}
    files = list(files_of_lists(LISTS))
    _refuse_other_numbers([file for file in files if file.group == "suite"])
    for file in files:
        for name, node in file.content.items():
            if not isinstance(node, DictConfig) or "_target_" not in node:
                continue
            term = f"{file.group}.{name}"
            if term in defined and not _for_both(defined[term], file):
                both = dict.fromkeys((defined[term].path, file.path))
                source = " and ".join(both) if len(both) > 1 else f"{file.path}, listed twice"
                raise ConfigError(f"{term} is defined by {source}; keep one, or rename the other.")
            defined[term] = file


def _refuse_other_numbers(files: Sequence[File]) -> None:
    """Refuses suites that fly the same scene in other numbers, unless the command says which."""
    settled = {key for key, value in map(split_override, given()) if value != "null"}
    for one, other in combinations(files, 2):
        if _lists(one, other, files) or _lists(other, one, files):
            continue  # a suite may give other numbers than those that it begins with
        for name in [name for name in one.content if name in other.content]:
            mine, theirs = _numbers(one, name), _numbers(other, name)
            for number in {**mine, **theirs}:
                key, both = f"suite.{name}.{number}", (mine.get(number), theirs.get(number))
                said = {key, f"~suite.{name}"} if None in both else {key, f"~suite.{name}", number}
                if both[0] == both[1] or said & settled:
                    continue
                first, second = ("null" if value is None else shown(value) for value in both)
                raise ConfigError(
                    f"{key} is {first} in {one.path} and {second} in {other.path}; leave one of "
                    f"the suites out, or say which counts: {key}={first}."
                )


def _numbers(file: File, name: Any) -> dict[Any, Any]:  # noqa: ANN401 - as a file holds it
    """What a suite says of a scene; a suite that is wrong is told where it is read."""
    numbers = cast(dict[Any, Any], OmegaConf.to_container(file.content))[name]
    return numbers if isinstance(numbers, dict) else {}


def _lists(one: File, other: File, files: Sequence[File]) -> bool:
    """Whether a file has another one among its defaults, or among those of its defaults."""
    listed_by = {file.path: file.listed_by for file in files}
    path = other.listed_by
    while path and path != one.path:
        path = listed_by.get(path, "")
    return path == one.path


def _for_both(one: File, other: File) -> bool:
    """Whether a list that was given is that of the run and that of an estimator's sensors.

    Hydra puts it in the place of both.
    """
    brought = {file.listed_by.startswith("estimator/") for file in (one, other)}
    return one.path == other.path and brought == {True, False}
