"""The arrays of an arm as one argument of kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from irm.arm.chain import ArmChain

__all__ = ["ChainArrays", "chain_arrays"]

Floats = NDArray[np.float64]


class ChainArrays(NamedTuple):
    """Arrays of `ArmChain`, for kernels."""

    offsets: Floats
    axes: NDArray[np.int64]
    tip: Floats
    lower: Floats
    upper: Floats
    links: Floats


def chain_arrays(chain: ArmChain, torso_range: tuple[float, float] | None = None) -> ChainArrays:
    """The arrays of a chain, with other limits of its torso if given [m]."""
    lower, upper = chain.lower.copy(), chain.upper.copy()
    if torso_range is not None:
        lower[0], upper[0] = torso_range
    lower.setflags(write=False)
    upper.setflags(write=False)
    return ChainArrays(chain.offsets, chain.axes, chain.tip, lower, upper, chain.links)
