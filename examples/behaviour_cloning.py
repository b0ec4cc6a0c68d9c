"""Trains a policy on recorded flights: what another policy did becomes what this one should do.

python evaluate.py 'scenes=[training]' flights=1000 hydra.run.dir=runs/teacher
python examples/behaviour_cloning.py runs/teacher/rollouts
python evaluate.py policy=runs/cloned

The recording may be any of RESC's; its successful episodes are learned from. Observations are made
by flying them again, so the student may see something else than the teacher did:

python examples/behaviour_cloning.py runs/teacher/rollouts obstacle_observation=ray_guiding
"""

import argparse
import sys
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from tqdm import trange

from resc import schema
from resc.build import build, build_stages
from resc.errors import RescError
from resc.evaluation.replay import recorded_config
from resc.launch import CONF, explain
from resc.learning.assemble import fly_held_out
from resc.learning.checkpoint import save_policy
from resc.learning.offline import replay_buffer
from resc.recording import RolloutLog

SEES = ("env", "observation")
"""Groups of the configuration that say what the student sees."""


def main() -> None:
    """Reads the command line; a wrong one ends with a sentence and status 1."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("recording", help="an .mcap file, a folder or a pattern")
    parser.add_argument("overrides", nargs="*", help="of conf/train.yaml: what the student sees")
    parser.add_argument("--episodes", type=int, default=500, help="how many to learn from")
    parser.add_argument("--updates", type=int, default=5000, help="gradient steps")
    parser.add_argument("--batch", type=int, default=1024, help="transitions per gradient step")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/cloned"), help="where the policy goes"
    )
    args = parser.parse_intermixed_args()
    schema.register()
    try:
        with initialize_config_dir(str(CONF), version_base="1.3"):
            config = compose("train", ["compile=false", *args.overrides])
        clone(args, config)
    except HydraException as error:
        sys.exit(f"error: {explain(error, 'train')}")
    except RescError as error:
        sys.exit(f"error: {error}")


def clone(args: argparse.Namespace, config: DictConfig) -> None:
    """Learns the recorded actions, saves the policy and flies held-out episodes."""
    torch.set_num_threads(config["threads"])
    flights = RolloutLog(args.recording).where(success=True, complete=True)
    flights = flights.take(range(min(args.episodes, len(flights))))
    recorded = recorded_config(flights, config["allowed_targets"])
    sees = {group: OmegaConf.to_container(config[group], resolve=True) for group in SEES}
    buffer = replay_buffer(flights, batch_size=args.batch, config={**recorded, **sees})
    stages = build_stages(config)
    networks = build(
        config["model"],
        "model",
        observation_width=len(stages.observation_columns),
        action_width=stages.terms.action.width,
        seed=config["seed"],
    )
    networks.to(config["device"])
    optimizer = torch.optim.Adam(networks.head.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, args.updates)
    for _ in (bar := trange(args.updates, unit="update")):
        batch = buffer.sample().to(config["device"])
        action, _ = networks.policy(batch["observation"])
        loss = (action - batch["action"]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        bar.set_postfix(loss=f"{loss.item():.4f}", refresh=False)
    save_policy(args.out, networks, stages, config)
    held_out = fly_held_out(config, args.out)
    print(
        f"{held_out.success_rate:.1%} of {len(held_out)} held-out episodes succeed after cloning "
        f"{len(flights)} episodes ({len(buffer)} transitions). Policy: {args.out}"
    )


if __name__ == "__main__":
    main()
