"""End-effector control: the TCP goes where the action says, within the joints' limits; failures are counted."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys

import mink
import mujoco
import numpy as np
import pytest

from assets import FETCH, robot as find_robot
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.simulation.control import CONTROL_STEP
from clutter_env.simulation.end_effector import (
    _CONFIGURATION_GAIN,
    _SOLVER_DAMPING,
    EndEffectorController,
    TcpFollower,
    _MotionLimit,
)
from clutter_env.simulation.self_avoidance import _Boxes

LOWER = np.array([max(link.lower, -50.0) for link in FETCH.chain])
UPPER = np.array([min(link.upper, 50.0) for link in FETCH.chain])
MOST_CHANGE = np.array(FETCH.max_acceleration[3:]) * CONTROL_STEP


def test_joints_keep_their_limits_from_every_state() -> None:
    rng, controller = np.random.default_rng(0), EndEffectorController(FETCH)
    for case in range(100):
        q = rng.uniform(LOWER, UPPER)
        if case % 3 == 0:  # some joints at their limits
            q = np.where(rng.random(len(q)) < 0.4, np.where(rng.random(len(q)) < 0.5, LOWER, UPPER), q)
        qd = np.zeros_like(q)
        controller.reset(q)
        twist = rng.uniform(-1, 1, 6)
        for _ in range(20):
            velocity = controller.joint_velocity(twist, q, qd)
            assert (np.abs(velocity - qd) <= MOST_CHANGE + 1e-6).all()
            assert (np.abs(velocity) <= np.array(FETCH.max_velocity[3:]) + 1e-6).all()
            step = velocity * CONTROL_STEP
            beyond = np.maximum(q + step - UPPER, LOWER - q - step)
            assert beyond.max() < 2e-3, "a joint brakes before its limit; the joint controller clips the rest"
            q, qd = np.clip(q + step, LOWER, UPPER), velocity
    assert controller.failures == 0


def test_the_objective_is_the_one_that_mink_assembles_from_both_tasks() -> None:
    rng, controller = np.random.default_rng(0), EndEffectorController(FETCH)
    configuration = mink.Configuration(controller._configuration.model)
    keep_home = mink.PostureTask(configuration.model, cost=controller._costs, gain=_CONFIGURATION_GAIN)
    keep_home.set_target(np.array(FETCH.home))
    for _ in range(20):
        q = rng.uniform(LOWER, UPPER)
        controller.reset(q)
        controller.joint_velocity(rng.uniform(-1, 1, 6), q, np.zeros_like(q))
        configuration.update(controller._configuration.q)
        tasks = [controller._frame_task, keep_home]
        problem = mink.build_ik(configuration, tasks, CONTROL_STEP, _SOLVER_DAMPING, limits=[])
        quadratic, linear = controller._objective(configuration.q)
        np.testing.assert_allclose(quadratic, problem.P, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(linear, problem.q, rtol=1e-12, atol=1e-14)


FOLLOW = """
import hashlib
import numpy as np
from assets import FETCH
from clutter_env.simulation.end_effector import EndEffectorController

rng, controller, digest = np.random.default_rng(0), EndEffectorController(FETCH), hashlib.sha256()
for _ in range(10):
    q, qd = np.array(FETCH.home), np.zeros(len(FETCH.home))
    controller.reset(q)
    for twist in np.repeat(rng.uniform(-1, 1, (5, 6)), 10, axis=0):
        qd = controller.joint_velocity(twist, q, qd)
        q = q + 0.05 * qd
        digest.update(q.tobytes())
