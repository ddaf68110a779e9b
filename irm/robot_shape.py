"""Collision shapes of a robot's model: the radius of its trunk, and tests of its arm against solid boxes.

The base stops in any direction in front of an obstacle, so its outline is a circle. It depends on the heights of the
obstacle: a torso may extend farther than the base below it.

A map knows the floor plan and the arm's joints. It does not know that a low gripper with a rising approach has its
wrist inside the table. Some parts of the arm have the same place in the TCP frame in every configuration. The first
part is the last link. The second are balls inside the link before it, around points of the last joint's axis. The third
is a ball inside the link before that, around the point where the last two axes meet. Where such a part is inside a box,
no base can reach the TCP pose. Fingers block a pose only if they are inside a box both when closed and when open.

The link before the last may be anywhere in the rings through which its corners turn about the last axis. Where a ring
is inside a box, the angles of the last two joints decide, because they place the last two links before the gripper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, inf, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import Robot
from irm.errors import QueryError

if TYPE_CHECKING:
    import mujoco

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
_CORNERS = 48
"""Corners of the polygon around a circle. The polygon is 0.2% larger than the circle."""
_TOUCH = 0.001
"""[m] Penetration up to which solids merely touch. It exceeds the difference of round solids and the polyhedra around
them."""
_MEET = 1e-6
"""[m] Largest distance of two axes that meet."""
_BALL_STEP = 0.01
"""[m] between the balls on the last joint's axis."""


def robot_radius(robot: Robot, low: float = 0.0, high: float = inf) -> float:
    """Radius of the circle around the base's centre that contains base, torso and head between two heights [m].

    It covers all torso heights. The arm is left out, because its place depends on its configuration.

    Args:
        robot: with a model.
        low: lowest point of an obstacle above the floor [m].
        high: its highest point [m].

    Returns:
        The radius [m]. Zero if no part of the robot is between these heights.

    Raises:
        QueryError: the heights are not increasing numbers.

    Example:
        table = FreeSpace.from_boxes([(0.0, 0.0, 0.7, 1.0)], radius=robot_radius(FETCH, 0.0, 0.75) + 0.01)
    """
    if not (isinstance(low, int | float | np.number) and isinstance(high, int | float | np.number) and low < high):
        raise QueryError(f"the heights of an obstacle are two increasing numbers [m], not {low!r} and {high!r}")
    radius = 0.0
    for points, lowered, raised in _trunk(robot):
        bottom, top = float(low) - raised, float(high) - lowered
        # The part of a convex hull between two heights is the hull of its corners there and of its edges' crossings
        # with both heights.
        inside = [points[(points[:, 2] >= bottom) & (points[:, 2] <= top)]]
        for height in (bottom, top):
            below, above = points[points[:, 2] < height], points[points[:, 2] > height]
            if len(below) and len(above):
                share = (height - below[:, None, 2]) / (above[None, :, 2] - below[:, None, 2])
                inside.append((below[:, None] + share[:, :, None] * (above[None] - below[:, None])).reshape(-1, 3))
        x, y, _ = np.concatenate(inside).T
        radius = max(radius, float(np.hypot(x, y).max(initial=0.0)))
    return radius


@lru_cache(maxsize=8)
def _trunk(robot: Robot) -> tuple[tuple[Floats, float, float], ...]:
    """Geoms that do not move with the arm: corners (n, 3) in the base frame with the torso at 0, and the range of
    heights by which the torso lifts them [m]."""
    from irm.self_contact import is_solid  # see `_posed`

    model, data = _posed(robot, {robot.chain[0].joint: 0.0})
    base, torso, arm = model.body(robot.base_body).id, *(int(model.joint(j.joint).bodyid[0]) for j in robot.chain[:2])
    R, origin = data.xmat[base].reshape(3, 3), data.xpos[base]
    parts = []
    for geom in np.flatnonzero(is_solid(model)).tolist():
        body = int(model.geom_bodyid[geom])
        carriers = {body}
        while body:
            body = int(model.body_parentid[body])
            carriers.add(body)
        if base in carriers and arm not in carriers:
            lifted = (robot.chain[0].lower, robot.chain[0].upper) if torso in carriers else (0.0, 0.0)
            parts.append(((_world_corners(model, data, geom) - origin) @ R, *lifted))
    return tuple(parts)


