"""How punctual set-points are: flights of the simulated vehicle over loopback, in real time.

python benchmarks/link.py            one flight
python benchmarks/link.py 5          five
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCENE = "scenes=[paper4_map15]"
PORT = 14599


def run(module: str, folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Starts one end of the link."""
    line = [sys.executable, "-m", f"resc.deployment.{module}", SCENE]
    line += [f"connection=udp:127.0.0.1:{PORT}", f"hydra.run.dir={folder / module}", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(line, cwd=ROOT, **pipes)


def main() -> None:
    """Flies and prints."""
    for _ in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            peer = run("peer", folder)
            fly = run("fly", folder, "arm=true", "link.wait_s=60")
            told = fly.communicate(timeout=300)[0]
            peer.send_signal(signal.SIGTERM)
            peer.wait(timeout=30)
            summary = folder / "fly" / "summary.json"
            if not summary.exists():
                sys.exit(told)
            f = json.loads(summary.read_text())
        load = os.getloadavg()[0]
        print(
            f"{f['outcome']}: {f['set_points']} set-points, late by {f['jitter_p50_ms']:.2f} ms "
            f"(p50), {f['jitter_p99_ms']:.2f} ms (p99), {f['late']} late, {f['left_out']} left "
            f"out; load {load:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
