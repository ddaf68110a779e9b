"""Motions between two contacts made one: without stops, base and arm together, on a shorter path where one is free.

A pick, a drive and a put-down are planned one by one, each from rest to rest, through the home configuration. Between
the release of one object and the grasp of the next nothing is touched, so only the straight lines near the contacts
have to stay. Between them the straight line in the space of whole-body configurations is taken if it is free, with
blended corners, timed as one motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from planners.collision.hit_kernels import CollisionQuery, path_hits
from planners.collision.scene_arrays import RobotArrays
from planners.collision.world import STEP, CollisionWorld
from planners.motion.arm import tcp_poses
from planners.motion.path import CLEARANCE, SAME_BASE, interpolate
from planners.motion.timing import finger_ramp, near_walls, round_corners, time_parametrise
from planners.motion.trajectory import Phase, Trajectory
from planners.scene import SELF_BIT, HeldObject

Array = NDArray[np.float64]

_KEPT = (0.4, 0.7, 1.0)
"""Shares of a straight line beside a contact that are kept; the smallest that is free is taken."""
_STRAIGHT = 0.5
"""Share of what is kept that stays straight; the rest may be rounded off."""
_BESIDE = 0.03
"""[m] An object is held at its rim or handle if its centre is farther than this to the side of the TCP."""
_SAG = 0.5
"""Height [m] to which such an object is lifted before anything turns, per metre to its centre: a pan turns by 13
degrees between the fingers, and its far side is twice as far away as its centre."""
_HANGS = 0.26
"""[rad] by which such an object turns about the fingers until its far side hangs: the slanting wall of a bowl lies
between the pads then. The corners and what is between them are free with it so, too."""
_TIPS = 0.02
"""[m] above such an object's top: from there down the empty fingers, which have its wall between them, go straight."""
_MOST_CORNERS = 10
"""Between two contacts; a path with more of them is left as it is."""
_HALF_WIDTHS = (0.3, 0.15, 0.07)
"""[s] at full speed before and after a corner that are rounded off, the first for which the path is free."""
_LAG = 2
"""Samples by which fingers may be behind their commands."""
_OFF_LINE = 0.001
"""[m] A driven configuration farther off the planned lines keeps `CLEARANCE`: base and arm lag when both move."""

_TINY = 1e-12
"""[m²] The robot rests there."""


def merge_phases(
    world: CollisionWorld, phases: Sequence[Trajectory], first: HeldObject | None, last: HeldObject | None
) -> list[Trajectory] | None:
    """The same phases on a shorter path, timed as one motion; None if none is found that takes less time.

    The phases keep their shares of the time. The fingers move while the robot does.

    Args:
        world: the scene at this time, compiled.
        phases: consecutive ones in which nothing is grasped or released, at rest at both ends; one phase each.
        first, last: what the fingers are around at the start and at the end.
    """
    path = _shorter_path(world, phases, first, last)
    if path is None:
        return None
    robot, held, steps = world.scene.robot, phases[0].phases[0].held, [len(phase.times) - 1 for phase in phases]
    start, end = phases[0].finger_position[0], phases[-1].finger_position[-1]
    is_near = near_walls(world, robot.opening(max(start, end)))
    timed = time_parametrise(path, robot, start, Phase("", 0.0), bool(held), is_near)
    ramp = finger_ramp(robot, start, end)
    count = len(timed.times) - 1
    if not max(len(ramp) - 1, len(phases)) <= count < sum(steps):
        return None
    bounds, states = _bounds(steps, count), timed.states.copy()
    # The fingers begin to move with the phase in which they did as planned, or else at once, or as late as they can.
    moving, latest = (k for k, phase in enumerate(phases) if np.ptp(phase.finger_position) > 0.0), count + 1 - len(ramp)
    planned = np.vstack([phase.states[:, :-1] for phase in phases])
    for begin in (min(bounds[next(moving, 0)], latest), 0, latest):
        states[:, -1] = np.concatenate([np.full(begin, start), ramp, np.full(latest - begin, end)])
        if held or _fingers_are_free(world, states, planned):
            break
    else:
        return None
    return [
        Trajectory.of_states(states[enter : leave + 1], phase.phases[0])
        for (enter, leave), phase in zip(itertools.pairwise(bounds), phases, strict=True)
    ]


