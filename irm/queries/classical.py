"""The classical inverse reachability map of equation 4, with its online ground filter, in plain NumPy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from irm.floor.free_space import EVERYWHERE, FreeSpace
from irm.maps.orientation_index import rotation
from irm.maps.reachability import CERTAIN_IN_HEIGHT, CERTAIN_IN_PITCH, ReachabilityMap
from irm.queries.keys import Key, base_turns, find_key
from irm.queries.placement import FULL_TURN, SEPARATION, YAW_STEP, BasePlacement, as_count, as_position, as_yaw_range
from irm.queries.status import Status

__all__ = ["ClassicalInverseReachabilityMap"]

Floats = NDArray[np.float64]

_UPRIGHT = 1e-6
"""1 - cos of the tilt up to which a base stands on the ground: rounding, for rings of pitch are degrees apart."""

_BLOCK = 16_384
"""Transforms moved at a time: their result stays in the processor's cache."""


class ClassicalInverseReachabilityMap:
    """Equation 4: T_eff = I, T_base = T_eff⁻¹ for every pose of the reachability map.

    Only online is it known which of these bases stand on the ground: the map is moved to the hand, and those whose base
    is upright and no farther than half a voxel from the floor are kept; this once for every allowed approach yaw.

    The half voxel, and taking pitch and roll of the hand as those of the nearest ring, are what the key of equation 5
    does as well, so that both maps hold the same candidates and give the same best μ.
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
        pitch: float = 0.0,
        roll: float = 0.0,
        yaw_range: tuple[float, float] = FULL_TURN,
        free_space: FreeSpace | None = None,
        k: int = 1,
        separation: float = SEPARATION,
        yaw_step: float = YAW_STEP,
    ) -> BasePlacement:
        """The bases of highest μ; arguments and errors as in `InverseReachabilityMap.query`.

        NO only if the hand is out of the map's height or nothing is free: that this map holds no base proves nothing.
        """
        grid, space = self.reachability_map.grid, free_space or EVERYWHERE
        point, bounds, count = as_position(position), as_yaw_range(yaw_range), as_count(k)
        key = find_key(grid, point[2], pitch, roll)
        if key is None or space.is_empty:
            return BasePlacement.nothing(Status.NO)
        angles = grid.orientations.pitch[key.group], grid.orientations.roll[key.group]
        turns = base_turns(grid, key, bounds, yaw_step).yaws
        per_yaw = [self._candidates(point, yaw, angles, space) for yaw in turns]
        base, x, y, base_yaw, approach = (np.concatenate(column) for column in zip(*per_yaw, strict=True))
        mu = self.reachability_map.manipulability[base]
        chosen = _best_apart(x, y, mu, count, separation)
        if not len(chosen):
            return BasePlacement.nothing(Status.UNKNOWN)
        torso, certain = self._torso_and_certainty(base[chosen], key)
        poses = np.column_stack([x, y, base_yaw, _wrapped(approach + key.yaw_shift), mu])[chosen]
        rows = np.column_stack([poses, torso, certain])
        return BasePlacement.of_rows(rows)

    def _candidates(
        self, point: Sequence[float], yaw: float, angles: tuple[float, float], space: FreeSpace
    ) -> tuple[NDArray[np.int64], Floats, Floats, Floats, Floats]:
        """Move the whole map to the hand; number, x, y, yaw and approach yaw of the bases on free ground."""
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = rotation(yaw, *angles), point
        on_ground = [self._on_ground(T_world_tcp, block) for block in self._blocks]
        base = np.concatenate([some + k * _BLOCK for k, (some, _) in enumerate(on_ground)] or [np.empty(0, np.int64)])
        x, y, base_yaw = np.concatenate([places for _, places in on_ground] or [np.empty((3, 0))], axis=1)
        free = space.are_free(x, y)
        return base[free], x[free], y[free], base_yaw[free], np.full(np.count_nonzero(free), yaw)

    def _on_ground(self, T_world_tcp: Floats, block: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Move a block of the map to the hand: numbers (m,) and x, y, yaw (3, m) of bases that stand on the ground."""
        T_world_base = (T_world_tcp @ block.reshape(4, -1)).reshape(block.shape)
        half = self.reachability_map.grid.voxel / 2
        height = T_world_base[2, :, 3]
        upright = (height >= -half) & (height < half) & (T_world_base[2, :, 2] > 1 - _UPRIGHT)
        base = np.flatnonzero(upright)
        yaw = np.arctan2(T_world_base[1, base, 0], T_world_base[0, base, 0])
        return base, np.stack([T_world_base[0, base, 3], T_world_base[1, base, 3], yaw])

    def _torso_and_certainty(self, base: NDArray[np.int64], key: Key) -> tuple[Floats, NDArray[np.bool_]]:
        """Torso height [m] and whether the hand certainly reaches, of the chosen bases."""
        rm = self.reachability_map
        lower, upper = rm.grid.torso_range
        torso, flags = rm.torso[base], rm.flags[base]
        follows = (torso + key.height_offset >= lower) & (torso + key.height_offset <= upper) & (upper > lower)
        inside = follows | (abs(key.height_offset) < 1e-9) | (flags & CERTAIN_IN_HEIGHT > 0)
        certain = (inside & key.exact) | (flags & CERTAIN_IN_PITCH > 0)
        return (np.clip(torso + key.height_offset, lower, upper) if upper > lower else torso), certain


def _inverse_transforms(rm: ReachabilityMap) -> Floats:
    """T_base of equation 4, shape (4, n, 4): row r of transform k is [r, k], so that one product moves them all."""
    R = np.array([rotation(*angles) for angles in rm.grid.orientations.angles])
    _, orientation, _, _ = rm.indices()
    R_transposed = R.transpose(0, 2, 1)[orientation]
    T = np.zeros((4, len(rm), 4))
    T[:3, :, :3] = R_transposed.transpose(1, 0, 2)
    T[:3, :, 3] = -np.einsum("nij,nj->in", R_transposed, rm.positions)
    T[3, :, 3] = 1.0
    return T


def _best_apart(x: Floats, y: Floats, mu: NDArray[np.float32], count: int, separation: float) -> NDArray[np.int64]:
    """Indices of the best candidates, each more than `separation` from the better ones."""
    if count == 1:
        return np.array([mu.argmax()]) if len(mu) else np.empty(0, dtype=np.int64)
    chosen: list[int] = []
    left = mu.astype(float)
    while len(chosen) < count and len(left) and left.max() > 0:
        best = int(left.argmax())
        chosen.append(best)
        left[np.hypot(x - x[best], y - y[best]) <= max(separation, 1e-6)] = 0.0
    return np.array(chosen, dtype=np.int64)


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
