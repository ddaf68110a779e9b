"""Range and resolution of a map."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index

import numpy as np

from irm.errors import ReachabilityError

__all__ = ["MapParameters", "refinement"]

_MAX_REFINEMENT = 24
"""m of the finest orientation set: 3.75 degrees."""


_MAX_ROLLS = 96
"""Most roll samples: 3.75 degrees, as for the approach axes."""

_COUNTS = ("orientations", "rolls", "samples", "seed")


@dataclass(frozen=True)
class MapParameters:
    """Range and resolution of a map.

    Attributes:
        voxel: edge of the position cells [m].
        orientations: number of approach axes: 6, 26, 62, 114, 182, 266, … = 2 + 4 m (2 m - 1).
        rolls: roll samples per approach axis; 0 chooses 1 for a wrist that rolls freely and 4 for any other.
        pitches: the rings to keep [rad], () for all.
        heights: lowest and highest TCP position to cover [m]; limited by the reach of the arm.
        lift: whether the torso is a free parameter of the map; if not, it stays at the height it has at home.
        torso_margin: distance that the torso keeps from both ends of its lift [m].
        samples: random configurations, for arms without a closed form.
        seed: of those configurations.
    """

    voxel: float = 0.05
    orientations: int = 62
    rolls: int = 0
    pitches: tuple[float, ...] = ()
    heights: tuple[float, float] = (0.0, 10.0)
    lift: bool = True
    torso_margin: float = 0.0
    samples: int = 400_000
    seed: int = 0

    def __post_init__(self) -> None:
        try:
            numbers = {name: float(getattr(self, name)) for name in ("voxel", "torso_margin")}
            numbers |= {name: index(getattr(self, name)) for name in _COUNTS}
            pairs = {name: tuple(float(v) for v in getattr(self, name)) for name in ("pitches", "heights")}
        except (TypeError, ValueError) as problem:
            raise ReachabilityError(f"parameters of a map are numbers, pitches and heights tuples: {self}") from problem
        for name, value in {**numbers, **pairs, "lift": bool(self.lift)}.items():
            object.__setattr__(self, name, value)
        if not all(np.isfinite((self.voxel, *self.heights, *self.pitches))) or not 0.005 <= self.voxel <= 0.5:
            raise ReachabilityError(f"voxel must be 0.005 to 0.5 m and every number finite: {self}")
        if not 0.0 <= self.torso_margin < np.inf:
            raise ReachabilityError(f"torso_margin must be a number ≥ 0 [m], not {self.torso_margin}")
        if len(self.heights) != 2 or not 0.0 <= self.heights[0] < self.heights[1]:
            raise ReachabilityError(f"heights must be an increasing pair of numbers ≥ 0, not {self.heights}")
        if not 0 <= self.rolls <= _MAX_ROLLS or self.samples < 1:
            raise ReachabilityError(f"rolls must be 0 to {_MAX_ROLLS} and samples ≥ 1: {self}")
        refinement(self.orientations)


def refinement(orientations: int) -> int:
    """m of an orientation count.

    Raises:
        ReachabilityError: no such set; the message lists those there are.
    """
    counts = {2 + 4 * m * (2 * m - 1): m for m in range(1, _MAX_REFINEMENT + 1)}
    if orientations not in counts:
        known = ", ".join(map(str, counts))
        raise ReachabilityError(f"there is no set of {orientations!r} orientations; there are sets of {known}")
    return counts[orientations]
