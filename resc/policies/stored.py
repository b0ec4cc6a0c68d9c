"""Small policy files: a trained policy with all that is needed to fly it.

They are data, loaded without running code.
"""

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any, cast

import torch
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from resc.build import ALLOWED, build, load_config, locate
from resc.command_line import command
from resc.envs.quadrotor import layout_of
from resc.envs.stages import Stages
from resc.errors import CallError, CheckpointError
from resc.places import HOME
from resc.policies.networks import IS_INIT, STATE, Model
from resc.policies.policy import Policy
from resc.run_folder import CHECKPOINT, CONFIG, LATEST, POLICY, latest, replacing
from resc.settings import fingerprint

Layout = tuple[tuple[str, int], ...]
ACTION_WIDTH = 4
"""Of policies stored before their files said it."""


class StoredPolicy(TensorDictModuleBase):
    """A trained policy with all that is needed to fly it.

    For observations it returns the mean action, clipped to [-1, 1]; in a TensorDict, as TorchRL's
    rollouts and collectors hand it on, it sets the action.

    Args:
        policy: From observations to actions, normalisation included.
        layout: Names and widths of the observation's blocks.
        config: The resolved configuration it was trained with: data, not code.
    """

    def __init__(self, policy: Policy, layout: Layout, config: DictConfig) -> None:
        super().__init__()
        self.in_keys = list(policy.in_keys)  # pyright: ignore[reportAttributeAccessIssue]
        kept = [("next", STATE)] if policy.state_width else []
        self.out_keys = ["action", *kept]  # pyright: ignore[reportAttributeAccessIssue]
        self.policy, self.layout, self.config = policy, layout, config

    @torch.no_grad()
    def forward(
        self, observation: Float[Tensor, "*n d"] | TensorDictBase
    ) -> Float[Tensor, "*n a"] | TensorDictBase:
        """The action [n, a] for observations [n, d], or the TensorDict with it.

        Raises:
            CallError: The policy remembers, and is not told what.
        """
        self._require_memory(observation)
        if not isinstance(observation, TensorDictBase):
            return self.policy.decide(observation)[0]
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            out = self.policy(observation.select(*self.in_keys))
        out["action"] = out["action"].clamp(-1, 1)
        return observation.update(out.select(*self.out_keys))

    def _require_memory(self, given: Tensor | TensorDictBase) -> None:
        """What a policy that remembers is given must say what it remembers."""
        if not self.policy.state_width:
            return
        if not isinstance(given, TensorDictBase):
            raise CallError(
                "This policy remembers, so an observation alone does not say what it does; call "
                "its policy.decide(observation, state), which returns the next state."
            )
        if STATE not in given:
            raise CallError(
                f"This policy remembers, but the TensorDict has no '{STATE}'; add it and "
                f"'{IS_INIT}' to the environment, as TorchRL's TensorDictPrimer and InitTracker do."
            )

    def require_layout(self, stages: Stages) -> None:
        """Raises CheckpointError, naming the first difference, if observations differ."""
        require_same_layout(self.layout, stages)


def require_same_layout(trained: Sequence[tuple[str, int]], stages: Stages) -> None:
    """Raises CheckpointError, naming the first difference, if observations are not those."""
    given = layout_of(stages)
    blocks = zip_longest(trained, given, fillvalue=("nothing", 0))
    for number, (ours, theirs) in enumerate(blocks):
        if ours != theirs:
            raise CheckpointError(
                f"The policy was trained on {ours[0]} ({ours[1]} numbers) as observation block "
                f"{number}, but the environment gives {theirs[0]} ({theirs[1]}); fly it with the "
                "observation of its own config.yaml."
            )


def save_policy(folder: Path, networks: nn.ModuleDict, stages: Stages, made_with: str) -> None:
    """Writes policy.pt (weights and layout) into a folder, for the config.yaml of its run there.

    `networks` are an algorithm's: `policy`, and whatever else it needs. `made_with` is the
    fingerprint of the configuration.
    """
    folder.mkdir(parents=True, exist_ok=True)
    head = type(cast(Policy, networks["policy"]).head)
    content = {
        "networks": {name: value.cpu().clone() for name, value in networks.state_dict().items()},
        "head": f"{head.__module__}.{head.__qualname__}",
        "layout": [list(block) for block in layout_of(stages)],
        "action_width": stages.terms.action.width,
        "made_with": made_with,
    }
    write_atomically(folder / POLICY, content)


