"""Trains a policy: compose, build, run, report.

python train.py                                    the default: flight among obstacles
python train.py +experiment=quick                  a few minutes of it
python train.py obstacle_observation=none          swap a part
python train.py resume=runs/latest                 go on with an interrupted run
python train.py --cfg job                          look, do not run
"""

import sys
import time
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.build import build
from resc.command_line import command
from resc.errors import RescError
from resc.evaluation.run_folder import finish_run, link_latest
from resc.launch import launch, refuse_doubles
from resc.learning.assemble import build_trainer, fly_held_out, restore, resumed
from resc.learning.checkpoint import CONFIG, save_policy
from resc.learning.ppo import RENEWED
from resc.learning.progress import ProgressTable, describe, draw_learning_curve
from resc.learning.training import train
from resc.process import prepare_process
from resc.recording.rollouts import open_recorder


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def main(config: DictConfig) -> None:
    """One training run in Hydra's run folder."""
    try:
        refuse_doubles()
        run(config, Path(HydraConfig.get().runtime.output_dir))
    except RescError as error:
        sys.exit("\n".join([f"error: {error}", *getattr(error, "__notes__", [])]))


def run(config: DictConfig, folder: Path) -> None:
    """Trains, flies held-out episodes, leaves policy, curve, recording, summary in the folder."""
    config, folder = resumed(config, folder)
    prepare_process(config["threads"], config["device"])
    trainer = build_trainer(config)
    restore(trainer, folder, config)
    stages = trainer.env.stages
    print(describe(stages), flush=True)
    OmegaConf.save(config, folder / CONFIG, resolve=True)
    link_latest(folder)
    recorder = open_recorder(
        config,
        stages,
        directory=folder / "rollouts",
        outcomes=(*stages.outcomes, RENEWED),
        num_envs=config["num_envs"],
        policy=trainer.networks.policy,
        overrides=HydraConfig.get().overrides.task,
    )
    logger = build(config["logger"], "logger", folder=folder)
    table = ProgressTable(folder / "progress.csv", trainer.frames)
    began, before = time.monotonic(), trainer.frames
    try:
        complete = train(
            trainer,
            folder,
            total_frames=config["total_frames"],
            recorder=recorder,
            logger=logger,
            table=table,
            checkpoint_every_s=config["checkpoint_every_s"],
        )
    finally:
        logger.close()
        if recorder is not None:
            recorder.close()
    wall_s = time.monotonic() - began
    save_policy(folder, trainer.networks, stages, config)
    if table.rows:
        draw_learning_curve(table.rows, folder / "learning_curve.png")
    speed = (trainer.frames - before) / wall_s
    summary = {"frames": trainer.frames, "wall_s": wall_s, "frames_per_s": speed}
    if not complete:
        finish_run(folder, summary)
        sys.exit(
            f"Stopped after {trainer.frames} frames. Go on with: "
            + command("train.py", {"resume": folder})
        )
    flights = fly_held_out(config, folder, HydraConfig.get().overrides.task)
    rates = {"success_rate": flights.success_rate, "collision_rate": flights.collision_rate}
    finish_run(folder, {**summary, "episodes": len(flights), **rates})
    succeed = f"{flights.success_rate:.1%} of {len(flights)} held-out episodes succeed"
    print(f"{succeed}. Results: {folder}")


if __name__ == "__main__":
    schema.register()
    launch(main, "train")
