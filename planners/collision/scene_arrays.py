"""Conversion of a scene's robot, objects and static obstacles to arrays for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets.robots import RobotSpec
from irm.chain import BASE, ArmChain
from irm.gjk import BOX, CYLINDER, ELLIPSOID, HULL, Solids
from irm.ik.arm_solver import SolverArrays
from irm.ik.solvers import solver_arrays
from irm.kernel_arguments import packed
from irm.kinematics import link_frames
from planners.scene import AsideObject, Body, Scene, Solid

Array = NDArray[np.float64]

CORES = {"box": BOX, "cylinder": CYLINDER, "capsule": BOX, "sphere": BOX, "ellipsoid": ELLIPSOID, "hull": HULL}
"""Core of each shape. A capsule is a segment and a sphere a point, both boxes without width, grown by their radius."""
_KNOWN = ("boxes", "capsules", "cylinders", "spheres")


_NO_SOLIDS = Solids(
    core=np.zeros(0, np.int64),
    half=np.zeros((0, 3)),
    radius=np.zeros(0),
    bound=np.zeros(0),
    position=np.zeros((0, 3)),
    rotation=np.zeros((0, 3, 3)),
)


class GeometryError(ValueError):
    """A robot with collision geometry other than boxes, capsules, cylinders and spheres."""


class RobotArrays(NamedTuple):
    """Robot for kernels: a chain of n joints and p collision solids, those of the gripper first. Lengths in metres.

    Attributes:
        offsets: (n, 3 or 12), with `axes` (n,), `tip` (3,), `lower`, `upper` (n,), see `ArmChain`.
        ik: its inverse kinematics.
        core: (p,) BOX or CYLINDER, with half extents `half` (p, 3), grown by `radius` (p,).
        bound: (p,) radius of the bounding sphere about the solid's centre.
        link: (p,) BASE, 0 (torso with head and idle arms) … n - 1, with `position` (p, 3) and `rotation` (p, 3, 3) in
            that link's frame.
        slides: (p,) whether it is part of a finger. `slide` (p, 3): its motion in its link per metre of the finger's
            motion.
        gap: opening of the closed gripper. `slide_end`: upper limit of the finger joints.
        self_pairs: (s, 2) pairs of solids checked for self-collision, on links that are not neighbours.
        held_from: index of the first solid that is checked against the held object. Earlier solids belong to the
            gripper.
        reach: (3 + n,) upper bound of the motion of any point of the robot per radian or metre of each joint.
        tip_reach: (3 + n,) as `reach`, for the TCP alone.
        stands: whether the base is fixed, so that its contacts with static obstacles are ignored.
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
    stands: bool


class Obstacles(NamedTuple):
    """Obstacles for kernels: n objects made of p solids, and m static obstacles. Lengths in metres, in the world.

    Attributes:
        pieces: p solids. Object i has those from `first[i]` up to `first[i + 1]`. `first` is (n + 1,).
        centre: (n, 3) positions of the objects.
        radius, bottom, top: (n,) upright bounding cylinder about each object's position.
        lower, upper: (3,) corners of a box that contains all objects.
        static: m solids, by decreasing height of their tops.
        extent: (m, 3) half extents of the bounding box about the centre of each, along the world's axes.
    """

    pieces: Solids
    first: NDArray[np.int64]
    centre: Array
    radius: Array
    bottom: Array
    top: Array
    lower: Array
    upper: Array
    static: Solids
    extent: Array

    @classmethod
    def of(
        cls, pieces: Solids, first: NDArray[np.int64], upright: tuple[Array, ...], static: Solids, extent: Array
    ) -> Obstacles:
        """Pack objects with their `upright` cylinders (position, radius, bottom, top), and static obstacles."""
        centre, radius, bottom, top = upright
        lower = [*(centre[:, :2] - radius[:, None]).min(axis=0, initial=np.inf), bottom.min(initial=np.inf)]
        upper = [*(centre[:, :2] + radius[:, None]).max(axis=0, initial=-np.inf), top.max(initial=-np.inf)]
        box = np.array(lower), np.array(upper)
        return packed(cls(pieces, first, centre, radius, bottom, top, *box, static, extent))

    def rows(self, index: int) -> range:
        """Rows of an object's solids in `pieces`."""
        return range(int(self.first[index]), int(self.first[index + 1]))


