"""Trains a policy on recorded flights: what another policy did becomes what this one should do.

python evaluate.py 'scenes=[training]' flights=1000 hydra.run.dir=runs/teacher
python examples/behaviour_cloning.py runs/teacher/rollouts
python evaluate.py policy=runs/cloned

The recording may be any of RESC's; its successful episodes are learned from. Observations are made
by flying them again, so the student may see something else than the teacher did:

python examples/behaviour_cloning.py runs/teacher/rollouts obstacle_observation=ray_guiding

So may a dataset that `resc-log lerobot` or `resc-log minari` has written, with what it shows:

resc-log lerobot runs/teacher/rollouts --where success --out runs/dataset
python examples/behaviour_cloning.py runs/dataset

A recording whose configuration names parts of your own package is flown only if you allow it:

python examples/behaviour_cloning.py runs/teacher/rollouts --allow mypackage.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.utils import ExplorationType, set_exploration_type

from resc import schema
from resc.console import progress
from resc.envs.stages import Stages
from resc.errors import RecordingError, RescError
from resc.flying.replay import recorded_config
from resc.learning.offline import replay_buffer
from resc.learning.training_run import TrainingRun
from resc.places import CONF
from resc.policies.stored import POLICY
from resc.process import prepare_process
from resc.recording import RolloutLog
from resc.recording.datasets import is_dataset, read_dataset, require_same_names
from resc.recording.selection import TRAJECTORY, Selection
from resc.settings import check_settings
from resc.setup import build_stages
from resc.starting.answers import refused

SEES = ("env", "observation")
"""Groups of the configuration that say what the student sees."""


def main() -> None:
    """Reads the command line; a wrong one ends with a sentence and status 1 or 2."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("recording", help="an .mcap file, a folder, a pattern, a dataset")
    parser.add_argument("overrides", nargs="*", help="of conf/train.yaml: what the student sees")
    parser.add_argument("--episodes", type=_count, default=500, help="how many to learn from")
    parser.add_argument("--updates", type=_count, default=5000, help="gradient steps")
    parser.add_argument("--batch", type=_count, default=1024, help="transitions per gradient step")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/cloned"), help="where the policy goes"
    )
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        metavar="PREFIX",
        help="prefix of your own package that the recorded configuration may name, such as "
        "mypackage.; the same as allowed_targets=[mypackage.]",
    )
    args = parser.parse_intermixed_args()
    schema.register()
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            config = compose("train", ["compile=false", *args.overrides])
        config["allowed_targets"] = [*config["allowed_targets"], *args.allow]
        check_settings(config, schema.TrainSchema)
        clone(args, config)
    except HydraException as error:
        sys.exit(f"error: {refused(error, 'train', args.overrides)}")
    except RescError as error:
        sys.exit(f"error: {error}")


def clone(args: argparse.Namespace, config: DictConfig) -> None:
    """Learns the recorded actions, saves the policy and flies held-out episodes."""
    prepare_process(config["threads"], config["device"])
    flights = None
    if not is_dataset(Path(args.recording)):
        flights = RolloutLog(args.recording).where(success=True, complete=True)
        flights = flights.take(range(min(args.episodes, len(flights))))
    run, stages = TrainingRun(config), build_stages(config)
    algorithm = run.algorithm(stages)
    policy = algorithm.policy
    prepare_output(args.out)
    buffer, episodes = read(args, config, stages, flights)
    if args.batch > len(buffer):
        raise RecordingError(
            f"--batch is {args.batch:,}, more than the {len(buffer):,} transitions recorded; "
            "lower it, or record more flights."
        )
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, args.updates)
    with progress(args.updates, unit="update", lasts=True) as bar:
        for _ in range(args.updates):
            batch = buffer.sample().to(config["device"])
            flown = batch["action"]
            with set_exploration_type(ExplorationType.DETERMINISTIC):
                action = policy(batch.select("observation"))["action"]
            loss = (action - flown).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            bar.set_postfix_str(f"loss {loss.item():.4f}", refresh=False)
            bar.update()
    run.save_policy(args.out, algorithm, stages)
    held_out = run.fly_held_out(args.out)
    print(
        f"{held_out.success_rate:.1%} of {len(held_out)} held-out episodes succeed after cloning "
        f"{episodes} episodes ({len(buffer)} transitions). Policy: {args.out}"
    )


def read(
    args: argparse.Namespace, config: DictConfig, stages: Stages, flights: Selection | None
) -> tuple[TensorDictReplayBuffer, int]:
    """What is learned from, and how many episodes of it."""
    if flights is None:
        place = Path(args.recording)
        data, names = read_dataset(place)
        require_same_names(names, stages.observation_columns, place)
        data = data[data[TRAJECTORY] < args.episodes]
        storage = LazyTensorStorage(len(data))
        buffer = TensorDictReplayBuffer(storage=storage, batch_size=args.batch)
        buffer.extend(data)
        return buffer, len(data[TRAJECTORY].unique())
    recorded = recorded_config(flights, config["allowed_targets"])
    sees = {group: OmegaConf.to_container(config[group], resolve=True) for group in SEES}
    shown = build_stages({**recorded, **sees})
    return replay_buffer(flights, batch_size=args.batch, stages=shown), len(flights)


def prepare_output(folder: Path) -> None:
    """Makes the folder of the policy, before any work is spent.

    Raises:
        RecordingError: It holds a policy already, or cannot be written to.
    """
    try:
        if (folder / POLICY).exists():
            raise RecordingError(f"{folder} holds a policy; give another folder with --out.")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise RecordingError(
            f"{folder} cannot be written to: {error.strerror}. Give another folder with --out."
        ) from error


def _count(text: str) -> int:
    """A number of things, for argparse."""
    count = int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0
    if count < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 1 to 999,999,999")
    return count


if __name__ == "__main__":
    main()
