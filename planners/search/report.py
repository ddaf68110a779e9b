"""How a search went: its decisions, and the belief that each of them was made with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planners.placing.negative_goal_region import SupportGrid
from planners.search.perception import Seen

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SearchStep:
    """One decision of a search: when [s], its kind, what in words, and the belief that it was made with.

    `kind` is "drive" for a view, "open" for a drawer or door opened, or shut, "place" for an object put aside, "pick"
    for the target taken, "end". `places` are the
    cells at which the target can be, by support, of `grids`; `known` the objects, `eye` (3,) the camera.
    """

    time: float
    kind: str
    text: str
    places: Mapping[str, NDArray[np.bool_]]
    grids: Mapping[str, SupportGrid]
    known: tuple[Seen, ...]
    eye: Array


@dataclass
class SearchReport:
    """How a search went.

    Attributes:
        found: the target has been seen.
        taken: it has been taken and is still between the fingers.
        failure: why the search ended without, "" for success; "cannot be found" if every place has been seen and the
            target in none of them. Otherwise it says how many places stay hidden, and by what.
        moves: names of the objects moved, in order, as the expert calls them.
        openings: names of what plans opened, or shut again, in order, for the target too; those that failed count.
        views: viewpoints looked from.
        deviations: that stopped motions, as text.
        belief_s, decision_s: [s] CPU time of each belief update, of each decision with its plan.
        steps: decisions, in order.
    """

    found: bool = False
    taken: bool = False
    failure: str = "unfinished"
    moves: list[str] = field(default_factory=list)
    openings: list[str] = field(default_factory=list)
    views: int = 0
    deviations: list[str] = field(default_factory=list)
    belief_s: list[float] = field(default_factory=list)
    decision_s: list[float] = field(default_factory=list)
    steps: list[SearchStep] = field(default_factory=list)
