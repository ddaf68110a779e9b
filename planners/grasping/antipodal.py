"""Antipodal grasps: level lines through the pieces of an object, on which two opposite faces can be held."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import gripper_hits, gripper_rotation
from planners.grasping.families import AntipodalFamily
from planners.scene import Body, RobotState, Scene, Solid
from planners.scene.bodies import JOINED, TIP, pose_matrix

Array: TypeAlias = NDArray[np.float64]

_BESIDE = 7
"""Lines through one piece beside each other, and above each other, at most."""
_INSET = AntipodalFamily.inset
"""[m] of the highest line on which anything is held, from the end of its piece."""
_THINNEST = 0.001
"""[m] Thinner faces are no piece of an object."""
_OFF_PADS = 0.008
"""[m] by which what is between the pads may be wider than it is on the line."""
_OVERLAP = 0.004
"""[m] by which the fingertips must reach beyond the line on which they hold something."""
_SAME_TOUCH = 0.0005
"""[m] What is so much nearer to the line than what the fingers touch first is touched with it."""
_ALONG, _HIGHER, _ASLANT = 0.5, 0.3, 0.1
"""Cost of a metre from the centre of mass along the line, and upwards, and of a contact across the line instead of
along it, if a metre across the line costs 1: there the weight turns the object between the pads."""
_OPENINGS = 0.005
"""[m] Openings of the gripper are rounded up to multiples of this, to check many grasps at once."""
_DECIMALS, _ROUNDING = 9, 1e-9
_HIGH = 10.0
"""[m] above the ground at which an object is looked at alone."""


class Line(NamedTuple):
    """A grasp: yaw [rad] of the gripper, the TCP (3,) [m], and the width [m] of what is between the pads there."""

    yaw: float
    tcp: Array
    width: float


@dataclass(frozen=True)
class _Shape:
    """An object turned so that its yaw is 0; two are equal if all their numbers are, so that grasps are kept."""

    numbers: bytes
    quaternion: tuple[float, ...]
    body: Body = field(compare=False)

    @classmethod
    def of(cls, body: Body) -> _Shape:
        turn, back = np.empty(4), np.array([math.cos(body.yaw / 2), 0.0, 0.0, -math.sin(body.yaw / 2)])
        mujoco.mju_mulQuat(turn, back, body.quaternion)
        turn = np.round(turn / np.linalg.norm(turn) * (-1.0 if turn[0] < 0 else 1.0), _DECIMALS)
        numbers = [body.half_extents, np.array(body.centre_of_mass)]
        for one in body.solids:
            numbers += [one.position, one.half_extents, one.rotation, one.vertices]
        shapes = " ".join(one.shape for one in body.solids).encode()
        key = b"".join([shapes, *(array.tobytes() for array in numbers)])
        return cls(key, tuple(turn.tolist()), body.at((0.0, 0.0, _HIGH), turn))


def antipodal_lines(
    body: Body, robot: RobotSpec, family: AntipodalFamily, lowest: float, widest: float, pad: float, reach: float
) -> Iterator[Line]:
    """The grasps of a family of an object where it is, direction by direction, the best of each first.

    Args:
        body: the object.
        robot: whose gripper.
        family: pitch, friction cone and lines.
        lowest: [m] of the TCP above the object's lowest point at least.
        widest: [m] Only what is less wide is grasped.
        pad: [m] Half the height of the fingers.
        reach: [m] that the fingertips extend beyond the TCP.
    """
    turn = gripper_rotation(body.yaw, 0.0)
    shape, (least, most) = _Shape.of(body), family.lever
    heavy = shape.body.mass_centre - shape.body.position
    for line in _lines(shape, robot, replace(family, name="", lever=(0.0, math.inf)), lowest, widest, pad, reach):
        if not least <= math.hypot(*(line.tcp - heavy)[:2]) < most:
            continue
        yaw = math.remainder(line.yaw + body.yaw, 2 * math.pi)
        yield Line(yaw, body.position + turn @ line.tcp, line.width)


def highest_line(body: Body) -> float:
    """[m] above its lowest point up to which an object of pieces is held along level lines."""
    pieces = [(float(piece.lower[2]), float(piece.upper[2])) for piece in body.placed]
    return max(high - min(_INSET, (high - low) / 2) for low, high in pieces) - body.bottom


def lowest_line(lowest: float, pitch: float, reach: float) -> float:
    """[m] above an object's lowest point from which on it is held so, the TCP `lowest` [m] above that at least."""
    return lowest - _tip(reach) * math.sin(pitch)


