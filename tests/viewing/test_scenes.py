"""Scene files: what the documentation promises, decoded by stock readers."""

import errno
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from street import copy_of, fly_street

from resc import keys
from resc.envs.stages import SUCCESS
from resc.errors import ConfigError, RecordingError
from resc.scenes.layout import PARKED_M
from resc.sights import Shape
from resc.term import Observation
from resc.viewing import layouts
from resc.viewing.appearance import WALL_ALPHA
from resc.viewing.episode_scene import load_scene
from resc.viewing.foxglove import write_scene
from resc.viewing.layouts import DEFAULT

DT_NS = 20_000_000
LATER = ("pillars_w", "start_motion")
"""Arrays of scenes that older recordings lack."""
ON_EVERY_STEP = (
    ("/tf", "foxglove.FrameTransform"),
    ("/drone/pose", "foxglove.PoseInFrame"),
    ("/drone/points", "foxglove.PointCloud"),
    ("/state", "resc.State"),
    ("/command", "resc.Command"),
    ("/reward", "resc.Reward"),
    ("/observation/kgp_esdf", "foxglove.SceneUpdate"),
    ("/observation/kgp_esdf_points", "foxglove.PointCloud"),
    ("/observation/esdf_patch_points", "foxglove.PointCloud"),
)
ONCE = (
    ("/drone/body", "foxglove.SceneUpdate"),
    ("/world/obstacles", "foxglove.SceneUpdate"),
    ("/world/obstacle_points", "foxglove.PointCloud"),
    ("/map/esdf_slice", "foxglove.Grid"),
    ("/map/esdf_points", "foxglove.PointCloud"),
    ("/plan/path", "foxglove.PosesInFrame"),
)