def _posed(robot: Robot, q: dict[str, float]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot's model with joints at given positions, all others at their initial positions."""
    import mujoco  # a function needs the simulator, the package does not

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data = mujoco.MjData(model)
    for name, position in q.items():
        data.joint(name).qpos[0] = position
    mujoco.mj_kinematics(model, data)
    return model, data


def _world_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Floats:
    """(n, 3) points in the world whose convex hull contains a geom."""
    return np.asarray(_geom_corners(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])


def _geom_corners(model: mujoco.MjModel, geom: int) -> Floats:
    """(n, 3) points in the geom's frame whose convex hull contains the geom."""
    import mujoco  # see `_posed`

    from irm.model_reading import hull_corners

    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return hull_corners(model, geom)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _prism(size[0], [-size[1], size[1]])
    if kind in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE):
        half = size[1] if kind == mujoco.mjtGeom.mjGEOM_CAPSULE else 0.0
        return np.concatenate([_ball(size[0]) - (0, 0, half), _ball(size[0]) + (0, 0, half)])
    centre, extent = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.stack(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), axis=-1).reshape(-1, 3)
    return np.asarray(centre + signs * extent)


def _prism(radius: float, heights: list[float]) -> Floats:
    """Corners of a regular prism around a cylinder."""
    angle = np.arange(_CORNERS) * (2 * pi / _CORNERS)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * radius / cos(pi / _CORNERS)
    return np.concatenate([np.column_stack([ring, np.full(_CORNERS, height)]) for height in heights])


