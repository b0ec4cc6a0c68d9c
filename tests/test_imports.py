"""The import rule of docs/architecture: rooms import rooms below them only."""

import ast
from pathlib import Path

from source_trees import parsed

PACKAGE = Path(__file__).parents[1] / "resc"
FLOORS = (
    {"cuda_graph", "early", "errors", "garbage", "kept_program", "keys", "moved", "places"},
    {"shared_means"},
    {"ranks"},
    {
        "console",
        "math",
        "process",
        "quantities",
        "run_folder",
        "sights",
        "command_line",
    },
    {"term", "sweep_folder"},
    {"groups"},
    {"schema"},
    {"build", "settings", "starting"},
    {"simulation", "maps"},
    {"scenes"},
    {"terms"},
    {"envs"},
    {"planning", "policies", "recording"},
    {"setup", "flight_logs"},
    {"viewing", "flying", "door"},
    {"baselines", "learning", "evaluation", "log_command", "gym"},
    {"studies", "deployment", "compile_kernels"},
    {"pages"},
    {"sweeps"},
)
"""From the ground up. Rooms of one floor do not know each other."""
HYDRA_ROOMS = {"build", "schema", "starting"}
FILES = sorted(
    path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE or path.name != "__init__.py"
)


def imported(path):
    """Full names of the modules that a file imports."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.module != "resc":
                yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room(name):
    return name.split(".")[1] if name.startswith("resc.") else None


def floor(name):
    floors = [number for number, rooms in enumerate(FLOORS) if name in rooms]
    assert floors, f"resc/{name} is new: say above which floor it stands"
    return floors[0]


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def test_a_file_imports_its_own_room_and_lower_floors():
    for path in FILES:
        own = room_of(path)
        others = {room(name) for name in imported(path) if room(name)} - {own}
        too_high = [name for name in others if floor(name) >= floor(own)]
        assert not too_high, path.relative_to(PACKAGE)


def test_term_files_do_not_know_each_other_nor_the_environment():
    for path in (PACKAGE / "terms").glob("*/*.py"):
        foreign = [name for name in imported(path) if room(name) in ("terms", "envs", "build")]
        assert not foreign, path.name


def test_hydra_is_met_in_build_and_schema_only():
    for path in FILES:
        names = {name.split(".")[0] for name in imported(path)}
        assert room_of(path) in HYDRA_ROOMS or "hydra" not in names, path.name


def test_nothing_relies_on_the_internals_of_hydra():
    plugins = (PACKAGE.parent / "hydra_plugins").glob("*.py")
    for path in (*FILES, *plugins):
        assert not [name for name in imported(path) if name.startswith("hydra._")], path.name
