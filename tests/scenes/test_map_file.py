"""Maps out of files: each format tells of the same obstacles, and what is wrong is a sentence."""

import warnings

import numpy as np
import pytest
import torch
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from street import fly_street

from resc.build import build
from resc.errors import ConfigError
from resc.math.geometry import box_distance
from resc.planning.route import RoutePlanner
from resc.scenes.grid_map import GridMap
from resc.scenes.map_file import MapFile
from resc.scenes.turned import turned
from resc.viewing.episode_scene import load_scene
from resc.viewing.foxglove import write_scene
from resc.viewing.plot import draw

ROOM = np.array([[1, 0, 0, 1], [0, 0, 0, 0], [0, 0, 1, 1]], bool)
"""The greatest y first."""
CELL_M, CORNER_M = 0.5, (-1.0, 2.0)
BLACK_ON_WHITE = np.where(ROOM, 0, 254)
ENDS = {"start_m": [-0.75, 2.25, 1.0], "goal_m": [0.25, 3.25, 1.0]}
YAML = {
    "image": "room.pgm",
    "resolution": 0.5,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
PLANNER = {"max_expansions": 100_000, "spacing_m": (1.0, 2.0), "nominal_m": 1.5}


@pytest.fixture
def stored(tmp_path):
    """`stored(pixels, **changes)`: a map_server map as its YAML file."""

    def store(pixels=BLACK_ON_WHITE, suffix="pgm", **changes):
        Image.fromarray(np.asarray(pixels, np.uint8)).save(tmp_path / f"room.{suffix}")
        values = YAML | {"image": f"room.{suffix}"} | changes
        lines = [f"{name}: {value}" for name, value in values.items() if value is not None]
        (tmp_path / "room.yaml").write_text("\n".join(lines) + "\n")
        return tmp_path / "room.yaml"

    return store


@pytest.fixture
def cloud(tmp_path):
    """`cloud(suffix)`: points of the room at two heights, one of them not a number."""

    def points_of():
        row, column = np.nonzero(ROOM[::-1])
        x, y = (CORNER_M[0] + 0.5 * column + 0.3, CORNER_M[1] + 0.5 * row + 0.1)
        wall = np.stack((x, y, np.full(len(x), 1.0)), 1)
        floor = np.array([(-0.9, 2.1, 0.0), (0.9, 3.4, 0.0), (-0.1, 2.6, 3.0)])
        return np.concatenate((wall, floor, np.full((1, 3), np.nan))).astype(np.float32)

    def store(suffix, points=None):
        points = points_of() if points is None else np.asarray(points, np.float32)
        path = tmp_path / f"room.{suffix}"
        if suffix == "pcd":
            pypcd4 = pytest.importorskip("pypcd4")
            with warnings.catch_warnings():  # its writer leaves the file open
                warnings.simplefilter("ignore")
                pypcd4.PointCloud.from_xyz_points(points).save(path)
        else:
            trimesh = pytest.importorskip("trimesh")
            path.write_bytes(trimesh.PointCloud(points).export(file_type="ply"))
        return path

    return store


def scene_of(path, **settings):
    return MapFile(file=str(path), **ENDS | settings)


def _nearest(points, grid):
    boxes = torch.tensor(grid.boxes(), dtype=torch.float64)
    return box_distance(torch.tensor(points), boxes.expand(len(points), -1, -1)).amin(1)


def assert_is_the_room(scene):
    np.testing.assert_array_equal(scene.grid.occupied, ROOM[::-1])
    assert scene.boxes.tolist() == [
        [0.0, 2.0, 1.0, 0.5],
        [-1.0, 3.0, 0.5, 0.5],
        [0.5, 3.0, 0.5, 0.5],
    ]
    assert scene.origin_m.tolist() == list(CORNER_M)
    assert scene.size_m.tolist() == [2.0, 1.5]


@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_an_image_with_its_yaml_is_the_room(stored, suffix):
    assert_is_the_room(scene_of(stored(suffix=suffix)))


def test_an_npz_file_is_the_room(tmp_path):
    np.savez(tmp_path / "room.npz", occupied=ROOM, cell_m=CELL_M, corner_m=CORNER_M)
    assert_is_the_room(scene_of(tmp_path / "room.npz"))


@pytest.mark.parametrize("suffix", ["pcd", "ply"])
def test_a_point_cloud_at_flight_height_is_the_room(cloud, suffix):
    assert_is_the_room(scene_of(cloud(suffix), cell_m=0.5, height_m=[0.5, 1.5]))


def test_negate_swaps_black_and_white(stored):
    assert_is_the_room(scene_of(stored(np.where(ROOM, 254, 0), negate=1)))


def test_unknown_cells_are_occupied_unless_set_free(stored):
    path = stored(np.where(ROOM, 0, np.array([254, 254, 254, 205])))
    assert scene_of(path).grid.occupied[1].tolist() == [False, False, False, True]
    assert_is_the_room(scene_of(path, unknown="free"))


def test_thresholds_of_the_command_win(stored):
    path = stored(np.where(ROOM, 100, 254))  # occupied with a probability of 0.61
    assert_is_the_room(scene_of(path, unknown="free", occupied_thresh=0.6))
    assert not scene_of(path, unknown="free").grid.occupied.any()


def test_scale_and_raw_count_cells_by_their_value(stored):
    path = stored(np.where(ROOM, 140, 254))  # 0.45, and 56 % of the way from 0.196 to 0.65
    path.write_text(path.read_text() + "mode: scale\n")
    assert_is_the_room(scene_of(path))
    assert not scene_of(path, occupied_at=60.0).grid.occupied.any()
    path = stored(np.where(ROOM, 70, 0))
    path.write_text(path.read_text() + "mode: raw\n")
    assert_is_the_room(scene_of(path))
    assert not scene_of(path, occupied_at=80.0).grid.occupied.any()


def test_what_is_not_opaque_is_unknown(stored):
    pixels = np.full((*ROOM.shape, 4), 254)
    pixels[..., 3] = np.where(ROOM, 0, 255)
    path = stored(pixels, suffix="png")
    assert_is_the_room(scene_of(path))
    assert not scene_of(path, unknown="free").grid.occupied.any()


@pytest.mark.parametrize("yaw", [0.3, -1.0, 2.2])
def test_a_turned_map_keeps_its_obstacles_and_gains_less_than_two_cells(yaw):
    occupied = np.random.default_rng(0).random((12, 9)) < 0.1
    grid = GridMap(occupied, 0.5, (1.0, -2.0))
    points = np.random.default_rng(1).uniform(0, (4.5, 6.0), (3000, 2))
    c, s = np.cos(yaw), np.sin(yaw)
    there = points @ np.array([[c, s], [-s, c]]) + (1.0, -2.0)
    before = _nearest(points, GridMap(occupied, 0.5, (0.0, 0.0)))
    after = _nearest(there, turned(grid, yaw, outside=False))
    assert (after[before <= 0] <= 1e-6).all()
    assert (before[after <= 0] < 1.5 * 0.5).all()


def test_a_quarter_turn_is_exact(stored):
    scene = scene_of(
        stored(origin=[-1.0, 2.0, float(np.pi / 2)]),
        start_m=[-1.25, 2.25, 1.0],
        goal_m=[-2.25, 3.25, 1.0],
    )
    np.testing.assert_array_equal(scene.grid.occupied[::-1], np.rot90(ROOM))
    torch.testing.assert_close(scene.origin_m, torch.tensor([-2.5, 2.0]))


def test_beyond_a_turned_map_is_unknown(stored):
    path = stored(np.full((40, 40), 254), origin=[-1.0, 2.0, 0.5])
    inside = {"start_m": [-1.0, 14.0, 1.0], "goal_m": [1.0, 14.0, 1.0]}
    assert scene_of(path, **inside).grid.occupied[0, 0]
    assert not scene_of(path, unknown="free", **inside).grid.occupied.any()


def test_the_route_through_the_office_keeps_its_clearance(load_part):
    scene = build(load_part("scene", "occupancy"), "scene")
    planner = RoutePlanner(clearance_m=0.4, resolution_m=0.1, **PLANNER)
    layout = planner(scene.sample(3, torch.Generator().manual_seed(0)))
    assert (layout.route_length > 4).all()
    for path in planner.paths:
        points = torch.tensor(path.points_m, dtype=torch.float32)
        share = torch.linspace(0, 1, 50)[:, None, None]
        along = (points[:-1] + share * points.diff(dim=0)).reshape(-1, 2)
        away = box_distance(along, scene.boxes.expand(len(along), -1, -1)).amin()
        assert away > 0.4 - 0.1


def test_a_flight_in_a_map_is_recorded_and_drawn_as_among_boxes(compose, load_part, tmp_path):
    scene = build(load_part("scene", "occupancy"), "scene")
    planner = RoutePlanner(clearance_m=0.4, resolution_m=0.1, **PLANNER)
    layout = planner(scene.sample(2, torch.Generator().manual_seed(0)))
    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    log = fly_street(config, tmp_path / "rollouts", layout)
    torch.testing.assert_close(load_scene(log, 1).place.boxes, scene.boxes)
    drawn = write_scene(log, 1, tmp_path / "scene.mcap")
    with drawn.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        shown = [
            message
            for *_, message in reader.iter_decoded_messages(topics=["/world/obstacles"])
            for _ in message.entities[0].cubes
        ]
    assert len(shown) == len(scene.boxes)
    draw(log, 1, tmp_path / "episode.png")
    assert (tmp_path / "episode.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        ({"image": "nowhere.pgm"}, "names the image 'nowhere.pgm', and there is no file"),
        ({"resolution": None}, "lacks 'resolution'"),
        ({"resolution": 0.0}, "cells of .* are 0 m wide"),
        ({"resolution": ".nan"}, "resolution in .* is nan; expected a finite number"),
        ({"resolution": "wide"}, "resolution in .* is 'wide'"),
        ({"origin": [0.0, 0.0]}, r"origin in .* is \[0.0, 0.0\]; expected \[x, y, yaw\]"),
        ({"origin": "[0.0, .nan, 0.0]"}, "origin in .* is nan"),
        ({"origin": "[0.0, 0.0, .inf]"}, "origin in .* is inf"),
        ({"negate": 2}, "negate in .* is 2; expected 0 or 1"),
        ({"occupied_thresh": 65}, "occupied_thresh in .* is 65; expected a number from 0 to 1"),
        ({"free_thresh": 0.7}, "free_thresh of .* is 0.7 and occupied_thresh 0.65"),
        ({"occupied_thresh": None}, "lacks 'occupied_thresh'"),
    ],
)
def test_a_wrong_yaml_is_one_sentence(stored, changes, answer):
    with pytest.raises(ConfigError, match=answer):
        scene_of(stored(**changes))


