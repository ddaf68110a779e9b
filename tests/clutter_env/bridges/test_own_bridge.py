"""The bridge that the page shows for a user's own environment, as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from assets import FETCH
from planners import ControlledWorld, TampExpert, insert_robot

Array = NDArray[np.float64]

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "bridges.md"
SCENE = """
<mujoco>
  <option cone="elliptic" impratio="10"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" conaffinity="3"/>
    <geom name="table" type="box" size="0.3 0.5 0.02" pos="1.1 0 0.72" conaffinity="3"/>
    <body name="can" pos="1.0 0 0.801">
      <freejoint name="can"/><geom type="cylinder" size="0.03 0.06" mass="0.3" conaffinity="3"/>
    </body>
    <body name="tea" pos="1.15 0.2 0.821">
      <freejoint name="tea"/><geom type="box" size="0.03 0.03 0.08" mass="0.4" conaffinity="3"/>
    </body>
  </worldbody>
</mujoco>"""
PREFIX = "their_"


class TheirEnv:
    """Somebody's simulation of a robot with names of its own; an action changes its joints, and says the opening."""

    def __init__(self) -> None:
        spec = mujoco.MjSpec.from_string(SCENE)
        spec.attach(mujoco.MjSpec.from_file(str(FETCH.mjcf_path)), frame=spec.worldbody.add_frame(), prefix=PREFIX)
        self.model = spec.compile()
        self.mjcf = spec.to_xml()
        self.data = mujoco.MjData(self.model)
        self.joints = [PREFIX + name for name in FETCH.drive_joints]
        self.fingers = [PREFIX + name for name in FETCH.finger_joints]
        self.motors = [self.model.actuator(name).id for name in (*self.joints, *self.fingers)]
        for name, value in zip(self.joints[3:], FETCH.home, strict=True):
            self.data.joint(name).qpos = value
        mujoco.mj_forward(self.model, self.data)

    @property
    def qpos(self) -> Array:
        return self.data.qpos

    @property
    def opening(self) -> float:
        return FETCH.opening(float(self.data.joint(self.fingers[0]).qpos[0]))

    def address(self, joint: str) -> int:
        return int(self.model.joint(joint).qposadr[0])

    def step(self, action: Array) -> tuple[None, float, bool, bool, dict[str, Any]]:
        now = np.array([self.qpos[self.address(name)] for name in self.joints])
        finger = FETCH.finger_position(float(action[-1]))
        self.data.ctrl[self.motors] = [*(now + action[:-1]), finger, finger]
        mujoco.mj_step(self.model, self.data, nstep=round(0.1 / self.model.opt.timestep))
        return None, 0.0, False, False, {}


def shown() -> str:
    section = PAGE.read_text(encoding="utf-8").partition("## A bridge of your own")[2]
    found = re.search(r"```py\n(.*?)```", section, re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.slow
def test_thirty_lines_fetch_an_object_in_somebody_elses_environment() -> None:
    code = shown()
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 30
    names: dict[str, Any] = {"np": np, "insert_robot": insert_robot, "ControlledWorld": ControlledWorld}
    exec(compile(code, str(PAGE), "exec"), names)
    env = TheirEnv()
    theirs = SimpleNamespace(base=PREFIX + FETCH.base_body, joints=env.joints, free_joints=["can", "tea"])
    bridge = names["Bridge"](env, env.mjcf, FETCH, theirs, movable=["can", "tea"], support="table")
    expert = TampExpert(bridge.world)
    expert.reset("can")
    while not (expert.done or bridge.world.is_over):
        bridge.world.step(expert.act())
    assert expert.report.scored, expert.report
    assert env.data.body("can").xpos[2] > 0.8 + 0.1
    assert abs(env.data.body("tea").xpos[2] - 0.82) < 0.01
