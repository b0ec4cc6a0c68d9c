"""The vocabulary: every TensorDict key with its shape, unit, frame and meaning.

Terms *read* keys and *write* keys; nothing else connects them. Frames: `w` world ENU (z up), `b`
body FLU. Shapes leave out the environment axis `n`; shared keys (the maps of the scene pool) have
none.
"""

from dataclasses import dataclass

import torch

NestedKey = tuple[str, ...]


@dataclass(frozen=True)
class Declaration:
    """What one key holds.

    `shape` is per environment, or the whole shape's meaning when `shared`.
    """

    shape: tuple[int | str, ...]
    unit: str
    meaning: str
    dtype: torch.dtype = torch.float32
    shared: bool = False


DECLARED: dict[NestedKey, Declaration] = {}


def _declare(
    path: NestedKey,
    shape: tuple[int | str, ...],
    unit: str,
    meaning: str,
    dtype: torch.dtype = torch.float32,
    shared: bool = False,
) -> NestedKey:
    DECLARED[path] = Declaration(shape, unit, meaning, dtype, shared)
    return path


ACTION = _declare(
    ("action",), (4,), "-", "policy output in [-1, 1]: roll, pitch, yaw rate, collective thrust"
)

POSITION_W = _declare(("state", "position_w"), (3,), "m", "centre of mass")
VELOCITY_W = _declare(("state", "velocity_w"), (3,), "m/s", "velocity")
ATTITUDE_WB = _declare(
    ("state", "attitude_wb"), (4,), "-", "Hamilton quaternion wxyz, body to world"
)
BODY_RATE_B = _declare(("state", "body_rate_b"), (3,), "rad/s", "angular velocity")
ROTOR_THRUST = _declare(
    ("state", "rotor_thrust"), (4,), "N", "thrust of each rotor: FR, RR, RL, FL"
)
ACCELERATION_W = _declare(
    ("state", "acceleration_w"), (3,), "m/s^2", "mean kinematic acceleration over the last step"
)

ACTION_QUEUE = _declare(("command", "action_queue"), ("d", 4), "-", "last actions, newest first")
COLLECTIVE_THRUST = _declare(
    ("command", "collective_thrust"), (1,), "N", "commanded sum of the rotor thrusts"
)
BODY_RATE_COMMAND_B = _declare(("command", "body_rate_b"), (3,), "rad/s", "commanded body rate")
ROTOR_COMMAND = _declare(
    ("command", "rotor_thrust"), (4,), "N", "rotor thrust after rate loop and allocation"
)
THROTTLE_COMMAND = _declare(
    ("command", "throttle"), (1,), "-", "collective thrust set-point of a flight controller, 0 to 1"
)
MOTOR_OUTPUT = _declare(
    ("command", "motor_output"),
    (4,),
    "-",
    "what each motor of a real flight is sent, in the order and unit of its log",
)
SPECIFIC_FORCE_B = _declare(
    ("sensor", "specific_force_b"), (3,), "m/s^2", "acceleration without gravity, by accelerometer"
)

GYRO_DELAYS = _declare(
    ("loop", "gyro_delays"), (2, 3), "rad/s", "memory of the filter of the gyro, newest first, FRD"
)
FILTERED_RATE = _declare(
    ("loop", "filtered_rate"), (3,), "rad/s", "body rate that the rate loop sees, FRD"
)
FILTERED_ACCELERATION = _declare(
    ("loop", "filtered_acceleration"), (3,), "rad/s^2", "its slope as the rate loop sees it, FRD"
)
RATE_INTEGRAL = _declare(
    ("loop", "rate_integral"), (3,), "-", "the rate loop's integrators, normalised torque, FRD"
)
YAW_TORQUE = _declare(
    ("loop", "yaw_torque"), (1,), "-", "filtered yaw torque, normalised, positive to the right"
)
UNALLOCATED = _declare(
    ("loop", "unallocated_torque"),
    (3,),
    "-",
    "what the allocator last reported that it could not give, normalised torque, FRD",
)
STATUS_AGE = _declare(
    ("loop", "status_age"), (1,), "runs", "runs of the rate loop since the allocator's report"
)

