"""State of the environment as the expert knows it: scene, held objects, and whether the goal is reached."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from planners.expert.actor import home_of, planned_from
from planners.expert.interfaces import ControlledEnv
from planners.expert.monitor import Sensor, held_object
from planners.expert.stops import Stops
from planners.goals import Goal, GoalError, height_below
from planners.scene import AsideObject, ParkedArm, RobotState, Scene, SceneError


class PerceivedWorld:
    """Read-only view of an environment as its robot knows it.

    Attributes:
        robots: the robot with each of its acting arms active, by the arm's name.
    """

    def __init__(self, env: ControlledEnv) -> None:
        self._env, robot = env, env.robot
        self._stops = Stops()
        self.robots = {arm: robot if arm == robot.arm_name else robot.using(arm) for arm in robot.acting_arms}

    @property
    def source(self) -> Any:
        """`model` and `data` as the robot knows them: `env.perceived` if the environment has it, else the true ones."""
        return getattr(self._env, "perceived", self._env)

    def sensors(self) -> dict[str, Sensor]:
        """Sensors, one for each arm."""
        model, data, names = self.source.model, self.source.data, self._env.object_names
        return {arm: Sensor(model, data, robot, names) for arm, robot in self.robots.items()}

    def opened_in_part(self, name: str, position: float) -> None:
        """Note where a part stopped that was not moved as far as planned. A second stop there becomes its end."""
        self._stops.note(self._measured().opening(name), position)

    def stops_short_of(self, goal: Goal) -> str:
        """Message about a drawer or door that stops short of where a goal wants it, "" for none."""
        return self._stops.short_of(goal, self._measured())

    def scene(self) -> Scene:
        """Read the present scene, with the arm active that is away from home. Arms near home are set to it exactly.

        Raises:
            SceneError: two arms are away from home, or the scene is not valid.
        """
        scenes = []
        for arm in self.robots:
            scene = self._stops.applied(self._measured(arm, held_object(self._measured(arm))))
            state = scene.state
            q = planned_from(scene.robot, state.q)
            scenes.append(scene.with_state(RobotState(state.base, q, state.finger_position)))
        scene = max(scenes, key=lambda one: (not _is_at_home(one), one.held is not None))
        others = [one for one in scenes if one is not scene]
        if away := [one.robot.arm_name for one in others if not _is_at_home(one)]:
            raise SceneError(f"the arms {scene.robot.arm_name} and {', '.join(away)} are both away from home")
        held = [AsideObject(one.robot.arm_name, one.held) for one in others if one.held is not None]
        parked = [ParkedArm(one.robot.arm_name, one.state.q[1:]) for one in others]
        return replace(scene, aside=tuple(held), parked=tuple(parked))

    def reaches(self, goal: Goal, start: Scene) -> tuple[bool, str]:
        """Whether a goal is reached, and the reason if that cannot be measured, such as a fallen bin, else "".

        A target must be held, high enough above the support that it stood on at the start.
        """
        try:
            in_hand = {arm: held_object(self._measured(arm)) for arm in self.robots}
            if not goal.target:
                held = [self._measured(arm, name) for arm, name in in_hand.items() if name]
                scene, *others = held or [self._measured()]
                aside = tuple(AsideObject(one.robot.arm_name, one.held) for one in others if one.held is not None)
                return goal.holds(replace(scene, aside=aside), start), ""
            stood_at = height_below(start, start.body(goal.target))
            height = self._measured().body(goal.target).bottom - stood_at
            return height > self._env.lift_height and goal.target in in_hand.values(), ""
        except (SceneError, GoalError) as error:
            return False, f"whether the goal is reached cannot be measured: {error}"

    def _measured(self, arm: str = "", held: str = "") -> Scene:
        """The present scene, with an arm active and this object in its gripper."""
        env, known = self._env, self.source
        return Scene.from_mujoco(
            known.model,
            known.data,
            self.robots.get(arm, env.robot),
            held,
            movable=env.object_names,
            support=env.support_name,
            more_supports=getattr(env, "more_supports", None),
            regions=getattr(env, "regions", ()),
        )


def _is_at_home(scene: Scene) -> bool:
    return np.array_equal(scene.state.q, home_of(scene.robot, scene.state.q))
