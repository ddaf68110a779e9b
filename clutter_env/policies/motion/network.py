"""The network of the keyframe policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from clutter_env.policies.parsed_observation import ParsedObservation, planar_pose
from clutter_env.policies.weights import WeightsInfo, damage_refused, load_weights
from clutter_env.scene.keep_out import KeepOutRegion
from planners import Contact

_SIZES = (3, 8, 3, 1, 1)
"""Numbers in each part of a `Prediction`."""
Q = slice(3, 11)
"""Numbers of torso and arm among them."""
_FINGER, _LENGTH = 0.01, 0.05
"""[m] of finger position, and of offset and line length, that are one unit of an output."""
_UNITS = np.repeat((1.0, 1.0, _LENGTH, _FINGER, _LENGTH), _SIZES).astype(np.float32)
Array = NDArray[np.float64]
SKILLS = ("pick", "place")
PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pick": ("drive", "ready", "transit", "approach", "close", "lift", "retreat"),
        "place": ("drive", "transit", "lower", "open", "rise", "retreat"),
    }
)
"""Phases of a motion by skill, in their order, as the planner's trajectories name them."""
DRIVEN = ("enter", "reach", "back", "leave")
"""Straight drives of the base under a shelf and out again with the arm rigid. They lead to a pose just before the
gripper surrounds the object, along the gripper to the contact, and back."""
SHELF_PHASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pick": ("drive", "ready", "transit", "enter", "reach", "close", "lift", "back", "leave", "retreat"),
        "place": ("drive", "transit", "enter", "reach", "lower", "open", "back", "leave", "retreat"),
    }
)
"""The same under a shelf."""
ELSEWHERE = ("transit", *DRIVEN)
"""Phases under a shelf whose arm configuration is one of a straight line at the contact."""
TOWARDS, AWAY = ("approach", "lower"), ("lift", "rise")
LINES = (*TOWARDS, *AWAY)
"""Straight lines of the gripper to a contact, and away from it."""
FINGERS = ("ready", "close", "open")
"""Only the fingers move."""
_LEARNED = tuple((skill, phase) for skill in SKILLS for phase in PHASES[skill])
_NUMBERS = {key: number for number, key in enumerate(_LEARNED)}
NUM_PHASES = len(_LEARNED)
CENTRE = np.array((0.75, 0.0, 0.85))
"""[m] in the base's frame: near most contacts, so that features are about zero."""
REACH = 0.15
"""[m] of a contact's position that is one unit of a feature."""
_NEAR = (10.0, 50.0)
"""[1/m] of the squashed copies of the distance on a line."""
POSE = slice(NUM_PHASES, NUM_PHASES + 9)
"""Columns of the pose of the contact: position, and the gripper's x and y axes."""
_SIZE_UNITS, _SIZE_SHIFT = np.array((20.0, 20.0, 20.0, 1.0)), np.array((1.0, 1.0, 1.0, 0.0))
NUM_FEATURES = POSE.stop + 4 + 1 + len(_NEAR) + 2
FREE = slice(NUM_FEATURES - 2, NUM_FEATURES)
"""Columns of the free joints at the contact."""
FREE_JOINTS = (0, 3)
"""Numbers of the joints, torso lift and upper-arm roll, that are free where the gripper is given."""
FREE_UNITS = (0.1, 0.5)
"""[m], [rad] of the free joints that are one unit of a feature."""


class Prediction(NamedTuple):
    """Keyframes of k situations.

    Attributes:
        base: (k, 3) where the base is to stand, in its frame at the contact: x, y [m], yaw [rad].
        q: (k, 8) torso [m] and arm [rad].
        offset: (k, 3) [m] of the TCP from the contact, in the contact's frame.
        finger: (k,) [m] position of one finger.
        length: (k,) [m] of the straight line.
        excess: (k,) by how much the joints were clipped to their limits, [m] and [rad] together.
    """

    base: torch.Tensor
    q: torch.Tensor
    offset: torch.Tensor
    finger: torch.Tensor
    length: torch.Tensor
    excess: torch.Tensor


