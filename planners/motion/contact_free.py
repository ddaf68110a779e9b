"""Merging of motions between two contacts: no stops, base and arm together, on a shorter path if collision-free.

A pick, a drive and a put-down are planned separately, each from rest to rest, through the home configuration. Between
the release of one object and the grasp of the next, the robot touches nothing. So only the straight lines near the
contacts must stay. Between them, the path is a straight line in whole-body configurations if it is collision-free, with
blended corners and timed as one motion.
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
"""Shares of a straight line at a contact that are kept. The smallest collision-free share is used."""
_STRAIGHT = 0.5
"""Share of the kept line that stays straight. The rest may be rounded."""
_BESIDE = 0.03
"""Distance [m] of an object's centre to the side of the TCP above which it is held at its rim or handle."""
_SAG = 0.5
"""Lift [m] of such an object before anything turns, per metre to its centre. A pan turns by 13 degrees between the
fingers, and its far side is twice as far away as its centre."""
_HANGS = 0.26
"""Angle [rad] by which such an object turns about the fingers until its far side hangs: the slanting wall of a bowl is
between the pads then. The corners of a path, and all between them, are collision-free with it in that pose too."""
_TIPS = 0.02
"""Height [m] above such an object's top, from which the empty fingers go straight down around its wall."""
_MOST_CORNERS = 10
"""Most corners between two contacts. A path with more corners stays as it is."""
_NODES, _CHECKS = 32, 300
"""Points of the planned path that a thorough search connects, and lines between them that it tests."""
_CORNER_TIME = 0.4
"""Time [s] that a corner costs, about: the robot slows down there."""
_HALF_WIDTHS = (0.3, 0.15, 0.07)
"""Half widths [s] at full speed of the rounding at a corner. The first collision-free one is used."""
_NARROW = (0.03, 0.015)
"""More of them, for a thorough search."""
_LAG = 2
"""Samples by which fingers may lag behind their commands."""
_OFF_LINE = 0.001
"""Distance [m] from the planned lines above which a driven configuration keeps `CLEARANCE`: base and arm lag if both
move."""

_TINY = 1e-12
"""Squared distance [m²] of a robot at rest."""


def merge_phases(
    world: CollisionWorld,
    phases: Sequence[Trajectory],
    first: HeldObject | None,
    last: HeldObject | None,
    thorough: bool = False,
) -> list[Trajectory] | None:
    """Merge phases into one motion on a shorter path. None if it fails or takes as long.

    The phases keep their shares of the time. The fingers move while the robot moves.

    Args:
        world: the compiled scene at this time.
        phases: consecutive trajectories of one phase each, without grasp or release, at rest at both ends.
        first, last: the object between the fingers at the start and at the end.
        thorough: whether corners are chosen such that the robot does not collide with itself between them, and so that
            they take the least time. If that fails, the phases are merged into two motions. Without it, a path on which
            the robot collides with itself is refused once it is known, and the phases stay as they are.
    """
    merged = _merged(world, phases, first, last, thorough)
    if merged is not None or not thorough:
        return merged
    in_parts = (_in_two(world, phases, cut, first, last) for cut in range(1, len(phases)))
    return min(filter(None, in_parts), key=lambda found: sum(phase.duration for phase in found), default=None)


def _in_two(
    world: CollisionWorld, phases: Sequence[Trajectory], cut: int, first: HeldObject | None, last: HeldObject | None
) -> list[Trajectory] | None:
    """Phases merged before and after a cut. None if neither part takes less time."""
    before = _merged(world, phases[:cut], first, None, True)
    after = _merged(world, phases[cut:], None, last, True)
    if before is None and after is None:
        return None
    return [*(before or phases[:cut]), *(after or phases[cut:])]