MASS = _declare(("params", "mass"), (1,), "kg", "mass")
INERTIA_B = _declare(("params", "inertia_b"), (3,), "kg m^2", "diagonal of the inertia matrix")
TORQUE_COEFFICIENT = _declare(
    ("params", "torque_coefficient"), (1,), "m", "yaw torque per rotor thrust"
)
ARM = _declare(
    ("params", "arm"), (3,), "m", "rotor offsets: x, y of the front rotors, y of the rear rotors"
)
THRUST_SCALE = _declare(("params", "thrust_scale"), (1,), "-", "true over nominal rotor thrust")
ACTION_DELAY = _declare(
    ("params", "action_delay"), (1,), "steps", "age of the action that is applied"
)

RATE_GAINS = _declare(
    ("variation", "rate_gains"),
    (3,),
    "-",
    "P, I and D of PX4's rate loop over those of the vehicle's file, where they are drawn",
)
ROTOR_TIME_CONSTANT = _declare(
    ("variation", "rotor_time_constant"), (1,), "s", "of the rotors' lag, where it is drawn"
)
CENTRE_OF_MASS_B = _declare(
    ("variation", "centre_of_mass_b"),
    (2,),
    "m",
    "how far ahead and to the left of the point that rotor offsets count from, where it is drawn",
)
GYRO_BIAS_B = _declare(
    ("variation", "gyro_bias_b"),
    (3,),
    "rad/s",
    "what the rate loop's gyroscope reads at rest, where it is drawn",
)
GYRO_NOISE = _declare(("variation", "gyro_noise"), (1,), "rad/s", "standard deviation of its noise")
GYRO_STREAM = _declare(
    ("variation", "gyro_stream"), (3,), "-", "where the sequence of its noise stands", torch.int64
)

BATTERY_CHARGE = _declare(
    ("battery", "charge"), (1,), "-", "share of the full charge, where a battery drives the rotors"
)

WIND_W = _declare(("air", "wind_w"), (3,), "m/s", "mean wind of the episode, where it is drawn")
GUST_W = _declare(
    ("air", "gust_w"),
    (4, 2, 3),
    "m/s",
    "gusts of the episode: cosine and sine parts of each of four frequencies",
)

SPEED_LIMIT = _declare(
    ("limits", "speed"), (1,), "m/s", "greatest speed asked of the episode, where one is drawn"
)
MARGIN = _declare(
    ("limits", "margin"),
    (1,),
    "m",
    "least distance to obstacles asked of the episode, where one is drawn",
)

CLOCK = _declare(("clock", "step"), (1,), "steps", "control steps since the reset")
SCENE_INDEX = _declare(("scene", "index"), (1,), "-", "entry of the scene pool", torch.int64)

START_W = _declare(("task", "start_w"), (3,), "m", "where the episode begins")
START_MOTION = _declare(
    ("task", "start_motion"),
    (2,),
    "m/s, rad",
    "greatest speed, and angle to the route, that the scene lets an episode begin with",
)
ROUTE_CLEARANCE = _declare(
    ("task", "clearance"),
    (1,),
    "m",
    "what the route keeps from obstacles; infinite where the scene does not say",
)
ROUTE_W = _declare(("task", "route_w"), ("k", 3), "m", "all control points, padded with the last")
ROUTE_LENGTH = _declare(
    ("task", "route_length"), (1,), "-", "number of control points, 0 without a way", torch.int64
)
ROUTE_INDEX = _declare(
    ("task", "route_index"), (1,), "-", "control points already passed", torch.int64
)
CONTROL_POINTS_W = _declare(
    ("task", "control_points_w"), (2, 3), "m", "next two control points, the last repeated"
)
TARGET_W = _declare(("task", "target_w"), (3,), "m", "control point aimed at during the last step")
PASSED = _declare(
    ("task", "passed"), (1,), "-", "a control point was passed in the last step", torch.bool
)
FINISHED = _declare(
    ("task", "finished"), (1,), "-", "the last control point has been passed", torch.bool
)

