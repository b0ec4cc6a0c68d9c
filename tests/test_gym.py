"""docs/gymnasium.md: what `gymnasium.make` and `make_vec` make, pictures of it, and films."""

import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVideos
from matplotlib.colors import to_rgb
from numpy.testing import assert_array_equal as assert_same

import resc
from resc import keys
from resc.errors import ConfigError
from resc.viewing.colours import OBSTACLE, TRUE
from resc.viewing.top_view import EDGE_PX, TopView

ID = "resc/Flight-v0"
FREE = {"overrides": ["+experiment=obstacle_free"], "pool_size": 4}
DYING = {
    "overrides": [*FREE["overrides"], "termination.time_limit.limit_s=0.2"],
    "termination": ["time_limit"],
    "pool_size": 4,
    "render_mode": "rgb_array",
}
"""Every episode ends after ten steps, by the clock."""


def pixels(frame, colour):
    """How many are of a colour."""
    return int((frame == np.round(255 * np.array(to_rgb(colour)))).all(-1).sum())


# The observation has no bounds.
@pytest.mark.filterwarnings("ignore:.*Box observation space.*infinity")
def test_what_is_made_passes_the_environment_checker():
    env = gymnasium.make(ID, render_mode="rgb_array", **FREE)
    assert env.spec.id == ID
    check_env(env.unwrapped)


def test_keywords_and_overrides_are_those_of_make_env():
    settings = {"observation": ["velocity", "attitude"], "seed": 3, "device": torch.device("cpu")}
    first, _ = gymnasium.make_vec(ID, num_envs=2, **settings, **FREE).reset()
    same = ("+experiment=obstacle_free", "observation=[velocity,attitude]", "pool_size=4")
    env = resc.make_env(*same, num_envs=2, seed=3)
    assert_same(first, env.restart(torch.arange(2)))


def test_without_a_seed_no_two_fly_the_same_and_with_one_they_do():
    envs = [gymnasium.make_vec(ID, num_envs=1, **FREE) for _ in range(2)]
    assert (envs[0].reset()[0] != envs[1].reset()[0]).any()
    assert_same(*(each.reset(seed=1)[0] for each in envs))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"num_env": 3}, "num_env is not a setting: .* Did you mean 'num_envs'?"),
        ({"reward": ["progres"]}, "reward has no 'progres'. Did you mean 'progress'?"),
        ({"reward": {"time": 1}}, "reward is {'time': 1}; as a keyword, a setting is a text, a nu"),
        ({"overrides": "seed=1"}, r"overrides is 'seed=1'; give a list of texts, \['seed=1'\]"),
        ({"overrides": ["sed=1"]}, "train has no 'sed'. Did you mean 'seed'?"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'; there is 'rgb_array' alone"),
        ({"total_frames": 5}, "total_frames=5: this belongs to a training run and changes nothing"),
        (
            {"max_episode_steps": 5},
            "max_episode_steps is for gymnasium.make; .* set the time limit",
        ),
        ({"autoreset_mode": "same"}, "autoreset_mode is 'same'; expected one of NextStep, SameSte"),
    ],
)
def test_a_wrong_keyword_gets_one_sentence(settings, sentence):
    with pytest.raises(ConfigError, match=sentence):
        gymnasium.make_vec(ID, num_envs=2, **settings)


def test_one_environment_is_not_many():
    with pytest.raises(ConfigError, match=r"num_envs is 4; .* gymnasium.make_vec makes more"):
        gymnasium.make(ID, num_envs=4)


def test_a_frame_shows_obstacles_trail_and_vehicle_where_they_are(make_env):
    env = make_env("num_envs=2", "scene=paper1_map11", scenes=1)
    view = TopView(env)
    env.restart(torch.arange(2))
    view.look()
    before = view.frame(0)
    wide, high = env.pool.shared[keys.MAP_SIZE][0].tolist()
    assert max(before.shape[:2]) == EDGE_PX
    assert before.shape[0] / before.shape[1] == pytest.approx(high / wide, abs=0.01)
    assert pixels(before, OBSTACLE) > 1000
    for _ in range(30):
        env.advance(torch.zeros(2, 4))
        view.look()
    after = view.frame(0)
    assert pixels(after, TRUE) > pixels(before, TRUE)
    origin = env.pool.shared[keys.MAP_ORIGIN_W][0]
    x, y = (env.value_of(keys.POSITION_W)[0, :2] - origin).tolist()
    column, row = x / wide * after.shape[1], y / high * after.shape[0]
    here = after[-round(row) - 2 : -round(row) + 2, round(column) - 2 : round(column) + 2]
    assert pixels(here, TRUE) > 0
    env.restart(torch.tensor([0]))
    view.look()
    assert pixels(view.frame(0), TRUE) < pixels(view.frame(1), TRUE)


def test_movers_are_drawn_where_they_are_now(make_env):
    env = make_env("num_envs=1", "scene=dynamic", "sensing=predicted", scenes=1)
    view = TopView(env)
    env.restart(torch.arange(1))
    view.look()
    still = view.frame(0)
    assert_same(view.frame(0), still)
    env.tensors[keys.CLOCK] += 50
    assert (view.frame(0) != still).any()


def test_without_a_render_mode_nothing_is_drawn():
    env = gymnasium.make(ID, **FREE).unwrapped
    assert (env.render_mode, env.render()) == (None, None)
    assert gymnasium.make_vec(ID, num_envs=2, **FREE).render() is None


OF_MOVIEPY = pytest.mark.filterwarnings(
    *(f"ignore::{kind}Warning" for kind in ("Deprecation", "Syntax", "Resource"))
)


@OF_MOVIEPY
@pytest.mark.slow
def test_gymnasium_films_a_flight_and_a_batch(tmp_path):
    pytest.importorskip("moviepy", reason="the extra 'video' is not installed")
    env = RecordVideo(gymnasium.make(ID, **DYING), str(tmp_path / "one"))
    env.reset(seed=0)
    while not env.step(np.zeros(4, np.float32))[3]:
        pass
    env.close()
    envs = RecordVideos(gymnasium.make_vec(ID, num_envs=2, **DYING), str(tmp_path / "two"))
    envs.reset(seed=0)
    for _ in range(10):
        envs.step(np.zeros((2, 4), np.float32))
    envs.close()
    assert size_of(tmp_path / "one") == (480, 480, 11)
    assert size_of(tmp_path / "two") == (960, 480, 11)


def size_of(folder):
    """Width, height and number of frames of the only film."""
    from imageio_ffmpeg import count_frames_and_secs, read_frames

    (film,) = folder.glob("*.mp4")
    reading = read_frames(str(film))
    size = next(reading)["size"]
    reading.close()
    return (*size, count_frames_and_secs(str(film))[0])


@OF_MOVIEPY
@pytest.mark.slow
def test_the_page_runs_as_it_is_written(tmp_path, monkeypatch):
    pytest.importorskip("moviepy", reason="the extra 'video' is not installed")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[1] / "docs" / "gymnasium.md"
    names = {}
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL):
        exec(block, names)
    assert names["info"].keys() == {"outcome", "is_success"}
    assert [path.name for path in (tmp_path / "films").iterdir()] == ["rl-video-episode-0.mp4"]