def policy_folder(text: str, setting: str) -> Path:
    """The folder that `policy` or `init_from` names: `latest` is the last run that was trained.

    One that the working directory lacks may be RESC's own: policies/obstacles.
    """
    if text == LATEST:
        return latest(setting, "train")
    ours = HOME / text
    return ours if ours.exists() and not Path(text).exists() else Path(text)


def load_weights(folder: Path, networks: nn.ModuleDict, stages: Stages) -> list[str]:
    """Puts the weights of a stored policy, normalisation included, into an algorithm's networks.

    Loads its other networks, too, where the stored ones are the same. What the policy did not
    observe has weights of zero at first, so it flies as it did. Returns the names of the networks
    that keep their initial weights, and of the observations that are new or longer.

    Raises:
        CheckpointError: A file is missing, cut short or foreign, or it is of another observation
            or another policy.
    """
    if not (folder / POLICY).exists():
        raise CheckpointError(f"{folder} holds no {POLICY}; {_where_else(folder)}.")
    content = _in_todays_form(read(folder / POLICY, ("head", "layout")))
    trained = [(str(name), int(width)) for name, width in content["layout"]]
    columns = _columns(trained, stages)
    config = load_config(folder / CONFIG)
    frame = (config.get("env") or {}).get("observation_frame", "world")
    _require_same_input(folder, frame, config.get("observation") or {}, stages, dict(trained))
    afresh = [f"observation.{name}" for name, _ in {*layout_of(stages)} - {*trained}]
    for name, network in networks.items():
        try:
            stored, own = _part(content["networks"], name), network.state_dict()
            network.load_state_dict(_widened(stored, own, columns))
        except RuntimeError:
            if name != "policy":
                afresh.append(name)
                continue
            raise CheckpointError(
                f"The policy of {folder} has other networks than this run; give both the same: "
                f"there, model is {config.get('model')} and algorithm "
                f"{(config.get('algorithm') or {}).get('_target_')}."
            ) from None
    return afresh


def _columns(trained: Layout | list[tuple[str, int]], stages: Stages) -> list[int]:
    """Where the numbers that a policy was trained on stand among those of today.

    Steps of the past follow the newest, so a block with a longer one begins like a shorter one.

    Raises:
        CheckpointError: They are not all there.
    """
    first, begin = 0, {}
    for name, width in layout_of(stages):
        begin[name] = first, width
        first += width
    if any(begin.get(name, (0, 0))[1] < width for name, width in trained):
        require_same_layout(trained, stages)
    return [begin[name][0] + column for name, width in trained for column in range(width)]


def _widened(
    stored: Mapping[str, Tensor], own: Mapping[str, Tensor], columns: Sequence[int]
) -> dict[str, Tensor]:
    """Stored weights with zeros for what is observed in addition, where only that is missing."""
    found = dict(stored)
    for name, value in own.items():
        old = found.get(name)
        if old is None or old.shape == value.shape or not value.dim():
            continue
        if old.shape[:-1] == value.shape[:-1] and old.shape[-1:] == (len(columns),):
            wide = torch.zeros_like(value) if value.dim() > 1 else value.clone()
            wide[..., list(columns)] = old.to(wide)
            found[name] = wide
    return found


