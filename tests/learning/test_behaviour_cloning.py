"""The example that learns from recorded flights: its command line, in this process."""

import sys

import pytest
from omegaconf import OmegaConf
from street import fly_street

from examples import behaviour_cloning
from resc.log_command import main as resc_log
from resc.policies.stored import load_policy
from resc.recording.indexing import open_source
from resc.recording.segment import FileHead, Segment

SMALL = ("obstacle_observation=none", "model.hidden=[8]", "evaluation_episodes=2", "pool_size=2",
         "termination.time_limit.limit_s=0.2")  # fmt: skip


@pytest.fixture(scope="module")
def teacher(compose, tmp_path_factory):
    """Two flights that count as successes."""
    config = compose("num_envs=2", "recorder=mcap", "task=from_rest")
    folder = tmp_path_factory.mktemp("teacher")
    fly_street(config, folder)
    return rewritten(folder / "rollouts_00000.mcap", tmp_path_factory.mktemp("success"))


def rewritten(path, folder, change=None):
    """The recording with a changed configuration, and with every flight a success."""
    source = open_source(path)
    config = OmegaConf.create(source.attachments()["config.yaml"].decode())
    if change is not None:
        change(config)
    attachments = {"config.yaml": OmegaConf.to_yaml(config).encode()}
    target = folder / "rollouts_00000.mcap"
    segment = Segment(target, FileHead(source.specification, source.metadata, attachments), "zstd")
    for topic in source.topics:
        for chunk in source.chunks_of(topic):
            found = source.messages_in(chunk, topic)
            segment.append(topic, [(t, n, flown(topic, data)) for t, n, _, data in found], 0)
    segment.finish()
    return target


def flown(topic, data):
    """An episode's flag of success is the byte before its outcome."""
    if topic != "/episodes":
        return data
    from resc.recording.wire import fixed_fields

    size = fixed_fields("/episodes", 0).dtype.itemsize
    return data[: size - 1] + b"\1" + data[size:]


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Runs the example: its exit code or sentence, and what it printed."""
    import hydra.core.global_hydra

    def ran(*arguments):
        hydra.core.global_hydra.GlobalHydra.instance().clear()
        monkeypatch.setattr(sys, "argv", ["behaviour_cloning.py", *map(str, arguments)])
        monkeypatch.chdir(tmp_path)
        try:
            behaviour_cloning.main()
        except SystemExit as ended:
            return ended.code, capsys.readouterr().err
        return 0, capsys.readouterr().out

    saved = hydra.core.global_hydra.GlobalHydra.instance().hydra
    yield ran
    hydra.core.global_hydra.GlobalHydra.instance().hydra = saved


def test_a_policy_is_learned_and_flown(teacher, run, tmp_path):
    code, out = run(teacher, *SMALL, "--updates", 3, "--batch", 8, "--out", "own/policy")
    assert code == 0, out
    assert "after cloning 2 episodes" in out
    load_policy(tmp_path / "own" / "policy")
    code, _ = run(teacher, *SMALL, "--updates", 3, "--batch", 8, "--out", "own/policy")
    assert "own/policy holds a policy; give another folder with --out" in code


@pytest.mark.slow
@pytest.mark.parametrize(("command", "name"), [("lerobot", "lerobot"), ("minari", "flights-v0")])
def test_a_policy_is_learned_from_a_dataset(command, name, teacher, run, tmp_path):
    pytest.importorskip("minari" if command == "minari" else "pandas")
    dataset = tmp_path / name
    with pytest.raises(SystemExit) as ended:
        resc_log([command, str(teacher), "--out", str(dataset)])
    assert ended.value.code == 0
    learn = ("--episodes", 1, "--updates", 3, "--batch", 8, "--out", "own")
    held_out = ("model.hidden=[8]", "evaluation_episodes=2", "pool_size=2")
    limit = "termination.time_limit.limit_s=0.2"
    code, out = run(dataset, *held_out, limit, *learn)
    assert code == 0, out
    assert "after cloning 1 episodes" in out
    code, _ = run(dataset, *held_out, "obstacle_observation=ray_guiding", *learn[:-1], "other")
    assert "holds observations of another configuration: no ray_sampling" in code


@pytest.mark.slow
def test_parts_of_ones_own_package_are_flown_only_if_allowed(teacher, run, tmp_path, monkeypatch):
    (tmp_path / "own_cloned.py").write_text(
        "from resc.simulation.vehicle import Vehicle\n\n\nclass Own(Vehicle):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def own(config):
        config["vehicle"]["_target_"] = "own_cloned.Own"
        config["allowed_targets"] = ["own_cloned."]  # a recording cannot opt in for its reader

    folder = tmp_path / "own"
    folder.mkdir()
    path = rewritten(teacher, folder, own)
    common = (path, *SMALL, "--updates", 2, "--batch", 8)
    code, _ = run(*common, "--out", "a")
    assert "vehicle._target_ is 'own_cloned.Own'" in code
    assert run(*common, "--out", "b", "--allow", "own_cloned.")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("nowhere",), 1, "No recording at nowhere"),
        (("text.mcap",), 1, "is not an MCAP file"),
        (("TEACHER", "--episodes", "-3"), 2, "'-3' is not a whole number from 1"),
        (("TEACHER", "--updates", "0"), 2, "'0' is not a whole number from 1"),
        (("TEACHER", "--batch", "9" * 30), 2, "is not a whole number from 1"),
        (("TEACHER", "--batch", "999999999"), 1, "more than the"),
        (("TEACHER", "--out", "/proc/nope"), 1, "/proc/nope cannot be written to"),
        (("TEACHER", "--out", "text.mcap"), 1, "text.mcap cannot be written to"),
        (("TEACHER", "modl=x"), 1, "modl"),
        (("TEACHER", "threads=-1"), 1, "threads is -1"),
        (("TEACHER", "seed=-1"), 1, "seed is -1"),
    ],
    ids=lambda value: " ".join(value)[:30] if isinstance(value, tuple) else None,
)
def test_wrong_arguments_end_in_a_sentence(arguments, code, sentence, teacher, run, tmp_path):
    (tmp_path / "text.mcap").write_text("hello")
    given = [str(teacher) if text == "TEACHER" else text for text in arguments]
    found, errors = run(given[0], *SMALL, *given[1:])
    told = found if isinstance(found, str) else errors
    assert (1 if isinstance(found, str) else found) == code
    assert sentence in told
    assert "Traceback" not in errors
