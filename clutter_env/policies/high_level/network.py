"""The network of the high-level policy: whether each candidate can be reached, and which objects stand in its way.

Every object beside a candidate is described in the frame of the gripper, and judged by the same small network. So the
answer does not depend on the order or the number of the objects, and what is learned at one place holds at others.
A candidate is free if it is reached and no object is in its way.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn

_NEAR = (5.0, 20.0)
"""[1/m] of the squashed copies of offsets."""
_TABLE_HEIGHT = 0.75
_MIDDLE_RADIUS, _MIDDLE_HEIGHT = 0.03, 0.16
"""[m] of usual objects, subtracted so that features are about zero."""
_OWN, _OTHER = 18, 18


class CandidateBatch(NamedTuple):
    """m candidates next to up to n objects. Columns as in `CandidateExamples`.

    Attributes:
        own: (m, 5) the object to pick or place, at its pose in the candidate.
        tcp: (m, 5) x, y, z [m], yaw and pitch [rad].
        base: (m, 3) x [m], y [m], yaw [rad].
        others: (m, n, 5) the other objects.
        is_present: (m, n) whether each is present.
    """

    own: torch.Tensor
    tcp: torch.Tensor
    base: torch.Tensor
    others: torch.Tensor
    is_present: torch.Tensor


class CandidateNetwork(nn.Module):
    """Predicts which objects are in the way of candidates, and apart from that whether these are reached at all."""

    def __init__(self, width: int = 96) -> None:
        super().__init__()
        self.reach = nn.Sequential(
            nn.Linear(_OWN, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, 1)
        )
        self.contact = nn.Linear(_OWN, width)
        self.other = nn.Linear(_OTHER, width)
        self.blocks = nn.Sequential(nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, 1))

    def forward(self, batch: CandidateBatch) -> torch.Tensor:
        """Logits (m, n) that an object is in the way of a candidate, very negative for absent objects."""
        hidden = self.contact(_own_features(batch))[:, None] + self.other(_other_features(batch))
        blocks = self.blocks(hidden)[..., 0]
        return torch.where(batch.is_present, blocks, blocks.new_tensor(-30.0))

    def reach_logits(self, batch: CandidateBatch) -> torch.Tensor:
        """(m,) logits that a candidate is reached, for which the other objects do not matter."""
        logits: torch.Tensor = self.reach(_own_features(batch))[:, 0]
        return logits


def _own_features(batch: CandidateBatch) -> torch.Tensor:
    """(m, 18) The candidate: its place on the table, the gripper against the base, the object's size."""
    x, y, z, yaw, pitch = batch.tcp.unbind(1)
    heading = batch.base[:, 2]
    turn = torch.remainder(yaw - heading + torch.pi, 2 * torch.pi) - torch.pi
    standoff = (batch.tcp[:, :2] - batch.base[:, :2]).norm(dim=1)
    radius, height = batch.own[:, 3], batch.own[:, 4]
    features = (
        3 * x,
        2 * y,
        10 * (z - _TABLE_HEIGHT),
        torch.cos(heading),
        2 * torch.sin(heading),
        torch.cos(yaw),
        torch.sin(yaw),
        torch.cos(turn),
        2 * torch.sin(turn),
        torch.sin(2 * turn),
        torch.cos(pitch),
        torch.sin(pitch),
        torch.sin(2 * pitch),
        10 * (standoff - 0.75),
        100 * (radius - _MIDDLE_RADIUS),
        20 * (height - _MIDDLE_HEIGHT),
        5 * (batch.base[:, 0] + 0.7),
        2 * batch.base[:, 1],
    )
    return torch.stack(features, dim=1)


def _other_features(batch: CandidateBatch) -> torch.Tensor:
    """(m, n, 18) The other objects in the frame of the gripper and in that of the base, and their sizes."""
    offset = batch.others[..., :2] - batch.tcp[:, None, :2]
    ahead, aside = turned(offset, batch.tcp[:, 3])
    before, beside = turned(offset, batch.base[:, 2])
    radius, height = batch.others[..., 3], batch.others[..., 4]
    top = batch.others[..., 2] + height - batch.tcp[:, None, 2]
    gap = offset.norm(dim=-1) - radius - batch.own[:, None, 3]
    features = [3 * ahead, 3 * aside, 3 * before, 3 * beside]
    for scale in _NEAR:
        features += [torch.tanh(scale * value) for value in (ahead, aside, before, beside)]
    features += [torch.tanh(40 * aside), torch.tanh(60 * gap), 3 * gap]
    features += [100 * (radius - _MIDDLE_RADIUS), 20 * (height - _MIDDLE_HEIGHT), 20 * top - 2]
    return torch.stack(features, dim=-1)


def turned(offset: torch.Tensor, yaw: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Offsets (..., n, 2) ahead and to the left of headings (...)."""
    cosine, sine = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    x, y = offset.unbind(-1)
    return cosine * x + sine * y, cosine * y - sine * x
