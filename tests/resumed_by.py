"""What the command line of a resumed run makes of its configuration, without the command."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from resc.learning.beginning import resumed
from resc.settings import RESUMABLE


def resumed_by(config: DictConfig, overrides: Sequence[str], folder: Path) -> DictConfig:
    """The configuration that a run goes on with, as train.py finds it."""
    taken = {name: OmegaConf.select(config, name) for name in RESUMABLE}
    return resumed(folder, overrides, taken, config["resume"])
