"""Rerun's own web viewer on a recording, in a headless Chromium, as a picture.

python tests/viewing/rerun_viewer.py flight.rrd docs/scene_rerun.png

Needs Rerun, Playwright for Python and a Chromium: that of `playwright install chromium`, or the
program that the variable CHROMIUM names. Everything is served from this machine.
"""

import io
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
from PIL import Image

SIZE = {"width": 1280, "height": 720}
DRAWS = (
    *("--no-sandbox", "--no-zygote", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
)
"""What a Chromium takes that draws in 3-D without a GPU, in a container, as root."""
SLIDER = (265, -208, -14)
"""Ends of the time slider, from the left and the right, and its place from below [pixels]."""
LONGEST_S = 240.0
LEAST_PX = 50


@contextmanager
def served(path):
    """The address under which Rerun's web viewer shows a recording."""
    data, pages = _free_ports()
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--bind", "127.0.0.1"]
    command += ["--port", str(data), "--web-viewer-port", str(pages), str(path)]
    server = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        _wait_for(pages)
        yield f"http://127.0.0.1:{pages}/?url=rerun%2Bhttp://127.0.0.1:{data}/proxy&renderer=webgl"
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def seen(play, path, ready):
    """What the viewer shows halfway through a recording, as an image, once it is ready."""
    with served(path) as address:
        browser = play.chromium.launch(
            executable_path=os.environ.get("CHROMIUM"), args=list(DRAWS), timeout=60_000
        )
        page = browser.new_page(viewport=SIZE)
        page.goto(address, timeout=60_000)
        began = time.monotonic()
        while True:
            picture = _halfway(page)
            there = ready(picture)
            if there or time.monotonic() - began > LONGEST_S:
                picture = _halfway(page) if there else picture  # the first click may come too early
                browser.close()
                return picture


def count(picture, colour):
    """Pixels of a colour, but for what the viewer's shading changes."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - wanted).max(-1) <= 12).sum())


def drawn(picture):
    """Whether obstacles, their ring and the vehicle are in the left half of the window."""
    from resc.viewing.colours import FRONT, INFLATED, OBSTACLE

    left = picture[:, : SIZE["width"] // 2]
    return all(count(left, colour) > LEAST_PX for colour in (OBSTACLE, INFLATED, FRONT))


def _halfway(page):
    """A screenshot, with the time in the middle of the flight."""
    first, last, below = SLIDER
    page.wait_for_timeout(3000)
    page.mouse.move((first + SIZE["width"] + last) / 2, SIZE["height"] + below)
    page.mouse.down()
    page.wait_for_timeout(500)
    page.mouse.up()
    page.wait_for_timeout(2000)
    shot = page.screenshot(timeout=120_000)
    return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"))


def _free_ports():
    with socket.socket() as one, socket.socket() as other:
        for taken in (one, other):
            taken.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


def _wait_for(port):
    began = time.monotonic()
    while time.monotonic() - began < 60:
        with socket.socket() as knock:
            if knock.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    raise TimeoutError("Rerun's web viewer does not answer")


if __name__ == "__main__":
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playing:
        Image.fromarray(seen(playing, sys.argv[1], drawn)).save(sys.argv[2], optimize=True)
