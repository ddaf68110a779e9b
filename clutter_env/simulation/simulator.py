"""The physics of an environment from episode to episode: the world in use, the last measurements, what actions do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec
from clutter_env.errors import ActionError, StateError
from clutter_env.scene.layout import Layout
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.action_modes import EndEffectorActions, action_mode
from clutter_env.simulation.control import ControlState, checked_action
from clutter_env.simulation.physics_state import PhysicsState, read_physics, restore_physics
from clutter_env.simulation.robot_check import check_robot
from clutter_env.simulation.saved_state import MEMORY, SEVERAL_ARMS, SavedState
from clutter_env.simulation.state_fields import Fields, check_quaternions
from clutter_env.simulation.world import Measurements, World

__all__ = ["CheckedState", "Simulator"]


@dataclass(frozen=True)
class CheckedState:
    """A saved state that a simulator can restore: its world, and everything that is put into it."""

    world: World
    scene: TableScene
    physics: PhysicsState
    control: ControlState
    wanted_tcp: list[float] | None
    held: int
    is_touching: bool
    other_held: tuple[int, ...]


class Simulator:
    """Steps one robot among objects by actions of one control mode.

    Raises:
        ConfigError: the robot's data do not fit its MJCF file.
    """

    measurements: Measurements
    """Of the present state."""

    def __init__(
        self,
        robot: RobotSpec,
        layout: Layout,
        shapes: tuple[str, ...],
        control_mode: str,
        ik: str,
        image_size: tuple[int, int],
        show_meshes: bool,
    ) -> None:
        check_robot(robot)
        self._robot, self._layout = robot, layout
        self._image_size, self._show_meshes = image_size, show_meshes
        self._home_world = self._make_world(shapes)
        self.world = self._home_world
        self.action_mode = action_mode(control_mode, robot, ik)
        self.has_started = False

    def start(self, scene: TableScene, configuration: tuple[float, ...]) -> None:
        """Begin an episode with the robot at rest in a configuration (1 + n,) of torso and arm."""
        self.world = self._world_for(scene)
        self.world.reset(scene, configuration)
        self.action_mode.reset(self.world.controller.state)
        self.measurements = self.world.measure()
        self.has_started = True

    def step(self, action: ArrayLike) -> None:
        """Advance by one control step.

        Raises:
            ActionError: the action is not a finite vector of the right shape, or nothing has started; no change.
        """
        checked = checked_action(action, self.action_mode.size)
        self.check_started("step()")
        velocity = self.action_mode.joint_velocity(checked, self.world.controller.state)
        self.measurements = self.world.advance(self.measurements, velocity, self._grips(checked))

    def _grips(self, action: NDArray[np.float64]) -> list[float]:
        """The last numbers of an action: the opening of each gripper."""
        grips: list[float] = action[-self.world.controller.num_grippers :].tolist()
        return grips

    def joint_action(self, q_target: ArrayLike, gripper_width: ArrayLike) -> NDArray[np.float64]:
        """The "joint" action towards a whole-body configuration; see `JointController.action_towards`.

        Raises:
            ActionError: not finite, the wrong shape, or the control mode is "ee".
        """
        if isinstance(self.action_mode, EndEffectorActions):
            raise ActionError("joint_action needs control_mode='joint'; this environment has 'ee', use ee_action")
        self.check_started("joint_action()")
        return self.world.controller.action_towards(q_target, gripper_width, self._is_loaded)

    def ee_action(self, base_target: ArrayLike, T_world_tcp: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The "ee" action towards a base pose and a TCP pose; see `EndEffectorActions.action_towards`.

        Raises:
            ActionError: not finite, the wrong shape, or the control mode is "joint".
        """
        if not isinstance(self.action_mode, EndEffectorActions):
            raise ActionError("ee_action needs control_mode='ee'; this environment has 'joint', use joint_action")
        self.check_started("ee_action()")
        controller = self.world.controller
        return self.action_mode.action_towards(controller, base_target, T_world_tcp, gripper_width, self._is_loaded)

    def memory(self) -> dict[str, Any]:
        """What controller and measurements remember besides the physics, as JSON values."""
        control = self.world.controller.state
        several = {"other_held": self.measurements.other_held, "other_fingers": control.other_fingers}
        return {
            **(several if control.other_fingers else {}),
            "held": self.measurements.held,
            "is_touching": self.measurements.is_touching,
            "target": control.target.tolist(),
            "velocity": control.velocity.tolist(),
            "finger": control.finger,
            "wanted_tcp": self.action_mode.wanted_tcp,
        }

    def check(self, saved: SavedState) -> CheckedState:
        """Check everything in a saved state against the model of its scene; nothing changes.

        Raises:
            StateError: an entry is missing, of the wrong type or size, out of range, or does not agree with another.
        """
        world = self._world_for(saved.scene)
        others = world.controller.num_grippers - 1
        memory = Fields(saved.memory, "memory", (*MEMORY, *(SEVERAL_ARMS if others else ())))
        size = len(world.controller.state.target)
        return CheckedState(
            world=world,
            scene=saved.scene,
            physics=read_physics(world, saved.physics),
            control=ControlState(
                memory.numbers("target", (size,)),
                memory.numbers("velocity", (size,)),
                memory.number("finger"),
                tuple(memory.numbers("other_fingers", (others,)).tolist()) if others else (),
            ),
            wanted_tcp=self._checked_tcp(memory),
            held=memory.integer("held", -1, saved.scene.num_objects - 1),
            is_touching=memory.flag("is_touching"),
            other_held=_slots(memory, others, saved.scene.num_objects),
        )

    def restore(self, state: CheckedState) -> None:
        """Continue from a saved state, bit for bit.

        Raises:
            StateError: bodies of the state sleep and overlap; nothing has changed.
        """
        restore_physics(state.world, state.scene, state.physics)
        self.world = state.world
        self.world.controller.state = state.control
        self.action_mode.wanted_tcp = state.wanted_tcp
        self.measurements = self.world.measure_objects(state.held, state.is_touching, state.other_held)
        self.has_started = True

    def check_started(self, call: str) -> None:
        """Raise ActionError unless an episode has begun; `call` is what needs one."""
        if not self.has_started:
            raise ActionError(f"call reset() before {call}")

    @property
    def _is_loaded(self) -> bool:
        return self.measurements.is_holding

    def _make_world(self, shapes: tuple[str, ...]) -> World:
        return World(self._robot, self._layout, shapes, self._image_size, self._show_meshes)

    def _world_for(self, scene: TableScene) -> World:
        """A world for a scene: explicit scenes may have fewer objects or other shapes than the environment's own."""
        for world in (self.world, self._home_world):
            if scene.shapes == world.shapes:
                return world
        return self._make_world(scene.shapes)

    def _checked_tcp(self, memory: Fields) -> list[float] | None:
        """What the action mode remembers."""
        if self.action_mode.wanted_tcp is None:
            if memory["wanted_tcp"] is not None:
                raise StateError("memory: wanted_tcp of the state must be null in control mode 'joint'")
            return None
        pose = memory.numbers("wanted_tcp", (7,))
        check_quaternions("memory wanted_tcp", pose[:4])
        return pose.tolist()


def _slots(memory: Fields, grippers: int, num_objects: int) -> tuple[int, ...]:
    """What the other grippers hold."""
    return tuple(memory.integers("other_held", grippers, -1, num_objects - 1).tolist()) if grippers else ()
