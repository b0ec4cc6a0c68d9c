"""Starting a Hydra script: a wrong override gets one sentence with the nearest right name."""

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig

from resc.build import nearest

CONF = Path(__file__).parents[1] / "conf"


def launch(main: Callable[[], None], config_name: str) -> None:
    """Runs a `hydra.main` function; what Hydra refuses ends it with one sentence and status 1."""
    os.environ.setdefault(
        "HYDRA_FULL_ERROR", "1"
    )  # Hydra then raises instead of printing and exiting
    try:
        main()
    except HydraException as error:
        sys.exit(f"error: {explain(error, config_name)}")


def explain(error: HydraException, config_name: str) -> str:
    """What is wrong with the command line, and the nearest names that exist."""
    text = str(error)
    if override := re.search(r"Could not override '([\w.@/]+)'", text):
        return _explain_override(override[1], config_name)
    if option := re.search(r"Could not (?:load|find) '([\w/]+)/(\w+)'", text):
        group, name = option.groups()
        if (CONF / group).is_dir():
            known = [path.stem for path in (CONF / group).glob("*.yaml")]
            return f"{group} has no '{name}'.{nearest(name, known)}"
    cause = str(error.__cause__ or "").partition("\n")[0]
    return " ".join(f"{text}. {cause}".split())


def _explain_override(path: str, config_name: str) -> str:
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        node = compose(config_name)
    parts = path.replace("/", ".").split(".")
    found: list[str] = []
    while (
        len(found) < len(parts) - 1 and isinstance(node, DictConfig) and parts[len(found)] in node
    ):
        node = node[parts[len(found)]]
        found.append(parts[len(found)])
    known = [str(key) for key in node] if isinstance(node, DictConfig) else []
    missing = parts[len(found)]
    where = ".".join(found) or config_name
    return f"{path} is no setting: {where} has no '{missing}'.{nearest(missing, known)}"
