"""What the pages of runs, evaluations and sweeps have in common."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from resc.pages.page import Html, Page, details, link, paragraph, table
from resc.run_folder import TERMS, json_of

HEADS = {
    "observation": ("observation", "first", "last", "columns"),
    "reward": ("reward", "weight", "what it is"),
    "termination": ("termination", "means", "when"),
    "randomization": ("randomization", "what it draws"),
    "difficulty": ("difficulty", "eases"),
}
LISTED = 12
"""Files of one kind that are linked one by one; of more, their folder is."""


def add_terms(page: Page) -> None:
    """The table of terms with their weights, as the run wrote it down."""
    terms = json_of(page.folder / TERMS)
    shown = [table(HEADS[kind], rows) for kind, rows in terms.items() if kind in HEADS and rows]
    page.add("Terms", *(Html(f"<p></p>{one}") for one in shown))


def add_files(page: Page, told: Mapping[str, str]) -> None:
    """Links to what is in the folder, of what patterns find, with what it is."""
    rows = []
    for pattern, what in told.items():
        found = sorted(page.folder.glob(pattern))
        if len(found) > LISTED:
            found = sorted({path.parent for path in found})
        rows += [(link(path, page.folder), _size(path), what) for path in found]
    page.add("Files", table(("file", "size", "what it holds"), rows))


def add_pictures(page: Page, title: str, paths: Sequence[tuple[Path, str]]) -> None:
    """A section of pictures that lie in the folder."""
    shown = [page.picture(path, what) for path, what in paths if path.exists()]
    page.add(title, Html(f'<div class="pictures">{"".join(shown)}</div>' if shown else ""))


def notes(title: str, text: str) -> Html:
    """Paragraphs to open."""
    parts = [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]
    return details(title, *map(paragraph, parts)) if parts else Html()


def about(*parts: str | None) -> str:
    """A line of what there is to say."""
    return " · ".join(part for part in parts if part)


def _size(path: Path) -> str:
    """How large a file, or all files of a folder, is."""
    files = [path] if path.is_file() else [part for part in path.rglob("*") if part.is_file()]
    size = sum(part.stat().st_size for part in files)
    return f"{size / 1e6:,.1f} MB" if size >= 1e5 else f"{size / 1e3:,.1f} kB"
