"""A second map: how much of the target a camera sees at the grasp, for each cell of a reachability map."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.arm.chain_arrays import chain_arrays
from irm.arm.kinematics import ArmChain
from irm.errors import MapFileError, MapMismatchError, QueryError
from irm.maps.archive import read_archive, write_archive
from irm.maps.cache import cache_folder, cached
from irm.maps.orientation_index import nearest_orientation, rotations
from irm.maps.reachability import ReachabilityMap
from irm.progress import ProgressBar, watched
from irm.visibility.robot_view import RobotView, read_view
from irm.visibility.sight_kernel import FULL_SHARE, fill_shares

__all__ = ["TARGET", "VisibilityMap", "cached_visibility"]

Floats = NDArray[np.float64]

FORMAT = "visibility map 1"
"""Changed whenever the numbers of a map, or their meaning, change."""

TARGET = ((0.0, 0.0, -0.04), (0.0, 0.0, 0.0), (0.0, 0.0, 0.04))
"""[m] Points of the target, relative to the TCP's position: the axis of a can that is held in its middle."""

OPENING = 0.06
"""[m] between the pads: as wide as the target."""

_ROLLS = -np.pi + (np.arange(12) + 0.5) * (2 * np.pi / 12)
"""[rad] Angles of the upper-arm roll joint for which configurations are computed."""

_CELLS_AT_A_TIME = 8192
"""Cells computed by one call of the kernel: a fraction of a second, after which the interpreter handles Ctrl-C."""


