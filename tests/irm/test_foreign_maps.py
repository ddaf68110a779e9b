"""Maps of other projects: poses become cells, and are saved, loaded, inverted and queried."""

import numpy as np
import pytest

from assets import FETCH
from examples.import_pose_tables import read_irm, read_pose_table, read_reuleaux
from irm.answers import Status
from irm.errors import MapFileError, MapMismatchError, QueryError, ReachabilityError
from irm.inverse_map import ClassicalInverseReachabilityMap, InverseReachabilityMap
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation, rotations

INVERSE_MAPS = (InverseReachabilityMap, ClassicalInverseReachabilityMap)


def level_table(rng, count=400):
    """(n, 18) rows as the paper's authors publish them: a level gripper at three heights, yaws 15 degrees apart."""
    table = rng.uniform(-1, 1, (count, 18))
    table[:, 0] = 0.1 + 0.05 * rng.integers(0, 12, count)
    table[:, 1] = -0.65 + 0.05 * rng.integers(0, 17, count)
    table[:, 2] = rng.choice([0.7, 0.75, 0.8], count)
    table[:, 6], table[:, 7], table[:, 8] = -90, 90, 15 * rng.integers(-6, 7, count)
    table[:, 9] = rng.uniform(0.01, 0.11, count)
    yaw = np.radians(table[:, 8])
    table[:, 3:6] = table[:, :3] - 0.109 * np.column_stack([np.cos(yaw), np.sin(yaw), 0 * yaw])
    return table


@pytest.fixture
def table():
    return level_table(np.random.default_rng(0))


@pytest.fixture
def foreign(table, tmp_path):
    np.save(tmp_path / "table.npy", table)
    T, mu = read_pose_table(tmp_path / "table.npy")
    return ReachabilityMap.from_poses(T, mu, orientations=266, pitches=(0.0,), robot="robocare")


def test_the_authors_angles_are_read(table, tmp_path):
    np.save(tmp_path / "table.npy", table)
    T, mu = read_pose_table(tmp_path / "table.npy")
    yaw = np.radians(table[:, 8])
    np.testing.assert_allclose(T[:, :3, 0], np.column_stack([np.cos(yaw), np.sin(yaw), 0 * yaw]), atol=1e-12)
    np.testing.assert_allclose(T[:, :3, 3], table[:, :3])
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0)
    np.testing.assert_array_equal(mu, table[:, 9])
    np.savetxt(tmp_path / "table.csv", table, delimiter=",", header=",".join("abcdefghijklmnopqr"), comments="")
    np.testing.assert_allclose(read_pose_table(tmp_path / "table.csv")[0], T, atol=1e-12)


def test_the_authors_inverse_map_is_told_apart_and_read(table, tmp_path):
    """It has the same columns, and was read as a reachability map: bases were wrong, with status YES."""
    angle, inverse = np.pi - np.radians(table[:, 8]), table.copy()
    inverse[:, 0] = np.cos(angle) * table[:, 0] - np.sin(angle) * table[:, 1]
    inverse[:, 1] = np.sin(angle) * table[:, 0] + np.cos(angle) * table[:, 1]
    np.save(tmp_path / "rm.npy", table)
    np.save(tmp_path / "irm.npy", inverse)
    with pytest.raises(MapFileError, match="use read_irm"):
        read_pose_table(tmp_path / "irm.npy")
    with pytest.raises(MapFileError, match="read_pose_table"):
        read_irm(tmp_path / "rm.npy")
    T, mu = read_irm(tmp_path / "irm.npy")
    np.testing.assert_allclose(T, read_pose_table(tmp_path / "rm.npy")[0], atol=1e-9)
    np.testing.assert_array_equal(mu, table[:, 9])


def test_a_table_of_seven_columns_has_our_own_angles(tmp_path):
    row = [0.5, 0.1, 0.9, 0.3, -0.2, 0.4, 0.08]
    np.save(tmp_path / "table.npy", [row])
    T, mu = read_pose_table(tmp_path / "table.npy")
    np.testing.assert_allclose(T[0, :3, :3], rotation(0.3, -0.2, 0.4))
    np.testing.assert_allclose([*T[0, :3, 3], *mu], [0.5, 0.1, 0.9, 0.08])


def test_every_pose_is_the_centre_of_a_cell_with_its_best_value(foreign, table):
    best = {}
    for row in table:
        key = tuple(np.round(row[[0, 1, 2, 8]], 6))
        best[key] = max(best.get(key, 0.0), row[9])
    degrees = (np.degrees(foreign.yaw_pitch_roll[:, 0]) + 180) % 360 - 180
    stored = dict(
        zip(
            [tuple(np.round([*p, y], 6) + 0.0) for p, y in zip(foreign.positions, degrees, strict=True)],
            foreign.manipulability,
            strict=True,
        )
    )
    assert stored.keys() == best.keys()
    for key, value in best.items():
        assert stored[key] == pytest.approx(value)