def _merged(
    world: CollisionWorld,
    phases: Sequence[Trajectory],
    first: HeldObject | None,
    last: HeldObject | None,
    thorough: bool,
) -> list[Trajectory] | None:
    """Phases merged into one motion, as for `merge_phases`."""
    path = _shorter_path(world, phases, first, last, thorough)
    if path is None:
        return None
    robot, held, steps = world.scene.robot, phases[0].phases[0].held, [len(phase.times) - 1 for phase in phases]
    start, end = phases[0].finger_position[0], phases[-1].finger_position[-1]
    is_near = near_walls(world, robot.opening(max(start, end)))
    is_loaded = bool(held) or bool(world.scene.aside)
    timed = time_parametrise(path, robot, start, Phase("", 0.0), is_loaded, is_near)
    ramp = finger_ramp(robot, start, end)
    count = len(timed.times) - 1
    if not max(len(ramp) - 1, len(phases)) <= count < sum(steps):
        return None
    bounds, states = _bounds(steps, count), timed.states.copy()
    # Fingers begin to move in the phase in which they did as planned, else at once, else as late as possible.
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
    """Whether partly open fingers are collision-free on a motion (n, 12), even if `_LAG` samples late.

    They are closer to an object between them than open ones. Configurations off the planned path (m, 11) keep
    `CLEARANCE` here too.
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
    """Sample numbers at which phases begin, then `last`: in proportion to their steps, with at least one step each."""
    shares = np.cumsum([0, *steps]) / max(sum(steps), 1)
    bounds = [max(round(share * last), k) for k, share in enumerate(shares)]
    return [min(bound, last - (len(bounds) - 1 - k)) for k, bound in enumerate(bounds)]


def _shorter_path(
    world: CollisionWorld,
    phases: Sequence[Trajectory],
    first: HeldObject | None,
    last: HeldObject | None,
    thorough: bool,
) -> Array | None:
    """Shorter path of whole-body configurations (n, 11) from start to end of the motion. None if the search fails.

    It is the straight line between the kept lines at both ends, or else a polygon with corners on the planned path.
    """
    # Checks use the widest opening of the motion, or the object held throughout.
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
    checks = _Checks(world, clear, hung, world.query(opening, held, first_only=True), thorough)
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
    whole = np.vstack([starts[-1][-1:], *planned, ends[-1][:1]])
    for find in (_quickest_corners, _corners)[not thorough :]:
        corners = find(checks, whole)
        rounded = None if corners is None else checks.rounded(starts[-1], corners[1:-1], ends[-1], keeps)
        if rounded is not None:
            return rounded
    return None


class _Checks(NamedTuple):
    world: CollisionWorld
    clear: CollisionQuery  # padding CLEARANCE, without self-collision
    hung: CollisionQuery  # the same with the held object as it hangs
    free: CollisionQuery  # padding of the world, with self-collision
    thorough: bool

    def is_free(self, path: Array) -> bool:
        """Whether a path keeps `CLEARANCE` from everything except the robot itself.

        In a thorough search the robot must not collide with itself either.
        """
        if path_hits(self.clear, path, STEP) or (self.thorough and path_hits(self.free, path, STEP)):
            return False
        return self.hung is self.clear or not path_hits(self.hung, path, STEP)

    def rounded(self, start: Array, corners: Array, end: Array, keeps: bool) -> Array | None:
        """Path along two lines with corners between them, all rounded. None if it is in collision.

        Corners within the straight parts of the lines are rounded too if that is collision-free, unless `keeps`.
        """
        polygon = np.vstack([start, corners, end])
        first, last = len(start) - 1, len(polygon) - len(end)
        only_between = max(first - 1, 0), min(last + 1, len(polygon) - 1)
        for begin, stop in ((0, len(polygon) - 1), only_between)[keeps:]:
            for half_width in (*_HALF_WIDTHS, *(_NARROW if self.thorough else ())):
                smooth, at = round_corners(self.world.scene.robot, polygon[begin : stop + 1], half_width)
                path = np.vstack([polygon[:begin], smooth, polygon[stop + 1 :]])
                at = np.concatenate([np.arange(begin), at + begin, np.arange(stop + 1, len(polygon))])
                on_polygon = interpolate(at, np.arange(len(polygon)), polygon)
                is_off = np.abs(path - on_polygon) @ self.world.robot.reach > _OFF_LINE
                drives = np.abs(np.gradient(path[:, :3], axis=0)).max(axis=1) > SAME_BASE
                # Parts off the planned path keep CLEARANCE. The lines at contacts cannot, and need only be free.
                changed = (at >= first) & (at <= last) | is_off & drives
                edges = np.flatnonzero(np.diff(changed, prepend=False, append=False)).reshape(-1, 2)
                is_clear = all(self.is_free(path[enter:leave]) for enter, leave in edges)
                if is_clear and not path_hits(self.free, path, STEP):
                    return path
        return None


def _is_changed(world: CollisionWorld, X: Array, planned: Array) -> NDArray[np.bool_]:
    """Whether configurations (k, 11) are driven and farther than `_OFF_LINE` from the planned path (n, 11): (k,).

    The distance is an upper bound over all points of the robot.
    """
    reach, drives = world.robot.reach, np.abs(np.gradient(X[:, :3], axis=0)).max(axis=1) > SAME_BASE
    scaled, start, along = X[drives] * reach, planned[:-1] * reach, np.diff(planned, axis=0) * reach
    lengths = np.maximum((along**2).sum(axis=1), _TINY)
    share = np.clip((scaled @ along.T - (start * along).sum(axis=1)) / lengths, 0.0, 1.0)
    nearest = start + share[..., None] * along
    drives[drives] = np.abs(scaled[:, None] - nearest).sum(axis=2).min(axis=1) > _OFF_LINE
    return drives


def _corners(checks: _Checks, path: Array) -> Array | None:
    """Corners (n, 11) on a path, both ends included, with free lines between them. None if the search fails."""
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


def _quickest_corners(checks: _Checks, path: Array) -> Array | None:
    """Corners (n, 11) on a path with the least time between them, as far as `_CHECKS` lines tell. None for none.

    A shortest path is found among points of the path. If a line of it is in collision, it is left out, and so on.
    """
    nodes = path[np.unique(np.linspace(0, len(path) - 1, _NODES).round().astype(int))]
    last, velocity = len(nodes) - 1, np.array(checks.world.scene.robot.max_velocity)
    times = np.abs(nodes[:, None] - nodes) / velocity
    cost = np.where(np.triu(np.ones((last + 1, last + 1)), 1) > 0, times.max(axis=2) + _CORNER_TIME, np.inf)
    known: set[tuple[int, int]] = set()
    for _ in range(_CHECKS):
        to_go, after = np.zeros(last + 1), np.zeros(last + 1, int)
        for node in reversed(range(last)):
            ahead = cost[node] + to_go
            after[node] = int(ahead[node + 1 :].argmin()) + node + 1
            to_go[node] = ahead[after[node]]
        if not np.isfinite(to_go[0]):
            return None
        route = [0]
        while route[-1] < last:
            route.append(int(after[route[-1]]))
        line = next((one for one in itertools.pairwise(route) if one not in known), None)
        if line is None:
            return np.asarray(nodes[route])
        if checks.is_free(nodes[list(line)]):
            known.add(line)
        else:
            cost[line] = np.inf
    return None


def _straight(world: CollisionWorld, contact: Array, touched: HeldObject | None, is_held: bool) -> float:
    """Length [m] of the line at a contact (1, 12) that must stay straight. 0 for an object held at its middle."""
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
    """Parts of a phase at a contact that may be kept: configurations (n, 11) from the contact outwards, shortest first.

    The last configuration is the corner. At least `least` [m] stay straight. Without contact, only the first
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
