"""Statistics of features as LeRobot stores them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["image_statistics", "vector_statistics"]

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_FRAMES = 50
"""Images of an episode that count at most, spread evenly."""


def vector_statistics(rows: NDArray[Any]) -> dict[str, Any]:
    """Of each number of rows (n, k): min, max, mean, std, quantiles, each a list (k,), and the count [n]."""
    values = np.asarray(rows, dtype=np.float64).reshape(len(rows), -1)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(),
        "count": [len(values)],
        **{name: np.quantile(values, share, axis=0).tolist() for name, share in _QUANTILES.items()},
    }


def image_statistics(images: NDArray[np.uint8]) -> dict[str, Any]:
    """Of each colour of images (n, h, w, 3), from 0 to 1: lists of shape (3, 1, 1)."""
    chosen = images[np.unique(np.linspace(0, len(images) - 1, _FRAMES).round().astype(int))]
    found = vector_statistics(chosen.reshape(-1, chosen.shape[-1]) / 255.0)
    shaped = {name: [[[value]] for value in values] for name, values in found.items() if name != "count"}
    return {**shaped, "count": [len(chosen)]}
