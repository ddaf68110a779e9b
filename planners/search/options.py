"""Options of a search and their gains: another view, a moved object with its new place, an opened drawer or door."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.placing.negative_goal_region import SupportGrid, footprint_mask
from planners.regions import Region
from planners.scene import Body, Opening, Scene
from planners.scene.moving import moved
from planners.search.belief import Belief, beside
from planners.search.sight import FIXED, Screens, between

Array = NDArray[np.float64]

_SIDEWAYS = (-1.2, -0.8, -0.5, -0.3, -0.15, 0.0, 0.15, 0.3, 0.5, 0.8, 1.2)
"""Offsets [m] of views along the support's front, from the mean place of the target."""
_STAND_OFF = (0.95, 1.25)
"""Distances [m] of the base centre from the support's front edge."""
_SPOTS, _SPOT_SPACING = 4, 0.06
"""Most spots to propose, and spacing [m] of the tested ones."""
_SPOT_GAP = 0.03
"""Free space [m] around an object at a spot, for the fingers."""
_MOST_POINTS = 1200
"""Most places for weighing options."""
_FEW_POINTS = 300
"""Most places for weighing openings: each needs its own scene."""
_OPEN = 0.5
"""Share of the range from which on a drawer or door is open."""
FULLY = 0.97
"""Share to which drawers and doors are opened: short of their stops."""
_NEARER, _BESIDE = (0.1, 0.2, 0.35), (-0.3, 0.0, 0.3)
"""Distances [m] of the base centre from the front of an open drawer, its handle, and to the side. From there, a camera
looks into the drawer over its front, down to objects right behind it."""


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A base pose (3,), a torso height [m], and the camera position (3,) [m] there.

    `gain` is the probability that the target is in sight from there, `seconds` the time to get there and look.
    """

    base: Array
    torso: float
    eye: Array
    gain: float = 0.0
    seconds: float = 1.0

    @property
    def rate(self) -> float:
        """Probability revealed per second."""
        return self.gain / self.seconds


@dataclass(frozen=True, eq=False)
class Disclosure:
    """A drawer or door that may be opened, others to shut before, and the gain.

    Attributes:
        name: name of the drawer or door.
        shut: names of open drawers and doors that were searched and are shut before.
        view: the best view after it. `gain` is the probability that the target is in sight from there, but from nowhere
            at present. `seconds` is the time to get there and look.
    """

    name: str
    shut: tuple[str, ...]
    view: Viewpoint


class Prospect:
    """Possible places of the target, with the obstacles between them and each viewpoint.

    Attributes:
        points: (m, n, 3) [m], n points of the target at each place.
        bodies: the known objects.
    """

    def __init__(
        self, belief: Belief, places: Mapping[str, NDArray[np.bool_]], scene: Scene, most: int = _MOST_POINTS
    ) -> None:
        """Begin with a limited number of the places (nx, ny) by support."""
        points = belief.points(places)
        stride = math.ceil(len(points) / most) or 1
        self.points, self.bodies = points[::stride], scene.objects
        self._screens = Screens.of(scene.objects, scene.static_obstacles)

    def masks(self, eye: Array) -> NDArray[np.int64]:
        """Masks (m, n) of the obstacles between an eye (3,) and each point."""
        return between(eye, self.points.reshape(-1, 3), self._screens).reshape(self.points.shape[:2])

    def gain(self, eye: Array) -> float:
        """Probability that the target is in sight from an eye (3,)."""
        return float((self.masks(eye) == 0).any(axis=1).mean()) if len(self.points) else 0.0

    def shadows(self, eye: Array) -> dict[str, float]:
        """Probability that each object hides from an eye (3,).

        A place hidden by k objects gives 1/2^(k-1) to each of them. Places hidden by furniture are left out.
        """
        masks = self.masks(eye)
        count = np.where(masks & FIXED, 99, np.bitwise_count(masks))
        least, chosen = count.min(axis=1), masks[np.arange(len(masks)), count.argmin(axis=1)]
        worth = np.where((least > 0) & (least < 99), 0.5 ** (least - 1.0), 0.0)
        return {
            body.name: float((((chosen >> i) & 1) * worth).sum() / max(len(masks), 1))
            for i, body in enumerate(self.bodies)
        }

    def hidden_by(self, body: Body, eyes: Sequence[Array]) -> float:
        """Probability that the target is behind an object at this pose, as a mean over eyes."""
        alone = Screens.of([body], ())
        shares = [(between(eye, self.points.reshape(-1, 3), alone) != 0).mean() for eye in eyes]
        return float(np.mean(shares)) if len(self.points) else 0.0


def viewpoints(scene: Scene, points: Array, eye: Array, torso: tuple[float, float]) -> list[Viewpoint]:
    """Viewpoints in front of the first support: from the present base pose, its front, several sides and heights.

    Args:
        scene: the scene with robot and furniture.
        points: (m, n, 3) [m] points of the places to see.
        eye: (3,) [m] present camera position in the base frame.
        torso: range of the torso's height [m].
    """
    support, state = scene.support, scene.state
    middle = points[..., 1].mean() if len(points) else support.position[1]
    bases = [np.array(state.base)]
    for x in support.lower[0] - np.array(_STAND_OFF):
        for y in middle + np.array(_SIDEWAYS):
            bases.append(np.array((x, y, math.atan2(middle - y, support.position[0] - x))))
    for one in opened(scene):
        bases += _bases_before(scene, one) if one.kind == "slide" else []
    found = []
    for base, height in itertools.product(bases, (torso[0], float(state.q[0]), torso[1])):
        rise = height - state.q[0]
        c, s = math.cos(base[2]), math.sin(base[2])
        there = np.array((base[0] + c * eye[0] - s * eye[1], base[1] + s * eye[0] + c * eye[1], eye[2] + rise))
        found.append(Viewpoint(base, height, there))
    return found


def _bases_before(scene: Scene, drawer: Opening) -> list[Array]:
    """Base poses (3,) in front of an open drawer, near enough to look into it over its front."""
    parts = [one for one in scene.static_obstacles if one.name in drawer.parts]
    lower, upper = np.min([one.lower for one in parts], axis=0), np.max([one.upper for one in parts], axis=0)
    x, y = (lower + upper)[:2] / 2
    return [
        np.array((lower[0] - away, y + aside, math.atan2(-aside, x - lower[0] + away)))
        for away, aside in itertools.product(_NEARER, _BESIDE)
    ]


def disclosures(
    scene: Scene,
    belief: Belief,
    places: Mapping[str, NDArray[np.bool_]],
    eye: Array,
    torso: tuple[float, float],
    seconds: Callable[[Viewpoint], float],
) -> list[Disclosure]:
    """Find drawers and doors whose opening reveals places, each with the view that then reveals most per second.

    Open drawers that cannot hold the target may be shut first. So each result also appears once with these shut.

    Args:
        scene: the present scene.
        belief, places: the possible places of the target.
        eye, torso: as for `viewpoints`.
        seconds: time [s] to get to a viewpoint and look.
    """
    shut = [one for one in scene.openings if one.share < _OPEN]
    if not shut:
        return []
    prospect = Prospect(belief, places, scene, _FEW_POINTS)
    hidden = np.ones(len(prospect.points), np.bool_)
    for view in viewpoints(scene, prospect.points, eye, torso):
        hidden &= (prospect.masks(view.eye) != 0).all(axis=1)
    empty = tuple(one.name for one in opened(scene) if not may_hold(one, places))
    found = []
    for one in shut:
        for others in ((), empty) if empty else ((),):
            there, then = _pulled_to(scene, belief, {**dict.fromkeys(others, 0.0), one.name: FULLY})
            prospect = Prospect(then, places, there, _FEW_POINTS)
            views = [
                replace(view, gain=float(((prospect.masks(view.eye) == 0).any(axis=1) & hidden).mean()))
                for view in viewpoints(there, prospect.points, eye, torso)
            ]
            timed = [replace(view, seconds=seconds(view)) for view in views if view.gain > 0]
            if timed:
                found.append(Disclosure(one.name, others, max(timed, key=lambda view: view.rate)))
    return found


def opened(scene: Scene) -> list[Opening]:
    """Drawers and doors that are open."""
    return [one for one in scene.openings if one.share >= _OPEN]


def may_hold(one: Opening, places: Mapping[str, NDArray[np.bool_]]) -> bool:
    """Whether the target can be in a drawer, or behind a door. A door's parts do not tell which places it hides."""
    return one.kind == "hinge" or any(cells.any() for name, cells in places.items() if name in one.parts)


