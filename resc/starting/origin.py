"""The command that began a sweep or a run: written down once, so that the folder belongs to it."""

import contextlib
import json
import os
import platform
import sys
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from resc import ranks
from resc.command_line import shell, starting
from resc.errors import ConfigError
from resc.run_folder import CHECKPOINT, CONFIG, ORIGIN, git, json_of, replacing
from resc.sweep_folder import arguments_of, go_on, origin_of

MULTIRUN = ("-m", "--multirun")
CHANGEABLE = (
    "launcher",
    "hydra.launcher",
    "hydra/launcher",
    "hydra.sweeper.trials",
    "hydra.sweeper.batch",
    "hydra.sweeper.objective",
)
"""Settings that say how a sweep is run, not what its runs are."""
OF_ITS_FOLDER = ("hydra.mode", "hydra.sweep")
"""Settings that make it a sweep, in its folder."""
OF_EACH = ("command", "directory", "commit", "machine", "versions", "begun")
"""What is kept of every command that goes on with a run."""


def launched_today(arguments: Sequence[str]) -> list[str]:
    """The arguments of a stored command, with the launchers of this machine by today's name.

    One run after the other was `launcher=serial`, several at a time `launcher=joblib`, two of them
    unless said otherwise.
    """
    number = "hydra.launcher.backend.n_jobs"
    told = any(key_of(text) == number for text in arguments)
    found: list[str] = []
    for text in arguments:
        if text in ("launcher=joblib", "launcher=serial"):
            found.append("launcher=local")
            found += ["hydra.launcher.backend.jobs=2"] if "joblib" in text and not told else []
        else:
            found.append(text.replace(f"{number}=", "hydra.launcher.backend.jobs="))
    return found


def key_of(argument: str) -> str:
    """The setting that an argument names; empty if it is no override."""
    is_override = "=" in argument or argument.startswith("~")
    return argument.lstrip("+~").partition("=")[0].partition("@")[0] if is_override else ""


def is_among(argument: str, settings: Sequence[str]) -> bool:
    """Whether an argument names one of the settings, or a part of one."""
    key = key_of(argument)
    return any(key == name or key.startswith(f"{name}.") for name in settings)


def says_how(argument: str) -> bool:
    """Whether an argument says how the sweep is run."""
    return argument in MULTIRUN or is_among(argument, (*CHANGEABLE, *OF_ITS_FOLDER))


def what_is_run(arguments: Sequence[str]) -> list[str]:
    """The arguments that say what the runs are."""
    return [text for text in arguments if not says_how(text)]


def require_own_folder(folder: Path) -> None:
    """Refuses a folder of another sweep, or of a run.

    Raises:
        ConfigError: It says how to go on with what is there.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file; choose another folder with hydra.sweep.dir.")
    if any((folder / name).exists() for name in (CONFIG, CHECKPOINT)):
        raise ConfigError(f"{folder} holds a run; choose another folder with hydra.sweep.dir.")
    if not (folder / ORIGIN).exists():
        return
    if what_is_run(arguments_of(folder)) != what_is_run(sys.argv[1:]):
        raise ConfigError(
            f"{folder} holds another sweep; choose another folder with hydra.sweep.dir, or go on "
            f"with what is there: {go_on(folder)}"
        )


def claim(folder: Path) -> None:
    """Writes down where a sweep is from, once.

    Raises:
        ConfigError: The folder is another sweep's, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary = folder / f".{ORIGIN}.{os.getpid()}"
        temporary.write_text(json.dumps(facts(), indent=2) + "\n")
        try:
            os.link(temporary, folder / ORIGIN)  # whole at once, and only one sweep's
        except FileExistsError:
            require_own_folder(folder)
        finally:
            temporary.unlink()
    except OSError as error:
        raise ConfigError(
            f"{error.filename or folder} cannot be written ({error.strerror}); choose another "
            "folder with hydra.sweep.dir."
        ) from None


def note_origin(folder: Path, overrides: Sequence[str]) -> None:
    """Writes down where a run is from: the command that began it, and each that went on with it.

    The latter are listed under `resumed`.
    """
    told = facts()
    told["command"] = ranks.started_by(told["command"])
    path = folder / ORIGIN
    content = {**told, "overrides": list(overrides)}
    if path.exists():
        content = json_of(path)
        before = content.get("resumed")
        again = {name: told[name] for name in OF_EACH}
        content["resumed"] = [*(before if isinstance(before, list) else ()), again]
    with replacing(path) as part:
        part.write_text(json.dumps(content, indent=2) + "\n")


def facts() -> dict[str, str]:
    """Which command, directory, commit and machine a run or a sweep is from.

    The folder of a run that goes on is left out of its command: `resume=` names it.
    """
    words = sys.argv[1:]
    if any(text.startswith("resume=") for text in words):
        words = [text for text in words if not text.startswith("hydra.run.dir=")]
    found = {
        "command": shell(*starting(Path(sys.argv[0]).name), *words),
        "directory": str(Path.cwd()),
        "commit": git("rev-parse", "--short=12", "HEAD") or "unknown",
        "machine": f"{_processor()}, {len(os.sched_getaffinity(0))} cores, {platform.system()}",
        "versions": f"Python {platform.python_version()}, torch {version('torch')}",
        "begun": time.strftime("%Y-%m-%d %H:%M %Z"),
    }
    if path := python_path():
        found["PYTHONPATH"] = path
    if git("status", "--porcelain", "--untracked-files=no"):
        found["commit"] += " with changes"
    return found


def return_to(folder: Path) -> None:
    """Goes to the directory that a sweep was begun in: paths in its command are seen from there.

    Raises:
        ConfigError: The directory is gone, or Python does not look for modules where it did.
    """
    origin = origin_of(folder)
    lost = [p for p in origin.get("PYTHONPATH", "").split(os.pathsep) if p and p not in sys.path]
    if lost:
        raise ConfigError(
            f"{folder} was begun with PYTHONPATH={origin['PYTHONPATH']}, where its parts may come "
            f"from; set it again: PYTHONPATH={shell(origin['PYTHONPATH'])} {go_on(folder)}"
        )
    os.environ |= {"PYTHONPATH": path} if (path := python_path()) else {}
    sys.argv[0] = os.path.abspath(sys.argv[0])  # runs are by the script at hand, not one over there
    try:
        os.chdir(origin.get("directory", "."))
    except OSError as error:
        raise ConfigError(
            f"{folder} was begun in {error.filename}, where its command has to be read "
            f"({error.strerror}); restore that directory, or start a new sweep."
        ) from None


def python_path() -> str:
    """PYTHONPATH with absolute paths, so that it holds in every directory."""
    found = os.environ.get("PYTHONPATH", "")
    return os.pathsep.join(os.path.abspath(path) for path in found.split(os.pathsep) if path)


def _processor() -> str:
    """The processor's name."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()
