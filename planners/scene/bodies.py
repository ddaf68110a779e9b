"""Movable objects, their resting poses, the robot's state and its held objects. Immutable, in world coordinates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from planners.scene.solid import BOX_CORNERS, SceneError, Solid, frozen

UPRIGHT_TILT = 0.17
"""[rad] Largest tilt of a standing object."""
Shape = Literal["cylinder", "box", "pieces"]
Array = NDArray[np.float64]
_PAD = 0.004 * np.array([(0.0, 0.0, 0.0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)])
"""[m] Points of a finger pad, in the TCP frame, where the width of an object of several pieces is measured."""
TIP = 0.012
"""[m] Distance beyond these points, where an object held by the fingertips is measured."""
JOINED = 0.002
"""[m] Largest gap on a line between pieces of an object that are joined there."""
_ON_FACE = 0.002
"""[m] Least distance of the centre of mass inside the edges of a face on which an object of several pieces rests."""
_SAME_FACE = 0.02
"""[rad] Angle of two faces of a hull below which they are the same face."""
_FACES = np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], dtype=float)
"""Directions out of the faces of a box, its z axis first. The first two are the ends of a cylinder."""
_DIGITS = 3
"""Decimals of rounded pitches [rad]. The gap under the object absorbs the remainder."""


class UnknownObject(SceneError):
    """No object of that name. The message lists the known objects."""


def pose_matrix(position: ArrayLike, rotation: ArrayLike) -> Array:
    """Make the pose (4, 4) of an origin (3,) and a rotation matrix, (3, 3) or MuJoCo's (9,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(rotation, (3, 3)), position
    return T


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid object, upright or toppled: a cylinder, a box, or several convex pieces, such as a mug with its handle.

    `half_extents` (3,) [m]: for a cylinder radius, radius, half height. `position` (3,) [m] of the centre and
    `quaternion` (4,) wxyz are in the world. For an object of several pieces, these describe the box around it. `pieces`
    are given in the frame of this box, see `of_pieces`. `centre_of_mass` (3,) [m] is in this frame too, or () for its
    origin.
    """

    name: str
    shape: Shape
    half_extents: NDArray[np.float64]
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    pieces: tuple[Solid, ...] = ()
    centre_of_mass: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, size in (("half_extents", 3), ("position", 3), ("quaternion", 4)):
            object.__setattr__(self, name, frozen(getattr(self, name), (size,), f"{name} of {self.name!r}"))
        if self.shape not in ("cylinder", "box", "pieces") or (self.shape == "pieces") != bool(self.pieces):
            raise SceneError(f"{self.name!r} is a {self.shape!r}; known shapes: box, cylinder, or pieces with `pieces`")
        if (self.half_extents <= 0).any() or not np.linalg.norm(self.quaternion) > 0.5:
            raise SceneError(f"{self.name!r} needs positive half extents and a unit quaternion")

    @classmethod
    def of_pieces(
        cls,
        name: str,
        pieces: Iterable[Solid],
        position: ArrayLike = (0, 0, 0),
        quaternion: ArrayLike = (1, 0, 0, 0),
        centre_of_mass: ArrayLike | None = None,
    ) -> Body:
        """Make an object of convex solids, given in a frame at `position` (3,), `quaternion` (4,) wxyz.

        Its `centre_of_mass` (3,) [m] is in this frame. None assumes pieces of one density that do not overlap.

        Example:
            neck = Solid("neck", (0, 0, 0.15), (0.015, 0.015, 0.05), "cylinder")
            bottle = Body.of_pieces("bottle", [Solid("body", (0, 0, 0.05), (0.035, 0.035, 0.05), "cylinder"), neck])

        Raises:
            SceneError: no pieces.
        """
        given = tuple(pieces)
        if not given:
            raise SceneError(f"{name!r} has no pieces")
        low = np.min([piece.lower for piece in given], axis=0)
        high = np.max([piece.upper for piece in given], axis=0)
        middle, turn = (low + high) / 2, np.asarray(quaternion, dtype=float)
        centred = tuple(piece.moved(np.eye(3), -middle) for piece in given)
        if centre_of_mass is None:
            centre_of_mass = np.average([one.position for one in given], 0, [one.volume for one in given])
        heavy = frozen(centre_of_mass, (3,), f"centre of mass of {name!r}") - middle
        body = cls(name, "pieces", (high - low) / 2, np.zeros(3), turn, centred, tuple(heavy.tolist()))
        return body.at(np.asarray(position) + body.rotation @ middle)

    @cached_property
    def rotation(self) -> NDArray[np.float64]:
        """R_world_body (3, 3)."""
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, self.quaternion / np.linalg.norm(self.quaternion))
        matrix.setflags(write=False)
        return matrix.reshape(3, 3)

    @property
    def pose(self) -> NDArray[np.float64]:
        """T_world_body (4, 4)."""
        return pose_matrix(self.position, self.rotation)

    @property
    def yaw(self) -> float:
        """Yaw of the body's x axis about the vertical [rad]."""
        rotation = self.rotation
        return math.atan2(rotation[1, 0], rotation[0, 0])

    @property
    def mass_centre(self) -> NDArray[np.float64]:
        """Centre of mass (3,) in the world [m]."""
        return self.position + self.rotation @ (self.centre_of_mass or (0.0, 0.0, 0.0))

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """Convex solids of the object, in its own frame. A cylinder or box has a single one."""
        if self.shape == "pieces":
            return self.pieces
        return (Solid(self.name, np.zeros(3), self.half_extents, self.shape),)

    @cached_property
    def placed(self) -> tuple[Solid, ...]:
        """Convex solids of the object in the world."""
        return tuple(solid.moved(self.rotation, self.position) for solid in self.solids)

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        """Corners (k, 2) [m], counter-clockwise, of its convex hull seen from above. Round solids become polygons."""
        points = self.corners[:, :2]
        return np.asarray(points[ConvexHull(points).vertices])

    @property
    def piece_outlines(self) -> tuple[Array, ...]:
        """Corners (k, 2) [m] of each solid seen from above, relative to `position`, as in `Solid.outline`.

        They are computed once for each orientation: an object is tried at many locations.
        """
        return _seen_from_above(self.solids, self.rotation.tobytes())[0]

    @property
    def resting_directions(self) -> Array:
        """Directions (k, 3) in its own frame that may point up when it rests on a level plane. A cylinder only
        stands."""
        if self.shape == "pieces":
            return _resting_directions(self.pieces, self.centre_of_mass or (0.0, 0.0, 0.0))
        return _FACES if self.shape == "box" else _FACES[:2]

    def reach(self, direction: ArrayLike) -> float:
        """Distance from the centre to the farthest touching plane in a world `direction` (3,) of unit length [m].

        For a cylinder or a box, the opposite direction has the same distance.
        """
        local = np.asarray(direction, dtype=float) @ self.rotation
        if self.shape == "box":
            return float(np.abs(local) @ self.half_extents)
        if self.shape == "cylinder":
            return float(abs(local[2]) * self.half_extents[2] + math.hypot(local[0], local[1]) * self.half_extents[0])
        return max(float(local @ piece.position + piece.reach(local[None])[0]) for piece in self.pieces)

    def half_extent_along(self, direction: ArrayLike) -> float:
        """Distance from the centre to the farther of the two touching planes perpendicular to a `direction` [m]."""
        if self.shape != "pieces":
            return self.reach(direction)
        return max(self.reach(direction), self.reach(-np.asarray(direction, dtype=float)))

    def width_in_gripper(self, T_tcp_body: ArrayLike) -> float:
        """Width of the body along the line on which the fingers close, held at T_tcp_body (4, 4) [m].

        For an object of several pieces, the width of the part between the pads: a handle, the wall under a rim, or a
        whole bottle.
        """
        T = np.asarray(T_tcp_body, dtype=float)
        if self.shape != "pieces":
            return 2.0 * self.at_pose(T).half_extent_along((0.0, 1.0, 0.0))
        widest = _width_between_pads(self.pieces, T.tobytes())
        return widest if widest > 0.0 else 2.0 * self.at_pose(T).half_extent_along((0.0, 1.0, 0.0))

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Points (k, 3) in the world whose convex hull contains it [m]."""
        return np.concatenate([solid.corners for solid in self.placed])

    @cached_property
    def radius(self) -> float:
        """Radius of the circle about `position` that contains the body's outline seen from above [m]."""
        vertical = self.rotation[2]
        if self.shape == "cylinder":
            half, radius = self.half_extents[2], self.half_extents[0]
            standing, lying = abs(vertical[2]), math.hypot(vertical[0], vertical[1])
            if half * standing < radius * lying:
                return math.hypot(half, radius)
            return float(lying * half + standing * radius)
        if self.shape == "pieces":
            return _seen_from_above(self.pieces, self.rotation.tobytes())[1]
        corners = (BOX_CORNERS * self.half_extents) @ self.rotation.T
        return float(np.hypot(corners[:, 0], corners[:, 1]).max())

    @property
    def half_width(self) -> float:
        """Half width that the fingers must span [m]: a cylinder's radius, or half the wider side of a box."""
        return float(self.half_extents[:2].max())

    @cached_property
    def bottom(self) -> float:
        """Height of the lowest point [m]."""
        return float(self.position[2]) - self.reach((0.0, 0.0, -1.0))

    @cached_property
    def top(self) -> float:
        """Height of the highest point [m]."""
        return float(self.position[2]) + self.reach((0.0, 0.0, 1.0))

    @property
    def foot(self) -> NDArray[np.float64]:
        """Point (3,) under its centre at the height of its lowest point [m]."""
        return np.array([*self.position[:2], self.bottom])

    @cached_property
    def is_upright(self) -> bool:
        """Whether its own z axis points up, within `UPRIGHT_TILT`."""
        return bool(self.rotation[2, 2] > math.cos(UPRIGHT_TILT))

    def at(self, position: ArrayLike, quaternion: ArrayLike | None = None) -> Body:
        """The same object at another position. By default it keeps its orientation."""
        orientation = self.quaternion if quaternion is None else quaternion
        return replace(self, position=np.asarray(position), quaternion=np.asarray(orientation))

    def at_pose(self, T_world_body: NDArray[np.float64]) -> Body:
        """The same object at a pose (4, 4)."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T_world_body[:3, :3]).ravel())
        return self.at(T_world_body[:3, 3], quaternion)

    def lowered(self, distance: float) -> Body:
        """The same object, `distance` [m] lower."""
        return self.at(self.position - [0.0, 0.0, distance]) if distance else self


@dataclass(frozen=True, eq=False)
class RobotState:
    """State of the robot. `base` (3,): x [m], y [m], yaw [rad]. `q` (8,): torso [m] and arm [rad].

    `finger_position` [m]: commanded position of each finger.
    """

    base: NDArray[np.float64]
    q: NDArray[np.float64]
    finger_position: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", frozen(self.base, (3,), "base"))
        object.__setattr__(self, "q", frozen(self.q, (len(self.q),), "q"))
        object.__setattr__(self, "finger_position", float(self.finger_position))


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object between the fingers: its name and T_tcp_object (4, 4)."""

    name: str
    T_tcp_object: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_tcp_object", frozen(self.T_tcp_object, (4, 4), "T_tcp_object"))

    @property
    def key(self) -> tuple[str, bytes]:
        """Key that is equal for the same object in the same place between the fingers."""
        return self.name, self.T_tcp_object.tobytes()

    @classmethod
    def grasped(cls, body: Body, T_world_tcp: NDArray[np.float64]) -> HeldObject:
        """Grasp an object at its present pose with fingers that close at T_world_tcp (4, 4)."""
        return cls(body.name, np.linalg.inv(T_world_tcp) @ body.pose)


