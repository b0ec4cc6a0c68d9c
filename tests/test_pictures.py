"""Every picture of README and docs is there, and beneath it stands the command that makes it."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PICTURE = re.compile(r"!\[[^\]]*\]\(([^)\s]+\.(?:png|gif))\)")
COMMAND = re.compile(r"(?:python (-m [\w.]+|[\w/]+\.py)|(make) (\w+)|(resc-log) (\w+))")
BENEATH = 12
"""Lines below a picture within which its command stands."""
SHOWN = [
    (page, number, found.group(1))
    for page in PAGES
    for number, line in enumerate(page.read_text().splitlines())
    for found in PICTURE.finditer(line)
]


@pytest.mark.parametrize(("page", "number", "picture"), SHOWN, ids=[shown[2] for shown in SHOWN])
def test_a_picture_is_there_and_its_command_stands_beneath(page, number, picture):
    assert (page.parent / picture).is_file()
    beneath = page.read_text().splitlines()[number : number + 1 + BENEATH]
    commands = COMMAND.findall("\n".join(beneath))
    assert commands, f"{page.name}, line {number + 1}: say which command makes {picture}"
    assert any(_exists(*command) for command in commands)


def test_every_picture_of_docs_is_shown():
    shown = {(page.parent / picture).resolve() for page, _, picture in SHOWN}
    drawn = [
        path
        for folder in (ROOT / "docs", ROOT / "docs/observations")
        for path in folder.iterdir()
        if path.suffix in (".png", ".gif")
    ]
    assert {path.name for path in drawn if path.resolve() not in shown} == set()


def test_colours_are_named_in_one_file():
    stray = {
        path.name: found
        for folder in ("resc", "benchmarks", "examples")
        for path in (ROOT / folder).rglob("*.py")
        if (found := re.findall(r"[\"'](?:#[0-9a-fA-F]{6}|tab:|C\d[\"']|tab10)", path.read_text()))
    }
    assert set(stray) == {"colours.py"}


def _exists(script, make, target, log, verb):
    """Whether there is such a script, module, target or verb."""
    if make:
        return f"\n{target}:" in (ROOT / "Makefile").read_text()
    if log:
        verbs = "".join(path.read_text() for path in (ROOT / "resc/log_command").glob("*.py"))
        return f'"{verb}"' in verbs
    module = script.removeprefix("-m ")
    place = ROOT / (module.replace(".", "/") if script.startswith("-m ") else script)
    return place.is_file() or place.with_suffix(".py").is_file() or place.is_dir()
