"""Recorded and modelled steps of the body rate over one another, one panel a kind."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from resc.errors import ConfigError
from resc.flight_logs.rate_steps import Step
from resc.run_folder import replacing
from resc.viewing.colours import FRAME, MODELLED, RECORDED, TEXT


def draw_steps(steps: Sequence[Step], path: Path) -> None:
    """Draws all steps, those of a kind in one panel."""
    kinds = list(dict.fromkeys(step.kind for step in steps))
    with mpl.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(12, 3.4 * -(-len(kinds) // 3)), layout="constrained")
        places = list(figure.subplots(-(-len(kinds) // 3), 3, squeeze=False).flat)
        for axes, kind in zip(places, kinds, strict=False):
            _draw_kind(axes, [step for step in steps if step.kind == kind])
        for axes in places[len(kinds) :]:
            axes.axis("off")
        with replacing(path, ConfigError) as unfinished:
            figure.savefig(unfinished, dpi=130, format=path.suffix.removeprefix(".") or "png")


def _draw_kind(axes: Axes, steps: Sequence[Step]) -> None:
    first, axis = steps[0], steps[0].kind.split("_")
    axes.plot(first.time_s, first.asked, color=FRAME, linewidth=0.9, linestyle="--", label="asked")
    for number, step in enumerate(steps):
        for values, colour, name, width in (
            (step.recorded, RECORDED, "PX4", 2.2),
            (step.modelled, MODELLED, "model", 0.9),
        ):
            label = None if number else name
            axes.plot(step.time_s, values, color=colour, linewidth=width, label=label)
    errors = np.mean([step.error for step in steps])
    axes.set_title(f"{axis[0]}, {axis[1]} rad/s, {len(steps)} times: NRMSE {errors:.3f}")
    axes.set(xlim=(-0.05, 0.9), xlabel="time since the step [s]", ylabel="rate / amplitude")
    axes.legend(fontsize="small", frameon=False, loc="lower right")
    axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)
