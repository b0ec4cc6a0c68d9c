"""Stands in for train.py: writes at once what a run leaves, or fails, or waits to be stopped."""

import json
import os
import signal
import sys
import time
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser

given = [text for text in sys.argv[1:] if not text.startswith("--")]
overrides = OverridesParser.create().parse_overrides(given)
arguments = {override.key_or_group: override.value() for override in overrides}
folder = Path(arguments["hydra.run.dir"])
with (folder.parent / f"starts_{folder.name}.txt").open("a") as file:
    file.write("resumed\n" if "resume" in arguments else "fresh\n")


facts = {"argv": sys.argv, "directory": os.getcwd(), "environment": dict(os.environ)}
(folder / "started.json").write_text(json.dumps({**facts, "optimize": sys.flags.optimize}))


def stop(*_):
    for name in ("checkpoint.pt", "config.yaml"):
        (folder / name).touch()
    print("Stopped after 100 frames. Go on with: ...", file=sys.stderr)
    sys.exit(3)


signal.signal(signal.SIGTERM, stop)
print("a table of terms")
if arguments.get("weight") == "high":
    sys.exit("error: reward.progress.weight is 'high'; expected a number.")
if arguments.get("killed"):
    signal.raise_signal(signal.SIGKILL)
(folder / "ready").touch()
deadline = time.monotonic() + 60
while arguments.get("wait") and "resume" not in arguments:
    time.sleep(0.02)
    if time.monotonic() > deadline:
        sys.exit("error: nobody stopped this run")
(folder / "evaluation.csv").touch()
(folder / "summary.json").write_text(json.dumps({"episodes": 8, "success_rate": 0.5}))