ESDF = _declare(
    ("map", "esdf"), ("p", "h", "w"), "m", "distance between cell centres, truncated", shared=True
)
MAP_ORIGIN_W = _declare(("map", "origin_w"), ("p", 2), "m", "lower-left corner", shared=True)
MAP_SIZE = _declare(("map", "size"), ("p", 2), "m", "extent in x and y", shared=True)
BOXES_W = _declare(
    ("map", "boxes_w"), ("p", "k", 4), "m", "columns: x and y of the corner, lengths", shared=True
)
PILLARS_W = _declare(
    ("map", "pillars_w"),
    ("p", "m", 3),
    "m",
    "round columns: x and y of the axis, radius",
    shared=True,
)
MOVERS_W = _declare(
    ("map", "movers_w"),
    ("p", "o", 10),
    "m, m/s",
    "columns that move: x and y at the beginning, velocity, half the edges (radius and 0: round), "
    "least x and y of the centre, greatest x and y",
    shared=True,
)

CLEARANCE = _declare(("sensor", "clearance"), (1,), "m", "distance field at the vehicle's cell")
SURFACE_CLEARANCE = _declare(
    ("sensor", "surface_clearance"), (1,), "m", "exact distance to the nearest obstacle surface"
)
EULER = _declare(("sensor", "euler"), (3,), "rad", "roll, pitch, yaw (ZYX)")
LIMIT_VIOLATIONS = _declare(
    ("sensor", "limit_violations"),
    (4,),
    "-",
    "1 for each of speed, acceleration, roll, pitch over its limit",
)

MOCAP_POSITION_W = _declare(
    ("sensor", "mocap_position_w"), (3,), "m", "last position that motion capture delivered"
)
MOCAP_ATTITUDE_WB = _declare(
    ("sensor", "mocap_attitude_wb"), (4,), "-", "last attitude that motion capture delivered"
)
MOCAP_PAST = _declare(
    ("sensor", "mocap_past"),
    ("b", 10),
    "m, m/s, -",
    "positions, velocities and attitudes at the steps before, newest first",
)
MOCAP_HIDDEN = _declare(
    ("sensor", "mocap_hidden"), (1,), "s", "for how long motion capture does not see the vehicle"
)
MOCAP_FRESH = _declare(
    ("sensor", "mocap_fresh"),
    (1,),
    "-",
    "motion capture delivered a frame in the last step",
    torch.bool,
)
IMU_SPECIFIC_FORCE_B = _declare(
    ("sensor", "imu_specific_force_b"),
    (3,),
    "m/s^2",
    "accelerometer: its mean over the last step, in the body frame of the middle of the step",
)
IMU_MEAN_RATE_B = _declare(
    ("sensor", "imu_mean_rate_b"), (3,), "rad/s", "gyroscope: its mean over the last step"
)
IMU_BODY_RATE_B = _declare(
    ("sensor", "imu_body_rate_b"), (3,), "rad/s", "gyroscope: its reading now"
)

IMU_BIAS_B = _declare(
    ("sensor", "imu_bias_b"),
    (6,),
    "m/s^2, rad/s",
    "what is added to the accelerometer's and the gyroscope's readings, the same all episode",
)

FILTER_MEAN = _declare(
    ("estimate", "filter_mean"), ("d", "c"), "", "state of a filter when the last frame was taken"
)
FILTER_ATTITUDE_WB = _declare(
    ("estimate", "filter_attitude_wb"), (4,), "-", "its attitude, body to world"
)
FILTER_COVARIANCE = _declare(
    ("estimate", "filter_covariance"), ("d", "d"), "", "covariance of its error"
)
FILTER_INPUTS = _declare(
    ("estimate", "filter_inputs"),
    ("b", 6),
    "m/s^2, rad/s",
    "readings of accelerometer and gyroscope in the last steps, newest first",
)
FRAME_AGE = _declare(("estimate", "frame_age"), (1,), "s", "time since the last frame arrived")

ESTIMATED_POSITION_W = _declare(("estimate", "position_w"), (3,), "m", "estimate of the position")
ESTIMATED_VELOCITY_W = _declare(("estimate", "velocity_w"), (3,), "m/s", "estimate of the velocity")
ESTIMATED_ATTITUDE_WB = _declare(
    ("estimate", "attitude_wb"), (4,), "-", "estimate of the attitude, body to world"
)
ESTIMATED_BODY_RATE_B = _declare(
    ("estimate", "body_rate_b"), (3,), "rad/s", "estimate of the angular velocity"
)
ESTIMATES = {
    POSITION_W: ESTIMATED_POSITION_W,
    VELOCITY_W: ESTIMATED_VELOCITY_W,
    ATTITUDE_WB: ESTIMATED_ATTITUDE_WB,
    BODY_RATE_B: ESTIMATED_BODY_RATE_B,
}
"""What is estimated: the key of the truth, and that of the estimate, which the policy sees."""

