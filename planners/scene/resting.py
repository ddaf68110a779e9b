"""How an object rests: which of its directions points up, on a support and once it is put down."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planners.scene.bodies import UPRIGHT_TILT, Body, HeldObject

__all__ = ["release_pitch", "up_axis"]

Array = NDArray[np.float64]

_DIGITS = 3
"""Pitches are rounded to so many decimals [rad]: what remains is closed by the gap under the object."""


def up_axis(body: Body) -> Array:
    """The direction (3,) in the world, fixed to the object, that points up once it rests as it lies or stands now."""
    z_axis, up = body.rotation[:, 2], np.array((0.0, 0.0, 1.0))
    if body.shape == "cylinder" and abs(z_axis[2]) < math.sqrt(0.5):
        level = up - z_axis[2] * z_axis
        return np.asarray(level / np.linalg.norm(level))
    axis = 2 if body.shape == "cylinder" else int(np.abs(body.rotation[2]).argmax())
    return np.asarray(body.rotation[:, axis] * np.sign(body.rotation[2, axis]))


def release_pitch(body: Body, held: HeldObject) -> float:
    """Pitch [rad] of the gripper at which a held object rests on a level plane: standing if it can be, else lying.

    It is the pitch of the grasp if the object stood when it was taken and has not slipped. Level where no pitch between
    level and straight down lets the object rest.
    """
    pitches = (round(math.atan2(-up[0], up[2]), _DIGITS) + 0.0 for up in _resting_axes(body, held.T_tcp_object[:3, :3]))
    return next((pitch for pitch in pitches if -UPRIGHT_TILT <= pitch <= math.pi / 2 + UPRIGHT_TILT), 0.0)


def _resting_axes(body: Body, rotation: Array) -> Iterator[Array]:
    """Directions (3,) in the TCP frame that may point up when the object rests, its own z axis before the others.

    Args:
        body: the object.
        rotation: R_tcp_object (3, 3).
    """
    axes = [rotation[:, 2], -rotation[:, 2]]
    if body.shape == "cylinder":
        lying = np.array((-rotation[2, 2], 0.0, rotation[0, 2]))
        axes += [lying, -lying]
    else:
        axes += [rotation[:, 0], -rotation[:, 0], rotation[:, 1], -rotation[:, 1]]
    for axis in axes:
        if abs(axis[1]) < math.sin(UPRIGHT_TILT) and math.hypot(axis[0], axis[2]) > math.sin(UPRIGHT_TILT):
            yield axis