@dataclass(frozen=True, eq=False)
class AsideObject:
    """Object that an idle arm holds in its home configuration: the arm's name, and the object in its gripper."""

    arm: str
    held: HeldObject


@dataclass(frozen=True, eq=False)
class ParkedArm:
    """Arm that was active before: its name, and its configuration `q` (n,) [rad], at home up to whole turns."""

    arm: str
    q: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen(self.q, (len(self.q),), "q"))


def up_axis(body: Body) -> Array:
    """Direction (3,) in the world, fixed to the object, that points up once it rests as it lies or stands now.

    Straight up for pieces that stand on a round solid, such as a ball or an egg, or have no face to rest on.
    """
    z_axis = body.rotation[:, 2]
    if body.shape == "cylinder" and abs(z_axis[2]) < math.sqrt(0.5):
        level = np.array((0.0, 0.0, 1.0)) - z_axis[2] * z_axis
        return np.asarray(level / np.linalg.norm(level))
    ups = body.resting_directions @ body.rotation.T
    if body.shape == "pieces":
        lowest = min(body.placed, key=lambda piece: float(piece.lower[2]))
        if not len(ups) or lowest.shape in ("sphere", "ellipsoid", "capsule"):
            return np.array((0.0, 0.0, 1.0))
    return np.asarray(ups[ups[:, 2].argmax()])


