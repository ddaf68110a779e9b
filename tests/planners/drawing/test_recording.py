"""The recording of an episode while it goes on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco

from planners.expert.report import Recorder
from tests.planners.plans import refused


def recorder() -> tuple[Recorder, Any]:
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    env: Any = SimpleNamespace(model=model, data=mujoco.MjData(model), object_names=())
    return Recorder(env, "object_00"), env.data


def test_the_present_state_belongs_to_the_action_under_way() -> None:
    """A live page sends it, and later only what is newer: the action has no gaps there."""
    made, data = recorder()
    made.add_solve(refused())
    sent: list[int] = []
    for step in range(9):
        made.add_frame(1, "PickUp object_00: lift")
        data.time = 0.05 * (step + 1)
        frames = made.recording().frames
        if len(frames) >= len(sent) + 3:
            sent += [frame.action for frame in frames[len(sent) :]]
    assert sent == [1] * 9
    assert made.recording().frames[-1].phase == "PickUp object_00: lift"


def test_a_new_plan_has_not_begun_until_its_first_step() -> None:
    made, data = recorder()
    made.add_solve(refused())
    made.add_frame(3, "PickUp object_00: lift")
    made.add_solve(refused())
    data.time = 0.05
    assert (made.recording().frames[-1].solve, made.recording().frames[-1].action) == (1, -1)
