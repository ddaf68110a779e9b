"""The end-to-end policy: after each motion its network says where to go next, and a fixed controller goes there.

Its inputs are observations, and what it remembers: its last decision, whether that failed, and where it took the held
object from. It knows the robot's kinematics and the size of the table. It has no planner, no reachability map and no
model of contacts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import assets
from assets import RobotSpec
from clutter_env.envs.base import layout_identity, robot_identity
from clutter_env.policies.end_to_end.anchors import DIRECTIONS, ObservedObjects, observed_objects, table_cells
from clutter_env.policies.end_to_end.controller import PHASES, Controller, Keyframe
from clutter_env.policies.end_to_end.network import (
    ABSENT,
    ARM,
    FINGER,
    NO_PHASE,
    NOMINAL_DISTANCE,
    TCP,
    EndToEndNetwork,
    Scenes,
    pair_features,
    situation_features,
)
from clutter_env.policies.motion.control import stay
from clutter_env.policies.parsed_observation import Observation, ParsedObservation, parse_observation, planar_pose
from clutter_env.policies.protocol import SKILLS, PolicyError, PublicInfo
from clutter_env.policies.weights import WeightsInfo, damage_refused, load_weights
from clutter_env.scene.layout import Layout, find_layout

Array = NDArray[np.float64]

KIND = "end-to-end"
"""Of the weights."""
_HOLD_STEPS = 20
"""Decisions after a retreat with the target in the gripper, after which the policy has finished."""
_MOST_DECISIONS = 12 * SKILLS
"""Keyframes of an episode: about those of the skills that other policies have."""
_BEFORE_CLOSED = ("drive", "ready", "transit", "approach")
"""Phases in which the anchor of a pick moves with its object."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """What the network points at.

    Attributes:
        index: of the object that is picked or put down.
        own: (5,) the object as it stands there, `anchors.OBJECT_COLUMNS`.
        yaws: (2,) of gripper and base [rad].
        is_place: whether it is put down.
    """

    index: int
    own: NDArray[np.float32]
    yaws: Array
    is_place: bool


class EndToEndPolicy:
    """Plays `clutter_env/Retrieve-…` by one network and a fixed controller.

    After a pick or place that failed it draws its next choice from what the network says, instead of taking the best. A
    place has failed too if its object is picked again at once.

    Attributes:
        info: robot, layout and grasps that the network was trained for.
        failure: why it gave up, "" if it did not.
        decisions: keyframes of this episode so far: phase and index of the object.
    """

    grasps = "side"

    def __init__(
        self, network: EndToEndNetwork, robot: RobotSpec, layout: Layout, info: WeightsInfo | None = None
    ) -> None:
        self.info = info or WeightsInfo(KIND, robot_identity(robot), layout_identity(layout), "side")
        self._network, self._robot = network.eval(), robot
        self._controller = Controller(robot)
        self._cells = torch.tensor(table_cells(layout), dtype=torch.float32)
        self._reset()

    @classmethod
    def load(cls, path: Path) -> EndToEndPolicy:
        """Load the policy from a file of weights. Raise `PolicyError`, see `load_weights`."""
        weights, info = load_weights(path, KIND)
        with damage_refused(path):
            network = EndToEndNetwork(len(weights["anchor.bias"]))
            network.load_state_dict(weights)
            return cls(network, assets.robot(info.robot), find_layout(info.layout), info)

    def check(self, public: PublicInfo) -> None:
        """Refuse an environment with another robot, layout, task or kind of actions (`PolicyError`)."""
        found = (public.family, public.control_mode, public.acts_by_skills)
        if found != ("retrieve", "joint", False):
            acts = "skills" if public.acts_by_skills else f"control_mode={public.control_mode!r}"
            raise PolicyError(f"end-to-end plays Retrieve with control_mode='joint', not {public.family} with {acts}")
        self.info.check(public)

    def reset(self, info: Mapping[str, Any]) -> None:  # noqa: ARG002  part of the protocol
        """Start an episode."""
        self._reset()

    def _reset(self) -> None:
        self.failure, self.decisions = "", list[tuple[str, int]]()
        self._controller.reset()
        self._phase = NO_PHASE
        self._anchor: Anchor | None = None
        self._taken_from = np.zeros(2, np.float32)
        self._rng = np.random.default_rng(0)
        self._steps_after, self._has_failed = 0, False

    @property
    def done(self) -> bool:
        """Whether it has finished or given up."""
        return bool(self.failure) or self._steps_after > _HOLD_STEPS

    @property
    def phase(self) -> str:
        """What it is doing, such as "pick object 3: lift"."""
        if self._anchor is None:
            return ""
        return f"{'place' if self._anchor.is_place else 'pick'} object {self._anchor.index}: {PHASES[self._phase]}"

    def act(self, observation: Observation) -> Array:
        """The next action."""
        seen = parse_observation(observation)
        if self.decisions:
            self._controller.update(seen)
        if self._controller.is_over:
            self._decide(seen)
        if self._anchor is None:
            return stay(self._robot, seen)
        return self._controller.act(seen)

    def _decide(self, seen: ParsedObservation) -> None:
        """Ask the network for the next keyframe."""
        objects = observed_objects(seen)
        holds_target = objects.held == objects.target
        if holds_target and self._phase == PHASES.index("retreat"):
            self._steps_after += 1
        with torch.no_grad():
            self._has_failed |= self._controller.has_stopped
            phase = self._next_phase(objects)
            if phase == "drive" or self._anchor is None:
                self._anchor = self._choose(objects)
            if self._anchor is None or len(self.decisions) >= _MOST_DECISIONS:
                self.failure = "nothing is left to choose" if self._anchor is None else "too many keyframes"
                return
            if phase in _BEFORE_CLOSED and not self._anchor.is_place:
                self._anchor = replace(self._anchor, own=objects.rows[self._anchor.index])
            keyframe = self._keyframe(phase, self._anchor, objects, seen)
        self._phase = PHASES.index(phase)
        self.decisions.append((phase, self._anchor.index))
        self._controller.start(keyframe, seen)

    def _next_phase(self, objects: ObservedObjects) -> str:
        is_place = self._anchor is not None and self._anchor.is_place
        state = (objects.held >= 0, objects.held == objects.target, self._controller.has_stopped, is_place)
        logits = self._network.phase_logits(torch.tensor([self._phase]), torch.tensor([state], dtype=torch.float32))
        return PHASES[int(logits.argmax())]

    # The choice of an object or a place.

    def _choose(self, objects: ObservedObjects) -> Anchor | None:
        """The object to pick next and its direction, or the cell where the held object is put down."""
        has_failed = self._has_failed or (self._anchor is not None and not self._anchor.is_place and objects.held < 0)
        self._has_failed = False
        network, scenes = self._network, _scenes(objects)
        tables = network.tables(scenes)
        if objects.held < 0:
            logits, _ = network.point(scenes, tables)
            if float(logits.max()) <= ABSENT:
                return None
            index, direction = divmod(self._one_of(logits.flatten(), has_failed), logits.shape[2])
            # What it has just put down and takes again was in the way there too.
            self._has_failed = self._anchor is not None and self._anchor.is_place and self._anchor.index == index
            self._taken_from = objects.rows[index, :2]
            return Anchor(index, objects.rows[index], DIRECTIONS[direction], is_place=False)
        held = torch.from_numpy(objects.rows[objects.held])[None]
        places = network.judge_places(scenes, network.needs(scenes, tables), held, self._cells)
        logits = network.place_logits(scenes, places, torch.from_numpy(self._taken_from)[None])
        cell = self._one_of(logits.flatten(), has_failed)
        return Anchor(objects.held, places.placed[0, cell].numpy(), np.zeros(2), is_place=True)

    def _one_of(self, logits: torch.Tensor, is_drawn: bool) -> int:
        """Index of the best one, or of one that is drawn."""
        if not is_drawn:
            return int(logits.argmax())
        shares = torch.softmax(logits.double(), dim=0).numpy()
        return int(self._rng.choice(len(shares), p=shares / shares.sum()))

    # The keyframe.

    def _keyframe(self, phase: str, anchor: Anchor, objects: ObservedObjects, seen: ParsedObservation) -> Keyframe:
        """The likeliest keyframe of the network's mixture, in the world."""
        own, yaws = torch.from_numpy(anchor.own)[None], _batch(anchor.yaws)
        others = objects.is_there.copy()
        others[anchor.index] = False
        in_hand = np.zeros(3)
        if objects.held >= 0:
            in_hand = seen.tcp[:3, :3].T @ (seen.position(objects.held) - seen.tcp[:3, 3])
        situation = situation_features(own, yaws, torch.tensor([anchor.is_place]), _batch(seen.base), _batch(in_hand))
        pairs = pair_features(own, yaws, torch.from_numpy(objects.rows)[None])
        number = torch.tensor([PHASES.index(phase)])
        weights, keyframes = self._network.keyframes(number, situation, pairs, torch.from_numpy(others)[None])
        best = keyframes[0, int(weights.argmax())].numpy().astype(float)
        yaw, heading = anchor.yaws
        position = anchor.own[:3].astype(float)
        tcp = planar_pose(np.array((0.0, 0.0, yaw)))
        tcp[:3, 3] = position + tcp[:3, :3] @ best[TCP]
        along, aside, turn = self._network.stands(own, yaws)[0].numpy().astype(float)
        facing = planar_pose(np.array((0.0, 0.0, heading)))[:2, :2]
        base = position[:2] - facing @ (along + NOMINAL_DISTANCE, aside)
        finger = min(max(float(best[FINGER][0]), 0.0), self._robot.max_finger_position)
        q = np.array(self._robot.in_front) + best[ARM]
        return Keyframe(phase, np.append(base, heading + math.asin(min(max(turn, -1.0), 1.0))), tcp, q, finger)


def _batch(values: Array) -> torch.Tensor:
    """(1, k) of values (k,)."""
    return torch.tensor(values[None], dtype=torch.float32)


def _scenes(objects: ObservedObjects) -> Scenes:
    """A batch of one scene."""
    return Scenes(
        objects=torch.from_numpy(objects.rows)[None],
        is_there=torch.from_numpy(objects.is_there)[None],
        can_be_taken=torch.from_numpy(objects.can_be_taken)[None],
        is_target=(torch.arange(len(objects.rows)) == objects.target)[None],
    )
