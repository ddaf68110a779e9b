"""Bases decided by exact inverse kinematics, on request; paths off the rings of the map."""

import dataclasses

import numpy as np
import pytest

from irm.answers import Status
from irm.free_space import FreeSpace
from irm.ik.solvers import ExactSolver, SelfCollision
from irm.inverse_map import InverseReachabilityMap
from irm.kinematics import forward
from irm.reachability_map import ReachabilityMap
from irm.verification import NotVerified, tcp_poses, verify
from tests.irm.arms import CHAIN, PATH, arm_chain, in_base, in_world

SOLVER = ExactSolver(CHAIN)
PITCHES = (0.0, 0.37, -0.61, np.pi / 2)


def reaches(base, points, yaws, pitch):
    """(m,) exact answers for TCP positions (m, 3) from one base."""
    T = np.array([tcp_poses(point, yaw, pitch)[0] for point, yaw in zip(points, yaws, strict=True)])
    return SOLVER.solve(in_base(base, T))[0]


@pytest.mark.parametrize("pitch", PITCHES)
def test_exact_bases_reach_and_the_torso_height_is_one_of_a_configuration(coarse_inverse, table_floor, cups, pitch):
    some = 0
    for cup in cups[:20]:
        how = {"pitch": pitch, "yaw_range": (-0.9, 0.4), "free_space": table_floor, "k": 4}
        placement = coarse_inverse.query(cup, exact=True, **how)
        for base, yaw, is_certain, torso in zip(
            placement.poses, placement.approach_yaw, placement.certain, placement.torso, strict=True
        ):
            answer = reaches(base, [cup], [yaw], pitch)[0]
            assert answer != Status.NO.value
            assert is_certain == (answer == Status.YES.value)
            assert CHAIN.lower[0] <= torso <= CHAIN.upper[0]
            some += is_certain
        assert placement.status is (Status.YES if placement.certain.any() else Status.UNKNOWN) or not len(placement)
        assert np.all(np.diff(placement.manipulability) <= 0)
    assert some > 20


def test_the_best_base_has_a_free_configuration_wherever_a_base_has_one(coarse_map, coarse_inverse):
    rng, grid, asked = np.random.default_rng(5), coarse_map.grid, 0
    for pitch in np.tile(np.unique(grid.orientations.pitch), 12):
        point = (0.0, 0.0, rng.uniform(grid.bottom, grid.top - 1e-6))
        found = coarse_inverse.query(point, pitch=pitch)
        if not len(found):
            continue
        asked += 1
        if reaches(found.poses[0], [point], found.approach_yaw[:1], pitch)[0] != Status.YES.value:
            assert not coarse_inverse.query(point, pitch=pitch, exact=True, k=200, separation=0.0).certain.any()
    assert asked > 50


@pytest.mark.slow
def test_best_bases_of_an_arm_without_a_structure_are_decided_where_the_map_is_certain_of_none():
    """Each at one turn about the TCP: all turns of a base are the same to the arm. None of them was decided."""
    chain = arm_chain("ur5e")
    offsets = chain.offsets.copy()
    offsets[3:, :3] += 0.02
    chain, rng = dataclasses.replace(chain, offsets=offsets), np.random.default_rng(0)
    rm = ReachabilityMap.build(chain, voxel=0.15, orientations=26, samples=50_000)
    inverse_map, grid, decided = InverseReachabilityMap(rm), rm.grid, 0
    for pitch in np.tile(np.unique(grid.orientations.pitch), 8):
        point = (0.0, 0.0, rng.uniform(grid.bottom, grid.top - 1e-6))
        found = inverse_map.query(point, pitch=pitch)
        if found.configurations is not None:
            decided += found.certain[0]
            T = in_base(found.poses[0], tcp_poses(point, found.approach_yaw[0], pitch)[0])
            if found.certain[0]:
                np.testing.assert_allclose(forward(chain, found.configurations[0]), T, atol=3e-5)
                assert SelfCollision(chain)(None, found.configurations[0])
    assert decided > 0


@pytest.fixture(scope="module")
def ur5e_inverse():
    """An arm whose wrist does not roll freely: its map has rolls, 90 degrees apart."""
    return InverseReachabilityMap(ReachabilityMap.build(arm_chain("ur5e"), voxel=0.15, orientations=26, samples=50_000))