@pytest.mark.parametrize(
    ("settings", "answer"),
    [
        ({"start_m": [-0.75, 3.25, 1.0]}, "start_m is .* inside an occupied cell"),
        ({"goal_m": [0.25, 2.25, 1.0]}, "goal_m is .* inside an occupied cell"),
        ({"room_m": 0.6}, "goal_m is .*, 0.25 m from an occupied cell, nearer than room_m, 0.6 m"),
        ({"start_m": [5.0, 2.25, 1.0]}, "start_m is .* outside the map"),
        ({"cell_m": 0.1}, "cell_m is 0.1, but the map .* has no use for it"),
        ({"height_m": [0.0, 1.0]}, "height_m is .*, but the map .* has no use for it"),
        ({"free_thresh": 0.7}, "free_thresh of .* is 0.7"),
    ],
)
def test_a_wrong_setting_is_one_sentence(stored, settings, answer):
    with pytest.raises(ConfigError, match=answer):
        scene_of(stored(), **settings)


def test_a_wrong_mode_is_one_sentence(stored):
    for mode, negate, answer in (("fuzzy", 0, "mode in .* is 'fuzzy'"), ("raw", 1, "negate: 1")):
        path = stored(negate=negate)
        path.write_text(path.read_text() + f"mode: {mode}\n")
        with pytest.raises(ConfigError, match=answer):
            scene_of(path)


