"""Questions about scenes, each with an answer that is proved: for models that see images and answer in words.

What is asked is what a robot must know before it acts: whether an object can be taken now, and from where, how many
others must be moved before and which, what is touched on the way, what falls. Grasps are level, from 24 directions.

A "yes" is proved by a grasp: base pose, arm configuration and gripper touch nothing. A "no" is proved by the gripper
alone: with its wrist it touches an object from every direction, wherever base and arm are. A number is proved where
both give the same one: the fewest objects by a plan, and by the gripper alone. What lies between is not asked, nor is
what has several right answers, or what a millimetre would decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.obstruction import side_approaches, side_grasps
from planners import Scene
from planners.clearing.lower_bound import MAX_EXPANSIONS, self_clearable_sets
from planners.collision.world import CollisionWorld, objects_on
from planners.grasping.families import SIDE, Family, GraspFamily
from planners.scene import STATIC_BIT
from planners.workspace import Workspace

Answer: TypeAlias = bool | int | tuple[str, ...]
"""Yes or no, a number, or names, sorted."""
_NEAR, _FAR, _BEYOND = math.radians(50), math.radians(130), math.pi
SIDES: Mapping[str, tuple[Family, ...]] = {
    "front": (GraspFamily("front", 0.0, yaws=(-_NEAR, _NEAR)),),
    "left": (GraspFamily("left", 0.0, yaws=(-_FAR, -_NEAR)),),
    "right": (GraspFamily("right", 0.0, yaws=(_NEAR, _FAR)),),
    "behind": (
        GraspFamily("behind", 0.0, yaws=(_FAR, _BEYOND)),
        GraspFamily("behind", 0.0, yaws=(-_BEYOND, -_FAR)),
    ),
}
"""Level grasps by the side from which the gripper comes, as seen across the table along +x, with +y to the left: the
robot stands before it, and may look elsewhere. The 24 directions of a grasp are 15° apart, and none is on a border."""
BAR = 0.12
"""[m] Width of the bar of "touched", about that of the open gripper."""
DECIDES = 0.003
"""[m] An object whose distance from the bar is less than this, on either side, makes the question unfair."""
KINDS = ("taken now", "fewest", "which", "from where", "touched", "falls")
OF_GRASPS = ("taken now", "fewest", "which", "from where")
"""Kinds whose answers depend on every object that stands there."""
_ANY = "any"
DRIVES = "It may first drive along the edge of the table at which it stands."
"""Said with every question about grasps: an image shows the robot at one place, from which it reaches less."""
DIRECTIONS = tuple(
    next(
        side
        for side, families in SIDES.items()
        for family in families
        if isinstance(family, GraspFamily) and family.yaws and family.yaws[0] <= yaw <= family.yaws[1]
    )
    for yaw in (math.remainder(2 * math.pi * index / SIDE.directions, 2 * math.pi) for index in range(SIDE.directions))
)
"""The side of each direction of the gripper, from 0 (away from the robot) on, anticlockwise."""
_Touching: TypeAlias = Callable[[str], Sequence[int]]
OVERLAP = 0.005
"""[m] by which the outline of gripper and wrist must overlap an object to count: it is drawn around their shapes."""
_WIDER = 1
"""Cells of the table, and directions, by which more counts as within reach."""
_MOST_SETS = 2
"""Number of smallest sets to search for: with a second set the answer is not unique."""


@dataclass(frozen=True)
class Question:
    """One question about a scene.

    Attributes:
        kind: one of `KINDS`.
        about: name of the object that it is about.
        text: in English, with the object's name.
        answer: the right one.
        choices: what can be answered: names for those kinds, empty for a number, or for yes and no.
    """

    kind: str
    about: str
    text: str
    answer: Answer
    choices: tuple[str, ...] = ()


@dataclass
class Asker:
    """Asks about scenes of one environment, whose workspaces it keeps.

    Attributes:
        workspaces: of the planner, by the side from which grasps come, and `_ANY` for all of them.
    """

    workspaces: dict[str, Workspace] = field(default_factory=dict)

    def questions(self, env: Any, about: Sequence[str]) -> list[Question]:
        """All questions about the present scene whose answers are proved.

        Args:
            env: an environment of this package, unwrapped, that has been reset.
            about: names of the objects that questions are about. All objects in a scene in which something stands on
                something else.
        """
        scene = Scene.from_mujoco(env.model, env.data, env.robot)
        if _is_stacked(scene):
            return [_falls(scene, name) for name in scene.names]
        touching, found = _touching(env), list[Question | None]()
        for name in about:
            found += [self._taken_now(scene, touching, name), self._from_where(scene, touching, name)]
            found.append(_touched(scene, name))
            found += self._fewest(scene, touching, name)
        return [one for one in found if one is not None]

    def _taken_now(self, scene: Scene, touching: _Touching, name: str) -> Question | None:
        is_free = self._is_free(scene, touching, name, _ANY)
        text = f"Can the robot take {name} now, with its gripper level, without moving another object? {DRIVES}"
        return None if is_free is None else Question("taken now", name, text, is_free)

    def _from_where(self, scene: Scene, touching: _Touching, name: str) -> Question | None:
        found = {side: self._is_free(scene, touching, name, side) for side in SIDES}
        if None in found.values():
            return None
        text = (
            f"From which sides can the robot take {name} now, with its gripper level, without moving another object? "
            f"{DRIVES} The sides are as seen across the table at right angles to that edge, wherever the robot stands "
            "and looks: within 50° of this direction the gripper comes from the front, within 50° of the opposite one "
            "from behind, otherwise from the left or the right."
        )
        return Question("from where", name, text, tuple(sorted(side for side in SIDES if found[side])), tuple(SIDES))

    def _is_free(self, scene: Scene, touching: _Touching, name: str, side: str) -> bool | None:
        """Whether an object can be taken from a side now, None if neither is proved."""
        masks = touching(name)
        if all(mask for mask, direction in zip(masks, DIRECTIONS, strict=bool(masks)) if side in (_ANY, direction)):
            return False
        return True if 0 in self._workspace(scene, side).grasps().blockers(scene, name) else None

    def _fewest(self, scene: Scene, touching: _Touching, name: str) -> Iterator[Question]:
        candidates = self._workspace(scene, _ANY).grasps()
        plan = next(self_clearable_sets(partial(candidates.blockers, scene), name, scene.names))
        least, sets = _smallest(touching, name, scene.names)
        if plan.count is None or plan.count != least:
            return
        how = f"before the robot can take {name} with its gripper level"
        yield Question("fewest", name, f"How many other objects must at least be moved {how}? {DRIVES}", least)
        if len(sets) == 1 and least:
            others = tuple(one for one in scene.names if one != name)
            text = f"Which objects must be moved {how}, if as few as possible are moved? {DRIVES}"
            yield Question("which", name, text, tuple(sorted(sets[0])), others)

    def _workspace(self, scene: Scene, side: str) -> Workspace:
        if side not in self.workspaces:
            families = SIDES[side] if side != _ANY else (SIDE, *chain(*SIDES.values()))
            self.workspaces[side] = Workspace.of(scene.robot, scene, grasps=families)
        return self.workspaces[side]


def _touching(env: Any) -> _Touching:
    """What gripper and wrist alone touch at each grasp of an object: a mask for each of `DIRECTIONS`.

    A direction from which the robot reaches nothing near the object, on the empty table, has the bit of what never
    moves. See `_widened`.
    """
    known, scene = side_approaches(env.robot.full_name), env.world.scene
    known = replace(known, margins=known.margins._replace(padding=-OVERLAP))
    table = known.reachable[env.layout.name]
    anywhere = replace(known, reachable={env.layout.name: np.ones_like(table)})
    own, hits = side_grasps(anywhere, env.layout, scene, env.robot.max_opening)
    wide = replace(known, reachable={env.layout.name: _widened(table)})
    bits = 1 << np.arange(hits.shape[1])
    yaws = np.arange(len(DIRECTIONS), dtype=np.float64) * (2 * math.pi / len(DIRECTIONS))
    towards = np.array((np.cos(yaws), np.sin(yaws)), np.float64).T
    masks: dict[str, list[int]] = {}
    for slot, name in enumerate(env.world.names):
        depth = max(float(scene.half_extents[slot, 0]) - known.palm_reach, 0.0)
        tcp = np.subtract(scene.positions[slot], depth * towards, dtype=np.float64)
        is_reached = wide.is_reachable(env.layout, tcp, yaws)
        touched = (hits[own == slot] @ bits).tolist()
        masks[name] = [mask if can else STATIC_BIT for mask, can in zip(touched, is_reached, strict=False)]
    return lambda name: masks[name]


def _widened(reachable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A table of reachable directions, with the neighbours of each cell and of each direction: (nx, ny, yaws).

    The table was made with some base poses of the planner's. With others the robot reaches a little more.
    """
    padded = np.pad(reachable, ((_WIDER, _WIDER), (_WIDER, _WIDER), (0, 0)))
    nx, ny, _ = reachable.shape
    shifts = range(2 * _WIDER + 1)
    cells = np.any([padded[x : x + nx, y : y + ny] for x in shifts for y in shifts], axis=0)
    return np.asarray(np.any([np.roll(cells, turn, axis=2) for turn in range(-_WIDER, _WIDER + 1)], axis=0))


