"""Flies a policy through scenes and reports what came of it.

python evaluate.py                                      the shipped policy on the paper's four maps
python evaluate.py policy=latest                        the policy trained last
python evaluate.py policy=runs/2025-11-22/10-00-00_train    that of a run
python evaluate.py suite=forest                         100 forests of each of three densities
python evaluate.py 'suite=[paper,field]' maps=20        several suites, fewer maps
python evaluate.py 'scenes=[random_boxes]' flights=50   another scene of conf/scene
python evaluate.py 'scenes=[training]' flights=1000     episodes as in training, never trained on
python evaluate.py 'scenes=[paper1_map11]' '+scene.goal_m=[9.0,8.75,1.0]'    a number of the scene
python evaluate.py 'pilot=[policy,pursuit]'             the policy, and a pilot without learning
python evaluate.py replay=runs/latest_evaluation/rollouts#7    a recorded episode, flown again
"""

import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from resc import early as early  # first, for what it does as it is imported
from resc import schema
from resc.console import logged
from resc.evaluation.campaign import Evaluation
from resc.evaluation.suites import scenes_to_fly
from resc.flying.pilot import build_pilots
from resc.pages.write import leave_page
from resc.policies.stored import load_policy, policy_folder
from resc.process import prepare_process
from resc.run_folder import claimed, unfinished
from resc.settings import check_settings, refuse_beside
from resc.starting.answers import answering
from resc.starting.composed import compose_scenes, refuse_doubles
from resc.starting.launch import launch

REPLAYED = ("replay", "allowed_targets", "threads", "name")
"""Settings that a replay heeds; all others are the recording's."""


@hydra.main(version_base="1.3", config_path="conf", config_name="evaluate")
def main(config: DictConfig) -> None:
    """One evaluation in Hydra's run folder."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    overrides, allowed = HydraConfig.get().overrides.task, config["allowed_targets"]
    with answering(), claimed(folder):
        refuse_doubles()
        check_settings(config, schema.EvaluateSchema)
        OmegaConf.resolve(config)
        prepare_process(config["threads"], config["device"])
        if config["replay"]:
            from resc.flying.replay import replay  # reads recordings, which takes long to import

            refuse_beside(overrides, REPLAYED, "replay")
            print(replay(config["replay"], folder, allowed=allowed))
            return
        names = scenes_to_fly(config["scenes"], config["suite"], overrides)
        scenes = compose_scenes(names, config["scene"])
        config["policy"] = str(policy_folder(config["policy"], "policy"))
        policy = load_policy(Path(config["policy"]), config["device"], allowed)
        pilots = build_pilots(config["pilot"], allowed)
        with logged(folder / "evaluate.log"):
            if unfinished(Path(config["policy"])):
                print(f"{config['policy']} is a training that has not finished.", file=sys.stderr)
            print(Evaluation(config, policy, scenes, overrides, pilots).fly(folder))
            leave_page(folder)


if __name__ == "__main__":
    schema.register()
    launch(main, "evaluate")
