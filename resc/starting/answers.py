"""What a command answers where something is wrong: one sentence, with the nearest right name."""

import contextlib
import errno
import os
import re
import signal
import sys
from collections.abc import Iterator, Sequence

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError

from resc import ranks
from resc.errors import ConfigError, ExitCode, RescError, UnfinishedError, nearest
from resc.places import CONF
from resc.starting.aside import set_aside

TOLD = (RescError, OSError, OmegaConfBaseException, MarkedYAMLError)
"""What is told in a sentence, beside what torch cannot compile."""


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
    except Exception as error:
        uncompiled = type(error).__module__.startswith("torch._dynamo")
        if not uncompiled and not isinstance(error, TOLD):
            raise
        told = _uncompiled(error) if uncompiled else str(error)
        if isinstance(error, MarkedYAMLError) and error.problem_mark:
            mark = error.problem_mark
            told = f"{mark.name}, line {mark.line + 1}: {error.problem}; mend this file."
        if isinstance(error, OmegaConfBaseException):
            told = f"{told.partition(chr(10))[0]} ({error.full_key})"
        if isinstance(error, OSError) and error.filename is not None:
            told = f"{error.filename} cannot be used ({error.strerror}); give another, or mend it."
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            told = "The disk is full; make room, then run the command again."
        told = "\n".join([f"error: {told}", *getattr(error, "__notes__", [])])
        if ranks.may_say(error):
            print(told, file=sys.stderr)
        ranks.leave_word(error, told)
        sys.exit(ExitCode.UNFINISHED if isinstance(error, UnfinishedError) else ExitCode.ERROR)
    except KeyboardInterrupt as error:
        if ranks.is_first():
            print("\n".join(["Stopped.", *getattr(error, "__notes__", [])]), file=sys.stderr)
        sys.exit(ExitCode.INTERRUPTED)


def _uncompiled(error: Exception) -> str:
    """What torch's compiler says, and the line of a part that it could not read."""
    text = str(error)
    lines = re.findall(r'File "([^"]+)", line (\d+), in (\w+)', text)
    where = f" in {lines[-1][0]}, line {lines[-1][1]} ({lines[-1][2]})" if lines else ""
    return (
        f"torch cannot compile the step{where}: {text.partition(chr(10))[0]} A part computes all "
        "environments at once: write torch.where for a Python `if`, or give compile=false."
    )


def refused(error: Exception, config_name: str, arguments: Sequence[str]) -> ConfigError:
    """What Hydra raises for wrong arguments, in one sentence with the nearest names that exist."""
    return ConfigError(_own_words(error) or _explain(error, config_name, arguments))


def _own_words(error: BaseException | None) -> str:
    """The sentence of ours that Hydra has wrapped, if there is one."""
    while error is not None and not isinstance(error, RescError):
        error = error.__cause__ or error.__context__
    return str(error or "")


def _explain(error: Exception, config_name: str, arguments: Sequence[str]) -> str:
    text = str(error)
    gone = re.search(r"Could not delete from config[^']*'([\w.@/]+)' does not exist", text)
    if override := gone or re.search(r"Could not override '([\w.@/]+)'", text):
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
    with set_aside(), initialize_config_dir(str(CONF), version_base="1.3"):
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
    if config_name == "evaluate" and path in ("obstacle_observation", "env", "model", "algorithm"):
        return f"{path} is not a setting of evaluate: a policy keeps what it was trained with."
    where = ".".join(found) or config_name
    return f"{path} is not a setting: {where} has no '{missing}'.{nearest(missing, known)}"