def _smallest(touching: _Touching, name: str, names: Sequence[str]) -> tuple[int | None, list[frozenset[str]]]:
    """The fewest objects that must have left before the gripper alone has room, and up to two smallest sets of them.

    None where there is no such number, or the search gave up.
    """
    sets: list[frozenset[str]] = []
    count = None
    for found in self_clearable_sets(touching, name, names):
        if not found.proved or found.count is None or found.expansions >= MAX_EXPANSIONS:
            return None, []
        count = found.count
        sets.append(frozenset(found.objects) - {name})
        if len(sets) == _MOST_SETS:
            break
    return count, sets


def _touched(scene: Scene, name: str) -> Question | None:
    gaps = {other: gap_to_bar(scene, name, other) for other in scene.names if other != name}
    if any(abs(gap) < DECIDES for gap in gaps.values()):
        return None
    text = (
        f"A bar {BAR * 100:.0f} cm wide, level and straight, is pushed over the table from the edge at which the robot "
        f"stands, at right angles to that edge, until its tip is at the middle of {name}, with which it is in line. "
        "Which other objects does it touch?"
    )
    return Question("touched", name, text, tuple(sorted(one for one, gap in gaps.items() if gap < 0)), tuple(gaps))


def gap_to_bar(scene: Scene, name: str, other: str) -> float:
    """[m] between a cylinder and the bar of "touched" on its way to another one. Negative if the bar touches it."""
    tip, at = scene.body(name).position, scene.body(other).position
    away = np.array([max(at[0] - tip[0], 0.0), max(abs(at[1] - tip[1]) - BAR / 2, 0.0)])
    inside = min(tip[0] - at[0], BAR / 2 - abs(at[1] - tip[1]))
    distance = float(np.hypot(*away)) if away.any() else -float(inside)
    return distance - float(scene.body(other).half_extents[0])


def _falls(scene: Scene, name: str) -> Question:
    on_it = scene.names_of(objects_on(CollisionWorld.from_scene(scene), name))
    text = f"{name} is taken away at once, sideways, and touches nothing else. Which objects fall?"
    return Question("falls", name, text, tuple(sorted(on_it)), tuple(one for one in scene.names if one != name))


def _is_stacked(scene: Scene) -> bool:
    """Whether something stands on something else than a support."""
    world = CollisionWorld.from_scene(scene)
    return any(objects_on(world, name) for name in scene.names)