def resting_ways(body: Body) -> tuple[Body, ...]:
    """The object at its position, once for each orientation in which it may rest after it has been put down.

    A standing object keeps its orientation. Otherwise it is turned by the smallest angle, first to stand, then onto its
    other sides.
    """
    if body.is_upright:
        return (body,)
    ups = body.resting_directions
    if body.shape == "cylinder":
        ups = np.vstack((ups, up_axis(body) @ body.rotation))
    return tuple(body.at_pose(with_up(body, up)) for up in ups @ body.rotation.T) or (body,)


def leans(body: Body) -> bool:
    """Whether an object neither stands nor lies, within `UPRIGHT_TILT`."""
    turned = [(np.trace(way.rotation.T @ body.rotation) - 1) / 2 for way in resting_ways(body)]
    return bool(max(turned) < math.cos(UPRIGHT_TILT))


def with_up(body: Body, up: Array) -> Array:
    """Pose (4, 4) of an object after the smallest turn that makes its world direction `up` (3,) point up."""
    T, (x, y, z) = body.pose, up
    if z < -1 + 1e-9:
        T[:3, :3] = np.diag((1.0, -1.0, -1.0)) @ T[:3, :3]
        return T
    K = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    T[:3, :3] = (np.eye(3) + K + K @ K / (1.0 + z)) @ T[:3, :3]
    return T


