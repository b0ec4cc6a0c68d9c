"""python -m resc.studies.ablation runs/<sweep>: which variant is better, and how sure that is.

Reads the finished runs of a sweep; writes report.md, variants.csv, runs.csv and pictures into its
folder `report`. Nothing of the runs is changed.
"""

import argparse
import sys
from pathlib import Path

from resc.errors import RescError
from resc.studies.ablation_analysis import analyse
from resc.studies.ablation_figures import draw_figures
from resc.studies.ablation_text import write_text
from resc.studies.study import read_sweep

REPORT = "report"


def write_report(folder: Path, baseline: str | None = None) -> Path:
    """Writes the report of a sweep's folder; returns the path of report.md."""
    sweep = read_sweep(folder)
    analysis = analyse(sweep, baseline)
    target = folder / REPORT
    target.mkdir(exist_ok=True)
    draw_figures(sweep, analysis, target)
    return write_text(sweep, analysis, target)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m resc.studies.ablation")
    parser.add_argument("sweep", type=Path, help="folder of a sweep: runs/<date>/<time>_<name>")
    parser.add_argument("--baseline", help="variant to compare with; the first one if not given")
    arguments = parser.parse_args()
    try:
        report = write_report(arguments.sweep, arguments.baseline)
    except RescError as error:
        sys.exit(f"error: {error}")
    except OSError as error:
        sys.exit(f"error: {error.filename} cannot be written or read ({error.strerror}).")
    print(report.read_text())
    print(f"Report: {report}")


if __name__ == "__main__":
    main()
