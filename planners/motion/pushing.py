"""Paths of closed fingers that push: up to the face, along with it, and back from it.

The middle of the finger tips stays in front of the same point of the face. The hand either turns with the pushed part,
or keeps its orientation while the part turns and the face rolls on the fingers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planners.collision.finger_tips import finger_tips, way_of
from planners.scene import Scene
from planners.scene.bodies import pose_matrix

Array = NDArray[np.float64]

_STEP = 0.004
"""Spacing [m] of hand poses on the way to the face and back."""


class Track(NamedTuple):
    """Poses (k, 4, 4) of the TCP in the world, and positions (k,) [m] or [rad] of the opening part.

    `turned` (k,) [m] or [rad] are the positions of its lever, if any.
    """

    poses: Array
    positions: Array
    turned: Array | None = None


def pushed_tracks(scene: Scene, T_world_tcp: Array, positions: Array) -> Iterator[Track]:
    """Find paths of a hand that pushes a part, from a pose (4, 4) in front of it, for positions (k,) of the opening."""
    assert scene.pull is not None
    opening, tips, body = scene.opening(scene.pull.opening), finger_tips(scene.robot), scene.body(scene.pull.handle)
    middle, R, end = tips.middle(T_world_tcp), T_world_tcp[:3, :3], float(positions[-1])
    way = way_of(opening, middle, end)
    cuts = [piece.cut(middle[None], way[None]) for piece in body.placed]
    ahead = [float(enter[0]) for enter, leave, *_ in cuts if enter[0] < leave[0] and enter[0] > 0.0]
    if not ahead:
        return
    point = middle + min(ahead) * way
    for turns in (True, False) if opening.kind == "hinge" else (True,):
        poses = []
        for position in positions:
            T = opening.motion(float(position))
            turned = T[:3, :3] @ R if turns else R
            along = T[:3, :3] @ way_of(opening, point, end)
            at = T[:3, :3] @ point + T[:3, 3] - tips.reach(turned, along) * along
            poses.append(pose_matrix(at - tips.ahead * turned[:, 0], turned))
        first = _line(T_world_tcp, poses[0])
        along = opening.motion(end)[:3, :3] @ way_of(opening, point, end)
        away = poses[-1].copy()
        away[:3, 3] -= scene.robot.finger_gap * along
        last = _line(poses[-1], away)[1:]
        at_ends = np.full(len(first) - 1, positions[0]), np.full(len(last), end)
        yield Track(np.array([*first[:-1], *poses, *last]), np.concatenate([at_ends[0], positions, at_ends[1]]))


def _line(T: Array, to: Array) -> list[Array]:
    """Poses (4, 4) on the straight line between two poses of the same orientation, both ends included."""
    steps = max(int(np.ceil(np.linalg.norm(to[:3, 3] - T[:3, 3]) / _STEP)), 1)
    return [pose_matrix(T[:3, 3] + share * (to[:3, 3] - T[:3, 3]), T[:3, :3]) for share in np.linspace(0, 1, steps + 1)]
