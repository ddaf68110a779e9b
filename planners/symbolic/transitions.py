"""References, and changes of the symbolic state by actions of the plan and by results of motion planning.

References are symbols for poses, paths and locations. Their names follow Fig. 13 of Lee & Kim 2019:
`robot_gp_object_36` is the base pose for grasping object_36, `arm_pdp_table_loc_36` the arm pose for putting it down at
`table_loc_36`, and `…_mp_…` are the motion paths there.

`update_from_action` and `update_from_error` are the two updates of Algorithm 1 (Lee & Kim 2019). In addition to the
effects in PDDL they rebind references. A fact about a path is dropped once the path's symbol means another path.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

from planners.symbolic.problem import GRIPPER, ROBOT_INIT_LOC, Atom, GroundAction, SymbolicState


class References(NamedTuple):
    """Symbols of one arm motion: the base pose, the final arm pose, and the paths of base and arm to them."""

    base_pose: str
    arm_pose: str
    base_trajectory: str
    arm_trajectory: str


def grasp_references(name: str) -> References:
    """References for grasping an object at its present location."""
    return References(f"robot_gp_{name}", f"arm_gp_{name}", f"robot_mp_{name}", f"arm_mp_{name}")


def placement_references(location: str) -> References:
    """References for putting an object down at a location."""
    return References(f"robot_pdp_{location}", f"arm_pdp_{location}", f"robot_mp_{location}", f"arm_mp_{location}")


def initial_state(
    objects: Collection[str],
    held: Mapping[str, str] = MappingProxyType({}),
    grippers: Collection[str] = (GRIPPER,),
    held_obstructs: str = "",
) -> SymbolicState:
    """Facts of a scene before any motion is planned: every object can be grasped at its location.

    `held`: objects by the gripper that holds them. They may be put down. They are no obstacles until an error reports
    it, or, with `held_obstructs`, obstacles of the object for which they were taken away.
    """
    facts: set[Atom] = {("robotAt", ROBOT_INIT_LOC)}
    facts |= {("graspedBy", held[one], one) if one in held else ("empty", one) for one in grippers}
    for name in objects:
        if name not in held.values():
            location = f"{name}_init_loc"
            facts |= {("objectAt", name, location), ("occupied", location)}
            facts |= motion_facts(grasp_references(name), name, location)
    state = SymbolicState(frozenset(facts))
    for name in sorted(held.values()):
        location = next_location(state, name)
        motion = motion_facts(placement_references(location), name, location)
        state = state.changed(add={("isPlacementLocation", location, name), *motion})
    for name in sorted(held.values()) if held_obstructs else ():
        state = _offer_clearance(state, name, held_obstructs)
    return state


class ArmStep(NamedTuple):
    """A pick or a put-down of a plan: the object, and whether it is put down."""

    object: str
    is_put_down: bool


class Moved(NamedTuple):
    """Move of a plan for a goal with places.

    Attributes:
        object: its name.
        blockers: names of the objects that obstruct its grasp.
        is_put_down: whether it is put down again, or stays held.
        obstructs: the object for which it is put aside. "" if it is put at its goal location.
    """

    object: str
    blockers: tuple[str, ...]
    is_put_down: bool
    obstructs: str = ""


def with_moves(
    state: SymbolicState, moves: Sequence[Moved], steps: Sequence[ArmStep]
) -> tuple[SymbolicState, tuple[Atom, ...]]:
    """The state with the references of these moves, in this order, without those of other moves. Also returns the goal
    facts.

    A goal with places is a conjunction of facts `objectAt` with a location for placement or clearance.

    Args:
        state: the facts.
        moves: the moves. The objects that they put down are objects of the goal facts.
        steps: their picks and put-downs in order. With one hand, each object is put down before the next is picked.
    """
    stale = {fact for fact in state.facts if fact[0] in ("obstructs", "obstacle", "waitsFor", "putAfter")}
    offers = {fact[1:3] for fact in state.find("isClearanceLocation", None, None, None)}
    offers |= {fact[1:3] for fact in state.find("isPlacementLocation", None, None)}
    for location, name in offers:
        stale |= {*state.find("isClearanceLocation", location, name, None), ("isPlacementLocation", location, name)}
        if ("objectAt", name, location) not in state.facts:
            stale |= set(state.find("isGrasp", None, name, location))
    state = state.changed(remove=stale)
    wanted: list[Atom] = []
    locations: dict[str, str] = {}
    for name, blockers, is_put_down, obstructs in moves:
        add: set[Atom] = {("obstructs", other, grasp_references(name).arm_trajectory, name) for other in blockers}
        if is_put_down:
            location = locations[name] = next_location(state, name)
            add |= motion_facts(placement_references(location), name, location)
            wanted.append(("objectAt", name, location))
            if obstructs:
                add |= {("obstacle", name), ("isClearanceLocation", location, name, obstructs)}
            else:
                add.add(("isPlacementLocation", location, name))
        state = state.changed(add=add)
    return state.changed(add=_in_order(steps, locations)), tuple(wanted)


def _in_order(steps: Sequence[ArmStep], locations: Mapping[str, str]) -> Iterator[Atom]:
    """Facts that forbid each step before the one ahead of it. `locations`: where objects are put, by name."""
    for before, (name, is_put_down) in itertools.pairwise(steps):
        if before.is_put_down:
            yield ("putAfter" if is_put_down else "waitsFor"), name, before.object
        elif before.object != name:
            references = placement_references(locations[name]) if is_put_down else grasp_references(name)
            yield "obstructs", before.object, references.arm_trajectory, name


def reached_by(state: SymbolicState, name: str, gripper: str) -> SymbolicState:
    """The state in which only this gripper reaches the grasp of an object's references."""
    pose = grasp_references(name).arm_pose
    others = {("outOfReach", other, pose) for other in state.grippers if other != gripper}
    return state.changed(add=others, remove={("outOfReach", gripper, pose)})


