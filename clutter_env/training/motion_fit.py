"""Fits the keyframe network: to the keyframes, and to where they bring the gripper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import smooth_l1_loss

from assets import RobotSpec
from clutter_env.policies.motion.arm import ArmKinematics, rotations_about
from clutter_env.policies.motion.keep_out import keep_out_of_drives
from clutter_env.policies.motion.network import KeyframeNetwork, Prediction
from clutter_env.policies.motion.network_input import CENTRE, FREE, FREE_JOINTS, FREE_UNITS, POSE, REACH
from clutter_env.training.descent import DescentConfig, Report, descend
from clutter_env.training.motion_demonstrations import Motion
from clutter_env.training.motion_examples import KeyframeExamples, demonstrated_free_joints, keyframe_examples


@dataclass(frozen=True)
class KeyframeFitConfig(DescentConfig):
    """Settings of the regression, and these.

    Attributes:
        tcp_weight: of the error of the gripper, beside that of the joints.
        shift, turn, tilt: [m], [rad] about the vertical, [rad]: largest standard deviations by which contacts are
            moved for the loss of the gripper.
        free: by how many units of their features the free joints are changed at most, as a standard deviation.
    """

    learning_rate: float = 2e-3
    width: int = 128
    tcp_weight: float = 10.0
    shift: float = 0.04
    turn: float = 0.15
    tilt: float = 0.05
    free: float = 0.7


_JOINT, _LENGTH, _FINGER = 0.05, 0.02, 0.003
"""[rad] and [m] of base, torso and arm; [m] of a straight line; [m] of a finger: errors that count like one another."""
_MAX_GRADIENT = 100.0
"""Length to which gradients are clipped."""
_POSITION, _ROTATION = 0.01, 0.05
"""[m] and [rad]: and those of the gripper."""


def fit_motions(
    robot: RobotSpec, motions: Sequence[Motion], steps: int, seed: int = 0, report: Report = lambda *_: None
) -> KeyframeNetwork:
    """The network of a keyframe policy, fitted to demonstrated motions.

    Args:
        robot: that was demonstrated.
        motions: to imitate.
        steps: gradient steps.
        seed: random seed.
        report: called with the step and the loss every 500 steps.

    Raises:
        DatasetError: there are no motions.
    """
    config = KeyframeFitConfig(steps=steps, seed=seed)
    network = fit_keyframes(robot, keyframe_examples(robot, motions), config, report)
    if network.is_under_shelf:
        network.set_demonstrated(demonstrated_free_joints(robot, motions))
    drives = [
        motion.seen.base[steps.start : steps.stop + 1, :2]
        for motion in motions
        for phase, steps in motion.runs()
        if phase == "drive"
    ]
    network.set_keep_out(keep_out_of_drives(drives))
    return network


def fit_keyframes(
    robot: RobotSpec,
    examples: KeyframeExamples,
    config: KeyframeFitConfig = KeyframeFitConfig(),
    report: Report = lambda *_: None,
) -> KeyframeNetwork:
    """A network fitted to examples.

    Two losses are added. The first compares keyframes with those of the demonstrations. The second compares the poses
    of the gripper, by forward kinematics, in situations whose contact is shifted and turned at random, more or less:
    the gripper has to move with the contact, whatever the joints are. The free joints at the contact, torso and
    upper-arm roll, are changed at random too.

    Args:
        robot: whose kinematics.
        examples: to imitate.
        config: settings.
        report: called with the step and the loss every 500 steps.
    """
    torch.manual_seed(config.seed)
    limits = ([link.lower for link in robot.chain], [link.upper for link in robot.chain])
    network = KeyframeNetwork(robot.home, *limits, config.width, examples.is_under_shelf)
    kinematics = ArmKinematics(robot)
    network.seen[np.unique(examples.phase)] = True
    data = _Tensors(examples, kinematics)

    def total_loss(_: int) -> torch.Tensor:
        chosen = torch.multinomial(data.weights, config.batch, replacement=True)
        near = torch.multinomial(data.weights * data.at_contact, config.batch, replacement=True)
        moved, R, p, free = data.moved(near, config)
        prediction = network(torch.cat((data.features[chosen], moved)))
        loss = data.keyframe_loss(Prediction(*(part[: config.batch] for part in prediction)), chosen)
        loss = loss + config.tcp_weight * _tcp_loss(*kinematics.tcp(prediction.q[config.batch :]), p, R)
        loss = loss + smooth_l1_loss(prediction.offset[config.batch :] / _LENGTH, data.offset[near] / _LENGTH)
        predicted = prediction.q[config.batch :, list(FREE_JOINTS)]
        loss = loss + smooth_l1_loss(predicted / _JOINT, free / _JOINT)
        return loss + config.tcp_weight * (prediction.excess / _JOINT).mean()

    optimiser = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    descend(optimiser, config.steps, total_loss, report, _MAX_GRADIENT)
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

    def moved(self, chosen: torch.Tensor, config: KeyframeFitConfig) -> tuple[torch.Tensor, ...]:
        """Features with contact and free joints changed; orientations, positions and free joints (k, 2) as they change.

        The free joints change everywhere as they do at the contact.
        """
        features = self.features[chosen].clone()
        amount = torch.rand(len(chosen))
        shift = config.shift * amount[:, None] * torch.randn(len(chosen), 3)
        turn = torch.eye(3).expand(len(chosen), 3, 3)
        for axis, size in enumerate((config.tilt, config.tilt, config.turn)):
            turn = turn @ rotations_about(axis, size * amount * torch.randn(len(chosen)))
        contact = _positions(features)
        features[:, POSE.start : POSE.start + 3] += shift / REACH
        for first in (POSE.start + 3, POSE.start + 6):
            axis = features[:, first : first + 3]
            features[:, first : first + 3] = (turn @ axis[..., None])[..., 0]
        position = contact + shift + (turn @ (self.position[chosen] - contact)[..., None])[..., 0]
        change = config.free * torch.randn(len(chosen), 2) * torch.rand(len(chosen), 1) * torch.tensor(FREE_UNITS)
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


def _tcp_loss(p: torch.Tensor, R: torch.Tensor, wanted_p: torch.Tensor, wanted_R: torch.Tensor) -> torch.Tensor:
    return smooth_l1_loss(p / _POSITION, wanted_p / _POSITION) + smooth_l1_loss(R / _ROTATION, wanted_R / _ROTATION)
