"""Motions made one: the fingers have opened before they get between objects."""

from __future__ import annotations

import mujoco
import numpy as np

from assets.robots import FETCH
from planners import CollisionWorld, Solution, Strategy, goals, solve
from planners.scene import SELF_BIT
from planners.scene.scene import Scene

LAG = 2
"""Samples by which the fingers stay behind their commands."""
NEAR = """<mujoco><include file="{robot}"/><worldbody>
  <geom name="table" type="box" size="0.35 0.5 0.37" pos="1.2 0 0.37"/>
  <body name="can" pos="1.05 0 0.8"><freejoint/><geom type="cylinder" size="0.03 0.06"/></body>
  {boxes}</worldbody></mujoco>"""
BOX = '<body name="box_{}" pos="{} {} 0.82"><freejoint/><geom type="box" size="0.025 0.025 0.08"/></body>'
PLACES = ((0.95, -0.06), (0.95, 0.06), (1.05, 0.1), (1.05, -0.1), (1.15, 0.0))


def near_scene() -> Scene:
    """Boxes about a can, whose lifting takes the gripper, closed at first, a short way."""
    boxes = "".join(BOX.format(number, *place) for number, place in enumerate(PLACES))
    model = mujoco.MjModel.from_xml_string(NEAR.format(robot=FETCH.mjcf_path, boxes=boxes))
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in FETCH.drive_joints[3:]]] = FETCH.home
    mujoco.mj_forward(model, data)
    return Scene.from_mujoco(model, data, FETCH, movable=lambda name: name[:3] in ("can", "box"), support="table")


def test_fingers_closed_at_the_start_are_open_before_they_reach_the_object_even_if_they_lag() -> None:
    scene = near_scene()
    found = solve(
        scene, "can", Strategy("nearest", grasps="greedy", region="ngr1", locations="priority"), grasps="side"
    )
    assert isinstance(found, Solution)
    pick = next(action for action in found.actions if action.name == "PickUp")
    path, world = pick.trajectory, CollisionWorld.from_scene(pick.scene, 0.0)
    close = next(phase.start for phase in path.phases if phase.name == "close")
    for number in range(LAG, int(np.searchsorted(path.times, close))):
        x = np.append(path.base[number], path.q[number])
        opening = FETCH.opening(float(path.finger_position[number - LAG]))
        hits = world.path_hits(np.stack([x, x]), opening, ignore=1 << SELF_BIT)
        assert not hits, (number, world.names_of(hits))


STACKED = """<mujoco><include file="{robot}"/><worldbody>
  <geom name="table" type="box" size="0.35 0.5 0.37" pos="1.2 0 0.37"/>
  <body name="can" pos="1.05 0.1 0.8401"><freejoint/><geom type="cylinder" size="0.03 0.06"/></body>
  <body name="here" pos="1.05 0.1 0.76"><freejoint/><geom type="box" size="0.06 0.06 0.02"/></body>
  <body name="there" pos="1.05 -0.15 0.76"><freejoint/><geom type="box" size="0.06 0.06 0.02"/></body>
</worldbody></mujoco>"""


def test_what_stands_on_something_is_carried_to_something_else_in_one_motion() -> None:
    model = mujoco.MjModel.from_xml_string(STACKED.format(robot=FETCH.mjcf_path))
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in FETCH.drive_joints[3:]]] = FETCH.home
    mujoco.mj_forward(model, data)
    scene = Scene.from_mujoco(model, data, FETCH, movable=["can", "here", "there"], support="table")
    found = solve(scene, goals.on("can", "there"))
    assert isinstance(found, Solution)
    put_down = next(action for action in found.actions if action.is_put_down)
    q = put_down.trajectory.q[0]
    assert np.abs(q[1:] - np.array(FETCH.home)[1:]).max() > 0.1, "it passes home, as two motions do"
