"""What README and docs show in their code blocks and tables: commands, programs, files."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "policies" / "README.md"]
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
PROGRAM = r"(?:\w+=\S+ )?(?:python|resc-log|resc-train|torchrun|make|pip|g\+\+|\./\w+)"
COMMAND = re.compile(rf"{PROGRAM}(?: |$)")
INLINE = re.compile(rf"`({PROGRAM} [^`]+)`")


@dataclass(frozen=True)
class Block:
    """What stands between two fences."""

    page: str
    line: int
    language: str
    text: str
    file: str
    """Its name where the line above gives one."""


def blocks():
    """Every code block of every page."""
    for path in PAGES:
        text = path.read_text()
        for found in FENCE.finditer(text):
            named = re.search(r"^`(\S+\.\w+)`.*\n\n\Z", text[: found.start()], re.MULTILINE)
            yield Block(
                path.relative_to(ROOT).as_posix(),
                text[: found.start()].count("\n") + 1,
                found[2],
                found[3],
                named[1] if named else "",
            )


def is_shell(block):
    """Whether a block holds commands: one that says no language may be a listing."""
    return block.language == "bash" or (not block.language and bool(COMMAND.match(block.text)))


def lines(block):
    """The commands of a block, without comments."""
    whole = block.text.replace("\\\n", " ")
    return [" ".join(re.sub(r"\s# .*|\s+#$", "", line).split()) for line in whole.splitlines()]


def commands():
    """Every command that is shown, with the pages that show it."""
    found = {}
    for block in blocks():
        for line in lines(block) if is_shell(block) else ():
            found.setdefault(line, set()).add(block.page)
    for path in PAGES:
        for line in INLINE.findall(FENCE.sub("", path.read_text())):
            found.setdefault(" ".join(line.split()), set()).add(path.relative_to(ROOT).as_posix())
    return {line: sorted(pages) for line, pages in sorted(found.items())}
