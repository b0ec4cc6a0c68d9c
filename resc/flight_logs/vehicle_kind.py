"""Whether a log is of a multirotor: its rate loop and its frames are what we read."""

from resc.errors import RecordingError
from resc.flight_logs.ulog import Ulog

STATUS = "vehicle_status"
_MULTIROTORS = {2: "quadrotor", 13: "hexarotor", 14: "octorotor"}
_OTHERS = {
    1: "fixed-wing aircraft", 3: "coaxial helicopter", 4: "helicopter", 7: "airship",
    8: "free balloon", 10: "rover", 11: "boat", 12: "submarine", 15: "tricopter",
    16: "flapping wing", 17: "kite", **dict.fromkeys(range(19, 26), "VTOL aircraft"),
}  # fmt: skip
"""By MAV_TYPE, the number of MAVLink's table of vehicles."""
_TELLING = {
    "fixed-wing aircraft": (
        "tecs_status",
        "fw_virtual_attitude_setpoint",
        "fw_virtual_rates_setpoint",
    ),
    "rover": ("rover_status", "rover_rate_setpoint", "rover_throttle_setpoint"),
}
"""Topics that only a vehicle of another kind logs."""
TOPICS = (STATUS, *(topic for topics in _TELLING.values() for topic in topics))


def kind_of(log: Ulog) -> str:
    """What flew, as its log says: such as `quadrotor`; `unknown` where it says nothing.

    Raises:
        RecordingError: It is no multirotor.
    """
    number, origin = _number(log)
    if number in _OTHERS:
        _refuse(log, _OTHERS[number], f"{origin} is {number}")
    status = log.first(STATUS)
    if status is not None and status.fields.get("is_vtol", [0])[-1]:
        _refuse(log, "VTOL aircraft", f"{STATUS} says is_vtol")
    if number not in _MULTIROTORS:
        for kind, topics in _TELLING.items():
            told = [topic for topic in topics if topic in log.topics]
            if told:
                _refuse(log, kind, f"it logs {told[0]}")
    return _MULTIROTORS.get(number, "unknown")


def _number(log: Ulog) -> tuple[int, str]:
    """The kind by MAVLink's numbers, 0 where the log does not say it, and what says it."""
    if "MAV_TYPE" in log.parameters:
        return int(log.parameters["MAV_TYPE"]), "MAV_TYPE"
    status = log.first(STATUS)
    if status is not None and "system_type" in status.fields:
        return int(status.fields["system_type"][-1]), f"system_type in {STATUS}"
    return 0, ""


def _refuse(log: Ulog, kind: str, reason: str) -> None:
    article = "an" if kind[0] in "aeiou" else "a"
    raise RecordingError(
        f"{log.path} is the log of {article} {kind} ({reason}); give one of a multirotor, such as "
        "a quadrotor."
    )