def _fingers_are_free(world: CollisionWorld, states: Array, planned: Array) -> bool:
    """Whether fingers that are not fully open hit nothing on the way (n, 12), up to `_LAG` samples late as they are.

    They are nearer to an object between them than open ones. What is not as planned (m, 11) keeps `CLEARANCE` here too.
    """
    X, widths = states[:, :-1], states[:, -1]
    narrowest = np.array([widths[max(k - _LAG + 1, 0) : k + 2].min() for k in range(len(X) - 1)])
    narrow = np.flatnonzero(narrowest < widths.max())
    if not len(narrow):
        return True
    changed = np.zeros(len(X), bool)
    changed[narrow[0] : narrow[-1] + 2] = _is_changed(world, X[narrow[0] : narrow[-1] + 2], planned)
    clear = world.with_padding(CLEARANCE)
    for (width, is_changed), part in itertools.groupby(narrow, lambda k: (narrowest[k], changed[k] and changed[k + 1])):
        steps = list(part)
        checked, opening = clear if is_changed else world, world.scene.robot.opening(width)
        if checked.path_hits(X[steps[0] : steps[-1] + 2], opening, ignore=1 << SELF_BIT):
            return False
    return True


def _bounds(steps: Sequence[int], last: int) -> list[int]:
    """The numbers of the samples at which phases begin, then `last`: in their shares, one step each at least."""
    shares = np.cumsum([0, *steps]) / max(sum(steps), 1)
    bounds = [max(round(share * last), k) for k, share in enumerate(shares)]
    return [min(bound, last - (len(bounds) - 1 - k)) for k, bound in enumerate(bounds)]


def _shorter_path(
    world: CollisionWorld, phases: Sequence[Trajectory], first: HeldObject | None, last: HeldObject | None
) -> Array | None:
    """Whole-body configurations (n, 11) from the start of the motion to its end; None if no shorter path is found.

    The straight line between what is kept of the lines at both ends, or else a polygon of corners on the planned path.
    """
    # The checks: with the widest opening of the motion, or what is held throughout.
    robot, loaded = world.scene.robot, phases[0].phases[0]
    widest = max(float(phase.finger_position.max()) for phase in phases)
    opening, held = robot.opening(widest), loaded.touched if loaded.held else None
    clear = world.with_padding(CLEARANCE).query(opening, held, 1 << SELF_BIT, first_only=True)
    hanging = None if held is None else _hanging(world, phases[0].states[:1], held)
    hung = (
        clear
        if hanging is None
        else world.with_padding(CLEARANCE).query(opening, hanging, 1 << SELF_BIT, first_only=True)
    )
    checks = _Checks(world, clear, hung, world.query(opening, held, first_only=True))
    at_start, at_end = (
        _straight(world, states, touched, held is not None)
        for states, touched in ((phases[0].states[:1], first), (phases[-1].states[-1:], last))
    )
    keeps = at_start > 0.0 or at_end > 0.0
    starts = list(_lines(world.robot, phases[0].states, first is not None, at_start))
    ends = [line[::-1] for line in _lines(world.robot, phases[-1].states[::-1], last is not None, at_end)]
    for i, j in sorted(itertools.product(range(len(starts)), range(len(ends))), key=sum):
        if checks.is_free(np.stack([starts[i][-1], ends[j][0]])):
            path = checks.rounded(starts[i], np.empty((0, starts[i].shape[1])), ends[j], keeps)
            if path is not None:
                return path
    inner = phases[int(first is not None) : len(phases) - int(last is not None)]
    planned = [phase.states[:, :-1] for phase in inner]
    corners = _corners(checks, np.vstack([starts[-1][-1:], *planned, ends[-1][:1]]))
    return None if corners is None else checks.rounded(starts[-1], corners[1:-1], ends[-1], keeps)


class _Checks(NamedTuple):
    """The collision checks of one motion."""

    world: CollisionWorld
    clear: CollisionQuery  # with `CLEARANCE` as padding, without the robot itself
    hung: CollisionQuery  # the same with what is held as it hangs
    free: CollisionQuery  # with the world's own, with it

    def is_free(self, path: Array) -> bool:
        """Whether a path keeps `CLEARANCE` from all but the robot itself."""
        if path_hits(self.clear, path, STEP):
            return False
        return self.hung is self.clear or not path_hits(self.hung, path, STEP)

    def rounded(self, start: Array, corners: Array, end: Array, keeps: bool) -> Array | None:
        """The path along two lines and by corners between them, its corners rounded; None if it is not free.

        Corners within the straight parts of the lines are rounded too if that is free, unless `keeps`.
        """
        polygon = np.vstack([start, corners, end])
        first, last = len(start) - 1, len(polygon) - len(end)
        only_between = max(first - 1, 0), min(last + 1, len(polygon) - 1)
        for begin, stop in ((0, len(polygon) - 1), only_between)[keeps:]:
            for half_width in _HALF_WIDTHS:
                smooth, at = round_corners(self.world.scene.robot, polygon[begin : stop + 1], half_width)
                path = np.vstack([polygon[:begin], smooth, polygon[stop + 1 :]])
                at = np.concatenate([np.arange(begin), at + begin, np.arange(stop + 1, len(polygon))])
                on_polygon = interpolate(at, np.arange(len(polygon)), polygon)
                is_off = np.abs(path - on_polygon) @ self.world.robot.reach > _OFF_LINE
                drives = np.abs(np.gradient(path[:, :3], axis=0)).max(axis=1) > SAME_BASE
                # What is not as planned keeps `CLEARANCE`; the lines beside contacts cannot, and need only be free.
                changed = (at >= first) & (at <= last) | is_off & drives
                edges = np.flatnonzero(np.diff(changed, prepend=False, append=False)).reshape(-1, 2)
                is_clear = all(self.is_free(path[enter:leave]) for enter, leave in edges)
                if is_clear and not path_hits(self.free, path, STEP):
                    return path
        return None


