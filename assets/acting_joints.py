"""The joints that actions move: base, torso and arm, and of a robot that acts with all its arms the other arms too."""

from __future__ import annotations

from dataclasses import dataclass

from assets.robot_spec import RobotSpec

__all__ = ["ActingJoints"]


@dataclass(frozen=True)
class ActingJoints:
    """Joints in the order of actions: base, torso and the active arm (4 + n), then the other arms that act.

    Attributes:
        names: of the joints.
        velocity, acceleration: their limits [m/s], [rad/s]; per second.
        lower, upper: ranges of torso and arms, without the base [m], [rad].
        home: of torso and arms.
        arms: names of the arms, the active one first.
        finger_joints, finger_geoms: of each arm's gripper.
    """

    names: tuple[str, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    home: tuple[float, ...]
    arms: tuple[str, ...]
    finger_joints: tuple[tuple[str, str], ...]
    finger_geoms: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, robot: RobotSpec) -> ActingJoints:
        """Those of a robot."""
        others = robot.idle_arms if robot.acts_with_all_arms else ()
        links = (*robot.chain, *(link for arm in others for link in arm.chain))
        return cls(
            names=(*robot.base_joints, *(link.joint for link in links)),
            velocity=(*robot.max_velocity, *(value for arm in others for value in arm.max_velocity)),
            acceleration=(*robot.max_acceleration, *(value for arm in others for value in arm.max_acceleration)),
            lower=tuple(link.lower for link in links),
            upper=tuple(link.upper for link in links),
            home=(*robot.home, *(value for arm in others for value in arm.home)),
            arms=robot.acting_arms,
            finger_joints=(robot.finger_joints, *(arm.finger_joints for arm in others)),
            finger_geoms=(robot.finger_geoms, *(arm.finger_geoms for arm in others)),
        )

    @property
    def num_grippers(self) -> int:
        """How many grippers act."""
        return len(self.arms)
