"""Check of a scene before planning: objects that are sunk, in the air, or about to topple.

print(check(scene))
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planners.cause import Cause
from planners.collision.world import CollisionWorld, are_near
from planners.regions import RESTING
from planners.scene import Body, Scene, Solid
from planners.scene.findings import Finding, Reason, SceneReport

Array = NDArray[np.float64]

_SUNK = RESTING - 1e-6
"""Depth [m] in furniture from which on an object is sunk, not resting."""
_FALLS = 0.01
"""Fall [m] after which an object is no longer where the plan expects it."""
_STEP, _EXACT = 0.005, 1e-4
"""Step [m] by which an object is moved until it touches, or is clear, and the accuracy [m] of the result."""
_FARTHEST = 0.3
"""Largest depth [m] in furniture that is measured."""
_FOOT, _BESIDE = 0.004, 0.005
"""Height [m] of the foot above the lowest point. Tolerance [m] of the centre of mass beside the foot: outlines of round
shapes are polygons."""
_TURNS = np.linspace(0.0, 2 * np.pi, 180, endpoint=False)
_DIRECTIONS = np.column_stack((np.cos(_TURNS), np.sin(_TURNS)))
_CAUSES = {
    Reason.TOO_HEAVY: Cause.TOO_HEAVY,
    Reason.SLIPPERY: Cause.TOO_SLIPPERY,
}
"""Causes of a refusal, by the finding that makes a plan with the object fail in execution."""


def check(scene: Scene) -> SceneReport:
    """Report what is odd about a scene, with numbers.

    Findings are about objects that are sunk into furniture, float, stand with their centre of mass beside their foot,
    or touch the robot. In scenes read from a simulation, objects may also be too heavy or too slippery for the robot,
    or tied to others. Free bodies without a name are reported, too. A body that floats because it is tied, as by a
    weld, is only reported as tied.

    Args:
        scene: the scene, which is not changed. See `planners.settle` for objects that are in the air or sunk.

    Raises:
        GeometryError: the robot has collision geometry that cannot be represented.
    """
    findings = [*_places(scene, scene.names), *_at_robot(scene), *scene.findings]
    return SceneReport(tuple(sorted(findings, key=lambda one: list(Reason).index(one.reason))))


def hindrance(scene: Scene, names: Collection[str]) -> tuple[Cause, tuple[Finding, ...]] | None:
    """Cause and findings if the robot cannot carry objects of these names. None if it can, as far as is known."""
    report = SceneReport(scene.findings)
    for reason, cause in _CAUSES.items():
        if found := tuple(one for one in report.about(names, (reason,)) if one.is_certain):
            return cause, found
    return None


def not_at_rest(scene: Scene, names: Collection[str]) -> tuple[Finding, ...]:
    """Findings about objects of these names that are sunk into furniture or in the air."""
    return SceneReport(tuple(_places(scene, names))).about(names, (Reason.SUNK, Reason.FLOATING))


def _places(scene: Scene, names: Collection[str]) -> Iterator[Finding]:
    """Findings about the poses of objects, in the order of the scene."""
    tied = {one.object for one in scene.findings if one.reason is Reason.TIED}
    for body in scene.objects:
        if body.name not in names or body.name in scene.held_names or (scene.pull and scene.pull.handle == body.name):
            continue
        around = _around(scene, body)
        depth, into = _depth(scene, body)
        if depth > _SUNK:
            text = f"{body.name}: {_mm(depth)} inside {into}"
            yield Finding(Reason.SUNK, body.name, 1000 * depth, text)
        elif body.name not in tied and (fall := _fall(around, body))[0] > _FALLS:
            height, below = fall
            yield Finding(Reason.FLOATING, body.name, 1000 * height, f"{body.name}: {_mm(height)} above {below}")
        elif (beside := _beside(around, body)) > _BESIDE:
            text = f"{body.name}: its centre of mass is {_mm(beside)} beside what it stands on"
            yield Finding(Reason.UNSTABLE, body.name, 1000 * beside, text)


def _at_robot(scene: Scene) -> Iterator[Finding]:
    world, state = CollisionWorld.from_scene(scene, 0.0), scene.state
    hits = world.hits(state.base, state.q, scene.robot.opening(state.finger_position), scene.held)
    for name in scene.names_of(hits):
        if name not in scene.held_names:
            yield Finding(Reason.TOUCHES_ROBOT, name, 0.0, f"{name}: touches the robot where it stands")


def _around(scene: Scene, body: Body) -> list[tuple[str, tuple[Solid, ...]]]:
    """Names and solids of everything that an object can stand on, except the ground."""
    others = [one for one in scene.objects if one.name not in (body.name, *scene.held_names)]
    static = [(one.name, (one,)) for one in scene.static_obstacles]
    return [*static, *((one.name, one.placed) for one in others)]


def _depth(scene: Scene, body: Body) -> tuple[float, str]:
    """Shortest move [m], up or sideways, out of the static obstacle that an object is deepest in, and its name."""
    deepest, into = 0.0, ""
    for one in scene.static_obstacles:
        if not are_near([one], body, 0.0):
            continue
        level = [axis for axis in one.rotation.T if abs(axis[2]) < 0.5]
        ways = [np.array((0.0, 0.0, 1.0)), *level, *(-axis for axis in level)]
        if any(not are_near([one], body.at(body.position + _SUNK * way), 0.0) for way in ways):
            continue
        depth = min(_until_clear(one, body, way) for way in ways)
        if depth > deepest:
            deepest, into = depth, one.name
    return deepest, into


def _until_clear(one: Solid, body: Body, way: Array) -> float:
    """Move [m] along a unit vector (3,) that frees an object from a solid. Infinite beyond `_FARTHEST`."""
    for low, high in pairwise(np.arange(0.0, _FARTHEST, _STEP)):
        if not are_near([one], body.at(body.position + high * way), 0.0):
            while high - low > _EXACT:
                middle = (low + high) / 2
                if are_near([one], body.at(body.position + middle * way), 0.0):
                    low = middle
                else:
                    high = middle
            return float(high)
    return np.inf


def _fall(around: list[tuple[str, tuple[Solid, ...]]], body: Body) -> tuple[float, str]:
    """Height [m] that an object falls until it touches something, with that name. 0 if it already touches something."""
    below = "the ground"
    if body.bottom <= RESTING or any(are_near(solids, body, RESTING) for _, solids in around):
        return 0.0, below
    low, high = 0.0, body.bottom
    for fallen in np.arange(_STEP, body.bottom, _STEP).tolist():
        touched = [name for name, solids in around if are_near(solids, body.lowered(fallen), 0.0)]
        if touched:
            low, high, below = fallen - _STEP, fallen, touched[0]
            break
    else:
        return high, below
    solids = dict(around)[below]
    while high - low > _EXACT:
        middle = (low + high) / 2
        low, high = (low, middle) if are_near(solids, body.lowered(middle), 0.0) else (middle, high)
    return high, below


def _beside(around: list[tuple[str, tuple[Solid, ...]]], body: Body) -> float:
    """Distance [m] of the centre of mass from the contact area. 0 if the object leans on something, or lies."""
    if body.shape == "cylinder" and not body.is_upright:
        return 0.0
    foot = body.corners[body.corners[:, 2] <= body.bottom + _FOOT][:, :2]
    points = [foot] if body.bottom <= RESTING else []
    for _, solids in around:
        for solid in solids:
            if not are_near([solid], body, RESTING):
                continue
            if float(solid.upper[2]) > body.bottom + RESTING:
                return 0.0
            points.append(_common(foot, solid.outline))
    contact = np.concatenate(points) if points else np.zeros((0, 2))
    if not len(contact):
        return 0.0
    away = _DIRECTIONS @ body.mass_centre[:2] - (_DIRECTIONS @ contact.T).max(axis=1)
    return max(float(away.max()), 0.0)


def _common(points: Array, outline: Array) -> Array:
    """Corners (k, 2) of the intersection of the convex hull of points (n, 2) and a convex outline (m, 2)."""
    centre = points.mean(axis=0)
    around = np.argsort(np.arctan2(*(points - centre).T[::-1]))
    inside, middle = points[around], outline.mean(axis=0)
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        normal = np.array((end[1] - start[1], start[0] - end[0]))
        normal = normal if normal @ (middle - start) <= 0 else -normal
        beyond = (inside - start) @ normal
        kept = []
        for here, there, a, b in zip(inside, np.roll(inside, -1, axis=0), beyond, np.roll(beyond, -1), strict=True):
            kept += [here] if a <= 0 else []
            kept += [here + (there - here) * a / (a - b)] if a * b < 0 else []
        inside = np.array(kept).reshape(-1, 2)
        if not len(inside):
            break
    return inside


def _mm(length: float) -> str:
    return f"{1000 * length:.0f} mm" if np.isfinite(length) else f"more than {1000 * _FARTHEST:.0f} mm"
