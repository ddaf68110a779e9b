"""Visibility maps: their values against MuJoCo's rays, files, and bases ordered by them."""

import logging

import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.experiments.maps.bases.visibility import CameraRays
from irm.arm.kinematics import ArmChain, inverse
from irm.checks.verification import tcp_poses
from irm.errors import MapFileError, MapMismatchError, QueryError
from irm.maps.reachability import ReachabilityMap
from irm.queries.inverse import InverseReachabilityMap
from irm.visibility.map import OPENING, TARGET, VisibilityMap, cached_visibility
from irm.visibility.tie_break import EQUAL_SHARE, most_visible_first


@pytest.fixture(scope="module")
def table_map():
    return ReachabilityMap.build(FETCH, voxel=0.1, orientations=62, pitches=(0.0,), heights=(0.7, 1.1))


@pytest.fixture(scope="module")
def seen(table_map):
    return VisibilityMap.build(table_map, FETCH)


@pytest.fixture(scope="module")
def bases(table_map):
    return InverseReachabilityMap(table_map)


def test_shares_are_those_of_rays_over_other_configurations(table_map, seen):
    rng, rays, chain = np.random.default_rng(0), CameraRays(FETCH, "head", OPENING), ArmChain.from_robot(FETCH)
    rolls, apart = np.linspace(-np.pi, np.pi, 48, endpoint=False), []
    for i in rng.choice(len(table_map), 150, replace=False):
        T = tcp_poses(table_map.positions[i], table_map.yaw_pitch_roll[i, 0])[0]
        found = inverse(chain, T, [table_map.torso[i]], rolls)
        if len(found) > 8:
            truth = np.mean([rays.seen(q, np.array(TARGET) + table_map.positions[i]) for q in found])
            apart.append(abs(seen.shares[i] / 255 - truth))
    assert len(apart) > 100
    assert np.mean(apart) < 0.05
    assert 0.1 < np.mean(seen.shares == 255) < 0.9


def test_a_base_has_the_share_of_its_cell_wherever_it_stands(table_map, seen):
    rng = np.random.default_rng(1)
    cells = rng.choice(len(table_map), 500)
    p, yaw = table_map.positions[cells], table_map.yaw_pitch_roll[cells, 0]
    poses = rng.uniform((-3, -3, -np.pi), (3, 3, np.pi), (500, 3))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    points = np.column_stack(
        [poses[:, 0] + c * p[:, 0] - s * p[:, 1], poses[:, 1] + s * p[:, 0] + c * p[:, 1], p[:, 2]]
    )
    assert np.array_equal(seen.visible(poses, points, yaw + poses[:, 2]), seen.shares[cells] / 255)


def test_outside_of_the_map_nothing_is_seen(seen):
    far = seen.visible(np.zeros((3, 3)), np.array([(9.0, 0, 0.8), (0.7, 0, 5.0), (0.7, 0, -1.0)]), np.zeros(3))
    assert np.array_equal(far, np.zeros(3))


def test_the_first_base_is_the_most_visible_one_among_the_equally_good(bases, seen, table_floor, cups):
    more = 0
    for cup in cups:
        keywords = {"free_space": table_floor}
        plain, chosen = bases.query(cup, k=25, **keywords), bases.query(cup, k=5, prefer=seen, **keywords)
        if not plain:
            continue
        shares = seen.visible(plain.poses, np.array(cup), plain.approach_yaw)
        equal = plain.manipulability > (1 - EQUAL_SHARE) * plain.manipulability[0]
        first = seen.visible(chosen.poses, np.array(cup), chosen.approach_yaw)
        assert first[0] == shares[equal].max()
        assert chosen.manipulability[0] == plain.manipulability[equal][shares[equal].argmax()]
        assert {tuple(pose) for pose in chosen.poses} <= {tuple(pose) for pose in plain.poses} or len(plain) == 25
        more += first[0] > shares[0]
    assert more > 3


def test_a_batch_prefers_as_single_queries_do(bases, seen, table_floor, cups):
    batch = bases.query_batch(cups[:20], free_space=table_floor, k=3, prefer=seen)
    for i, cup in enumerate(cups[:20]):
        alone = bases.query(cup, free_space=table_floor, k=3, prefer=seen)
        assert batch.count[i] == len(alone)
        assert np.array_equal(batch.poses[i, : len(alone)], alone.poses)


def test_exact_answers_can_be_preferred_too(bases, seen, table_floor, cups):
    for cup in cups[:5]:
        answer = bases.query(cup, free_space=table_floor, k=4, prefer=seen, exact=True)
        assert len(answer) <= 4
        assert answer.certain.all()


def test_order_by_class_then_visibility_then_mu():
    rows = np.full((2, 4, 7), np.nan)
    rows[0, :, 4], rows[1, :2, 4] = (1.0, 0.95, 0.85, 0.84), (0.5, 0.2)
    shares = np.array([(0.0, 0.5, 0.5, 1.0), (0.0, 1.0, 0.0, 0.0)])
    ordered = most_visible_first(rows, np.array([4, 2]), shares, 3)
    assert ordered.rows[0, :, 4].tolist() == [0.95, 1.0, 0.84]
    assert ordered.rows[1, :2, 4].tolist() == [0.5, 0.2]
    assert ordered.counts.tolist() == [3, 2]


def test_files_and_cache(tmp_path, monkeypatch, caplog, table_map, seen):
    seen.save(tmp_path / "seen.npz")
    assert np.array_equal(VisibilityMap.load(tmp_path / "seen.npz", table_map, FETCH).shares, seen.shares)
    with pytest.raises(MapMismatchError, match="camera"):
        VisibilityMap.load(tmp_path / "seen.npz", table_map, FETCH, "gripper")
    table_map.save(tmp_path / "map.npz")
    with pytest.raises(MapFileError):
        VisibilityMap.load(tmp_path / "map.npz", table_map, FETCH)
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path / "cache"))
    few = table_map.subset(np.arange(100))
    first = cached_visibility(few, FETCH)
    (file,) = (tmp_path / "cache").iterdir()
    monkeypatch.setattr(VisibilityMap, "build", None)
    assert np.array_equal(cached_visibility(few, FETCH).shares, first.shares)
    monkeypatch.undo()
    monkeypatch.setenv("CLUTTER_ENV_CACHE", str(tmp_path / "cache"))
    file.write_bytes(file.read_bytes()[:200])
    with caplog.at_level(logging.WARNING):
        assert np.array_equal(cached_visibility(few, FETCH).shares, first.shares)
    assert "building the map again" in caplog.text


def test_misuse_is_an_error(bases, seen, table_map, lift_arm, lift_arm_map):
    with pytest.raises(QueryError, match="prefer is a VisibilityMap"):
        bases.query((0, 0, 0.8), prefer="head")
    with pytest.raises(QueryError, match="query_multi takes no prefer"):
        bases.query_multi([(0, 0, 0.8)], prefer=seen)
    with pytest.raises(QueryError, match="query_path takes no prefer"):
        bases.query_path([(0, 0, 0.8)], prefer=seen)
    with pytest.raises(MapMismatchError):
        VisibilityMap.build(lift_arm_map, FETCH)
    with pytest.raises(QueryError, match="closed form"):
        VisibilityMap.build(lift_arm_map, lift_arm)
    with pytest.raises(QueryError, match="head, gripper"):
        VisibilityMap.build(table_map, FETCH, "chest")
