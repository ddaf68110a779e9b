"""FrankaKitchen of Gymnasium-Robotics through its nine joint velocities."""

from __future__ import annotations

import numpy as np
import pytest

from clutter_env.bridges.remote import BridgeError
from planners import ExpertConfig, Infeasible, Scene, TampExpert

pytest.importorskip("gymnasium_robotics")


def test_an_unknown_task_is_refused_with_those_that_are_known() -> None:
    from clutter_env.bridges.kitchen_tasks import KitchenTask

    with pytest.raises(BridgeError, match=r"toaster.*microwave, slide cabinet"):
        KitchenTask("toaster", seed=0)


@pytest.mark.slow
def test_the_arm_stands_where_the_environment_s_does_and_what_opens_is_read() -> None:
    from clutter_env.bridges.kitchen_tasks import KitchenTask

    task = KitchenTask("microwave", seed=0)
    world, theirs = task.world, task.simulated
    away = world.data.body("panda0_link7").xpos - theirs.body("panda0_link7").xpos
    assert np.linalg.norm(away) < 0.003  # positions are observed with a noise of 1 mrad
    scene = Scene.from_mujoco(world.model, world.data, world.robot, movable=world.object_names, more_supports=())
    assert {"microdoorroot", "slidelink", "hingerightdoor", "knob 2"} <= {one.name for one in scene.openings}
    assert scene.opening("microdoorroot").handles == ("handle",)


@pytest.mark.slow
@pytest.mark.parametrize("id", ["slide cabinet", "top burner"])
def test_an_episode_ends_with_the_task_among_those_completed(id: str) -> None:
    from clutter_env.bridges.kitchen_tasks import BARS, KitchenTask

    task = KitchenTask(id, seed=0)
    expert = TampExpert(task.world, grasps=BARS, config=ExpertConfig(planning_s=300.0, with_floor=False))
    expert.reset()
    assert not isinstance(expert.solution, Infeasible)
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    assert task.is_solved
    assert task.steps < 280
