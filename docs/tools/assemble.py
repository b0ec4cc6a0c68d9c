"""Gathers the pages of the site in build/docs: those of docs/, and those made of the repository.

python docs/tools/assemble.py, as `make docs` does before it builds the site.
"""

import os
import re
import shutil
import sys
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
LINK = re.compile(r"(!?)\[([^]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
ELSEWHERE = {"README.md": "index.md", "policies/README.md": "policies.md"}
"""Pages that stand outside docs/."""
LEFT_OUT = ("tools", "*.tar.xz", "*.md")


def pages() -> dict[str, str]:
    """The text of every page, by its path in the site."""
    written = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "docs").rglob("*.md")}
    found = {name.removeprefix("docs/"): path.read_text() for name, path in written.items()}
    found |= {page: (ROOT / path).read_text() for path, page in ELSEWHERE.items()}
    there = set(found)
    return {name: led(text, name, there) for name, text in found.items()}


def led(text: str, name: str, there: set[str]) -> str:
    """A page whose links lead to pages of the site; links to what is on none become plain text."""
    stands = {page: path for path, page in ELSEWHERE.items()}.get(name, f"docs/{name}")
    folder = PurePosixPath(stands).parent

    def lead(found: re.Match[str]) -> str:
        picture, label, target, anchor = found.groups(default="")
        if not target or ":" in target:
            return found[0]
        path = os.path.normpath(folder / target)
        page = page_of(path, there)
        if page is None:
            return label
        return f"{picture}[{label}]({os.path.relpath(page, PurePosixPath(name).parent)}{anchor})"

    return LINK.sub(lead, text)


def page_of(path: str, there: set[str]) -> str | None:
    """Where the site shows a file of the repository; None if nowhere."""
    if path in ELSEWHERE:
        return ELSEWHERE[path]
    within = path.removeprefix("docs/")
    shown = path.startswith("docs/") and (not path.endswith(".md") or within in there)
    return within if shown else None


def assemble(folder: Path) -> None:
    """Writes the pages, what they show, and how the site is built of them."""
    shutil.rmtree(folder, ignore_errors=True)
    shown = folder / "pages"
    shutil.copytree(ROOT / "docs", shown, ignore=shutil.ignore_patterns(*LEFT_OUT))
    for name, text in pages().items():
        (shown / name).parent.mkdir(parents=True, exist_ok=True)
        (shown / name).write_text(text)
    shutil.copy(Path(__file__).with_name("mkdocs.yml"), folder)


if __name__ == "__main__":
    assemble(ROOT / "build" / "docs")
