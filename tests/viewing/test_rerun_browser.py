"""A flight in Rerun's web viewer: the file opens with its own layout, and all of it is there."""

import numpy as np
import pytest
from PIL import Image
from rerun_viewer import SIZE, count, drawn, seen
from street import fly_street

from resc.viewing.colours import AXES, INFLATED, OBSTACLE

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")


@pytest.fixture(scope="module")
def picture(compose, tmp_path_factory):
    """The window, halfway through a flight along the street."""
    from resc.viewing.rerun_scene import write_rerun

    log = fly_street(
        compose("num_envs=2", "recorder=mcap", "task=from_rest"), tmp_path_factory.mktemp("street")
    )
    path = write_rerun(log, 1, tmp_path_factory.mktemp("scenes") / "scene.rrd")
    with api.sync_playwright() as play:
        try:
            found = seen(play, path, drawn)
        except api.Error as error:
            pytest.skip(f"no Chromium opens here: {error}".splitlines()[0])
    Image.fromarray(found).save(path.with_suffix(".png"))
    return found


def test_obstacles_their_ring_and_the_vehicle_are_seen(picture):
    assert drawn(picture)
    left = picture[:, : SIZE["width"] // 2]
    assert count(left, OBSTACLE) > 500
    assert count(left, INFLATED) > 500


def test_rates_speed_and_thrust_have_curves_of_their_own(picture):
    panels = np.array_split(picture[36:560, 5 * SIZE["width"] // 6 :], 4)
    coloured = [int((np.ptp(panel, axis=-1) > 60).sum()) for panel in panels]
    assert min(coloured[:3]) > 50
    assert count(panels[0], AXES[1]) > 20
