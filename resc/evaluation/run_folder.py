"""The folder of a run: its summary, and the link to the newest one."""

import contextlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resc.errors import ConfigError

RUNS = "runs"
LATEST = "latest"
SUMMARY = "summary.json"
CHECKPOINT, CONFIG, EPISODES = "checkpoint.pt", "config.yaml", "evaluation.csv"
HELD_OUT = "held_out"
"""Where the flights of `EPISODES` are recorded."""
JOB, FAILURE, ORIGIN = "job.json", "failure.txt", "origin.json"
"""Of a sweep: what makes a run, why it failed, and, of all, command, commit and machine."""


def finish_run(folder: Path, summary: Mapping[str, Any]) -> None:
    """Writes summary.json into the folder and points `runs/latest` to it.

    Numbers that are not finite become null: JSON has no word for them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_finite(summary), indent=2, allow_nan=False) + "\n"
    temporary = folder / f".{SUMMARY}.tmp"
    temporary.write_text(text)
    temporary.replace(folder / SUMMARY)
    link_latest(folder)


def link_latest(folder: Path) -> None:
    """Points `latest` in the folder `runs` above to this run; a run elsewhere gets no link.

    Raises:
        ConfigError: Something that is no link has the name already.
    """
    folder = folder.resolve()
    runs = next((parent for parent in folder.parents if parent.name == RUNS), None)
    if runs is None:
        return
    link = runs / LATEST
    if link.exists() and not link.is_symlink():
        raise ConfigError(
            f"{link} is no link but a file or folder; move it, the newest run goes there."
        )
    temporary = runs / f".{LATEST}.{os.getpid()}"
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(folder.relative_to(runs), target_is_directory=True)
    temporary.replace(link)  # at once, so that a reader always finds a run


def is_finished(folder: Path) -> bool:
    """Whether a run was trained and evaluated to the end."""
    return (folder / EPISODES).exists() and "success_rate" in summary_of(folder)


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary of a run; empty if there is none, or one that was cut."""
    return json_of(folder / SUMMARY)


def json_of(path: Path) -> dict[str, Any]:
    """What a JSON file says; empty if it is missing or cut."""
    with contextlib.suppress(OSError, ValueError):
        content = json.loads(path.read_text())
        return content if isinstance(content, dict) else {}
    return {}


def _finite(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
