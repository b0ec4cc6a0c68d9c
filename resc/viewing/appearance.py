"""How an episode looks in every viewer: places, colours and curves."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from resc import keys
from resc.maps.constants import INFLATION_M
from resc.math.rotation import euler_from_quaternion
from resc.recording.columns import REWARD_TERMS
from resc.viewing.colours import FAR, FRONT, INFLATED, NEAR, NEXT, OBSTACLE, PASSED, ROTOR
from resc.viewing.episode_scene import EpisodeScene
from resc.viewing.map_picture import SHADE_M
from resc.viewing.scalars import Numbers

TRAIL_STEPS = 5
"""The trail grows by this many steps at a time."""
HEIGHT_M = 2.0
"""Obstacles have no top; they are drawn to here, or to the highest point of the flight."""
WALL_ALPHA = 0.35
"""Opacity of obstacles: what flies behind them is seen."""
SURFACE_M = 0.1
"""Distance between neighbouring points on the surface of an obstacle."""


def rgba(colour: str, alpha: float = 1.0) -> tuple[int, int, int, int]:
    """Bytes of a colour of `resc.viewing.colours`."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue, round(255 * alpha)


def top_of_obstacles(scene: EpisodeScene) -> float:
    """Height [m] to which obstacles are drawn; they have none."""
    flown = float(scene.column(keys.POSITION_W)[:, 2].max())
    return max(HEIGHT_M, flown, float(scene.place.route[:, 2].max()))


def map_centres(scene: EpisodeScene) -> Float[np.ndarray, "n 3"]:
    """Centres of the map's cells [m], row by row, on the ground."""
    place = scene.place
    row, column = np.indices(tuple(place.esdf.shape))
    centres = np.stack((column + 0.5, row + 0.5), -1) * place.resolution + place.origin.numpy()
    return np.pad(centres.reshape(-1, 2), ((0, 0), (0, 1)))


def scene_numbers(scene: EpisodeScene) -> dict[str, Numbers]:
    """The curves of an episode by topic: state, command and reward."""
    attitude = scene.column(keys.ATTITUDE_WB)
    euler = euler_from_quaternion(attitude)
    velocity = scene.column(keys.VELOCITY_W)
    rates, thrust = scene.command
    reward = scene.column(keys.REWARD)[:, 0]
    numbers: dict[str, Numbers] = {
        "/state": {
            "position": _named(scene.column(keys.POSITION_W), "xyz"),
            "velocity": _named(velocity, "xyz"),
            "speed": velocity.norm(dim=-1).numpy(),
            "euler": _named(euler, ("roll", "pitch", "yaw")),
            "body_rate": _named(scene.column(keys.BODY_RATE_B), "xyz"),
        },
        "/command": {
            "body_rate": _named(rates, "xyz"),
            "collective_thrust": thrust[:, 0].numpy(),
            "action": _named(scene.column(keys.ACTION), ("p", "q", "r", "thrust")),
        },
        "/reward": {
            "total": reward.numpy(),
            "so_far": reward.cumsum(0).numpy(),
            "terms": _named(scene.column(REWARD_TERMS), scene.reward_names),
        },
    }
    return numbers | _measured(scene)


def _measured(scene: EpisodeScene) -> dict[str, Numbers]:
    """Curves of what was read and of what was estimated, where there is any."""
    found: dict[str, Numbers] = {}
    seen, guess = scene.path(keys.MOCAP_POSITION_W), scene.path(keys.ESTIMATED_POSITION_W)
    if seen is not None:
        found["/mocap"] = {"position": _named(seen, "xyz")}
    if guess is not None:
        euler = euler_from_quaternion(scene.column(keys.ESTIMATED_ATTITUDE_WB))
        velocity = scene.column(keys.ESTIMATED_VELOCITY_W)
        found["/estimate"] = {
            "position": _named(guess, "xyz"),
            "velocity": _named(velocity, "xyz"),
            "euler": _named(euler, ("roll", "pitch", "yaw")),
            "body_rate": _named(scene.column(keys.ESTIMATED_BODY_RATE_B), "xyz"),
            "position_error": (guess - scene.column(keys.POSITION_W)).norm(dim=-1).numpy(),
            "velocity_error": (velocity - scene.column(keys.VELOCITY_W)).norm(dim=-1).numpy(),
        }
    return found


