"""The folder of a run: who writes to it, its summary, and the links to the newest ones."""

import contextlib
import fcntl
import functools
import json
import math
import os
import platform
import subprocess
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any, Literal

from resc.errors import ConfigError, RescError
from resc.places import INSTALLED

RUNS = "runs"
LATEST = "latest"
SUMMARY = "summary.json"
CHECKPOINT, CONFIG, EPISODES = "checkpoint.pt", "config.yaml", "evaluation.csv"
POLICY, PROGRESS, ROLLOUTS = "policy.pt", "progress.csv", "rollouts"
EXPERIENCE = "experience"
"""What an algorithm keeps of its flights, beside `CHECKPOINT`."""
PAGE, TERMS = "report.html", "terms.json"
"""The page of a run, an evaluation or a sweep; the table of its terms."""
HELD_OUT = "held_out"
"""Where the flights of `EPISODES` are recorded."""
JOB, FAILURE, ORIGIN = "job.json", "failure.txt", "origin.json"
"""Of a sweep: what makes a run, why it failed, and, of all, command, commit and machine."""
CLAIM = ".claim"
"""Locked by the process that writes to the folder; the system lets go of it when that ends."""
OWNED = (CONFIG, CHECKPOINT, POLICY, PROGRESS, EPISODES, SUMMARY, ROLLOUTS, HELD_OUT)
"""What a second run in the same folder would overwrite or append to."""

Kind = Literal["train", "sweep", "evaluation", "replay", "bound", "transfer", "flight", "export"]