@dataclass(frozen=True, eq=False)
class VisibilityMap:
    """How much of the target a camera of the robot sees, for each cell of a reachability map.

    The TCP is at the cell's centre, and the torso at the height of the cell's best μ. The value is the share of the
    target's points that are in the image with no part of the robot in front of them, on average over the
    configurations of the arm. The head is in `RobotSpec.head_configuration`. Other objects are not considered.

    Attributes:
        reachability_map: the map whose cells these are.
        key: digest of everything the values depend on.
        shares: (n,) uint8, one for each cell of the reachability map; 255 is all. Read-only.

    Example:
        seen = cached_visibility(reachability_map, FETCH)
        placement = inverse_map.query((0.1, 0.0, 0.85), free_space=floor, prefer=seen)
    """

    reachability_map: ReachabilityMap
    key: str
    shares: NDArray[np.uint8]

    @staticmethod
    def build(
        reachability_map: ReachabilityMap,
        robot: RobotSpec,
        camera: str = "head",
        *,
        progress: ProgressBar | None = None,
    ) -> VisibilityMap:
        """The visibility map of a robot.

        Args:
            reachability_map: of the same robot.
            robot: with a model; its arm has the structure of Fetch's arm.
            camera: name of a camera of the model.
            progress: shows how far it is, such as `tqdm.tqdm`.

        Raises:
            QueryError: the model has no such camera, or the arm has no closed form.
            MapMismatchError: the reachability map is that of another arm.
        """
        view, chain = _view_of(reachability_map, robot, camera), ArmChain.from_robot(robot)
        orientation = reachability_map.indices()[1]
        R = rotations(*reachability_map.grid.orientations.angles.T)
        positions, torso = reachability_map.positions, reachability_map.torso
        shares, target, arm = np.empty(len(reachability_map), dtype=np.uint8), np.array(TARGET), chain_arrays(chain)
        starts = range(0, len(shares), _CELLS_AT_A_TIME)
        for first in watched(starts, "visibility map", len(starts), progress):
            some = slice(first, first + _CELLS_AT_A_TIME)
            poses = R, orientation[some], positions[some], torso[some]
            fill_shares(arm, view, *poses, _ROLLS, target, shares[some])
        shares.setflags(write=False)
        return VisibilityMap(reachability_map, _key(reachability_map, view), shares)

    def visible(
        self, bases: Floats, points: Floats, approach_yaws: Floats, pitch: float = 0.0, roll: float = 0.0
    ) -> Floats:
        """How much of the target the camera sees from m bases, in [0, 1]; 0 where the arm does not reach.

        Args:
            bases: (m, 3) x, y [m] and yaw [rad].
            points: (m, 3), or (3,) for all, TCP positions in the world [m].
            approach_yaws: (m,) of the TCP in the world [rad].
            pitch: of the TCP [rad].
            roll: of the TCP [rad].
        """
        rm, grid = self.reachability_map, self.reachability_map.grid
        turn = approach_yaws - bases[:, 2]
        offset, c, s = points - np.pad(bases[:, :2], ((0, 0), (0, 1))), np.cos(bases[:, 2]), np.sin(bases[:, 2])
        ahead, aside = c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]
        index = np.array(
            [
                np.floor((offset[:, 2] - grid.bottom) / grid.thickness),
                nearest_orientation(
                    grid.orientations, rotations(turn, np.full(len(turn), pitch), np.full(len(turn), roll))
                ),
                np.floor((ahead - grid.centre[0]) / grid.voxel) + grid.half,
                np.floor((aside - grid.centre[1]) / grid.voxel) + grid.half,
            ]
        ).astype(np.int64)
        inside = np.all((index >= 0) & (index < np.array(grid.shape)[:, None]), axis=0)
        cells = np.ravel_multi_index(tuple(index), grid.shape, mode="clip")
        place = np.minimum(np.searchsorted(rm.cells, cells), len(rm) - 1)
        return np.where(inside & (rm.cells[place] == cells), self.shares[place] / FULL_SHARE, 0.0)

    def save(self, path: str | Path) -> None:
        """Write the map to one `.npz` file.

        Raises:
            OSError: the disk is full or cannot be written; an old file of that name stays.
        """
        write_archive(Path(path), {"format": FORMAT, "key": self.key}, {"shares": self.shares})

    @staticmethod
    def load(
        path: str | Path, reachability_map: ReachabilityMap, robot: RobotSpec, camera: str = "head"
    ) -> VisibilityMap:
        """Read a map that `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            MapFileError: the file is damaged or is no visibility map.
            MapMismatchError: it belongs to another reachability map, robot or camera.
        """
        key = _key(reachability_map, _view_of(reachability_map, robot, camera))
        about, arrays = read_archive(Path(path), ["shares"])
        if about.get("format") != FORMAT:
            raise MapFileError(f"{path} is no {FORMAT!r} but {about.get('format')!r}; build it again")
        if about.get("key") != key:
            raise MapMismatchError(f"{path} belongs to another map, robot or camera; build it again")
        shares = arrays["shares"]
        if shares.dtype != np.uint8 or shares.shape != (len(reachability_map),):
            raise MapFileError(f"{path}: the shares have the wrong type or shape; build it again")
        shares.setflags(write=False)
        return VisibilityMap(reachability_map, key, shares)


def cached_visibility(
    reachability_map: ReachabilityMap, robot: RobotSpec, camera: str = "head", *, progress: ProgressBar | None = None
) -> VisibilityMap:
    """The visibility map from the user's cache, built at the first call; arguments as of `VisibilityMap.build`."""
    key = _key(reachability_map, _view_of(reachability_map, robot, camera))
    return cached(
        cache_folder() / f"{robot.name}-visibility-{key}.npz",
        lambda path: VisibilityMap.load(path, reachability_map, robot, camera),
        lambda: VisibilityMap.build(reachability_map, robot, camera, progress=progress),
    )


def _view_of(reachability_map: ReachabilityMap, robot: RobotSpec, camera: str) -> RobotView:
    """The view of a robot whose map this is."""
    if reachability_map.robot != robot.name:
        raise MapMismatchError(f"this is a map of {reachability_map.robot!r}, not of {robot.name!r}")
    if not ArmChain.from_robot(robot).has_closed_form:
        raise QueryError(f"a visibility map needs an arm with a closed form; {robot.name} has none")
    return read_view(robot, camera, OPENING)


def _key(reachability_map: ReachabilityMap, view: RobotView) -> str:
    """Digest of everything a visibility map depends on: format, reachability map, camera, solids, target."""
    digest = hashlib.sha256(f"{FORMAT} {reachability_map.key}".encode())
    for array in (*view, TARGET, _ROLLS):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
