"""The page of an evaluation."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resc.evaluation.by_pilot import FLIGHTS_TABLE, PICTURE, REPORT, ROLLOUTS
from resc.pages.common import about, add_files, add_pictures, add_terms, notes
from resc.pages.page import Html, Page, table, tiles
from resc.pages.worst import read_flights, worst_flights
from resc.run_folder import summary_of

FILES = {
    "report.md": "the table, and what its rows mean",
    "scenes.csv": "its numbers",
    "flights.csv": "every metric of every flight",
    "summary.json": "the results, for programs",
    "config.yaml": "the configuration, resolved",
    "**/scenes/*.mcap": "flights in 3-D, for Foxglove and Lichtblick",
    "**/rollouts*/*.mcap": "every step of every flight: resc-log --help",
    "*/report.md": "the report of one pilot",
    "*/flights.csv": "its flights",
    "evaluate.log": "what the console said",
}


def evaluation_page(folder: Path) -> Page:
    """The page: the table, the worst flights, pictures, terms, files; pilot by pilot."""
    summary = summary_of(folder)
    commit = str(summary.get("git_commit", ""))[:12]
    page = Page(
        folder,
        about(
            "evaluation",
            f"policy {summary['policy']}" if "policy" in summary else None,
            f"seed {summary['seed']}" if "seed" in summary else None,
            f"commit {commit}" if commit else None,
        ),
    )
    shown, text = from_report((folder / REPORT).read_text())
    page.add("Result", _result(summary), shown, notes("What the rows mean", text))
    pilots = [name for name in summary.get("pilots", {}) if (folder / name).is_dir()]
    for name in pilots or [""]:
        own = folder / name
        flights = read_flights(own / FLIGHTS_TABLE)
        recordings = sorted(own.glob(f"{ROLLOUTS}*"))
        behind = f", {name}" if name else ""
        page.add(f"Worst flights{behind}", worst_flights(page, flights, recordings))
        pictures = sorted(own.glob("flight_*.png"))
        pictures = [own / PICTURE, *pictures] if len(pictures) > 1 else pictures
        titled = [(path, path.stem.removeprefix("flight_").replace("_", " ")) for path in pictures]
        add_pictures(page, f"Pictures{behind}", titled)
    add_terms(page)
    add_files(page, FILES)
    return page


def from_report(text: str) -> tuple[Html, str]:
    """The table of a report, and its other text without the title."""
    lines = [line for line in text.splitlines() if not line.startswith("# ")]
    rows = [
        [cell.strip() for cell in line.strip("|").split(" | ")]
        for line in lines
        if line.startswith("|") and not line.startswith("| -")
    ]
    rest = "\n".join(line for line in lines if not line.startswith("|"))
    return (table(rows[0], rows[1:]) if rows else Html()), rest


def _result(summary: Mapping[str, Any]) -> Html:
    if "success_rate" not in summary:
        return Html()
    low, high = summary["success_interval"]
    facts: dict[str, object] = {
        f"of {summary['episodes']} flights arrive": f"{summary['success_rate']:.1%}",
        "95 % interval": f"{100 * low:.1f} to {100 * high:.1f} %",
        "collide": f"{summary['collision_rate']:.1%}",
        "SPL": "-" if summary["spl"] is None else f"{summary['spl']:.3f}",
    }
    return tiles(facts)