@pytest.mark.parametrize("arm", ["coarse_inverse", "ur5e_inverse"])
def test_a_query_between_the_rings_is_decided_as_often_as_with_exact(arm, request):
    """Random heights, pitches and rolls: none is on a ring of the map or in the middle of a layer."""
    inverse_map = request.getfixturevalue(arm)
    chain, grid = inverse_map.reachability_map.chain, inverse_map.reachability_map.grid
    rng, unknown, yes = np.random.default_rng(8), {None: 0, True: 0, False: 0}, 0
    for _ in range(40):
        pitch, roll = rng.uniform(-np.pi / 2, np.pi / 2), rng.uniform(-np.pi, np.pi)
        point, yaw = (0.0, 0.0, rng.uniform(grid.bottom, grid.top - 1e-6)), rng.uniform(-np.pi, np.pi)
        how = {"pitch": pitch, "roll": roll, "yaw_range": (yaw - 0.13, yaw + 0.13)}
        for exact in unknown:
            found = inverse_map.query(point, exact=exact, **how)
            unknown[exact] += found.status is Status.UNKNOWN
            if exact is None and found.status is Status.YES:
                yes += 1
                T = in_base(found.poses[0], tcp_poses(point, found.approach_yaw[0], pitch, roll)[0])
                if found.configurations is not None and found.certain[0]:
                    np.testing.assert_allclose(forward(chain, found.configurations[0])[:3, 3], T[:3, 3], atol=3e-5)
                    assert SelfCollision(chain)(None, found.configurations[0])
                elif found.certain[0]:
                    assert ExactSolver(chain, grid.torso_range).solve(T[None])[0][0] == Status.YES.value
    assert yes > 10
    assert unknown[None] == unknown[True] < unknown[False]


def test_bases_that_do_not_reach_are_dropped(coarse_inverse):
    """At the end of the arm's reach some bases of a coarse map do not reach; with `exact` none of them is left."""
    point, wrong, kept = (0.0, 0.0, 0.9), 0, 0
    for distance in np.linspace(0.5, 1.15, 30):
        edge = FreeSpace.from_boxes([(2.0 - distance + 0.3, 0.0, 4.0, 9.0)], 0.3, (-3, -3, 3.5, 3))
        how = {"pitch": 0.7, "yaw_range": (-0.5, 0.3), "free_space": edge, "k": 4}
        plain, exact = (coarse_inverse.query(point, exact=is_exact, **how) for is_exact in (False, True))
        answers = [reaches(b, [point], [y], 0.7)[0] for b, y in zip(plain.poses, plain.approach_yaw, strict=True)]
        wrong += answers.count(Status.NO.value)
        kept += len(exact)
        assert len(exact) >= len(plain) - answers.count(Status.NO.value)
        for base, yaw in zip(exact.poses, exact.approach_yaw, strict=True):
            assert reaches(base, [point], [yaw], 0.7)[0] != Status.NO.value
    assert wrong > 0
    assert kept > 50


@pytest.mark.slow
def test_a_batch_decides_exactly_too(coarse_inverse, table_floor, cups):
    how = {"pitch": 0.37, "free_space": table_floor, "k": 3, "exact": True}
    batch = coarse_inverse.query_batch(cups, yaw_ranges=(-0.9, 0.4), **how)
    for k, cup in enumerate(cups):
        found = int(batch.count[k])
        assert np.isnan(batch.poses[k, found:]).all()
        assert not batch.certain[k, found:].any()
        for rank in range(found):
            answer = reaches(batch.poses[k, rank], [cup], [batch.approach_yaw[k, rank]], 0.37)[0]
            assert answer == (Status.YES if batch.certain[k, rank] else Status.UNKNOWN).value


@pytest.mark.slow
@pytest.mark.parametrize("pitch", PITCHES)
def test_narrow_windows_of_paths_say_yes_and_are_right(coarse_inverse, table_floor, cups, pitch):
    """Off the rings too: every waypoint is reached, and small steps connect them."""
    path, said = PATH if pitch < 1.5 else PATH[2:], 0
    for cup in cups[:12]:
        whole = coarse_inverse.query_path(path, target=cup, pitch=pitch, free_space=table_floor)
        if not len(whole):
            continue
        middle = float(whole.approach_yaw[0]) + 0.1
        window = (middle - np.radians(10), middle + np.radians(10))
        placement = coarse_inverse.query_path(
            path, target=cup, pitch=pitch, free_space=table_floor, yaw_range=window, k=3
        )
        said += placement.status is Status.YES
        for base, yaw, is_certain in zip(placement.poses, placement.approach_yaw, placement.certain, strict=True):
            answers = reaches(base, in_world(cup, yaw, path), np.full(len(path), yaw), pitch)
            assert not np.any(answers == Status.NO.value)
            assert is_certain == np.all(answers == Status.YES.value)
    assert said >= 10


@pytest.mark.slow
def test_a_certain_path_is_continuous(coarse_inverse, table_floor, cups):
    for cup in cups[:10]:
        placement = coarse_inverse.query_path(
            PATH, target=cup, pitch=0.37, free_space=table_floor, yaw_range=(-0.3, 0.1)
        )
        if placement.status is not Status.YES:
            continue
        yaw = placement.approach_yaw[0]
        T = tcp_poses(in_world(cup, yaw), yaw, 0.37)
        found = verify(CHAIN, placement, lambda _, T=T: T, limit=1)
        assert not isinstance(found, NotVerified)


def test_targets_of_several_are_decided_on_request(coarse_inverse, table_floor):
    targets = [(-0.25, -0.1, 0.82), (-0.2, 0.25, 0.9)]
    placement = coarse_inverse.query_multi(targets, pitch=0.2, free_space=table_floor, k=3, exact=True)
    assert placement.status is Status.YES
    for base, yaws, torso in zip(placement.poses, placement.approach_yaw, placement.torso, strict=True):
        assert np.all(reaches(base, targets, yaws, 0.2) == Status.YES.value)
        assert torso.shape == (2,)
