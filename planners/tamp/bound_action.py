"""An action of a task plan with the motion that its references stand for."""

from __future__ import annotations

from dataclasses import dataclass, field

from planners.motion.arm import tcp_pose
from planners.motion.trajectory import Trajectory
from planners.placing.surfaces import Surface
from planners.scene import Body, RobotState, Scene
from planners.tamp.plan_file import is_same

__all__ = ["BoundAction"]


@dataclass(frozen=True, eq=False)
class BoundAction:
    """A ground action of the task plan whose references are bound to a motion.

    Attributes:
        name: action of the PDDL domain, as in Fig. 4 of Lee & Kim 2019.
        args: the symbols of the action, references included.
        trajectory: the verified motion behind the references.
        scene: the world in which the motion was planned, as the actions before it leave it.
        target: the object that is moved or approached, "" for a base motion.
        surfaces: of a put-down: the supports that were looked at, with the regions that the object keeps out of.
    """

    name: str
    args: tuple[str, ...]
    trajectory: Trajectory = field(repr=False)
    scene: Scene = field(repr=False)
    target: str = ""
    surfaces: tuple[Surface, ...] = field(default=(), repr=False)

    def __str__(self) -> str:
        return f"{self.name.upper()} ({' '.join(self.args).upper()})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BoundAction) and is_same(self, other)

    def __hash__(self) -> int:
        return hash((self.name, self.args, self.target))

    @property
    def is_clearance(self) -> bool:
        """Whether the action puts an object down."""
        return self.name.startswith("PutDown")

    @property
    def obstructed(self) -> str:
        """Name of the object that the cleared object obstructs, "" if the action clears nothing for another object."""
        return self.args[1] if self.name == "PutDownForClearance" else ""

    @property
    def released(self) -> Body | None:
        """The object at the pose where the gripper lets go of it, None if the action releases nothing."""
        opening = next((phase for phase in self.trajectory.phases if phase.name == "open"), None)
        if opening is None or opening.touched is None:
            return None
        sample = self.trajectory.sample(opening.start)
        T_world_tcp = tcp_pose(self.scene.robot, RobotState(sample.base, sample.q, sample.finger_position))
        return self.scene.body(opening.touched.name).at_pose(T_world_tcp @ opening.touched.T_tcp_object)
