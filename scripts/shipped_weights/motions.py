"""Trains a motion policy from demonstrations or plans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import smooth_l1_loss

from assets import RobotSpec
from clutter_env.data.dataset import Dataset
from clutter_env.errors import DatasetError
from clutter_env.policies.experts import PLANNERS
from clutter_env.policies.motion.arm import ArmKinematics, rotations_about
from clutter_env.policies.motion.network import (
    CENTRE,
    FREE,
    FREE_JOINTS,
    FREE_UNITS,
    POSE,
    REACH,
    KeyframeNetwork,
    Prediction,
)
from clutter_env.policies.motion.shelf import demonstrated_row
from clutter_env.scene.keep_out import KeepOutRegion
from scripts.shipped_weights.descent import Report, descend
from scripts.shipped_weights.motion_examples import (
    KeyframeExamples,
    Motion,
    cut_at_corners,
    free_joints_of,
    is_driven,
    keyframe_examples,
)
from scripts.shipped_weights.planned import PlannedHighLevelPolicy

_BATCH, _LEARNING_RATE = 256, 2e-3
_TCP_WEIGHT = 10.0
"""Weight of the gripper's error, beside that of the joints."""
_SHIFT, _TURN, _TILT = 0.04, 0.15, 0.05
"""[m], [rad] about the vertical, [rad]: largest standard deviations by which contacts are moved for that error."""
_FREE = 0.7
"""Units of their features by which the free joints are changed, as a largest standard deviation."""
_JOINT, _LENGTH, _FINGER = 0.05, 0.02, 0.003
"""[rad] and [m] of base, torso and arm; [m] of a straight line; [m] of a finger: errors that count like one another."""
_MAX_GRADIENT = 100.0
"""Length to which gradients are clipped."""
_SPACING = 0.02
"""[m] between the points by which a demonstrated drive is compared with a rectangle, and between its possible sides."""
_POSITION, _ROTATION = 0.01, 0.05
"""[m] and [rad]: and those of the gripper."""


def high_level_of(dataset: Dataset) -> PlannedHighLevelPolicy:
    """The planner whose motions a dataset shows, as a high-level policy.

    Raises:
        DatasetError: its expert is no planner.
    """
    expert = str(dataset.identity["expert"])
    if expert not in PLANNERS:
        raise DatasetError(
            f"{dataset.directory} shows the expert {expert!r}; motions are learned from planners: {', '.join(PLANNERS)}"
        )
    choice = PLANNERS[expert]
    return PlannedHighLevelPolicy(choice.grasps, choice.canonical, choice.strategy)


def fit_motions(
    robot: RobotSpec, motions: Sequence[Motion], steps: int, seed: int = 0, report: Report = lambda *_: None
) -> KeyframeNetwork:
    """The network of a keyframe policy, fitted to demonstrated motions.

    Two losses are added. The first compares keyframes with those of the demonstrations. The second compares the poses
    of the gripper, by forward kinematics, in situations whose contact is shifted and turned at random, more or less:
    the gripper has to move with the contact, whatever the joints are. The free joints at the contact, torso and
    upper-arm roll, are changed at random too.

    Args:
        robot: that was demonstrated.
        motions: to imitate.
        steps: gradient steps.
        seed: random seed.
        report: called with the step and the loss every 500 steps.

    Raises:
        DatasetError: there are no motions.
    """
    # Where the base drives in under a shelf to one of the contacts, motions in the open are left out.
    shelf = [cut_at_corners(motion) for motion in motions if is_driven(motion)]
    examples = keyframe_examples(robot, shelf or motions, bool(shelf))
    torch.manual_seed(seed)
    limits = ([link.lower for link in robot.chain], [link.upper for link in robot.chain])
    network = KeyframeNetwork(robot.in_front, *limits, is_under_shelf=bool(shelf))
    kinematics = ArmKinematics(robot)
    network.seen[np.unique(examples.phase)] = True
    # Of inputs that never differ from 0, such as whether it is a box, nothing is learned: they are to change nothing.
    network.layers[0].weight.data[:, (examples.features == 0).all(axis=0)] = 0.0
    data = _Tensors(examples, kinematics)

    def total_loss(_: int) -> torch.Tensor:
        chosen = torch.multinomial(data.weights, _BATCH, replacement=True)
        near = torch.multinomial(data.weights * data.at_contact, _BATCH, replacement=True)
        moved, R, p, free = data.moved(near)
        prediction = network(torch.cat((data.features[chosen], moved)))
        loss = data.keyframe_loss(Prediction(*(part[:_BATCH] for part in prediction)), chosen)
        predicted_p, predicted_R = kinematics.tcp(prediction.q[_BATCH:])
        loss = loss + _TCP_WEIGHT * smooth_l1_loss(predicted_p / _POSITION, p / _POSITION)
        loss = loss + _TCP_WEIGHT * smooth_l1_loss(predicted_R / _ROTATION, R / _ROTATION)
        loss = loss + smooth_l1_loss(prediction.offset[_BATCH:] / _LENGTH, data.offset[near] / _LENGTH)
        loss = loss + smooth_l1_loss(prediction.q[_BATCH:, list(FREE_JOINTS)] / _JOINT, free / _JOINT)
        return loss + _TCP_WEIGHT * (prediction.excess / _JOINT).mean()

    descend(torch.optim.Adam(network.parameters(), lr=_LEARNING_RATE), steps, total_loss, report, _MAX_GRADIENT)
    if shelf:
        reached = [(motion.contact, free) for motion in shelf if (free := free_joints_of(robot, motion)) is not None]
        network.shown = torch.tensor(np.array([demonstrated_row(*one) for one in reached]), dtype=torch.float32)
    drives = [
        motion.seen.base[steps.start : steps.stop + 1, :2]
        for motion in motions
        for phase, steps in motion.runs()
        if phase == "drive"
    ]
    region = keep_out_of_drives(drives)
    network.closed = torch.from_numpy(np.stack((region.low, region.high)))
    return network


