"""Results of a solve: a plan with references bound to motions, or the reason why no plan exists."""

from __future__ import annotations

import html
import reprlib
import textwrap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planners.cause import Cause
from planners.clearing.goal_bound import LowerBound
from planners.goals import Goal
from planners.grasping.families import Family
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import Trajectory, is_contact
from planners.placing.surfaces import Surface
from planners.scene import Body, HeldObject, RobotState, Scene
from planners.strategies import Strategy
from planners.tamp.joint_trajectory import JointTrajectory, joint_trajectory
from planners.tamp.plan_file import Stored, is_same

_EVIDENCE = 70
"""Characters of the evidence in the repr of an `Infeasible`."""


@dataclass(frozen=True, eq=False)
class BoundAction:
    """A ground action of the task plan with its references bound to a motion.

    Attributes:
        name: action of the PDDL domain, as in Fig. 4 of Lee & Kim 2019.
        args: the symbols of the action, references included.
        trajectory: the verified motion that the references stand for.
        scene: the scene in which the motion was planned, after the actions before it.
        target: the object that is moved, "" for a base motion.
        surfaces: for a put-down, the supports that were searched, with their keep-out regions for the object.
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
    def is_put_down(self) -> bool:
        """Whether the action puts an object down."""
        return self.name.startswith("PutDown")

    @property
    def obstructed(self) -> str:
        """Name of the object that the cleared object obstructs, "" if the action clears it for no other object."""
        return self.args[1] if self.name == "PutDownForClearance" else ""

    @property
    def grip(self) -> tuple[RobotState, HeldObject] | None:
        """Robot state when the fingers begin to close or open, with the object between them. None for a base motion."""
        for phase in self.trajectory.phases:
            if is_contact(phase) and phase.touched is not None:
                sample = self.trajectory.sample(phase.start)
                return RobotState(sample.base, sample.q, sample.finger_position), phase.touched
        return None

    @property
    def released(self) -> Body | None:
        """Object at the pose of its release. None if the action is no put-down."""
        if self.grip is None or not self.is_put_down:
            return None
        state, held = self.grip
        return self.scene.body(held.name).at_pose(tcp_pose(self.scene.robot, state) @ held.T_tcp_object)


@dataclass(frozen=True)
class ReplanRecord:
    """One turn of Algorithm 1's loop, for printing as in Fig. 11.

    Attributes:
        plan: the task plan that was tried, as text, one action each.
        verified: how many of its actions were bound.
        refuted: the action that motion planning refuted, "" for none.
        new_facts: facts learnt from the refutation, as text.
        reason: why motion planning refuted the action, "" for none.
    """

    plan: tuple[str, ...]
    verified: int
    refuted: str
    new_facts: tuple[str, ...]
    reason: str = ""


@dataclass(frozen=True)
class SolveStats:
    """Counts and CPU times [s] of one solve.

    `unusable` is the number of grasps that are free by the lower bound but without a motion to or from them. If it is
    not 0, a plan may clear more objects than the bound says.
    """

    replans: int = 0
    task_plans: int = 0
    task_planning_s: float = 0.0
    motion_planning_s: float = 0.0
    total_s: float = 0.0
    unusable: int = 0
    history: tuple[ReplanRecord, ...] = field(default=(), repr=False)

    def rows(self) -> dict[str, str]:
        """Counts and times in words, by name."""
        unusable = {"Grasps without a way to them": str(self.unusable)} if self.unusable else {}
        replans = f"{self.replans} (task plans: {self.task_plans})"
        return {"Planning time": f"{self.total_s:.2f} s of CPU time", "Replans": replans, **unusable}


@dataclass(frozen=True, repr=False, eq=False)
class Solution(Stored):
    """A feasible plan F of Algorithm 1 with every reference bound to a verified motion.

    Two solutions are equal if all their fields are, scenes and trajectories included.

    Example:
        solution = solve(scene, "object_03")
        print(solution.summary())
        solution.save("plan.npz")
        Solution.load("plan.npz").plot()

    Attributes:
        actions: bound actions in order.
        clearances: names of the objects put aside, in order. An object cleared twice appears twice.
        stats: counts and times.
        target: name of the object that the plan takes, "" for a goal with places.
        strategy: the strategy that made the plan.
        goal: the goal that the plan reaches. None in files of older versions means that the target is held.
        bound: lower bound of picks and pulls of handles together. Set for goals with places, and for a target if the
            strategy plans ahead.
        end: the scene at the end, held objects at their poses in the gripper. None in files of older versions.
        grasps: the grasp set that the plan was chosen from. () in files of older versions.
    """

    actions: tuple[BoundAction, ...]
    clearances: tuple[str, ...]
    stats: SolveStats
    target: str
    strategy: Strategy
    goal: Goal | None = None
    bound: LowerBound | None = None
    end: Scene | None = None
    grasps: tuple[Family, ...] = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Solution) and is_same(self, other)

    def __hash__(self) -> int:
        return hash((self.target, self.clearances, len(self.actions)))

    def __repr__(self) -> str:
        wanted = f"target={reprlib.repr(self.target)}" if self.target else f"goal={reprlib.repr(str(self.goal))}"
        counts = f"actions={len(self.actions)}, clearances={len(self.clearances)}, duration={self.duration:.1f} s"
        return f"Solution({wanted}, strategy={reprlib.repr(self.strategy.name)}, {counts})"

    @property
    def duplicated(self) -> tuple[str, ...]:
        """Objects cleared twice or more (Table 1, right half)."""
        return tuple(sorted({name for name in self.clearances if self.clearances.count(name) > 1}))

    @property
    def picks(self) -> int:
        """Number of picks."""
        return sum(action.name == "PickUp" for action in self.actions)

    @property
    def pulls(self) -> int:
        """Number of doors and drawers opened or closed."""
        return sum(action.name in ("Open", "Close") for action in self.actions)

    @property
    def duration(self) -> float:
        """Simulated time of the motions [s]."""
        return sum(action.trajectory.duration for action in self.actions)

    def summary(self) -> str:
        """Describe the plan in several lines: goal, put-downs with their positions, picks, duration, planning times."""
        puts = [action for action in self.actions if action.is_put_down]
        wanted = f"takes {self.target}" if self.target else f"reaches {self.goal}"
        lines = [
            f"Plan that {wanted}, made by strategy {self.strategy.name!r}",
            f"{'Clearances' if self.target else 'Put down'}: {len(puts) or 'none'}",
            *(f"  {number}. {_clearance(action)}" for number, action in enumerate(puts, start=1)),
        ]
        rows = {"Actions": str(len(self.actions)), "Simulated duration": f"{self.duration:.1f} s", **self.stats.rows()}
        if self.bound is not None:
            pulls, together = (f" and {self.pulls} of handles", " together") if self.pulls else ("", "")
            rows = {"Picks": f"{self.picks}{pulls}; no plan has fewer than {self.bound.least}{together}", **rows}
        return "\n".join([*lines, *(f"{name}: {value}" for name, value in rows.items())])

    def _repr_html_(self) -> str:
        return html_table(self.summary())

    def to_joint_trajectory(self) -> JointTrajectory:
        """The plan as one trajectory of joints, base and grippers, for a robot's controllers.

        Raises:
            ValueError: the plan has no actions.
        """
        return joint_trajectory(self.actions)

    def to_mcap(self, path: str | Path) -> None:
        """Write the plan as ROS 2 messages to an MCAP file for Foxglove, rerun or rosbag2.

        It holds the joint trajectory, joint states and transforms at every control step, and markers of robot, objects
        and static obstacles. See `planners.drawing.mcap_file`. It needs the extra "ros", but not ROS itself.

        Raises:
            ValueError: the plan has no actions.
            ImportError: the extra "ros" is not installed. The message says how to install it.
            OSError: the file cannot be written.
        """
        # The import stands here because drawing is built on this package, as in `plot`.
        from planners.drawing.mcap_file import write_mcap

        write_mcap(self, Path(path))

    def plot(self, ax: Any = None) -> Any:
        """Draw the plan from above: objects, clearances in order, the path of the base.

        Args:
            ax: matplotlib axes to draw in. Default: a new figure.

        Returns:
            The axes.

        Raises:
            ValueError: the plan has no actions.
        """
        # The import stands here because drawing is built on this package and needs matplotlib, which planning must not
        # import.
        from planners.drawing.pictures import draw_overview

        return draw_overview(self, ax)

    def plot_clearances(self, path: str | Path) -> None:
        """Draw the choice of each clearance location (Figs. 8-10 of Lee & Kim 2019) from above into one image file.

        Raises:
            ValueError: the plan has no actions.
            OSError: the file cannot be written.
        """
        from planners.drawing.pictures import draw_plan

        draw_plan(self, Path(path))

    def to_html(self, path: str | Path) -> None:
        """Write the plan as one HTML page that needs no network, with its motions in 3-D on a time line.

        The motions are shown as planned, without physics. The page also has the actions, negative goal regions and
        candidates of each clearance, base poses of the reachability map, gripper paths and replanning.

        Raises:
            ValueError: the plan has no actions.
            OSError: the file cannot be written.
        """
        # The import stands here because the page is built on this package, as in `plot`.
        from planners.drawing.page.page import write_plan_page

        write_plan_page(self, Path(path))


@dataclass(frozen=True, repr=False)
class Infeasible(Stored):
    """A refusal: the reason why no plan was found.

    Attributes:
        cause: why the search failed.
        detail: one sentence with the evidence.
        objects: the objects that the evidence is about.
        clearances: objects cleared in the verified part of the plan.
        stats: counts and times.
        target: name of the object to take.
        strategy: the strategy that failed.
        goal: the goal to reach. None in files of older versions means that the target is held.
    """

    cause: Cause
    detail: str
    objects: tuple[str, ...] = ()
    clearances: tuple[str, ...] = ()
    stats: SolveStats = field(default_factory=SolveStats)
    target: str = ""
    strategy: Strategy | None = None
    goal: Goal | None = None

    def __repr__(self) -> str:
        detail = textwrap.shorten(self.detail, _EVIDENCE, placeholder=" ...")
        is_place = self.goal is not None and not self.target
        wanted = f"goal={reprlib.repr(str(self.goal))}" if is_place else f"target={reprlib.repr(self.target)}"
        return f"Infeasible({wanted}, cause={str(self.cause)!r}, detail={detail!r})"

    def summary(self) -> str:
        """Describe the failure in several lines: target, cause, evidence, times."""
        by = f", with strategy {self.strategy.name!r}" if self.strategy else ""
        rows = {
            "Cause": str(self.cause),
            "Evidence": self.detail,
            "Objects concerned": ", ".join(self.objects) or "none",
            "Cleared before the failure": ", ".join(self.clearances) or "none",
            **self.stats.rows(),
        }
        reaches = f"takes {self.target or 'the target'}" if self.goal is None or self.target else f"reaches {self.goal}"
        lines = [f"No plan {reaches}{by}"]
        return "\n".join([*lines, *(f"{name}: {value}" for name, value in rows.items())])

    def _repr_html_(self) -> str:
        return html_table(self.summary())


def html_table(summary: str) -> str:
    """Format a summary, lines of "name: value", as an HTML table for notebooks."""
    cells = [[html.escape(cell) for cell in line.partition(": ")[::2]] for line in summary.splitlines()]
    return f"<table>{''.join(f'<tr><th>{name}</th><td>{value}</td></tr>' for name, value in cells)}</table>"


def _clearance(action: BoundAction) -> str:
    """Describe one clearance: the object, its new position, and the object that it obstructs."""
    body = action.released
    where = "" if body is None else f" to x = {body.position[0]:.2f} m, y = {body.position[1]:.2f} m"
    because = f", because it obstructs {action.obstructed}" if action.obstructed else ""
    return f"{action.target}{where}{because}"
