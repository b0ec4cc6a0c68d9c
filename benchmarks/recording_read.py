"""How fast recordings are read.

    python benchmarks/recording_read.py                     1024 environments, 524,288 steps
    python benchmarks/recording_read.py runs/latest_train         a recording of your own
    python benchmarks/recording_read.py --json out.json

The file is in the page cache: what counts is decompression, checksums and copies. CPU time is given
beside wall time, because other jobs on the machine lengthen only the latter.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

import torch
from tensordict import TensorDict

from benchmarks.measure import machine, sentence, write_json
from resc import keys
from resc.process import prepare_process
from resc.recording import RolloutLog, RolloutRecorder
from resc.recording.columns import usual_columns
from resc.recording.schema import SAMPLED_ACTION

COLUMNS = usual_columns(tuple(f"term_{i}" for i in range(7)))
"""Those of a training run with the published reward."""
ENVS, BATCHES, STEPS, EPISODES = 1024, 16, 32, 10_000
GOALS = {"read_steps_per_s": 2e6, "one_env_ms": 25.0, "list_10000_ms": 100.0}


def make_recording(folder: Path, compression: str = "lz4") -> None:
    """A recording of random walks: 524,288 steps of 1024 environments, some 10,000 episodes."""
    generator = torch.Generator().manual_seed(0)
    outcomes = ("success", "collision", "time_limit")
    with RolloutRecorder(
        directory=folder,
        columns=COLUMNS,
        dt_s=0.02,
        num_envs=ENVS,
        metadata={"seed": "0"},
        attachments={},
        outcomes=outcomes,
        compression=compression,  # pyright: ignore[reportArgumentType]
    ) as recorder:
        began = torch.zeros(ENVS, dtype=torch.int64)
        values = {c.key: torch.zeros(ENVS, c.width) for c in COLUMNS if c.dtype == torch.float32}
        for start in range(0, BATCHES * STEPS, STEPS):
            batch = TensorDict({}, batch_size=[STEPS, ENVS])
            for key, last in values.items():
                walk = torch.randn(STEPS, *last.shape, generator=generator).mul_(0.01)
                batch[key] = walk.cumsum(0).add_(last)
                values[key] = batch[key][-1].clone()
            batch[keys.ACTION] = batch[SAMPLED_ACTION.key].clamp(-1, 1)
            ended = torch.rand(STEPS, ENVS, 1, generator=generator) < EPISODES / (
                BATCHES * STEPS * ENVS
            )
            batch[keys.TERMINATED], batch[keys.TRUNCATED] = ended, torch.zeros_like(ended)
            entries = []
            for step, env_id in ended[..., 0].nonzero().tolist():
                entries.append((env_id, int(began[env_id]), start + step))
                began[env_id] = start + step + 1
            recorder.put(batch, start, _episodes(entries))


def _episodes(entries: list[tuple[int, int, int]]) -> TensorDict:
    env_id, first, last = torch.tensor(entries).reshape(-1, 3).unbind(1)
    zeros = torch.zeros(len(env_id), dtype=torch.int64)
    return TensorDict(
        {
            "env_id": env_id,
            "episode": zeros,
            "start_step": first,
            "end_step": last,
            "length": last + 1 - first,
            "return_": torch.zeros(len(env_id)),
            "difficulty": torch.ones(len(env_id)),
            "success": env_id % 3 == 0,
            "outcome": env_id % 3,
            "scene": zeros,
        },
        batch_size=[len(env_id)],
    )


def reading_figures(location: str | Path, repeats: int = 7) -> dict[str, float]:
    """Medians: rates [env-steps/s], times [ms], CPU times [ms] with `_cpu` in the name."""
    log = RolloutLog(location)
    steps, episodes = log.to_tensordict().numel(), len(log)
    figures: dict[str, float] = {"env_steps": steps, "episodes": episodes}
    wholes: dict[str, Callable[[], object]] = {
        "read": lambda: log.to_tensordict(),
        "polars": lambda: log.to_polars(),
        "selection": lambda: log.where(complete=True).to_tensordict(),
    }
    for name, task in wholes.items():
        wall, cpu = _median_s(task, repeats)
        of = log.where(complete=True).episodes["length"].sum() if name == "selection" else steps
        figures |= {f"{name}_steps_per_s": of / wall, f"{name}_steps_per_cpu_s": of / cpu}
    ids = iter(range(0, log.num_envs * repeats, max(log.num_envs // repeats, 1)))
    short: dict[str, Callable[[], object]] = {
        "one_env": lambda: log.env(next(ids) % log.num_envs),
        "list": lambda: RolloutLog(location).episodes,
    }
    for name, task in short.items():
        wall, cpu = _median_s(task, repeats)
        figures |= {f"{name}_ms": 1e3 * wall, f"{name}_cpu_ms": 1e3 * cpu}
    if episodes:
        figures["list_10000_ms"] = figures["list_ms"] * 10_000 / episodes
    return figures


def _median_s(task: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median wall and CPU time of a task [s]."""
    times = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        task()
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    walls, cpus = zip(*times, strict=True)
    return statistics.median(walls), statistics.median(cpus)


def goal(name: str) -> str:
    """The goal of a figure; nothing where there is none."""
    return f"{GOALS[name]:,.4g}" if name in GOALS else ""


def main() -> None:
    """Prints the table and writes the figures."""
    parser = argparse.ArgumentParser(description="How fast recordings are read.")
    parser.add_argument("location", nargs="?", help="a recording; one is made if not given")
    parser.add_argument("--json", type=Path, help="write the figures there, too")
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    prepare_process(1, "cpu")
    with tempfile.TemporaryDirectory() as folder:
        if args.location is None:
            make_recording(Path(folder))
        figures = reading_figures(args.location or folder, args.repeats)
    facts = machine("cpu", 1)
    print("| | measured | goal |\n|---|---|---|")
    for name, value in figures.items():
        print(f"| {name} | {value:,.4g} | {goal(name)} |")
    print(f"\n{sentence(facts)}")
    write_json(args.json, {**figures, **facts})


if __name__ == "__main__":
    main()