def _pulled_to(scene: Scene, belief: Belief, shares: Mapping[str, float]) -> tuple[Scene, Belief]:
    """Scene with drawers and doors at other shares, by name, and the belief that has slid with them."""
    for name, share in shares.items():
        one = scene.opening(name)
        position = one.at_share(share)
        scene = moved(scene, name, position)
        if one.kind == "slide":
            belief = belief.slid(one.parts, one.motion(position)[:3, 3])
    return scene, belief


def spots(
    scene: Scene, body: Body, belief: Belief, prospect: Prospect, eyes: Sequence[Array], rng: np.random.Generator
) -> list[Region]:
    """Spots for an object: seen to be free, hiding little of the unseen places, near. Best first."""
    radius = float(np.hypot(*body.half_extents[:2])) if body.shape == "box" else float(body.half_extents[0])
    around = radius + _SPOT_GAP
    others = [one for one in scene.objects if one.name != body.name]
    found: list[tuple[float, Region]] = []
    for name in scene.supports:
        support, grid = scene.support_named(name), belief.grid(name)
        coarse = SupportGrid.over(support, _SPOT_SPACING).centres().reshape(-1, 2)
        taken = footprint_mask(grid, [one for one in others if one.top > support.top], around)
        above = support.top + 2 * body.half_extents[2] + 0.02
        taken |= beside(grid, scene.static_obstacles, support.top + 0.001, above, radius)
        unseen = belief.unseen(name)
        for x, y in coarse:
            inside = min(x - support.lower[0], support.upper[0] - x, y - support.lower[1], support.upper[1] - y)
            if inside < around:
                continue
            i, j = (int(v) for v in np.floor((np.array((x, y)) - (grid.x0, grid.y0)) / grid.resolution))
            near = slice(max(i - 4, 0), i + 5), slice(max(j - 4, 0), j + 5)
            if taken[i, j] or unseen[near].any():
                continue
            there = body.at((x, y, support.top + body.half_extents[2]))
            hidden = prospect.hidden_by(there, eyes)
            away = float(np.hypot(x - body.position[0], y - body.position[1]))
            region = Region("spot", name, (float(x), float(y)), (around, around))
            found.append((round(hidden, 2) + 0.02 * away + 1e-6 * float(rng.random()), region))
    chosen: list[Region] = []
    for _, region in sorted(found, key=lambda one: one[0]):
        if all(math.dist(region.centre, other.centre) > 2 * _SPOT_SPACING for other in chosen):
            chosen.append(region)
        if len(chosen) == _SPOTS:
            break
    return chosen
