"""Every obstacle observation of one pose, one ray and one look-up at a time.

Slow and without cleverness: the truth that the batched versions are compared with.
"""

import math
from dataclasses import dataclass

from scalar_kgp import GAP, Map, cast, guided, polar

CELL = 0.1


@dataclass
class Pose:
    """A pose over a map; `gap` decides ties of the sweep."""

    field: Map
    position: tuple
    velocity: tuple
    points: list
    yaw: float
    gap: float = GAP

    @property
    def here(self):
        return self.position[:2]


def bearing(a, b):
    return math.atan2(b[1] - a[1], b[0] - a[0])


def free_distance(field, here, angle, length=3.0):
    return math.dist(here, cast(field, here, polar(here, length, angle)))


def kgp_esdf(pose, toward="velocity"):
    p, first = pose.position, pose.points[0]
    speed = math.hypot(*pose.velocity)
    ahead = first[:2]
    radius = math.dist(p[:2], first[:2]) + 0.3
    if speed > 1e-6:
        far = math.dist(p, first)
        ahead = tuple(p[i] + pose.velocity[i] / speed * far for i in (0, 1))
        radius = math.dist(p[:2], ahead) + 0.3
    edges = [
        *guided(pose.field, pose.here, ahead, min(radius, 3.0), gap=pose.gap),
        *guided(pose.field, pose.here, first[:2], 2.0, gap=pose.gap),
    ]
    aim = ahead if toward == "velocity" else first
    return [*edges, free_distance(pose.field, pose.here, bearing(pose.here, aim))]


def kgp_esdf_pair(pose):
    first, second = pose.points
    if math.dist(first, second) < 0.01:
        second = first
    numbers = []
    for point in (first, second):
        numbers += guided(pose.field, pose.here, point[:2], 2.0, gap=pose.gap)
        numbers.append(free_distance(pose.field, pose.here, bearing(pose.here, point)))
    angle = bearing(pose.here, first)
    if math.hypot(*pose.velocity) > 1e-6:
        angle = math.atan2(pose.velocity[1], pose.velocity[0])
    return [*numbers, free_distance(pose.field, pose.here, angle)]


def ray_sampling(pose, angles, length):
    numbers = []
    for angle in angles:
        direct = bearing(pose.here, pose.points[0])
        end = cast(pose.field, pose.here, polar(pose.here, length, direct + angle))
        numbers += relative(pose, end)
    return numbers


def ray_search(pose, half_cone=math.pi / 3, count=15, longest=3.0):
    numbers = []
    for point in pose.points:
        length = min(max(math.dist(pose.here, point[:2]), 0.1), longest)
        direct = bearing(pose.here, point)

        def end(angle, direct=direct, length=length):
            return cast(pose.field, pose.here, polar(pose.here, length, direct + angle))

        guide = end(0.0)
        guide_blocked = pose.field.occupied(guide)
        edges, ways = [], []
        for side in (1, -1):
            edge, before = None, guide
            for k in range(1, count + 1):
                hit = end(side * half_cone * k / count)
                blocked = pose.field.occupied(hit)
                if edge is None and blocked != guide_blocked:
                    edge = before if guide_blocked else hit
                    ways.append((k, side < 0, hit))
                before = hit
            edges.append(before if edge is None else edge)
        through = min(ways)[2] if guide_blocked and ways else guide
        numbers += [*relative(pose, edges[0]), *relative(pose, edges[1])]
        numbers += [math.dist(pose.here, guide), *relative(pose, through)]
    return numbers


def esdf_patch(pose, side, spacing, yaw):
    numbers = []
    for row in range(side):
        for column in range(side):
            x, y = (column - (side - 1) / 2) * spacing, ((side - 1) / 2 - row) * spacing
            point = (
                pose.position[0] + math.cos(yaw) * x - math.sin(yaw) * y,
                pose.position[1] + math.sin(yaw) * x + math.cos(yaw) * y,
            )
            numbers.append(pose.field.esdf(point))
    return numbers


def sdf_gradient(pose):
    (x, y), at = pose.here, pose.field.esdf
    slope_x = (at((x + CELL, y)) - at((x - CELL, y))) / (2 * CELL)
    slope_y = (at((x, y + CELL)) - at((x, y - CELL))) / (2 * CELL)
    steepness = math.hypot(slope_x, slope_y)
    if steepness < 1e-4:
        return [at((x, y)), 0.0, 0.0]
    return [at((x, y)), -slope_x / steepness, -slope_y / steepness]


def depth_scan(pose, beams=32, field_of_view=1.566, nearest=0.2, farthest=5.0):
    """Without noise and dropouts."""
    field = pose.field
    seen = Map(field.rows, field.origin, field.truncation, CELL / 2, 2**0.5 * CELL)
    seen.slack = field.slack
    numbers = []
    for beam in range(beams):
        angle = pose.yaw + field_of_view * (0.5 - beam / (beams - 1))
        end = cast(seen, pose.here, polar(pose.here, farthest, angle))
        distance = min(math.dist(pose.here, end), farthest) if seen.occupied(end) else farthest
        numbers.append(0.0 if distance < nearest else distance)
    return numbers


def relative(pose, point):
    return point[0] - pose.here[0], point[1] - pose.here[1]
