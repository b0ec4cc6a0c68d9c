"""A recorded episode flown again: its start and scene put back, its actions taken once more.

On the device and with the versions that recorded it, every number comes out again bit for bit.
"""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from resc import keys
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.errors import ConfigError, RecordingError
from resc.flying.episodes import RENEWED
from resc.flying.loop import flown
from resc.groups import NEEDED
from resc.keys import NestedKey
from resc.recording.columns import REPLAN_COLUMNS, REWARD_TERMS, STATE_COLUMNS, require_columns
from resc.recording.configuration import require_groups
from resc.recording.reader import RolloutLog
from resc.recording.schema import SAMPLED_ACTION
from resc.recording.selection import Selection
from resc.run_folder import finish_run, provenance
from resc.scenes.pool import layout_from
from resc.setup import among, build_stages

STATE = tuple(column.key for column in (*STATE_COLUMNS, *REPLAN_COLUMNS))
FLAGS = (keys.TERMINATED, keys.TRUNCATED)
OUTPUTS = (keys.REWARD, REWARD_TERMS, *FLAGS)


@dataclass(frozen=True)
class Replay:
    """What came of a replay.

    Args:
        location: File and episode.
        steps: Length of the episode.
        deviations: Largest difference to the recording, by column.
        differing: Versions and device of the recording and of now, where they differ.
        env: What flew it.
    """

    location: str
    steps: int
    deviations: dict[NestedKey, float]
    differing: dict[str, tuple[str, str]]
    env: QuadrotorEnv

    @property
    def largest(self) -> float:
        """Largest deviation of any column."""
        return max(self.deviations.values())

    def report(self) -> str:
        """A table and a sentence."""
        names = {key: ".".join(key) for key in self.deviations}
        width = max(len("largest deviation in"), *map(len, names.values()))
        head = [
            f"| {'largest deviation in':<{width}} |           |",
            f"| {'-' * width} | --------: |",
        ]
        rows = [
            f"| {names[key]:<{width}} | {value:9.3g} |" for key, value in self.deviations.items()
        ]
        same = self.largest == 0
        verdict = "came out again bit for bit" if same else "came out differently"
        lines = [*head, *rows, "", f"All {self.steps} steps of {self.location} {verdict}."]
        for name, (then, now) in self.differing.items():
            lines.append(f"Recorded with {name} {then}, replayed with {now}.")
        return "\n".join(lines)


def parse(location: str) -> tuple[Path, int]:
    """Path and episode of FILE#EPISODE.

    Raises:
        ConfigError: It is written otherwise.
    """
    path, _, episode = location.rpartition("#")
    if not path or not re.fullmatch(r"-?\d+", episode, re.ASCII):
        raise ConfigError(
            f"replay is '{location}'; expected FILE#EPISODE, such as "
            "runs/latest_train/rollouts/rollouts_00000.mcap#3."
        )
    return Path(path), int(episode)


def replay(location: str, folder: Path, *, allowed: Sequence[str] = ()) -> str:
    """Flies the episode FILE#EPISODE again, compares, and leaves report and summary in the folder.

    Returns the report.
    """
    began = time.perf_counter()
    result = fly_again(location, allowed=allowed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "replay.md").write_text(f"# {location}\n\n{result.report()}\n")
    figures = {
        "replay": location,
        "steps": result.steps,
        "largest_deviation": result.largest,
        "deviations": {".".join(key): value for key, value in result.deviations.items()},
        "wall_s": time.perf_counter() - began,
        **provenance(),
    }
    finish_run(folder, figures, "replay")
    return result.report()


