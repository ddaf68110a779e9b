"""Drawers that stop short of their ends, which the planner does not know before: what the expert says of them."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from numpy.typing import NDArray

from assets import FETCH
from planners import ControlledWorld, Solution, TampExpert, execute, goals, solve
from planners.goals import Goal
from planners.scene.mujoco_reading import RobotJoints
from tests.planners.expert.test_controller import Deltas
from tests.planners.opening.furniture import drawer_world


class Joints(Deltas):
    """A controller of a robot that does not stand at the origin: its joints begin where it stands."""

    def act(self, configuration: NDArray[np.float64], opening: float) -> None:
        super().act(RobotJoints.of(self.model, self.data, FETCH).positions(configuration), opening)


@pytest.mark.parametrize("goal", [goals.open_("drawer"), goals.open_("drawer", amount=0.2)])
def test_a_drawer_that_jams_is_not_taken_for_open(goal: Goal) -> None:
    world = drawer_world()
    known = copy.deepcopy(world.model)
    world.model.jnt_range[world.model.joint("drawer_joint").id] = (0.0, 0.14)  # it jams at half
    first, *more = world.supports
    controller = Joints(world.model, world.data, dt=0.1, most=0.1)
    watched = ControlledWorld(controller, known, FETCH, movable=world.movable, support=first, more_supports=more)
    expert = TampExpert(watched)
    expert.reset(goal)
    while not expert.done:
        watched.step(expert.act())
    assert not expert.report.scored
    assert expert.report.failure == "'drawer' stopped twice at 0.14 m, short of the goal"
    assert expert.report.deviations == ("drawer: not moved as far as planned",) * 2


def test_a_drawer_that_stays_ajar_is_not_shut() -> None:
    world = drawer_world(share=0.9)
    plan = solve(world.scene(), goals.closed("drawer"))
    assert isinstance(plan, Solution)
    world.model.jnt_range[world.model.joint("drawer_joint").id] = (0.08 * 0.28, 0.28)  # something is behind it
    result = execute(plan, world.model, world.data)
    assert result.deviation is not None
    assert str(result.deviation) == "drawer: not moved as far as planned"
    assert world.data.joint("drawer_joint").qpos[0] > 0.05 * 0.28