class KeyframeNetwork(nn.Module):
    """From the network input of a situation to the keyframe that it leads to.

    Attributes:
        home: (8,) configuration that the output is added to.
        lower, upper: (8,) limits of the joints, which the output keeps.
        seen: (p,) flags of the phases that the demonstrations show.
        is_under_shelf: whether it drives in to contacts under a shelf, and out again.
        shown: (m, 7) contacts and free joints demonstrated under a shelf, see `demonstrated_free_joints`.
        closed: (2, 2) lowest and highest x and y [m] of the region that no demonstrated drive enters.
    """

    home: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    seen: torch.Tensor
    closed: torch.Tensor
    shown: torch.Tensor

    def __init__(
        self,
        home: Sequence[float],
        lower: Sequence[float],
        upper: Sequence[float],
        width: int = 128,
        is_under_shelf: bool = False,
    ) -> None:
        super().__init__()
        self.is_under_shelf = is_under_shelf
        for name, values in (("home", home), ("lower", lower), ("upper", upper)):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))
        self.register_buffer("seen", torch.zeros(NUM_PHASES, dtype=torch.bool))
        if is_under_shelf:
            self.register_buffer("shown", torch.zeros((0, 7)))
        self.register_buffer("closed", torch.zeros((2, 2), dtype=torch.float64))
        widths = pairwise((NUM_FEATURES, width, width, width, sum(_SIZES)))
        layers = [layer for ends in widths for layer in (nn.Linear(*ends), nn.SiLU())]
        self.layers = nn.Sequential(*layers[:-1])

    def forward(self, features: torch.Tensor) -> Prediction:
        """Keyframes of network inputs (k, f)."""
        base, q, offset, finger, length = torch.split(self.layers(features), _SIZES, dim=1)
        wanted = self.home + q
        q = torch.clamp(wanted, self.lower, self.upper)
        excess = torch.abs(wanted - q).sum(1)
        return Prediction(base, q, _LENGTH * offset, _FINGER * finger[:, 0], _LENGTH * length[:, 0], excess)

    def has_seen(self, skill: str, phase: str) -> bool:
        """Whether the demonstrations show a phase of a skill."""
        number = phase_index(skill, phase)
        return number is not None and bool(self.seen[number])

    @property
    def keep_out(self) -> KeepOutRegion:
        """The region that the base keeps out of."""
        return KeepOutRegion(*self.closed.numpy())

    @classmethod
    def load(cls, path: Path) -> tuple[KeyframeNetwork, WeightsInfo]:
        """Load a network and its `WeightsInfo` from a file. Raise `PolicyError`, see `load_weights`."""
        weights, info = load_weights(path, "motions")
        with damage_refused(path):
            home, lower, upper = (weights[name].tolist() for name in ("home", "lower", "upper"))
            network = cls(home, lower, upper, len(weights["layers.0.bias"]), is_under_shelf="shown" in weights)
            if network.is_under_shelf:
                network.shown = weights["shown"]
            network.load_state_dict(weights)
        return network, info


class KeyframePredictor:
    """A network's keyframes without modules and gradients, which take most of the time of a single one."""

    def __init__(self, network: KeyframeNetwork) -> None:
        layers = [layer for layer in network.layers if isinstance(layer, nn.Linear)]
        self._layers = [(layer.weight.detach(), layer.bias.detach()) for layer in layers]
        self._home, self._lower, self._upper = network.home.numpy(), network.lower.numpy(), network.upper.numpy()

    def predict(self, skill: str, phase: str, base_contact: Array, sizes: Array, distance: Any, free: Array) -> Array:
        """Keyframes (k, 16) in a phase of a skill, see `network_input`. The columns are those of `Prediction` from base
        to length."""
        features = network_input(phase_index(skill, phase), base_contact, sizes, distance, free)
        hidden = torch.from_numpy(features.astype(np.float32))
        for weight, bias in self._layers[:-1]:
            hidden = functional.silu(functional.linear(hidden, weight, bias))
        output = functional.linear(hidden, *self._layers[-1]).numpy() * _UNITS
        output[:, Q] = np.minimum(np.maximum(output[:, Q] + self._home, self._lower), self._upper)
        return np.asarray(output, float)


def phase_index(skill: str, phase: str) -> int | None:
    """Index of a phase of a skill among all phases, None for a phase that is not learned."""
    return _NUMBERS.get((skill, phase))


def network_input(
    phase: int | None, base_contact: Array, sizes: Array, distance: Array | float, free: Array
) -> NDArray[np.float64]:
    """Features (k, NUM_FEATURES) of k situations. Arguments with one row are repeated.

    Args:
        phase: index from `phase_index`.
        base_contact: (k, 4, 4) TCP pose at the contact, in the base's frame.
        sizes: (k, 4) of the object, as `ParsedObservation.sizes`.
        distance: (k,) [m] from the contact on a straight line, 0 in other phases.
        free: (k, 2) torso [m] and upper-arm roll [rad] relative to home: at the contact, or under a shelf at the
            keyframe itself.
    """
    assert phase is not None
    features = np.zeros((len(base_contact), NUM_FEATURES))
    features[:, phase] = 1.0
    position = (base_contact[:, :3, 3] - CENTRE) / REACH
    features[:, POSE] = np.concatenate((position, base_contact[:, :3, 0], base_contact[:, :3, 1]), axis=1)
    features[:, POSE.stop : POSE.stop + 4] = sizes * _SIZE_UNITS - _SIZE_SHIFT
    line = np.stack((distance / REACH, *(np.tanh(scale * distance) for scale in _NEAR)), axis=-1)
    features[:, POSE.stop + 4 : FREE.start] = line
    features[:, FREE] = free / FREE_UNITS
    return features


def contact_in_base(contact_tcp: Array, base: Array) -> Array:
    """(..., 4, 4) TCP pose of a contact (4, 4) in the frame of bases (..., 3)."""
    return np.asarray(np.linalg.inv(planar_pose(np.asarray(base))) @ contact_tcp)


def line_distance(seen: ParsedObservation, contact: Contact) -> Array:
    """(...) [m] from the measured TCP to a contact."""
    return np.asarray(np.linalg.norm(seen.tcp[..., :3, 3] - contact.tcp[:3, 3], axis=-1))
