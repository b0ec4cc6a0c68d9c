"""Pages of the program's interface: one for each room of resc/, with all that is public there."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
SPLIT = "terms"
"""A room so large that each of its own rooms has a page."""


def public(path: Path) -> list[str]:
    """Names of the public classes and functions of a file."""
    kinds = (ast.ClassDef, ast.FunctionDef)
    body = ast.parse(path.read_text()).body
    return [node.name for node in body if isinstance(node, kinds) and node.name[0] != "_"]


def rooms() -> dict[str, list[Path]]:
    """The files with something public, by the name of their room."""
    found: dict[str, list[Path]] = defaultdict(list)
    for path in sorted([*ROOT.glob("resc/**/*.py"), *ROOT.glob("hydra_plugins/*.py")]):
        if public(path):
            found[room(path)].append(path)
    return dict(sorted(found.items()))


def room(path: Path) -> str:
    """The room of a file: its folder, or the uppermost one but resc/ itself."""
    inside = path.relative_to(ROOT).parent.parts
    return ".".join(inside[: 3 if inside[1:2] == (SPLIT,) else 2])


def module(path: Path) -> str:
    """Full name of the module that a file is."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def pages() -> dict[str, str]:
    """The text of every page, by its path in the site."""
    found = {"api/index.md": _index()}
    for name, paths in rooms().items():
        blocks = [f"::: {module(path)}\n" for path in paths]
        found[f"api/{name}.md"] = "\n".join([f"# {name}\n", *blocks])
    return found


def _index() -> str:
    """The door of the package, and a table of its rooms."""
    lines = [
        "# The program\n",
        "What most programs need is in `resc` itself: [`make_env`][resc.door.make_env], "
        "[`load_policy`][resc.door.load_policy] and [`load`][resc.door.load] "
        "([From Python](../python.md)).\n",
        "| room | what is in it |",
        "|---|---|",
    ]
    for name in rooms():
        init = ROOT / name.replace(".", "/") / "__init__.py"
        said = ast.get_docstring(ast.parse(init.read_text())) if init.exists() else ""
        first = " ".join((said or "Sweeps in Hydra.").partition("\n\n")[0].split())
        lines.append(f"| [{name}]({name}.md) | {first} |")
    return "\n".join(lines) + "\n"