def _tip(reach: float) -> float:
    """[m] ahead of the TCP where the tips hold something, if they extend so far beyond it."""
    return max(min(TIP, reach - _OVERLAP), 0.0)


@lru_cache(maxsize=256)
def _lines(
    shape: _Shape, robot: RobotSpec, family: AntipodalFamily, lowest: float, widest: float, pad: float, reach: float
) -> tuple[Line, ...]:
    """The grasps of an object with yaw 0, relative to its centre."""
    body, is_down = shape.body, math.cos(family.pitch) < 1e-6
    alone = CollisionWorld.from_scene(
        Scene(robot, RobotState(np.zeros(3), np.array(robot.home), 0.0), (body,), (), supports=())
    )
    found: list[Line] = []
    tip = _tip(reach)
    # Straight down, half a turn makes no difference.
    for index in range(math.ceil(family.directions / 2) if is_down else family.directions):
        yaw = math.remainder(index * 2 * math.pi / family.directions, 2 * math.pi)
        spans, rotation = _spans(body, yaw, family, lowest, widest, tip), gripper_rotation(yaw, family.pitch)
        chosen: dict[tuple[int, int], _Span] = {}
        # Where the fingers do not fit as deep as the middle of the pads, their tips may.
        for back in (0.0, tip) if tip else (0.0,):
            there = [one._replace(tcp=one.tcp - back * rotation[:, 0]) for one in spans if one.pieces not in chosen]
            there = [one for one in there if one.tcp[2] > body.bottom + lowest - _ROUNDING]
            free = itertools.compress(there, _free(alone, there, robot, yaw, family.pitch))
            for span in sorted(free, key=lambda one: one.cost):
                if len(chosen) == family.most or span.pieces in chosen:
                    continue
                # All that is between the pads, not on the line alone: nothing may be touched long before.
                width = body.width_in_gripper(np.linalg.inv(pose_matrix(span.tcp, rotation)) @ body.pose)
                if width < min(span.width + _OFF_PADS, widest) and _are_faces(
                    body, span, rotation, (pad, min(TIP, reach)), robot.finger_gap, family.friction
                ):
                    exact = span._replace(width=width)
                    if _free(alone, [exact], robot, yaw, family.pitch, rounded=False)[0]:
                        chosen[span.pieces] = exact
        found += [Line(yaw, span.tcp - body.position, span.width) for span in chosen.values()]
    return tuple(found)


class _Span(NamedTuple):
    """What the pads close on: the TCP, between two points of a line, and the numbers of the pieces there."""

    tcp: Array
    width: float
    pieces: tuple[int, int]
    cost: float


def _spans(body: Body, yaw: float, family: AntipodalFamily, lowest: float, widest: float, tip: float) -> list[_Span]:
    """What can be held along level lines across the heading `yaw`."""
    heading = np.array((math.cos(yaw), math.sin(yaw), 0.0))
    across, up = np.array((-heading[1], heading[0], 0.0)), np.array((0.0, 0.0, 1.0))
    lowest += body.bottom - tip * math.sin(family.pitch)
    grids = [_grid(piece, heading, up, lowest, family) for piece in body.placed]
    places = np.unique(np.concatenate(grids).round(_DECIMALS), axis=0)
    if not len(places):
        return []
    origins = places[:, :1] * heading + places[:, 1:] * up
    cuts = [piece.cut(origins, np.tile(across, (len(origins), 1))) for piece in body.placed]
    enter, leave, before, after = (np.array(column) for column in zip(*cuts, strict=True))
    # How near to the line the outward normals are where it enters, and where it leaves: (pieces, lines).
    into, out = -before @ across, after @ across
    least = math.cos(math.atan(family.friction))
    heavy, found = body.mass_centre, list[_Span]()
    for k, origin in enumerate(origins):
        ends = _joined(enter[:, k], leave[:, k])
        for (low, _, first, _), (_, high, _, last) in itertools.combinations_with_replacement(ends, 2):
            slant = into[first, k], out[last, k]
            if _THINNEST < high - low < widest and min(slant) > least:
                middle = origin + (low + high) / 2 * across
                away = np.abs((heading, across, up) @ (middle - heavy))
                cost = away @ (1.0, _ALONG, _HIGHER) + _ASLANT * (2.0 - sum(slant))
                found.append(_Span(middle, float(high - low), (first, last), round(float(cost), 6)))
    return found