@pytest.fixture(scope="module")
def log(compose, tmp_path_factory):
    """Two flights along the street, recorded."""
    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    return fly_street(config, tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def path(log, tmp_path_factory):
    return write_scene(log, 1, tmp_path_factory.mktemp("scenes") / "deep" / "scene.mcap")


@pytest.fixture(scope="module")
def messages(path):
    """`(topic, schema name, message record, decoded message)` of all, by the stock reader."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, schema.name, message, decoded)
            for schema, channel, message, decoded in reader.iter_decoded_messages()
        ]


def of_topic(messages, wanted):
    return [decoded for topic, _, _, decoded in messages if topic == wanted]


def test_topics_schemas_and_counts_are_the_documented_ones(log, messages):
    steps = len(log.episode(1))
    counts = Counter((topic, name) for topic, name, *_ in messages)
    passed = int(load_scene(log, 1).passed[-1])
    assert passed > 0
    expected = {
        **dict.fromkeys(ON_EVERY_STEP, steps),
        **dict.fromkeys(ONCE, 1),
        ("/drone/trail", "foxglove.PosesInFrame"): len({*range(0, steps, 5), steps - 1}),
        ("/plan/columns", "foxglove.SceneUpdate"): 1 + passed,
        ("/plan/control_points", "foxglove.PointCloud"): 1 + passed,
        ("/log", "foxglove.Log"): 2 + passed,
    }
    assert counts == expected


def test_every_topic_is_documented_with_its_schema(messages):
    text = (Path(__file__).parents[2] / "docs/scenes.md").read_text()
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("| `/")]
    documented = {(topic.strip(" `"), schema.strip()) for topic, schema in rows}
    found = {(topic.replace("kgp_esdf", "<name>"), schema) for topic, schema, *_ in messages}
    of_movers = {pair for pair in documented if pair[0].startswith("/world/mover")}
    assert len(of_movers) == 2  # this scene has none
    assert documented - of_movers == {pair for pair in found if "esdf_patch" not in pair[0]}


def test_times_count_from_the_beginning_and_agree_with_the_stamps(log, messages):
    steps = len(log.episode(1))
    times = [m.log_time for topic, _, m, _ in messages if topic == "/state"]
    assert times == [step * DT_NS for step in range(steps)]
    assert all(m.log_time == 0 for topic, _, m, _ in messages if (topic, _) in ONCE)
    for _, _, record, decoded in messages:
        assert record.publish_time == record.log_time
        stamps = [decoded] if hasattr(decoded, "timestamp") else getattr(decoded, "entities", [])
        for stamped in stamps:
            assert stamped.timestamp.ToNanoseconds() == record.log_time
    every = [record.log_time for _, _, record, _ in messages]
    assert every == sorted(every)
    assert every[-1] == steps * DT_NS  # the outcome


def test_body_moves_as_recorded(log, messages):
    flight = log.episode(1)
    for (x, y, z), (qw, qx, qy, qz), moved, pose in zip(
        flight[keys.POSITION_W].tolist(),
        flight[keys.ATTITUDE_WB].tolist(),
        of_topic(messages, "/tf"),
        of_topic(messages, "/drone/pose"),
        strict=True,
    ):
        assert (moved.parent_frame_id, moved.child_frame_id) == ("world", "drone")
        assert (moved.translation.x, moved.translation.y, moved.translation.z) == (x, y, z)
        q = moved.rotation
        assert (q.w, q.x, q.y, q.z) == (qw, qx, qy, qz)
        place, turn = pose.pose.position, pose.pose.orientation
        assert (place.x, place.y, place.z) == (x, y, z)
        assert (turn.w, turn.x, turn.y, turn.z) == (qw, qx, qy, qz)
    (body,) = of_topic(messages, "/drone/body")[0].entities
    assert (body.frame_id, body.frame_locked) == ("drone", True)
    assert body.lifetime.ToNanoseconds() == 0
    trail = of_topic(messages, "/drone/trail")[-1].poses
    assert len(trail) == len(flight)
    assert trail[-1].position.x == float(flight[keys.POSITION_W][-1, 0])


def test_curves_are_the_recorded_numbers_and_the_scaled_action(log, messages):
    flight = log.episode(1)
    state, command = of_topic(messages, "/state"), of_topic(messages, "/command")
    reward = of_topic(messages, "/reward")
    at = -1
    rate = flight[keys.BODY_RATE_B][at].tolist()
    assert [state[at].body_rate.x, state[at].body_rate.y, state[at].body_rate.z] == rate
    assert state[at].speed == pytest.approx(float(flight[keys.VELOCITY_W][at].norm()))
    # conf/action: 0.05 of 2.0944 rad/s; thrust 1.64 kg * 9.7946 * (1.04 / 2 * 1.4 + 0.3)
    assert command[at].body_rate.y == pytest.approx(0.05 * 2.0944)
    assert command[at].collective_thrust == pytest.approx(1.64 * 9.7946 * 1.028, rel=1e-5)
    assert command[at].action.q == pytest.approx(0.05)
    assert reward[at].total == float(flight[keys.REWARD][at])
    names = [field.name for field, _ in reward[at].terms.ListFields()]
    terms = [getattr(reward[at].terms, name) for name in names]
    assert set(names) <= set(DEFAULT[0])
    assert sum(terms) == pytest.approx(reward[at].total, abs=1e-4)
    assert reward[at].so_far == pytest.approx(log.episodes["return_"][1], rel=1e-5)


def test_obstacles_let_the_vehicle_and_its_ring_shine_through(messages):
    (obstacles,) = of_topic(messages, "/world/obstacles")[0].entities
    assert obstacles.cubes[0].color.a == pytest.approx(WALL_ALPHA, abs=0.5 / 255)
    (ring,) = of_topic(messages, "/drone/body")[0].entities[0].lines
    assert ring.scale_invariant
    radii = [np.hypot(point.x, point.y) for point in ring.points]
    assert radii == pytest.approx([0.3] * len(radii))


def test_obstacles_map_and_plan_are_those_of_the_scene(messages):
    (obstacles,) = of_topic(messages, "/world/obstacles")[0].entities
    (cube,) = obstacles.cubes  # the second box is parked: it does not exist
    assert (cube.pose.position.x, cube.pose.position.y) == pytest.approx((3.2, 1.0))
    assert (cube.size.x, cube.size.y, cube.size.z) == pytest.approx((0.4, 1.0, 2.0))
    (grid,) = of_topic(messages, "/map/esdf_slice")
    assert (grid.column_count, grid.cell_size.x, grid.row_stride) == (50, 0.1, 400)
    assert [field.name for field in grid.fields] == ["distance", "red", "green", "blue", "alpha"]
    cells = np.frombuffer(grid.data, "<f4").reshape(20, 50, 2)[..., 0]
    assert cells[10, 31] == 0.0
    assert cells[10, 20] == pytest.approx(1.0)  # from x = 2.05 to the cell of x = 3.05
    (points,) = of_topic(messages, "/world/obstacle_points")
    places = np.frombuffer(points.data, "<f4").reshape(-1, 5)[:, :3]
    assert places.min(0).tolist() == pytest.approx([3.0, 0.5, 0.0])
    assert places.max(0).tolist() == pytest.approx([3.4, 1.5, 2.0])
    (plan,) = of_topic(messages, "/plan/path")
    assert [pose.position.x for pose in plan.poses] == [1.0, 1.5, 2.0]
    columns = of_topic(messages, "/plan/columns")[0].entities[0].cylinders
    assert [(c.size.x, c.size.z) for c in columns] == [pytest.approx((1.0, 0.4))] * 2


def test_observation_is_seen_from_the_vehicle(log, messages):
    scene = load_scene(log, 1)
    step = len(scene) - 1
    shape = scene.sights["kgp_esdf"][0]
    drawn = of_topic(messages, "/observation/kgp_esdf")[step].entities[0]
    here = scene.column(keys.POSITION_W)[step].tolist()
    first = drawn.lines[0].points
    assert (first[0].x, first[0].y, first[0].z) == tuple(here)
    assert (first[1].x, first[1].y) == tuple(shape.places[step, 0].tolist())
    cloud = of_topic(messages, "/observation/esdf_patch_points")[step]
    rows = np.frombuffer(cloud.data, "<f4").reshape(9, 5)
    esdf = scene.place.esdf
    x, y = here[:2]
    assert rows[0, :2] == pytest.approx([x - 0.1, y + 0.1])
    assert rows[4, :2] == pytest.approx([x, y])
    assert rows[4, 3] == float(esdf[int(y / 0.1), int(x / 0.1)])


class Gate(Observation):
    """Of a package outside RESC: the way to the next control point, and how it is drawn."""

    reads = (keys.CONTROL_POINTS_W, keys.POSITION_W)
    columns = ("x", "y")

    def compute(self, points, position):
        return (points[:, 0] - position)[:, :2]

    def sights(self, numbers, pose):
        return [Shape("next gate", "arrow", "first", pose.at(numbers))]


def test_an_observation_of_another_package_that_draws_itself_is_in_the_scene(compose, tmp_path):
    gate = f"+observation.gate={{_target_:{__name__}.Gate}}"
    street = ("num_envs=2", "recorder=mcap", "task=from_rest")
    config = compose(*street, gate, f"allowed_targets=[{__name__}]")
    log = fly_street(config, tmp_path)
    path = write_scene(log, 0, tmp_path / "scene.mcap", allowed=[__name__])
    with path.open("rb") as file:
        topics = make_reader(file, decoder_factories=[DecoderFactory()])
        drawn = [m for *_, m in topics.iter_decoded_messages(["/observation/gate"])]
    line = drawn[0].entities[0].lines[0].points
    assert [(point.x, point.y) for point in line] == [(1.0, 1.0), (1.5, 1.0)]
    assert "gate" not in load_scene(log, 0).sights  # its package is not allowed


def test_log_tells_beginning_control_points_and_outcome(log, messages):
    told = of_topic(messages, "/log")
    assert told[0].message == "episode 1 begins: environment 1, scene 1, 2 control points"
    assert told[1].message == "control point 1 of 2 passed"
    away = log.episode(1)[keys.POSITION_W][1:, 0] - 1.5  # the first control point is at x = 1.5
    reached = 1 + int((away.abs() <= 0.5).nonzero()[0, 0])
    assert told[1].timestamp.ToNanoseconds() == reached * DT_NS
    outcome = log.episodes["outcome"][1]
    assert told[-1].message.startswith(f"{outcome} after ")
    assert told[-1].level == (2 if outcome == SUCCESS else 3)


def test_file_says_whose_flight_it_is_and_carries_its_layouts(log, path):
    with path.open("rb") as file:
        reader = make_reader(file)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        documents = {record.name: record.data for record in reader.iter_attachments()}
    assert metadata["resc.run"] == log.metadata
    assert metadata["resc.episode"]["index"] == "1"
    assert metadata["resc.episode"]["file"] == log.files[0].name
    assert metadata["resc.episode"]["outcome"] == log.episodes["outcome"][1]
    assert documents["config.yaml"] == log.attachments["config.yaml"]
    foxglove = json.loads(documents["foxglove_layout.json"])
    assert foxglove["version"] == 1
    lichtblick = json.loads(documents["lichtblick_layout.json"])
    assert set(lichtblick["configById"]) == {
        "3D!flight",
        "Plot!0",
        "Plot!1",
        "Plot!2",
        "Plot!3",
        "RosOut!log",
    }


def paths_in(layout):
    """Every message path that a layout plots, and every topic that it names."""
    text = json.dumps(layout)
    return {part for part in text.split('"') if part.startswith("/")}


@pytest.mark.parametrize("name", ["foxglove", "lichtblick"])
def test_layouts_name_only_what_the_scene_has(messages, path, name):
    with path.open("rb") as file:
        documents = {record.name: record.data for record in make_reader(file).iter_attachments()}
    topics = {topic for topic, *_ in messages}
    for named in paths_in(json.loads(documents[f"{name}_layout.json"])):
        topic, *fields = named.split(".")
        assert topic in topics, named
        value = of_topic(messages, topic)[0]
        for field in fields:
            value = getattr(value, field)
        assert not fields or isinstance(value, float), named


@pytest.mark.parametrize("name", ["foxglove", "lichtblick"])
def test_shipped_layout_is_up_to_date(name):
    shipped = (Path(layouts.__file__).parent / f"{name}.json").read_text()
    assert shipped == getattr(layouts, name)(*DEFAULT) + "\n"


def test_default_layout_is_for_the_default_training(compose):
    config = compose()
    assert tuple(config["reward"]) == DEFAULT[0]
    seen = {name.removesuffix("_points") for name in DEFAULT[1]}
    assert seen <= set(config["observation"])


def test_recording_without_scenes_is_refused_in_a_sentence(log, tmp_path):
    bare = copy_of(log, tmp_path / "bare", world={})
    with pytest.raises(RecordingError, match="Scene 0, in use in step 0, is not recorded"):
        write_scene(bare, 0, tmp_path / "scene.mcap")
    assert not (tmp_path / "scene.mcap").exists()


def test_recording_of_other_columns_is_refused_in_a_sentence(log, tmp_path):
    kept = tuple(column for column in log.columns if column.key != keys.BODY_RATE_B)
    few = copy_of(log, tmp_path / "few", columns=kept)
    with pytest.raises(RecordingError, match=r"holds no column state\.body_rate_b"):
        write_scene(few, 0, tmp_path / "scene.mcap")


def test_scan_is_drawn_without_the_noise_of_the_flight(log, load_part, tmp_path):
    config = log.config
    config["observation"] = load_part("obstacle_observation", "depth_scan")
    config["observation"]["depth_scan"]["beams"] = 3
    scene = load_scene(copy_of(log, tmp_path / "scan", config=config), 0)
    shapes = {shape.label: shape for shape in scene.sights["depth_scan"]}
    x = float(scene.column(keys.POSITION_W)[0, 0])
    # Straight on the way is free up to the box, whose surface begins at x = 3.
    reach = float(shapes["depths"].places[0, 1, 0]) - x
    assert 2.0 <= reach <= 2.1
    assert shapes["beams without a reading"].places.isnan().all()


def test_spherical_control_points_are_drawn_as_spheres(log, tmp_path):
    config = log.config
    config["task"]["control_points"].update({"half_height_m": None, "radius_m": 0.4})
    path = write_scene(copy_of(log, tmp_path / "run", config=config), 0, tmp_path / "s.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        first = next(iter(reader.iter_decoded_messages(topics=["/plan/columns"])))[3]
    sizes = [sphere.size.z for sphere in first.entities[0].spheres]
    assert sizes == [pytest.approx(0.8)] * 2
    assert not first.entities[0].cylinders


def test_scene_without_obstacles_is_a_scene(log, tmp_path):
    nowhere = torch.tensor([PARKED_M, PARKED_M, 0.0, 0.0]).expand(2, 2, 4)
    free = copy_of(log, tmp_path / "free", world={**log.world, "boxes_w": nowhere})
    with write_scene(free, 0, tmp_path / "scene.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {
            channel.topic: decoded for _, channel, _, decoded in reader.iter_decoded_messages()
        }
    assert not found["/world/obstacles"].entities[0].cubes
    assert found["/world/obstacle_points"].data == b""
    distances = np.frombuffer(found["/map/esdf_slice"].data, "<f4")[::2]
    assert (distances == 3.0).all()  # where the distance field ends


MOVERS = torch.tensor(
    [
        [2.5, 0.4, 0.0, 1.0, 0.25, 0.0, 2.5, 0.4, 2.5, 0.4],
        [4.0, 1.0, -2.0, 0.0, 0.2, 0.3, 4.0, 1.0, 4.0, 1.0],
        [PARKED_M, PARKED_M, *(0.0,) * 4, *(PARKED_M,) * 4],
    ]
)
"""One round, one a box, one that does not exist."""


def test_movers_are_drawn_where_they_are_in_each_step(log, tmp_path):
    world = {**log.world, "movers_w": MOVERS.expand(2, 3, 10)}
    run = copy_of(log, tmp_path / "run", world=world)
    found, clouds = [], []
    with write_scene(run, 0, tmp_path / "scene.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, decoded in reader.iter_decoded_messages():
            if channel.topic == "/world/movers":
                (entity,) = decoded.entities
                found.append((entity.cylinders[0].pose.position, entity.cubes[0]))
            if channel.topic == "/world/mover_points":
                places = np.frombuffer(decoded.data, np.uint8).reshape(-1, decoded.point_stride)
                clouds.append(places[:, :4].copy().view("<f4").max())
    assert [centre.y for centre, _ in found] == pytest.approx([0.4, 0.42, 0.44])
    assert [box.pose.position.x for _, box in found] == pytest.approx([4.0, 3.96, 3.92])
    assert (found[0][1].size.x, found[0][1].size.y) == pytest.approx((0.4, 0.6))
    assert clouds == pytest.approx([4.2, 4.16, 4.12])


def test_where_nothing_moves_there_is_no_topic_for_it(log, tmp_path):
    with write_scene(log, 0, tmp_path / "still.mcap").open("rb") as file:
        topics = {c.topic for c in make_reader(file).get_summary().channels.values()}
    assert not any("mover" in topic for topic in topics)


def test_pillars_are_cylinders_and_round_in_the_map(log, tmp_path):
    pillars = torch.tensor([[2.5, 0.4, 0.25], [PARKED_M, PARKED_M, 0.0]]).expand(2, 2, 3)
    run = copy_of(log, tmp_path / "run", world={**log.world, "pillars_w": pillars})
    with write_scene(run, 0, tmp_path / "scene.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {
            channel.topic: decoded for _, channel, _, decoded in reader.iter_decoded_messages()
        }
    (pillar,) = found["/world/obstacles"].entities[0].cylinders
    assert (pillar.size.x, pillar.size.y) == (0.5, 0.5)
    assert (pillar.pose.position.x, pillar.pose.position.y) == pytest.approx((2.5, 0.4))
    points = np.frombuffer(found["/world/obstacle_points"].data, np.uint8)
    places = points.reshape(-1, found["/world/obstacle_points"].point_stride)[:, :12].copy()
    x, y, _ = places.view("<f4").T
    reach = np.hypot(x - 2.5, y - 0.4)
    assert (reach <= 0.2501).sum() > 100
    distance = np.frombuffer(found["/map/esdf_slice"].data, "<f4")[::2].reshape(20, 50)
    assert distance[4, 24] == 0.0
    assert distance[1, 22] > 0.0  # the corner of the square about it


def test_recordings_from_before_there_were_pillars_are_drawn_as_ever(log, path, tmp_path):
    world = {key: value for key, value in log.world.items() if key not in LATER}
    assert len(world) == len(log.world) - len(LATER)
    old = load_scene(copy_of(log, tmp_path / "old", world=world), 0).place
    new = load_scene(log, 0).place
    assert torch.equal(old.esdf, new.esdf)
    assert torch.equal(old.boxes, new.boxes)
    assert len(old.pillars) == len(new.pillars) == 0


def test_config_that_names_a_foreign_class_needs_leave_to_build_it(log, tmp_path):
    config = log.config
    config["vehicle"]["_target_"] = "somewhere.Vehicle"
    foreign = copy_of(log, tmp_path / "foreign", config=config)
    with pytest.raises(ConfigError, match=r"vehicle\._target_ is 'somewhere\.Vehicle'"):
        write_scene(foreign, 0, tmp_path / "scene.mcap")


def test_disk_that_fills_up_leaves_no_half_of_a_scene(log, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = write_scene(log, 0, tmp_path / "scene.mcap")
    before = path.read_bytes()
    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(RecordingError, match=r"cannot be written \(No space left on device\)"):
        write_scene(log, 1, path)
    assert [file.name for file in tmp_path.iterdir()] == ["scene.mcap"]
    assert path.read_bytes() == before


def test_place_that_cannot_be_written_is_a_sentence(log, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match=r"cannot be written .*; choose another folder"):
        write_scene(log, 0, tmp_path / "file" / "scene.mcap")
