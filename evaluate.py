"""Flies a policy through scenes and reports what came of it.

python evaluate.py                                      the shipped policy on the paper's four maps
python evaluate.py policy=runs/2025-11-22/10-00-00_train    a policy of your own
python evaluate.py 'scenes=[random_boxes]' flights=50   another scene of conf/scene
python evaluate.py 'scenes=[training]' flights=1000     episodes as in training, never trained on
python evaluate.py 'scenes=[paper1_map11]' '+scene.goal_m=[9.0,8.75,1.0]'    a number of the scene
python evaluate.py 'replay=runs/latest/rollouts#7'      a recorded episode, flown again step by step
"""

import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.build import nearest
from resc.errors import ConfigError, RescError
from resc.evaluation.campaign import evaluate
from resc.evaluation.replay import replay
from resc.launch import launch, refuse_doubles
from resc.learning.checkpoint import load_policy
from resc.process import prepare_process


@hydra.main(version_base="1.3", config_path="conf", config_name="evaluate")
def main(config: DictConfig) -> None:
    """One evaluation in Hydra's run folder."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # unwinds: the recording is completed
    try:
        refuse_doubles()
        prepare_process(config["threads"], config["device"])
        folder = Path(HydraConfig.get().runtime.output_dir)
        if config["replay"]:
            print(replay(config["replay"], folder, allowed=config["allowed_targets"]))
            return
        scenes = compose_scenes(config)
        policy = load_policy(Path(config["policy"]), config["device"])
        overrides = HydraConfig.get().overrides.task
        print(evaluate(config, policy, scenes, folder, overrides))
    except RescError as error:
        sys.exit(f"error: {error}")


def compose_scenes(config: DictConfig) -> dict[str, dict[str, Any]]:
    """The scenes of the list with the numbers of `scene` in place of their own.

    Raises:
        ConfigError: A scene is unknown or named twice.
    """
    known = GlobalHydra.instance().config_loader().get_group_options("scene")
    scenes = {}
    for name, times in Counter(config["scenes"]).items():
        if name not in known:
            raise ConfigError(f"Unknown scene '{name}'.{nearest(name, known)}")
        if times > 1:
            raise ConfigError(f"scenes names '{name}' {times} times; raise flights instead.")
        node = hydra.compose(f"scene/{name}")["scene"]
        own, given = (
            OmegaConf.to_container(part, resolve=True) for part in (node, config["scene"])
        )
        scenes[name] = {**own, **given}
    return scenes


if __name__ == "__main__":
    schema.register()
    launch(main, "evaluate")
