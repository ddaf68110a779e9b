"""Maps written for other projects: what they read is what the map has."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from assets import FETCH
from examples.export_maps import write_point_cloud, write_reuleaux, write_rm4d
from examples.import_pose_tables import read_reuleaux
from irm import ReachabilityMap
from irm.rotations import rotation


@pytest.fixture(scope="module")
def rm() -> ReachabilityMap:
    return ReachabilityMap.build(FETCH, voxel=0.1, orientations=62, heights=(0.4, 1.0))


def test_reuleaux_reads_the_free_cells(rm: ReachabilityMap, tmp_path: Path) -> None:
    write_reuleaux(rm, tmp_path / "map.h5")
    T, index = read_reuleaux(tmp_path / "map.h5")
    free = rm.manipulability > 0
    np.testing.assert_allclose(T[:, :3, 3], rm.positions[free], atol=1e-6)
    expected = np.array([rotation(*angles) for angles in rm.yaw_pitch_roll[free]])
    np.testing.assert_allclose(T[:, :3, :3], expected, atol=1e-6)
    z, _, x, y = (axis[free] for axis in rm.indices())
    np.testing.assert_allclose(index, rm.reachability_index[z, x, y] / 100, atol=1e-6)


def test_rm4d_has_every_free_cell_and_nothing_far_from_one(rm: ReachabilityMap, tmp_path: Path) -> None:
    """Indices as `ReachabilityMap4D.get_indices_for_ee_pose` computes them."""
    write_rm4d(rm, tmp_path / "map.npy")
    d = np.load(tmp_path / "map.npy", allow_pickle=True).item()
    (low, high), (bottom, top), voxel, angles = d["xy_limits"], d["z_limits"], d["voxel_res"], d["n_bins_theta"]
    side = int(np.ceil((high - low) / voxel))
    assert d["map"].shape == (int(np.ceil((top - bottom) / voxel)), angles, side, side)
    free = rm.manipulability > 0
    p, (yaw, pitch, _) = rm.positions[free], rm.yaw_pitch_roll[free].T
    c, s = np.cos(yaw), np.sin(yaw)
    base = np.column_stack([-c * p[:, 0] - s * p[:, 1], s * p[:, 0] - c * p[:, 1]])
    theta = np.minimum(((np.pi / 2 + pitch) / (np.pi / angles) + 1e-9).astype(int), angles - 1)
    z, (x, y) = ((p[:, 2] - bottom) / voxel).astype(int), np.floor((base.T - low) / voxel).astype(int)
    found = np.zeros_like(d["map"])
    for dx in (-1, 0, 1):  # a cell's centre may lie on the edge of a bin that its turn has the centre of the next in
        for dy in (-1, 0, 1):
            found |= _marked(d["map"].shape, z, theta, x + dx, y + dy)
    assert d["map"][z, theta, x, y].mean() > 0.9
    rings = np.unique(theta)
    assert not (d["map"][:, rings] & ~_grown(found)[:, rings]).any()


def _marked(shape: tuple[int, ...], *indices: np.ndarray) -> np.ndarray:
    found = np.zeros(shape, bool)
    inside = np.all([(index >= 0) & (index < size) for index, size in zip(indices, shape, strict=True)], axis=0)
    found[tuple(index[inside] for index in indices)] = True
    return found


def _grown(found: np.ndarray) -> np.ndarray:
    grown = found.copy()
    grown[1:] |= found[:-1]
    grown[:-1] |= found[1:]
    return grown


def test_a_point_cloud_has_the_voxels(rm: ReachabilityMap, tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2")
    write_point_cloud(rm, tmp_path / "map.mcap")
    make_reader = importlib.import_module("mcap.reader").make_reader
    decoders = [importlib.import_module("mcap_ros2.decoder").DecoderFactory()]
    with (tmp_path / "map.mcap").open("rb") as file:
        ((_, channel, _, message),) = make_reader(file, decoder_factories=decoders).iter_decoded_messages()
    assert channel.topic == "/reachability"
    points = np.frombuffer(message.data, "<f4").reshape(-1, 4)
    assert message.width == len(points) == np.count_nonzero(rm.reachability_index)
    assert points[:, 3].max() == pytest.approx(rm.reachability_index.max())
    assert [field.name for field in message.fields] == ["x", "y", "z", "intensity"]
