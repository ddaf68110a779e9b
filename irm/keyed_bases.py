"""The shared part of all queries on equation 5: the table of bases, exact decisions, and the test for NO."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.answers import NO, YES
from irm.chain import ArmChain
from irm.errors import QueryError
from irm.free_space import FreeSpace
from irm.ik.solvers import ExactSolver, exact_solver
from irm.inverse_table import invert_map
from irm.query_kernels import any_base_near, disc_meets_floor, turns_of
from irm.query_keys import Key, QueryOptions, flat_key, linspace_angles, nearby_keys, outer_turns
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation

Floats = NDArray[np.float64]
SPARE_BASES = 8
"""Bases that are decided beyond the number wanted, in place of those that are dropped."""
_OUTER_VOXELS = 1.5 * float(np.sqrt(2.0))
"""Voxels by which the outer map extends beyond a reachable one: to the far corner of its diagonal neighbour."""


class WristDisc(NamedTuple):
    """The base's centre is at most `radius` from the wrist centre, which is `level` behind the TCP; both horizontal
    [m]."""

    level: float
    radius: float

    @property
    def farthest(self) -> float:
        """[m] between the base's centre and the TCP, at most."""
        return self.level + self.radius


def wrist_disc(chain: ArmChain, torso_range: tuple[float, float], z: float, pitch: float) -> WristDisc | None:
    """Where the base may be for a TCP at height `z` [m] with a pitch [rad]; None if the arm does not reach this height.

    With a closed form, the wrist centre is at most upper arm + forearm away from the lift axis. For any other arm, the
    TCP is at most the sum of all link lengths away from the first joint.
    """
    if chain.has_closed_form:
        pan_x, pan_z, shoulder_x, shoulder_z, upper_arm, forearm, gripper = chain.links.tolist()
        level, inner, reach = gripper * cos(pitch), abs(pan_x) + shoulder_x, upper_arm + forearm
        height = z + gripper * sin(pitch) - pan_z - shoulder_z
    else:
        x, y, shoulder = chain.shoulder.tolist()
        level, inner, reach, height = 0.0, hypot(x, y), chain.reach, z - shoulder
    above = max(torso_range[0] - height, height - torso_range[1], 0.0)
    return WristDisc(level, inner + sqrt(reach * reach - above * above)) if above <= reach else None


class GroupField(NamedTuple):
    """The map of one pitch and roll as dense arrays `mu` and `torso` (layer, yaw, x, y), for kernels.

    `x0`, `y0`, `z0`: lowest corner of the grid in the base frame [m]; `voxel`: edge of its cells [m];
    `thickness` of its layers [m].
    """

    mu: NDArray[np.float32]
    torso: NDArray[np.float32]
    x0: float
    y0: float
    z0: float
    voxel: float
    thickness: float


class DecidedBases(NamedTuple):
    """Exact answers for k bases and m TCP poses of each.

    `may_reach` (k,): false where a pose is certainly out of reach; `certain` (k,): all poses are reached; `torso`
    (k, m): torso height of a configuration that reaches, NaN where there is none [m].
    """

    may_reach: NDArray[np.bool_]
    certain: NDArray[np.bool_]
    torso: Floats


