"""The arm between two frames of a MuJoCo model, and the pairs of its bodies that may collide."""

from __future__ import annotations

from pathlib import Path

import mujoco

from assets.arm_reading import ModelArm, body_number, load_model, read_arm
from assets.robots import InvalidRobot
from irm.arm.reading.collision_pairs import self_collision_pairs
from irm.errors import ChainError

__all__ = ["read_model"]


def read_model(
    model: mujoco.MjModel | str | Path, base: str, tip: str, approach: str
) -> tuple[ModelArm, tuple[tuple[str, str], ...]]:
    """The arm from `base` to `tip`, and pairs of bodies by their names; see `ArmChain.from_mjcf`.

    Raises:
        ChainError: there is no such arm.
    """
    try:
        arm = read_arm(model, base, tip, approach)
        loaded = model if isinstance(model, mujoco.MjModel) else load_model(Path(model))
        return arm, self_collision_pairs(loaded, body_number(loaded, base))
    except InvalidRobot as problem:
        raise ChainError(str(problem)) from None
