"""How many objects must be cleared for another one, from what is in the way of each grasp with some probability."""

from __future__ import annotations

import torch

__all__ = ["ROUNDS", "clearances_without"]

NEVER = 6.0
"""Clearances that stand for what cannot be cleared."""
ROUNDS = 4
"""How many objects in a row are followed: one in the way of another one that is in the way of a third."""
_SMOOTH = 0.1
"""Clearances by which the minimum over grasps is smoothed, so that more than one of them learns."""


def clearances_without(blocks: torch.Tensor, unreachable: torch.Tensor, is_target: torch.Tensor) -> torch.Tensor:
    """Clearances needed before each object can be grasped: in the scene without any one object, and in the whole one.

    The clearances for a grasp are the sum over what is in its way of one and of the clearances for that; those for an
    object are the least of its grasps. An object in the way of two others counts twice. The target is never cleared.

    Args:
        blocks: (k, n, yaws, n) probability that the last object is in the way of the first one's grasp.
        unreachable: (k, n, yaws) probability that the arm does not reach the grasp.
        is_target: (k, n) 1 for the target, 0 for the others.

    Returns:
        (k, n, n + 1) for the first object without the second; the last column without none.
    """
    k, n, yaws, _ = blocks.shape
    keeps = torch.cat((1 - torch.eye(n), torch.ones(n, 1)), dim=1).to(blocks)
    flat, never = blocks.reshape(k, n * yaws, n), (NEVER * unreachable)[..., None]
    stays = is_target[..., None]
    needed = torch.zeros(k, n, n + 1).to(blocks)
    for _ in range(ROUNDS):
        price = keeps * (stays * NEVER + (1 - stays) * (1 + needed))
        of_grasps = (flat @ price).reshape(k, n, yaws, n + 1) + never
        least = -_SMOOTH * torch.logsumexp(-of_grasps / _SMOOTH, dim=2)
        needed = least.clamp(min=0, max=NEVER)
    return needed
