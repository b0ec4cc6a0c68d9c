"""Composing a configuration without a script, beside whatever else uses Hydra in the process."""

from collections.abc import Sequence

from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from resc.errors import ConfigError
from resc.places import CONF
from resc.starting.answers import refused
from resc.starting.arguments import quoted_paths, require_names
from resc.starting.aside import set_aside
from resc.starting.composed import refuse_doubles, refuse_idle_clearance


def composed(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """The configuration that a script composes with these overrides, not yet resolved.

    Raises:
        ConfigError: A name does not exist, a term is defined twice, or a clearance of the
            search would change nothing.
    """
    if foreign := [each for each in overrides if not isinstance(each, str)]:
        raise ConfigError(f"{foreign[0]!r} is not an override; give texts, such as 'seed=1'.")
    if options := [text for text in overrides if text.startswith("-")]:
        raise ConfigError(
            f"{options[0]} is an option of the command line; give overrides, such as seed=1."
        )
    with set_aside():
        require_names(overrides)
        try:
            with initialize_config_dir(str(CONF), version_base="1.3"):
                config = compose(config_name, quoted_paths(overrides), return_hydra_config=True)
                config.hydra.job.config_name = config_name
                HydraConfig.instance().set_config(config)
                refuse_doubles()
                refuse_idle_clearance(config.get("scene"), config.get("held_out"))
        except (HydraException, OmegaConfBaseException) as error:
            raise refused(error, config_name, overrides) from None
    with open_dict(config):
        del config["hydra"]
    return config
