"""Whether a run of the default training does as well as the stored runs.

    python -m resc.evaluation.reproduction runs/latest_train

`docs/results/default_training.json` holds the success rates of the default training, one for each
training seed. Exit status 0 if the run's rate lies in their prediction interval.
"""

import argparse
import json
import math
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import t as student

from resc.errors import ConfigError, RescError
from resc.places import RESULTS
from resc.run_folder import SUMMARY

STORED = RESULTS / "default_training.json"


def prediction_interval(rates: Sequence[float], level: float = 0.95) -> tuple[float, float]:
    """Where one more rate lies with probability `level`, cut to [0, 1].

    mean -+ t_(n-1) s sqrt(1 + 1/n): the rates are taken as normal, with unknown spread s.

    Raises:
        ConfigError: There are fewer than two rates.
    """
    count = len(rates)
    if count < 2:
        raise ConfigError(f"an interval needs at least two runs; there are {count}.")
    reach = float(student.ppf((1 + level) / 2, count - 1)) * statistics.stdev(rates)
    middle, reach = statistics.fmean(rates), reach * math.sqrt(1 + 1 / count)
    return max(middle - reach, 0.0), min(middle + reach, 1.0)


def compare(folder: Path, results: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether the run in `folder` lies in the interval of the stored ones, and the sentence for it.

    Raises:
        ConfigError: The run is not finished, or is no run of the stored length.
    """
    path = folder / SUMMARY
    try:
        summary = json.loads(path.read_text())
        rate, frames = float(summary["success_rate"]), int(summary["frames"])
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist; give the folder of a finished run.") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{path} is not the summary of a finished training run.") from None
    if frames != results["frames"]:
        raise ConfigError(
            f"the run in {folder} took {frames} frames, the stored ones {results['frames']}; "
            "compare runs of the default length."
        )
    rates = list(results["success_rate"].values())
    low, high = prediction_interval(rates)
    inside = low <= rate <= high
    place = "inside" if inside else "outside"
    return inside, (
        f"{rate:.1%} success, {place} {low:.1%} to {high:.1%}, where 95 % of runs are expected "
        f"after {len(rates)} training seeds."
    )


def main() -> None:
    """Compares the run named on the command line; its status is the answer."""
    parser = argparse.ArgumentParser(
        prog="python -m resc.evaluation.reproduction",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", type=Path, help="folder of a finished run")
    given = parser.parse_args()
    try:
        inside, sentence = compare(given.run, json.loads(STORED.read_text()))
    except RescError as error:
        sys.exit(f"error: {error}")
    print(sentence)
    sys.exit(0 if inside else 1)


if __name__ == "__main__":
    main()
