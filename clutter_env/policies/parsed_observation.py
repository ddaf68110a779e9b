"""The world as an observation shows it: the robot, and the objects other than the grasped object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.observation import OBSERVATION_LAYOUT
from clutter_env.policies.protocol import PolicyError
from clutter_env.scene.layout import Box
from clutter_env.scene.table_scene import object_name
from irm.rotations import arctan2

Array = NDArray[np.float64]

_ROBOT, _TCP, _GRIPPER, _ROW = (OBSERVATION_LAYOUT[name] for name in ("robot", "tcp", "gripper", "objects"))
_Q = slice(_ROBOT["torso_position"].start, _ROBOT["arm_position"].stop)
_VELOCITY = slice(_ROBOT["base_velocity"].start, _ROBOT["arm_velocity"].stop)
_SIZE = slice(_ROW["half_extents"].start, _ROW["is_box"].stop)
_HELD, _PRESENT = _ROW.index("held"), _ROW.index("present")

Observation: TypeAlias = Mapping[str, NDArray[Any]]
"""One step of `clutter_env/Retrieve-…` with `obs_mode="state"`."""


@dataclass(frozen=True, eq=False)
class ParsedObservation:
    """One observation, or several: arrays have the leading shape (...) of the observations' entries.

    Attributes:
        base: (..., 3) x [m], y [m], yaw [rad] in the world.
        q: (..., 8) torso [m] and arm [rad].
        velocity: (..., 11) of base (in its own frame), torso and arm [m/s, rad/s].
        base_tcp: (..., 4, 4) TCP pose in the base's frame.
        widths: (..., 2) [m] between the pads, as measured and as commanded.
        objects: (..., n, 14) rows of the objects, see `OBJECT_FIELDS`. Positions are in the base's frame.
    """

    base: Array
    q: Array
    velocity: Array
    base_tcp: Array
    widths: Array
    objects: Array

    @cached_property
    def tcp(self) -> Array:
        """(..., 4, 4) TCP pose in the world."""
        return planar_pose(self.base) @ self.base_tcp

    @cached_property
    def whole_body(self) -> Array:
        """(..., 11) base, torso and arm."""
        return np.concatenate((self.base, self.q), axis=-1)

    def position(self, index: int) -> Array:
        """(..., 3) [m] centre of an object in the world."""
        T_world_base = planar_pose(self.base)
        in_base = self.objects[..., index, _ROW["position"]]
        return np.asarray((T_world_base[..., :3, :3] @ in_base[..., None])[..., 0] + T_world_base[..., :3, 3])

    def sizes(self, index: int) -> Array:
        """(..., 4) half extents [m] of an object, and whether it is a box."""
        return np.asarray(self.objects[..., index, _SIZE])

    def is_held(self, index: int) -> Any:
        """Whether the fingers hold an object: a flag, or (...) of them."""
        return self.objects[..., index, _HELD] > 0

    def index(self, name: str) -> int:
        """Row of the object with a name of the environment: "object_00" is row 0.

        Raises:
            PolicyError: no object of that name.
        """
        names = [object_name(row) for row in range(self.objects.shape[-2])]
        if name not in names:
            raise PolicyError(f"no object {name!r} is observed; there are {', '.join(names)}")
        return names.index(name)


def parse_observation(observation: Observation) -> ParsedObservation:
    """Parse an observation, or the observations of an episode, with entries (..., n)."""
    robot, tcp, gripper, rows = (
        np.asarray(observation[name], float) for name in ("robot", "tcp", "gripper", "objects")
    )
    heading = robot[..., _ROBOT["base_heading"]]
    yaw = arctan2(heading[..., :1], heading[..., 1:])
    return ParsedObservation(
        base=np.concatenate((robot[..., _ROBOT["base_position"]], yaw), axis=-1),
        q=robot[..., _Q],
        velocity=robot[..., _VELOCITY],
        base_tcp=pose_of_quaternion(tcp[..., _TCP["position"]], tcp[..., _TCP["quaternion"]]),
        widths=gripper,
        objects=rows.reshape(*rows.shape[:-1], -1, _ROW.size),
    )


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The objects other than the object that is picked or placed: n upright cylinders, and m boxes of furniture.

    Attributes:
        position: (n, 3) [m] centres of the cylinders.
        radius, height: (n,) [m] their radii and half heights.
        core: (n,) [m] radii within which the objects are in any case: one may be a box.
        centre, half: (m, 3) [m] centres and half extents of the boxes.
    """

    position: Array
    radius: Array
    height: Array
    core: Array
    centre: Array
    half: Array

    @classmethod
    def beside(cls, seen: ParsedObservation, index: int, T: Array, boxes: Sequence[Box] = ()) -> Surroundings:
        """Boxes, and all objects of an observation but object `index`, in the frame into which T leads from the base's.

        Args:
            seen: one observation.
            index: of the object that is left out.
            T: (4, 4) from the base's frame.
            boxes: in the frame into which it leads.
        """
        rows = seen.objects
        is_other = rows[:, _PRESENT] > 0
        is_other[index] = False
        half = rows[is_other][:, _ROW["half_extents"]]
        return cls(
            position=rows[is_other][:, _ROW["position"]] @ T[:3, :3].T + T[:3, 3],
            radius=half[:, :2].max(axis=1),
            height=half[:, 2],
            core=half[:, :2].min(axis=1),
            centre=np.array([box.position for box in boxes]).reshape(-1, 3),
            half=np.array([box.half_extents for box in boxes]).reshape(-1, 3),
        )

    def distance(self, points: Array) -> Array:
        """Distance (...) [m] from points (..., 3) to the nearest surface, 0 inside, infinite without any surface."""
        x, y, z = (np.ascontiguousarray(points[..., i]) for i in range(3))
        nearest = np.full(x.shape, np.inf)  # squared; one object after the other is faster than all at once
        for position, radius, height in zip(self.position, self.radius, self.height, strict=True):
            across = np.maximum(np.sqrt((x - position[0]) ** 2 + (y - position[1]) ** 2) - radius, 0.0)
            above = np.maximum(np.abs(z - position[2]) - height, 0.0)
            np.minimum(nearest, across * across + above * above, out=nearest)
        return np.minimum(distance_to_boxes(points, self.centre, self.half), np.sqrt(nearest))

    def contain(self, points: Array) -> bool:
        """Whether any of the points (..., 3) is inside a box or an object for certain."""
        away = points[..., None, :] - self.position
        is_beside = np.hypot(away[..., 0], away[..., 1]) < self.core
        is_in_box = (np.abs(points[..., None, :] - self.centre) < self.half).all(axis=-1)
        return bool((is_beside & (np.abs(away[..., 2]) < self.height)).any() or is_in_box.any())


