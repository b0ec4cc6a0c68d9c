"""Layouts for Foxglove and Lichtblick: 3-D view, rates, thrust and speed, rewards, log.

The files in this folder fit the default training; every scene file has a pair for its own rewards
and observations. `python -m resc.viewing.layouts` rewrites the files in this folder.
"""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import foxglove.layouts as panels

from resc.viewing.colours import CHALK, ESTIMATED, NEXT, NIGHT, RENEWED, TRUE

DEFAULT = (
    (
        *("progress", "time", "crash", "dynamics_limits", "field_of_view", "body_rate", "finish"),
        *("jerk", "action_rate"),
    ),
    ("esdf_patch_points", "kgp_esdf_points", "kgp_esdf"),
)
"""Rewards, and topics under /observation, of the default training."""
CAMERA = {"distance": 7.0, "phi": 50.0, "thetaOffset": 45.0, "perspective": True}
"""The camera looks down on the vehicle from this distance [m], and goes where it goes."""
PLAN, TRAIL = (CHALK + "ff",) * 2, (NEXT + "ff", TRUE + "ff")
ESTIMATE, BESIDE_ESTIMATE = (ESTIMATED + "ff",) * 2, (TRUE + "66",) * 2
ROUTE = (RENEWED + "ff",) * 2
"""The estimated track, and the true one around it, through which it shows."""
SHARES = (62, 38)
"""Width [%] of the 3-D view and of the curves."""


class Curve(NamedTuple):
    """One line of a plot: a message path and its name."""

    path: str
    label: str


def curves(reward_names: Sequence[str], tracks: Sequence[str] = ()) -> dict[str, list[Curve]]:
    """The plots by title.

    Args:
        reward_names: The reward terms.
        tracks: Topics of the tracks beside the true one.
    """
    rates = [
        Curve(f"/{topic}.body_rate.{axis}", f"{axis} {label}")
        for axis in "xyz"
        for topic, label in (("command", "commanded"), ("state", "true"))
    ]
    errors = {
        "Errors of the estimate [m, m/s]": [
            Curve("/estimate.position_error", "position"),
            Curve("/estimate.velocity_error", "velocity"),
        ]
    }
    return {
        "Body rates [rad/s]": rates,
        "Speed [m/s]": [Curve("/state.speed", "speed")],
        "Commanded thrust [N]": [Curve("/command.collective_thrust", "thrust")],
        "Reward terms": [Curve(f"/reward.terms.{name}", name) for name in reward_names],
        **(errors if "/drone/estimate" in tracks else {}),
    }


def topics(observations: Sequence[str], tracks: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """How the 3-D view shows each topic; points that repeat a shape are hidden."""
    hidden = ("/drone/points", "/world/obstacle_points", "/map/esdf_points", "/drone/pose")
    shown = ("/drone/body", "/world/obstacles", "/plan/columns")
    line = {"visible": True, "type": "line"}
    seen = [f"/observation/{name}" for name in observations]
    points = {"visible": True, "pointSize": 9.0, "colorMode": "rgba-fields"}
    beside = {
        "/drone/measured": {**points, "pointSize": 4.0},
        "/drone/estimate": {**line, "lineWidth": 0.015, "gradient": list(ESTIMATE)},
        "/world/movers": {"visible": True},
        "/world/mover_points": {"visible": False},
        "/map/known": {"visible": True, "colorMode": "rgba-fields"},
        "/plan/route": {**line, "lineWidth": 0.045, "gradient": list(ROUTE)},
    }
    trail = BESIDE_ESTIMATE if "/drone/estimate" in tracks else TRAIL
    return {
        **{topic: {"visible": False} for topic in hidden},
        **{topic: {"visible": True} for topic in shown},
        "/map/esdf_slice": {"visible": True, "colorMode": "rgba-fields"},
        "/plan/path": {**line, "lineWidth": 0.03, "gradient": list(PLAN)},
        "/drone/trail": {**line, "lineWidth": 0.06, "gradient": list(trail)},
        "/plan/control_points": points,
        **{topic: points if topic.endswith("_points") else {"visible": True} for topic in seen},
        **{topic: beside[topic] for topic in tracks},
    }


def view(observations: Sequence[str], tracks: Sequence[str] = ()) -> dict[str, Any]:
    """Settings of the 3-D view, the same in both programs."""
    return {
        "cameraState": CAMERA,
        "followMode": "follow-position",
        "followTf": "drone",
        "scene": {"backgroundColor": NIGHT, "transforms": {"visible": False}},
        "topics": topics(observations, tracks),
    }


def foxglove(
    reward_names: Sequence[str], observations: Sequence[str], tracks: Sequence[str] = ()
) -> str:
    """The layout as Foxglove's JSON."""
    config = view(observations, tracks)
    scene = panels.Panel(panel_type="ThreeDee", config=config, title="Flight", version=1)
    plots: list[panels.BasePanel] = [
        panels.PlotPanel(
            title=title,
            config=panels.PlotConfig(
                paths=[panels.PlotSeries(value=c.path, label=c.label) for c in lines],
                legend_display="floating",
                is_synced=True,
            ),
        )
        for title, lines in curves(reward_names, tracks).items()
    ]
    log = panels.LogPanel(config=panels.LogConfig(topic_to_render="/log"))
    column = panels.SplitContainer(
        direction="column", items=[panels.SplitItem(content=panel) for panel in (*plots, log)]
    )
    items = [
        panels.SplitItem(proportion=share, content=content)
        for share, content in zip(SHARES, (scene, column), strict=True)
    ]
    return panels.Layout(content=panels.SplitContainer(direction="row", items=items)).to_json()


def lichtblick(
    reward_names: Sequence[str], observations: Sequence[str], tracks: Sequence[str] = ()
) -> str:
    """The layout as Lichtblick's JSON."""
    configs: dict[str, Any] = {"3D!flight": view(observations, tracks)}
    for number, (title, lines) in enumerate(curves(reward_names, tracks).items()):
        configs[f"Plot!{number}"] = {
            "lichtblickPanelTitle": title,
            "paths": [
                {
                    "value": curve.path, "label": curve.label,
                    "enabled": True, "timestampMethod": "receiveTime",
                }
                for curve in lines
            ],
            "showLegend": True,
            "legendDisplay": "floating",
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "isSynced": True,
            "xAxisVal": "timestamp",
        }  # fmt: skip
    configs["RosOut!log"] = {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []}
    first, *column = configs
    split = {"direction": "row", "first": first, "splitPercentage": SHARES[0]}
    layout = {
        "configById": configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {**split, "second": _stacked(column)},
    }
    return json.dumps(layout, separators=(",", ":"))


def _stacked(names: list[str]) -> str | dict[str, Any]:
    """Panels of equal height, one below the other."""
    if len(names) == 1:
        return names[0]
    share = 100 / len(names)
    below = _stacked(names[1:])
    return {"direction": "column", "first": names[0], "second": below, "splitPercentage": share}