def release_pitch(body: Body, held: HeldObject) -> float:
    """Pitch [rad] of the gripper at which a held object rests on a level plane: standing if possible, or lying.

    It equals the pitch of the grasp if the object stood when it was taken and has not slipped. It is 0 (level) if no
    pitch between level and straight down lets the object rest.
    """
    pitches = (round(math.atan2(-up[0], up[2]), _DIGITS) + 0.0 for up in _resting_axes(body, held.T_tcp_object[:3, :3]))
    return next((pitch for pitch in pitches if -UPRIGHT_TILT <= pitch <= math.pi / 2 + UPRIGHT_TILT), 0.0)


def _resting_axes(body: Body, rotation: Array) -> Iterator[Array]:
    """Directions (3,) in the TCP frame that may point up when the object rests. `rotation` (3, 3) is R_tcp_object.

    The object's own z axis comes first, so that it stands if possible.
    """
    axes = [*(body.resting_directions @ rotation.T)]
    if body.shape == "cylinder":
        lying = np.array((-rotation[2, 2], 0.0, rotation[0, 2]))
        axes += [lying, -lying]
    for axis in axes:
        if abs(axis[1]) < math.sin(UPRIGHT_TILT) and math.hypot(axis[0], axis[2]) > math.sin(UPRIGHT_TILT):
            yield axis


