"""Bases of about the same manipulability in the order of how much of the target a camera sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["COMPARED_BASES", "EQUAL_SHARE", "OrderedRows", "most_visible_first"]

Floats = NDArray[np.float64]

EQUAL_SHARE = 0.1
"""Bases whose μ differs by less than this share of the best μ count as equally good."""

COMPARED_BASES = 24
"""Bases that are compared beyond the number wanted."""


class OrderedRows(NamedTuple):
    """Rows (n, k, 7) of n queries, filled with NaN beyond `counts` (n,), as of `PlacementBatch.of_rows`."""

    rows: Floats
    counts: NDArray[np.int64]


def most_visible_first(rows: Floats, counts: NDArray[np.int64], shares: Floats, k: int) -> OrderedRows:
    """The first k bases of each query: by classes of μ, in a class by visibility, then by μ.

    Args:
        rows: (n, m, 7) of n queries, best μ first, filled with NaN beyond `counts`; column 4 is μ.
        counts: (n,) bases of each query.
        shares: (n, m) how much of the target is seen from each base.
        k: bases wanted for each query, at most m.
    """
    mu = rows[..., 4]
    is_there = np.arange(rows.shape[1]) < counts[:, None]
    lost = np.floor((1.0 - mu / mu[:, :1]) / EQUAL_SHARE)
    keys = np.where(is_there, -shares, 0.0), np.where(is_there, lost, np.inf)
    order = np.lexsort(keys, axis=1)[:, :k]
    chosen = np.take_along_axis(rows, order[..., None], axis=1)
    return OrderedRows(np.ascontiguousarray(chosen), np.minimum(counts, k))
