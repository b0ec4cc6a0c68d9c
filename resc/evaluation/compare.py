"""Evaluations or training runs side by side, paired by their starts.

python -m resc.evaluation.compare runs/<evaluation> runs/<evaluation>    two policies, or more
python -m resc.evaluation.compare runs/latest_evaluation                 of several pilots
python -m resc.evaluation.compare runs/<run> runs/<run> --names old new  held-out episodes

The first is what the others are compared with. Flights are paired by scene, map and start; those
that not all flew are left out, and the report says so. report.md, differences.csv, flights.csv and
pictures are left in a new folder of runs/, or in that of --into. Nothing of what is compared is
changed.
"""

import argparse
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from resc.errors import ConfigError
from resc.evaluation.compare_picture import TIMES, draw_paths, draw_times
from resc.evaluation.compare_text import write_text
from resc.evaluation.entrants import Entrant, read_entrants
from resc.evaluation.paired import Shared, contrast, scenes_in, share
from resc.run_folder import RUNS, new_folder
from resc.starting.answers import answering

REPORT = "report.md"


def write_comparison(entrants: Sequence[Entrant], shared: Shared, into: Path) -> str:
    """Writes the comparison into a folder, which is made if it is missing; returns the report."""
    contrasts = [
        contrast(scene, flights, number)
        for scene, flights in scenes_in(shared)
        for number in range(1, len(entrants))
    ]
    into.mkdir(parents=True, exist_ok=True)
    text = write_text(entrants, shared, contrasts, into)
    draw_times(entrants, shared, into / TIMES)
    drawn, missing = draw_paths(entrants, shared, into)
    if missing:
        text += f"\nNo paths of {', '.join(missing)}: not all of its flights are recorded.\n"
    pictures = "\n".join(f"![{path.stem}]({path.name})" for path in [into / TIMES, *drawn])
    (into / REPORT).write_text(f"{text}\n{pictures}\n")
    return text


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.evaluation.compare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folders", type=Path, nargs="+", help="of evaluations, or of runs")
    parser.add_argument("--names", nargs="+", help="what they are called, in their order")
    parser.add_argument("--into", type=Path, help="folder of the report, which must not exist")
    given = parser.parse_args()
    if given.into and given.into.exists():
        raise ConfigError(f"{given.into} exists; give --into a folder that does not.")
    entrants = read_entrants(given.folders, given.names)
    shared = share(entrants)
    into = given.into or Path(new_folder(f"{RUNS}/{datetime.now():%Y-%m-%d/%H-%M-%S}_compare"))
    print(write_comparison(entrants, shared, into))
    print(f"Report: {into / REPORT}")


if __name__ == "__main__":
    with answering():
        main()
