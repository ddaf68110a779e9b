"""What the arms command and hold: which object is in which gripper, and from where it was lifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.execution.executor import Command
from planners.motion.arm import tcp_pose
from planners.scene import Body, Scene

__all__ = ["ArmTargets", "height_below", "held_object"]

Array = NDArray[np.float64]

_OFF_SUPPORT = 0.01
"""[m] above the support; a lower object may still stand on it."""
_SUNK = 0.005
"""[m] below the top of a support that the lowest point of an object on it may be: it leans, or sinks in."""
_BETWEEN_PADS = 0.01
"""[m] wider than the object the fingers may be: they touch it, or are about to."""
_REACH = 0.02
"""[m] that the TCP may be outside the object: it is gripped at its edge."""


class ArmTargets:
    """What a robot's arms are told: the one that moves follows its plan, the others stay, their grippers closed."""

    def __init__(self, robot: RobotSpec, command: Command) -> None:
        """Begin with all arms but one at home.

        Args:
            robot: as the environment has it.
            command: the present configuration of one arm, and the opening of its gripper.
        """
        self._robot = robot
        self._joints = {arm.name: np.array(arm.home) for arm in robot.arms}
        self.follow(command)

    def follow(self, command: Command) -> None:
        """Remember the joints of the arm that is commanded."""
        self._joints[command.arm] = command.drive[4:]

    def of(self, command: Command) -> tuple[Array, float | Array]:
        """Whole-body configuration and widths [m] of the grippers, as `ControlledEnv.joint_action` takes them."""
        self.follow(command)
        if not self._robot.acts_with_all_arms:
            return command.drive, command.opening
        arms = self._robot.acting_arms
        widths = [command.opening if arm == command.arm else self._robot.opening(0.0) for arm in arms]
        return np.concatenate((command.drive[:4], *(self._joints[arm] for arm in arms))), np.array(widths)


def held_object(scene: Scene) -> str:
    """Name of the object between closed fingers and off the support; "" for none.

    Args:
        scene: a snapshot in which nothing is said to be held, so that the finger position is the measured one.
    """
    T_world_tcp = tcp_pose(scene.robot, scene.state)
    gap = scene.robot.opening(scene.state.finger_position)
    for body in scene.objects:
        is_lifted = body.bottom > height_below(scene, body) + _OFF_SUPPORT
        if is_lifted and _is_between_fingers(body, T_world_tcp, gap):
            return body.name
    return ""


def height_below(scene: Scene, body: Body) -> float:
    """[m] of the highest support under the centre of an object, on which it stands or would fall.

    Beside the supports it is the height of the first one.
    """
    supports = [scene.support, *(scene.support_named(name) for name in scene.supports[1:])]
    under = [support for support in supports if support.is_under(body.position[:2])]
    return max((support.top for support in under if support.top <= body.bottom + _SUNK), default=scene.support.top)


def _is_between_fingers(body: Body, T_world_tcp: Array, gap: float) -> bool:
    """Whether the TCP is in the body and the fingers, `gap` [m] apart, are not wider open than the body is."""
    tcp_in_body = body.rotation.T @ (T_world_tcp[:3, 3] - body.position)
    is_inside = bool((np.abs(tcp_in_body) < body.half_extents + _REACH).all())
    return is_inside and gap < 2 * body.half_extent_along(T_world_tcp[:3, 1]) + _BETWEEN_PADS
