"""A scene's robot, objects and static obstacles as arrays for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.chain import BASE, ArmChain
from irm.gjk import BOX, CYLINDER, ELLIPSOID, HULL, Solids
from irm.ik.solvers import SolverArrays, solver_arrays
from irm.kernel_arguments import packed
from irm.kinematics import link_frames
from planners.scene import AsideObject, Body, Scene, StaticObstacle

Array = NDArray[np.float64]

CORES = {"box": BOX, "cylinder": CYLINDER, "capsule": BOX, "sphere": BOX, "ellipsoid": ELLIPSOID, "hull": HULL}
"""A capsule is a segment, a sphere a point, both boxes without width, grown by their radius."""
_KNOWN = ("boxes", "capsules", "cylinders", "spheres")


class GeometryError(ValueError):
    """A robot with collision geometry other than boxes, capsules, cylinders and spheres."""


class RobotArrays(NamedTuple):
    """A robot for kernels: a chain of n joints and p collision solids, those of the gripper first. Lengths in metres.

    Attributes:
        offsets: (n, 3 or 12), `axes` (n,), `tip` (3,), `lower`, `upper` (n,): see `ArmChain`.
        ik: its inverse kinematics.
        core: (p,) BOX or CYLINDER; `half` (p, 3) its half extents; `radius` (p,) by which it is grown.
        bound: (p,) radius of the sphere about the solid's centre that contains it.
        link: (p,) BASE, 0 (torso with head and idle arms) … n - 1; `position` (p, 3) and `rotation` (p, 3, 3) in that
            link's frame.
        slides: (p,) whether it is part of a finger; `slide` (p, 3) its motion in its link per metre of that.
        gap: opening of the closed gripper; `slide_end`: upper limit of the finger joints.
        self_pairs: (s, 2) solids checked for self-collision: those on links that are not neighbours.
        held_from: solids from this one on are checked against the held object; those before are the gripper's.
        reach: (3 + n,) upper bound of the motion of any point of the robot per radian or metre of each joint.
        tip_reach: (3 + n,) the same for the TCP alone.
    """

    offsets: NDArray[np.float64]
    axes: NDArray[np.int64]
    tip: NDArray[np.float64]
    ik: SolverArrays
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    core: NDArray[np.int64]
    half: NDArray[np.float64]
    radius: NDArray[np.float64]
    bound: NDArray[np.float64]
    link: NDArray[np.int64]
    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    slides: NDArray[np.bool_]
    slide: NDArray[np.float64]
    gap: float
    slide_end: float
    self_pairs: NDArray[np.int64]
    held_from: int
    reach: NDArray[np.float64]
    tip_reach: NDArray[np.float64]


class Obstacles(NamedTuple):
    """n objects and m static obstacles for kernels. Lengths in metres, in the world.

    Attributes:
        objects: n solids.
        radius, bottom, top: (n,) the upright cylinder about its position that contains each object.
        lower, upper: (3,) corners of a box that contains all objects.
        static: m solids, the one with the highest top first.
        extent: (m, 3) half extents of the box about the centre of each, along the world's axes, that contains it.
    """

    objects: Solids
    radius: Array
    bottom: Array
    top: Array
    lower: Array
    upper: Array
    static: Solids
    extent: Array

    @classmethod
    def of(cls, objects: Solids, upright: tuple[Array, Array, Array], static: Solids, extent: Array) -> Obstacles:
        """Objects with their `upright` cylinders (radius, bottom, top), and static obstacles; packed."""
        (radius, bottom, top), centre = upright, objects.position[:, :2]
        lower = [*(centre - radius[:, None]).min(axis=0, initial=np.inf), bottom.min(initial=np.inf)]
        upper = [*(centre + radius[:, None]).max(axis=0, initial=-np.inf), top.max(initial=-np.inf)]
        return packed(cls(objects, radius, bottom, top, np.array(lower), np.array(upper), static, extent))


def obstacle_arrays(scene: Scene) -> Obstacles:
    """The objects in the order of their bits, and the static obstacles, the one with the highest top first."""
    bodies = scene.objects
    upright = np.array([(body.radius, body.bottom, body.top) for body in bodies]).reshape(-1, 3).T.copy()
    static = sorted(scene.static_obstacles, key=lambda obstacle: -(obstacle.position[2] + obstacle.extent[2]))
    return Obstacles.of(
        objects=Solids(
            core=np.array([CORES[body.shape] for body in bodies], dtype=np.int64),
            half=_rows([body.half_extents for body in bodies]),
            radius=np.zeros(len(bodies)),
            bound=np.array([body_bound(body) for body in bodies], dtype=float),
            position=_rows([body.position for body in bodies]),
            rotation=np.array([body.rotation for body in bodies]).reshape(-1, 3, 3),
        ),
        upright=(upright[0], upright[1], upright[2]),
        static=_static_solids(static),
        extent=_rows([obstacle.extent for obstacle in static]),
    )


def with_object(obstacles: Obstacles, index: int, body: Body) -> Obstacles:
    """The same obstacles with the arrays' rows of one object, number `index`, made from `body`."""

    def put(rows: NDArray[Any], row: ArrayLike) -> NDArray[Any]:
        """A copy of `rows` with one of them replaced."""
        changed = rows.copy()
        changed[index] = row
        return changed

    solids = obstacles.objects
    objects = solids._replace(
        core=put(solids.core, CORES[body.shape]),
        half=put(solids.half, body.half_extents),
        bound=put(solids.bound, body_bound(body)),
        position=put(solids.position, body.position),
        rotation=put(solids.rotation, body.rotation),
    )
    upright = put(obstacles.radius, body.radius), put(obstacles.bottom, body.bottom), put(obstacles.top, body.top)
    return Obstacles.of(objects, upright, obstacles.static, obstacles.extent)