@lru_cache(maxsize=512)
def _seen_from_above(pieces: tuple[Solid, ...], rotation: bytes) -> tuple[tuple[Array, ...], float]:
    """Outlines of pieces, and the radius [m] of all, about the origin of their body. `rotation` holds R_world_body."""
    R = np.frombuffer(rotation).reshape(3, 3)
    placed = [piece.moved(R, np.zeros(3)) for piece in pieces]
    corners = np.concatenate([piece.corners for piece in placed])
    return tuple(piece.outline for piece in placed), float(np.linalg.norm(corners[:, :2], axis=1).max())


@lru_cache(maxsize=4096)
def _width_between_pads(pieces: tuple[Solid, ...], held_at: bytes) -> float:
    """Width [m] of the part of pieces between the pads, 0 for none. `held_at` holds T_tcp_body (4, 4).

    While a placement is searched, the same is asked for each location.
    """
    T = np.frombuffer(held_at).reshape(4, 4)
    for pad in (_PAD, _PAD + (TIP, 0.0, 0.0)):
        points, along = (pad - T[:3, 3]) @ T[:3, :3], np.tile(T[1, :3], (len(pad), 1))
        cuts = np.array([piece.cut(points, along)[:2] for piece in pieces]).transpose(2, 0, 1)
        widest = max(_between_pads(intervals[intervals[:, 0] < intervals[:, 1]]) for intervals in cuts)
        if widest > 0.0:
            return widest
    return 0.0


def _between_pads(intervals: Array) -> float:
    """Width that fingers must span to close on intervals (k, 2) of a line from both sides of its zero [m], 0 for none.

    It covers the joined interval at zero. If zero is in a hollow, it covers the nearest intervals on both sides.
    """
    joined: list[Array] = []
    for low, high in intervals[np.argsort(intervals[:, 0])]:
        if joined and low < joined[-1][1] + JOINED:
            joined[-1][1] = max(joined[-1][1], high)
        else:
            joined.append(np.array((low, high)))
    around = [one for one in joined if one[0] < JOINED and one[1] > -JOINED]
    if not around:
        below, above = [one for one in joined if one[1] < 0], [one for one in joined if one[0] > 0]
        around = [*below[-1:], *above[:1]]
    return 2.0 * max((float(np.abs(one).max()) for one in around), default=0.0)


@lru_cache(maxsize=256)
def _resting_directions(pieces: tuple[Solid, ...], middle: tuple[float, ...]) -> Array:
    """Directions (k, 3) in the frame of pieces that may point up when the pieces rest on a level plane.

    The z axis comes first if they can stand on their bottom, then the directions of the largest faces of the hull.
    """
    hull = ConvexHull(np.concatenate([piece.corners for piece in pieces]))
    normals, corners = hull.equations[:, :3], hull.points[hull.simplices]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    found: list[tuple[float, Array]] = []
    are_same, is_found = normals @ normals.T > math.cos(_SAME_FACE), np.zeros(len(normals), np.bool_)
    for side, (normal, is_same) in enumerate(zip(normals, are_same, strict=True)):
        if is_found[side]:
            continue
        # Project the face and the centre of mass along the face's normal.
        across = np.linalg.svd(normal[None])[2][1:]
        face = ConvexHull(hull.points[np.unique(hull.simplices[is_same])] @ across.T)
        if (face.equations[:, :2] @ (across @ np.array(middle)) + face.equations[:, 2] < -_ON_FACE).all():
            found.append((float(areas[is_same].sum()), -normal))
            is_found |= is_same
    found.sort(key=lambda one: (one[1][2] < math.cos(UPRIGHT_TILT), -round(one[0], 9)))
    return np.array([up for _, up in found]).reshape(-1, 3)
