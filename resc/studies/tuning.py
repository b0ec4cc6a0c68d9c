"""python -m resc.studies.tuning runs/<sweep>: what a sweep that tunes has found, and how surely.

Reads the study that Optuna keeps in the folder of such a sweep; writes report.md, trials.csv and
pictures into its folder `report`. train.py -m does the same at the end of a sweep.
"""

import argparse
from pathlib import Path

from resc.errors import ConfigError
from resc.starting.answers import answering
from resc.studies.tuning_picture import draw_pictures
from resc.studies.tuning_study import read_tuning
from resc.studies.tuning_text import write_text

REPORT = "report"


def write_report(folder: Path) -> Path:
    """Writes the report of a sweep that tunes; returns the path of report.md."""
    tuning = read_tuning(folder)
    target = folder / REPORT
    target.mkdir(exist_ok=True)
    draw_pictures(tuning, target)
    return write_text(tuning, target)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.studies.tuning",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sweep", type=Path, help="folder of a sweep: runs/<date>/<time>_<name>")
    given = parser.parse_args()
    if not given.sweep.is_dir():
        raise ConfigError(f"{given.sweep} does not exist; give the folder of a sweep that tunes.")
    report = write_report(given.sweep.resolve())
    print(report.read_text())
    print(f"Report: {report}")


if __name__ == "__main__":
    with answering():
        main()