def obstacle_arrays(scene: Scene) -> Obstacles:
    """Convert the objects in the order of their bits, and the static obstacles by decreasing height of their tops."""
    bodies = scene.objects
    upright = np.array([(body.radius, body.bottom, body.top) for body in bodies]).reshape(-1, 3).T.copy()
    static = sorted(scene.static_obstacles, key=lambda obstacle: -(obstacle.position[2] + obstacle.extent[2]))
    solids = [body_solids(body) for body in bodies]
    return Obstacles.of(
        join_solids(solids),
        np.cumsum([0, *(len(one.core) for one in solids)], dtype=np.int64),
        (_rows([body.position for body in bodies]), *upright),
        solid_arrays(static),
        _rows([obstacle.extent for obstacle in static]),
    )


def with_object(obstacles: Obstacles, index: int, body: Body) -> Obstacles:
    """The same obstacles after object number `index` has moved. Its rows in the arrays come from `body`."""

    def put(rows: NDArray[Any], place: int | slice, row: ArrayLike) -> NDArray[Any]:
        """A copy of `rows` with some of them replaced."""
        changed = rows.copy()
        changed[place] = row
        return changed

    rows = obstacles.rows(index)
    place, solids, moved = slice(rows.start, rows.stop), obstacles.pieces, body_solids(body)
    names = ("core", "half", "radius", "bound", "position", "rotation")
    pieces = solids._replace(**{name: put(getattr(solids, name), place, getattr(moved, name)) for name in names})
    upright = (
        put(obstacles.centre, index, body.position),
        put(obstacles.radius, index, body.radius),
        put(obstacles.bottom, index, body.bottom),
        put(obstacles.top, index, body.top),
    )
    return Obstacles.of(pieces, obstacles.first, upright, obstacles.static, obstacles.extent)


def body_solids(body: Body) -> Solids:
    """Solids of an object at its place."""
    if body.shape == "pieces":
        return moved_solids(_piece_arrays(body.pieces), body.rotation, body.position)
    return Solids(
        core=np.array([CORES[body.shape]], dtype=np.int64),
        half=body.half_extents[None],
        radius=np.zeros(1),
        bound=np.array([body_bound(body)]),
        position=body.position[None],
        rotation=body.rotation[None],
    )


def body_bound(body: Body) -> float:
    """Radius of the bounding sphere about an object's centre [m]."""
    half = body.half_extents
    return float(np.hypot(half[0], half[2]) if body.shape == "cylinder" else np.linalg.norm(half))


@lru_cache(maxsize=256)
def _piece_arrays(pieces: tuple[Solid, ...]) -> Solids:
    return solid_arrays(pieces)


def solid_arrays(solids: Sequence[Solid]) -> Solids:
    """Convert convex solids to arrays, in their own frame."""
    is_round = np.array([solid.shape in ("capsule", "sphere") for solid in solids], dtype=bool)
    half = _rows([solid.half_extents for solid in solids])
    radius = np.where(is_round, half[:, 0], 0.0)
    segment = np.column_stack((np.zeros((len(half), 2)), half[:, 2] - half[:, 0]))
    half = np.where(is_round[:, None], segment, half)
    return Solids(
        core=np.array([CORES[solid.shape] for solid in solids], dtype=np.int64),
        half=half,
        radius=radius,
        bound=np.linalg.norm(half, axis=1) + radius,
        position=_rows([solid.position for solid in solids]),
        rotation=np.array([solid.rotation for solid in solids]).reshape(-1, 3, 3),
        vertices=np.concatenate([np.zeros((0, 3)), *(solid.vertices for solid in solids)]),
        first=np.cumsum([0, *(len(solid.vertices) for solid in solids)]),
    )


def join_solids(parts: Sequence[Solids]) -> Solids:
    """Concatenate solids in their order."""
    columns = zip(*(_NO_SOLIDS, *parts), strict=True)
    corners = [np.diff(part.first) if len(part.first) else np.zeros(len(part.core), np.int64) for part in parts]
    first = np.concatenate([np.zeros(1, np.int64), *corners]).cumsum()
    return Solids(*map(np.concatenate, columns))._replace(first=first)


def moved_solids(solids: Solids, rotation: Array, position: Array) -> Solids:
    """Transform solids from a frame at `position` (3,) with axes `rotation` (3, 3) to the outer frame."""
    # One product per row, because products of whole arrays round differently with their length.
    return solids._replace(
        position=_rows([position + rotation @ one for one in solids.position]),
        rotation=np.array([rotation @ one for one in solids.rotation]).reshape(-1, 3, 3),
    )


