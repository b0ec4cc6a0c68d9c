"""Starting a Hydra script, with one sentence for whatever is wrong with its command."""

import contextlib
import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from hydra import main as hydra_main
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from resc import early as early  # for what it does as it is imported
from resc import ranks
from resc.errors import ConfigError, ExitCode
from resc.places import CONF
from resc.run_folder import claimed
from resc.starting.answers import answering, refused
from resc.starting.arguments import in_its_folder, quoted_paths, require_names, resumed_sweep
from resc.starting.composed import refuse_doubles
from resc.starting.origin import MULTIRUN

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


def show_quietly() -> None:
    """Lets what only shows something end quietly where its reader, such as head, has left.

    By the signal, as other programs do: Hydra shows with the help of `logging`, which reports every
    line that it cannot write. A run is ended by the error, which unwinds.
    """
    if any(text.partition("=")[0] in SHOWING for text in sys.argv[1:]):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    logging.raiseExceptions = False  # a line of the log that cannot be written ends nothing
