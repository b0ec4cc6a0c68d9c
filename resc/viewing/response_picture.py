"""What a log shows of the rate loop and the rotors, beside a model's: one picture."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from resc.errors import RecordingError
from resc.flight_logs.models import LoopModel
from resc.flight_logs.rate_response import AXES, AxisResult, Response
from resc.flight_logs.thrust_curve import GRAVITY_MPS2, ThrustCurve
from resc.run_folder import replacing
from resc.viewing.colours import AXES as HUES
from resc.viewing.colours import FRAME, ORANGE, TEXT

_MOST_LINES = 60


def draw_responses(
    results: Sequence[AxisResult],
    curve: ThrustCurve | str,
    model: LoopModel,
    name: str,
    path: Path,
) -> None:
    """Draws the step responses of roll, pitch and yaw, and the thrust curve."""
    with mpl.rc_context({"font.size": 9, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(12, 7.5), layout="constrained")
        places = figure.subplots(2, 2)
        for i, axes in enumerate(places.flat[:3]):
            _draw_axis(axes, results[i], AXES[i], HUES[i], model.name)
        _draw_curve(places[1, 1], curve, model)
        figure.suptitle(f"{name}: response to rate set-points, and thrust")
        with replacing(path, RecordingError) as unfinished:
            figure.savefig(unfinished, dpi=130, format=path.suffix.removeprefix(".") or "png")


def _draw_axis(axes: Axes, result: AxisResult, name: str, colour: str, model: str) -> None:
    axes.axhline(1, color=FRAME, linewidth=0.8, linestyle="--", zorder=1)
    if result.measured is None:
        axes.text(0.5, 0.5, _wrapped(result.reason), transform=axes.transAxes, ha="center")
    else:
        each = result.measured.each[:_MOST_LINES]
        axes.plot(_ticks(result.measured), each.T, color=colour, linewidth=0.5, alpha=0.25)
        label = f"log, {result.measured.count} {_unit(result.measured)}"
        axes.plot(*_curve(result.measured), color=colour, linewidth=2.0, label=label)
    if result.modelled is not None:
        axes.plot(*_curve(result.modelled), color=TEXT, linewidth=1.2, label=f"model {model}")
    axes.set(xlim=(0, 0.5), ylim=(-0.2, 1.6), xlabel="time since the step [s]")
    axes.set_ylabel(f"{name} rate / set-point")
    if result.measured is not None:
        axes.legend(fontsize="small", frameon=False, loc="lower right")
    _quiet(axes)


def _draw_curve(axes: Axes, curve: ThrustCurve | str, model: LoopModel) -> None:
    throttle = np.linspace(0, 1, 101)
    axes.axhline(GRAVITY_MPS2, color=FRAME, linewidth=0.8, linestyle="--", zorder=1)
    if isinstance(curve, str):
        axes.text(0.5, 0.5, _wrapped(curve), transform=axes.transAxes, ha="center")
    else:
        sizes = 10 + 60 * curve.count / curve.count.max()
        axes.scatter(curve.throttle, curve.thrust, s=sizes, color=ORANGE, label="log, medians")
        axes.plot(throttle, curve.at(throttle), color=ORANGE, label="log, fitted")
    axes.plot(
        throttle, model.specific_thrust(throttle), color=TEXT, linewidth=1.2,
        label=f"model {model.name}",
    )  # fmt: skip
    axes.set(xlim=(0, 1), xlabel="thrust set-point", ylabel="specific thrust [m/s²]")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small", frameon=False, loc="upper left")
    _quiet(axes)


def _ticks(response: Response) -> np.ndarray:
    return np.arange(len(response.values)) * response.dt_s


def _curve(response: Response) -> tuple[np.ndarray, np.ndarray]:
    return _ticks(response), response.values


def _unit(response: Response) -> str:
    return "steps" if response.method == "steps" else "windows, deconvolved"


def _wrapped(text: str) -> str:
    return text.replace(", ", ",\n")


def _quiet(axes: Axes) -> None:
    axes.grid(color=FRAME, linewidth=0.4, alpha=0.5)
    axes.tick_params(length=2, color=FRAME, labelcolor=TEXT, labelsize="small")
    for spine in axes.spines.values():
        spine.set_color(FRAME)
