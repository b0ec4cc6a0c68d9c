"""The life of a training run: batches until the frames are flown, saved on the way."""

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, cast

import torch
from torch import Tensor
from tqdm import tqdm

from resc import ranks
from resc.console import progress
from resc.envs.terms_table import write_terms
from resc.errors import CheckpointError, LostRankError, RecordingError, RescError
from resc.learning.checkpoint import save_checkpoint
from resc.learning.progress import Logger, ProgressTable
from resc.learning.trainer import Trainer
from resc.learning.training_run import TrainingRun
from resc.recording.rollouts import (
    record_world,
    start_arrays,
    with_flown,
    with_success,
)
from resc.recording.schema import ROUTES
from resc.recording.writer import RolloutRecorder
from resc.run_folder import CHECKPOINT, PROGRESS, finish_run
from resc.sweep_folder import go_on


@dataclass
class Interruption:
    """Whether the user asked to stop; a second request stops at once."""

    requested: bool = False
    signal_number: int = field(default=0)


@contextmanager
def stopping_at_batch_end() -> Iterator[Interruption]:
    """Turns the first SIGINT or SIGTERM into a request heeded after the batch in hand."""
    interruption = Interruption()
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def request(number: int, _: FrameType | None) -> None:
        interruption.requested, interruption.signal_number = True, number
        for caught, handler in previous.items():
            signal.signal(caught, handler)
        if ranks.is_first():
            tqdm.write(
                "Stopping after this batch; the checkpoint will be saved. Interrupt again to stop "
                "at once."
            )

    for number in previous:
        signal.signal(number, request)
    try:
        yield interruption
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def train_and_save(
    trainer: Trainer, run: TrainingRun, folder: Path, logger: Logger
) -> dict[str, Any]:
    """Trains until the budget is spent or a signal comes, saves; returns frames and seconds.

    The summary counts all processes that trained the run, one after the other or together, and,
    under `process`, what this one added; `processes` is how many train it together.
    """
    if ranks.is_first():
        write_terms(trainer.env.stages, folder)
    recorder = run.recorder(trainer, folder)
    save = partial(run.save_policy, folder, trainer.algorithm, trainer.env.stages)
    table = ProgressTable(folder / PROGRESS, trainer.frames)
    frames, trained_s = trainer.frames, trainer.trained_s
    try:
        train(
            trainer,
            folder,
            total_frames=run.config["total_frames"],
            recorder=recorder,
            logger=logger,
            table=table,
            checkpoint_every_s=run.config["checkpoint_every_s"],
        )
    except Exception as error:
        if ranks.is_first():
            _keep_policy(trainer, save, folder, error)
        if isinstance(error, LostRankError):
            again = ranks.started_by(go_on(folder, run.config["allowed_targets"]))
            error.add_note(f"Go on from the last checkpoint with: {again}")
        raise
    finally:
        if recorder is not None:
            recorder.close()
    if ranks.is_first():
        save()
    if ranks.is_first() and table.rows:
        from resc.learning.learning_curve import draw_learning_curve

        draw_learning_curve(table.rows, folder / "learning_curve.png")
    own = speeds(trainer.frames - frames, trainer.trained_s - trained_s)
    summary = {
        **speeds(trainer.frames, trainer.trained_s),
        "processes": ranks.count(),
        "process": own,
        "made_with": trainer.made_with,
    }
    if ranks.is_first():
        finish_run(folder, summary, "train")
    return summary


def speeds(frames: int, wall_s: float) -> dict[str, float | int]:
    """Frames trained on, the seconds that training them took, and their ratio."""
    return {
        "frames": frames,
        "wall_s": wall_s,
        "frames_per_s": frames / wall_s if wall_s else math.nan,
    }


