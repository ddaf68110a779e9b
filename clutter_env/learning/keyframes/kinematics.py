"""Forward kinematics of torso and arm in torch, so that a loss can weigh the error of the gripper."""

from __future__ import annotations

import torch

from assets.robots import RobotSpec

__all__ = ["ArmKinematics", "rotations_about"]

_AXES = "xyz"


class ArmKinematics:
    """Where the gripper is in the base's frame, for a batch of arm configurations."""

    def __init__(self, robot: RobotSpec) -> None:
        self._chain = tuple(
            (torch.tensor(link.offset, dtype=torch.float32), _AXES.index(link.axis), link.prismatic)
            for link in robot.chain
        )
        self._tip = torch.tensor(robot.tcp_offset, dtype=torch.float32)

    def tcp(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Positions (k, 3) [m] and orientations (k, 3, 3) of the TCP at configurations (k, 8)."""
        origins, R = self.frames(q)
        return origins[:, -1], R

    def frames(self, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Origins (k, 9, 3) [m] of all joints and of the TCP, and orientations (k, 3, 3) of the TCP."""
        R = torch.eye(3).expand(len(q), 3, 3)
        p, origins = torch.zeros(len(q), 3), []
        for joint, (offset, axis, prismatic) in enumerate(self._chain):
            p = p + R @ offset
            if prismatic:
                p = p + R[:, :, axis] * q[:, joint, None]
            else:
                R = R @ rotations_about(axis, q[:, joint])
            origins.append(p)
        return torch.stack((*origins, p + R @ self._tip), dim=1), R


def rotations_about(axis: int, angle: torch.Tensor) -> torch.Tensor:
    """Rotations (k, 3, 3) by angles (k,) about a coordinate axis."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    zero, one = torch.zeros_like(angle), torch.ones_like(angle)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    entries = [[zero] * 3 for _ in range(3)]
    entries[axis][axis] = one
    entries[u][u], entries[u][v], entries[v][u], entries[v][v] = cosine, -sine, sine, cosine
    return torch.stack([torch.stack(row, dim=-1) for row in entries], dim=-2)
