"""An exported policy: every file does what the policy does, and the card says what that means."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from forked import ROOT, forked
from omegaconf import OmegaConf
from torch import nn
from torch.testing import assert_close

from resc.build import build_terms
from resc.deployment.card import card_of
from resc.deployment.export import export, wanted_files
from resc.deployment.export_check import SOURCE, onnx_session, steps_of
from resc.deployment.exported import CARD, HEADER, ONNX, TORCH, PlainPolicy
from resc.envs.quadrotor import layout_of
from resc.errors import ConfigError, NumericalError
from resc.policies.heads import Deterministic, Gaussian, TanhGaussian
from resc.policies.networks import Gru, Mlp, RunningNormalization
from resc.policies.policy import Policy
from resc.policies.stored import StoredPolicy, load_policy
from resc.run_folder import ORIGIN, SUMMARY, json_of
from resc.setup import build_stages
from resc.term import Observation

CXX = os.environ.get("CXX") or shutil.which("g++")
STRICT = ("-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")
ALL, WITHOUT_ONNX = (ONNX, TORCH, HEADER), (TORCH, HEADER)
PLAIN = ("obstacle_observation=none", "reward=[progress]")
SHIPPED = sorted(path.parent for path in (ROOT / "policies").glob("*/policy.pt"))


@pytest.fixture(scope="module")
def made(compose):
    """`made(model, head, *overrides)`: a policy with random weights, its normalisation taught."""

    def make(model, head=None, *overrides):
        config = compose(*PLAIN, *overrides)
        layout = tuple(layout_of(build_stages(config)))
        width = sum(count for _, count in layout)
        torch.manual_seed(0)
        policy = Policy(model, head or Gaussian(4), width, gain=1.0).eval()
        if isinstance(policy.normalization, RunningNormalization):
            scale = torch.linspace(0.1, 30.0, width)
            policy.normalization.update(torch.randn(1000, width) * scale + scale)
        return StoredPolicy(policy, layout, config)

    return make


@pytest.fixture(scope="module")
def remembering(made, tmp_path_factory):
    """A policy that remembers, and the folder that it is exported to."""
    policy = made(Gru(width=24, hidden=[16], normalization="running"), TanhGaussian(4))
    folder = tmp_path_factory.mktemp("remembering")
    return policy, folder, export(policy, Path("runs/one"), folder, ALL)


@pytest.fixture(scope="module")
def plain(made, tmp_path_factory):
    """A policy without memory, of which files other than ONNX are exported."""
    policy = made(Mlp(hidden=[32, 32]), None, "observation.velocity.scale=0.5")
    folder = tmp_path_factory.mktemp("plain")
    export(policy, Path("runs/one"), folder, WITHOUT_ONNX)
    return policy, folder


@pytest.mark.slow
def test_a_policy_that_remembers_is_the_same_in_every_file(remembering):
    _, folder, found = remembering
    assert set(found) == {ONNX, TORCH, HEADER}
    assert max(found.values()) <= 1e-5
    assert {path.name for path in folder.iterdir()} == {ONNX, TORCH, HEADER, CARD}


@pytest.mark.parametrize(
    ("model", "head"),
    [
        (Mlp(hidden=[]), Gaussian(4)),
        (Mlp(hidden=[8], activation="elu", normalization="running"), Deterministic(4)),
        (Mlp(hidden=[8, 9], activation="relu"), TanhGaussian(4)),
        (Gru(width=8, hidden=[]), Gaussian(4)),
    ],
)
def test_all_models_and_heads_are_the_same_in_c_and_torch(made, model, head, tmp_path):
    found = export(made(model, head), Path("runs/one"), tmp_path, WITHOUT_ONNX)
    assert set(found) == {TORCH, HEADER}
    assert max(found.values()) <= 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("stored_in", SHIPPED, ids=lambda path: path.name)
def test_shipped_policies_are_exported(stored_in, tmp_path):
    found = export(load_policy(stored_in), stored_in, tmp_path, ALL)
    assert max(found.values()) <= 1e-5


@pytest.mark.slow
def test_onnx_takes_any_batch_in_float32_and_says_what_its_numbers_are(remembering):
    policy, folder, _ = remembering
    session = onnx_session(folder / ONNX)
    width = policy.policy.observation_width
    assert [(i.name, i.shape[1], i.type) for i in session.get_inputs()] == [
        ("observation", width, "tensor(float)"),
        ("state", 24, "tensor(float)"),
    ]
    assert [o.name for o in session.get_outputs()] == ["action", "next_state"]
    for batch in (1, 7):
        given = {"observation": np.ones((batch, width)), "state": np.zeros((batch, 24))}
        action, _ = session.run(None, {k: v.astype(np.float32) for k, v in given.items()})
        expected, _ = policy.policy.decide(torch.ones(batch, width))
        assert_close(torch.from_numpy(action), expected, atol=1e-5, rtol=0)
    facts = session.get_modelmeta().custom_metadata_map
    card = json.loads((folder / CARD).read_text())
    for name in ("observation", "action", "control_rate_hz", "training"):
        assert json.loads(facts[name]) == card[name]


@pytest.mark.slow
def test_onnx_is_of_the_newest_opset_that_torch_writes(remembering):
    onnx = pytest.importorskip("onnx")
    model = onnx.load(remembering[1] / ONNX)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 25)]
    assert "double" not in str(onnx.printer.to_text(model))


@pytest.mark.slow
def test_torch_export_holds_the_card_and_takes_any_batch(plain):
    policy, folder = plain
    facts = {CARD: ""}
    program = torch.export.load(folder / TORCH, extra_files=facts)
    assert json.loads(facts[CARD])["policy"] == "runs/one"
    observation = torch.randn(5, policy.policy.observation_width)
    assert_close(program.module()(observation), policy(observation))


def test_c_does_exactly_what_small_weights_say(made, tmp_path):
    policy = made(Mlp(hidden=[]))
    layer = policy.policy.network[0]
    with torch.no_grad():
        layer.weight.zero_()
        layer.weight[0, 2], layer.weight[1, 0] = 0.5, -2.0
        layer.bias.copy_(torch.tensor([0.25, 0.0, 9.0, -0.0]))
    export(policy, Path("runs/one"), tmp_path, [HEADER])
    step = steps_of(tmp_path, PlainPolicy(policy.policy))[HEADER]
    observation = torch.zeros(2, policy.policy.observation_width)
    observation[1, :3] = torch.tensor([0.125, 0.0, 1.0])
    assert step(observation, None)[0].tolist() == [[0.25, 0, 1, 0], [0.75, -0.25, 1, 0]]


def program_of(folder):
    """The example in C++, compiled on the header of a folder."""
    source = ROOT / "examples" / "cpp" / "fly_policy.cpp"
    assert len(source.read_text().splitlines()) <= 40
    program = folder / "fly_policy"
    subprocess.run(
        [CXX, "-std=c++11", *STRICT, f"-I{folder}", source, "-o", program], check=True, timeout=100
    )
    return program


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "remembering"])
def test_the_example_in_cpp_flies_as_the_policy_does(kind, request, tmp_path):
    policy, folder, *_ = request.getfixturevalue(kind)
    shutil.copy(folder / HEADER, tmp_path)
    flights = torch.randn(2, 5, policy.policy.observation_width)
    text = "\n\n".join(
        "\n".join(" ".join(f"{number:.9g}" for number in row) for row in flight.tolist())
        for flight in flights
    )
    done = subprocess.run(
        [program_of(tmp_path)], input=text, capture_output=True, text=True, check=True, timeout=100
    )
    told = torch.tensor([[float(n) for n in line.split()] for line in done.stdout.splitlines()])
    action, command = told.view(2, 5, 8).split(4, -1)
    state = None
    for number in range(5):
        expected, state = policy.policy.decide(flights[:, number], state)
        assert_close(action[:, number], expected, atol=1e-5, rtol=0)
    limits = torch.tensor([2.0944, 2.0944, 1.0472])
    assert_close(command[..., :3], action[..., :3] * limits)


@pytest.mark.slow
def test_the_header_is_c99_without_a_warning(remembering, tmp_path):
    (tmp_path / "act.c").write_text(SOURCE)
    command = [CXX, "-x", "c", "-std=c99", *STRICT, f"-I{remembering[1]}", "-fsyntax-only"]
    subprocess.run([*command, tmp_path / "act.c"], check=True, timeout=100)


def test_the_card_lists_the_numbers_in_order_with_units_frames_and_scales(made):
    overrides = ("observation.velocity.scale=0.5", "observation.velocity.clip=3", "env.history=2")
    policy = made(Mlp(hidden=[]), None, *overrides, "env.observation_frame=heading")
    stages = build_stages(policy.config)
    card = card_of(policy, stages, Path("runs/one"))
    numbers = card["observation"]["numbers"]
    assert [number["name"] for number in numbers] == stages.observation_columns
    assert [number["index"] for number in numbers] == list(range(policy.policy.observation_width))
    named = {number["name"]: number for number in numbers}
    assert named["velocity.y_1_ago"] == {
        "index": named["velocity.x"]["index"] + 4,
        "name": "velocity.y_1_ago",
        "unit": "m/s",
        "frame": "heading",
        "scale": 0.5,
        "clip": 3.0,
        "steps_ago": 1,
    }
    assert (named["body_rate.p"]["unit"], named["body_rate.p"]["frame"]) == ("rad/s", "body")
    assert (named["heights.to_ground"]["frame"], named["body_x.z"]["frame"]) == ("", "heading")
    assert card["control_rate_hz"] == 50.0
    assert card["training"]["seed"] == 0


def test_the_card_says_what_is_stored_of_the_training(made, tmp_path):
    policy = made(Mlp(hidden=[]))
    (tmp_path / "summary.json").write_text('{"success_rate": 0.9, "episodes": 10, "frames": 512}')
    (tmp_path / "origin.json").write_text('{"commit": "0123abc", "command": "python train.py"}')
    training = card_of(policy, build_stages(policy.config), tmp_path)["training"]
    assert (training["success_rate"], training["episodes"], training["frames"]) == (0.9, 10, 512)
    assert (training["commit"], training["command"]) == ("0123abc", "python train.py")
    assert training["collision_rate"] is None


def test_shipped_policies_are_stored_with_what_their_table_says():
    table = (ROOT / "policies" / "README.md").read_text().splitlines()
    rows = [line.strip("| ").split(" | ") for line in table if line.startswith("| `")]
    assert {row[0].strip("`") for row in rows} == {
        path.parent.name for path in (ROOT / "policies").glob("*/policy.pt")
    }
    for name, command, _, commit, frames, _, success in rows:
        folder = ROOT / "policies" / name.strip("`")
        origin, summary = (json_of(folder / file) for file in (ORIGIN, SUMMARY))
        assert command.startswith(f"`{origin['command']}`")
        assert commit == origin["commit"]
        assert frames == f"{summary['frames'] / 1e6:.1f} M"
        told = f"{100 * summary['success_rate']:.1f} % of {summary['episodes']:,}"
        assert success.startswith(told)


def test_the_action_commands_what_its_channels_say(compose):
    action = build_stages(compose(*PLAIN)).terms.action
    given = torch.tensor([[-1.0, 0.5, 1.0, 0.25]])
    queue, delay = torch.zeros(1, 4, 4), torch.zeros(1, 1)
    _, rates, thrust = action.compute(given, queue, delay)
    told = [c.offset + c.slope * a for c, a in zip(action.channels, given[0].tolist(), strict=True)]
    assert_close(torch.cat((rates, thrust), -1)[0], torch.tensor(told))
    assert [c.unit for c in action.channels] == ["rad/s", "rad/s", "rad/s", "N"]


def test_every_observation_tells_units_of_its_columns():
    files = (ROOT / "conf").glob("*observation/*.yaml")
    nodes = {path.stem: OmegaConf.load(path) for path in files if path.stem != "none"}
    for node in nodes.values():
        terms = {name: part for name, part in node.items() if name != "defaults"}
        for term in build_terms(terms, "observation", Observation):
            assert len(term.units) in (1, len(term.columns)), term.name
            assert all(term.units), term.name
            frames = term.frames("heading")
            assert len(frames) == len(term.columns)
            assert all(frames[column] == "heading" for pair in term.vectors for column in pair)


class Unknown(nn.Module):
    """A layer that is written in Python alone."""

    def forward(self, x):
        return x * x


def test_a_layer_without_a_form_in_c_is_named(made, tmp_path):
    policy = made(Mlp(hidden=[8]))
    policy.policy.network[1] = Unknown()
    with pytest.raises(ConfigError, match=r"is a Unknown, which has no form in C; leave policy.h"):
        export(policy, Path("runs/one"), tmp_path, [HEADER])
    assert export(policy, Path("runs/one"), tmp_path, [TORCH])[TORCH] <= 1e-5


def test_a_head_that_is_not_known_is_named(made, tmp_path):
    policy = made(Mlp(hidden=[8]))
    policy.policy.head.distribution = torch.distributions.Cauchy
    with pytest.raises(ConfigError, match="algorithm: the policy's Gaussian cannot be exported"):
        export(policy, Path("runs/one"), tmp_path, [TORCH])


def test_a_layer_that_cannot_be_traced_is_named(made, tmp_path):
    class Asking(nn.Module):
        def forward(self, x):
            return x if x.sum() > 0 else -x

    policy = made(Mlp(hidden=[8]))
    policy.policy.network[1] = Asking()
    with pytest.raises(ConfigError, match=r"model: torch.export cannot trace the policy"):
        export(policy, Path("runs/one"), tmp_path, [TORCH])


def test_an_action_that_does_not_say_what_it_commands_is_refused(made, tmp_path, monkeypatch):
    policy = made(Mlp(hidden=[8]))
    action = type(build_stages(policy.config).terms.action)
    monkeypatch.setattr(action, "channels", ())
    with pytest.raises(ConfigError, match="BodyRateThrust does not say what its 4 numbers command"):
        export(policy, Path("runs/one"), tmp_path, [TORCH])


def test_files_that_do_something_else_than_the_policy_are_not_left(policy, tmp_path):
    """The pilot decides by equations, so that its network is not what it does."""
    with pytest.raises(NumericalError, match=r"policy.h deviates from the policy by .* so nothing"):
        export(policy, Path("runs/one"), tmp_path, [HEADER])
    assert not list(tmp_path.iterdir())


def test_weights_that_are_not_finite_are_refused(made, tmp_path):
    policy = made(Mlp(hidden=[8]))
    with torch.no_grad():
        policy.policy.network[0].bias[3] = torch.nan
    with pytest.raises(NumericalError, match="runs/one holds numbers that are not finite"):
        export(policy, Path("runs/one"), tmp_path, [TORCH])


def test_files_are_named_by_what_there_is(monkeypatch):
    assert wanted_files(["h", "pt2"]) == [HEADER, TORCH]
    with pytest.raises(ConfigError, match=r"files has 'onx'. Did you mean 'onnx'\?"):
        wanted_files(["onx"])
    with pytest.raises(ConfigError, match="files is empty; give some of onnx, pt2, h"):
        wanted_files([])
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ConfigError, match=r"needs onnx, .* pip install -e '.\[export\]', or leave"):
        wanted_files(["onnx"])


def test_the_command_leaves_the_files_in_its_folder(tmp_path):
    module = ROOT / "resc" / "deployment" / "export.py"
    folder = tmp_path / "exported"
    given = ("policy=policies/free", "files=[pt2,h]", f"hydra.run.dir={folder}")
    code, out, errors = forked(module, given)
    assert (code, errors) == (0, "")
    assert {path.name for path in folder.iterdir()} == {TORCH, HEADER, CARD}
    assert out.splitlines()[-1] == f"files and card {folder}"
    card = json.loads((folder / CARD).read_text())
    assert card["policy"] == "policies/free"
    assert card["files"][HEADER]["largest_deviation"] <= 1e-5
