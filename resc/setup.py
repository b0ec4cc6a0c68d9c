"""What episodes are flown in, from a run's configuration: built once, and passed on."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from resc import keys
from resc.build import build, build_term, build_terms, plain, resolved, without_difficulty
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.stages import Stages
from resc.envs.terms import Terms
from resc.errors import ConfigError
from resc.groups import GROUPS, TASK, Group
from resc.maps.cells import require_room
from resc.math.sampling import generator_for
from resc.planning.route import RoutePlanner, planner_for
from resc.quantities import NotNegative, checked
from resc.scenes.laid_out import LaidOut
from resc.scenes.layout import PARKED_M, Layout, Scene
from resc.scenes.pool import ScenePool
from resc.term import Curriculum, Device, Observation, Term

CRITIC = "observation_critic"
"""First part of the keys of what the value function alone sees."""
PROBED = 32
"""Scenes laid out to look at, before a whole pool is."""


@dataclass(frozen=True)
class Setup:
    """What episodes are flown in.

    Args:
        stages: The step and the reset.
        pool: The scenes that episodes begin in.
        planner: Plans the routes of scenes that only know their goal; None without a search.
    """

    stages: Stages
    pool: ScenePool
    planner: RoutePlanner | None = None

    def __post_init__(self) -> None:
        """Refuses movers that nothing shows to the policy."""
        terms = self.stages.terms
        shown = terms.sensing or any(keys.MOVERS_W in term.reads for term in terms.observations)
        if self.pool.shared[keys.MOVERS_W].shape[1] and not shown:
            raise ConfigError(
                "scene.movers are obstacles that move, but without a sensing the policy sees a map "
                "on which they are not; choose sensing=predicted, local, depth or lidar2d, or add "
                "nearest_movers to observation."
            )

    def env(self, num_envs: int, **options: Any) -> QuadrotorEnv:
        """An environment of so many rows; the options are those of `QuadrotorEnv`."""
        device = self.pool.shared[keys.ESDF].device
        return QuadrotorEnv(self.stages, self.pool, num_envs=num_envs, device=device, **options)


def set_up(
    config: Mapping[str, Any],
    *,
    size: int,
    seed: int,
    curricula: Iterable[Curriculum] = (),
) -> Setup:
    """What a run's configuration flies in.

    Args:
        config: Of the whole run.
        size: Scenes of the pool.
        seed: Of the scenes.
        curricula: They ease the scenes; without one, difficulty is full.

    Raises:
        ConfigError: A name, a number or a combination is wrong.
    """
    allowed, device = config.get("allowed_targets", ()), config["device"]
    stages = build_stages(config)
    nodes = {name: config.get(name) for name in ("search", "task", "env")}
    planner = planner_for(**nodes, allowed=allowed)
    room = {"size": size, "resolution_m": stages.context.resolution_m, "device": device}
    levels = {term.name: term.levels for term in curricula}
    pool = ScenePool(
        build_scene(config["scene"], seed=seed, allowed=allowed, **room),
        **room,
        generator=generator_for(seed, "scene_layout"),
        plan=planner,
        levels=levels.get(stages.scene_difficulty or "", (1.0,)),
    )
    _require_ways(pool.layout, getattr(stages.terms.task, "radius_m", None))
    return Setup(stages, pool, planner)


def among(scenes: Layout, stages: Stages, device: torch.device | str = "cpu") -> Setup:
    """A step and a reset in scenes that are laid out already, their routes included."""
    pool = ScenePool(
        LaidOut(scenes),
        size=len(scenes),
        resolution_m=stages.context.resolution_m,
        generator=generator_for(0, "scene_layout"),
        device=device,
    )
    return Setup(stages, pool)


def build_scene(
    node: Any,
    *,
    size: int,
    seed: int,
    resolution_m: float,
    device: torch.device | str = "cpu",
    allowed: Iterable[str] = (),
) -> Scene:
    """The scene that a node describes, if a pool of `size` of them has room on the device."""
    scene = scene_of(node, "scene", allowed)
    some = scene.sample(PROBED, generator_for(seed, "scene_layout"))
    require_room(size, some.size, resolution_m, device)
    _require_boxes(scene, some)
    return scene


def scene_of(node: Any, path: str, allowed: Iterable[str] = ()) -> Scene:
    """The scene that a node describes; what eases it is the pool's to know."""
    return build(without_difficulty(node, path)[0], path, allowed=allowed, kind=Scene)