def motion_facts(references: References, name: str, location: str) -> set[Atom]:
    """Facts that a motion reaches object `name` at `location`."""
    return {
        ("isGrasp", references.arm_pose, name, location),
        ("isMotion", references.arm_trajectory, references.base_pose, references.arm_pose),
        ("isBaseMotion", references.base_trajectory, references.base_pose),
    }


def next_location(state: SymbolicState, name: str) -> str:
    """New symbol of a location for object `name`: `table_loc_36`, `table_loc_36_2`, …"""
    base = f"table_loc_{name.removeprefix('object_')}"
    taken = state.retired | {fact[3] for fact in state.facts if fact[0] == "isGrasp" and fact[2] != name}
    taken |= {fact[1] for fact in state.facts if fact[0] == "occupied"}
    later = (f"{base}_{number}" for number in itertools.count(2))
    return next(symbol for symbol in itertools.chain((base,), later) if symbol not in taken)


class InapplicableActionError(ValueError):
    """An action with unmet preconditions, or with a wrong name or number of arguments."""


@dataclass(frozen=True)
class GraspObstructed:
    """Error: exactly these objects obstruct the grasp that is now bound to the object's references."""

    object: str
    blockers: frozenset[str]


def unmet_preconditions(state: SymbolicState, action: GroundAction) -> tuple[Atom, ...]:
    """Facts that make an action inapplicable: missing facts, and facts that must not hold ("not", …)."""
    required, forbidden = _preconditions(state, action)
    return (*sorted(required - state.facts), *sorted(("not", *fact) for fact in forbidden & state.facts))


def apply_action(state: SymbolicState, action: GroundAction) -> SymbolicState:
    """The state after an action, by only the effects of the PDDL domain.

    Raises:
        InapplicableActionError: a precondition does not hold. The message lists them.
    """
    if unmet := unmet_preconditions(state, action):
        raise InapplicableActionError(f"{action} is not applicable: {', '.join(map(str, unmet))}")
    return state.changed(*_effects(state, action))


def update_from_action(state: SymbolicState, action: GroundAction) -> SymbolicState:
    """The state after a verified action (Algorithm 1, updateInitialStateFromAction). Raises as `apply_action`.

    An object that was put down keeps its grasp references, which now mean grasps at its new place.
    """
    state = apply_action(state, action)
    if action.name not in ("PutDownGeneral", "PutDownForClearance"):
        return state
    name, location = action.args[0], action.args[-1]
    state = _without_obstructions(state, grasp_references(name).arm_trajectory)
    stale = {
        *state.find("isGrasp", None, name, None),
        *state.find("isClearanceLocation", None, name, None),
        *state.find("isPlacementLocation", None, name),
    }
    state = state.changed(add=motion_facts(grasp_references(name), name, location), remove=stale)
    return replace(state, retired=state.retired | {location})


def update_from_error(state: SymbolicState, error: GraspObstructed) -> SymbolicState:
    """The state after a failed motion (Algorithm 1, updateInitialStateFromError, section 3.4).

    Adds facts obstacle, obstructs and isClearanceLocation. They replace those of an earlier binding of the same
    references.
    """
    trajectory = grasp_references(error.object).arm_trajectory
    state = _without_obstructions(state, trajectory)
    for blocker in sorted(error.blockers):
        state = _offer_clearance(state, blocker, error.object)
        state = state.changed(add={("obstructs", blocker, trajectory, error.object)})
    return state


