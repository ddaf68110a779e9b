"""Forward kinematics of torso and arm in torch, so that a loss can weigh the error of the gripper."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from assets import RobotSpec
from irm import PRISMATIC, frames_of

__all__ = ["ArmKinematics", "rotations_about"]


class ArmKinematics:
    """Where the gripper is in the base's frame, for a batch of arm configurations."""

    def __init__(self, robot: RobotSpec) -> None:
        offsets, axes, tip = frames_of(robot)
        self._chain = tuple(
            (*_place(place), int(axis) % PRISMATIC, bool(axis >= PRISMATIC))
            for place, axis in zip(offsets, axes, strict=True)
        )
        self._tip, self._tip_turn = _place(tip)

    def tcp(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Positions (k, 3) [m] and orientations (k, 3, 3) of the TCP at configurations (k, 8)."""
        origins, R = self.frames(q)
        return origins[:, -1], R

    def frames(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Origins (k, 9, 3) [m] of all joints and of the TCP, and orientations (k, 3, 3) of the TCP."""
        origins, rotations = self.links(q)
        return origins, rotations[:, -1]

    def links(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Origins (k, 9, 3) [m] and orientations (k, 9, 3, 3) of the links behind all joints, and of the TCP."""
        R = torch.eye(3).expand(len(q), 3, 3)
        p, origins, rotations = torch.zeros(len(q), 3), [], []
        for joint, (offset, turn, axis, prismatic) in enumerate(self._chain):
            p = p + R @ offset
            R = R if turn is None else R @ turn
            if prismatic:
                p = p + R[:, :, axis] * q[:, joint, None]
            else:
                R = R @ rotations_about(axis, q[:, joint])
            origins.append(p)
            rotations.append(R)
        p = p + R @ self._tip
        R = R if self._tip_turn is None else R @ self._tip_turn
        return torch.stack((*origins, p), dim=1), torch.stack((*rotations, R), dim=1)


def _place(place: NDArray[np.float64]) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Offset (3,) and orientation (3, 3), None for none, of a row of `irm.arm.frames.frames_of`."""
    numbers = torch.tensor(place, dtype=torch.float32)
    return numbers[:3], numbers[3:].reshape(3, 3) if len(place) > 3 else None


def rotations_about(axis: int, angle: torch.Tensor) -> torch.Tensor:
    """Rotations (k, 3, 3) by angles (k,) about a coordinate axis."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    entries = [[zero] * 3 for _ in range(3)]
    entries[axis][axis] = one
    entries[u][u], entries[u][v], entries[v][u], entries[v][v] = cosine, -sine, sine, cosine
    return torch.stack([torch.stack(row, dim=-1) for row in entries], dim=-2)
