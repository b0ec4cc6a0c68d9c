"""Microseconds of one inference of an exported policy: onnxruntime, torch and C, on one core.

    python benchmarks/export.py                              policies/obstacles
    python benchmarks/export.py policies/free                another
    python benchmarks/export.py runs/latest_train --json out.json    the figures as an object, too

One observation at a time. All take turns, block by block, so that what else the machine does meets
them alike; medians over all blocks count. C is timed without the call from Python.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # when started as a file

import numpy as np
import torch

from benchmarks.measure import machine, sentence, write_json
from resc.deployment.export import FILES, export
from resc.deployment.export_check import compiled, onnx_session
from resc.deployment.exported import HEADER, ONNX, TORCH, PlainPolicy
from resc.policies.stored import load_policy, policy_folder
from resc.process import prepare_process

BLOCKS, A_BLOCK = 40, 100
IN_C = 100
"""Inferences of a call into C."""
POLICY = "torch, the policy"
"""As an evaluation calls it, TensorDict and all."""
ALLOWED_US = 50.0

Run = Callable[[], object]


def runs(folder: Path, stored_in: Path) -> dict[str, tuple[Run, int]]:
    """What is timed, by name, and how many inferences each call is."""
    stored = load_policy(stored_in)
    export(stored, stored_in, folder, list(FILES.values()))
    policy, plain = stored.policy, PlainPolicy(stored.policy).eval()
    examples = tuple(torch.randn(1, example.shape[1]) for example in plain.examples)
    named = {n: e.numpy() for n, e in zip(plain.inputs, examples, strict=True)}
    session, program = onnx_session(folder / ONNX), torch.export.load(folder / TORCH).module()
    act = compiled(folder / HEADER)
    rows = np.random.default_rng(0).standard_normal((IN_C, plain.observation_width), np.float32)
    state = np.zeros((IN_C, max(1, plain.state_width)), np.float32)
    action = np.empty((IN_C, plain.action_width), np.float32)
    arrays = (rows, state, action)
    remembered = [example.unsqueeze(1) for example in examples[1:]]
    return {
        "onnxruntime": (lambda: session.run(None, named), 1),
        "C": (lambda: act(*(array.ctypes.data for array in arrays), IN_C), IN_C),
        "torch, plain layers": (lambda: plain(*examples), 1),
        "torch.export": (lambda: program(*examples), 1),
        POLICY: (lambda: policy.decide(examples[0], *remembered), 1),
    }


@torch.inference_mode()
def measure(timed: dict[str, tuple[Run, int]]) -> dict[str, float]:
    """Median microseconds of one inference of each."""
    times: dict[str, list[float]] = {name: [] for name in timed}
    for _ in range(BLOCKS):
        for name, (run, count) in timed.items():
            for _ in range(A_BLOCK):
                began = time.perf_counter()
                run()
                times[name].append((time.perf_counter() - began) / count * 1e6)
    return {name: statistics.median(values) for name, values in times.items()}


def table(found: dict[str, float]) -> str:
    """The medians as Markdown, each beside that of the policy in torch."""
    lines = ["| what runs it | one inference [us] | times as fast |", "|---|---:|---:|"]
    for name, value in found.items():
        lines.append(f"| {name} | {value:.2f} | {found[POLICY] / value:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Measures, prints the table, writes the figures; status 1 if onnxruntime is too slow."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("policy", nargs="?", default="policies/obstacles", help="its folder")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()
    prepare_process(1, "cpu")
    facts = machine("cpu", 1)
    with tempfile.TemporaryDirectory() as text:
        found = measure(runs(Path(text), policy_folder(args.policy, "policy")))
    print(sentence(facts), table(found), sep="\n\n")
    write_json(args.json, {f"{name}_us": value for name, value in found.items()} | facts)
    sys.exit(found["onnxruntime"] > ALLOWED_US)


if __name__ == "__main__":
    main()
