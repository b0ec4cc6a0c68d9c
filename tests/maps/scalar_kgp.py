"""The obstacle observation one ray at a time, as the fact sheet's pseudo-code (4.3 to 4.5).

Slow and without cleverness: the truth that the batched versions are compared with.
"""

import math

RESOLUTION = 0.1
INFLATION = 0.30
OCCUPIED = 0.29
MARGIN = math.sqrt(2) * INFLATION
SECTOR = math.pi / 3
GAP = 0.9
REACHED = 1e-3


class Map:
    """A distance field as nested lists, row 0 lowest, its lower-left corner at `origin`.

    Distances read at most `truncation`; `occupied` and `margin` are those of what rays meet. A ray
    that has come within `slack` of its length has reached it.
    """

    def __init__(
        self,
        rows,
        origin=(0.0, 0.0),
        truncation=math.inf,
        occupied=OCCUPIED,
        margin=MARGIN,
        resolution=RESOLUTION,
    ):
        self.resolution = resolution
        self.rows, self.origin, self.truncation = rows, origin, truncation
        self.limit, self.margin, self.slack = occupied, margin, 0.0
        self.height, self.width = len(rows), len(rows[0])

    def esdf(self, q):
        column = int((q[0] - self.origin[0]) / self.resolution)
        row = int((q[1] - self.origin[1]) / self.resolution)
        stored = self.rows[min(max(row, 0), self.height - 1)][min(max(column, 0), self.width - 1)]
        return min(stored, self.truncation)

    def holds(self, q):
        x, y = q[0] - self.origin[0], q[1] - self.origin[1]
        return 0 <= x < self.width * self.resolution and 0 <= y < self.height * self.resolution

    def occupied(self, q):
        return self.esdf(q) < self.limit


def cast(field, start, end):
    """Where a ray ends (4.3)."""
    length = math.dist(start, end)
    if length == 0:
        return end
    ux, uy = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    travelled, q = 0.0, start
    while travelled < length - field.slack:
        jump = field.esdf(q) - field.margin
        step = jump if jump >= 0.1 else 0.1
        before = q
        q = (q[0] + step * ux, q[1] + step * uy)
        travelled += step
        if not field.holds(q):
            return before
        if field.occupied(q):
            return q
    return end


def guided(field, p, target, radius=None, gap=GAP):
    """Two edges relative to p, counter-clockwise first (4.4)."""
    if not field.holds(p):
        return (0.0, 0.0, 0.0, 0.0)
    if radius is None:
        radius = math.dist(p, target) + INFLATION
    toward = math.atan2(target[1] - p[1], target[0] - p[0])
    guide_hit = cast(field, p, polar(p, radius, toward))
    guide_free = not field.occupied(guide_hit)
    edges = []
    for side in (1, -1):
        hit = sweep(field, p, radius, toward, side, guide_hit, gap)
        edges += corner(field, p, target, hit, nearest=guide_free)
    return tuple(edges)


def sweep(field, p, radius, toward, side, guide_hit, gap):
    """The point that one side's edge lies at."""
    guide_free = not field.occupied(guide_hit)
    last, last_distance = (p, 0.0) if guide_free else (guide_hit, math.dist(guide_hit, p))
    step, angle = math.atan2(RESOLUTION / 2, radius), 0.0
    while angle < SECTOR:
        angle += step
        end = polar(p, radius, toward + side * angle)
        hit = cast(field, p, end)
        if guide_free:
            last = hit
            if field.occupied(hit):
                return hit
        elif field.occupied(hit):
            distance = math.dist(hit, p)
            if distance - last_distance > gap:
                return last
            last, last_distance = hit, distance
        elif math.dist(hit, end) < REACHED:
            return last
    return last


def corner(field, p, target, hit, *, nearest):
    """The corner of the cell hit with the least or greatest angle to the guide, relative to p."""
    west, south = (
        math.floor((hit[i] - field.origin[i]) / field.resolution) * field.resolution
        + field.origin[i]
        for i in (0, 1)
    )
    corners = [
        (x - p[0], y - p[1]) for x in (west, west + RESOLUTION) for y in (south, south + RESOLUTION)
    ]
    guide = (target[0] - p[0], target[1] - p[1])
    if guide == (0.0, 0.0):
        return corners[0]
    return (min if nearest else max)(corners, key=lambda c: angle_between(c, guide))


def angle_between(a, b):
    product = math.hypot(*a) * math.hypot(*b)
    if product == 0:
        return math.pi / 2
    return math.acos(min(max((a[0] * b[0] + a[1] * b[1]) / product, -1.0), 1.0))


def polar(p, radius, angle):
    return (p[0] + radius * math.cos(angle), p[1] + radius * math.sin(angle))
