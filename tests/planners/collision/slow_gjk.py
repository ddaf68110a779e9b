"""Distances between primitives by alternating projections, and a collision check built on them: slow, but simple."""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import ConvexHull

from irm.chain import BASE, ArmChain
from irm.gjk import CYLINDER, ELLIPSOID, HULL, Solids
from irm.kinematics import fk_frames
from planners.collision.world import SUPPORT_SLACK, CollisionWorld
from planners.scene import SELF_BIT, STATIC_BIT, HeldObject


def project(solids: Solids, i: int, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest point of a core."""
    local = solids.rotation[i].T @ (point - solids.position[i])
    half = solids.half[i]
    if solids.core[i] == CYLINDER:
        local[:2] *= min(1.0, half[0] / max(np.hypot(*local[:2]), 1e-12))
        local[2] = np.clip(local[2], -half[2], half[2])
    elif solids.core[i] == ELLIPSOID:
        local = _project_on_ellipsoid(half, local)
    elif solids.core[i] == HULL:
        local = _project_on_hull(solids.vertices[solids.first[i] : solids.first[i + 1]], local)
    else:
        local = np.clip(local, -half, half)
    return np.asarray(solids.position[i] + solids.rotation[i] @ local)


def _project_on_ellipsoid(half: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """x with x_i = a_i^2 p_i / (a_i^2 + t), where t > 0 solves |x / a| = 1."""

    def excess(t: float) -> float:
        return float(np.sum((half * point / (half**2 + t)) ** 2) - 1)

    if excess(0.0) <= 0:
        return point
    t = brentq(excess, 0.0, float(half.max() * np.linalg.norm(point)), xtol=1e-15)
    return np.asarray(half**2 * point / (half**2 + t))


def _project_on_hull(vertices: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """The quadratic program min |x - p|^2 with x on the inner side of all faces."""
    faces = ConvexHull(vertices).equations
    A, upper = np.ascontiguousarray(faces[:, :3]), -faces[:, 3]
    lower, sense = np.full(len(upper), -1e30), np.zeros(len(upper), dtype=np.int32)
    x, _, flag, _ = daqp.solve(np.eye(3), -point, A, upper.copy(), lower, sense)
    assert flag == 1
    return np.asarray(x)


def distance(a: Solids, i: int, b: Solids, j: int) -> float:
    """Distance between solid i of `a` and j of `b`; radii taken off, so that it may be negative."""
    near = a.position[i]
    for _ in range(4000):
        far = project(b, j, near)
        closer = project(a, i, far)
        if np.abs(closer - near).max() < 1e-11:
            break
        near = closer
    return float(np.linalg.norm(near - far) - a.radius[i] - b.radius[j])


def slow_hits(
    world: CollisionWorld, base: NDArray[np.float64], q: NDArray[np.float64], opening: float, held: HeldObject | None
) -> int:
    """The twin of `configuration_hits`: every primitive against every obstacle, no culling but by spheres."""
    moving = _placed(world, base, q, opening, held)
    robot, count = world.robot, len(world.robot.core)
    carried = () if held is None else (count,)
    hits = 0
    for i in (*range(count), *carried):
        for j, body in enumerate(world.scene.objects):
            if (held is None or body.name != held.name) and _near(moving, i, world.obstacles.pieces, j, world.padding):
                hits |= 1 << j
    for i in (*range(count), *(c + 1 for c in carried)):
        is_low = moving.position[i, 2] - _height(moving, i) < world.padding
        on_base = i < count and robot.link[i] == BASE
        static = range(len(world.scene.static_obstacles))
        if (is_low and not on_base) or any(_near(moving, i, world.obstacles.static, j, world.padding) for j in static):
            hits |= 1 << STATIC_BIT
    pairs = [tuple(pair) for pair in robot.self_pairs]
    pairs += [(i, c) for c in carried for i in range(count) if robot.link[i] < len(robot.offsets) - 1]
    if any(_near(moving, i, moving, j, world.padding) for i, j in pairs):
        hits |= 1 << SELF_BIT
    return hits


def _near(a: Solids, i: int, b: Solids, j: int, padding: float) -> bool:
    if np.linalg.norm(a.position[i] - b.position[j]) > a.bound[i] + b.bound[j] + padding:
        return False
    return distance(a, i, b, j) < padding


def _height(solids: Solids, i: int) -> float:
    """[m] from the centre to the highest point."""
    R, half = solids.rotation[i], solids.half[i]
    if solids.core[i] == CYLINDER:
        return float(abs(R[2, 2]) * half[2] + np.hypot(*R[2, :2]) * half[0] + solids.radius[i])
    return float(np.abs(R[2]) @ half + solids.radius[i])


def _placed(
    world: CollisionWorld, base: NDArray[np.float64], q: NDArray[np.float64], opening: float, held: HeldObject | None
) -> Solids:
    """All primitives in the world; the held object last, twice, the second time with its bottom raised."""
    robot, spec = world.robot, world.scene.robot
    chain = ArmChain.from_robot(spec)
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, q, R, p)
    c, s = np.cos(base[2]), np.sin(base[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    frames = [(turn @ R[k], turn @ p[k] + [*base[:2], 0.0]) for k in range(len(p))]
    frames.append((turn, np.array([*base[:2], 0.0])))
    finger = spec.finger_position(opening)
    rows = []
    for i in range(len(robot.core)):
        frame, origin = frames[robot.link[i]]
        position = origin + frame @ (robot.position[i] + finger * robot.slide[i])
        rows.append(
            (robot.core[i], robot.half[i], robot.radius[i], robot.bound[i], position, frame @ robot.rotation[i])
        )
    if held is not None:
        tcp, origin = frames[-2]
        body, index = world.scene.body(held.name), world.scene.index(held.name)
        core, rotation = world.obstacles.pieces.core[index], held.T_tcp_object[:3, :3]
        bound = float(np.linalg.norm(body.half_extents))
        for raised in (0.0, 0.5 * (world.padding + SUPPORT_SLACK)):
            position = held.T_tcp_object[:3, 3] + raised * rotation[:, 2]
            half = body.half_extents - ([0.0, 0.0, raised] if raised else world.yields)
            rows.append((core, half, 0.0, bound, origin + tcp @ position, tcp @ rotation))
    return Solids(
        *(np.array(column) for column in zip(*rows, strict=True)),
        vertices=np.zeros((0, 3)),
        first=np.zeros(0, dtype=np.int64),
    )
