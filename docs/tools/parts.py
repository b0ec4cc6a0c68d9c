"""Pages of the parts: one for each folder of conf/, with an entry for each of its files.

An entry says what the file's first comment and the class's docstring say, what the part reads and
writes, and its numbers with their units.
"""

import inspect
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from griffe import DocstringSectionKind
from omegaconf import DictConfig, ListConfig, OmegaConf

from docs.tools import keys
from docs.tools.settings import HEAD, arguments, comments, head_comment, row, sections, settings_of
from resc.build import build_term, locate
from resc.groups import GROUPS, Group
from resc.term import Curriculum, Term

ROOT = Path(__file__).parents[2]
CONF = ROOT / "conf"
RUNS = {"train": "train.py", "evaluate": "evaluate.py", "bound": "resc.evaluation.bound"}
OWNERS = {
    "evaluation": "",
    "policy": " An evaluation flies with the policy's own, unless the command line names another.",
    "scene": " An evaluation has its own, unless the scene brings no route: then the policy's.",
}
_NONE = inspect.Parameter.empty


def pages() -> dict[str, str]:
    """The text of every page, by its path in the site."""
    folders = sorted(path for path in CONF.iterdir() if path.is_dir())
    return {f"parts/{folder.name}.md": page(folder) for folder in folders}


def files(folder: Path) -> list[Path]:
    """The files of a folder of conf/, those of its own folders, too."""
    return sorted(folder.rglob("*.yaml"))


def page(folder: Path) -> str:
    """The page of a folder of conf/."""
    entries = [entry(path) for path in files(folder)]
    return "\n\n".join([f"# {folder.name}", *_introduction(folder.name), *entries]) + "\n"


def _introduction(folder: str) -> Iterator[str]:
    """What the group is, by the table of docs/parts.md, and what `resc.groups` knows of it."""
    table = (ROOT / "docs" / "parts.md").read_text()
    said = re.search(rf"^\| `{folder}`(?: \*)? \| (.*?) \|", table, re.MULTILINE)
    if said:
        text = re.sub(r"\]\((?=[\w-]+\.md)", "](../", said[1])
        yield f"{text[0].upper()}{text[1:]}."
    for group in GROUPS:
        if folder in (*([group.name] if group.own_folder else []), *group.folders):
            yield _group(group)


def _group(group: Group) -> str:
    kind = f", each a {_reference(group.kind)}" if group.kind else ""
    takes = f"`{group.name}` takes {'a list of these files' if group.several else 'one file'}{kind}"
    runs = ", ".join(f"`{RUNS[run]}`" for run in group.runs)
    return f"{takes}. Runs that have it: {runs}.{OWNERS[group.owner]}"


def entry(path: Path) -> str:
    """What is said of one file of conf/."""
    own, nodes = _loaded(path), list(_nodes(_whole(path)))
    name = path.relative_to(CONF).as_posix()
    blocks = [f"## {path.stem}", head_comment(path), f"`conf/{name}`{_brings(own)}"]
    for number, (where, node) in enumerate(nodes):
        outer = not number and where in ("", path.stem)
        blocks += [*([] if outer else [f"### {where}"]), *_part(where, node, path)]
    if not nodes:
        blocks.append(f"```yaml\n{settings_of(path)}\n```")
    return "\n\n".join(block for block in blocks if block)


def _brings(own: Mapping[str, Any]) -> str:
    """What a file takes from others."""
    taken = [entry for entry in own.get("defaults", []) if entry != "_self_"]
    shown = [e if isinstance(e, str) else str(OmegaConf.to_container(e))[1:-1] for e in taken]
    shown = ", ".join(f"`{one}`".replace("'", "") for one in shown)
    return f", on top of {shown}" if taken else ""


@cache
def _loaded(path: Path) -> DictConfig | ListConfig:
    """What a file holds."""
    return OmegaConf.load(path)


def _whole(path: Path) -> Mapping[str, Any]:
    """The settings of a file, with those of the files of its folder that it builds on."""
    own = _loaded(path)
    based = [d for d in own.get("defaults", []) if isinstance(d, str) and d != "_self_"]
    below = [_whole(path.with_name(f"{name}.yaml")) for name in based]
    plain = OmegaConf.to_container(OmegaConf.merge(*below, own))
    return {key: value for key, value in plain.items() if key != "defaults"}


def _nodes(node: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every node that names a class, by where it stands, the outer ones first."""
    if "_target_" in node:
        yield where, node
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _nodes(value, f"{where}.{key}" if where else key)


def _part(where: str, node: Mapping[str, Any], path: Path) -> Iterator[str]:
    """A class, what it reads and writes, its numbers."""
    kind = locate(node["_target_"], where, ("resc.", "hydra_plugins."))
    summary, *rest = _said(kind)
    yield f"{_reference(kind)}: {summary}"
    yield from rest
    if issubclass(kind, Term):
        wanted = Curriculum if issubclass(kind, Curriculum) else Term
        term = build_term(node, where, (), wanted).named(where.rpartition(".")[2] or path.stem)
        yield keys.table(term.reads, term.outputs)
    rows = list(_rows(kind, node, comments(path)))
    if rows:
        yield "\n".join([HEAD, *rows])


def _rows(kind: type, node: Mapping[str, Any], beside: Mapping[str, str]) -> Iterator[str]:
    """A line for every number of a node, and for every one that it leaves to the class."""
    known = arguments(kind)
    left = {name: one.default for name, one in known.items() if one.default is not _NONE}
    for name, value in (left | dict(node)).items():
        if name != "_target_" and not (isinstance(value, Mapping) and any(_nodes(value))):
            meaning = known[name].meaning if name in known else ""
            yield row(name, value, meaning or beside.get(name, ""))


def _said(kind: type) -> list[str]:
    """Paragraphs of a docstring, without its arguments; lines of equations stay lines."""
    texts = [s.value for s in sections(kind.__doc__) if s.kind is DocstringSectionKind.text]
    paragraphs = [paragraph.splitlines() for text in texts for paragraph in text.split("\n\n")]
    return [("<br>" if all("=" in x for x in lines) else " ").join(lines) for lines in paragraphs]


def _reference(kind: type) -> str:
    return f"[`{kind.__name__}`][{kind.__module__}.{kind.__qualname__}]"