def train(
    trainer: Trainer,
    folder: Path,
    *,
    total_frames: int,
    recorder: RolloutRecorder | None,
    logger: Logger,
    table: ProgressTable,
    checkpoint_every_s: float,
) -> bool:
    """Trains until `total_frames`; whether it got there.

    Errors of the recorder leave a saved checkpoint behind. Of several ranks, one cannot save what
    another had that was killed, so they save their first batch, too.
    """
    pool = trainer.env.pool
    saved_at = counted_to = time.monotonic()
    saved_at -= checkpoint_every_s if ranks.count() > 1 else 0
    ranks.copy_first(trainer.algorithm.networks)
    if recorder is not None:
        record_world(recorder, pool, trainer.collector.start_step)
        trainer.collector.keep_starts()
    bar = progress(
        total_frames,
        lasts=True,
        silent=not ranks.is_first(),
        initial=trainer.frames,
        unit="step",
        unit_scale=True,
    )
    if total_frames < trainer.batch_frames and ranks.is_first():
        whole = f"a batch is {trainer.batch_frames} steps, and a whole one is trained"
        print(f"total_frames is {total_frames}; {whole}.", flush=True)
    with stopping_at_batch_end() as interruption, bar:
        while trainer.frames < total_frames and not ranks.any_of(interruption.requested):
            began = time.monotonic()
            figures = trainer.iterate()
            _record_or_save(trainer, recorder, folder)
            curricula = trainer.curricula
            figures |= trainer.statistics.rates() | _reward_terms(trainer) | curricula.figures()
            figures |= trainer.statistics.success_by_difficulty(curricula.active)
            figures["speed/steps_per_s"] = trainer.batch_frames / (time.monotonic() - began)
            figures["episode/total"] = float(trainer.statistics.total)
            if ranks.is_first():
                logger.log(figures, trainer.frames)
                table.add({"frames": float(trainer.frames), **figures})
            bar.set_postfix_str(_summary(figures), refresh=False)
            bar.update(trainer.batch_frames)
            now = time.monotonic()
            trainer.trained_s += now - counted_to
            counted_to = now
            if ranks.any_of(now - saved_at > checkpoint_every_s):
                if recorder is not None:
                    recorder.flush()  # a resumed run records nothing from before its checkpoint
                save_checkpoint(folder / CHECKPOINT, trainer)
                saved_at = time.monotonic()
    save_checkpoint(folder / CHECKPOINT, trainer)
    return trainer.frames >= total_frames


def _keep_policy(
    trainer: Trainer, save: Callable[[], None], folder: Path, error: Exception
) -> None:
    """Saves the weights that the last whole batch left; the disk may be full, or they spoilt."""
    if not all(parameter.isfinite().all() for parameter in trainer.algorithm.parameters):
        return
    try:
        save()
    except (RescError, OSError) as failure:
        error.add_note(f"The policy could not be saved: {failure}")
    else:
        error.add_note(f"The policy as it was after {trainer.frames} frames is in {folder}.")


def _record_or_save(trainer: Trainer, recorder: RolloutRecorder | None, folder: Path) -> None:
    """Records the batch; where a rank cannot, all save the checkpoint and end.

    Raises:
        RecordingError: The recorder failed; so may the checkpoint, as the disk may be full.
        LostRankError: That of another rank did.
    """
    error = None
    try:
        record_batch(trainer, recorder)
    except RecordingError as failure:
        error = failure
    if not ranks.any_of(error is not None):
        return
    error = error or LostRankError("Another process of this training cannot record.")
    try:
        save_checkpoint(folder / CHECKPOINT, trainer)
    except CheckpointError as failure:
        error.add_note(f"The previous checkpoint is kept: {failure}")
    raise error


def record_batch(trainer: Trainer, recorder: RolloutRecorder | None) -> None:
    """Hands the batch just flown to the recorder, with the scenes renewed after it."""
    if recorder is None:
        return
    start = trainer.statistics.start_step
    recorder.put(
        with_flown(trainer.collector.flown),
        start,
        with_success(trainer.statistics.episodes()),
        start_arrays(trainer.collector.take_starts()),
        {ROUTES: trainer.collector.take_routes()},
    )
    if count := trainer.collector.renew_scenes:
        pool = trainer.env.pool
        renewed = (pool.head + torch.arange(-count, 0)) % len(pool)
        record_world(recorder, pool, trainer.collector.start_step, renewed)


def _reward_terms(trainer: Trainer) -> dict[str, float]:
    """Mean weighted reward per step, by term."""
    means = ranks.mean(cast(Tensor, trainer.batch["reward_terms"]).mean((0, 1))).tolist()
    names = [term.name for term in trainer.env.stages.terms.rewards]
    return {f"reward/{name}": mean for name, mean in zip(names, means, strict=True)}


def _summary(figures: dict[str, float]) -> str:
    success, collision = figures.get("outcome/success"), figures.get("outcome/collision")
    parts = [
        f"{share:.1%} {name}"
        for name, share in (("success", success), ("collision", collision))
        if share is not None
    ]
    difficulties = [
        f"{name.removeprefix('difficulty/')} {value:.2f}"
        for name, value in figures.items()
        if name.startswith("difficulty/")
    ]
    return ", ".join(parts + difficulties)
