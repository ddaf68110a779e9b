"""Reachability maps of other projects: read their TCP poses, each with how good it is, and make a map of them.

Example:
    T_base_tcp, mu = read_pose_table("robocare_right_reachability_map.npy")  # of the paper's authors
    rm = ReachabilityMap.from_poses(T_base_tcp, mu, orientations=266, pitches=(0.0,), robot="robocare")
"""

from __future__ import annotations

import importlib
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from irm.errors import MapFileError
from irm.rotations import rotation, rotations

Floats = NDArray[np.float64]
_YAW_PITCH_ROLL_COLUMNS = 7
_AUTHORS_COLUMNS = 10
_BESIDE = 1e-3
"""[m] by which the TCP may lie beside the line of the approach: their numbers have six digits."""


def read_pose_table(path: str | Path) -> tuple[Floats, Floats]:
    """Poses and manipulability from a NumPy table (.npy) or a text table (.csv), one pose a row.

    The number of columns tells which table it is:

    - 7: x, y, z [m], yaw, pitch, roll [rad] of the TCP, μ.
    - 10 or more: the table of the paper's authors (ryul1206/inverse-reachability-repositioning): x, y, z of the TCP
      [m]; x, y, z of the end effector; roll, pitch, yaw [degrees]; μ; joint angles. The angles are those of
      Rz(yaw) Ry(pitch) Rz(roll), of a frame whose z axis is the approach: a level gripper has pitch 90.

    Args:
        path: of the file.

    Returns:
        T_base_tcp (n, 4, 4), with x along the approach, and μ (n,).

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is no table of this kind, or it is the authors' inverse map: see `read_irm`.
    """
    table = _table(path)
    T, mu = _poses_of_table(table)
    if table.shape[1] >= _AUTHORS_COLUMNS and not _is_hand_ahead(T, table) and _is_hand_ahead(_turned_back(T), table):
        raise MapFileError(f"{path} is an inverse map of the paper's authors, not a reachability map: use read_irm")
    return T, mu


def read_irm(path: str | Path) -> tuple[Floats, Floats]:
    """The same from the authors' inverse map, whose x and y are those of the base: Rz(π - yaw) (x, y) of equation 5.

    All other columns are those of their reachability map, so that it follows from them.

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is no inverse map of theirs.
    """
    table = _table(path)
    T, mu = _poses_of_table(table)
    if table.shape[1] < _AUTHORS_COLUMNS or not _is_hand_ahead(_turned_back(T), table):
        raise MapFileError(f"{path} is no inverse map of the paper's authors; read_pose_table reads reachability maps")
    return _turned_back(T), mu


def _table(path: str | Path) -> Floats:
    table = _numbers(Path(path))
    if table.ndim != 2 or (table.shape[1] != _YAW_PITCH_ROLL_COLUMNS and table.shape[1] < _AUTHORS_COLUMNS):
        raise MapFileError(
            f"{path} has shape {table.shape}; a table of poses has 7 columns (x, y, z, yaw, pitch, roll, μ) or at "
            "least 10 (those of the paper's authors)"
        )
    return table


def _poses_of_table(table: Floats) -> tuple[Floats, Floats]:
    if table.shape[1] == _YAW_PITCH_ROLL_COLUMNS:
        return _poses(rotations(*table[:, 3:6].T), table[:, :3]), table[:, 6].copy()
    roll, pitch, yaw = np.radians(table[:, 6:9]).T
    nothing = np.zeros(len(table))
    approach_is_z = rotations(yaw, pitch, nothing) @ rotations(roll, nothing, nothing)
    return _poses(approach_is_z @ rotation(0.0, -np.pi / 2, 0.0), table[:, :3]), table[:, 9].copy()


def _is_hand_ahead(T: Floats, table: Floats) -> bool:
    """Whether the TCP lies ahead of the end effector, along the approach, in nearly every row: so it is in their
    reachability map, whose columns 3 to 5 are the end effector, and not in the inverse one."""
    hand = T[:, :3, 3] - table[:, 3:6]
    beside = np.linalg.norm(np.cross(hand, T[:, :3, 0]), axis=1)
    ahead = np.einsum("ni,ni->n", hand, T[:, :3, 0])
    return bool(np.mean((beside < _BESIDE) & (ahead > -_BESIDE)) > 0.99)


