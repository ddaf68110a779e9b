"""Report of a search: its decisions, each with its belief."""

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
    """One decision of a search: time [s], kind, text, and belief.

    `kind` is "drive" for a view, "open" for an opened or shut drawer or door, "place" for an object put aside. It is
    "pick" for the target, and "end" at the end. `places` are the cells where the target can be, by support, of `grids`.
    `known` are the seen objects, `eye` (3,) is the camera position.
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
    """Report of a search.

    Attributes:
        found: whether the target has been seen.
        taken: whether it has been taken and is still between the fingers.
        failure: reason why the search failed, "" for success. "cannot be found": every place was seen, but not the
            target. Otherwise it tells how many places stay hidden, and by which objects.
        moves: names of the moved objects in order, as the expert calls them.
        openings: names of the drawers and doors that plans opened or shut, in order, also for taking the target.
            Failures are included.
        views: number of viewpoints visited.
        deviations: deviations that stopped motions, as text.
        belief_s, decision_s: CPU times [s] of each belief update, and of each decision with its plan.
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
