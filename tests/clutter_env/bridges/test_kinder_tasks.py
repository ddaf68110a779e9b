"""What the bridge to KinDER does to its scenes, without KinDER."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from assets.robot_making import FINGERS, Mounting, make_robot
from assets.robots import FETCH
from clutter_env.bridges.kinder_tasks import _ROBOTS, KinderTask, _region, _with_linkage, standing
from planners.scene import Body, RobotState, Scene
from tests.assets.test_robot_making import ARMS
from tests.planners.scenes import HEIGHT, cylinder, table_scene


def matrix(quaternion: np.ndarray) -> np.ndarray:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


@pytest.mark.parametrize("seed", range(20))
def test_a_cube_that_has_rolled_stands_on_another_side(seed: int) -> None:
    quaternion = np.random.default_rng(seed).normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    R, found = matrix(quaternion), matrix(standing(quaternion))
    sides = R.T @ found
    np.testing.assert_allclose(np.sort(np.abs(sides), axis=1), [[0, 0, 1]] * 3, atol=1e-6)  # the same cube
    assert np.linalg.det(found) == pytest.approx(1.0)
    assert found[2, 2] == pytest.approx(np.abs(R[2]).max())


@pytest.mark.parametrize(("falls_for", "steps"), [(0, 0), (25, 30), (1000, 100)])
def test_the_robot_stands_still_while_a_cube_leans(falls_for: int, steps: int) -> None:
    class Task(KinderTask):
        _kind = _ROBOTS["tidybot"]

        def __init__(self) -> None:
            self.steps, self._theirs, self._state = 0, np.arange(10), np.arange(10.0)

        def act(self, configuration: np.ndarray, opening: float) -> None:
            np.testing.assert_array_equal(configuration, [0, 1, 2, 0, *range(3, 10)])
            assert opening == 0.085
            self.steps += 1

        def look(self) -> Scene:
            tilt = 0.3 if self.steps < falls_for else 0.02
            turned = (np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0)
            body = Body("cube", "box", np.full(3, 0.01), np.array((0.0, 0.0, 0.01)), np.array(turned))
            return Scene(FETCH, RobotState(np.zeros(3), np.array(FETCH.home), 0.0), (body,), (), supports=())

    task = Task()
    task._at_rest(task.look)
    assert task.steps == steps


class _Plant:
    """KinDER's `step` of one robot: how its joints move, integrated."""

    def __init__(self, kind: str, joints: int) -> None:
        self.kind, self.q, self.speed = kind, np.zeros(joints), np.zeros(joints)

    def __call__(self, call: str, action: list[float]) -> dict[str, Any]:
        assert call == "step"
        change, start, base = np.array(action[:-1]), self.q.copy(), len(_ROBOTS[self.kind].base_joints)
        torque = 200 * change - 30 * self.speed
        for _ in range(100):
            if self.kind == "tidybot":  # its controller computes a torque [Nm] once a step; the joints are damped
                force = torque - 50 * self.speed
            else:  # a position servo
                force = 4500 * (start + change - self.q) - 450 * self.speed
            self.speed = self.speed + 0.001 * force / 0.8  # kg m²
            self.q = self.q + 0.001 * self.speed
        self.q[:base] = start[:base] + change[:base]
        return {"qpos": self.q.tolist(), "terminated": False, "truncated": False}


@pytest.mark.parametrize("kind", _ROBOTS)
def test_the_arm_keeps_up_with_the_fastest_plan(kind: str) -> None:
    """It was told as if it stayed behind by less than it does, and planned for six times faster than it is."""
    base = len(_ROBOTS[kind].base_joints)
    plant = _Plant(kind, base + 7)

    class Task(KinderTask):
        def __init__(self) -> None:
            self._kinder, self._kind, self._theirs = plant, _ROBOTS[kind], np.arange(len(plant.q))  # type: ignore[assignment]  # a stand-in
            self._before = self._state = plant.q
            self.steps = 0

    task, wanted, speed, worst = Task(), np.zeros(11), 0.0, 0.0
    for step in range(120):
        aim = _ROBOTS[kind].arm_speed * (1 if step < 60 else -1)
        speed += float(np.clip(aim - speed, -0.2, 0.2))  # 2 rad/s²
        wanted[4:] += 0.1 * speed
        task.act(wanted, 0.085)
        worst = max(worst, float(np.abs(plant.q[base:] - wanted[4:]).max()))
    assert worst < 0.01


def test_the_hand_has_a_linkage_that_moves_with_the_fingers() -> None:
    tool = 0.16
    made, *_ = make_robot(ARMS / "ur5e.xml", Mounting("base", "wrist_3", on=(0.15, 0.7), lift=(0.0, 0.4), tool=tool))
    model = mujoco.MjModel.from_xml_string(_with_linkage(made, tool))
    data = mujoco.MjData(model)

    def widths(opening: float) -> list[float]:
        """[m] how far the shapes of each finger reach to its side."""
        for name in FINGERS:
            data.joint(name).qpos[0] = opening / 2
        mujoco.mj_forward(model, data)
        site = data.site("grip")
        geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == model.body(FINGERS[0]).id]
        across = site.xmat.reshape(3, 3)[:, 1]
        return [float((data.geom_xpos[geom] - site.xpos) @ across + model.geom_size[geom][1]) for geom in geoms]

    np.testing.assert_allclose(sorted(widths(0.04)), [0.02 + 0.014, 0.02 + 0.033], atol=1e-6)
    np.testing.assert_allclose(sorted(widths(0.0)), [0.014, 0.033], atol=1e-6)


def test_a_region_that_reaches_over_an_edge_is_on_the_table_wherever_its_middle_is() -> None:
    """The floor under its middle was taken for it, on which KinDER's check never finds the object."""
    scene = table_scene(cylinder("can", 0.0, 0.0))
    box = np.array([[-0.45, -0.1, HEIGHT + 0.008, -0.30, 0.1, HEIGHT + 0.07]])
    assert _region(scene, "front", "bowl", box, [["on", "can", "front"]]).support == "table_top"
    box = np.array([[-0.8, -0.1, -0.01, -0.7, 0.1, 0.1]])
    assert _region(scene, "there", "ground", box, [["on", "can", "there"]]).support == "floor"