def _ball(radius: float) -> Floats:
    """Corners of a polyhedron around a ball: rings of latitude, a step of longitude apart."""
    latitudes = np.linspace(-pi / 2, pi / 2, _CORNERS // 2 + 1)
    rings = [_prism(cos(turn), [np.sin(turn)]) for turn in latitudes]
    return np.concatenate(rings) * (radius / cos(pi / _CORNERS))


class Balls(NamedTuple):
    """n balls: `centres` (f, n, 3) in the TCP frame at f positions of the fingers, and `radii` (n,) [m]."""

    centres: Floats
    radii: Floats


class Forearm(NamedTuple):
    """The two links before the last, with the last two joints at 0, the link nearer to the gripper first.

    `corners`: (n, 3) of each link. `origins` (2, 3) and `axes` (2, 3): those of the joints that follow the links, in
    the TCP frame [m].
    """

    corners: tuple[Floats, Floats]
    origins: Floats
    axes: Floats


@dataclass(frozen=True, eq=False)
class SolidBoxes:
    """Boxes in the world, and balls in the TCP frame that represent parts of a robot's arm.

    Attributes:
        boxes: (k, 7) rows of centre x, y, z, size along x, y, z [m] and yaw [rad].
        filled: balls that the arm certainly fills. Corners have radius 0.
        swept: balls around the rings that the link before the last may fill.
        opened: corners of the open fingers.
        forearm: the two links before the last.

    Example:
        table = SolidBoxes.of(FETCH, [(0.0, 0.0, 0.73, 0.7, 1.0, 0.04)])
        inverse_map.query_path(path, target=cup, pitch=-0.2, solids=table, free_space=floor)
    """

    boxes: Floats
    filled: Balls
    swept: Balls
    opened: Balls
    forearm: Forearm

    @staticmethod
    def of(robot: Robot, boxes: ArrayLike) -> SolidBoxes:
        """Boxes for one robot.

        Args:
            robot: with a model.
            boxes: (k, 6) rows of centre x, y, z and size along x, y, z [m], or (k, 7) with a yaw [rad] last.

        Raises:
            QueryError: these are not rows of 6 or 7 finite numbers, or a size is not positive.
        """
        rule = "boxes are rows of 6 or 7 finite numbers: x, y, z, size x, size y, size z > 0 and, perhaps, yaw"
        try:
            rows = np.asarray(boxes, dtype=float)
        except (TypeError, ValueError):
            raise QueryError(rule) from None
        if rows.ndim != 2 or rows.shape[1] not in (6, 7) or not np.isfinite(rows).all() or np.any(rows[:, 3:6] <= 0):
            raise QueryError(rule)
        return SolidBoxes(np.column_stack([rows, np.zeros((len(rows), 7 - rows.shape[1]))]), *_parts(robot))

    def block(self, T_world_tcp: Floats, pivots: Floats, half_turn: float = 0.0) -> Bools:
        """Whether the arm penetrates a box at each TCP pose, in every configuration that reaches the pose.

        Args:
            T_world_tcp: (n, 4, 4).
            pivots: (n, 2) x, y of vertical axes [m].
            half_turn: [rad]. If positive, the arm must penetrate at every turn of the pose about its pivot by at most
                this angle.

        Returns:
            (n,). False also where only parts that depend on the configuration are inside.
        """
        return self._are_inside(self.filled, T_world_tcp, pivots, half_turn)

    def may_block(self, T_world_tcp: Floats) -> Bools:
        """(n,) whether a collision at the TCP poses (n, 4, 4) may depend on the configuration."""
        return self._are_inside(self.swept, T_world_tcp, T_world_tcp[:, :2, 3], 0.0)

    def block_open_fingers(self, T_world_tcp: Floats) -> Bools:
        """(n,) whether a finger of the open gripper is in a box at the TCP poses (n, 4, 4)."""
        return self._are_inside(self.opened, T_world_tcp, T_world_tcp[:, :2, 3], 0.0)

    def are_clear(self, T_world_tcp: Floats, configurations: Floats) -> Bools:
        """Whether the two links before the gripper are certainly outside all boxes.

        Args:
            T_world_tcp: (4, 4).
            configurations: (k, 1 + n) that reach it.

        Returns:
            (k,). The links nearer to the base are not tested.
        """
        (wrist, forearm), origins, axes = self.forearm
        wrist_angle, last_angle = configurations[:, -2], configurations[:, -1]
        near = _turned(wrist, origins[0], axes[0], -last_angle)
        far = _turned(_turned(forearm, origins[1], axes[1], -wrist_angle), origins[0], axes[0], -last_angle)
        clear = np.ones(len(last_angle), dtype=bool)
        for points in (near, far):
            world = points @ T_world_tcp[:3, :3].T + T_world_tcp[:3, 3]
            for box in self.boxes:
                local, half = _in_box(box, world), box[3:6] / 2 - _TOUCH
                clear &= np.any((local.min(axis=1) > half) | (local.max(axis=1) < -half), axis=1)
        return clear

    def _are_inside(self, balls: Balls, T_world_tcp: Floats, pivots: Floats, half_turn: float) -> Bools:
        """(n,) whether a ball is in a box, at all positions of the fingers."""
        R, origin = T_world_tcp[:, None, :3, :3], T_world_tcp[:, None, :3, 3]
        inside = np.zeros(len(T_world_tcp), dtype=bool)
        for box in self.boxes:
            deep = np.ones((len(T_world_tcp), len(balls.radii)), dtype=bool)
            for centres in balls.centres:
                points = (R @ centres[..., None])[..., 0] + origin
                narrower = np.linalg.norm(points[..., :2] - pivots[:, None], axis=2) * half_turn
                deep &= balls.radii - _distance(box, points, narrower) > _TOUCH
            inside |= deep.any(axis=1)
        return inside


def _distance(box: Floats, points: Floats, narrower: Floats) -> Floats:
    """Distances of points (n, p, 3) from a shrunken box (7,), negative inside [m]. Infinite where the box vanishes.

    `narrower` (n, p): how much each of the four vertical sides moves inward [m].
    """
    local = _in_box(box, points)
    half = np.broadcast_to(box[3:6] / 2, points.shape) - narrower[..., None] * (1.0, 1.0, 0.0)
    beyond = np.abs(local) - half
    outside, inside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1), np.minimum(beyond.max(axis=-1), 0.0)
    return np.where(half.min(axis=-1) > 0.0, outside + inside, np.inf)