print(digest.hexdigest())
"""
PROCESSORS = (
    {},
    {"OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_CORETYPE": "Prescott"},
    {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"},
)


@pytest.mark.slow
def test_its_digits_are_the_same_on_every_processor() -> None:
    """They passed through a BLAS, and recordings of "ee" actions could not be confirmed on other processors."""
    command = [sys.executable, "-c", FOLLOW]
    runs = [
        subprocess.Popen(command, env={**os.environ, **kind}, stdout=subprocess.PIPE, text=True) for kind in PROCESSORS
    ]
    digests = [run.communicate()[0].strip() for run in runs]
    assert len(digests[0]) == 64
    assert len(set(digests)) == 1


def test_the_follower_reaches_a_pose_near_home() -> None:
    follower, home = TcpFollower(FETCH), np.array(FETCH.home)
    controller = EndEffectorController(FETCH)
    controller.reset(home)
    goal = mink.SE3(np.array(controller.wanted)).as_matrix()
    goal[:3, 3] += (-0.1, 0.05, 0.05)
    follower.reset(home)
    for _ in range(60):
        q = follower.step(goal)
    controller.reset(q)
    reached = mink.SE3(np.array(controller.wanted)).as_matrix()
    assert np.abs(reached - goal).max() < 0.005


def test_failures_of_the_inverse_kinematics_are_counted_saved_and_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = _MotionLimit.inequalities

    def contradiction(limit: _MotionLimit, *given: np.ndarray) -> tuple[np.ndarray, ...]:
        rows, upper, *others = bounds(limit, *given)
        return rows, -np.ones_like(upper), *others

    monkeypatch.setattr(_MotionLimit, "inequalities", contradiction)
    env = RetrieveEnv(num_objects=1, control_mode="ee")
    assert env.reset(seed=0)[1]["ik_failures"] == 0
    for count in (1, 2, 3):
        assert env.step(np.full(10, 0.5))[4]["ik_failures"] == count
    state = env.save_state()
    assert env.reset(seed=1)[1]["ik_failures"] == 0
    env.restore_state(state)
    assert env.info["ik_failures"] == 3


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["fetch", "pr2", "panda_mobile"])
def test_self_avoidance_has_no_pair_that_the_arm_does_not_bring_nearer(name: str) -> None:
    """Shapes of PR2's other arm divided zero by zero."""
    robot = find_robot(name)
    controller = EndEffectorController(robot)
    q = np.array(robot.home)
    controller.reset(q)
    controller.joint_velocity(np.full(6, 0.1), q, np.full_like(q, 0.1))
    assert (controller._avoidance._brakes > 0.0).all()


def test_an_arm_at_rest_gets_the_velocities_of_a_new_solve() -> None:
    """Rests of several steps, between motions, from which it moves on; each step beside a controller without a past."""
    rng, controller, fresh = np.random.default_rng(0), EndEffectorController(FETCH), EndEffectorController(FETCH)
    q, qd, rests = np.array(FETCH.home), np.zeros(len(FETCH.home)), 0
    controller.reset(q)
    for twist in np.repeat(rng.uniform(-1, 1, (8, 6)) * (np.arange(8) % 2)[:, None], 60, axis=0):
        fresh._last, fresh.wanted = ((), np.zeros_like(q)), controller.wanted
        known = controller._last
        velocity = controller.joint_velocity(twist, q, qd)
        assert velocity.tobytes() == fresh.joint_velocity(twist, q, qd).tobytes()
        assert controller.wanted == fresh.wanted
        rests += known is controller._last and not twist.any()
        q, qd = q + velocity * CONTROL_STEP, velocity.copy()
        velocity[:] = np.nan  # whoever gets it may write it
    assert rests > 60


def test_gaps_are_those_of_the_shapes_corners() -> None:
    """Shapes with a centre of their own, such as meshes, too."""
    arms = "".join(
        f'<body pos="0.1 0 0.2"><joint axis="{axis}"/><geom type="{kind}" size="0.03 0.05 0.07" pos="0 0.05 0"/>'
        f'<geom type="mesh" mesh="wedge" pos="0.1 0 0" euler="20 {number} 40"/>'
        for number, (axis, kind) in enumerate((("0 0 1", "box"), ("0 1 0", "capsule"), ("1 1 0", "cylinder")))
    )
    wedge = '<asset><mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.2 0  0 0 0.05"/></asset>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{wedge}<worldbody>{arms}{'</body>' * 3}</worldbody></mujoco>")
    pairs = np.array(list(itertools.combinations(range(model.ngeom), 2)))
    rng = np.random.default_rng(0)
    model.geom_aabb[:, :3] = rng.uniform(-0.1, 0.1, (model.ngeom, 3))
    boxes, signs = _Boxes(model, pairs), np.array(list(itertools.product((-1, 1), repeat=3)))
    for _ in range(10):
        states = [mujoco.MjData(model), mujoco.MjData(model)]
        for data in states:
            data.qpos[:] = rng.uniform(-2, 2, model.nq)
            mujoco.mj_kinematics(model, data)
        for data, gaps in zip(states, boxes.gaps(*states), strict=True):
            low, high = np.empty((2, model.ngeom, 3))
            for geom in range(model.ngeom):
                corners = (model.geom_aabb[geom, :3] + signs * model.geom_aabb[geom, 3:]) @ data.geom_xmat[
                    geom
                ].reshape(3, 3).T
                low[geom], high[geom] = corners.min(axis=0), corners.max(axis=0)
            low, high = low + data.geom_xpos, high + data.geom_xpos
            first, second = pairs.T
            expected = np.maximum(low[first] - high[second], low[second] - high[first]).max(axis=1)
            np.testing.assert_allclose(gaps, expected, atol=1e-12)