class _Tensors:
    """The examples as tensors; phases are drawn equally often."""

    def __init__(self, examples: KeyframeExamples, kinematics: ArmKinematics) -> None:
        self.features, self._base, self._q, self._finger, self._length = (
            torch.tensor(getattr(examples, name), dtype=torch.float32)
            for name in ("features", "base", "q", "finger", "length")
        )
        self.at_contact = torch.tensor(examples.at_contact, dtype=torch.float32)
        counts = np.bincount(examples.phase)
        self.weights = torch.tensor(1.0 / counts[examples.phase], dtype=torch.float32)
        self.position, self.rotation = kinematics.tcp(self._q)
        self.offset = _offsets(self.features, self.position)

    def keyframe_loss(self, predicted: Prediction, chosen: torch.Tensor) -> torch.Tensor:
        """The loss of base, arm, finger and the line's length."""
        pairs = (
            (predicted.base, self._base, _JOINT),
            (predicted.q, self._q, _JOINT),
            (predicted.finger, self._finger, _FINGER),
            (predicted.length, self._length, _LENGTH),
        )
        losses = [smooth_l1_loss(one / size, other[chosen] / size) for one, other, size in pairs]
        return torch.stack(losses).sum()

    def moved(self, chosen: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Features with contact and free joints changed; orientations, positions and free joints (k, 2) as they change.

        The free joints change everywhere as they do at the contact.
        """
        features = self.features[chosen].clone()
        amount = torch.rand(len(chosen))
        shift = _SHIFT * amount[:, None] * torch.randn(len(chosen), 3)
        turn = torch.eye(3).expand(len(chosen), 3, 3)
        for axis, size in enumerate((_TILT, _TILT, _TURN)):
            turn = turn @ rotations_about(axis, size * amount * torch.randn(len(chosen)))
        contact = _positions(features)
        features[:, POSE.start : POSE.start + 3] += shift / REACH
        for first in (POSE.start + 3, POSE.start + 6):
            axis = features[:, first : first + 3]
            features[:, first : first + 3] = (turn @ axis[..., None])[..., 0]
        position = contact + shift + (turn @ (self.position[chosen] - contact)[..., None])[..., 0]
        change = _FREE * torch.randn(len(chosen), 2) * torch.rand(len(chosen), 1) * torch.tensor(FREE_UNITS)
        features[:, FREE] += change / torch.tensor(FREE_UNITS)
        return features, turn @ self.rotation[chosen], position, self._q[chosen][:, list(FREE_JOINTS)] + change


def _positions(features: torch.Tensor) -> torch.Tensor:
    """Contacts (k, 3) [m] in the base's frame."""
    return REACH * features[:, POSE.start : POSE.start + 3] + torch.tensor(CENTRE, dtype=torch.float32)


def _offsets(features: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
    """(k, 3) [m] from the contacts to positions (k, 3) in the base's frame, in the contacts' frames."""
    x, y = features[:, POSE.start + 3 : POSE.start + 6], features[:, POSE.start + 6 : POSE.stop]
    axes = torch.stack((x, y, torch.linalg.cross(x, y)), dim=1)
    return (axes @ (position - _positions(features))[..., None])[..., 0]


def keep_out_of_drives(drives: Iterable[NDArray[np.float64]]) -> KeepOutRegion:
    """The largest rectangle about the middle of the table that none of these drives (n, 2) [m] enters.

    It is empty without drives. Sides beyond which nothing drives are infinitely far away; areas are measured as far as
    the drives reach.
    """
    best, largest = KeepOutRegion(np.zeros(2), np.zeros(2)), 0.0
    paths = [_filled(drive) for drive in drives]
    if not paths:
        return best
    points = np.concatenate(paths)
    nearest, farthest = np.minimum(points.min(axis=0), 0.0), np.maximum(points.max(axis=0), 0.0)
    y = _SPACING * np.unique(np.round(points[:, 1] / _SPACING))
    # Infinity comes first: of rectangles that are equally large the one without a side there is taken.
    lows, highs = np.append(-np.inf, y[y < 0]), np.append(np.inf, y[y > 0])
    for low, high in product(lows, highs):
        x = points[(points[:, 1] > low) & (points[:, 1] < high), 0]
        left, right = x[x < 0].max(initial=-np.inf), x[x >= 0].min(initial=np.inf)
        found = KeepOutRegion(np.array((left, low)), np.array((right, high)))
        area = float(np.prod(np.minimum(found.high, farthest) - np.maximum(found.low, nearest)))
        if area > largest:
            best, largest = found, area
    return best


def _filled(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) on a path at most `_SPACING` from one another."""
    counts = np.ceil(np.linalg.norm(np.diff(path, axis=0), axis=1) / _SPACING).astype(int)
    parts = [np.linspace(one, other, count, False) for one, other, count in zip(path, path[1:], counts, strict=False)]
    return np.concatenate((*parts, path[-1:]))
