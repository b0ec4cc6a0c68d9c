"""How large the parts are, and how much each function is told: limits that only tighten."""

import ast
import statistics
from collections import Counter
from pathlib import Path

from source_trees import parsed

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "resc").rglob("*.py"))
LINES = {path: len(path.read_text().splitlines()) for path in FILES}
WHOLE = ("config", "settings", "stored", "rules")
"""What a parameter is called that holds a whole configuration."""
MAPPINGS = ("Mapping[str, Any]", "dict[str, Any]", "Settings")
MOST_WITH_ALL = 6


def takes_all(function):
    """Whether a parameter of a function is a whole configuration."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    types = {a.arg: ast.unparse(a.annotation) if a.annotation else "" for a in arguments}
    return any(
        kind == "DictConfig" or (name in WHOLE and any(one in kind for one in MAPPINGS))
        for name, kind in types.items()
    )


def test_a_function_takes_what_it_needs_and_seldom_the_whole_configuration():
    """A node, a number or a built part says what a function depends on; a configuration does not.

    Those that take all of it check it, build the step of it or compose it.
    """
    found = [
        f"{path.relative_to(ROOT)}: {node.name}"
        for path in FILES
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.FunctionDef) and takes_all(node)
    ]
    assert len(found) <= MOST_WITH_ALL, "\n".join(found)


def test_no_room_is_larger_than_a_fifth_of_all():
    rooms = Counter()
    for path, lines in LINES.items():
        rooms[path.relative_to(ROOT / "resc").parts[0]] += lines
    (room, largest), *_ = rooms.most_common(1)
    assert largest <= 0.2 * sum(LINES.values()), room


def test_files_are_short():
    assert statistics.median(LINES.values()) <= 100
    assert statistics.quantiles(LINES.values(), n=10)[-1] <= 260


def test_the_scripts_fit_on_a_page():
    for name in ("train.py", "evaluate.py"):
        assert len((ROOT / name).read_text().splitlines()) <= 100, name
