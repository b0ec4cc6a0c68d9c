"""The page of the keys, and tables of what a part reads and writes."""

from collections import defaultdict
from collections.abc import Iterable

from resc.keys import DECLARED, Declaration, NestedKey


def page() -> str:
    """Every key of `resc.keys`, by its first word."""
    groups: dict[str, list[NestedKey]] = defaultdict(list)
    for key in DECLARED:
        groups[key[0] if len(key) > 1 else "of a step"].append(key)
    lines = [
        "# Keys",
        "\nWhat parts read from each other and write for each other. `n` is the number of "
        "environments; `w` is the world, east, north and up, `b` the body, forward, left and up. "
        "`memory.` before a key stands for its value before the current step.",
    ]
    for group, keys in groups.items():
        lines += [
            f"\n## {group}\n",
            "| key | shape | unit | type | meaning |",
            "|---|---|---|---|---|",
        ]
        lines += [_line(key, DECLARED[key]) for key in keys]
    return "\n".join(lines) + "\n"


def _line(key: NestedKey, told: Declaration) -> str:
    kind = str(told.dtype).removeprefix("torch.")
    cells = [
        f'<span id="{"-".join(key)}"></span>`{".".join(key)}`',
        *_size(told),
        kind,
        told.meaning,
    ]
    return f"| {' | '.join(cells)} |"


def _size(told: Declaration) -> tuple[str, str]:
    shape = told.shape if told.shared else ("n", *told.shape)
    return " x ".join(map(str, shape)), told.unit


def table(reads: Iterable[NestedKey], writes: Iterable[NestedKey]) -> str:
    """The keys that a part reads and writes, with their shapes and units."""
    lines = ["| | key | shape | unit |", "|---|---|---|---|"]
    for verb, keys in (("reads", reads), ("writes", writes)):
        lines += [f"| {verb} | {' | '.join(_named(key))} |" for key in keys]
    return "\n".join(lines)


def _named(key: NestedKey) -> tuple[str, str, str]:
    """A key, linked where it is declared, with shape and unit; a part names others itself."""
    declared = key[1:] if key[0] == "memory" else key
    name = f"`{'.'.join(key)}`"
    if declared not in DECLARED:
        return name, "", ""
    return f"[{name}](../keys.md#{'-'.join(declared)})", *_size(DECLARED[declared])