def body_bound(body: Body) -> float:
    """[m] of the sphere about an object's centre that contains it."""
    half = body.half_extents
    return float(np.hypot(half[0], half[2]) if body.shape == "cylinder" else np.linalg.norm(half))


def _static_solids(obstacles: Sequence[StaticObstacle]) -> Solids:
    is_round = np.array([obstacle.shape in ("capsule", "sphere") for obstacle in obstacles], dtype=bool)
    half = _rows([obstacle.half_extents for obstacle in obstacles])
    radius = np.where(is_round, half[:, 0], 0.0)
    segment = np.column_stack((np.zeros((len(half), 2)), half[:, 2] - half[:, 0]))
    half = np.where(is_round[:, None], segment, half)
    return Solids(
        core=np.array([CORES[obstacle.shape] for obstacle in obstacles], dtype=np.int64),
        half=half,
        radius=radius,
        bound=np.linalg.norm(half, axis=1) + radius,
        position=_rows([obstacle.position for obstacle in obstacles]),
        rotation=np.array([obstacle.rotation for obstacle in obstacles]).reshape(-1, 3, 3),
        vertices=np.concatenate([np.zeros((0, 3)), *(obstacle.vertices for obstacle in obstacles)]),
        first=np.cumsum([0, *(len(obstacle.vertices) for obstacle in obstacles)]),
    )


def _rows(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=float).reshape(-1, 3)


def robot_of(scene: Scene) -> RobotArrays:
    """The solids of a scene's robot, packed; objects that idle arms hold are solids of the torso, behind all others.

    Raises:
        GeometryError: the robot has collision geometry that cannot be represented.
    """
    arrays = robot_arrays(scene.robot)
    for one in scene.aside:
        arrays = _with_aside(arrays, scene, one)
    return arrays


def _with_aside(arrays: RobotArrays, scene: Scene, one: AsideObject) -> RobotArrays:
    body, chain = scene.body(one.held.name), ArmChain.from_robot(scene.robot.using(one.arm))
    home = next(arm.home for arm in scene.robot.arms if arm.name == one.arm)
    R, p = link_frames(chain, np.array((scene.robot.home[0], *home)))
    T = one.held.T_tcp_object
    position, rotation = R[0].T @ (p[-1] + R[-1] @ T[:3, 3] - p[0]), R[0].T @ R[-1] @ T[:3, :3]
    bound, added = body_bound(body), len(arrays.core)
    pairs = np.array([(solid, added) for solid in range(added) if arrays.link[solid] > 1], np.int64).reshape(-1, 2)
    reach = arrays.reach.copy()
    reach[2] = max(reach[2], float(np.linalg.norm((p[-1] + R[-1] @ T[:3, 3])[:2])) + bound)
    with_object = arrays._replace(
        core=np.append(arrays.core, CORES[body.shape]),
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
    return packed(with_object)


@cache
def robot_arrays(robot: RobotSpec) -> RobotArrays:
    """The collision solids of a robot, with its head and idle arms in `robot.still_configuration`; read once, packed.

    Raises:
        GeometryError: its MJCF has a collision geom that is no box, capsule, cylinder or sphere.
    """
    chain, shapes = ArmChain.from_robot(robot), robot.shapes
    if np.any(shapes.core > CYLINDER):
        raise GeometryError(f"{robot.name} has a mesh or an ellipsoid, which is none of {', '.join(_KNOWN)}")
    link, bound, slides = shapes.link, shapes.bound, (shapes.opened != 0).any(axis=1)
    arrays = RobotArrays(
        offsets=chain.offsets,
        axes=chain.axes,
        tip=chain.tip,
        ik=solver_arrays(chain),
        lower=chain.lower,
        upper=chain.upper,
        core=shapes.core,
        half=shapes.half,
        radius=shapes.radius,
        bound=bound,
        link=link,
        position=shapes.position,
        rotation=shapes.rotation,
        slides=slides,
        slide=shapes.opened / robot.max_finger_position,
        gap=robot.finger_gap_closed,
        slide_end=robot.max_finger_position,
        self_pairs=shapes.pairs,
        held_from=int(np.argmax(link < chain.size - 1)),
        reach=_reach(chain, link, shapes.position, bound + robot.max_finger_position * slides),
        tip_reach=_reach(chain, np.array([chain.size - 1]), chain.tip[None, :3], np.zeros(1)),
    )
    return packed(arrays)


def _reach(chain: ArmChain, link: NDArray[np.int64], position: Array, bound: Array) -> Array:
    """Per joint, upper bound of the distance from its axis of any point that it turns; 1 for slides."""
    solids, reach = list(zip(link, position, bound, strict=True)), np.ones(3 + chain.size)
    reach[2] = max(_leg_length(chain, BASE, 2, *solid) for solid in solids)
    for joint in range(1, chain.size):
        axis = int(chain.axes[joint])
        reach[3 + joint] = max(_leg_length(chain, joint, axis, *solid) for solid in solids if solid[0] >= joint)
    return reach


def _leg_length(chain: ArmChain, joint: int, axis: int, link: int, position: Array, bound: float) -> float:
    """[m] from the axis of a joint to the farthest point of a sphere on a later link, with the arm stretched out."""
    legs = [*chain.offsets[joint + 1 : link + 1, :3], position]
    across = np.delete(np.arange(3), axis)
    return float(np.linalg.norm(legs[0][across]) + sum(np.linalg.norm(leg) for leg in legs[1:]) + bound)