def shrunk_solids(solids: Solids, by: float | Array, least: float = 0.0) -> Solids:
    """Move the surfaces of n solids inward by up to `by` [m], one number or (n,).

    Half extents of more than `least` [m] stay above it. All corners of a hull move towards its middle.
    """
    if not np.any(by):
        return solids
    inwards, is_grown, is_hull = np.broadcast_to(by, solids.core.shape), solids.radius > 0.0, solids.core == HULL
    smaller = np.minimum(solids.half, np.maximum(solids.half - inwards[:, None], least))
    half = np.where(is_grown[:, None], solids.half, smaller)
    shares = (half / np.maximum(solids.half, 1e-9)).min(axis=1, initial=1.0)
    corners = np.diff(solids.first) if len(solids.first) else np.zeros(len(half), np.int64)
    return solids._replace(
        half=half,
        radius=np.minimum(solids.radius, np.maximum(solids.radius - inwards, least * is_grown)),
        vertices=solids.vertices * np.repeat(np.where(is_hull, shares, 1.0), corners)[:, None],
    )


def _rows(vectors: Sequence[Array]) -> Array:
    return np.array(vectors, dtype=float).reshape(-1, 3)


def robot_of(scene: Scene) -> RobotArrays:
    """Solids of a scene's robot, packed. Objects that idle arms hold become solids of the torso, after all others.

    Raises:
        GeometryError: the robot has collision geometry that cannot be represented.
    """
    arrays = robot_arrays(scene.robot)
    for one in scene.aside:
        arrays = _with_aside(arrays, scene, one)
    return arrays


def _with_aside(arrays: RobotArrays, scene: Scene, one: AsideObject) -> RobotArrays:
    """The robot with an object that an idle arm holds. The boxes around its hulls and ellipsoids replace them."""
    body, chain = scene.body(one.held.name), ArmChain.from_robot(scene.robot.using(one.arm))
    home = next(arm.home for arm in scene.robot.arms if arm.name == one.arm)
    R, p = link_frames(chain, np.array((scene.robot.home[0], *home)))
    T = one.held.T_tcp_object
    position, rotation = R[0].T @ (p[-1] + R[-1] @ T[:3, 3] - p[0]), R[0].T @ R[-1] @ T[:3, :3]
    solids = moved_solids(body_solids(body.at_pose(np.eye(4))), rotation, position)
    count, added, bound = len(arrays.core), len(solids.core), body_bound(body)
    distal = np.flatnonzero(arrays.link > 1)
    pairs = np.array([(solid, count + new) for new in range(added) for solid in distal], np.int64).reshape(-1, 2)
    reach = arrays.reach.copy()
    reach[2] = max(reach[2], float(np.linalg.norm((p[-1] + R[-1] @ T[:3, 3])[:2])) + bound)
    with_object = arrays._replace(
        core=np.append(arrays.core, np.where(solids.core > CYLINDER, BOX, solids.core)),
        half=np.vstack((arrays.half, solids.half)),
        radius=np.append(arrays.radius, solids.radius),
        bound=np.append(arrays.bound, solids.bound),
        link=np.append(arrays.link, np.zeros(added, np.int64)),
        position=np.vstack((arrays.position, solids.position)),
        rotation=np.concatenate((arrays.rotation, solids.rotation)),
        slides=np.append(arrays.slides, np.zeros(added, np.bool_)),
        slide=np.vstack((arrays.slide, np.zeros((added, 3)))),
        self_pairs=np.concatenate((arrays.self_pairs, pairs)),
        reach=reach,
    )
    return packed(with_object)


@cache
def robot_arrays(robot: RobotSpec) -> RobotArrays:
    """Collision solids of a robot, with its head and idle arms in `robot.still_configuration`. Read once, packed.

    Raises:
        GeometryError: its MJCF has a collision geom other than boxes, capsules, cylinders and spheres.
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
        stands=robot.base_drive == "fixed",
    )
    return packed(arrays)


def _reach(chain: ArmChain, link: NDArray[np.int64], position: Array, bound: Array) -> Array:
    """Upper bound of the distance of any turned point from each joint's axis. 1 for slides."""
    solids, reach = list(zip(link, position, bound, strict=True)), np.ones(3 + chain.size)
    reach[2] = max(_leg_length(chain, BASE, 2, *solid) for solid in solids)
    for joint in range(1, chain.size):
        axis = int(chain.axes[joint])
        reach[3 + joint] = max(_leg_length(chain, joint, axis, *solid) for solid in solids if solid[0] >= joint)
    return reach


def _leg_length(chain: ArmChain, joint: int, axis: int, link: int, position: Array, bound: float) -> float:
    """Distance from a joint's axis to the farthest point of a sphere on a later link, with the arm stretched out
    [m]."""
    legs = [*chain.offsets[joint + 1 : link + 1, :3], position]
    across = np.delete(np.arange(3), axis)
    return float(np.linalg.norm(legs[0][across]) + sum(np.linalg.norm(leg) for leg in legs[1:]) + bound)
