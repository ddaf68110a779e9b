"""The classical inverse reachability map of equation 4, with its online ground filter, in plain NumPy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from irm.arm.angles import signed
from irm.errors import QueryError
from irm.floor.free_space import FreeSpace
from irm.maps.equations import inverse_reachability
from irm.maps.orientation_index import rotation
from irm.maps.reachability import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH, ReachabilityMap
from irm.queries.arguments import FULL_TURN, QueryKeywords, QueryOptions, as_position, as_yaw_range
from irm.queries.keys import Key, base_turns, find_key
from irm.queries.placement import BasePlacement
from irm.queries.placement_kernel import SAME_PLACE
from irm.queries.status import Status

__all__ = ["ClassicalInverseReachabilityMap"]

Floats = NDArray[np.float64]

_UPRIGHT = 1e-6
"""1 - cos of the tilt up to which a base counts as upright: larger than rounding, smaller than the step of pitch."""

_BLOCK = 16_384
"""Transforms that are multiplied at a time, so that their result stays in the processor's cache."""


class ClassicalInverseReachabilityMap:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹ for every pose of the reachability map.

    Which of these bases stand on the ground is known only at the query. The query moves the whole map to the TCP and
    keeps the bases that are upright and at most half a layer from the floor. It does so for every allowed approach yaw.

    The half layer, and the nearest ring in place of the TCP's own pitch and roll, are the same as in the key of
    equation 5. So both maps have the same candidates and give the same best μ.

    Example:
        classical_map = ClassicalInverseReachabilityMap(ReachabilityMap.build(FETCH))
        placement = classical_map.query((0.1, 0.0, 0.85), yaw_range=(-0.5, 0.5), free_space=floor)
    """

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        T = _inverse_transforms(reachability_map)
        self._blocks = [np.ascontiguousarray(T[:, k : k + _BLOCK]) for k in range(0, len(reachability_map), _BLOCK)]

    def __len__(self) -> int:
        return len(self.reachability_map)

    def query(
        self,
        position: Iterable[float],
        *,
        yaw_range: tuple[float, float] = FULL_TURN,
        **keywords: Unpack[QueryKeywords],
    ) -> BasePlacement:
        """The bases of highest μ from which the arm reaches a TCP pose.

        The status is NO only if the TCP is out of the map's height or no floor is free: a base that this map does not
        contain may still exist.

        Args:
            position: (3,) of the TCP in the world [m].
            yaw_range: allowed approach yaws in the world [rad].
            **keywords: `pitch`, `roll`, `free_space`, `k`, `separation`, `yaw_step`, as in
                `InverseReachabilityMap.query`.

        Raises:
            QueryError: as in `InverseReachabilityMap.query`, or `exact` or `prefer` is asked for.
        """
        options = QueryOptions.of(keywords, "yaw_range").without_preference("this query")
        if options.exact:
            raise QueryError("exact=True is for the queries of InverseReachabilityMap")
        grid, space = self.reachability_map.grid, options.floor
        point, bounds = as_position(position), as_yaw_range(yaw_range)
        key = find_key(grid, point[2], options.pitch, options.roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        angles = grid.orientations.pitch[key.group], grid.orientations.roll[key.group]
        turns = base_turns(grid, key, bounds, options.yaw_step)
        per_yaw = [self._candidates(point, yaw, angles, space) for yaw in turns]
        base, x, y, base_yaw, approach = (np.concatenate(column) for column in zip(*per_yaw, strict=True))
        mu = self.reachability_map.manipulability[base]
        chosen = _best_apart(x, y, mu, options)
        if not len(chosen):
            return BasePlacement.nothing(Status.UNKNOWN)
        torso, certain = self._torso_and_certainty(base[chosen], key)
        poses = np.column_stack([x, y, base_yaw, signed(approach + key.yaw_shift), mu])[chosen]
        rows = np.column_stack([poses, torso, certain])
        return BasePlacement.of_rows(rows)

    def _candidates(
        self, point: Sequence[float], yaw: float, angles: tuple[float, float], space: FreeSpace
    ) -> tuple[NDArray[np.int64], Floats, Floats, Floats, Floats]:
        """Index, x, y, yaw and approach yaw of the bases on free ground, for the map moved to the TCP."""
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = rotation(yaw, *angles), point
        on_ground = [self._on_ground(T_world_tcp, block) for block in self._blocks]
        base = np.concatenate([some + k * _BLOCK for k, (some, _) in enumerate(on_ground)] or [np.empty(0, np.int64)])
        x, y, base_yaw = np.concatenate([places for _, places in on_ground] or [np.empty((3, 0))], axis=1)
        free = space.are_free(x, y)
        return base[free], x[free], y[free], base_yaw[free], np.full(np.count_nonzero(free), yaw)

    def _on_ground(self, T_world_tcp: Floats, block: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Indices (m,) and x, y, yaw (3, m) of the bases that stand on the ground, for one block moved to the TCP."""
        T_world_base = (T_world_tcp @ block.reshape(4, -1)).reshape(block.shape)
        half = self.reachability_map.grid.thickness / 2
        height = T_world_base[2, :, 3]
        upright = (height >= -half) & (height < half) & (T_world_base[2, :, 2] > 1 - _UPRIGHT)
        base = np.flatnonzero(upright)
        yaw = np.arctan2(T_world_base[1, base, 0], T_world_base[0, base, 0])
        return base, np.stack([T_world_base[0, base, 3], T_world_base[1, base, 3], yaw])

    def _torso_and_certainty(self, base: NDArray[np.int64], key: Key) -> tuple[Floats, NDArray[np.bool_]]:
        """Torso height [m] of the chosen bases, and whether the arm certainly reaches from them."""
        rm = self.reachability_map
        lower, upper = rm.grid.torso_range
        torso, flags = rm.torso[base], rm.flags[base]
        follows = (torso + key.height_offset >= lower) & (torso + key.height_offset <= upper) & (upper > lower)
        inside = follows | (abs(key.height_offset) < 1e-9) | (flags & CERTAIN_IN_HEIGHT > 0)
        certain = (inside & key.exact) | (flags & CERTAIN_IN_PITCH > 0)
        return (np.clip(torso + key.height_offset, lower, upper) if upper > lower else torso), certain


def _inverse_transforms(rm: ReachabilityMap) -> Floats:
    """T_base of equation 4 (4, n, 4): row r of transform k is [r, k], so that one product transforms all of them."""
    R = np.array([rotation(*angles) for angles in rm.grid.orientations.angles])
    _, orientation, _, _ = rm.indices()
    R_base, p_base = inverse_reachability(R[orientation], rm.positions)
    T = np.zeros((4, len(rm), 4))
    T[:3, :, :3] = R_base.transpose(1, 0, 2)
    T[:3, :, 3] = p_base.T
    T[3, :, 3] = 1.0
    return T


def _best_apart(x: Floats, y: Floats, mu: NDArray[np.float32], options: QueryOptions) -> NDArray[np.int64]:
    """Indices of the `options.k` best candidates, each farther than `options.separation` from the better ones."""
    if options.k == 1:
        return np.array([mu.argmax()]) if len(mu) else np.empty(0, dtype=np.int64)
    chosen: list[int] = []
    left = mu.astype(float)
    while len(chosen) < options.k and len(left) and left.max() > 0:
        best = int(left.argmax())
        chosen.append(best)
        left[np.hypot(x - x[best], y - y[best]) <= max(options.separation, SAME_PLACE)] = 0.0
    return np.array(chosen, dtype=np.int64)