def test_a_map_without_a_free_cell_is_one_sentence(stored):
    with pytest.raises(ConfigError, match=r"All 12 cells of .* are occupied"):
        scene_of(stored(np.zeros((3, 4))))


def test_an_image_is_pointed_to_its_yaml(stored):
    path = stored()
    with pytest.raises(ConfigError, match=r"an image, which does not say .*; name .*room.yaml"):
        scene_of(path.with_suffix(".pgm"))
    path.unlink()
    with pytest.raises(ConfigError, match="give it a YAML file"):
        scene_of(path.with_suffix(".pgm"))


def test_damaged_files_are_one_sentence(stored, tmp_path):
    path = stored()
    image = path.with_suffix(".pgm")
    image.write_bytes(image.read_bytes()[:-3])  # smaller than its header says
    with pytest.raises(ConfigError, match="cannot be read as an image"):
        scene_of(path)
    image.write_bytes(b"P5 4 3")
    with pytest.raises(ConfigError, match="cannot be read as an image"):
        scene_of(path)
    image.write_bytes(b"P5 900000 900000 255\n")
    with pytest.raises(ConfigError, match=r"more than 25000000|cannot be read"):
        scene_of(path)
    Image.fromarray(np.zeros((3, 4), np.uint16)).save(path.with_suffix(".png"))
    path.write_text(path.read_text().replace("pgm", "png"))
    with pytest.raises(ConfigError, match="more than 8 bits per pixel"):
        scene_of(path)
    for text, answer in (("a: [", "cannot be read as YAML"), ("5", "is no map")):
        path.write_text(text)
        with pytest.raises(ConfigError, match=answer):
            scene_of(path)
    for suffix in ("npz", "pcd", "ply"):
        damaged = tmp_path / f"damaged.{suffix}"
        damaged.write_bytes(b"nothing")
        settings = {} if suffix == "npz" else {"cell_m": 0.5, "height_m": [0.0, 1.0]}
        with pytest.raises(ConfigError, match="cannot be read as"):
            scene_of(damaged, **settings)
    for name, answer in (("nowhere.yaml", "no such file"), ("", "no such file")):
        with pytest.raises(ConfigError, match=answer):
            scene_of(name)
    (tmp_path / "map.txt").write_text("##")
    with pytest.raises(ConfigError, match="expected a map of the kinds"):
        scene_of(tmp_path / "map.txt")