def build_stages(config: Mapping[str, Any]) -> Stages:
    """The step and the reset of a run's configuration."""
    allowed = config.get("allowed_targets", ())
    vehicle = build(config["vehicle"], "vehicle", allowed=allowed)
    env = resolved(config["env"], "env")
    layout = checked("env.layout", env.pop("layout", []), Sequence[str])
    parts = {
        group.stage: _build_group(group, config.get(group.name), allowed)
        for group in GROUPS
        if group.stage
    }
    parts["observations"] = in_layout(parts["observations"], layout)
    for term in parts["critic_observations"]:
        term.group = CRITIC
    task = resolved(config["task"], "task")
    for name, stage in TASK.items():
        parts[stage] = build_term(task.get(name), f"task.{name}", allowed, Term).named(name)
    terms = Terms(**parts)
    if not terms.rewards or not terms.observations or not terms.terminations:
        raise ConfigError("reward, observation and termination need at least one term each.")
    scene = config.get("scene") or {}
    kept = scene.get("clearance_m")
    if kept is not None:
        kept = checked("scene.clearance_m", plain(kept), Sequence[NotNegative])
    context = build(
        {"_target_": "resc.term.Context", **env},
        "env",
        vehicle=vehicle,
        longest_delay_steps=terms.action.longest_delay_steps,
        clearance_m=kept,
        latency_s=max((d.latency_s for d in terms.sensors if isinstance(d, Device)), default=0.0),
    )
    return Stages(terms, context, without_difficulty(scene, "scene")[1])


def _build_group(group: Group, node: Any, allowed: Iterable[str]) -> Any:
    """The terms of a group, or its only one."""
    assert group.kind is not None
    if group.several:
        return build_terms(node, group.name, group.kind, allowed)
    if not node and not group.needed:
        return None
    return build(node, group.name, allowed=allowed, kind=group.kind).named(group.name)


def _require_boxes(scene: Scene, some: Layout) -> None:
    """Guards that leave no room for any box would make a free scene without a word."""
    wanted = getattr(scene, "boxes", 0)
    if isinstance(wanted, int) and wanted and not (some.boxes_w[..., 0] < PARKED_M).any():
        raise ConfigError(
            f"scene.boxes is {wanted}, but {len(some)} scenes have not a single one: none is far "
            "enough from start, goal or path; lower the distances to keep clear, or set "
            "scene.boxes=0."
        )


def _require_ways(layout: Layout, radius_m: object) -> None:
    """An arrival that reaches from all goals to their starts leaves nothing to fly."""
    last = layout.route_length.clamp(min=1).unsqueeze(-1).expand(-1, 1, 3) - 1
    goal = layout.route_w.gather(1, last)[:, 0]
    farthest_m = float(torch.linalg.vector_norm((goal - layout.start_w)[:, :2], dim=-1).max())
    if isinstance(radius_m, int | float) and farthest_m <= radius_m and len(layout) > 1:
        raise ConfigError(
            f"task.control_points.radius_m is {radius_m}, but no goal is farther than "
            f"{farthest_m:.3g} m from its start; lower it."
        )


def in_layout(observations: list[Observation], layout: Iterable[str]) -> list[Observation]:
    """Observations in the order of `layout`; those it does not name follow as configured."""
    order = {name: number for number, name in enumerate(layout)}
    return sorted(observations, key=lambda term: order.get(term.name, len(order)))