def _grid(piece: Solid, heading: Array, up: Array, lowest: float, family: AntipodalFamily) -> Array:
    """Coordinates (n, 2) [m] along the heading and upwards of lines through a piece, none below the `lowest`."""
    axes, sides = np.stack((heading, up)), list[Array]()
    middle, back, ahead = axes @ piece.position, piece.reach(-axes), piece.reach(axes)
    for least, most, limit in zip(middle - back, middle + ahead, (-math.inf, lowest), strict=True):
        inset = min(family.inset, (most - least) / 2)
        begin, end = max(least + inset, limit), most - inset
        if begin > end:
            return np.zeros((0, 2))
        count = 2 * math.ceil((end - begin) / (2 * family.spacing)) + 1
        sides.append(np.linspace(begin, end, min(count, _BESIDE)))
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)


def _joined(enter: Array, leave: Array) -> list[tuple[float, float, int, int]]:
    """Intervals [m] of a line inside the object, pieces that touch joined: where it enters and leaves, and which."""
    joined: list[tuple[float, float, int, int]] = []
    for piece in np.argsort(enter, kind="stable").tolist():
        low, high = float(enter[piece]), float(leave[piece])
        if low >= high:
            continue
        if joined and low < joined[-1][1] + JOINED:
            before = joined[-1]
            if high > before[1]:
                joined[-1] = (before[0], high, before[2], piece)
        else:
            joined.append((low, high, piece, piece))
    return joined


def _are_faces(body: Body, span: _Span, rotation: Array, pad: tuple[float, float], gap: float, friction: float) -> bool:
    """Whether what the closing fingers touch first, at any height, is as little aslant as what is on the line.

    `pad`: [m] half the height of the fingers, and how far they reach beyond the TCP.
    """
    height, reach = pad
    ahead, high = np.meshgrid(np.linspace(-TIP, reach, 5), np.linspace(-height, height, 9))
    points = span.tcp + np.stack((ahead, 0.0 * ahead, high), axis=-1).reshape(-1, 3) @ rotation.T
    along, half = rotation[:, 1], span.width / 2 + gap
    cuts = [piece.cut(points, np.tile(along, (len(points), 1))) for piece in body.placed]
    enter, leave, before, after = (np.array(column) for column in zip(*cuts, strict=True))
    for out, ends, normals in ((-along, -enter, before), (along, leave, after)):
        ends = np.where((enter < leave) & (ends < half), ends, -np.inf)
        slants = normals[ends > ends.max() - _SAME_TOUCH] @ out
        if slants.max() < math.cos(math.atan(friction)):
            return False
    return True


def _free(
    alone: CollisionWorld, spans: list[_Span], robot: RobotSpec, yaw: float, pitch: float, rounded: bool = True
) -> NDArray[np.bool_]:
    """At which of these the open gripper touches no piece: (n,)."""
    openings = np.array([min(span.width + 2 * robot.finger_gap, robot.max_opening) for span in spans])
    if rounded:
        openings = np.minimum(np.ceil(openings / _OPENINGS) * _OPENINGS, robot.max_opening)
    poses = np.array([(*span.tcp, yaw, pitch) for span in spans])
    free = np.zeros(len(spans), np.bool_)
    for opening in np.unique(openings):
        rows = openings == opening
        free[rows] = gripper_hits(alone, poses[rows], float(opening)) == 0
    return free
