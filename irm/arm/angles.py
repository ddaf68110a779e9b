"""The same angle in [-π, π), for kernels and for arrays."""

from __future__ import annotations

from math import floor, pi
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

__all__ = ["signed", "wrap"]

Angle = TypeVar("Angle", float, NDArray[np.floating[Any]])


@njit(cache=True, inline="always")
def wrap(angle: float) -> float:
    """The same angle in [-π, π), compiled."""
    return angle - 2.0 * pi * floor((angle + pi) / (2.0 * pi))


def signed(angle: Angle) -> Angle:
    """The same angle, or array of angles, in [-π, π)."""
    return (angle + pi) % (2 * pi) - pi