def fly_again(location: str, *, allowed: Sequence[str] = ()) -> Replay:
    """Flies the episode FILE#EPISODE again and compares every step with the recording.

    All rows of a batch as large as the recorded one fly it, compiled if that was: a row's bits may
    depend on both.

    Raises:
        RecordingError: The file, the episode, or how it began is not there.
        ConfigError: The recorded configuration builds no environment today, or what was recorded is
            a real vehicle's flight.
    """
    path, episode = parse(location)
    log = RolloutLog(path)
    recorded, world, scene = log.episode(episode), log.start(episode), log.scene(episode)
    config = recorded_config(log, allowed)
    # A recording may hold only some of the environments; they flew among all.
    count = config.get("num_envs") or log.num_envs
    layout = layout_from({name: array.unsqueeze(0) for name, array in scene.items()})
    stages = build_stages(config)
    require_simulated(stages, location)
    setup = among(layout, stages, config["device"])
    env = setup.env(count, compiled=config["compile"], in_order=True)
    put_back(env, world)
    listed = log.episodes.row(episode, named=True)
    cut = listed["outcome"] == RENEWED
    deviations = compare(env, recorded, listed["env_id"], cut=cut)
    today = {**provenance(), "device": str(config["device"])}
    if log.round_bits is not None:
        today["mantissa bits"] = "23"
    then = {**log.metadata, "mantissa bits": str(log.round_bits)}
    differing = {
        name: (value, today[name])
        for name, value in then.items()
        if name in today and name != "git_dirty" and value != today[name]
    }
    return Replay(location, len(recorded), deviations, differing, env)


def recorded_config(log: RolloutLog | Selection, allowed: Sequence[str] = ()) -> dict[str, Any]:
    """The configuration of a recording, for this machine, with the prefixes its reader allows."""
    stored = log.config
    require_groups(stored, ("device", *NEEDED))
    config = cast(dict[str, Any], OmegaConf.to_container(stored, resolve=True))
    config["device"] = str(config["device"])  # whatever it is, torch says what it may be
    config["allowed_targets"] = list(allowed)  # a recording cannot opt in for its reader
    if config["device"].startswith("cuda") and not torch.cuda.is_available():
        config["device"] = "cpu"
    return config


def require_simulated(stages: Stages, location: str) -> None:
    """Raises ConfigError if a term's outputs came from outside, such as a real vehicle's state."""
    for term in stages.terms:
        if not term.replays:
            raise ConfigError(
                f"replay is {location}, whose {term.path} is {type(term).__name__}: no actions "
                "bring that flight back; draw it with resc-log, or replay a simulated one."
            )


def put_back(env: QuadrotorEnv, world: TensorDict) -> None:
    """Gives every row of the environment the recorded world, in the pool's only scene.

    Raises:
        RecordingError: The recorded world has other parts than the environment's.
    """
    recorded = set(world.keys(include_nested=True, leaves_only=True))
    expected = set(env.stages.persistent) - {*keys.KNOWN_MAP}
    if recorded != expected:
        parts = sorted(".".join(key) for key in recorded ^ expected)
        raise RecordingError(
            f"The recorded world and that of the simulator differ in {', '.join(parts)}; replay "
            "with the version that recorded it (metadata 'resc.run')."
        )
    rows = world.expand(env.num_envs).clone()
    rows[keys.SCENE_INDEX].zero_()
    env.begin(rows)


def compare(
    env: QuadrotorEnv, recorded: TensorDict, row: int, *, cut: bool
) -> dict[NestedKey, float]:
    """Largest difference of a row to the recording, by column, over all steps.

    Where the episode was `cut` from outside, its last flags are not the simulator's.
    """
    require_columns(recorded, [SAMPLED_ACTION.key], "a replay")
    deviations = {key: 0.0 for key in (*STATE, *OUTPUTS) if recorded.get(key, None) is not None}
    if not deviations:
        raise RecordingError(
            "The recording holds only the actions, so there is nothing to compare with; record "
            "with recorder.fields=null."
        )
    recorded = recorded.to(env.device)
    actions = (step[SAMPLED_ACTION.key].expand(env.num_envs, -1) for step in recorded)
    for number, (step, (before, _, out)) in enumerate(
        zip(recorded, flown(env, actions), strict=True)
    ):
        found = {key: before[key] for key in STATE if key in deviations}
        found |= {key: getattr(out, key[0]) for key in OUTPUTS}
        foreign = FLAGS if cut and number == len(recorded) - 1 else ()
        for key in deviations.keys() - foreign:
            apart = (found[key][row].double() - step[key].double()).abs().nan_to_num(torch.inf)
            deviations[key] = max(deviations[key], float(apart.max()))
    return deviations