@pytest.mark.parametrize(
    ("arrays", "answer"),
    [
        ({"occupied": np.full((2, 2), np.nan)}, "expected Booleans"),
        ({"occupied": np.zeros(3)}, "expected Booleans"),
        ({"occupied": np.zeros((0, 3))}, "expected Booleans"),
        ({"occupied": None}, "lacks the array 'occupied'"),
        ({"cell_m": np.nan}, "cell_m of .* is nan"),
        ({"cell_m": -1.0}, "are -1 m wide"),
        ({"corner_m": (0.0,)}, "corner_m of .* expected 2 numbers"),
    ],
)
def test_a_wrong_npz_file_is_one_sentence(arrays, answer, tmp_path):
    whole = {"occupied": ROOM, "cell_m": CELL_M, "corner_m": CORNER_M} | arrays
    given = {name: value for name, value in whole.items() if value is not None}
    np.savez(tmp_path / "room.npz", **given)
    with pytest.raises(ConfigError, match=answer):
        scene_of(tmp_path / "room.npz")


@pytest.mark.parametrize(
    ("settings", "points", "answer"),
    [
        ({"cell_m": None}, None, "cell_m is missing"),
        ({"height_m": None}, None, "height_m is missing"),
        ({"height_m": [1.0, 0.0]}, None, r"height_m is \[1.0, 0.0\]; expected"),
        ({"height_m": [5.0, 6.0]}, None, "no point from 5 to 6 m high, but from 0 to 3 m"),
        ({"free_thresh": 0.1}, None, "free_thresh is 0.1, but the point cloud .* has no use"),
        ({}, np.full((2, 3), np.nan), "not a single point that is finite"),
        ({"cell_m": 1e-5}, None, "more than 25000000"),
        ({}, [(0.0, 0.0, 1.0)], "All 1 cells of .* are occupied"),
    ],
)
@pytest.mark.parametrize("suffix", ["pcd", "ply"])
def test_a_wrong_cloud_is_one_sentence(cloud, settings, points, answer, suffix):
    with pytest.raises(ConfigError, match=answer):
        scene_of(cloud(suffix, points), **{"cell_m": 0.5, "height_m": [0.5, 1.5]} | settings)


def test_a_mesh_is_no_cloud(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box().export(tmp_path / "box.ply")
    with pytest.raises(ConfigError, match="is a trimesh; expected points alone"):
        scene_of(tmp_path / "box.ply", cell_m=0.5, height_m=[0.0, 1.0])
