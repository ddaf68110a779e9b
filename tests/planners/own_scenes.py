"""Scenes that are not of this package: the user's own MJCF around the robot, and its own judge of plans."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import FETCH, RobotSpec
from planners.scene import HeldObject, Scene
from planners.tamp.solution import Solution

TABLE_X, TOP = 1.1, 0.74
"""[m] The table stands in front of the robot, which is at the origin."""
MOVABLE = ("can", "box_a", "box_b")
SUPPORT = "table"

KITCHEN = """
<mujoco model="kitchen">
  <include file="{robot}"/>
  <asset>
    <mesh name="wedge" vertex="-.05 -.06 -.1  .05 -.06 -.1  -.05 .06 -.1  .05 .06 -.1  0 -.06 .5  0 .06 .5"/>
  </asset>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1"/>
    <geom name="back_wall" type="plane" size="1 1 1" pos="1.5 0 0" zaxis="-1 0 0"/>
    <geom name="left_wall" type="plane" size="1 1 1" pos="0 0.9 0" zaxis="0 -1 0"/>
    <geom name="right_wall" type="plane" size="1 1 1" pos="0 -0.9 0" zaxis="0 1 0"/>
    <body name="table" pos="{x} 0 0">
      <geom name="leg" type="cylinder" size="0.05 0.35" pos="0 0 0.35"/>
      <geom name="plate" type="box" size="0.35 0.5 0.02" pos="0 0 0.72"/>
    </body>
    <body name="can" pos="{x} 0.02 {z_can}"><freejoint/><geom type="cylinder" size="0.03 0.06" mass="0.3"/></body>
    <body name="box_a" pos="{x_a} 0.02 {z_box}"><freejoint/><geom type="box" size="0.03 0.03 0.08" mass="0.3"/></body>
    <body name="box_b" pos="{x} -0.25 {z_box}"><freejoint/><geom type="box" size="0.03 0.03 0.08" mass="0.3"/></body>
    {extra}
  </worldbody>
</mujoco>
"""


def kitchen(extra: str = "", robot: RobotSpec = FETCH) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A table in an alcove with a can and two boxes, the robot at home before it, and what is in `extra` (MJCF)."""
    places = {"x": TABLE_X, "x_a": TABLE_X - 0.12, "z_can": TOP + 0.06, "z_box": TOP + 0.08}
    model = mujoco.MjModel.from_xml_string(KITCHEN.format(robot=robot.mjcf_path, extra=extra, **places))
    data = mujoco.MjData(model)
    names, values = (*robot.drive_joints[3:], *robot.head_joints), (*robot.home, *robot.head_configuration)
    for joint, value in zip(names, values, strict=True):
        data.joint(joint).qpos = value
    for joint in robot.finger_joints:
        data.joint(joint).qpos = robot.max_finger_position
    mujoco.mj_forward(model, data)
    return model, data


def read(model: mujoco.MjModel, data: mujoco.MjData) -> Scene:
    """The scene with the can and the boxes movable."""
    return Scene.from_mujoco(model, data, FETCH, movable=MOVABLE, support=SUPPORT)


def deepest(
    model: mujoco.MjModel, solution: Solution, geoms: Sequence[str | int], step: int = 1
) -> tuple[float, NDArray[np.float64]]:
    """How deep [m] the robot, or the object that it holds, gets into these geoms of the user's own model.

    Every sample of every trajectory is replayed there, and `mj_geomDistance` asked, whatever the contact bits say.
    Returns the depth, 0 for none, and the whole-body configuration where it happens.
    """
    data = mujoco.MjData(model)
    columns = [model.joint(name).qposadr[0] for name in FETCH.drive_joints]
    fingers = [model.joint(name).qposadr[0] for name in FETCH.finger_joints]
    base = model.body(FETCH.base_body).id
    robot = [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] == base and model.geom_contype[g]]
    obstacles = [model.geom(name).id for name in geoms]
    for joint, angle in zip(FETCH.head_joints, FETCH.head_configuration, strict=True):
        data.joint(joint).qpos = angle
    worst, where = 0.0, np.zeros(len(columns))
    for action in solution.actions:
        trajectory = action.trajectory
        for i in range(0, len(trajectory.times), step):
            state = np.concatenate((trajectory.base[i], trajectory.q[i]))
            data.qpos[columns], data.qpos[fingers] = state, trajectory.finger_position[i]
            mujoco.mj_kinematics(model, data)
            held = _held_at(trajectory, trajectory.times[i])
            if held is not None:
                _carry(model, data, held)
            moving = robot if held is None else [*robot, int(model.body(held.name).geomadr[0])]
            for one in moving:
                for other in obstacles:
                    depth = -mujoco.mj_geomDistance(model, data, one, other, 0.01, None)
                    if depth > worst:
                        worst, where = depth, state
    return worst, where


def _held_at(trajectory, time: float) -> HeldObject | None:  # type: ignore[no-untyped-def] # a Trajectory
    phase = [phase for phase in trajectory.phases if phase.start <= time][-1]
    return phase.touched if phase.held else None


def _carry(model: mujoco.MjModel, data: mujoco.MjData, held: HeldObject) -> None:
    """Put the held object where the gripper has it."""
    site = data.site(FETCH.tcp_site)
    R, body = site.xmat.reshape(3, 3), model.body(held.name)
    start, quaternion = int(model.jnt_qposadr[body.jntadr[0]]), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (R @ held.T_tcp_object[:3, :3]).ravel())
    data.qpos[start : start + 3] = site.xpos + R @ held.T_tcp_object[:3, 3]
    data.qpos[start + 3 : start + 7] = quaternion
    mujoco.mj_kinematics(model, data)
