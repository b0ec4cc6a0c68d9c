"""Starting a Hydra script: a wrong override gets one sentence with the nearest right name."""

import contextlib
import logging
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra import main as hydra_main
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from resc import ranks
from resc.command_line import override, shell
from resc.errors import ConfigError, ExitCode, RescError, UnfinishedError, nearest
from resc.groups import names
from resc.places import CONF
from resc.run_folder import CONFIG, LATEST, ORIGIN, claimed, latest, sweep_of
from resc.starting.composed import File, files_of_lists
from resc.starting.origin import (
    CHANGEABLE,
    MULTIRUN,
    OF_ITS_FOLDER,
    is_among,
    key_of,
    launched_today,
    return_to,
)
from resc.sweep_folder import arguments_of, go_on, is_sweep, permissions

LISTS = names(lambda group: group.several)
"""Groups of which a configuration takes several files."""
PATHS = ("resume", "policy", "replay", "references")
"""Settings whose value is a path, typed as it is."""
SHOWING = ("--help", "-h", "--hydra-help", "--cfg", "-c", "--info", "-i")
"""Options of Hydra with which nothing is run."""


def launch(main: Callable[[], None], config_name: str) -> None:
    """Runs a `hydra.main` function; what goes wrong ends it with one sentence and status 1.

    `resume=` with the folder of a sweep becomes the command that began it. SIGTERM unwinds, so that
    recordings are completed.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(ExitCode.TERMINATED))
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 - it was closed by the caller
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    os.environ.setdefault(
        "HYDRA_FULL_ERROR", "1"
    )  # Hydra then raises instead of printing and exiting
    if not sys.warnoptions:  # ours raise; those of other packages would stand in the progress bar
        warnings.simplefilter("ignore")
    with _among_ranks(), answering():
        try:
            _refuse_foreign(sys.argv[1:])
            require_names(sys.argv[1:])
            sys.argv[1:] = resumed_sweep(in_its_folder(quoted_paths(sys.argv[1:])))
            _refuse_ranks(config_name, sys.argv[1:])
            show_quietly()
            main()
        except (HydraException, OmegaConfBaseException) as error:
            raise refused(error, config_name, sys.argv[1:]) from None
        except ValueError as error:
            if not str(error).startswith(("Only one of --run", "The --resolve flag")):
                raise
            raise ConfigError(f"{error}; leave out what does not belong.") from None


def launch_here(
    command: Callable[[DictConfig, Path], Callable[[], None]], config_name: str
) -> None:
    """`launch` for a module of the package.

    `command` makes what is run from the configuration and the run's folder.
    """

    @hydra_main(version_base="1.3", config_path=str(CONF), config_name=config_name)
    def run(config: DictConfig) -> None:
        folder = Path(HydraConfig.get().runtime.output_dir)
        with answering(), claimed(folder):
            refuse_doubles()
            command(config, folder)()

    launch(run, config_name)


@contextlib.contextmanager
def _among_ranks() -> Iterator[None]:
    """The processes that torchrun has started meet; the first one alone speaks on stdout."""
    with answering():
        ranks.join()
    if not ranks.is_first():
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
    try:
        yield
    finally:
        ranks.leave()


def _refuse_ranks(config_name: str, arguments: Sequence[str]) -> None:
    """Refuses to do in several processes what is done in one."""
    if ranks.count() == 1:
        return
    if config_name != "train":
        raise ConfigError("torchrun starts the processes of a training; leave it out.")
    if not set(arguments).isdisjoint(MULTIRUN):
        raise ConfigError(
            "torchrun starts the processes of one training, and a sweep starts a process for each "
            "of its runs; leave out torchrun, or make the runs one after the other without -m."
        )


def _refuse_foreign(arguments: Sequence[str]) -> None:
    """Refuses what Hydra can do, and runs here would not survive."""
    if any(text.startswith("--experimental") for text in arguments):
        raise ConfigError(
            "--experimental-rerun does not know the folders of runs; use resume= of train.py, or "
            "replay= of evaluate.py."
        )
    if any(text.lstrip("+") == "hydra.job.chdir=true" for text in arguments):
        raise ConfigError(
            "hydra.job.chdir=true, but paths are read from where the command is given; leave it "
            "out: a run's files are in its folder anyway."
        )


def require_names(arguments: Sequence[str]) -> None:
    """Refuses a group that is given something else than names of its files.

    Raises:
        ConfigError: It names the group and gives an example.
    """
    for text in arguments:
        key, given, value = text.lstrip("+").partition("=")
        group = key.partition("@")[0]
        if not given or text.startswith("-") or not (CONF / group).is_dir():
            continue
        try:
            parsed = OverridesParser.create().parse_override(text)
            chosen = "" if parsed.is_sweep_override() else parsed.value()
        except HydraException:  # Hydra says why
            continue
        names = chosen if isinstance(chosen, list) else [chosen]
        if any(not isinstance(name, str | QuotedString) for name in names):
            some = sorted(path.stem for path in (CONF / group).glob("*.yaml"))
            example = f"{group}=[{','.join(some[:2])}], or [] for none"
            example = example if group in LISTS else f"{group}={some[0]}"
            raise ConfigError(
                f"{group} is {value}; expected names of files in conf/{group}, such as {example}."
            )


def _own_words(error: BaseException | None) -> str:
    """The sentence of ours that Hydra has wrapped, if there is one."""
    while error is not None and not isinstance(error, RescError):
        error = error.__cause__ or error.__context__
    return str(error or "")


@contextlib.contextmanager
def answering() -> Iterator[None]:
    """Ends the process with one sentence and status 1 where something is wrong.

    Within a `hydra.main` function, too: of other exceptions Hydra speaks first.
    """
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output, such as head, has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except (RescError, OSError, OmegaConfBaseException) as error:
        told = str(error)
        if isinstance(error, OmegaConfBaseException):
            told = f"{told.partition(chr(10))[0]} ({error.full_key})"
        if isinstance(error, OSError) and error.filename is not None:
            told = f"{error.filename} cannot be used ({error.strerror}); give another, or mend it."
        told = "\n".join([f"error: {told}", *getattr(error, "__notes__", [])])
        if ranks.may_say(error):
            print(told, file=sys.stderr)
        ranks.leave_word(error, told)
        sys.exit(ExitCode.UNFINISHED if isinstance(error, UnfinishedError) else ExitCode.ERROR)
    except KeyboardInterrupt as error:
        if ranks.is_first():
            print("\n".join(["Stopped.", *getattr(error, "__notes__", [])]), file=sys.stderr)
        sys.exit(ExitCode.INTERRUPTED)


def in_its_folder(arguments: list[str]) -> list[str]:
    """The arguments; a run that is resumed keeps its folder, so that Hydra makes no other.

    `resume=latest` becomes the newest run, or the sweep that it is of.

    Raises:
        ConfigError: There is no such folder, or it holds neither a run nor a sweep.
    """
    chosen = [text for text in arguments if text.lstrip("+").startswith("resume=")]
    text = str(_value_of(chosen[-1])) if chosen else "null"
    if text in ("null", "None"):
        return arguments
    folder = latest("resume", "train", "sweep") if text == LATEST else Path(text).resolve()
    folder = (sweep_of(folder) or folder) if text == LATEST else folder
    if not (is_sweep(folder) or (folder / CONFIG).exists()):
        raise ConfigError(
            f"resume is '{text}', which holds no run and no sweep; give the folder of an "
            "interrupted one."
        )
    if not (is_sweep(folder) or set(arguments).isdisjoint(MULTIRUN)):
        raise ConfigError(f"resume is '{text}', which is one run; leave out -m.")
    if any(text.startswith("hydra.run.dir=") for text in arguments):
        return arguments
    rest = [text for text in arguments if text not in chosen]
    own = [] if is_sweep(folder) else [override("hydra.run.dir", folder)]
    return [*rest, override("resume", folder), *own]


def show_quietly() -> None:
    """Lets what only shows something end quietly where its reader, such as head, has left.

    By the signal, as other programs do: Hydra shows with the help of `logging`, which reports every
    line that it cannot write. A run is ended by the error, which unwinds.
    """
    if any(text.partition("=")[0] in SHOWING for text in sys.argv[1:]):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    logging.raiseExceptions = False  # a line of the log that cannot be written ends nothing


def resumed_sweep(arguments: list[str]) -> list[str]:
    """The arguments, or those of the sweep whose folder `resume=` names, into the same folder.

    The command that began the sweep is taken up in the directory where it began.

    Raises:
        ConfigError: Another argument would change what the runs are.
    """
    chosen = [text for text in arguments if text.lstrip("+").startswith("resume=")]
    folder = Path(str(_value_of(chosen[-1]))).resolve() if chosen else None
    if folder is None or not is_sweep(folder):
        return arguments
    stored = launched_today(arguments_of(folder))
    if not stored:
        raise ConfigError(f"{folder} does not say in {ORIGIN} what began it; start a new sweep.")
    given = [text for text in arguments if text not in (*chosen, *MULTIRUN)]
    permitted = permissions(given)
    given = [text for text in given if text not in permitted]
    if refused := [text for text in given if not is_among(text, CHANGEABLE)]:
        raise ConfigError(
            f"{folder} is a sweep, which goes on as it was begun: leave out {shell(*refused)}; "
            f"only how it is run may change: {', '.join(CHANGEABLE)}."
        )
    if list(map(_value_of, permitted)) != list(map(_value_of, permissions(stored))):
        raise ConfigError(
            f"{folder} was begun with other allowed_targets, which a folder cannot permit for you; "
            f"if you trust it, go on with: {go_on(folder)}"
        )
    again = {*map(key_of, given), *OF_ITS_FOLDER, "hydra.sweep.dir"}
    if "launcher" in again:  # settings of the one before are none of its
        stored = [text for text in stored if not is_among(text, ("hydra.launcher",))]
    kept = [text for text in stored if text not in MULTIRUN and key_of(text) not in again]
    return_to(folder)
    return ["-m", *kept, *given, override("hydra.sweep.dir", folder)]


def quoted_paths(arguments: Sequence[str]) -> list[str]:
    """The arguments, with quotes around paths that Hydra would not read as texts.

    A path typed bare may hold what means something to Hydra: `replay=runs/a/rollouts#17`,
    `policy=runs/lr=0.1`, `resume=runs/a, b`; a comma with `-m` is between paths.
    """
    swept = not set(arguments).isdisjoint(MULTIRUN)
    return [_quoted_path(text, swept=swept) for text in arguments]


def _quoted_path(argument: str, *, swept: bool) -> str:
    key, _, value = argument.partition("=")
    if key not in PATHS or value == "null":
        return argument
    with contextlib.suppress(HydraException):
        parsed = OverridesParser.create().parse_override(argument)
        if swept if parsed.is_sweep_override() else isinstance(parsed.value(), str):
            return argument
    return override(key, value)


def _value_of(argument: str) -> Any:  # noqa: ANN401 - any value
    """The value of an override as Hydra reads it."""
    return OverridesParser.create().parse_override(argument).value()


def refuse_doubles() -> None:
    """Refuses a composed configuration in which a term is defined twice.

    Hydra would merge the two without a word: the numbers of the later one would count.

    Raises:
        ConfigError: The term and the files that define it.
    """
    defined: dict[str, File] = {}
    for file in files_of_lists(LISTS):
        for name, node in file.content.items():
            if not isinstance(node, DictConfig) or "_target_" not in node:
                continue
            term = f"{file.group}.{name}"
            if term in defined and not _for_both(defined[term], file):
                both = dict.fromkeys((defined[term].path, file.path))
                source = " and ".join(both) if len(both) > 1 else f"{file.path}, listed twice"
                raise ConfigError(f"{term} is defined by {source}; keep one, or rename the other.")
            defined[term] = file


def _for_both(one: File, other: File) -> bool:
    """Whether a list that was given is that of the run and that of an estimator's sensors.

    Hydra puts it in the place of both.
    """
    brought = {file.listed_by.startswith("estimator/") for file in (one, other)}
    return one.path == other.path and brought == {True, False}


def refused(error: Exception, config_name: str, arguments: Sequence[str]) -> ConfigError:
    """What Hydra raises for wrong arguments, in one sentence with the nearest names that exist."""
    return ConfigError(_own_words(error) or _explain(error, config_name, arguments))


def _explain(error: Exception, config_name: str, arguments: Sequence[str]) -> str:
    text = str(error)
    if override := re.search(r"Could not override '([\w.@/]+)'", text):
        return _explain_override(override[1], config_name, _choices(arguments))
    if option := re.search(r"Could not (?:load|find) '([\w/]+)/(\w+)'", text):
        group, name = option.groups()
        if (CONF / group).is_dir():
            known = [path.stem for path in (CONF / group).glob("*.yaml")]
            return f"{group} has no '{name}'.{nearest(name, known)}"
    if word := re.search(r"Error parsing override '([^=']*)'\s*missing EQUAL", text):
        return f"'{word[1]}' is not a setting; give a name and a value, such as seed=1."
    cause = str(error.__cause__ or "").partition("\n")[0]
    return " ".join(f"{text}. {cause}".split())


def _choices(arguments: Sequence[str]) -> list[str]:
    """Those arguments that choose files of a group: what a setting exists beside."""
    named = {text: text.partition("=")[0].lstrip("+").partition("@")[0] for text in arguments}
    return [text for text, group in named.items() if "=" in text and (CONF / group).is_dir()]


def _explain_override(path: str, config_name: str, choices: Sequence[str]) -> str:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        try:
            node = compose(config_name, list(choices))
        except HydraException:  # choices of several runs, or from elsewhere
            node = compose(config_name)
    parts = path.replace("/", ".").split(".")
    if parts[0] == "simulator" and "simulator" not in node:
        return (
            f"{path} is not a setting of {config_name}: another simulator flies what is trained, "
            "with evaluate.py simulator=...; here dynamics=... chooses the equations of motion."
        )
    found: list[str] = []
    while (
        len(found) < len(parts) - 1 and isinstance(node, DictConfig) and parts[len(found)] in node
    ):
        node = node[parts[len(found)]]
        found.append(parts[len(found)])
    known = [str(key) for key in node] if isinstance(node, DictConfig) else []
    missing = parts[len(found)]
    if missing in known:
        return f"{path} is not a setting of the configuration that --config-name names."
    where = ".".join(found) or config_name
    return f"{path} is not a setting: {where} has no '{missing}'.{nearest(missing, known)}"
