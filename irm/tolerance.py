"""Bases that tolerate errors: the probability that the arm still reaches if the base stops slightly off."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.answers import BasePlacement
from irm.errors import QueryError
from irm.grid import nearest_orientation
from irm.inverse_map import InverseReachabilityMap
from irm.query_keys import FULL_TURN, QueryKeywords, as_position, checked_options
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotations, world_to_base

Floats = NDArray[np.float64]
_CANDIDATES = 30
"""Bases compared per requested base. Bases of highest μ are often at the edge of the feasible region."""
_SAMPLES = 400
"""Random errors of the base. They give the probability with a standard error of at most 2.5%."""


class TolerantPlacement(NamedTuple):
    """A `placement` with bases in the order of `probability` (k,), the highest first."""

    placement: BasePlacement
    probability: Floats


def query_tolerant(
    inverse_map: InverseReachabilityMap,
    position: Iterable[float],
    covariance: ArrayLike,
    rng: np.random.Generator,
    *,
    yaw_range: tuple[float, float] = FULL_TURN,
    **keywords: Unpack[QueryKeywords],
) -> TolerantPlacement:
    """Find the bases from which the arm most likely reaches a TCP pose, if the base stops with a normal error.

    Each base keeps its approach yaw. Ties are in the order of μ.

    Args:
        inverse_map: of the robot.
        position: (3,) of the TCP in the world [m].
        covariance: (3, 3) of the base's error along its own x, y [m] and of its yaw [rad].
        rng: of the errors.
        yaw_range: as in `InverseReachabilityMap.query`.
        **keywords: of all queries.

    Raises:
        QueryError: as `InverseReachabilityMap.query`, or the covariance is invalid.

    Example:
        placement, probability = query_tolerant(bases, cup, np.diag([0.03, 0.03, 0.05]) ** 2, rng, k=5)
    """
    wanted, position = checked_options(keywords, may_be_set=True).k, as_position(position)
    many = keywords.copy()
    many["k"] = _CANDIDATES * wanted
    found = inverse_map.query(position, yaw_range=yaw_range, **many)
    errors = _errors(covariance, rng)
    one, given = np.ones(len(found)), keywords.get
    pitch = found.pitch if found.pitch is not None else one * np.asarray(given("pitch", 0.0))
    roll = found.roll if found.roll is not None else one * np.asarray(given("roll", 0.0))
    T = np.tile(np.eye(4), (len(found), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotations(found.approach_yaw, pitch, roll), position
    if found.height is not None:
        T[:, 2, 3] = found.height
    rm = inverse_map.reachability_map
    probability = np.array([reach_probability(rm, base, T[k], errors) for k, base in enumerate(found.poses)])
    order = np.argsort(-probability, kind="stable")[:wanted]
    columns = {entry.name: getattr(found, entry.name) for entry in fields(found)}
    arrays: dict[str, Any] = {name: value[order] for name, value in columns.items() if isinstance(value, np.ndarray)}
    return TolerantPlacement(replace(found, **arrays), probability[order])


def reach_probability(rm: ReachabilityMap, base: Floats, T_world_tcp: Floats, errors: Floats) -> float:
    """Share of errors (n, 3) of a base pose (3,), in its own frame, with which the map reaches a TCP pose (4, 4)."""
    T_base_tcp = world_to_base(base) @ T_world_tcp
    c, s = np.cos(errors[:, 2]), np.sin(errors[:, 2])
    turn = np.zeros((len(errors), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, s, -s, c, 1.0
    offset = T_base_tcp[:3, 3] - np.column_stack([errors[:, :2], np.zeros(len(errors))])
    position = (turn @ offset[..., None])[..., 0]
    grid = rm.grid
    cells = np.column_stack(
        [
            np.floor((position[:, 2] - grid.bottom) / grid.thickness),
            nearest_orientation(grid.orientations, turn @ T_base_tcp[:3, :3]),
            *(np.floor((position[:, k] - grid.centre[k]) / grid.voxel) + grid.half for k in (0, 1)),
        ]
    ).astype(np.int64)
    inside = np.all((cells >= 0) & (cells < grid.shape), axis=1)
    return float(np.count_nonzero(rm.are_free(cells[inside])) / len(errors))


def _errors(covariance: ArrayLike, rng: np.random.Generator) -> Floats:
    """(n, 3) normal errors of a base pose."""
    rule = "a covariance is a symmetric array (3, 3) without negative eigenvalues: x, y [m] and yaw [rad] of the base"
    try:
        matrix = np.asarray(covariance, dtype=float)
    except (TypeError, ValueError):
        raise QueryError(rule) from None
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
        raise QueryError(rule)
    values, vectors = np.linalg.eigh(matrix)
    if values.min() < -1e-12:
        raise QueryError(rule)
    return np.asarray(rng.normal(size=(_SAMPLES, 3)) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)
