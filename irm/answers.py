"""Answers of the queries: YES, NO or UNKNOWN, and base poses, best first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
NO, UNKNOWN, YES = 0, 1, 2
"""Answers of solvers and kernels: the values of `Status`."""


class Status(Enum):
    """YES: certainly possible. NO: certainly impossible. UNKNOWN: the cells of the map are too coarse to decide."""

    NO = NO
    UNKNOWN = UNKNOWN
    YES = YES


@dataclass(frozen=True)
class BasePlacement:
    """Base poses that answer a query, best first. Arrays are read-only. Without a base, k = 0.

    Attributes:
        status: YES if one of the bases is certain, NO if there is certainly none, UNKNOWN otherwise.
        poses: (k, 3) base x, y [m] and yaw [rad] in [-π, π).
        manipulability: (k,) μ of the map's cell. For paths and several targets, the smallest μ. With exact answers, μ
            of `configurations`.
        torso: (k,) torso height at which the arm reaches with this μ [m]. For paths and several targets (k, m).
        approach_yaw: (k,) yaw of the TCP in the world [rad]. For several targets (k, m).
        certain: (k,) whether the arm certainly reaches from this base, free of self-collision.
        configurations: with exact answers, (k, 1 + n) torso [m] and arm joints [rad] that reach, free of
            self-collision. NaN where none is known. For paths and several targets (k, m, 1 + n). Otherwise None.
        joints_alone: whether self-collision is unknown, because the arm has no shapes or the map ignores them. YES and
            `certain` are then statements about the joints alone.
        height, pitch, roll: (k,) height [m] and angles [rad] of each base's TCP pose, if the query had ranges.
            Otherwise None.
    """

    status: Status
    poses: Floats
    manipulability: Floats
    torso: Floats
    approach_yaw: Floats
    certain: NDArray[np.bool_]
    configurations: Floats | None = None
    joints_alone: bool = False
    height: Floats | None = None
    pitch: Floats | None = None
    roll: Floats | None = None

    def __len__(self) -> int:
        return len(self.poses)

    def __bool__(self) -> bool:
        return len(self.poses) > 0

    def __str__(self) -> str:
        return "\n".join("  ".join(f"{cell:>9}" for cell in row) for row in ((self._title,), *self._table()))

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in self._table())
        return f"<table><caption>{self._title}</caption>{rows}</table>"

    @property
    def _title(self) -> str:
        return f"{self.status}{', joints alone' if self.joints_alone else ''}"

    def _table(self) -> list[tuple[str, ...]]:
        """A row of column names, then one row per base. For several targets, the torso height is that of the first."""
        rows = zip(self.poses, self.manipulability, self.torso, self.certain, strict=True)
        numbers = [(*pose, mu, *np.atleast_1d(torso)[:1], is_certain) for pose, mu, torso, is_certain in rows]
        words = [(*(f"{value:.3f}" for value in row[:-1]), "yes" if row[-1] else "no") for row in numbers]
        return [("x [m]", "y [m]", "yaw [rad]", "μ", "torso [m]", "certain"), *words]

    @staticmethod
    def nothing(status: Status, positions: tuple[int, ...] = ()) -> BasePlacement:
        """An answer without bases. `positions`: (m,) for m targets."""
        none = np.empty((0, *positions))
        return BasePlacement(status, np.empty((0, 3)), np.empty(0), none, none, np.empty(0, dtype=bool))

    @staticmethod
    def of_rows(rows: Floats, configurations: Floats | None = None, joints_alone: bool = False) -> BasePlacement:
        """Answer from kernel rows (k, 7) or more columns, k ≥ 1: x, y, yaw, approach yaw, μ, torso, certain."""
        rows.setflags(write=False)
        certain = rows[:, 6] > 0.5
        certain.setflags(write=False)
        status = Status.YES if True in certain.tolist() else Status.UNKNOWN
        columns = rows[:, :3], rows[:, 4], rows[:, 5], rows[:, 3]
        return BasePlacement(status, *columns, certain, configurations, joints_alone)

    @staticmethod
    def of_multi_rows(
        rows: Floats, torsos: Floats, yaws: Floats, status: Status, configurations: Floats | None = None
    ) -> BasePlacement:
        """Answer for m positions, from kernel rows (k, 5): x, y, yaw, smallest μ, certain. `torsos` and `yaws` are (k,
        m)."""
        certain = rows[:, 4] > 0.5
        for array in (rows, torsos, yaws, certain):
            array.setflags(write=False)
        return BasePlacement(status, rows[:, :3], rows[:, 3], torsos, yaws, certain, configurations)

    def with_first_yaw(self) -> BasePlacement:
        """The same answer with one approach yaw (k,) for all positions."""
        return replace(self, approach_yaw=self.approach_yaw[:, 0])


@dataclass(frozen=True)
class PlacementBatch:
    """Answers to n queries with up to k bases each, best first. Rows beyond `count[i]` are NaN.

    Attributes:
        count: (n,) bases found.
        poses, manipulability, torso, approach_yaw, certain: (n, k, …) as in `BasePlacement`. `certain` is False where
            no base was found.
        joints_alone: as in `BasePlacement`.
    """

    count: NDArray[np.int64]
    poses: Floats
    manipulability: Floats
    torso: Floats
    approach_yaw: Floats
    certain: NDArray[np.bool_]
    joints_alone: bool = False

    def __len__(self) -> int:
        return len(self.count)

    @staticmethod
    def of_rows(rows: Floats, count: NDArray[np.int64], joints_alone: bool = False) -> PlacementBatch:
        """Answers from kernel rows (n, k, 7), see `BasePlacement.of_rows`."""
        certain = rows[..., 6] > 0.5
        for array in (rows, count, certain):
            array.setflags(write=False)
        columns = rows[..., :3], rows[..., 4], rows[..., 5], rows[..., 3]
        return PlacementBatch(count, *columns, certain, joints_alone)