def _named(values: Tensor, names: Iterable[str]) -> dict[str, Float[np.ndarray, " t"]]:
    return dict(zip(names, values.numpy().T, strict=True))


def rotor_places(scene: EpisodeScene) -> Float[np.ndarray, "4 3"]:
    """Front right, rear right, rear left, front left rotor in the body frame [m]."""
    x, front, rear = scene.vehicle.arm_m
    return np.array([(x, -front, 0.0), (-x, -rear, 0.0), (-x, rear, 0.0), (x, front, 0.0)])


def rotor_radius(arms: Float[np.ndarray, "4 3"]) -> float:
    """Radius [m] at which discs around the rotors nearly touch."""
    return 0.48 * float(min(np.linalg.norm(arms[0] - arms[1]), np.linalg.norm(arms[0] - arms[3])))


def vehicle_ring() -> Float[np.ndarray, "n 3"]:
    """A level circle around the vehicle, body frame [m]: no obstacle should come into it."""
    angle = np.linspace(0, 2 * np.pi, 49)
    return INFLATION_M * np.stack((np.cos(angle), np.sin(angle), 0 * angle), -1)


def rotor_colours() -> list[str]:
    """Colour of each rotor; the front ones stand out."""
    return [FRONT, ROTOR, ROTOR, FRONT]


def rotor_outline(
    arms: Float[np.ndarray, "4 3"],
) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 4"]]:
    """Points on the rotors' circles and along the arms, body frame [m], and their colours."""
    angle = np.arange(0, 2 * np.pi, np.pi / 6)
    circle = rotor_radius(arms) * np.stack((np.cos(angle), np.sin(angle), 0 * angle), -1)
    spokes = np.linspace(0, 1, 5)[:, None]
    places, tints = [], []
    for arm, colour in zip(arms, rotor_colours(), strict=True):
        part = np.concatenate((arm + circle, spokes * arm))
        places.append(part)
        tints.append(np.tile(np.array(rgba(colour), np.uint8), (len(part), 1)))
    return np.concatenate(places), np.concatenate(tints)


def obstacle_surface(box: list[float], top: float) -> Float[np.ndarray, "n 3"]:
    """Points on the sides and the top of an obstacle [m]."""
    x, y, width, depth = box
    along = [
        np.linspace(0, length, max(2, round(length / SURFACE_M) + 1))
        for length in (width, depth, top)
    ]
    i, j, k = np.stack(np.meshgrid(*along, indexing="ij")).reshape(3, -1)
    outside = (i == 0) | (i == width) | (j == 0) | (j == depth) | (k == top)
    return np.stack((x + i, y + j, k), -1)[outside]


def pillar_surface(pillar: list[float], top: float) -> Float[np.ndarray, "n 3"]:
    """Points on the side and the top of a pillar [m]."""
    x, y, radius = pillar
    around = max(8, round(2 * np.pi * radius / SURFACE_M))
    angle = np.arange(around) * (2 * np.pi / around)
    circle = np.stack((np.cos(angle), np.sin(angle)), -1)
    heights = np.linspace(0, top, max(2, round(top / SURFACE_M) + 1))
    side = [np.insert(radius * circle, 2, height, 1) for height in heights]
    rings = np.linspace(0, radius, max(2, round(radius / SURFACE_M) + 1))[:-1]
    lid = [np.insert(ring * circle, 2, top, 1) for ring in rings]
    return np.concatenate((*side, *lid)) + np.array((x, y, 0.0))


def shades(distance: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 4"]:
    """Colours of the map: dark in obstacles, tinted in their inflation, light far from them."""
    share = np.clip(distance / SHADE_M, 0, 1)[..., None]
    near, far = np.array(rgba(NEAR)), np.array(rgba(FAR))
    tint = near + share * (far - near)
    tint = np.where((distance < INFLATION_M)[..., None], rgba(INFLATED), tint)
    return np.where((distance <= 0)[..., None], rgba(OBSTACLE), tint).astype(np.uint8)


def route_colours(scene: EpisodeScene, passed: int) -> list[str]:
    """Colour of each control point: passed, next, ahead."""
    count = len(scene.place.route)
    return [PASSED if n < passed else FRONT if n == passed else NEXT for n in range(count)]