KNOWN_EVIDENCE = _declare(
    ("known", "evidence"),
    ("h", "w"),
    "0.1",
    "log odds that a cell of the map is occupied, as the vehicle has seen it; -128: never seen",
    torch.int8,
)
KNOWN_ESDF = _declare(
    ("known", "esdf"), ("h", "w"), "m", "distance to the nearest cell that is known as occupied"
)

SENSING_STREAM = _declare(
    ("known", "stream"),
    (1,),
    "-",
    "where the sequence of the noise stands with which the map is seen",
    torch.int64,
)
KNOWN_MAP = (KNOWN_EVIDENCE, KNOWN_ESDF)
"""What recordings leave out of how an episode begins: a replay looks again."""

REPLAN_GOAL_W = _declare(("replan", "goal_w"), (3,), "m", "where routes of the episode lead")
REPLAN_CLEARANCE = _declare(
    ("replan", "clearance"), (1,), "m", "what a new route keeps from known obstacles"
)
PENDING_ROUTE_W = _declare(
    ("replan", "pending_route_w"), ("k", 3), "m", "control points of the route that is on its way"
)
PENDING_LENGTH = _declare(
    ("replan", "pending_length"), (1,), "-", "how many of them count", torch.int64
)
PENDING_STEPS = _declare(
    ("replan", "pending_steps"), (1,), "steps", "until it arrives; -1: none is", torch.int64
)
HOVER_W = _declare(("replan", "hover_w"), (3,), "m", "where to wait while no way is known")
REPLAN_STATUS = _declare(
    ("replan", "status"),
    (1,),
    "-",
    "last check of the route: 0 free, 1 blocked and planned again, 2 closed off, 3 search gave up",
    torch.int32,
)
REPLANS = _declare(
    ("replan", "count"), (1,), "-", "routes planned again in the episode", torch.int32
)
REPLAN_OVER = _declare(
    ("replan", "over"), (1,), "-", "the episode is over, and nothing is planned", torch.bool
)
REPLAN_MOVED = _declare(
    ("replan", "moved"),
    (1,),
    "-",
    "start or goal of the route planned in this step were moved out of the clearance",
    torch.bool,
)

LINK_STOPPED = _declare(
    ("link", "stopped"), (1,), "-", "the flight behind a link was stopped", torch.bool
)

TERMINATED = _declare(("terminated",), (1,), "-", "the episode ended in its own right", torch.bool)
TRUNCATED = _declare(("truncated",), (1,), "-", "the episode was cut by the clock", torch.bool)
DONE = _declare(("done",), (1,), "-", "terminated or truncated", torch.bool)
REWARD = _declare(("reward",), (1,), "-", "weighted sum of the reward terms")

SCENE_DIFFICULTY = _declare(
    ("scene", "difficulty"), (1,), "-", "difficulty in [0, 1] that the scene was laid out at"
)
TRAINED_SHARE = _declare(
    ("training", "share"), (1,), "-", "share in [0, 1] of the run's environment steps trained on"
)
CURRICULUM_DIFFICULTY = _declare(
    ("curriculum", "difficulty"), (1,), "-", "difficulty in [0, 1] that a curriculum has reached"
)
EPISODE_DIFFICULTY = _declare(
    ("episode", "difficulty"), (1,), "-", "difficulty that each finished episode was flown at"
)
EPISODE_SUCCESS = _declare(
    ("episode", "success"), (1,), "-", "whether each finished episode succeeded", torch.bool
)

GROUPS = (
    "termination",
    "reward",
    "metric",
    "observation",
    "observation_critic",
    "difficulty",
)
"""First part of the keys that terms name themselves: `(group, name)`."""


AHEAD: NestedKey = ("frame", "ahead")
"""Cosine and sine of the yaw [n, 2] during a step whose observations are turned by it."""


def previous(key: NestedKey) -> NestedKey:
    """The key under which the value that `key` had before the current step is kept."""
    return ("memory", *key)


def difficulty(name: str) -> NestedKey:
    """The key of a named difficulty, [n, 1] in [0, 1], as the episode began with it."""
    return ("difficulty", name)