class KeyedBases:
    """The bases of equation 5, found by the key of a TCP pose."""

    def __init__(self, reachability_map: ReachabilityMap) -> None:
        self.reachability_map = reachability_map
        self.grid = reachability_map.grid
        self.tiles = invert_map(reachability_map)
        self._fields: dict[int, GroupField] = {}

    def field(self, group: int) -> GroupField:
        """The map of one orientation group as a dense array, made at the first call."""
        if group not in self._fields:
            rm, grid, start = self.reachability_map, self.grid, self.grid.orientations.start
            layers, _, width, depth = grid.shape
            z, orientation, x, y = rm.indices()
            mine = (orientation >= start[group]) & (orientation < start[group + 1])
            place = z[mine], orientation[mine] - start[group], x[mine], y[mine]
            shape = layers, int(start[group + 1] - start[group]), width, depth
            mu, torso = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
            mu[place], torso[place] = rm.manipulability[mine], rm.torso[mine]
            x0, y0 = (centre - grid.half * grid.voxel for centre in grid.centre)
            self._fields[group] = GroupField(mu, torso, x0, y0, grid.bottom, grid.voxel, grid.thickness)
        return self._fields[group]

    def disc(self, z: float, pitch: float) -> WristDisc | None:
        """Where the arm's lengths allow the base to be for a TCP at a height [m] and pitch [rad]; None for nowhere.

        Without the arm's lengths, for the map of somebody else, it is everywhere.
        """
        chain = self.reachability_map.chain
        return WristDisc(0.0, np.inf) if chain is None else wrist_disc(chain, self.grid.torso_range, z, pitch)

    def may_exist(
        self, point: Sequence[float], pitch: float, key: Key, yaw_range: tuple[float, float], space: FreeSpace
    ) -> bool:
        """Whether a base may exist: within the arm's lengths, and in the outer map, on or near free floor.

        The outer map consists of all cells next to a reachable one.

        Args:
            point: (3,) TCP position [m].
            pitch: of the TCP [rad].
            key: of the TCP pose.
            yaw_range: checked range of approach yaws [rad].
            space: the free floor.
        """
        disc, raster = self.disc(point[2], pitch), space.raster
        if disc is None:
            return False
        yaws, half = linspace_angles((yaw_range[0], yaw_range[1]))
        if not disc_meets_floor(point[0], point[1], disc.level, disc.radius, yaws, half, raster):
            return False
        keys = nearby_keys(self.grid, key)
        if keys is None:
            return True
        turns, half = outer_turns(self.grid, key, yaw_range)
        slack = _OUTER_VOXELS * self.grid.voxel
        return bool(any_base_near(self.tiles, keys, point[0], point[1], turns_of(turns), half, raster, slack))

    def rarest(self, keys: Sequence[Key]) -> int:
        """Index of the key with the fewest bases: the shortest list to search."""
        flat = np.array([flat_key(self.grid, key.layer, key.group) for key in keys])
        return int((self.tiles.base_first[flat + 1] - self.tiles.base_first[flat]).argmin())

    def is_exact_wanted(self, options: QueryOptions, by_default: bool) -> bool:
        """Whether the bases of a query are to be decided exactly.

        Args:
            options: of the query.
            by_default: whether this query does so for an arm with a closed form if the caller does not say.

        Raises:
            QueryError: the caller wants it, and the map does not know its arm.
        """
        chain = self.reachability_map.chain
        if options.exact and chain is None:
            raise QueryError("exact=True needs the arm of the map; this map was made from poses")
        if options.exact is None:
            return by_default and chain is not None and chain.has_closed_form
        return options.exact

    def decide(self, bases: Floats, points: Floats, yaws: Floats, options: QueryOptions) -> DecidedBases:
        """Decide k bases.

        Args:
            bases: (k, 3) x, y [m] and yaw [rad].
            points: (k, m, 3) TCP positions in the world [m].
            yaws: (k, m) approach yaws in the world [rad].
            options: with pitch and roll of the TCP.
        """
        T = np.zeros((*yaws.shape, 4, 4))
        T[..., :3, :3] = _about_z(yaws - bases[:, None, 2]) @ rotation(0.0, options.pitch, options.roll)
        offset = points - np.concatenate([bases[:, None, :2], np.zeros((len(bases), 1, 1))], axis=2)
        T[..., :3, 3] = np.einsum("kij,kmj->kmi", _about_z(-bases[:, 2]), offset)
        T[..., 3, 3] = 1.0
        answers, configurations = self._solver.solve(T.reshape(-1, 4, 4))
        answers = answers.reshape(yaws.shape)
        torso = configurations[:, 0].reshape(yaws.shape)
        return DecidedBases(np.all(answers != NO, axis=1), np.all(answers == YES, axis=1), torso)

    @cached_property
    def _solver(self) -> ExactSolver:
        assert self.reachability_map.chain is not None
        return exact_solver(self.reachability_map.chain, self.reachability_map.grid.torso_range)


def _about_z(angle: Floats) -> Floats:
    """(..., 3, 3) rotations about z."""
    R = np.zeros((*angle.shape, 3, 3))
    c, s = np.cos(angle), np.sin(angle)
    R[..., 0, 0], R[..., 0, 1], R[..., 1, 0], R[..., 1, 1], R[..., 2, 2] = c, -s, s, c, 1.0
    return R
