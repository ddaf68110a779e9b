"""NO is proved: no pose of a configuration within the limits is out of reach, however its joints line up; and most of
what is out of reach is NO."""

from __future__ import annotations

import numpy as np
import pytest

from assets.robots import FETCH, PR2
from irm.chain import ArmChain
from irm.ik.exclusion import Angle, may_reach_parallel, may_reach_spherical
from irm.ik.ranges import TOLERANCE
from irm.ik.solvers import ExactSolver, SelfCollision, all_solutions, solver_arrays
from irm.ik.structure import ParallelArm, find_bounds, find_structure
from irm.ik.structured import parallel_goal, spherical_goal
from irm.map_kernels import tcp_frames
from tests.irm.arms import arm_chain, random_poses
from tests.irm.tables import baxter, hard_configurations, openarm, puma560, tiago, viperx_300s, widowx_ai

NO, UNKNOWN, YES = 0, 1, 2
KINDS = ("uniform", "limits", "inside", "right angles", "jittered")
ARMS = {
    **{f"puma560 of {digits} digits": puma560(digits) for digits in (4, 6, 9)},
    **{f"widowx ai of {digits} digits": widowx_ai(digits) for digits in (4, 6, 9)},
    "viperx 300s": viperx_300s(),
    "openarm": openarm(),
    "panda": arm_chain("panda"),
    "gen3": arm_chain("gen3"),
    "ur5e": arm_chain("ur5e"),
    "baxter": baxter(),
    "tiago": tiago(),
    "fetch": ArmChain.from_robot(FETCH),
    "pr2 on its lift": ArmChain.from_robot(PR2),
}


def poses_of(chain, q):
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = tcp_frames(solver_arrays(chain).chain, q)
    return T


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ARMS)
def test_no_pose_of_a_configuration_within_the_limits_is_out_of_reach(name, kind):
    """With structures taken for exact, and margins of 1e-9, a Puma of nine digits had 135 such of 1,000 at limits."""
    chain = ARMS[name]
    T = poses_of(chain, hard_configurations(chain, kind, 250, np.random.default_rng(0)))
    status, q = ExactSolver(chain).reach(T)
    assert not np.any(status == NO)
    assert np.mean(status == UNKNOWN) <= 0.05
    reached = q[status == YES]
    assert np.all((reached >= chain.lower - 1e-8) & (reached <= chain.upper + 1e-8))
    np.testing.assert_allclose(poses_of(chain, reached), T[status == YES], atol=3e-5)


@pytest.mark.parametrize("name", ["panda", "gen3", "pr2_arm"])
@pytest.mark.parametrize("kind", ["limits", "inside"])
def test_a_free_configuration_at_limits_is_found_though_few_angles_reach(name, kind):
    """A grid of the free joint's angles missed it: 5% of the poses of PR2's arm, whose elbow has little room, were
    UNKNOWN."""
    chain = arm_chain(name)
    q = hard_configurations(chain, kind, 600, np.random.default_rng(4))
    status, _ = ExactSolver(chain).solve(poses_of(chain, q[SelfCollision(chain).of(q)]))
    assert len(status) > 100
    assert not np.any(status == NO)
    assert np.mean(status == UNKNOWN) <= 0.03


@pytest.mark.parametrize("name", ["puma560 of 4 digits", "widowx ai of 4 digits", "openarm", "gen3", "baxter", "tiago"])
def test_nearly_all_that_is_out_of_reach_is_no(name):
    """Of arms without a closed form it was 87% (Baxter) and 60% (TIAGo)."""
    chain, rng = ARMS[name], np.random.default_rng(1)
    status, _ = ExactSolver(chain).reach(random_poses(chain, 400, rng))
    assert np.mean(status[status != YES] == NO) > 0.95


@pytest.mark.parametrize("name", ["puma560 of 4 digits", "openarm", "panda", "gen3", "baxter", "tiago"])
def test_a_box_around_a_configuration_is_never_left_out(name):
    chain, rng = ARMS[name], np.random.default_rng(2)
    arm, angles = solver_arrays(chain).bounds, np.empty((1, 7))
    free, fifth = (int(arm.columns[k]) for k in (0, 4))
    for kind in ("uniform", "limits", "right angles"):
        q = hard_configurations(chain, kind, 200, rng)
        for q_own, T in zip(q, poses_of(chain, q), strict=True):
            half = 10 ** rng.uniform(-9, 0, 3)
            beside = rng.uniform(-1, 1, 3) * half
            lowered = T[:3, 3] - (0.0, 0.0, q_own[0] + beside[0])
            goal = spherical_goal(arm, T[:3, :3].copy(), lowered)
            first = Angle(q_own[free] + beside[1] if free >= 0 else 0.0, half[1] if free >= 0 else 0.0)
            last = Angle(q_own[fifth] + beside[2], half[2])
            assert may_reach_spherical(arm, goal, half[0], first, last, arm.error + 4 * TOLERANCE, angles)


@pytest.mark.parametrize("name", ["ur5e", "widowx ai of 4 digits"])
def test_a_range_of_heights_around_a_configuration_is_never_left_out(name):
    chain, rng = ARMS[name], np.random.default_rng(3)
    arm = solver_arrays(chain).parallel
    for kind in ("uniform", "limits", "right angles"):
        q = hard_configurations(chain, kind, 200, rng)
        for T in poses_of(chain, q):
            half = 10 ** rng.uniform(-9, 0)
            lowered = T[:3, 3] - (0.0, 0.0, rng.uniform(-1, 1) * half)
            goal = parallel_goal(arm, T[:3, :3].copy(), lowered)
            assert may_reach_parallel(arm, goal, half + arm.error + 4 * (TOLERANCE + arm.turn))


def test_the_structure_of_an_arm_says_how_far_it_is_from_the_file():
    exact, rounded = find_structure(widowx_ai()), find_structure(widowx_ai(4))
    assert isinstance(exact, ParallelArm)
    assert isinstance(rounded, ParallelArm)
    assert exact.turn < rounded.turn < 3e-5
    assert rounded.turn > abs(round(np.pi / 2, 4) - np.pi / 2)
    np.testing.assert_array_equal(np.abs(rounded.axes[1:4] @ rounded.axes[1]), 1.0)
    assert find_structure(puma560(9)).error < 1e-7
    for chain, offset in ((baxter(), 0.01), (tiago(), 0.0)):
        assert find_structure(chain) is None
        np.testing.assert_allclose(np.linalg.norm(find_bounds(chain).offset), offset, atol=1e-9)


@pytest.mark.parametrize("name", ["ur5e", "widowx ai of 9 digits", "viperx 300s", "panda"])
def test_every_solution_reaches_within_the_limits_also_where_axes_of_the_wrist_line_up(name):
    """Of UR arms some were 0.1 m away: where the last axis lies along the parallel ones no angle was checked."""
    chain, rng = ARMS[name], np.random.default_rng(5)
    solver = solver_arrays(chain)
    q = hard_configurations(chain, "right angles", 300, rng)
    q[:150, -2] = np.clip(0.0, chain.lower[-2], chain.upper[-2])
    for own, T in zip(q, poses_of(chain, q), strict=True):
        free = np.array([own[solver.free] if solver.free >= 0 else 0.0])
        found = all_solutions(chain, T, own[:1], free)
        assert np.all((found >= chain.lower) & (found <= chain.upper))
        np.testing.assert_allclose(poses_of(chain, found), np.broadcast_to(T, (len(found), 4, 4)), atol=3e-5)
