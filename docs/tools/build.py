"""Builds the site in build/docs, of the pages of docs/ and of those made of the repository.

python -m docs.tools.build, as `make docs` does.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path, PurePosixPath

from docs.tools import api, keys, parts, runs

TOOLS = Path(__file__).parent
ROOT = TOOLS.parents[1]
LINK = re.compile(r"(!?)\[([^]]*)\]\(([^)#\s]*)(#[^)\s]*)?\)")
ELSEWHERE = {"README.md": "index.md", "policies/README.md": "policies.md"}
"""Pages that stand outside docs/."""
LEFT_OUT = ("tools", "*.tar.xz", "*.md")
USUAL = ("Build started", "No issues found", "Build finished")
"""How the lines begin that Zensical always prints."""


def pages() -> dict[str, str]:
    """The text of every page, by its path in the site."""
    written = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "docs").rglob("*.md")}
    found = {name.removeprefix("docs/"): path.read_text() for name, path in written.items()}
    found |= {page: (ROOT / path).read_text() for path, page in ELSEWHERE.items()}
    found["parts.md"] = re.sub(
        r"^\| `(\w+)`", r"| [`\1`](parts/\1.md)", found["parts.md"], flags=re.M
    )
    made = {
        **api.pages(),
        **parts.pages(),
        "parts/runs.md": runs.settings(),
        "keys.md": keys.page(),
        "examples.md": runs.examples(),
    }
    there = {*found, *made}
    return {name: led(text, name, there) for name, text in found.items()} | made


def led(text: str, name: str, there: set[str]) -> str:
    """A page whose links lead to pages of the site; links to what is on none become plain text."""
    stands = {page: path for path, page in ELSEWHERE.items()}.get(name, f"docs/{name}")
    folder = PurePosixPath(stands).parent

    def lead(found: re.Match[str]) -> str:
        picture, label, target, anchor = found.groups(default="")
        if not target or ":" in target:
            return found[0]
        page, _, place = page_of(os.path.normpath(folder / target)).partition("#")
        if page.endswith(".md") and page not in there:
            return label
        page = os.path.relpath(page, PurePosixPath(name).parent)
        return f"{picture}[{label}]({page}{f'#{place}' if place else anchor})"

    return LINK.sub(lead, text)


def page_of(path: str) -> str:
    """Where the site shows a file of the repository."""
    whole = PurePosixPath(path)
    if path in ELSEWHERE:
        return ELSEWHERE[path]
    if path.startswith("examples/"):
        return f"examples.md#{whole.name.replace('.', '')}"
    if path.startswith("conf/"):
        return f"parts/{whole.parts[1]}.md#{whole.stem}"
    if path.startswith("resc/"):
        return f"api/{api.room(ROOT / path)}.md#{api.module(ROOT / path)}"
    return path.removeprefix("docs/")


def assemble(folder: Path) -> None:
    """Writes the pages, what they show, and how the site is built of them."""
    shutil.rmtree(folder, ignore_errors=True)
    shown = folder / "pages"
    shutil.copytree(ROOT / "docs", shown, ignore=shutil.ignore_patterns(*LEFT_OUT))
    for name, text in pages().items():
        (shown / name).parent.mkdir(parents=True, exist_ok=True)
        (shown / name).write_text(text)
    shutil.copy(TOOLS / "site.css", shown)
    shutil.copy(TOOLS / "mkdocs.yml", folder)


def build(folder: Path) -> int:
    """Builds the site in a folder; whatever is said beside what is always said is an error."""
    zensical = Path(sys.executable).with_name("zensical")
    command = [zensical, "build", "--strict", "-f", folder / "mkdocs.yml"]
    quiet = {**os.environ, "NO_COLOR": "1"}
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=quiet
    )
    warnings = [line for line in done.stdout.splitlines() if not line.startswith(USUAL)]
    print("\n".join(warnings) or f"Open {folder / 'site' / 'index.html'}.")
    return done.returncode or bool(warnings)


if __name__ == "__main__":
    assemble(ROOT / "build" / "docs")
    sys.exit(build(ROOT / "build" / "docs"))
