"""Reachability maps for other projects: Reuleaux (HDF5), RM4D (NumPy), and a ROS 2 point cloud (MCAP).

    python examples/export_maps.py --robot fetch --out outputs/maps

Reuleaux needs h5py, the point cloud the extra [ros]; neither needs ROS.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from assets.robots import robot as find_robot
from irm import ReachabilityMap, cached_map

_POINT_CLOUD = "\n".join(
    [
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian",
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense",
        "=" * 80,
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "=" * 80,
        "MSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count",
    ]
)
"""Definition of `sensor_msgs/msg/PointCloud2` as ROS 2 has it, comments and constants left out."""
_FLOAT32 = 7
"""Number of this type in `sensor_msgs/msg/PointField`."""
_HAIR = 1e-9
"""[m]"""


def write_reuleaux(rm: ReachabilityMap, path: str | Path) -> None:
    """Write the free cells as a reachability map of Reuleaux, which `read_reuleaux` reads too.

    `/Poses/poses_dataset` (n, 10) has the centre of a voxel, the TCP position, which is that centre here, and the
    quaternion (x, y, z, w) of a TCP with x along the approach; `/Spheres/sphere_dataset` (m, 4) the centres and the
    index D of equation 1, with the voxel's edge as attribute `Resolution`.
    """
    h5py = importlib.import_module("h5py")
    free = rm.manipulability > 0
    centres = rm.positions[free]
    quaternions = Rotation.from_euler("ZYX", rm.yaw_pitch_roll[free]).as_quat()
    spheres = _voxels(rm)
    with h5py.File(path, "w") as file:
        file["Poses/poses_dataset"] = np.hstack([centres, centres, quaternions]).astype(np.float32)
        file["Spheres/sphere_dataset"] = spheres
        file["Spheres/sphere_dataset"].attrs["Resolution"] = np.float32(rm.grid.voxel)


def write_rm4d(rm: ReachabilityMap, path: str | Path, angles: int = 36) -> None:
    """Write the map in the four dimensions of RM4D (Rudorfer 2024), for `ReachabilityMap4D.from_file`.

    The gripper's z axis is the approach there. A bin of height, angle between approach and vertical, and base position
    seen from the gripper is in reach if our nearest cell is, for any yaw of the base: RM4D does not distinguish them.

    Args:
        rm: the map.
        path: of the file, `.npy`.
        angles: bins of the angle between approach and vertical; each has the nearest pitch of the map.
    """
    grid, voxel, reachable = rm.grid, rm.grid.voxel, rm.reachable
    widest = grid.half * voxel + max(abs(value) for value in grid.centre)
    bins = 2 * int(np.ceil(widest / voxel))
    low = int(np.floor(grid.bottom / voxel))
    heights = int(np.ceil((grid.bottom + grid.layers * grid.thickness) / voxel)) - low
    middles = (np.arange(bins) - bins / 2 + 0.5) * voxel
    layers = np.floor(((low + np.arange(heights) + 0.5) * voxel - grid.bottom) / grid.thickness).astype(int)
    is_layer = (layers >= 0) & (layers < grid.layers)
    yaw, pitch, _ = grid.orientations.angles.T
    theta = np.pi / 2 + pitch  # between approach and vertical: a positive pitch points down
    nearest = np.abs((np.arange(angles)[:, None] + 0.5) * np.pi / angles - theta)
    is_of_bin = nearest <= nearest.min(axis=1, keepdims=True) + 1e-9
    found = np.zeros((heights, angles, bins, bins), bool)
    x, y = np.meshgrid(-middles, -middles, indexing="ij")  # of the gripper, seen from the base, approach along x
    for orientation in np.flatnonzero(is_of_bin.any(axis=0)):
        c, s = np.cos(yaw[orientation]), np.sin(yaw[orientation])
        columns = np.stack([c * x - s * y - grid.centre[0], s * x + c * y - grid.centre[1]])
        i, j = np.floor(columns / voxel + 1e-9).astype(int) + grid.half
        is_inside = (i >= 0) & (i < 2 * grid.half) & (j >= 0) & (j < 2 * grid.half)
        slices = np.zeros((heights, bins, bins), bool)
        of_layers = reachable[layers[is_layer], orientation]
        slices[np.ix_(is_layer, *map(np.arange, (bins, bins)))] = (
            of_layers[:, np.where(is_inside, i, 0), np.where(is_inside, j, 0)] & is_inside
        )
        found[:, is_of_bin[:, orientation]] |= slices[:, None]
    # Its reader counts the bins from these, rounded up.
    half, top = bins / 2 * voxel - _HAIR, (low + heights) * voxel - _HAIR
    content = {"map": found, "xy_limits": [-half, half], "z_limits": [low * voxel, top]}
    content |= {"voxel_res": voxel, "n_bins_theta": angles}
    with Path(path).open("wb") as file:
        np.save(file, np.array(content, dtype=object), allow_pickle=True)


def write_point_cloud(rm: ReachabilityMap, path: str | Path, frame: str = "base_link") -> None:
    """Write voxels and their index D [%] as `sensor_msgs/msg/PointCloud2` on `/reachability`, x, y, z, intensity."""
    points = _voxels(rm).astype("<f4")
    fields = [
        {"name": name, "offset": 4 * number, "datatype": _FLOAT32, "count": 1}
        for number, name in enumerate(("x", "y", "z", "intensity"))
    ]
    message: dict[str, Any] = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame},
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": 16,
        "row_step": points.nbytes,
        "data": points.tobytes(),
        "is_dense": True,
    }
    with Path(path).open("wb") as file:
        writer = importlib.import_module("mcap_ros2.writer").Writer(file)
        kind = writer.register_msgdef("sensor_msgs/msg/PointCloud2", _POINT_CLOUD)
        writer.write_message("/reachability", kind, message, log_time=0, publish_time=0)
        writer.finish()


def _voxels(rm: ReachabilityMap) -> NDArray[np.float64]:
    """(m, 4) centre [m] and index D [%] of every voxel in reach."""
    grid, index = rm.grid, rm.reachability_index
    z, x, y = np.nonzero(index)
    height = grid.bottom + (z + 0.5) * grid.thickness
    centres = np.column_stack([grid.axis(0)[x], grid.axis(1)[y], height]).astype(np.float32)  # as poses are written
    return np.column_stack([centres, index[z, x, y]])


def main(robot: str = "fetch", out: Path = Path("outputs/maps")) -> None:
    """Write the default map of a robot in all three formats.

    Args:
        robot: its name.
        out: directory.
    """
    rm = cached_map(find_robot(robot))
    out.mkdir(parents=True, exist_ok=True)
    for write, name in (
        (write_reuleaux, "reuleaux.h5"),
        (write_rm4d, "rm4d.npy"),
        (write_point_cloud, "point_cloud.mcap"),
    ):
        write(rm, out / f"{robot}_{name}")
        print(f"written: {out / f'{robot}_{name}'}")


if __name__ == "__main__":
    tyro.cli(main)