def test_a_foreign_map_is_saved_loaded_and_inverted(foreign, tmp_path):
    foreign.save(tmp_path / "map.npz")
    loaded = ReachabilityMap.load(tmp_path / "map.npz")
    assert (loaded.key, loaded.robot, loaded.chain) == (foreign.key, "robocare", None)
    assert loaded.grid.extent() == foreign.grid.extent()
    np.testing.assert_array_equal(loaded.cells, foreign.cells)
    answer = InverseReachabilityMap(loaded).query((0.2, -0.1, 0.75))
    assert answer.status is not Status.NO
    assert (
        answer.manipulability[0] == ClassicalInverseReachabilityMap(loaded).query((0.2, -0.1, 0.75)).manipulability[0]
    )
    with pytest.raises(QueryError, match="covers TCP heights"):
        InverseReachabilityMap(loaded).query((0.2, -0.1, 1.5))


def test_a_foreign_map_and_a_robots_map_are_told_apart(foreign, coarse_map, tmp_path):
    foreign.save(tmp_path / "foreign.npz")
    coarse_map.save(tmp_path / "fetch.npz")
    with pytest.raises(MapMismatchError, match="load it without a robot"):
        ReachabilityMap.load(tmp_path / "foreign.npz", FETCH)
    with pytest.raises(MapMismatchError, match=r"of the robot 'fetch'; load it together with"):
        ReachabilityMap.load(tmp_path / "fetch.npz")


def test_what_are_no_poses_is_refused():
    good = np.eye(4)[None]
    for bad in (np.zeros((1, 4, 4)), np.eye(4), np.full((1, 4, 4), np.nan), np.diag([1, 1, -1, 1])[None], "poses"):
        with pytest.raises(QueryError, match="pose"):
            ReachabilityMap.from_poses(bad, [0.1])
    for values in ([0.0], [1.5], [np.nan], [0.1, 0.2]):
        with pytest.raises(ReachabilityError, match=r"in \(0, 1\]"):
            ReachabilityMap.from_poses(good, values)
    with pytest.raises(ReachabilityError, match="at least one pose"):
        ReachabilityMap.from_poses(np.empty((0, 4, 4)), [])
    with pytest.raises(ReachabilityError, match="none of the poses has one of these pitches"):
        ReachabilityMap.from_poses(good, [0.1], pitches=(np.pi / 2,))


def reuleaux_file(path, h5py):
    """A map of one sphere of 8 cm with its centre at (0.4, 0.1, 0.3), reached from three sides."""
    centre, radius = np.array([0.4, 0.1, 0.3]), 0.08
    yaw, pitch = np.array([0.0, np.pi / 2, 0.3]), np.array([0.0, 0.0, np.pi / 4])
    R = rotations(yaw, pitch, 0 * yaw)
    half = (yaw / 2, pitch / 2)
    c_yaw, s_yaw, c_pitch, s_pitch = np.cos(half[0]), np.sin(half[0]), np.cos(half[1]), np.sin(half[1])
    quaternions = np.column_stack([-s_yaw * s_pitch, c_yaw * s_pitch, s_yaw * c_pitch, c_yaw * c_pitch])
    points = centre - radius * R[:, :, 0]
    with h5py.File(path, "w") as file:
        file["Poses/poses_dataset"] = np.column_stack([np.tile(centre, (3, 1)), points, quaternions]).astype(np.float32)
        spheres = file.create_dataset("Spheres/sphere_dataset", data=[[*centre.astype(np.float32), 6.0]])
        spheres.attrs["Resolution"] = np.array([radius], dtype=np.float32)
    return R, points


def test_maps_of_reuleaux(tmp_path):
    h5py = pytest.importorskip("h5py")
    R, points = reuleaux_file(tmp_path / "arm_r0.08_reachability.h5", h5py)
    T, value = read_reuleaux(tmp_path / "arm_r0.08_reachability.h5")
    np.testing.assert_allclose(T[:, :3, :3], R, atol=1e-6)
    np.testing.assert_allclose(T[:, :3, 3], points, atol=1e-6)
    np.testing.assert_allclose(value, 0.06)
    assert len(ReachabilityMap.from_poses(T, value, voxel=0.08)) == 3
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = [1.0]
    (tmp_path / "text.h5").write_text("no map")
    for name in ("other.h5", "text.h5"):
        with pytest.raises(MapFileError, match="Reuleaux"):
            read_reuleaux(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read_reuleaux(tmp_path / "none.h5")
