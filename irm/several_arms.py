"""Base poses from which several arms of one robot reach a TCP pose each, such as both hands at a tray.

Every base of the arm with the fewest bases is a candidate, at every allowed yaw. μ of the other arms' TCP poses is read
from their maps, and the smallest μ is the candidate's score. The best bases are then decided exactly, at one height of
the torso for all arms, because they are on the same lift. Collisions between the arms are not checked: in the shapes of
one arm, the others are at home.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irm.answers import YES, BasePlacement, Status
from irm.base_decisions import SPARE_BASES
from irm.errors import QueryError
from irm.ik.solvers import ExactSolver
from irm.inverse_table import InverseTable, best_apart
from irm.query_kernels import base_turns
from irm.query_keys import Key, QueryOptions, find_key, yaw_window
from irm.rotations import rotation, world_to_base, wrap_to_pi

Floats = NDArray[np.float64]
_TORSO_STEP = 0.03
"""[m] Step between the torso heights at which the arms are solved together."""
_ROUNDING = 1e-5
"""[rad] Excess allowed of a yaw beyond its window."""


def place_for_arms(
    tables: list[InverseTable], targets: Floats, windows: Floats, pitches: Floats, rolls: Floats, options: QueryOptions
) -> BasePlacement:
    """`InverseReachabilityMap.query_multi` with one arm per target (m, 3). `tables`: m tables of these arms.

    `windows` (m, 2): range of yaws of each target. `pitches`, `rolls` (m,): its angles [rad].
    """
    if len(tables) != len(targets):
        raise QueryError(f"{len(tables)} arms do not go with {len(targets)} targets")
    chains = [table.reachability_map.chain for table in tables]
    if any(chain is None for chain in chains):
        raise QueryError("several arms need maps that know their arms, not maps made from poses")
    keys: list[Key] = []
    angles = zip(pitches.tolist(), rolls.tolist(), strict=True)
    for table, point, window, (pitch, roll) in zip(tables, targets, windows, angles, strict=True):
        key = find_key(table.grid, float(point[2]), pitch, roll)
        bounds = float(window[0]), float(window[1])
        if key is None or not table.may_exist(
            point.tolist(), pitch, key, bounds, options.free_space, options.base_yaws
        ):
            return BasePlacement.nothing(Status.NO, (len(targets),))
        keys.append(key)
    x, y, yaw, approach, mu = _scored(tables, keys, targets, windows, options)
    chosen = best_apart(x, y, mu, options.k + SPARE_BASES, options.separation)
    rows = np.column_stack([x, y, wrap_to_pi(yaw), mu, np.zeros(len(x))])[chosen]
    if not len(rows):
        return BasePlacement.nothing(Status.UNKNOWN, (len(targets),))
    yaws, size = approach[chosen], max(chain.size for chain in chains if chain is not None)
    q = np.full((len(rows), len(targets), size), np.nan)
    for row, base in enumerate(rows):
        T = np.zeros((len(targets), 4, 4))
        for k, point in enumerate(targets):
            T[k, :3, :3], T[k, :3, 3] = rotation(float(yaws[row, k]), float(pitches[k]), float(rolls[k])), point
            T[k, 3, 3] = 1.0
        base[4] = _together(tables, world_to_base(base[:3]) @ T, q[row])
    order = np.lexsort((-rows[:, 3], -rows[:, 4]))[: options.k]
    rows, yaws, q = rows[order], yaws[order], q[order]
    status = Status.YES if rows[:, 4].any() else Status.UNKNOWN
    return BasePlacement.of_multi_rows(rows, q[..., 0].copy(), yaws, status, q)


def _scored(
    tables: list[InverseTable], keys: list[Key], targets: Floats, windows: Floats, options: QueryOptions
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """x, y, yaw (n,), approach yaws (n, m) and smallest μ (n,) of all free bases from which every arm reaches its
    target by its map."""
    reference = int(np.argmin([table.count_of(key) for table, key in zip(tables, keys, strict=True)]))
    table, key = tables[reference], keys[reference]
    own_x, own_y, own_yaw, own_mu = table.bases_of(key)
    low, high = windows[reference].tolist()
    turns = base_turns(yaw_window(table.grid, key, (low, high), options.yaw_step))[:, None]
    x = (targets[reference, 0] + np.cos(turns) * own_x - np.sin(turns) * own_y).ravel()
    y = (targets[reference, 1] + np.sin(turns) * own_x + np.cos(turns) * own_y).ravel()
    yaw, turn = (turns + own_yaw).ravel(), np.repeat(turns[:, 0], len(own_x))
    mu = np.tile(own_mu, len(turns))
    approach = np.empty((len(x), len(targets)))
    approach[:, reference] = wrap_to_pi(turn + key.yaw_shift)
    kept = options.free_space.are_free(x, y)
    if np.isfinite(options.base_yaws.span):
        kept &= (yaw - options.base_yaws.low + _ROUNDING) % (2 * np.pi) <= options.base_yaws.span + 2 * _ROUNDING
    for k in range(len(targets)):
        x, y, yaw, mu, approach = x[kept], y[kept], yaw[kept], mu[kept], approach[kept]
        kept = np.ones(len(x), dtype=bool)
        if k != reference:
            best, approach[:, k] = _best_yaws(tables[k], keys[k], targets[k], windows[k], (x, y, yaw))
            mu, kept = np.minimum(mu, best), best > 0.0
    return x[kept], y[kept], yaw[kept], approach[kept], mu[kept]


def _best_yaws(
    table: InverseTable, key: Key, target: Floats, window: Floats, base: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    """Best μ of a target (n,), 0 for none, over the map's yaw samples in the window, and its approach yaw (n,)."""
    (x, y, yaw), grid = base, table.grid
    dx, dy, c, s = target[0] - x, target[1] - y, np.cos(yaw), np.sin(yaw)
    yaws, side, layer = int(grid.orientations.count[key.group]), 2 * grid.half, grid.layer(float(target[2]))
    i = np.floor((c * dx + s * dy - grid.centre[0]) / grid.voxel).astype(np.int64) + grid.half
    j = np.floor((c * dy - s * dx - grid.centre[1]) / grid.voxel).astype(np.int64) + grid.half
    inside = np.flatnonzero((i >= 0) & (i < side) & (j >= 0) & (j < side) & (0 <= layer < grid.layers))
    mu = np.zeros((len(x), yaws))
    for sample in range(yaws):
        mu[inside, sample] = table.mu_of(key.group, layer, np.full(len(inside), sample), i[inside], j[inside])
    approach = yaw[:, None] + 2 * np.pi * np.arange(yaws) / yaws + key.yaw_shift
    beyond = (approach - window[0] + _ROUNDING) % (2 * np.pi) - _ROUNDING
    mu[beyond > window[1] - window[0] + _ROUNDING] = 0.0
    best = mu.argmax(axis=1)
    rows = np.arange(len(x))
    return mu[rows, best], np.asarray(wrap_to_pi(approach[rows, best]))


def _together(tables: list[InverseTable], T_base_tcp: Floats, q: Floats) -> bool:
    """Whether each arm reaches its pose (m, 4, 4) with the torso at one height. Writes the configurations to `q` (m,
    n)."""
    low = max(table.grid.torso_range[0] for table in tables)
    high = min(table.grid.torso_range[1] for table in tables)
    if low > high:
        return False
    for height in np.linspace(low, high, int(np.ceil((high - low) / _TORSO_STEP)) + 1).tolist():
        for k, table in enumerate(tables):
            chain = table.reachability_map.chain
            assert chain is not None
            status, found = ExactSolver(chain, (height, height)).solve(T_base_tcp[k : k + 1])
            if status[0] != YES:
                break
            q[k, : chain.size] = found[0]
        else:
            return True
    q[:] = np.nan
    return False
