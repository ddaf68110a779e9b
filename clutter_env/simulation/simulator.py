"""The physics of an environment from episode to episode: the world in use, the last measurements, what actions do."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from assets import RobotSpec
from clutter_env.errors import ActionError, StateError
from clutter_env.scene.layout import Layout
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.control import ControlState, checked_action, checked_vector
from clutter_env.simulation.end_effector import EndEffectorController
from clutter_env.simulation.physics_state import PhysicsState, read_physics, restore_physics
from clutter_env.simulation.robot_check import check_robot
from clutter_env.simulation.saved_state import MEMORY, Fields, SavedState, check_quaternions
from clutter_env.simulation.world import Grip, Measurements, World

_BASE, _TWIST = 3, 6
"""Numbers of an "ee" action before the gripper's: base velocity, TCP velocity."""


@dataclass(frozen=True)
class CheckedState:
    """A saved state that a simulator can restore: its world, and everything that is put into it."""

    world: World
    scene: TableScene
    physics: PhysicsState
    control: ControlState
    wanted_tcp: list[float] | None
    ik_failures: int
    grip: Grip
    furniture_force: float


class Simulator:
    """Steps one robot among objects by actions of one control mode; all numbers of an action are in [-1, 1].

    "joint": base forward, left, yaw rate, torso and arm joint rates, each a share of the maximum; "ee": base forward,
    left, yaw rate, then linear and angular TCP velocity in the base frame. Last comes the opening of each gripper.
    Both modes end in joint velocities, which `JointController.follow` carries out.

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
        image_size: tuple[int, int],
        show_meshes: bool,
    ) -> None:
        check_robot(robot)
        self._make_world = partial(World, robot, layout, image_size=image_size, show_meshes=show_meshes)
        self.world = self._home_world = self._make_world(shapes=shapes)
        self._end_effector = EndEffectorController(robot) if control_mode == "ee" else None
        self.has_started = False

    def start(self, scene: TableScene) -> None:
        """Begin an episode with the robot at rest in its home configuration."""
        self.world = self._world_for(scene)
        self.world.reset(scene)
        if self._end_effector:
            self._end_effector.reset(self.world.controller.state.target[_BASE:])
        self.measurements = self.world.measure()
        self.has_started = True

    def step(self, action: ArrayLike) -> None:
        """Advance by one control step.

        Raises:
            ActionError: the action is not a finite vector of the right shape, or nothing has started; no change.
        """
        checked = checked_action(action, self.action_size)
        self.check_started("step()")
        controller = self.world.controller
        state, limit = controller.state, controller.max_velocity
        if self._end_effector:
            base, twist = checked[:_BASE] * limit[:_BASE], checked[_BASE : _BASE + _TWIST]
            arm = self._end_effector.joint_velocity(twist, state.target[_BASE:], state.velocity[_BASE:])
            velocity = np.concatenate((base, arm))
        else:
            velocity = checked[: len(limit)] * limit
        grips = checked[-controller.num_grippers :].tolist()
        self.measurements = self.world.advance(self.measurements, velocity, grips)

    @property
    def action_size(self) -> int:
        """Numbers in an action."""
        return _BASE + _TWIST + 1 if self._end_effector else self.world.controller.action_size

    @property
    def ik_failures(self) -> int:
        """Steps of this episode in which the inverse kinematics of "ee" control found nothing."""
        return self._end_effector.failures if self._end_effector else 0

    def joint_action(self, q_target: ArrayLike, gripper_width: ArrayLike) -> NDArray[np.float64]:
        """The "joint" action towards a whole-body configuration; see `BaseEnv.joint_action`."""
        if self._end_effector:
            raise ActionError("joint_action needs control_mode='joint'; this environment has 'ee', use ee_action")
        self.check_started("joint_action()")
        return self.world.controller.action_towards(q_target, gripper_width, self.measurements.grip.is_holding)

    def ee_action(self, base_target: ArrayLike, T_world_tcp: ArrayLike, gripper_width: float) -> NDArray[np.float64]:
        """The "ee" action (10,) towards a base and a TCP pose; see `BaseEnv.ee_action`."""
        if not self._end_effector:
            raise ActionError("ee_action needs control_mode='ee'; this environment has 'joint', use joint_action")
        self.check_started("ee_action()")
        controller = self.world.controller
        base = checked_vector("ee_action's base_target", base_target, (3,))
        pose = checked_vector("ee_action's T_world_tcp", T_world_tcp, (4, 4))
        goal = np.concatenate((base, controller.state.target[_BASE:]))
        velocity = controller.velocity_towards(goal, self.measurements.grip.is_holding)[:_BASE]
        drive = np.clip(velocity / controller.max_velocity[:_BASE], -1.0, 1.0)
        T_world_base = np.eye(4)
        cosine, sine = np.cos(base[2]), np.sin(base[2])
        T_world_base[:2, :2] = ((cosine, -sine), (sine, cosine))
        T_world_base[:2, 3] = base[:2]
        twist = self._end_effector.twist_towards(np.linalg.inv(T_world_base) @ pose)
        return np.concatenate((drive, twist, [controller.grip_action(gripper_width)]))

    def memory(self) -> dict[str, Any]:
        """Memory of controller and measurements besides the physics, as JSON values."""
        control = self.world.controller.state
        ee = self._end_effector
        return {
            "grip": asdict(self.measurements.grip),
            "furniture_force": self.world.furniture_force,
            "target": control.target.tolist(),
            "velocity": control.velocity.tolist(),
            "fingers": control.fingers,
            "end_effector": None if ee is None else {"wanted_tcp": ee.wanted, "ik_failures": ee.failures},
        }

    def check(self, saved: SavedState) -> CheckedState:
        """Check everything in a saved state against the model of its scene; nothing changes.

        Raises:
            StateError: an entry is missing, of the wrong type or size, out of range, or does not agree with another.
        """
        world = self._world_for(saved.scene)
        memory = Fields(saved.memory, "memory", MEMORY)
        wanted_tcp, ik_failures = None, 0
        if self._end_effector:
            entries = Fields(memory["end_effector"], "memory end_effector", ("wanted_tcp", "ik_failures"))
            pose = entries.numbers("wanted_tcp", (7,))
            check_quaternions("memory wanted_tcp", pose[:4])
            wanted_tcp, ik_failures = pose.tolist(), entries.integer("ik_failures", 0, 2**31)
        elif memory["end_effector"] is not None:
            raise StateError("memory: end_effector of the state must be null in control mode 'joint'")
        grip = Fields(memory["grip"], "memory grip", [entry.name for entry in fields(Grip)])
        size, grippers = len(world.controller.state.target), world.controller.num_grippers
        finger, *other_fingers = memory.numbers("fingers", (grippers,)).tolist()
        return CheckedState(
            world=world,
            scene=saved.scene,
            physics=read_physics(world, saved.physics),
            control=ControlState(
                memory.numbers("target", (size,)),
                memory.numbers("velocity", (size,)),
                finger,
                tuple(other_fingers),
            ),
            wanted_tcp=wanted_tcp,
            ik_failures=ik_failures,
            grip=Grip(
                held=tuple(grip.integers("held", grippers, -1, saved.scene.num_objects - 1).tolist()),
                is_carried=tuple(grip.flags("is_carried", grippers).tolist()),
                is_touching=grip.flag("is_touching"),
            ),
            furniture_force=memory.number("furniture_force", 0.0),
        )

    def restore(self, state: CheckedState) -> None:
        """Continue from a saved state, bit for bit.

        Raises:
            StateError: bodies of the state sleep and overlap; nothing has changed.
        """
        restore_physics(state.world, state.scene, state.physics)
        self.world = state.world
        self.world.controller.state = state.control
        if self._end_effector and state.wanted_tcp:
            self._end_effector.wanted, self._end_effector.failures = state.wanted_tcp, state.ik_failures
        self.measurements = self.world.measure_objects(state.grip)
        self.world.furniture_force = state.furniture_force
        self.has_started = True

    def check_started(self, call: str) -> None:
        """Raise ActionError unless an episode has begun; `call` is what needs one."""
        if not self.has_started:
            raise ActionError(f"call reset() before {call}")

    def _world_for(self, scene: TableScene) -> World:
        """A world for a scene: explicit scenes may have fewer objects or other shapes than the environment's own."""
        for world in (self.world, self._home_world):
            if scene.shapes == world.shapes:
                return world
        return self._make_world(shapes=scene.shapes)
