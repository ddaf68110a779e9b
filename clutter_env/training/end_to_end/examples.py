"""Examples for the end-to-end network: canonical plans of random scenes, without physics, and the tables of each scene.

A decision is made at the end of each phase of a plan. At every pick the planner's geometry says, for each object and
each direction, whether it is reached and which objects are in the way: hundreds of labels where the plan itself has
two.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from assets import RobotSpec
from clutter_env.policies.end_to_end.anchors import DIRECTIONS, nearest_direction, table_cells
from clutter_env.policies.end_to_end.controller import PHASES
from clutter_env.policies.end_to_end.network import KEYFRAME_SIZE, NO_PHASE, NOMINAL_DISTANCE
from clutter_env.policies.high_level.candidates import CandidateRule, object_rows
from clutter_env.policies.motion.arm import nearest_home
from clutter_env.policies.parsed_observation import wrapped
from clutter_env.policies.weights import damage_refused
from clutter_env.reporting.files import written_atomically
from clutter_env.scene.layout import TABLE_HEIGHT, Layout
from clutter_env.seeds import training_seeds
from clutter_env.training.end_to_end.right_choices import right_objects
from clutter_env.training.grasp_labels import label, scene_of
from planners import (
    BoundAction,
    Contact,
    Planner,
    RobotState,
    Scene,
    SceneError,
    Solution,
    contact_of,
    stand_at,
    tcp_pose,
)

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

MOST_OBJECTS = 25
"""Rows of objects in the examples; the network itself takes any number."""
_SIZES = (15, 15, 25, 10, 5, 20, 15, 1, 15, 15)
_COUNTS = tuple((size, place not in (7, 8)) for place, size in enumerate(_SIZES))
"""Numbers of objects, and whether the target is obstructed, in turn."""
_PER_FILE = 40
"""Plans in a file of examples."""
_FIRST_SEED, _SEEDS_OF_A_FILE = 600_001, 1000
"""First seed of the scenes, and seeds of a file."""
_EXACT = 0.03
"""[rad] by which a contact may be off its nearest direction."""
_AHEAD = 0.02
"""[rad] off straight ahead, and [m] off the middle of a cell, of places that the network can point at."""
_PLACES_SHARE = 0.08
"""Share of the places around a scene that are labelled."""
_PLACE_TURN, _PLACE_YAW = 0.4, 1.1
"""[rad] of gripper against base, and of the gripper, in labelled places at most."""
_STRAIGHT = 0.05
"""[m], [rad] by which a motion may be off the straight joint line; others cannot be followed by keyframes alone."""
_JOINT_LINES = ("drive", "transit")
"""Phases whose motion the controller makes a straight joint line."""
_SAMPLES = 12
"""Of a motion, to see whether it is straight."""


@dataclass(frozen=True, eq=False)
class _Arrays:
    """Examples as arrays with a row for each."""

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join several."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    @classmethod
    def of_rows(cls, rows: Sequence[Sequence[Any]]) -> Self:
        """From rows with a value for each field."""
        columns = zip(*rows, strict=True) if rows else [() for _ in fields(cls)]
        return cls(*(np.array(column) for column in columns))


@dataclass(frozen=True, eq=False)
class _InScenes(_Arrays):
    """s examples, each in a scene.

    Attributes:
        seed: (s,) of the scene.
        objects: (s, n, 5) `anchors.OBJECT_COLUMNS`, 0 beyond `size`.
        size: (s,) number of objects.
    """

    seed: NDArray[np.int64]
    objects: NDArray[np.float32]
    size: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _WithTarget(_InScenes):
    """s examples of plans for a target, its index `target` (s,)."""

    target: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PickExamples(_WithTarget):
    """s decisions to pick.

    Attributes:
        is_reached: (s, n, c) whether each direction is reached.
        blockers: (s, n, c) mask of what is in its way.
        is_right: (s, n) objects that begin a shortest sequence of clearances, or else the plan's.
        index, direction: (s,) of the plan; direction -1 if none is near.
    """

    is_reached: NDArray[np.bool_]
    blockers: NDArray[np.uint64]
    is_right: NDArray[np.bool_]
    index: NDArray[np.int64]
    direction: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PlaceExamples(_WithTarget):
    """s decisions to put down.

    Attributes:
        held: (s,) index of the held object.
        own: (s, 5) the held object, standing at the plan's place.
        before: (s, 2) [m] where it was taken from.
        cell: (s,) of the plan, -1 if it is between cells.
    """

    held: NDArray[np.int64]
    own: NDArray[np.float32]
    before: NDArray[np.float32]
    cell: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PlaceLabels(_InScenes):
    """m labelled places.

    Attributes:
        held: (m,) index of the held object.
        own: (m, 5) the object as it would stand there.
        yaws: (m, 2) of gripper and base [rad].
        is_reached: (m,).
        blockers: (m,) mask of what is in the way.
    """

    held: NDArray[np.int64]
    own: NDArray[np.float32]
    yaws: NDArray[np.float32]
    is_reached: NDArray[np.bool_]
    blockers: NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class KeyframeExamples(_WithTarget):
    """k keyframes. The objects are those when the phase begins.

    Attributes:
        phase, last: (k,) numbers of the phase and of the one before.
        held: (k,) index of the held object, -1 without one.
        was_place: (k,) whether the last phase was of a place.
        index: (k,) of the object of the contact.
        own: (k, 5) the object as it stands at the contact.
        yaws: (k, 2) of gripper and base at the contact [rad].
        is_place: (k,) whether it is put down.
        base: (k, 3) of the robot when the phase begins.
        in_hand: (k, 3) [m] of the held object in the TCP's frame.
        keyframe: (k, 15) see `network.KEYFRAME_SIZE`.
        is_straight: (k,) whether the motion there is straight.
    """

    phase: NDArray[np.int64]
    last: NDArray[np.int64]
    held: NDArray[np.int64]
    was_place: NDArray[np.bool_]
    index: NDArray[np.int64]
    own: NDArray[np.float32]
    yaws: NDArray[np.float32]
    is_place: NDArray[np.bool_]
    base: NDArray[np.float32]
    in_hand: NDArray[np.float32]
    keyframe: NDArray[np.float32]
    is_straight: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Examples:
    """All examples of some plans."""

    picks: PickExamples
    places: PlaceExamples
    place_labels: PlaceLabels
    keyframes: KeyframeExamples

    @classmethod
    def joined(cls, parts: Sequence[Examples]) -> Examples:
        """Join several."""
        return cls(*(kind.joined([getattr(part, name) for part in parts]) for name, kind in _KINDS.items()))

    def save(self, path: Path) -> None:
        """Write to a file (npz)."""
        arrays = {f"{name}.{key}": value for name in _KINDS for key, value in vars(getattr(self, name)).items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_atomically(path) as part, part.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: Path) -> Examples:
        """Read a file of `save`. Raises `PolicyError` if it is damaged."""
        with damage_refused(path), np.load(path, allow_pickle=False) as content:
            return cls(
                *(kind(*(content[f"{name}.{one.name}"] for one in fields(kind))) for name, kind in _KINDS.items())
            )


_KINDS: dict[str, Any] = {
    "picks": PickExamples,
    "places": PlaceExamples,
    "place_labels": PlaceLabels,
    "keyframes": KeyframeExamples,
}


def examples_of_plans(directory: Path, plans: int, seed: int = 0) -> Examples:
    """Examples of so many plans, a file for every 40 of them in a directory. Files that are there are read.

    Args:
        directory: of the files.
        plans: how many at least.
        seed: of the run. It chooses one of four sets of scenes, by its remainder.

    Raises:
        PolicyError: a file is damaged.
    """
    parts, wanted = [], min(_PER_FILE, plans)
    for number in range(math.ceil(plans / _PER_FILE)):
        first = _FIRST_SEED + seed % 4 * 100_000 + number * _SEEDS_OF_A_FILE
        path = directory / f"plans-{first}-{wanted}.npz"  # other scenes, or fewer, have a file of their own
        if not path.exists():
            _plans(training_seeds(first, _SEEDS_OF_A_FILE), wanted).save(path)
            _log.info("%s", path)
        parts.append(Examples.load(path))
    return Examples.joined(parts)


def _plans(seeds: range, wanted: int) -> Examples:
    """Examples of the first plans that are found in the scenes of some seeds."""
    envs = {one: _env(*one) for one in set(_COUNTS)}
    env = envs[_COUNTS[0]]
    robot, layout = env.get_wrapper_attr("robot"), env.get_wrapper_attr("layout")
    planner, found = Planner(robot, grasps="side", canonical=True), Collector(robot, layout)
    for number, seed in enumerate(seeds):
        env = envs[_COUNTS[number % len(_COUNTS)]]
        try:
            _, info = env.reset(seed=seed)
            solution = planner.solve(scene_of(env), info["target"])
        except SceneError:
            continue
        if isinstance(solution, Solution):
            found.add(solution, str(info["target"]), seed)
            if found.plans == wanted:
                break
    return found.examples()


def _env(objects: int, is_obstructed: bool) -> gym.Env[Any, Any]:
    return gym.make(f"clutter_env/Retrieve-o{objects}-v0", obstructed=is_obstructed)


class _Contact:
    """A contact of a plan, and what the network points at for it."""

    def __init__(self, contact: Contact, index: int, own: NDArray[np.float32]) -> None:
        self.contact, self.index, self.own = contact, index, own
        self.is_place = contact.skill == "place"
        yaws = np.array((contact.yaw, contact.base[2]))
        self.direction, off = nearest_direction(*yaws)
        if off > _EXACT:
            self.direction = -1
        self.yaws = DIRECTIONS[self.direction] if self.direction >= 0 and not self.is_place else yaws


class Collector:
    """Collects the examples of plans."""

    def __init__(self, robot: RobotSpec, layout: Layout) -> None:
        self._robot, self._rule, self._cells = robot, CandidateRule(robot, layout), table_cells(layout)
        self._rows: dict[str, list[Any]] = {name: [] for name in _KINDS}
        self.plans = 0

    def examples(self) -> Examples:
        """All that were collected."""
        return Examples(*(kind.of_rows(self._rows[name]) for name, kind in _KINDS.items()))

    def add(self, solution: Solution, target: str, seed: int) -> None:
        """Add a plan for a target."""
        self.plans += 1
        names = solution.actions[0].scene.names
        self._target, self._seed = names.index(target), seed
        self._last, self._was_place = NO_PHASE, False
        before = np.zeros(2, np.float32)
        for actions, contact in _by_contact(solution.actions):
            scene, index = actions[-1].scene, names.index(contact.object)
            rows = object_rows(scene.objects)
            own = rows[index].copy()
            if contact.skill == "place":
                own[:2], own[2] = _placed(actions[-1], contact)[:2], TABLE_HEIGHT
            at = _Contact(contact, index, own)
            if contact.skill == "pick":
                self._add_pick(scene, at)
                before = own[:2]
            else:
                self._add_place(scene, at, before)
            for action in actions:
                self._add_keyframes(action, at, names)

    def _add_pick(self, scene: Scene, at: _Contact) -> None:
        """The decision to pick, with the table of the scene."""
        rows, candidates = object_rows(scene.objects), self._rule.picks(scene.objects)
        labels = label(scene, candidates, scene.objects)
        shape = (MOST_OBJECTS, len(DIRECTIONS))
        is_reached, blockers = np.zeros(shape, np.bool_), np.zeros(shape, np.uint64)
        for row, index in enumerate(candidates.index):
            direction, _ = nearest_direction(candidates.tcp[row, 3], candidates.base[row, 2])
            is_reached[index, direction], blockers[index, direction] = labels.is_reached[row], labels.blockers[row]
        if at.direction >= 0 and not is_reached[at.index, at.direction]:
            is_reached[at.index, at.direction] = True
        masks = [blockers[index][is_reached[index]].tolist() for index in range(len(rows))]
        right, _ = right_objects(masks, self._target)
        if at.index not in right:  # what the plan found out on the way is not in the table
            right = frozenset((at.index,))
        is_right = np.isin(np.arange(MOST_OBJECTS), list(right))
        state = (self._seed, _padded(rows), len(rows), self._target)
        self._rows["picks"].append((*state, is_reached, blockers, is_right, at.index, at.direction))

    def _add_place(self, scene: Scene, at: _Contact, before: NDArray[np.float32]) -> None:
        """The decision to put down, and labels of places around."""
        rows, body = _padded(object_rows(scene.objects)), scene.objects[at.index]
        away = np.linalg.norm(self._cells - at.own[:2], axis=1)
        is_ahead = abs(at.yaws).max() < _AHEAD and away.min() < _AHEAD
        cell = int(away.argmin()) if is_ahead else -1
        state = (self._seed, rows, len(scene.objects))
        self._rows["places"].append((*state, self._target, at.index, at.own, before, cell))
        rng = np.random.default_rng(self._seed)
        points = np.column_stack((self._cells, np.full(len(self._cells), TABLE_HEIGHT)))
        assert scene.held is not None
        candidates = self._rule.places(body, scene.held, points)
        is_near = (np.abs(candidates.turn) < _PLACE_TURN) & (np.abs(candidates.tcp[:, 3]) < _PLACE_YAW)
        candidates = candidates.take(is_near & (rng.random(len(candidates)) < _PLACES_SHARE))
        labels = label(scene, candidates, [stand_at(body, point) for point in points])
        for row, index in enumerate(candidates.index):
            own, yaw = at.own.copy(), candidates.tcp[row, 3]
            own[:2] = self._cells[index]
            yaws = np.array((yaw, yaw - candidates.turn[row]), np.float32)
            self._rows["place_labels"].append(
                (*state, at.index, own, yaws, labels.is_reached[row], labels.blockers[row])
            )

    def _add_keyframes(self, action: BoundAction, at: _Contact, names: Sequence[str]) -> None:
        """The keyframes of an action, one at the end of each phase."""
        trajectory, scene, robot = action.trajectory, action.scene, self._robot
        starts = [*(phase.start for phase in trajectory.phases), trajectory.duration]
        objects = object_rows(scene.objects)
        held = names.index(scene.held.name) if scene.held is not None else -1
        T_tcp_object = scene.held.T_tcp_object if scene.held is not None else np.eye(4)
        for phase, end in zip(trajectory.phases, starts[1:], strict=True):
            if end - phase.start < 1e-9:
                continue
            here, there = trajectory.sample(phase.start), trajectory.sample(end)
            T_there = tcp_pose(robot, RobotState(there.base, there.q, there.finger_position))
            in_hand = T_tcp_object[:3, 3] if held >= 0 else np.zeros(3)
            number = PHASES.index(phase.name)
            self._rows["keyframes"].append(
                (
                    *(self._seed, _padded(objects), len(objects), self._target, number, self._last, held),
                    *(self._was_place, at.index, at.own, at.yaws.astype(np.float32), at.is_place),
                    *(here.base.astype(np.float32), in_hand.astype(np.float32)),
                    self._keyframe(at, there.base, T_there, nearest_home(robot, there.q), there.finger_position),
                    phase.name not in _JOINT_LINES or _is_straight(trajectory, phase.start, end),
                )
            )
            self._last, self._was_place = number, at.is_place
            if phase.name == "close":
                held = at.index
                T_tcp_object = np.linalg.inv(T_there) @ scene.objects[at.index].pose
            elif phase.name == "open":
                objects, held = objects.copy(), -1
                objects[at.index] = at.own

    def _keyframe(self, at: _Contact, base: Array, tcp: Array, q: Array, finger: float) -> NDArray[np.float32]:
        """(15,) A keyframe in the frame of the anchor."""
        yaw, heading = at.yaws
        behind = _turned_back(at.own[:2] - base[:2], heading) - (NOMINAL_DISTANCE, 0.0)
        in_anchor = _turned_back(tcp[:2, 3] - at.own[:2], yaw)
        keyframe = np.concatenate(
            (
                *(behind, [math.sin(base[2] - heading)], in_anchor, [tcp[2, 3] - at.own[2]]),
                *(q - np.array(self._robot.in_front), [finger]),
            )
        )
        assert len(keyframe) == KEYFRAME_SIZE
        return keyframe.astype(np.float32)


def _by_contact(actions: Sequence[BoundAction]) -> Iterator[tuple[list[BoundAction], Contact]]:
    """The actions that lead to each contact, and the contact."""
    before: list[BoundAction] = []
    for action in actions:
        before.append(action)
        contact = contact_of(action)
        if contact is not None:
            yield before, contact
            before = []


def _placed(action: BoundAction, contact: Contact) -> Array:
    """(3,) [m] centre of the object that an action puts down."""
    assert action.scene.held is not None
    return np.asarray((contact.tcp @ action.scene.held.T_tcp_object)[:3, 3])


def _padded(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    padded = np.zeros((MOST_OBJECTS, rows.shape[1]), np.float32)
    padded[: len(rows)] = rows
    return padded


def _turned_back(offset: Array, yaw: float) -> Array:
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array((cosine * offset[0] + sine * offset[1], cosine * offset[1] - sine * offset[0]))


def _is_straight(trajectory: Any, start: float, end: float) -> bool:
    """Whether base, torso and arm move on a straight joint line."""
    samples = [trajectory.sample(time) for time in np.linspace(start, end, _SAMPLES)]
    X = np.array([np.concatenate((one.base, one.q)) for one in samples])
    X[:, 2] = X[0, 2] + wrapped(X[:, 2] - X[0, 2])
    line = X[-1] - X[0]
    along = (X - X[0]) @ line / max(float(line @ line), 1e-12)
    return bool(np.abs(X - X[0] - along[:, None] * line).max() < _STRAIGHT)
