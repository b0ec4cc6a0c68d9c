"""Trains a policy: compose, build, run, report.

python train.py                                    the default: flight among obstacles
python train.py +experiment=quick                  a few minutes of it
python train.py obstacle_observation=none          swap a part
python train.py resume=latest                      go on with the last run, or sweep
python train.py --cfg job                          look, do not run
"""

import sys
from contextlib import closing
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.console import logged
from resc.envs.terms_table import describe
from resc.errors import ExitCode
from resc.learning.beginning import first_weights, restore, resumed
from resc.learning.training import train_and_save
from resc.learning.training_run import TrainingRun
from resc.pages.write import leave_page
from resc.process import prepare_process
from resc.run_folder import (
    CONFIG,
    claimed,
    finish_run,
    is_finished,
    link_latest,
    put_aside,
    succeeded,
    summary_of,
)
from resc.settings import RESUMABLE, check_settings
from resc.starting.launch import answering, launch, refuse_doubles
from resc.starting.origin import note_origin
from resc.sweep_folder import go_on


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def main(config: DictConfig) -> None:
    """One training run in Hydra's run folder, or in that of the run it goes on with."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    overrides = HydraConfig.get().overrides.task
    with answering(), claimed(folder, resumes=bool(config["resume"])):
        refuse_doubles()
        check_settings(config, schema.TrainSchema)
        OmegaConf.resolve(config)
        if config["init_from"]:
            config["init_from"] = str(first_weights(config["init_from"], folder))
        if config["resume"]:
            taken = {name: OmegaConf.select(config, name) for name in RESUMABLE}
            config = resumed(folder, overrides, taken, config["resume"])
            summary = summary_of(folder)
            if is_finished(folder) and summary["frames"] >= config["total_frames"]:
                print(f"{succeeded(summary)} already; a larger total_frames trains it further.")
                return
        run(TrainingRun(config, overrides), folder)


def run(training: TrainingRun, folder: Path) -> None:
    """Trains, flies held-out episodes, leaves policy, curve, recording, summary in the folder."""
    config = training.config
    prepare_process(config["threads"], config["device"])
    logger = training.logger(folder)
    print(f"Laying out {config['pool_size']} scenes", flush=True)
    trainer = training.trainer()
    training.check_recorder(trainer)
    training.check_held_out(trainer.env.stages)
    restore(trainer, folder, resumes=bool(config["resume"]), init_from=config["init_from"])
    if is_finished(folder):
        put_aside(folder)
    OmegaConf.save(config, folder / CONFIG, resolve=True)
    note_origin(folder, training.overrides)
    link_latest(folder, "train")
    with logged(folder / "train.log"), closing(logger):
        print(describe(trainer.env.stages), flush=True)
        summary = train_and_save(trainer, training, folder, logger)
        leave_page(folder)
        again = go_on(folder, config["allowed_targets"])
        if trainer.frames < config["total_frames"]:
            print(f"Stopped after {trainer.frames} frames. Go on with: {again}", file=sys.stderr)
            sys.exit(ExitCode.UNFINISHED)
        try:
            flights = training.fly_held_out(folder)
        except BaseException as error:
            error.add_note(f"The policy is trained and kept; fly the held-out episodes by: {again}")
            raise
        finish_run(folder, summary | flights.rates, "train")
        leave_page(folder)
        logger.attach(flights.rates)
        print(f"{succeeded(flights.rates)}. Results: {folder}")


if __name__ == "__main__":
    schema.register()
    launch(main, "train")
