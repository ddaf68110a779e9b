"""Kernels that allocate nothing: how they are compiled, and rows copied inside them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irm.compilation import njit

leaf_kernel = njit(cache=True, _nrt=False)
"""`numba.njit` without reference counting, for kernels that neither allocate nor return arrays and call none that do.

Numba counts references, atomically, to every array taken out of a tuple. For the 50 arrays of a collision query
this takes longer than the check itself. Numba compiles inner loops of its own in this way (`numba.misc.mergesort`); see
https://github.com/numba/numba/issues/2350. A kernel that allocates after all is refused when it is compiled ("NRT
required but not enabled").
"""
inlined_kernel = njit(cache=True, _nrt=False, forceinline=True)
"""A `leaf_kernel` that is compiled into its callers, for a few lines in an inner loop; it multiplies code."""
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