def distance_to_boxes(points: Array, centre: Array, half: Array) -> Array:
    """Distance (...) [m] from points (..., 3) to the nearest of boxes (m, 3), 0 inside, infinite without any box."""
    axes = [np.ascontiguousarray(points[..., i]) for i in range(3)]
    nearest = np.full(points.shape[:-1], np.inf)  # squared
    for of_box, extent in zip(centre, half, strict=True):
        x, y, z = (np.maximum(np.abs(axes[i] - of_box[i]) - extent[i], 0.0) for i in range(3))
        np.minimum(nearest, x * x + y * y + z * z, out=nearest)
    return np.sqrt(nearest)


def planar_pose(base: Array) -> Array:
    """T_world_base (..., 4, 4) of bases (..., 3) at x, y [m], yaw [rad]."""
    T = np.zeros((*base.shape[:-1], 4, 4))
    cosine, sine = np.cos(base[..., 2]), np.sin(base[..., 2])
    T[..., 0, 0], T[..., 0, 1], T[..., 1, 0], T[..., 1, 1] = cosine, -sine, sine, cosine
    T[..., :2, 3] = base[..., :2]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T


def base_from(origin: Array, base: Array) -> Array:
    """A base (3,) in the world that is given in the frame of another one (3,)."""
    T = planar_pose(origin)
    return np.append(T[:2, :2] @ base[:2] + T[:2, 3], origin[2] + base[2])


def pose_of_quaternion(position: Array, quaternion: Array) -> Array:
    """(..., 4, 4) of positions (..., 3) and unit quaternions (..., 4), wxyz."""
    unit = quaternion / np.sqrt((quaternion * quaternion).sum(axis=-1, keepdims=True))
    w, x, y, z = (unit[..., i] for i in range(4))
    T = np.zeros((*position.shape[:-1], 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    T[..., :3, 3], T[..., 3, 3] = position, 1.0
    return T


def wrapped(angle: Any) -> Any:
    """Angles [rad] in [-π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