def _is_changed(world: CollisionWorld, X: Array, planned: Array) -> NDArray[np.bool_]:
    """Whether each configuration (k, 11) of a motion is driven farther than `_OFF_LINE` from a planned one (n, 11).

    The distance is an upper bound of how far any point of the robot is from where the planned motion takes it.
    """
    reach, drives = world.robot.reach, np.abs(np.gradient(X[:, :3], axis=0)).max(axis=1) > SAME_BASE
    scaled, start, along = X[drives] * reach, planned[:-1] * reach, np.diff(planned, axis=0) * reach
    lengths = np.maximum((along**2).sum(axis=1), _TINY)
    share = np.clip((scaled @ along.T - (start * along).sum(axis=1)) / lengths, 0.0, 1.0)
    nearest = start + share[..., None] * along
    drives[drives] = np.abs(scaled[:, None] - nearest).sum(axis=2).min(axis=1) > _OFF_LINE
    return drives


def _corners(checks: _Checks, path: Array) -> Array | None:
    """Configurations (n, 11) of a path, from its first to its last, the straight lines between them free; or None."""
    corners, at = [path[0]], 0
    while at < len(path) - 1:
        steps = (len(path) - 1 - at) >> np.arange(len(path).bit_length())
        free = (at + step for step in steps if step and checks.is_free(path[[at, at + step]]))
        found = next(free, None)
        if found is None or len(corners) > _MOST_CORNERS:
            return None
        corners.append(path[found])
        at = found
    return np.array(corners)


def _straight(world: CollisionWorld, contact: Array, touched: HeldObject | None, is_held: bool) -> float:
    """[m] of the line beside a contact (1, 12) that have to stay straight; 0 of what is held at its middle."""
    if touched is None:
        return 0.0
    T_world_tcp = tcp_poses(world.robot, contact[:, :-1])[0]
    aside, up = T_world_tcp[:2, :3] @ touched.T_tcp_object[:3, 3], T_world_tcp[2, :3] @ touched.T_tcp_object[:3, 3]
    beside = float(np.hypot(*aside))
    if beside <= _BESIDE:
        return 0.0
    return _SAG * beside if is_held else float(up + world.scene.body(touched.name).half_extents[2]) + _TIPS


def _hanging(world: CollisionWorld, contact: Array, held: HeldObject) -> HeldObject | None:
    """An object that is held beside its middle as it hangs; None of what is held at its middle."""
    if _straight(world, contact, held, True) == 0.0:
        return None
    T_world_tcp = tcp_poses(world.robot, contact[:, :-1])[0]
    aside = T_world_tcp[:3, :3] @ held.T_tcp_object[:3, 3]
    axis = T_world_tcp[:3, :3].T @ np.cross(aside, (0.0, 0.0, -1.0))  # in the frame of the TCP, about which it turns
    T_tcp_turned = np.eye(4)
    T_tcp_turned[:3, :3] = Rotation.from_rotvec(_HANGS * axis / np.linalg.norm(axis)).as_matrix()
    return replace(held, T_tcp_object=T_tcp_turned @ held.T_tcp_object)


def _lines(robot: RobotArrays, states: Array, in_contact: bool, least: float) -> Iterator[Array]:
    """Parts of a phase beside a contact that may be kept: configurations (n, 11) from the contact on, shortest first.

    The last configuration is the corner. At least `least` [m] stay straight. Without contact nothing but the first
    configuration is kept.
    """
    X = states[:, :-1]
    if not in_contact:
        yield X[:1]
        return
    points = tcp_poses(robot, X)[:, :3, 3]
    away = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for share in _KEPT:
        kept = np.minimum(np.maximum(np.array([_STRAIGHT, 1.0]) * share * away[-1], least), away[-1])
        straight, corner = np.searchsorted(away, kept - 1e-9)
        yield np.vstack([X[: straight + 1], X[corner]])
