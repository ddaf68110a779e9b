"""The network of the keyframe policy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from clutter_env.policies.motion.keep_out import KeepOutRegion
from clutter_env.policies.motion.network_input import NUM_FEATURES, NUM_PHASES, phase_index
from clutter_env.policies.weights import WeightsInfo, load_weights

_SIZES = (3, 8, 3, 1, 1)
"""Numbers in each part of a `Prediction`."""
_FINGER, _LENGTH = 0.01, 0.05
"""[m] of finger position, and of offset and line length, that are one unit of an output."""


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
        self.layers = nn.Sequential(
            nn.Linear(NUM_FEATURES, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, sum(_SIZES)),
        )

    def forward(self, features: torch.Tensor) -> Prediction:
        """Keyframes of network inputs (k, f)."""
        base, q, offset, finger, length = torch.split(self.layers(features), _SIZES, dim=1)
        wanted = self.home + q
        q = torch.clamp(wanted, self.lower, self.upper)
        excess = torch.abs(wanted - q).sum(1)
        return Prediction(base, q, _LENGTH * offset, _FINGER * finger[:, 0], _LENGTH * length[:, 0], excess)

    def predict(self, features: NDArray[np.float64]) -> Prediction:
        """Keyframes of network inputs (k, f), without gradients."""
        with torch.no_grad():
            prediction: Prediction = self(torch.from_numpy(features.astype(np.float32)))
        return prediction

    def has_seen(self, skill: str, phase: str) -> bool:
        """Whether the demonstrations show a phase of a skill."""
        number = phase_index(skill, phase)
        return number is not None and bool(self.seen[number])

    @property
    def keep_out(self) -> KeepOutRegion:
        """The region that the base keeps out of."""
        return KeepOutRegion(*self.closed.numpy())

    def set_keep_out(self, region: KeepOutRegion) -> None:
        """Set the region that the base keeps out of."""
        self.closed = torch.from_numpy(np.stack((region.low, region.high)))

    def set_demonstrated(self, shown: NDArray[np.float64]) -> None:
        """Set contacts and free joints (m, 7) demonstrated under a shelf."""
        self.shown = torch.tensor(shown, dtype=torch.float32)

    @classmethod
    def load(cls, path: Path) -> tuple[KeyframeNetwork, WeightsInfo]:
        """The network with the weights of a file, and what they are for; raises `PolicyError`, see `load_weights`."""
        weights, info = load_weights(path, "motions")
        home, lower, upper = (weights[name].tolist() for name in ("home", "lower", "upper"))
        network = cls(home, lower, upper, len(weights["layers.0.bias"]), is_under_shelf="shown" in weights)
        if network.is_under_shelf:
            network.shown = weights["shown"]
        network.load_state_dict(weights)
        return network, info
