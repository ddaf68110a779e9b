"""Rows copied inside kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planners.collision.compilation import leaf_kernel

Array = NDArray[np.float64]


@leaf_kernel
def copy_row(source: Array, target: Array) -> None:
    """`target[:] = source` for arrays (d,) of the same length.

    For the assignment itself numba compiles the text of an error message about shapes, half a second for each kernel.
    """
    for i in range(target.shape[0]):
        target[i] = source[i]


@leaf_kernel
def copy_rows(source: Array, target: Array) -> None:
    """`target[:] = source` for arrays (k, d) of the same shape."""
    for row in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[row, i] = source[row, i]
