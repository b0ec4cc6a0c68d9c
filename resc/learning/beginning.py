"""What a training run begins with: the run that it goes on with, or the weights of another."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from resc import ranks
from resc.build import load_config
from resc.errors import ConfigError
from resc.learning.checkpoint import load_checkpoint
from resc.learning.trainer import Trainer
from resc.policies.stored import load_weights, policy_folder
from resc.run_folder import (
    CHECKPOINT,
    CONFIG,
    LATEST,
    ORIGIN,
    SUMMARY,
    claimed,
    is_finished,
    json_of,
    succeeded,
    summary_of,
    sweep_of,
)
from resc.schema import TrainSchema
from resc.settings import LATER, check_settings, fingerprint, honoured, listed
from resc.sweep_folder import difference, go_on, plain, require_as_begun


@contextmanager
def claimed_together(folder: Path, *, resumes: bool) -> Iterator[None]:
    """`run_folder.claimed` by the first rank, for all of a training."""
    with claimed(folder, resumes=resumes) if ranks.is_first() else nullcontext():
        ranks.wait()
        yield


def require_one_training(settings: Any, folder: Path) -> None:  # noqa: ANN401 - a configuration
    """Refuses ranks that would not train the same.

    Raises:
        ConfigError: It names the first setting that differs, and both values.
    """
    first, *others = ranks.gather({"hydra.run.dir": str(folder.resolve()), **plain(settings)})
    for number, own in enumerate(others, 1):
        if found := difference(first, own):
            name, ours, theirs = found
            raise ConfigError(
                f"{name} is {ours} in process 0 of this training, but {theirs} in process "
                f"{number}; start all of them with the same command and the same files."
            )


def trained_already(folder: Path, total_frames: int) -> str:
    """What to say of a run that has nothing left to train; nothing where it has."""
    summary = summary_of(folder)
    if not is_finished(folder) or summary["frames"] < total_frames:
        return ""
    return f"{succeeded(summary)} already; a larger total_frames trains it further."


def resumed(
    folder: Path, overrides: Sequence[str], taken: Mapping[str, Any], resume: str
) -> DictConfig:
    """Configuration of the run in `folder`, which `resume` names.

    Args:
        folder: Of the run.
        overrides: Of the command line. A larger `total_frames` lengthens the run; the others of
            `RESUMABLE` are taken over.
        taken: What the command line makes of `RESUMABLE`. Its allowed_targets hold in any case: a
            folder cannot opt in for its reader.
        resume: The setting.

    Raises:
        ConfigError: There is no such run, it is part of a sweep that has another budget, or an
            override cannot be honoured.
    """
    if folder.resolve() != Path(resume).resolve():
        raise ConfigError(
            f"hydra.run.dir is {folder}, but a resumed run stays where it is; leave it out."
        )
    if "total_frames" not in load_config(folder / CONFIG):
        raise ConfigError(f"{folder} holds no training run; give the folder of one.")
    stored = _settings_in(folder / CONFIG)
    if sweep_of(folder):
        require_as_begun(folder)
    made_with = listed(json_of(folder / ORIGIN).get("overrides", []))
    changed = honoured(overrides, made_with, folder)
    if "total_frames" in changed:
        _require_longer(taken["total_frames"], stored["total_frames"], folder)
    told = summary_of(folder).get("made_with")
    if told and told != fingerprint(stored):
        raise ConfigError(
            f"{folder / SUMMARY} belongs to a run with other settings than {CONFIG} beside it; "
            "restore both from one run, or delete it."
        )
    new = {name: taken[name] for name in {*changed, "allowed_targets"}}
    with open_dict(stored):
        for name, value in {**new, "resume": resume}.items():
            OmegaConf.update(stored, name, value)
    return stored


def _settings_in(path: Path) -> DictConfig:
    """A stored configuration with the types of a run's settings, as Hydra composes one, checked.

    Raises:
        ConfigError: A setting is missing, foreign, of another type or out of range.
    """
    repair, stored = f"restore {path} from its run", load_config(path)
    names = [field.name for field in fields(TrainSchema) if field.name not in LATER]
    if missing := [name for name in names if name not in stored]:
        raise ConfigError(f"{path} has no {missing[0]}; {repair}.")
    try:
        config = cast(DictConfig, OmegaConf.merge(OmegaConf.structured(TrainSchema), stored))
    except OmegaConfBaseException as error:
        reason = str(error).partition("\n")[0]
        raise ConfigError(f"{error.full_key} is wrong ({reason}); {repair}.") from None
    check_settings(config, TrainSchema)
    return config


def _require_longer(frames: int, budget: int, folder: Path) -> None:
    if frames < budget:
        raise ConfigError(
            f"total_frames is {frames}, but the run in {folder} was given {budget}; a resumed run "
            "can only be lengthened."
        )
    if frames > budget and (sweep := sweep_of(folder)):
        raise ConfigError(
            f"total_frames is {frames}, but {folder.name} is a run of the sweep {sweep}, whose "
            f"runs all take {budget}; begin a longer sweep, or go on with: " + go_on(sweep)
        )


def first_weights(text: str, folder: Path) -> Path:
    """The folder that `init_from` names, in the run that trains in `folder`.

    Raises:
        ConfigError: There is none, or `latest` stands for another in each run of a sweep.
    """
    if text == LATEST and sweep_of(folder):
        raise ConfigError(
            f"init_from is {LATEST}, which each run of a sweep changes; name the folder."
        )
    return policy_folder(text, "init_from").resolve()


def restore(trainer: Trainer, folder: Path, *, resumes: bool, init_from: str | None) -> None:
    """Loads what training begins with, if anything.

    A resumed run's checkpoint (without one yet, it begins again), else the weights of `init_from`.
    """
    if resumes and (folder / CHECKPOINT).exists():
        load_checkpoint(folder / CHECKPOINT, trainer)
        return
    if resumes:
        print(f"{folder} holds no checkpoint yet: the run begins again.", flush=True)
    if init_from:
        networks = trainer.algorithm.networks
        afresh = load_weights(Path(init_from), networks, trainer.env.stages)
        trainer.algorithm.take_over()
        if afresh:
            print(
                f"Not in {init_from}, so these start from scratch: {', '.join(afresh)}", flush=True
            )
