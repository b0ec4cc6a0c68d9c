"""python -m resc.pages FOLDER ...: writes report.html again for runs, evaluations and sweeps."""

import argparse
import sys
from pathlib import Path

from resc.errors import RescError
from resc.pages.write import write_page


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m resc.pages", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="+", help="of a run, an evaluation or a sweep")
    try:
        for folder in parser.parse_args().folder:
            print(write_page(folder))
    except RescError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