def _turned_back(T: Floats) -> Floats:
    """Poses of a reachability map, from those of the inverse map: x and y turned by yaw - π."""
    angle = np.arctan2(T[:, 1, 0], T[:, 0, 0]) - np.pi
    c, s, turned = np.cos(angle), np.sin(angle), T.copy()
    turned[:, 0, 3], turned[:, 1, 3] = c * T[:, 0, 3] - s * T[:, 1, 3], s * T[:, 0, 3] + c * T[:, 1, 3]
    return turned


def read_reuleaux(path: str | Path) -> tuple[Floats, Floats]:
    """Poses and reachability index from a reachability map of Reuleaux (HDF5, `/Poses/poses_dataset`).

    Each row of poses has the centre of its sphere (3), the TCP position (3) and its quaternion (x, y, z, w). Reuleaux
    knows no manipulability: the value of a pose is the index D of its sphere, 0 to 1. The TCP poses are those of the
    arm's own base frame; multiply them by T_base_arm for an arm that stands on a mobile base.

    Args:
        path: of the file.

    Returns:
        T_base_tcp (n, 4, 4), with x along the approach, and D (n,).

    Raises:
        FileNotFoundError: no such file.
        MapFileError: the file is no reachability map of Reuleaux, or h5py is not installed.
    """
    try:
        h5py = importlib.import_module("h5py")
    except ImportError as problem:
        raise MapFileError("maps of Reuleaux are HDF5 files: pip install h5py") from problem
    if not Path(path).exists():
        raise FileNotFoundError(path)
    try:
        with h5py.File(path, "r") as file:
            poses = np.asarray(file["Poses/poses_dataset"], dtype=float)
            spheres = np.asarray(file["Spheres/sphere_dataset"], dtype=float)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as problem:
        raise MapFileError(f"{path} is damaged or is no reachability map of Reuleaux ({problem})") from problem
    if poses.ndim != 2 or poses.shape[1] != 10 or spheres.ndim != 2 or spheres.shape[1] != 4:
        raise MapFileError(f"{path}: poses have 10 columns and spheres 4, not {poses.shape} and {spheres.shape}")
    index_of = {centre.tobytes(): index for centre, index in zip(_keys(spheres[:, :3]), spheres[:, 3], strict=True)}
    index = np.array([index_of.get(centre.tobytes(), 0.0) for centre in _keys(poses[:, :3])])
    return _poses(_of_quaternions(poses[:, 6:], path), poses[:, 3:6]), index / 100.0


def _numbers(path: Path) -> Floats:
    try:
        if path.suffix == ".csv":
            return np.asarray(np.loadtxt(path, delimiter=",", skiprows=_header_rows(path), ndmin=2))
        return np.asarray(np.load(path, allow_pickle=False), dtype=float)
    except FileNotFoundError:
        raise
    except (OSError, EOFError, ValueError, TypeError, MemoryError, zipfile.BadZipFile) as problem:
        raise MapFileError(f"{path} is no table of numbers ({problem})") from problem


def _header_rows(path: Path) -> int:
    """1 if the first row of a text table has titles, else 0."""
    with path.open(encoding="utf-8") as file:
        first = file.readline().split(",")[0]
    try:
        float(first)
    except ValueError:
        return 1
    return 0


def _poses(R: Floats, p: Floats) -> Floats:
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, p
    return T


def _keys(centres: Floats) -> NDArray[np.int64]:
    """Centres of spheres in micrometres: both data sets have rounded them to single precision."""
    return np.ascontiguousarray(np.round(centres * 1e6).astype(np.int64))


def _of_quaternions(xyzw: Floats, path: str | Path) -> Floats:
    """Rotations (n, 3, 3) of quaternions (n, 4) with the real part last."""
    length = np.linalg.norm(xyzw, axis=1)
    if not np.all(np.abs(length - 1.0) < 1e-3):
        raise MapFileError(f"{path} has orientations that are no unit quaternions")
    x, y, z, w = (xyzw / length[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