def _in_box(box: Floats, points: Floats) -> Floats:
    """Points (..., 3) of the world in the frame of a box (7,)."""
    c, s = np.cos(box[6]), np.sin(box[6])
    return np.asarray((points - box[:3]) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def _turned(points: Floats, origin: Floats, axis: Floats, angles: Floats) -> Floats:
    """Points (n, 3) or (k, n, 3) turned about one line by k angles [rad]: (k, n, 3)."""
    c, s = np.cos(angles)[:, None, None], np.sin(angles)[:, None, None]
    arm = points - origin
    along = (arm @ axis)[..., None] * axis
    return np.asarray(origin + along + c * (arm - along) + s * np.cross(axis, arm))


@lru_cache(maxsize=8)
def _parts(robot: Robot) -> tuple[Balls, Balls, Balls, Forearm]:
    """Balls that the arm certainly fills at a TCP pose, balls that it may fill, open fingers, and the forearm."""
    from irm.self_contact import is_solid  # see `_posed`

    poses = [_posed(robot, dict.fromkeys(robot.finger_joints, at)) for at in (0.0, robot.max_finger_position)]
    model, closed = poses[0]
    site = closed.site(robot.tcp_site)
    tcp, R = site.xpos, site.xmat.reshape(3, 3)
    before, last = (model.joint(link.joint) for link in robot.chain[-2:])
    end = int(last.bodyid[0])
    fingers = [int(model.joint(name).bodyid[0]) for name in robot.finger_joints]

    def shapes(data: mujoco.MjData, *bodies: int) -> list[Floats]:
        """Corners (n, 3) in the TCP frame of every solid rigidly connected with one of the bodies."""
        welded = [model.body_weldid[model.geom_bodyid] == model.body_weldid[body] for body in bodies]
        geoms = [geom for of_body in welded for geom in np.flatnonzero(of_body & is_solid(model)).tolist()]
        return [(_world_corners(model, data, geom) - tcp) @ R for geom in geoms]

    hand = np.array([_corners(shapes(data, end, *fingers)) for _, data in poses])
    tips = _corners(shapes(poses[1][1], *fingers))
    wrist, forearm = (shapes(closed, int(body)) for body in (before.bodyid[0], model.body_parentid[before.bodyid[0]]))
    (second, along_second), (origin, along) = (
        ((closed.xanchor[joint.id] - tcp) @ R, closed.xaxis[joint.id] @ R) for joint in (before, last)
    )
    corners = _corners(wrist)
    places = (corners - origin) @ along
    steps = np.arange(places.min(initial=0.0), places.max(initial=0.0), _BALL_STEP)
    on_axis, meeting = origin + steps[:, None] * along, _meeting_point(second, along_second, origin, along)
    balls, room = np.concatenate([on_axis, meeting]), np.concatenate([_room(wrist, on_axis), _room(forearm, meeting)])
    centres = np.concatenate([hand, np.array([balls[room > 0.0]] * 2)], axis=1)
    filled = Balls(centres, np.concatenate([np.zeros(hand.shape[1]), room[room > 0.0]]))
    rings = origin + places[:, None] * along
    swept = Balls(rings[None], np.linalg.norm(corners - rings, axis=1))
    opened = Balls(tips[None], np.zeros(len(tips)))
    links = corners, _corners(forearm)
    return filled, swept, opened, Forearm(links, np.array([origin, second]), np.array([along, along_second]))


def _corners(shapes: list[Floats]) -> Floats:
    """(n, 3) corners of all shapes."""
    return np.concatenate([np.zeros((0, 3)), *shapes])


def _room(shapes: list[Floats], points: Floats) -> Floats:
    """(n,) radius of the largest ball around each point (n, 3) inside one of the shapes. Negative outside."""
    from scipy.spatial import ConvexHull  # an import of a tenth of a second, for this function alone

    room = np.full(len(points), -np.inf)
    for shape in shapes:
        faces = ConvexHull(shape).equations
        room = np.maximum(room, -(points @ faces[:, :3].T + faces[:, 3]).max(axis=1))
    return room


def _meeting_point(first: Floats, along_first: Floats, second: Floats, along_second: Floats) -> Floats:
    """Intersection (1, 3) of two lines, (0, 3) if they miss each other."""
    normal = np.cross(along_first, along_second)
    apart = second - first
    if normal @ normal < _MEET or abs(apart @ normal) > _MEET * float(np.sqrt(normal @ normal)):
        return np.zeros((0, 3))
    along = np.cross(apart, along_second) @ normal / (normal @ normal)
    return np.asarray([first + along * along_first])
