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
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf, open_dict

from resc import schema
from resc.build import build, build_env, build_pool, load_config
from resc.errors import ConfigError, RescError
from resc.evaluation.flights import fly
from resc.evaluation.run_folder import finish_run, link_latest
from resc.learning.checkpoint import CHECKPOINT, CONFIG, load_checkpoint, load_policy, save_policy
from resc.learning.ppo import RENEWED, Ppo
from resc.learning.progress import ProgressTable, describe, draw_learning_curve
from resc.learning.training import train
from resc.planning.route import planner_for
from resc.process import prepare_process
from resc.recording.rollouts import open_recorder

CLOSED_BATCHES = 4
"""Batches for which a scene takes no new episodes before it is renewed; longer than nearly every episode."""


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def main(config: DictConfig) -> None:
    """One training run in Hydra's run folder."""
    try:
        run(config, Path(HydraConfig.get().runtime.output_dir))
    except RescError as error:
        sys.exit(f"error: {error}")


def run(config: DictConfig, folder: Path) -> None:
    """Trains, evaluates on fixed held-out scenes, and leaves policy, curve, recording and summary in the folder."""
    config, folder = resumed(config, folder)
    OmegaConf.save(config, folder / CONFIG, resolve=True)
    link_latest(folder)
    prepare_process(config["threads"], config["device"])
    trainer = build_trainer(config)
    if config["resume"]:
        load_checkpoint(folder / CHECKPOINT, trainer)
    print(describe(trainer.env.stages), flush=True)
    outcomes = (*trainer.env.stages.outcomes, RENEWED)
    recorder = open_recorder(
        config, trainer.env.stages, directory=folder / "rollouts", outcomes=outcomes, num_envs=config["num_envs"]
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
    save_policy(folder, trainer.networks, trainer.env.stages, config)
    draw_learning_curve(table.rows, folder / "learning_curve.png")
    summary = {"frames": trainer.frames, "wall_s": wall_s, "frames_per_s": (trainer.frames - before) / wall_s}
    if not complete:
        finish_run(folder, summary)
        raise ConfigError(f"Stopped at {trainer.frames} frames; go on with: python train.py resume={folder}")
    finish_run(folder, summary | evaluate(config, folder))


def build_trainer(config: DictConfig) -> Ppo:
    """The environment, the networks and PPO of a configuration."""
    renewed, size = config["renew_scenes"], config["pool_size"]
    if (CLOSED_BATCHES + 1) * renewed > size:
        raise ConfigError(f"renew_scenes is {renewed}; with pool_size {size} it can be at most {size // (CLOSED_BATCHES + 1)}.")
    if config["seed"] == config["evaluation_seed"]:
        raise ConfigError(f"seed is {config['seed']}, the seed of the evaluation scenes; choose another.")
    pool = build_pool(config, size=size, seed=config["seed"], device=config["device"], plan=planner_for(config))
    env = build_env(config, pool, seed=config["seed"], closed=CLOSED_BATCHES * renewed)
    networks = build(
        config["model"],
        "model",
        observation_width=env.observation_width,
        action_width=env.stages.terms.action.width,
        seed=config["seed"],
    )
    options = {"seed": config["seed"], "compile": config["compile"], "renew_scenes": renewed}
    settings = build(config["algorithm"], "algorithm")
    return Ppo(env, networks, settings, total_frames=config["total_frames"], **options)


def evaluate(config: DictConfig, folder: Path) -> dict[str, float]:
    """Success of the trained policy's mean action over fixed episodes of the training law, on held-out scenes."""
    episodes = config["evaluation_episodes"]
    seed = config["evaluation_seed"]
    pool = build_pool(config, size=episodes, seed=seed, device=config["device"], plan=planner_for(config))
    env = build_env({**config, "num_envs": episodes}, pool, seed=seed, in_order=True)
    flights = fly(env, load_policy(folder, config["device"]))
    return {"episodes": episodes, "success_rate": flights.success_rate, "collision_rate": flights.collision_rate}


def resumed(config: DictConfig, folder: Path) -> tuple[DictConfig, Path]:
    """The configuration and folder to use: those of an interrupted run if `resume` names one."""
    if not config["resume"]:
        return config, folder
    folder = Path(config["resume"]).resolve()
    stored = load_config(folder / CONFIG)
    with open_dict(stored):
        stored["resume"] = str(folder)
        stored["total_frames"] = max(stored["total_frames"], config["total_frames"])
    return stored, folder


if __name__ == "__main__":
    torch.set_float32_matmul_precision("high")
    schema.register()
    main()
