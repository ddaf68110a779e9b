"""Settings of the measurements of reachability maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

__all__ = ["BenchmarkSettings", "Part"]

Part = Literal["speed", "build", "decide", "strips", "targets", "visibility"]


@dataclass(frozen=True)
class BenchmarkSettings:
    """What is measured, and how often."""

    parts: tuple[Part, ...] = ("build", "speed", "decide", "strips", "targets", "visibility")
    """What to measure: times of building; times of queries; right and wrong answers; narrow strips of free floor; bases
    for targets on a table; what the head camera sees of them."""
    queries: int = 500
    """Random cup positions for each map and each range of approach yaws."""
    sizes: tuple[int, ...] = (7_899, 26_000, 1_000_000)
    """Poses of the maps: 7899 and 26000 as in the paper; any other number for a map of more than a million poses, which
    takes half an hour."""
    poses: int = 100_000
    """Random TCP poses for which the answers of the maps are checked."""
    grasps: int = 10_000
    """Random level grasps above a table for which exact answers are checked."""
    strips: int = 500
    """Random strips of free floor."""
    targets: int = 200
    """Random targets on the table, for each layout, and for the head camera."""
    layouts: tuple[str, ...] = ("paper", "island")
    """Layouts of the table for the targets."""
    seed: int = 0
    """Random seed."""
    output: Path = Path("outputs/irm_benchmark.png")
    """Where the box plot goes."""
