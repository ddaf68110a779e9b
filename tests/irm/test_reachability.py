"""Reachability maps: every cell is reached, with the μ and torso height that it says."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pytest

from assets import robot
from assets.robots import FETCH
from irm.answers import Status
from irm.chain import ArmChain
from irm.errors import ReachabilityError
from irm.free_space import FreeSpace
from irm.grid import MapGrid, MapParameters, Orientations, nearest_orientation
from irm.ik.closed_form import ik_pan
from irm.ik.numerical import random_seeds
from irm.ik.solvers import ExactSolver
from irm.inverse_map import InverseReachabilityMap
from irm.kinematics import forward, link_frames
from irm.map_images import any_pair_near, images_of, touching
from irm.map_kernels import PAN_SAMPLES, shapes_at_every_roll
from irm.reachability_map import ReachabilityMap
from irm.rotations import rotation, rotations, yaw_pitch_roll
from irm.self_contact import CLEARANCE
from irm.shapes import is_pair_near, make_placed, place_shapes
from irm.verification import SelfCollision, decide, tcp_poses
from tests.irm.arms import (
    ARM,
    CHAIN,
    arm_chain,
    in_base,
    inverse,
    jacobian,
    manipulability,
    random_configurations,
    solve,
)
from tests.irm.tables import puma560


def test_every_pose_of_a_map_has_an_exact_solution_as_good_as_it_says(coarse_map):
    rng = np.random.default_rng(0)
    positions, angles, torso = coarse_map.positions, coarse_map.yaw_pitch_roll, coarse_map.torso
    is_free = SelfCollision(CHAIN)
    rolls = np.linspace(-np.pi, np.pi, 2000, endpoint=False)  # some families of solutions are narrow
    for k in rng.choice(np.flatnonzero(coarse_map.manipulability), 16, replace=False):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation(*angles[k]), positions[k]
        found = inverse(CHAIN, T, [torso[k]], rolls)
        assert len(found)
        best = max(manipulability(jacobian(CHAIN, q)) for q in found if is_free(None, q))
        assert best > 0.9 * coarse_map.manipulability[k] - 0.005


def test_the_eight_images_of_a_voxel_are_those_of_a_scan_of_their_own(coarse_map):
    """A slow reference without symmetry: every pan sample of a cell by itself."""
    rng = np.random.default_rng(1)
    pans = (np.arange(PAN_SAMPLES) + 0.5) * 2 * np.pi / PAN_SAMPLES
    pans = (pans + np.pi) % (2 * np.pi) - np.pi
    pans = pans[(pans >= CHAIN.lower[1]) & (pans <= CHAIN.upper[1])]
    rows, reached = np.empty((2, 5)), 0
    is_free = SelfCollision(dataclasses.replace(CHAIN, shapes=shapes_at_every_roll(CHAIN)))
    grid = coarse_map.grid
    for _ in range(150):
        cell = [int(rng.integers(low, high)) for low, high in ((4, 12), (0, grid.shape[1]), (3, 21), (3, 21))]
        z, o, i, j = cell
        R = rotation(*coarse_map.grid.orientations.angles[o])
        best = 0.0
        for torso in grid.torsos:
            p = np.array([grid.axis(0)[i], grid.axis(1)[j], grid.layer_height(z)])
            wrist = p - CHAIN.links[6] * R[:, 0] - [CHAIN.links[0], 0.0, CHAIN.links[1] + torso]
            for pan in pans:
                for k in range(ik_pan(ARM, R[:, 0].copy(), wrist, np.cos(pan), np.sin(pan), rows)):
                    q = [torso, pan, *rows[k], 0.0]
                    best = max(best, manipulability(jacobian(CHAIN, q)) * is_free(None, q))
        number = np.ravel_multi_index(cell, grid.shape)
        place = np.searchsorted(coarse_map.cells, number)
        stored = coarse_map.manipulability[place] if number in coarse_map.cells else 0.0
        assert stored == pytest.approx(best, abs=1e-6)
        reached += best > 0
    assert reached > 10


def test_reachability_index_counts_orientations(coarse_map):
    index = coarse_map.reachability_index
    assert index.max() <= 100.0
    assert index.sum() == pytest.approx(np.count_nonzero(coarse_map.manipulability) / 62 * 100)


def test_orientations_number_and_index_themselves():
    for count in (6, 26, 62, 114, 266):
        parameters = MapParameters(orientations=count)
        for rolls, free in ((1, True), (4, False)):
            orientations = Orientations.sample(dataclasses.replace(parameters, rolls=rolls), free)
            assert orientations.size == (count - 2) * rolls + 2 * rolls
            R = np.array([rotation(*angles) for angles in orientations.angles])
            np.testing.assert_array_equal(nearest_orientation(orientations, R), np.arange(orientations.size))
            turned = np.array([rotation(*angles) for angles in yaw_pitch_roll(R)])
            np.testing.assert_allclose(turned, R, atol=1e-9)


def test_saving_and_loading_gives_the_same_map(coarse_map, tmp_path):
    file = tmp_path / "deep" / "map.npz"
    coarse_map.save(file)
    loaded = ReachabilityMap.load(file, FETCH)
    assert loaded.parameters == coarse_map.parameters
    assert loaded.key == coarse_map.key
    for name in ("cells", "manipulability", "torso_index", "flags"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(coarse_map, name))
        assert not getattr(loaded, name).flags.writeable
    assert list(tmp_path.glob("deep/*")) == [file]


def test_a_part_of_a_map_can_be_kept(coarse_map, tmp_path):
    part = coarse_map.subset(coarse_map.positions[:, 2] < 0.8)
    part.save(tmp_path / "part.npz")
    assert len(ReachabilityMap.load(tmp_path / "part.npz", FETCH)) == len(part) < len(coarse_map)
    assert part.key != coarse_map.key


def test_parameters_that_make_no_sense_are_refused():
    wrong = {
        "orientations": (60, "there are sets of 6, 26, 62"),
        "voxel": (0.0, "voxel"),
        "heights": ((1.0, 0.5), "pair"),
    }
    for name, (value, reason) in {**wrong, "torso_margin": (float("nan"), "torso_margin")}.items():
        with pytest.raises(ReachabilityError, match=reason):
            MapParameters(**{name: value})
    for name, value, reason in (("pitches", (0.1,), "rings, at"), ("heights", (4.0, 5.0), "reaches nothing")):
        with pytest.raises(ReachabilityError, match=reason):
            ReachabilityMap.build(FETCH, **{name: value})


def test_a_fixed_torso_reaches_less_and_keeps_its_height():
    free = ReachabilityMap.build(FETCH, voxel=0.2, orientations=26)
    fixed = ReachabilityMap.build(FETCH, voxel=0.2, orientations=26, lift=False)
    assert len(fixed) < len(free)
    np.testing.assert_allclose(fixed.torso, FETCH.home[0])
    assert free.torso.min() >= CHAIN.lower[0]
    assert free.torso.max() <= CHAIN.upper[0]


def test_progress_is_shown_by_the_callers_function() -> None:
    """It was a bar of tqdm, which fills a log file."""
    shown = []

    def record(items: Iterable[Any], desc: str, total: int) -> Iterator[Any]:
        shown.extend((desc, total))
        for item in items:
            shown.append(item)
            yield item

    small = {"voxel": 0.2, "orientations": 26}
    built = ReachabilityMap.build(FETCH, progress=record, **small)
    name, total, *layers = shown
    assert (name, total) == ("reachability map", len(layers))
    assert len(built) == len(ReachabilityMap.build(FETCH, **small))
    with pytest.raises(ReachabilityError, match="progress=True must be None or a function"):
        ReachabilityMap.build(FETCH, progress=True, **small)  # what earlier versions took


def test_a_lift_of_a_millimetre_does_not_make_layers_of_a_millimetre():
    """As robots have that `robot make` makes of an arm without one: their map was to have 1.3 billion cells."""
    fixed = puma560(9)
    short = dataclasses.replace(fixed, upper=np.concatenate([[1e-3], fixed.upper[1:]]))
    how = {"voxel": 0.1, "orientations": 6, "samples": 20_000}
    rm, other = (ReachabilityMap.build(chain, **how) for chain in (short, fixed))
    assert rm.grid.shape == other.grid.shape
    np.testing.assert_array_equal(rm.manipulability, other.manipulability)
    assert rm.grid.torso_range == (0.0, 1e-3), "of exact answers"
    q = random_configurations(short, 50, np.random.default_rng(0))
    assert np.all(decide(rm, np.array([forward(short, row) for row in q])) == Status.YES.value)
    assert InverseReachabilityMap(rm).query((0.5, 0.0, 0.5), exact=True).status is Status.YES


@pytest.mark.parametrize("voxel", [0.02, 0.05, 0.1, 0.5])
def test_torso_heights_reach_both_ends_of_the_lift(voxel):
    grid = MapGrid.of(CHAIN, MapParameters(voxel=voxel))
    assert grid.torsos[0] == CHAIN.lower[0]
    assert grid.torsos[-1] == CHAIN.upper[0]
    assert 0.0 < grid.thickness <= voxel + 1e-12
    np.testing.assert_allclose(np.diff(grid.torsos), grid.thickness)
    assert grid.top == pytest.approx(grid.bottom + grid.layers * grid.thickness)


def test_nearly_all_centres_in_reach_are_in_the_map(coarse_map):
    """Against the exact solver at random centres of cells: none too many, and few are missed."""
    grid, rng = coarse_map.grid, np.random.default_rng(0)
    cells = rng.choice(grid.size, 12_000, replace=False)
    z, orientation, x, y = np.unravel_index(cells, grid.shape)
    T = np.tile(np.eye(4), (len(cells), 1, 1))
    T[:, :3, :3] = rotations(*grid.orientations.angles[orientation].T)
    T[:, :3, 3] = np.column_stack([grid.axis(0)[x], grid.axis(1)[y], grid.bottom + (z + 0.5) * grid.thickness])
    answers = ExactSolver(CHAIN).solve(T)[0]
    in_map, truth = coarse_map.reachable[z, orientation, x, y], answers == 2
    assert truth.sum() > 800
    assert not np.any(in_map & (answers == 0))
    assert np.mean(in_map[truth]) > 0.95
    reached = ExactSolver(CHAIN).reach(T)[0] == 2
    in_map = coarse_map.reached[z, orientation, x, y]
    assert not np.any(in_map & ~reached)
    assert np.mean(in_map[reached]) > 0.975


def test_every_cell_of_a_sampled_map_is_reached(lift_arm_map):
    chain, rng = lift_arm_map.chain, np.random.default_rng(2)
    positions, angles, torso = lift_arm_map.positions, lift_arm_map.yaw_pitch_roll, lift_arm_map.torso
    unsolved = 0
    for k in rng.choice(np.flatnonzero(lift_arm_map.manipulability), 20, replace=False):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation(*angles[k]), positions[k]
        found = solve(chain, T, random_seeds(chain, 150, torso[k], rng))
        unsolved += len(found) == 0
        if len(found):
            best = max(manipulability(jacobian(chain, q)) for q in found)
            assert lift_arm_map.manipulability[k] <= best + 1e-3
    assert unsolved <= 1


@pytest.mark.slow
def test_bases_for_a_sampled_map_reach(lift_arm_map):
    inverse_map, grid, rng = InverseReachabilityMap(lift_arm_map), lift_arm_map.grid, np.random.default_rng(3)
    floor, z = FreeSpace.from_boxes([(0, 0, 0.6, 1.0)], 0.3), grid.layer_height(grid.layer(0.9))
    for k in range(12):
        tcp, roll = (*rng.uniform(-0.2, 0.2, 2), z), (0.0, np.pi / 2)[k % 2]
        placement = inverse_map.query(tcp, roll=roll, free_space=floor)
        T = in_base(placement.poses[0], tcp_poses(tcp, placement.approach_yaw[0], 0.0, roll)[0])
        assert len(solve(lift_arm_map.chain, T, random_seeds(lift_arm_map.chain, 200, placement.torso[0], rng)))


@pytest.mark.slow
def test_without_its_closed_form_fetch_gets_nearly_the_same_map():
    """Of the joints alone: free configurations of high μ are rare, and sampling finds others."""
    parameters = {"voxel": 0.15, "orientations": 26, "heights": (0.6, 1.2), "lift": False, "self_collision": False}
    exact = ReachabilityMap.build(FETCH, **parameters)
    sampled = ReachabilityMap.build(dataclasses.replace(FETCH, closed_form_ik=""), samples=100_000, **parameters)
    both = np.intersect1d(exact.cells, sampled.cells).size
    assert both > 0.93 * len(exact)
    assert both > 0.97 * len(sampled)
    mu_exact = exact.manipulability[np.isin(exact.cells, sampled.cells)]
    mu_sampled = sampled.manipulability[np.isin(sampled.cells, exact.cells)]
    assert np.mean(mu_sampled > 0.8 * mu_exact) > 0.9
    assert exact.key != sampled.key


def test_images_of_cells_under_turns_of_the_first_and_the_last_joint_are_reached():
    """Panda: neither joint turns without limit. One cell of up to sixteen is solved; all that it gives must be true."""
    chain = arm_chain("panda")
    rm = ReachabilityMap.build(chain, voxel=0.2, orientations=26, samples=20_000)
    images = images_of(chain, rm.grid)
    assert (images.quarters, images.rolls) == (4, 4)
    positions, angles = rm.positions, rm.yaw_pitch_roll
    free, rng = rm.manipulability > 0, np.random.default_rng(0)
    T = np.tile(np.eye(4), (len(rm), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotations(*angles.T), positions
    for mine, solve_all in ((free, "solve"), (np.ones(len(rm), dtype=bool), "reach")):
        some = rng.choice(np.flatnonzero(mine), 150, replace=False)
        answers, _ = getattr(ExactSolver(chain), solve_all)(T[some])
        assert np.mean(answers == Status.YES.value) > 0.98  # by its own search; the rest is not known to be wrong
        assert not np.any(answers == Status.NO.value)
    quadrant = 2 * (positions[free, 0] > rm.grid.centre[0]) + (positions[free, 1] > rm.grid.centre[1])
    counts = np.bincount(quadrant, minlength=4)
    assert counts.min() > 0.8 * counts.max()


def test_the_pair_that_touched_last_is_tested_first_and_no_pair_is_forgotten():
    chain, rng = ArmChain.of(robot("panda_mobile")), np.random.default_rng(3)
    images = images_of(chain, MapGrid.of(chain, MapParameters(voxel=0.2, orientations=26)))
    pairs = np.concatenate(touching(chain, chain.shapes, images)[:6])
    before, placed, touches = pairs.copy(), make_placed(chain.shapes), 0
    for q in random_seeds(chain, 300, 0.0, rng):
        place_shapes(chain.shapes, placed, *link_frames(chain, q))
        near = [is_pair_near(placed.solids, *pair, CLEARANCE, placed.simplex) for pair in before.tolist()]
        assert any_pair_near(placed, pairs) == any(near)
        touches += any(near)
        assert not any(near) or pairs[0].tolist() in before[near].tolist()
    assert touches > 20
    assert sorted(pairs.tolist()) == sorted(before.tolist())