@functools.cache
def new_folder(wanted: str) -> str:
    """A folder that nobody else has, made now: `wanted`, or with _2, _3 ... behind its name.

    So two runs that begin in the same second get a folder each. The same question gets the same
    answer within a process: Hydra asks more than once.
    """
    path = Path(wanted)
    with _answering(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        for number in range(2, 10_000):
            try:
                path.mkdir()
                break
            except FileExistsError:
                path = Path(f"{wanted}_{number}")
    return str(path)


@contextlib.contextmanager
def claimed(folder: Path, *, resumes: bool = False) -> Iterator[None]:
    """Keeps a run's folder for this process; a run that fails before it writes leaves nothing.

    Args:
        folder: Made if it is missing, unless the run resumes.
        resumes: Whether the run goes on with the one that is in the folder.

    Raises:
        ConfigError: Another process writes to the folder, another run is in it, or it cannot be
            written to.
    """
    path = folder / CLAIM
    with _answering(folder):
        folder.mkdir(parents=True, exist_ok=True)
        claim = path.open("a")
    with claim:
        if not _locked(claim, path):
            raise ConfigError(
                f"{folder} is being written to by another process; wait for it, or give another "
                "hydra.run.dir."
            )
        try:
            if not resumes and (found := next((n for n in OWNED if (folder / n).exists()), None)):
                raise ConfigError(
                    f"{folder} holds a run already ({found}); give another hydra.run.dir, or, if "
                    "it is a training, go on with it by resume=."
                )
            yield
        finally:
            path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # it holds something
                folder.rmdir()


@contextlib.contextmanager
def replacing(
    path: Path,
    error: type[RescError] = ConfigError,
    advice: str = "choose another folder or free some space",
) -> Iterator[Path]:
    """Gives the name of a file to write, which takes the place of `path` once it is whole.

    Its folder is made if it is missing. After an error the file is removed, and what was at `path`
    stays.

    Raises:
        RescError: It cannot be written, for one because the disk is full: an `error` with `advice`.
    """
    unfinished = path.with_name(f".{path.name}.part")
    places = [str(place) for place in (path, *path.parents)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.unlink(missing_ok=True)
        yield unfinished
        unfinished.replace(path)
    except OSError as failure:
        # Errors while writing name no file; those of other files, such as the input, name it.
        name = str(failure.filename or unfinished)
        if not name.startswith(str(unfinished)) and name not in places:
            raise
        reason = os.strerror(failure.errno) if failure.errno else str(failure)
        raise error(f"{path} cannot be written ({reason}); {advice}.") from failure
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)


def provenance() -> dict[str, str]:
    """Commit, versions and machine that made a file."""
    return {
        "git_commit": git("rev-parse", "HEAD") or "unknown",
        "git_dirty": str(bool(git("status", "--porcelain"))).lower(),
        **{f"{name}_version": version(name) for name in ("torch", "torchrl", "tensordict", "mcap")},
        "python_version": platform.python_version(),
    }


def git(*arguments: str) -> str:
    """What git says of RESC's own repository; nothing where there is none, or no quick git."""
    if INSTALLED:  # a repository around it would be another one
        return ""
    command: list[Any] = ["git", "-C", Path(__file__).parent, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
    except (FileNotFoundError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def finish_run(folder: Path, summary: Mapping[str, Any], kind: Kind) -> None:
    """Writes summary.json into the folder and points the links of its kind to it.

    Numbers that are not finite become null: JSON has no word for them.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_finite(summary), indent=2, allow_nan=False) + "\n"
    with replacing(folder / SUMMARY) as part:
        part.write_text(text)
    link_latest(folder, kind)


def link_latest(folder: Path, kind: Kind) -> None:
    """Points `latest` and `latest_<kind>` in the folder `runs` above to this run.

    A run elsewhere gets no links.

    Raises:
        ConfigError: Something that is no link has the name already.
    """
    folder = folder.resolve()
    runs = next((parent for parent in folder.parents if parent.name == RUNS), None)
    if runs is None:
        return
    for name in (LATEST, f"{LATEST}_{kind}"):
        link = runs / name
        if link.exists() and not link.is_symlink():
            raise ConfigError(
                f"{link} is a file or folder, not a link to the newest run; move it away."
            )
        temporary = runs / f".{name}.{os.getpid()}"
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(folder.relative_to(runs), target_is_directory=True)
        temporary.replace(link)  # at once, so that a reader always finds a run


def unfinished(folder: Path) -> bool:
    """Whether a training is in the folder that stopped, or still goes on."""
    return (folder / CHECKPOINT).exists() and not (folder / SUMMARY).exists()


def latest(setting: str, *kinds: Kind) -> Path:
    """The folder of the newest run of some kinds below the working directory's `runs`.

    Raises:
        ConfigError: There is none; the `setting` that asked for it is named.
    """
    links = [Path(RUNS) / f"{LATEST}_{kind}" for kind in kinds]
    found = [link for link in links if link.exists()]
    if not found:
        raise ConfigError(
            f"{setting}={LATEST}, but there is no {links[0]}; name the folder, or run one first."
        )
    return max(found, key=lambda link: link.lstat().st_mtime_ns).resolve()


def _locked(file: IO[str], path: Path) -> bool:
    """Whether this process now holds the lock of the file, which is still the one at `path`."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return os.fstat(file.fileno()).st_ino == path.stat().st_ino
    except OSError:  # taken, or the one before has just removed it
        return False


@contextlib.contextmanager
def _answering(folder: Path) -> Iterator[None]:
    """Says in a sentence why a folder cannot be made or written to."""
    try:
        yield
    except OSError as error:
        raise ConfigError(
            f"{folder} cannot be written to ({error.strerror}); give another hydra.run.dir."
        ) from None


def near(path: Path) -> Path:
    """The path as seen from the working directory, if that is shorter."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def put_aside(folder: Path) -> None:
    """Moves the held-out flights of a finished run that trains on to `held_out_<its frames>`."""
    if not is_finished(folder):
        return
    aside = folder / f"{HELD_OUT}_{summary_of(folder)['frames']}"
    aside.mkdir(exist_ok=True)
    if (folder / HELD_OUT).exists():
        for path in (folder / HELD_OUT).iterdir():
            path.replace(aside / path.name)
        (folder / HELD_OUT).rmdir()
    (folder / EPISODES).replace(aside / EPISODES)


def sweep_of(folder: Path) -> Path | None:
    """The folder of the sweep that a run belongs to, if any."""
    folder = folder.resolve()
    return folder.parent if (folder / JOB).exists() and folder.name.isdecimal() else None


def is_finished(folder: Path) -> bool:
    """Whether a run was trained and evaluated to the end."""
    return (folder / EPISODES).exists() and is_evaluated(summary_of(folder))


def is_evaluated(summary: Mapping[str, Any]) -> bool:
    """Whether a summary tells what came of the held-out episodes, in numbers."""
    rate, counts = summary.get("success_rate"), (summary.get("episodes"), summary.get("frames", 0))
    return isinstance(rate, int | float) and all(isinstance(count, int) for count in counts)


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary of a run; empty if there is none, or one that was cut."""
    return json_of(folder / SUMMARY)


def succeeded(summary: Mapping[str, Any]) -> str:
    """What came of the held-out episodes, for people."""
    return f"{summary['success_rate']:.1%} of {summary['episodes']} held-out episodes succeed"


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
