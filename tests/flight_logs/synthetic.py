"""ULog files written from scratch: pyulog reads them as it reads those of a flight controller."""

import struct

import numpy as np

_TYPES = {
    "f4": ("float", "f"), "f8": ("double", "d"), "u1": ("uint8_t", "B"), "i4": ("int32_t", "i"),
    "u8": ("uint64_t", "Q"), "b1": ("bool", "?"),
}  # fmt: skip
START_US = 5_000_000


def message(kind, content):
    return struct.pack("<HB", len(content), ord(kind)) + content


def named(kind, text, value):
    """An information or parameter message."""
    name = {"float": "float", "int": "int32_t"}.get(
        type(value).__name__, f"char[{len(value)}]" if isinstance(value, str) else ""
    )
    key = f"{name} {text}".encode()
    packed = (
        value.encode()
        if isinstance(value, str)
        else struct.pack("<f" if isinstance(value, float) else "<i", value)
    )
    return message(kind, bytes([len(key)]) + key + packed)


def ulog(topics, parameters=None, facts=None, start_us=START_US, dropouts=()):
    """Bytes of a log.

    `topics` maps (name, instance) to fields: arrays [t] or [t, k]; `time_s` [t] is their time since
    the start. Messages are in the order of their times.
    """
    parts = [b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", start_us)]
    parts.append(message("B", bytes(40)))
    parts += [named("I", name, value) for name, value in (facts or {}).items()]
    layouts = {}
    for (name, _), fields in topics.items():
        kinds = {
            n: (np.asarray(v), np.asarray(v).dtype.str[1:])
            for n, v in fields.items()
            if n != "time_s"
        }
        text = "uint64_t timestamp;" + "".join(
            f"{_TYPES[kind][0]}{f'[{v.shape[1]}]' if v.ndim > 1 else ''} {n};"
            for n, (v, kind) in kinds.items()
        )
        if name not in layouts:
            parts.append(message("F", f"{name}:{text}".encode()))
        layouts[name] = np.dtype(
            [("timestamp", "<u8")]
            + [(n, f"<{kind}", v.shape[1:]) for n, (v, kind) in kinds.items()]
        )
    parts += [named("P", name, value) for name, value in (parameters or {}).items()]
    data = []
    for number, ((name, instance), fields) in enumerate(topics.items()):
        parts.append(message("A", struct.pack("<BH", instance, number) + name.encode()))
        rows = np.zeros(len(fields["time_s"]), layouts[name])
        rows["timestamp"] = np.round(np.asarray(fields["time_s"]) * 1e6).astype(np.int64) + start_us
        for field in layouts[name].names[1:]:
            rows[field] = fields[field]
        data += [
            (int(row["timestamp"]), message("D", struct.pack("<H", number) + row.tobytes()))
            for row in rows
        ]
    data += [
        (round(at * 1e6) + start_us, message("O", struct.pack("<H", ms))) for at, ms in dropouts
    ]
    return b"".join(parts) + b"".join(part for _, part in sorted(data, key=lambda pair: pair[0]))


def flight(seconds=4.0, rate_hz=250.0, armed=((1.0, 3.0),), modern=True):
    """Topics of a flight: north at 2 m/s, climbing at 1 m/s, yawing right at 0.5 rad/s."""
    t = np.arange(0, seconds, 1 / rate_hz)
    slow = np.arange(0, seconds, 0.1)
    zeros = np.zeros_like(t)
    yaw = 0.5 * t
    is_armed = np.zeros(len(slow), bool)
    for begin, end in armed:
        is_armed |= (slow >= begin - 1e-9) & (slow < end - 1e-9)
    f4 = np.float32
    rates = np.stack((zeros + 0.1, zeros + 0.2, zeros + 0.5), 1).astype(f4)
    local = {
        "time_s": slow, "x": (2 * slow).astype(f4), "y": np.zeros_like(slow, f4),
        "z": (-slow).astype(f4), "vx": np.full_like(slow, 2, f4), "vy": np.zeros_like(slow, f4),
        "vz": np.full_like(slow, -1, f4), "xy_valid": np.ones_like(slow, bool),
        "z_valid": np.ones_like(slow, bool), "v_xy_valid": np.ones_like(slow, bool),
        "v_z_valid": np.ones_like(slow, bool),
    }  # fmt: skip
    q = np.stack((np.cos(yaw / 2), zeros, zeros, np.sin(yaw / 2)), 1).astype(f4)
    force = np.tile(np.array([[0, 0, -9.8]], f4), (len(t), 1))
    topics = {
        ("vehicle_attitude", 0): {"time_s": t, "q": q},
        ("vehicle_local_position", 0): local,
        ("vehicle_rates_setpoint", 0): {
            "time_s": t[::5], "roll": rates[::5, 0], "pitch": rates[::5, 1], "yaw": rates[::5, 2],
        },
    }  # fmt: skip
    setpoint = topics["vehicle_rates_setpoint", 0]
    if modern:
        thrust = np.zeros((len(setpoint["time_s"]), 3), f4)
        thrust[:, 2] = -0.4
        setpoint["thrust_body"] = thrust
        topics["vehicle_angular_velocity", 0] = {"time_s": t, "xyz": rates}
        topics["vehicle_acceleration", 0] = {"time_s": t, "xyz": force}
        motors = np.full((len(slow), 12), np.nan, f4)
        motors[:, :4] = np.where(is_armed[:, None], 0.4, np.nan)
        topics["actuator_motors", 0] = {"time_s": slow, "control": motors}
        topics["actuator_armed", 0] = {"time_s": slow, "armed": is_armed}
    else:
        setpoint["thrust"] = np.full(len(setpoint["time_s"]), 0.4, f4)
        topics["sensor_combined", 0] = {
            "time_s": t, "gyro_rad": rates, "accelerometer_m_s2": force,
        }  # fmt: skip
        outputs = np.full((len(slow), 16), 1500, f4)
        topics["actuator_outputs", 0] = {"time_s": slow, "output": np.zeros_like(outputs)}
        topics["actuator_outputs", 1] = {
            "time_s": slow,
            "output": outputs + slow[:, None].astype(f4),
        }
        topics["vehicle_status", 0] = {
            "time_s": slow, "arming_state": np.where(is_armed, 2, 1).astype(np.uint8),
            "system_type": np.full(len(slow), 2, np.uint8),
        }  # fmt: skip
    return topics


QUADROTOR = {"MAV_TYPE": 2, "SYS_AUTOSTART": 4001}


def answers(set_points, dt_s, delay_s=0.02, constant_s=0.06, damping=0.7):
    """Rates of a loop of second order after a delay: what identification has to find."""
    rates, speed = np.zeros_like(set_points), np.zeros(set_points.shape[1])
    frequency = 1 / constant_s
    late = round(delay_s / dt_s)
    for i in range(1, len(rates)):
        asked = set_points[max(0, i - 1 - late)]
        turn = frequency**2 * (asked - rates[i - 1]) - 2 * damping * frequency * speed
        speed = speed + dt_s * turn
        rates[i] = rates[i - 1] + dt_s * speed
    return rates


def loop_flight(set_points, dt_s=0.004, noise=0.02, full=25.0, curvature=0.3, **loop):
    """A flight in which the loop of `answers` follows set-points [t, 3] in our frame, FLU."""
    generator = np.random.default_rng(1)
    t = np.arange(len(set_points)) * dt_s
    flip = np.array([1.0, -1.0, -1.0])
    every = round(0.02 / dt_s)
    set_points = np.repeat(set_points[::every], every, 0)[: len(t)]
    rates = answers(set_points, dt_s, **loop) + noise * generator.standard_normal((len(t), 3))
    u = 0.5 + 0.25 * np.sin(0.5 * t)
    force = np.zeros((len(t), 3))
    force[:, 2] = -full * (curvature * u**2 + (1 - curvature) * u)
    force += 0.3 * generator.standard_normal(force.shape)
    q = np.tile([1.0, 0, 0, 0], (len(t), 1))
    f4 = np.float32
    asked, thrust = (set_points * flip).astype(f4)[::every], np.zeros((len(t[::every]), 3), f4)
    thrust[:, 2] = -u[::every]
    return {
        ("vehicle_attitude", 0): {"time_s": t, "q": q.astype(f4)},
        ("vehicle_angular_velocity", 0): {"time_s": t, "xyz": (rates * flip).astype(f4)},
        ("vehicle_acceleration", 0): {"time_s": t, "xyz": force.astype(f4)},
        ("vehicle_rates_setpoint", 0): {
            "time_s": t[::every], "roll": asked[:, 0], "pitch": asked[:, 1], "yaw": asked[:, 2],
            "thrust_body": thrust,
        },
        ("actuator_armed", 0): {"time_s": t[::125], "armed": np.ones(len(t[::125]), bool)},
    }  # fmt: skip


def doublets(dt_s=0.004, repeats=4):
    """Steps of 1 rad/s up and down, half a second each, one axis after the other."""
    rest, held = round(0.8 / dt_s), round(0.5 / dt_s)
    parts = []
    for axis in range(3):
        for _ in range(repeats):
            part = np.zeros((2 * rest + 2 * held, 3))
            part[rest : rest + held, axis] = 1.0
            part[2 * rest + held :, axis] = -1.0
            parts.append(part)
    return np.concatenate(parts)


def wandering(seconds=40.0, dt_s=0.004, hertz=3.0):
    """Set-points without steps, as an attitude controller asks for them."""
    generator = np.random.default_rng(2)
    values = generator.standard_normal((round(seconds / dt_s), 3))
    state = np.zeros((2, 3))
    share = dt_s * 2 * np.pi * hertz
    for i in range(len(values)):
        state[0] += share * (values[i] - state[0])
        state[1] += share * (state[0] - state[1])
        values[i] = state[1]
    return values / values.std(0)
