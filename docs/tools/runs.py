"""The page of the settings of a run, and that of the examples."""

import ast
import json
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from docs.tools.settings import HEAD, arguments, head_comment, row, settings_of
from resc.groups import GROUPS
from resc.schema import BoundSchema, EvaluateSchema, ExportSchema, FlySchema, TrainSchema

ROOT = Path(__file__).parents[2]
SCHEMAS = {
    "train": TrainSchema,
    "evaluate": EvaluateSchema,
    "bound": BoundSchema,
    "fly": FlySchema,
    "export": ExportSchema,
}
"""What each file at the top of conf/ is checked against."""


def settings() -> str:
    """The page of what is no part: one section for each kind of run."""
    blocks = ["# Settings of a run", "The groups of a run have pages of their own."]
    for name, schema in SCHEMAS.items():
        path = ROOT / "conf" / f"{name}.yaml"
        blocks += [f"## {name}", head_comment(path), f"`conf/{name}.yaml`", _table(schema)]
        blocks.append(f"```yaml\n{settings_of(path)}\n```")
    return "\n\n".join(blocks) + "\n"


def _table(schema: type[Any]) -> str:
    """The settings of a run that belong to no group, with what they are unless they are set."""
    known, groups = arguments(schema), {group.name for group in GROUPS}
    rows = [
        row(
            f.name,
            f.default if f.default is not MISSING else f.default_factory(),
            known[f.name].meaning,
        )
        for f in fields(schema)
        if f.name not in groups
    ]
    return "\n".join([HEAD, *rows])


def examples() -> str:
    """The page of the examples: each whole."""
    blocks = ["# Examples", "Programs to begin with; each is a file of `examples/`."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = path.read_text()
        said = (ast.get_docstring(ast.parse(text)) or "").partition("\n\n")[0]
        blocks += [f"## {path.name}", " ".join(said.split()), f"```python\n{text.strip()}\n```"]
    for path in sorted((ROOT / "examples").glob("*.ipynb")):
        blocks.append(f"## {path.name}")
        blocks += [_cell(cell) for cell in json.loads(path.read_text())["cells"]]
    for path in sorted((ROOT / "examples").glob("cpp/*.cpp")):
        blocks += [f"## {path.name}", f"```cpp\n{path.read_text().strip()}\n```"]
    return "\n\n".join(blocks) + "\n"


def _cell(cell: Mapping[str, Any]) -> str:
    """A cell of a notebook; its headings are no sections of the page."""
    text = "".join(cell["source"])
    return text.lstrip("# ") if cell["cell_type"] == "markdown" else f"```python\n{text}\n```"
