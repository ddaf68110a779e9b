"""A scene's robot, objects and static obstacles as arrays for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import ArmChain
from irm.kinematics import fk_frames
from planners.collision.configuration_kernel import Obstacles
from planners.collision.geometry import BOX, CYLINDER, ELLIPSOID, HULL, Solids
from planners.collision.robot_model import RobotArrays, robot_arrays
from planners.scene import AsideObject, Body, Scene, StaticObstacle

__all__ = ["body_bound", "body_core", "obstacle_arrays", "robot_of", "with_object"]

Array = NDArray[np.float64]

_CORES = {
    "box": BOX,
    "cylinder": CYLINDER,
    "capsule": BOX,
    "sphere": BOX,
    "ellipsoid": ELLIPSOID,
    "hull": HULL,
}
"""A capsule is a segment, a sphere a point, both boxes without width, grown by their radius."""


def body_core(body: Body) -> int:
    """BOX or CYLINDER."""
    return _CORES[body.shape]


def body_bound(body: Body) -> float:
    """[m] of the sphere about an object's centre that contains it."""
    half = body.half_extents
    return float(np.hypot(half[0], half[2]) if body.shape == "cylinder" else np.linalg.norm(half))


def obstacle_arrays(scene: Scene) -> Obstacles:
    """The objects in the order of their bits, and the static obstacles, the one with the highest top first."""
    bodies = scene.objects
    static = sorted(scene.static_obstacles, key=lambda obstacle: -(obstacle.position[2] + obstacle.extent[2]))
    corners = np.array(
        [(*(b.position[:2] + s * b.radius), b.top if s > 0 else b.bottom) for b in bodies for s in (-1, 1)]
    )
    nowhere = np.full((1, 3), np.inf)
    return Obstacles(
        objects=Solids(
            core=np.array([body_core(body) for body in bodies], dtype=np.int64),
            half=_rows([body.half_extents for body in bodies]),
            radius=np.zeros(len(bodies)),
            bound=np.array([body_bound(body) for body in bodies], dtype=float),
            position=_rows([body.position for body in bodies]),
            rotation=np.array([body.rotation for body in bodies]).reshape(-1, 3, 3),
            vertices=np.zeros((0, 3)),
            first=np.zeros(0, dtype=np.int64),
        ),
        radius=np.array([body.radius for body in bodies], dtype=float),
        bottom=np.array([body.bottom for body in bodies], dtype=float),
        top=np.array([body.top for body in bodies], dtype=float),
        lower=(corners if bodies else nowhere).min(axis=0),
        upper=(corners if bodies else nowhere).max(axis=0),
        static=_static_solids(static),
        extent=_rows([obstacle.extent for obstacle in static]),
    )


def robot_of(scene: Scene) -> RobotArrays:
    """The solids of a scene's robot; objects that idle arms hold are solids of the torso, behind all others.

    Raises:
        GeometryError: the robot has collision geometry that cannot be represented.
    """
    arrays = robot_arrays(scene.robot)
    for one in scene.aside:
        arrays = _with_aside(arrays, scene, one)
    return arrays


def _with_aside(arrays: RobotArrays, scene: Scene, one: AsideObject) -> RobotArrays:
    body, chain = scene.body(one.held.name), ArmChain.from_robot(scene.robot.using(one.arm))
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, np.array((scene.robot.home[0], *_home(scene, one.arm))), R, p)
    T = one.held.T_tcp_object
    position, rotation = R[0].T @ (p[-1] + R[-1] @ T[:3, 3] - p[0]), R[0].T @ R[-1] @ T[:3, :3]
    bound, added = body_bound(body), len(arrays.core)
    pairs = np.array([(solid, added) for solid in range(added) if arrays.link[solid] > 1], np.int64).reshape(-1, 2)
    reach = arrays.reach.copy()
    reach[2] = max(reach[2], float(np.linalg.norm((p[-1] + R[-1] @ T[:3, 3])[:2])) + bound)
    return arrays._replace(
        core=np.append(arrays.core, body_core(body)),
        half=np.vstack((arrays.half, body.half_extents)),
        radius=np.append(arrays.radius, 0.0),
        bound=np.append(arrays.bound, bound),
        link=np.append(arrays.link, 0),
        position=np.vstack((arrays.position, position)),
        rotation=np.concatenate((arrays.rotation, rotation[None])),
        slides=np.append(arrays.slides, False),
        slide=np.vstack((arrays.slide, np.zeros(3))),
        self_pairs=np.concatenate((arrays.self_pairs, pairs)),
        reach=reach,
    )


def _home(scene: Scene, arm: str) -> tuple[float, ...]:
    """The home configuration of an arm, without the torso."""
    return next(one.home for one in scene.robot.arms if one.name == arm)


def with_object(obstacles: Obstacles, index: int, body: Body) -> Obstacles:
    """The same obstacles with the arrays' rows of one object, number `index`, made from `body`."""

    def put(rows: NDArray[Any], row: ArrayLike) -> NDArray[Any]:
        """A copy of `rows` with one of them replaced."""
        changed = rows.copy()
        changed[index] = row
        return changed

    solids = obstacles.objects
    objects = solids._replace(
        core=put(solids.core, body_core(body)),
        half=put(solids.half, body.half_extents),
        bound=put(solids.bound, body_bound(body)),
        position=put(solids.position, body.position),
        rotation=put(solids.rotation, body.rotation),
    )
    radius, bottom = put(obstacles.radius, body.radius), put(obstacles.bottom, body.bottom)
    top, centre = put(obstacles.top, body.top), objects.position[:, :2]
    return obstacles._replace(
        objects=objects,
        radius=radius,
        bottom=bottom,
        top=top,
        lower=np.array([*(centre - radius[:, None]).min(axis=0), bottom.min()]),
        upper=np.array([*(centre + radius[:, None]).max(axis=0), top.max()]),
    )


def _static_solids(obstacles: Sequence[StaticObstacle]) -> Solids:
    radius = np.array([_radius(obstacle) for obstacle in obstacles], dtype=float)
    half = _rows([_core_half(obstacle) for obstacle in obstacles])
    return Solids(
        core=np.array([_CORES[obstacle.shape] for obstacle in obstacles], dtype=np.int64),
        half=half,
        radius=radius,
        bound=np.linalg.norm(half, axis=1) + radius,
        position=_rows([obstacle.position for obstacle in obstacles]),
        rotation=np.array([obstacle.rotation for obstacle in obstacles]).reshape(-1, 3, 3),
        vertices=np.concatenate([np.zeros((0, 3)), *(obstacle.vertices for obstacle in obstacles)]),
        first=np.cumsum([0, *(len(obstacle.vertices) for obstacle in obstacles)]),
    )


def _radius(obstacle: StaticObstacle) -> float:
    """[m] by which the core is grown."""
    return float(obstacle.half_extents[0]) if obstacle.shape in ("capsule", "sphere") else 0.0


def _core_half(obstacle: StaticObstacle) -> Array:
    """(3,) half extents [m] of the core."""
    half = obstacle.half_extents
    if obstacle.shape in ("capsule", "sphere"):
        return np.array([0.0, 0.0, half[2] - half[0]])
    return half


def _rows(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=float).reshape(-1, 3)