def applicable_actions(state: SymbolicState) -> Iterator[GroundAction]:
    """Every action whose preconditions hold, in a fixed order."""
    here = state.robot_at
    for _, trajectory, pose in state.find("isBaseMotion", None, None):
        if pose != here:
            yield GroundAction("MoveBase", (here, pose, trajectory))
    yield from (action for action, base in arm_actions(state) if base == here)


def arm_actions(state: SymbolicState) -> Iterator[tuple[GroundAction, str]]:
    """Every pick-up and put-down that is possible now or after a drive, with its base pose."""
    for _, trajectory, base, arm_pose in state.find("isMotion", None, None, None):
        for _, _, name, location in state.find("isGrasp", arm_pose, None, None):
            motion = (base, arm_pose, trajectory, location)
            targets = [fact[3] for fact in state.find("isClearanceLocation", location, name, None)]
            for gripper in state.grippers:
                for action in (
                    GroundAction("PickUp", (name, gripper, *motion)),
                    GroundAction("PutDownGeneral", (name, gripper, *motion)),
                    *(GroundAction("PutDownForClearance", (name, target, gripper, *motion)) for target in targets),
                ):
                    if set(unmet_preconditions(state, action)) <= {("robotAt", base)}:
                        yield action, base


def _preconditions(state: SymbolicState, action: GroundAction) -> tuple[frozenset[Atom], frozenset[Atom]]:
    """Facts that must hold and facts that must not."""
    match action:
        case GroundAction("MoveBase", (pose1, pose2, traj)):
            return frozenset({("robotAt", pose1), ("isBaseMotion", traj, pose2)}), frozenset()
        case GroundAction("PickUp", (name, gripper, pose1, pose2, traj, location)):
            empty = {gripper} if state.holds_aside else {gripper, *state.grippers}
            specific: set[Atom] = {("empty", one) for one in empty}
            specific.add(("objectAt", name, location))
            forbidden: set[Atom] = {("outOfReach", gripper, pose2), *state.find("waitsFor", name, None)}
        case GroundAction("PutDownGeneral", (name, gripper, pose1, pose2, traj, location)):
            specific = {("graspedBy", name, gripper), ("isPlacementLocation", location, name)}
            forbidden = {("obstacle", name), ("occupied", location), *state.find("putAfter", name, None)}
        case GroundAction("PutDownForClearance", (name, tar, gripper, pose1, pose2, traj, location)):
            specific = {("graspedBy", name, gripper), ("isClearanceLocation", location, name, tar), ("obstacle", name)}
            forbidden = {("occupied", location), *state.find("putAfter", name, None)}
        case _:
            raise InapplicableActionError(f"no action of the domain: {action}; see GroundAction for the valid ones")
    motion = {("robotAt", pose1), ("isGrasp", pose2, name, location), ("isMotion", traj, pose1, pose2)}
    return frozenset(specific | motion), frozenset({*forbidden, *state.find("obstructs", None, traj, name)})


def _effects(state: SymbolicState, action: GroundAction) -> tuple[set[Atom], set[Atom]]:
    """Facts added and facts removed."""
    if action.name == "MoveBase":
        pose1, pose2, _ = action.args
        return {("robotAt", pose2)}, {("robotAt", pose1)}
    name, location, gripper = action.args[0], action.args[-1], str(action.gripper)
    in_hand: set[Atom] = {("graspedBy", name, gripper)}
    on_table: set[Atom] = {("empty", gripper), ("objectAt", name, location), ("occupied", location)}
    if action.name == "PickUp":
        return in_hand, on_table | set(state.find("obstructs", name, None, None))
    in_hand |= {*state.find("waitsFor", None, name), *state.find("putAfter", None, name)}
    if action.name == "PutDownForClearance":
        return on_table, in_hand | {("obstacle", name), ("isClearanceLocation", location, name, action.args[1])}
    return on_table, in_hand


def _without_obstructions(state: SymbolicState, trajectory: str) -> SymbolicState:
    """Remove the facts on objects that obstruct a path, and the obstacle facts of those that obstruct no other path."""
    stale = state.find("obstructs", None, trajectory, None)
    state = state.changed(remove=stale)
    for _, blocker, _, name in stale:
        if not state.find("obstructs", blocker, None, name):
            state = state.changed(remove=state.find("isClearanceLocation", None, blocker, name))
        if not state.find("obstructs", blocker, None, None):
            state = state.changed(remove={("obstacle", blocker)})
    return state


def _offer_clearance(state: SymbolicState, obstacle: str, target: str) -> SymbolicState:
    """Add the facts that `obstacle` is an obstacle with a location where it does not obstruct `target`."""
    offered = state.find("isClearanceLocation", None, obstacle, None)
    location = offered[0][1] if offered else next_location(state, obstacle)
    facts = motion_facts(placement_references(location), obstacle, location)
    return state.changed(add={("obstacle", obstacle), ("isClearanceLocation", location, obstacle, target), *facts})