def _part(weights: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """The weights of one of several networks."""
    return {
        key.removeprefix(f"{name}."): value
        for key, value in weights.items()
        if key.startswith(f"{name}.")
    }


def _in_todays_form(content: dict[str, Any]) -> dict[str, Any]:
    """A policy file's content; older ones keep head, value function and normalisation apart."""
    if not isinstance(content["head"], Mapping):
        return content
    own, weights = content["head"], {}
    for name, value in own.items():
        place = "module.1.module." if name.startswith("body.") else "module.2.module."
        weights[f"policy.{place}{name.removeprefix('body.')}"] = value
    for name, value in content.get("normalization", {}).items():
        weights[f"policy.module.0.module.{name}"] = value
    for name, value in content.get("critic", {}).items():
        weights[f"value.{name.removeprefix('module.')}"] = value
    return {**content, "networks": weights, "head": "resc.policies.heads.Gaussian"}


def _require_same_input(
    folder: Path,
    frame: str,
    observation: Mapping[str, Any],
    stages: Stages,
    trained: Mapping[str, int],
) -> None:
    """The frame and the scales that the weights were trained with, as far as they are stored."""
    facts: dict[str, tuple[Any, Any]] = {
        "env.observation_frame": (frame, stages.context.observation_frame)
    }
    for term in (term for term in stages.terms.observations if term.name in trained):
        scale = (observation.get(term.name) or {}).get("scale", 1.0)
        facts[f"observation.{term.name}.scale"] = (scale, term.scale)
    for name, (trained, given) in facts.items():
        if trained != given:
            raise CheckpointError(
                f"The policy of {folder} was trained with {name}={trained}, but this run has "
                f"{given}; give it the same."
            )


def load_policy(
    folder: Path, device: torch.device | str = "cpu", allowed: Sequence[str] = ()
) -> StoredPolicy:
    """The policy of a run folder or of a shipped policy's folder.

    Targets outside resc are built if one of the prefixes `allowed` covers them.

    Raises:
        CheckpointError: A file is missing, cut short or foreign.
        ConfigError: The stored configuration asks for something that is not allowed.
    """
    folder = Path(folder)
    if not (folder / POLICY).exists():
        raise CheckpointError(
            f"{folder} holds no {POLICY}; {_where_else(folder)}, or policies/obstacles."
        )
    content = _in_todays_form(read(folder / POLICY, ("head", "layout")))
    config = load_config(folder / CONFIG)
    if "model" not in config:
        raise CheckpointError(f"{folder / CONFIG} lacks model; restore it from its run.")
    with fitting(folder / POLICY):
        layout = tuple((str(name), int(width)) for name, width in content["layout"])
        head = locate(content["head"], "head", (*ALLOWED, *allowed))
        policy = Policy(
            build(_model_of(config["model"]), "model", allowed=allowed, kind=Model),
            head(int(content.get("action_width", ACTION_WIDTH))),
            sum(width for _, width in layout),
        )
        policy.load_state_dict(_part(content["networks"], "policy"))
    require_same_run(content, fingerprint(config), folder / POLICY)
    return StoredPolicy(policy.to(device).eval(), layout, config)


def _model_of(model: Any) -> Any:  # noqa: ANN401 - a node of a configuration
    """The node of the model; older ones name the spread of actions, which is the algorithm's."""
    node = OmegaConf.to_container(model, resolve=True)
    if not isinstance(node, dict) or not str(node.get("_target_")).endswith(".build_networks"):
        return node
    return {name: value for name, value in node.items() if name != "initial_std"}


def _where_else(folder: Path) -> str:
    """Which folder to give instead of one that holds no policy."""
    if run := next(iter(sorted(folder.glob(f"[0-9]*/{POLICY}"))), None):
        return f"it is a sweep's: give one of its runs, such as {run.parent}"
    if not folder.exists():
        return "there is no such folder: give that of a finished run"
    if (folder / CONFIG).exists() and "total_frames" not in load_config(folder / CONFIG):
        return (
            "it is an evaluation's: give policy=latest for the last training, the folder of a run"
        )
    if (folder / CHECKPOINT).exists():
        again = command("train.py", {"resume": folder})
        return f"its training was killed: go on with {again}, or give the folder of another run"
    return "give the folder of a finished run"


@contextmanager
def fitting(path: Path) -> Iterator[None]:
    """Says of a file, whose content the program does not take, that it does not fit."""
    try:
        yield
    except (RuntimeError, KeyError, IndexError, ValueError, TypeError, AttributeError) as error:
        mismatch = "size mismatch" in str(error) or "state_dict" in str(error)
        reason = "its networks are others" if mismatch else _first_line(error)
        raise CheckpointError(
            f"{path} does not fit {CONFIG} beside it ({reason}); restore both from one run."
        ) from None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]


def require_same_run(content: Mapping[str, Any], made_with: str, path: Path) -> None:
    """Refuses weights of another run; older files do not say whose they are."""
    if content.get("made_with") and made_with and content["made_with"] != made_with:
        raise CheckpointError(
            f"{path} belongs to a run with other settings than {CONFIG} beside it; restore "
            "both from one run."
        )


def write_atomically(path: Path, content: Mapping[str, Any]) -> None:
    """Writes a torch file so that a crash leaves the old one or the new one, never half of one."""
    buffer = io.BytesIO()
    torch.save(dict(content), buffer)
    with (
        replacing(path, CheckpointError, "make room, then go on") as part,
        part.open("wb") as file,
    ):
        file.write(buffer.getbuffer())
        file.flush()
        os.fsync(file.fileno())


def read(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """A torch file's content, read as data only."""
    if not path.exists():
        raise CheckpointError(f"{path} does not exist; give the folder of an interrupted run.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # foreign bytes make the unpickler raise anything
        raise CheckpointError(
            f"{path} cannot be read ({_first_line(error)}); it is cut short, not a RESC file, or "
            "holds code."
        ) from None
    if not isinstance(content, dict) or any(name not in content for name in names):
        raise CheckpointError(f"{path} lacks {', '.join(names)}; it was not written by RESC.")
    return content
