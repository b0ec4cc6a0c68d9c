"""How an episode began, and the scene it was flown in, found among several files."""

import numpy as np
import pytest
import torch
from test_recorder import recorder, rollout

from resc.errors import RecordingError
from resc.recording.beginnings import scenes_in_use, worlds_at_start
from resc.recording.indexing import open_source
from resc.recording.reader import RolloutLog


def boxes(*values):
    return torch.tensor(values)[:, None, None].expand(-1, 2, 4).clone()


def scene_in_use(sources, scene, step):
    found = scenes_in_use(sources, np.array([scene]), np.array([step]))
    return {name: values[0] for name, values in found.items()}


def world_at_start(sources, env_id, step):
    return worlds_at_start(sources, np.array([env_id]), np.array([step]))[0]


@pytest.fixture
def sources(tmp_path):
    """Four batches in several files; scene 1 is renewed after the first and the third."""
    with recorder(tmp_path, rotate_mb=0.001) as target:
        target.put_world({"entry": torch.arange(3), "boxes_w": boxes(0.0, 1.0, 2.0)}, 0)
        for number in range(4):
            step = number * 10
            starts = {
                "env_id": torch.tensor([0, 3]),
                "step": torch.tensor([step, step + 10]),
                "state.position_w": torch.full((2, 3), float(number)),
            }
            target.put(rollout(number), step, starts=starts)
            if number in (0, 2):
                renewed = {"entry": torch.tensor([1]), "boxes_w": boxes(10.0 + number)}
                target.put_world(renewed, step + 10)
    found = [open_source(path) for path in RolloutLog(tmp_path).files]
    assert len(found) > 4
    return found


@pytest.mark.parametrize(
    ("scene", "step", "expected"),
    [(0, 0, 0.0), (1, 9, 1.0), (1, 10, 10.0), (1, 29, 10.0), (1, 30, 12.0), (2, 39, 2.0)],
)
def test_a_scene_is_the_one_in_use_at_that_step(sources, scene, step, expected):
    found = scene_in_use(sources, scene, step)
    assert torch.equal(found["boxes_w"], torch.full((2, 4), expected))


def test_every_file_begins_with_all_scenes_as_they_were_then(sources):
    """Also a file whose first news are the scenes renewed after the batch that filled the last."""
    firsts = [RolloutLog(source.path).worlds[0] for source in sources]
    for step, first in firsts:
        renewed = 12.0 if step == 30 else 10.0 if step == 10 else 1.0
        assert torch.equal(first["entry"], torch.arange(3))
        assert first["boxes_w"][:, 0, 0].tolist() == [0.0, renewed, 2.0]
    assert {step for step, _ in firsts} == {0, 10, 30}


@pytest.mark.parametrize(
    ("env_id", "step", "expected"), [(0, 0, 0), (3, 10, 0), (0, 10, 1), (3, 40, 3)]
)
def test_a_start_is_found_in_its_batch_or_at_the_end_of_the_one_before(
    sources, env_id, step, expected
):
    world = world_at_start(sources, env_id, step)
    assert world["state", "position_w"].tolist() == [expected] * 3


def test_what_is_not_recorded_is_refused(sources):
    with pytest.raises(RecordingError, match="How environment 2 began its episode in step 10 is"):
        world_at_start(sources, 2, 10)
    with pytest.raises(RecordingError, match="Scene 7, in use in step 5, is not recorded"):
        scene_in_use(sources, 7, 5)
    with pytest.raises(RecordingError, match="Scene 0, in use in step 5, is not recorded"):
        scene_in_use(sources[-1:], 0, 5)


def test_several_come_in_the_order_asked_for(sources):
    scenes, steps = np.array([1, 2, 1, 1]), np.array([35, 0, 5, 12])
    found = scenes_in_use(sources, scenes, steps)["boxes_w"][:, 0, 0]
    assert found.tolist() == [12.0, 2.0, 1.0, 10.0]
    worlds = worlds_at_start(sources, np.array([3, 0, 3]), np.array([40, 20, 10]))
    assert worlds["state", "position_w"][:, 0].tolist() == [3.0, 2.0, 0.0]
