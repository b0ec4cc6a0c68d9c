"""report.html of a folder: what the folder is of decides what the page shows."""

from pathlib import Path

from resc.errors import ConfigError
from resc.run_folder import PAGE, PROGRESS, replacing
from resc.sweep_folder import is_sweep


def write_page(folder: Path) -> Path:
    """Writes the page of a run, an evaluation or a sweep beside its files; returns its path.

    Raises:
        ConfigError: The folder is none of the three, or a file in it is damaged.
    """
    # Here, so that a run does not import what only its page needs.
    from resc.evaluation.by_pilot import FLIGHTS_TABLE
    from resc.pages.evaluation import evaluation_page
    from resc.pages.sweep import sweep_page
    from resc.pages.training import training_page

    folder = folder.resolve()
    if is_sweep(folder):
        page = sweep_page(folder)
    elif (folder / PROGRESS).exists():
        page = training_page(folder)
    elif (folder / FLIGHTS_TABLE).exists():
        page = evaluation_page(folder)
    else:
        raise ConfigError(
            f"{folder} holds no run, evaluation or sweep; give a folder that train.py or "
            "evaluate.py wrote."
        )
    path = folder / PAGE
    with replacing(path) as part:
        part.write_text(page.text(), encoding="utf-8")
    return path


def leave_page(folder: Path) -> None:
    """Writes the page of what has just ended, and says where, or why there is none."""
    try:
        print(f"Page: {write_page(folder)}", flush=True)
    except Exception as error:  # the run is done, whatever is wrong with its page
        reason = " ".join(str(error).split()) or type(error).__name__
        print(f"No {PAGE}: {reason}", flush=True)
