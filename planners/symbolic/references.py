"""References: the symbols that stand for poses, paths and locations, and the facts that offer them to a task planner.

Names follow Fig. 13 of Lee & Kim 2019: `robot_gp_object_36` is the base pose for grasping object_36,
`arm_pdp_table_loc_36` the arm pose for putting it down at `table_loc_36`, and `…_mp_…` are the motion paths there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

from planners.symbolic.problem import GRIPPER, ROBOT_INIT_LOC, Atom, SymbolError, SymbolicState


class References(NamedTuple):
    """The symbols of one arm motion: where the base stands, where the arm ends, and the two paths there."""

    base_pose: str
    arm_pose: str
    base_trajectory: str
    arm_trajectory: str


def grasp_references(name: str) -> References:
    """References for grasping an object where it stands."""
    return References(f"robot_gp_{name}", f"arm_gp_{name}", f"robot_mp_{name}", f"arm_mp_{name}")


def placement_references(location: str) -> References:
    """References for putting something down at a location."""
    return References(f"robot_pdp_{location}", f"arm_pdp_{location}", f"robot_mp_{location}", f"arm_mp_{location}")


def initial_location(name: str) -> str:
    """Symbol of the place where an object stood first."""
    return f"{name}_init_loc"


def initial_state(
    objects: Collection[str],
    *,
    held: str | Mapping[str, str] | None = None,
    robot_at: str = ROBOT_INIT_LOC,
    standing_at: Mapping[str, str] | None = None,
    grippers: Collection[str] = (GRIPPER,),
) -> SymbolicState:
    """What a scene says before any motion is planned: every object can be grasped where it stands.

    Args:
        objects: names of all objects.
        held: the object in the first gripper, or objects by gripper; they may be put down (as no obstacles until an
            error says so).
        robot_at: symbol of the base pose.
        standing_at: location symbols of objects that were moved before.
        grippers: symbols of the robot's grippers.

    Raises:
        SymbolError: a name PDDL cannot hold, or a held object is not among the objects.
    """
    in_hand = {next(iter(grippers)): held} if isinstance(held, str) else dict(held or {})
    for name in in_hand.values():
        if name not in objects:
            raise SymbolError(f"held object {name!r} is not among the objects: {', '.join(sorted(objects))}")
    moved = standing_at or {}
    facts: set[Atom] = {("robotAt", robot_at)}
    facts |= {("graspedBy", in_hand[one], one) if one in in_hand else ("empty", one) for one in grippers}
    for name in objects:
        location = moved.get(name, initial_location(name))
        if name not in in_hand.values():
            facts |= {("objectAt", name, location), ("occupied", location)}
            facts |= motion_facts(grasp_references(name), name, location)
    state = SymbolicState(frozenset(facts), frozenset(moved.values()))
    for name in sorted(in_hand.values()):
        location = next_location(state, name)
        motion = motion_facts(placement_references(location), name, location)
        state = state.changed(add={("isPlacementLocation", location, name), *motion})
    return state


def reached_by(state: SymbolicState, name: str, gripper: str) -> SymbolicState:
    """The state in which this gripper alone reaches the grasp that an object's references stand for."""
    pose = grasp_references(name).arm_pose
    others = {("outOfReach", other, pose) for other in state.grippers if other != gripper}
    return state.changed(add=others, remove={("outOfReach", gripper, pose)})


def motion_facts(references: References, name: str, location: str) -> set[Atom]:
    """The facts that say: this motion reaches object `name` at `location`."""
    return {
        ("isGrasp", references.arm_pose, name, location),
        ("isMotion", references.arm_trajectory, references.base_pose, references.arm_pose),
        ("isBaseMotion", references.base_trajectory, references.base_pose),
    }


def next_location(state: SymbolicState, name: str) -> str:
    """A symbol for a new place on the table for object `name`: `table_loc_36`, `table_loc_36_2`, …"""
    base = f"table_loc_{name.removeprefix('object_')}"
    taken = state.retired | {fact[3] for fact in state.facts if fact[0] == "isGrasp" and fact[2] != name}
    taken |= {fact[1] for fact in state.facts if fact[0] == "occupied"}
    suffix = 1
    while (symbol := base if suffix == 1 else f"{base}_{suffix}") in taken:
        suffix += 1
    return symbol
