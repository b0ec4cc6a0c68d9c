"""Commands for real flights: from-ulog, identify."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from resc.errors import ExitCode
from resc.log_command.arguments import (
    add_command,
    add_output,
    needing,
    output,
    require_picture,
)
from resc.recording.reader import RolloutLog

if TYPE_CHECKING:
    from resc.flight_logs.models import LoopModel
    from resc.flight_logs.rate_response import Response
    from resc.flight_logs.thrust_curve import ThrustCurve
    from resc.flight_logs.trace import Trace

_DT_S = 0.02
_MODEL = "imp250"


def add_commands(commands: Any) -> None:  # noqa: ANN401
    """Adds the commands of this module."""
    from_ulog = add_command(
        commands,
        "from-ulog",
        run_from_ulog,
        "a log of PX4 as a recording: each armed stretch an episode",
        "resc-log from-ulog flight.ulg --out flight.mcap",
    )
    from_ulog.add_argument("recording", type=Path, metavar="LOG", help=".ulg file of PX4")
    from_ulog.add_argument(
        "--dt", type=_step, default=_DT_S, metavar="S", help=f"control step [s]; default: {_DT_S}"
    )
    add_output(from_ulog, "LOG.mcap in this folder")
    identify = add_command(
        commands,
        "identify",
        run_identify,
        "how the body rates follow their set-points, and thrust its own, beside a model's",
        "resc-log identify flight.ulg --model iris --out response.png",
    )
    identify.add_argument(
        "recording", metavar="RECORDING", help=".ulg file of PX4, or file, folder, run or pattern"
    )
    identify.add_argument(
        "--model", default=_MODEL, metavar="NAME", help=f"to compare with; default: {_MODEL}"
    )
    add_output(identify, "response.png in this folder")


def run_from_ulog(given: argparse.Namespace) -> int:
    """Writes a log as a recording and says what it holds."""
    with needing("px4"):
        import pyulog  # noqa: F401 - said here, before anything is written
    from resc.flight_logs.recording import read_flight, write_flight

    flight = read_flight(given.recording, given.dt)
    path = output(given, Path(f"{given.recording.stem}.mcap"))
    write_flight(flight, path)
    log, found = flight.log, flight.signals.found
    seconds = len(flight.times_s) * given.dt
    print(f"{path}: {len(flight.episodes)} episode(s), {seconds:.1f} s at {given.dt:g} s")
    for name, signal in found.items():
        print(f"  {name:<17}{signal.topic}, {signal.rate_hz:.0f} Hz")
    for note in flight.notes:
        print(f"  note: {note}")
    if log.cut:
        print(f"  left out: {log.path} is cut or damaged; what could be read of it is recorded.")
    return ExitCode.UNFINISHED if log.cut else ExitCode.DONE


def run_identify(given: argparse.Namespace) -> int:
    """Prints and draws what a log shows of the rate loop."""
    from resc.flight_logs.models import loop_model
    from resc.flight_logs.rate_response import AXES, rate_responses
    from resc.flight_logs.thrust_curve import thrust_curve
    from resc.flight_logs.trace import trace_of_recording
    from resc.flight_logs.ulog import is_ulog
    from resc.viewing.response_picture import draw_responses

    model = loop_model(given.model)
    require_picture(given.out)
    place = Path(given.recording)
    if is_ulog(place) or place.suffix == ".ulg":
        trace = _trace_of_log(place)
    else:
        trace = trace_of_recording(RolloutLog(given.recording))
    results = rate_responses(trace, model.respond)
    curve = thrust_curve(trace)
    path = output(given, Path("response.png"))
    draw_responses(results, curve, model, trace.name, path)
    flown = sum(last - first for first, last in trace.spans)
    print(f"{trace.name}: {flown:.1f} s of flight, rates at {trace.rate.rate_hz:.0f} Hz")
    print(f"{'':<7}{'':<18}{'n':>5}{'t10 s':>8}{'t63 s':>8}{'t90 s':>8}{'overshoot':>11}")
    for axis, result in zip(AXES, results, strict=True):
        if result.measured is None:
            print(f"{axis:<7}{result.reason}")
        for origin, response in (("log", result.measured), (model.name, result.modelled)):
            if response is not None:
                print(_line(axis, f"{origin}, {response.method}", response))
    _print_curve(curve, model)
    print(path)
    return ExitCode.DONE


def _trace_of_log(path: Path) -> "Trace":
    with needing("px4"):
        import pyulog  # noqa: F401
    from resc.flight_logs.trace import trace_of_log

    return trace_of_log(path)


def _line(axis: str, origin: str, response: "Response") -> str:
    times = [response.reach_s(level) for level in (0.1, 0.63, 0.9)]
    cells = "".join(f"{'-':>8}" if time is None else f"{time:>8.3f}" for time in times)
    told = "" if response.explained is None else f"  explains {response.explained:.0%}"
    begun = f"{axis:<7}{origin:<18}"
    return f"{begun:<25}{response.count:>5}{cells}{response.overshoot:>11.1%}{told}"


def _print_curve(curve: "ThrustCurve | str", model: "LoopModel") -> None:
    if isinstance(curve, str):
        print(f"thrust: {curve}")
        return
    told = "a line: the set-points are too close to each other for a curve"
    if curve.curvature is not None:
        told = f"THR_MDL_FAC {curve.curvature:.2f}"
    full = float(model.specific_thrust(np.ones(1))[0])
    print(
        f"thrust: {curve.full_mps2:.1f} m/s^2 at full set-point ({model.name}: {full:.1f}), "
        f"hover at {curve.hover:.3f}, {told}, {curve.count.sum():.0f} samples"
    )


def _step(text: str) -> float:
    """A control step [s]."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0005 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no control step; give 0.0005 to 1 s")
    return value
