"""Where closed fingers push what opens: on a face of one of its parts that looks against the way it is to go.

A drawer is pushed shut at its front, a door at its panel or from behind its handle, a window or a lever at its side.
The fingers touch with their tips, or with one of their sides near the tips; the hand comes along its approach direction
and stops a little short of the face.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.finger_tips import finger_tips, way_of
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import gripper_hits, gripper_rotation
from planners.grasping.families import Family, GraspFamily
from planners.grasping.grasp_poses import GraspPose, even_yaws
from planners.scene import Body, Opening, Scene, Solid
from planners.scene.bodies import pose_matrix
from planners.scene.masks import FIXED_BITS

Array = NDArray[np.float64]

_ALONG, _INSET = 0.6, 0.02
"""Where a part is pushed besides its middle: in half its lengths from there, and [m] from its edges."""
_FACES = 0.8
"""Cosine between a face's normal and the way: a face farther from that would be slid along."""
_FLAT = 0.85
"""Cosine between the way and the side of the fingers that pushes."""
_BACKWARDS = -0.3
"""Cosine between approach and way: fingers that point back would push with the hand before them."""
_DIRECTIONS = 8
"""Yaws of the hand at most, evenly about the way."""
_LEAST_LEVER = 0.5
"""Of the longest lever: nearer to the hinge more force is needed, and the same play of the hand turns it farther."""
_STRONGEST = 40.0
"""[N] of a push at most: below the 50 N that count as pressing hard on furniture."""
_MOST = 16
"""Poses at most: the best of those at which the hand is free."""


@dataclass(frozen=True)
class PushFamily:
    """Pushes of a part of what opens, with the orientations of the hand that families of grasps have."""

    orientations: tuple[Family, ...]
    name: str = "pushed with closed fingers"


def push_poses(
    scene: Scene, body: Body, robot: RobotSpec, families: Sequence[Family], world: CollisionWorld
) -> tuple[GraspPose, ...]:
    """The poses of the hand beside a part of what opens from which closed fingers push it, the best first.

    Args:
        scene: with a `pull` that is a push of this part.
        body: the part.
        robot: whose hand it is.
        families: of whose orientations the hand has one.
        world: the scene, compiled.
    """
    assert scene.pull is not None
    opening, tips = scene.opening(scene.pull.opening), finger_tips(robot)
    longest = max(opening.lever_arm(corner) for piece in body.placed for corner in piece.corners)
    found: list[tuple[float, GraspPose]] = []
    for point, way, off in _contacts(body, opening, scene.pull.position):
        lever = opening.lever_arm(point)
        if opening.kind == "hinge" and lever < max(_LEAST_LEVER * longest, opening.friction / _STRONGEST):
            continue
        if opening.kind == "slide" and opening.friction > _STRONGEST:
            continue
        for yaw, pitch in _orientations(families, way):
            R = gripper_rotation(yaw, pitch)
            flat = float(np.abs(way @ R).max())
            if flat < _FLAT or R[:, 0] @ way < _BACKWARDS:
                continue
            middle = point - way * (tips.reach(R, way) + robot.finger_gap)
            T = pose_matrix(middle - tips.ahead * R[:, 0], R)
            cost = off + (1.0 - flat) + (1.0 - lever / longest if opening.kind == "hinge" else 0.0)
            found.append((cost, GraspPose(math.remainder(yaw, 2 * math.pi), pitch, T, 0.0)))
    if not found:
        return ()
    poses = np.array([(*one.T_world_tcp[:3, 3], one.yaw, one.pitch) for _, one in found])
    # The hand is wider than its fingers: it must not be in the part that these push.
    hits, itself = gripper_hits(world, poses, 0.0), scene.mask([body.name])
    free = [one for one, mask in zip(found, hits, strict=True) if not int(mask) & (FIXED_BITS | itself)]
    return tuple(pose for _, pose in sorted(free, key=lambda one: one[0])[:_MOST])


def face_against(opening: Opening, part: Solid, position: float) -> float:
    """[m²] of the face of a part that looks against its way to a position, as if it were a box; 0 if none does."""
    way = way_of(opening, part.position, position)
    faces = np.abs(part.rotation.T @ way)
    if not faces.any() or faces.max() < _FACES:
        return 0.0
    return float(np.prod(np.delete(2 * part.half_extents, int(faces.argmax()))))


def _contacts(body: Body, opening: Opening, position: float) -> Iterator[tuple[Array, Array, float]]:
    """Points (3,) of a part on faces that look against the way (3,), and how far they are from its middle, 0 to 1."""
    for piece in body.placed:
        for away in itertools.product(*map(_places, piece.half_extents.tolist())):
            inside, shares = piece.position + piece.rotation @ np.array(away), np.array(away) / piece.half_extents
            way = way_of(opening, inside, position)
            if not way.any():
                continue
            enter, leave, _, normal = piece.cut(inside[None], -way[None])
            is_first = away[int(np.abs(piece.rotation.T @ way).argmax())] == 0.0  # others lead to the same point
            if is_first and enter[0] < leave[0] and normal[0] @ -way >= _FACES:
                yield inside - way * leave[0], way, float(np.linalg.norm(shares)) / 4


def _places(half: float) -> list[float]:
    """[m] from the middle of a part of that half length where it is pushed."""
    return [0.0, *(side * away for away in {_ALONG * half, max(half - _INSET, 0.5 * half)} for side in (-1, 1))]


def _orientations(families: Sequence[Family], way: Array) -> list[tuple[float, float]]:
    """Yaws and pitches [rad] of the hand that families of grasps have, each once."""
    found: dict[tuple[float, float], None] = {}
    heading = math.atan2(way[1], way[0]) if math.hypot(way[0], way[1]) > 0.1 else 0.0
    for family in families:
        is_down = math.cos(family.pitch) < 1e-6
        turns_freely = family.directions >= _DIRECTIONS
        yaws = even_yaws(_DIRECTIONS if turns_freely else family.directions) + (heading if turns_freely else 0.0)
        for yaw in yaws[: math.ceil(len(yaws) / 2)] if is_down else yaws:
            yaw = math.remainder(float(yaw), 2 * math.pi)
            limits = family.yaws if isinstance(family, GraspFamily) else None
            if limits is None or limits[0] <= yaw <= limits[1]:
                found[round(yaw, 6), family.pitch] = None
    return list(found)
