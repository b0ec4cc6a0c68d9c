"""Trains a policy: compose, build, run, report.

python train.py                                    the default: flight among obstacles
python train.py +experiment=quick                  a few minutes of it
python train.py obstacle_observation=none          swap a part
python train.py init_from=latest reward.jerk.weight=0.1    the last run's policy, further
python train.py resume=latest                      go on with the last run, or sweep
python train.py --cfg job                          look, do not run
torchrun --nproc-per-node=2 train.py               the same training in two processes
"""

import sys
from contextlib import closing
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from resc import early as early  # first, for what it does as it is imported
from resc import ranks, schema
from resc.console import logged
from resc.envs.terms_table import describe
from resc.errors import ExitCode
from resc.learning import beginning
from resc.learning.training import train_and_save
from resc.learning.training_run import TrainingRun
from resc.pages.write import leave_page
from resc.process import prepare_process
from resc.run_folder import CONFIG, finish_run, link_latest, put_aside, succeeded
from resc.settings import RESUMABLE, check_settings
from resc.starting.answers import answering
from resc.starting.composed import refuse_doubles, refuse_idle_clearance
from resc.starting.launch import launch
from resc.starting.origin import note_origin
from resc.sweep_folder import go_on


@hydra.main(version_base="1.3", config_path="conf", config_name="train")
def main(config: DictConfig) -> None:
    """One training run in Hydra's run folder, or in that of the run it goes on with."""
    folder, overrides = Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().overrides.task
    with answering(), beginning.claimed_together(folder, resumes=bool(config["resume"])):
        refuse_doubles()
        refuse_idle_clearance(config["scene"], config["held_out"])
        check_settings(config, schema.TrainSchema)
        OmegaConf.resolve(config)
        if config["init_from"]:
            config["init_from"] = str(beginning.first_weights(config["init_from"], folder))
        if config["resume"]:
            taken = {name: OmegaConf.select(config, name) for name in RESUMABLE}
            config = beginning.resumed(folder, overrides, taken, config["resume"])
            if told := beginning.trained_already(folder, config["total_frames"]):
                print(told)
                return
        beginning.require_one_training(config, folder)
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
    resumes, init_from = bool(config["resume"]), config["init_from"]
    beginning.restore(trainer, folder, resumes=resumes, init_from=init_from)
    if not ranks.is_first():  # it writes, flies and speaks for all
        train_and_save(trainer, training, folder, logger)
        sys.exit(0 if trainer.frames >= config["total_frames"] else ExitCode.UNFINISHED)
    put_aside(folder)
    OmegaConf.save(config, folder / CONFIG, resolve=True)
    note_origin(folder, training.overrides)
    link_latest(folder, "train")
    with logged(folder / "train.log"), closing(logger):
        print(describe(trainer.env.stages), flush=True)
        summary = train_and_save(trainer, training, folder, logger)
        again = ranks.started_by(go_on(folder, config["allowed_targets"]))
        if trainer.frames < config["total_frames"]:
            leave_page(folder)
            print(f"Stopped after {trainer.frames} frames. Go on with: {again}", file=sys.stderr)
            sys.exit(ExitCode.UNFINISHED)
        try:
            flights = training.fly_held_out(folder)
            finish_run(folder, summary | flights.rates, "train")
        except BaseException as error:
            error.add_note(f"The policy is trained and kept; fly the held-out episodes by: {again}")
            raise
        finally:
            leave_page(folder)
        logger.attach(flights.rates)
        print(f"{succeeded(flights.rates)}. Results: {folder}")


if __name__ == "__main__":
    schema.register()
    launch(main, "train")
