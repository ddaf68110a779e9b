"""A second judge of goals, from `docs/goals.md` and elementary geometry alone: it shares no code with `planners.goals`.

Every fact gets a number [m]: how far it is from changing; positive if it holds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planners import Scene
from planners.goals import At, Before, Clear, Fact, Goal, Holding, Inside, On

REST, EDGE, RAISED, TILT = 0.005, 0.002, 0.10, 0.17
Array = NDArray[np.float64]


def margin(goal: Goal, scene: Scene, start: Scene) -> float:
    """How far [m] the goal is from changing between holding (positive) and not."""
    return min(Judge(scene, start).margin(fact) for fact in goal.facts)


class Judge:
    """The poses of a scene, and facts about them."""

    def __init__(self, scene: Scene, start: Scene) -> None:
        self.held = set(scene.held_names)
        self.body = {b.name: (b.shape, np.array(b.half_extents), np.array(b.position)) for b in scene.objects}
        self.turn = {b.name: rotation(b.quaternion) for b in scene.objects}
        self.face = {
            o.name: (o.position, o.half_extents, o.position[2] + o.half_extents[2])
            for o in scene.static_obstacles
            if o.name in scene.supports
        }
        self.region = {r.name: r for r in scene.regions}
        self.reach = {name: self.reaches(name) for name in self.body}
        self.start = Judge(start, start) if start is not scene else self

    def margin(self, fact: Fact) -> float:
        match fact:
            case Holding(name):
                return min(1.0 if name in self.held else -1.0, self.low(name) - self.start.low(name) - RAISED + EDGE)
            case On(name, place) if place in self.region:
                return self.margin(Inside(name, place))
            case On(name, place):
                return min(self.rests(name, place), self.centre_over(name, place))
            case Inside(name, place):
                return min(self.rests(name, self.support(place)), EDGE - self.sticks_out(name, place))
            case At(name, x, y, yaw, z, tolerance, yaw_tolerance):
                position = self.body[name][2]
                found = [tolerance - math.hypot(position[0] - x, position[1] - y)]
                if z is not None:
                    found.append(max(tolerance, REST) - abs(position[2] - z))
                if yaw is not None and (self.body[name][0] == "box" or self.tilt(name) > TILT):
                    turned = math.atan2(self.turn[name][1, 0], self.turn[name][0, 0]) - yaw
                    found.append(yaw_tolerance - abs(math.atan2(math.sin(turned), math.cos(turned))))
                over = [one for one in (*self.face, *self.body) if one != name and one not in self.held]
                found.append(max(min(self.rests(name, one), self.centre_over(name, one)) for one in over))
                return min(found)
            case Clear(place):
                return min((-self.occupies(name, place) for name in self.body), default=1.0)
            case Before():
                return 1.0

    def support(self, place: str) -> str:
        return self.region[place].support if place in self.region else place

    def extent(self, name: str, direction: Array) -> float:
        """[m] from the centre to the farthest point along a direction (3,)."""
        shape, half, _ = self.body[name]
        x, y, z = np.abs(self.turn[name].T @ direction)
        return float(half @ (x, y, z)) if shape == "box" else float(half[2] * z + half[0] * math.hypot(x, y))

    def reaches(self, name: str) -> Array:
        """`extent` along all `DIRECTIONS`."""
        shape, half, _ = self.body[name]
        along = np.abs(DIRECTIONS @ self.turn[name])
        if shape == "box":
            return np.asarray(along @ half)
        return np.asarray(half[2] * along[:, 2] + half[0] * np.hypot(along[:, 0], along[:, 1]))

    def low(self, name: str) -> float:
        return float(self.body[name][2][2]) - self.extent(name, np.array([0, 0, 1.0]))

    def high(self, place: str) -> float:
        if place in self.face:
            return float(self.face[place][2])
        return float(self.body[place][2][2]) + self.extent(place, np.array([0, 0, 1.0]))

    def tilt(self, name: str) -> float:
        return math.acos(min(1.0, self.turn[name][2, 2]))

    def rests(self, name: str, place: str) -> float:
        """Whether it stands on a face, upright or as it lay, and on no other one that is nearer."""
        if name in self.held or place in self.held:
            return -1.0
        lay = self.start.tilt(name) > TILT
        return min(self.touches_down(name, place), 1.0 if lay else TILT - self.tilt(name))

    def touches_down(self, name: str, place: str) -> float:
        """Whether its lowest point is at a face, and no other face below its centre is nearer."""
        away = abs(self.low(name) - self.high(place))
        found = [REST - away]
        for other in (*self.face, *self.body):
            if other not in (name, place) and other not in self.held:
                nearer = away - abs(self.low(name) - self.high(other))  # positive: the other one is nearer
                found.append(-min(nearer, self.centre_over(name, other)) if nearer else 1.0)
        return min(found)

    def centre_over(self, name: str, place: str) -> float:
        x, y = self.body[name][2][:2]
        if place in self.face:
            position, half, _ = self.face[place]
            return float(min(half[0] - abs(x - position[0]), half[1] - abs(y - position[1])))
        return float((self.reach[place] - DIRECTIONS @ (self.body[name][2] - self.body[place][2])).min())

    def axes(self, place: str) -> tuple[Array, Array, Array]:
        """Centre (2,), half extents (2,) and axes (2, 3) of a region or a support."""
        if place in self.face:
            return self.face[place][0][:2], self.face[place][1][:2], np.eye(3)[:2]
        region = self.region[place]
        c, s = math.cos(region.yaw), math.sin(region.yaw)
        return np.array(region.centre), np.array(region.half_extents), np.array([(c, s, 0.0), (-s, c, 0.0)])

    def sticks_out(self, name: str, place: str) -> float:
        centre, half, axes = self.axes(place)
        away = np.abs(axes[:, :2] @ (self.body[name][2][:2] - centre))
        return float(max(away[i] + self.extent(name, axes[i]) - half[i] for i in range(2)))

    def occupies(self, name: str, place: str, seen: tuple[str, ...] = ()) -> float:
        """Whether it stands there, or on something that stands on the same support, and overlaps the place."""
        if name in self.held or name in seen:
            return -1.0
        face = self.support(place)
        stands = min(self.touches_down(name, face), self.centre_over(name, face))
        for other in self.body:
            if other != name and other not in self.held:
                on_it = min(REST - abs(self.low(name) - self.high(other)), self.overlap(name, other))
                stands = max(stands, min(on_it, self.occupies(other, face, (*seen, name))))
        if place == face:
            return stands
        centre, half, axes = self.axes(place)
        offset = self.body[name][2][:2] - centre
        cuts = self.reach[name] + np.abs(DIRECTIONS @ axes.T) @ half - np.abs(DIRECTIONS[:, :2] @ offset) - EDGE
        return min(stands, float(cuts.min()))

    def overlap(self, one: str, other: str) -> float:
        offset = self.body[one][2] - self.body[other][2]
        return float((self.reach[one] + self.reach[other] - np.abs(DIRECTIONS @ offset)).min())


DIRECTIONS = np.array([(math.cos(a), math.sin(a), 0.0) for a in np.linspace(0, 2 * math.pi, 180, endpoint=False)])


def rotation(quaternion: Array) -> Array:
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
    )
