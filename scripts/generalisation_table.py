"""Clean success of learned policies beyond what they were trained for: other objects, layouts and robots, noise, delay.

Episodes are kept in a file, one a line: a run that was interrupted goes on where it was. Ten scenes of every cell are
played before the next ten. A cell that a policy refuses is not played.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.envs import reality
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.protocol import AnyPolicy, PolicyError
from clutter_env.policies.registry import load_policy
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.intervals import wilson
from clutter_env.reporting.tables import markdown_table
from clutter_env.seeds import HELD_OUT

CELLS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "5 objects": {"num_objects": 5},
        "15 objects": {},
        "60 objects": {"num_objects": 60},
        "dense, 25 objects": {"layout": "dense", "num_objects": 25},
        "island": {"layout": "island"},
        "boxes": {"shapes": "box"},
        "tall": {"object_set": "tall"},
        "household": {"object_set": "household", "obstructed": False},
        "panda_mobile": {"robot": "panda_mobile"},
        "poses off by 5 mm": {"reality": {"poses": 1.0}},
        "poses off by 10 mm": {"reality": {"poses": 1.0}},
        "observations 100 ms late": {"reality": {"observation_delay": 1.0}},
    }
)
"""Keyword arguments of the environment, beside 15 objects and obstructed targets."""
_DOUBLED = "poses off by 10 mm"
"""The cell with twice the noise (σ) of the reality dial."""
_BLOCK = 10
_REFUSED = "refused"


def main(
    policies: tuple[str, ...] = ("keyframes",),
    cells: tuple[str, ...] = tuple(CELLS),
    scenes: int = 30,
    out: Path = Path("outputs/generalisation.jsonl"),
) -> None:
    """Play `clutter_env/Retrieve-o15-v0` with obstructed targets in every cell, and print the table.

    Args:
        policies: As of `clutter-env evaluate`.
        cells: Names of `CELLS`.
        scenes: Seeds from 1,000,000 on.
        out: The file of the episodes.
    """
    kept = JsonLines(out)
    played = {tuple(row[:3]): row[3:] for row in kept.values}
    loaded = {name: load_policy(name, 0) for name in policies}
    for first in range(0, scenes, _BLOCK):
        block = range(first, min(first + _BLOCK, scenes))
        for cell, name, scene in product(cells, policies, block):
            is_refused = played.get((name, cell, 0), [""])[-1] == _REFUSED
            if (name, cell, scene) not in played and not is_refused:
                kept.append([name, cell, scene, *_play(loaded[name], cell, HELD_OUT + scene)])
                played[name, cell, scene] = kept.values[-1][3:]
    rows = []
    for cell in cells:
        row = [cell]
        for name in policies:
            found = [played[name, cell, scene] for scene in range(scenes) if (name, cell, scene) in played]
            clean, lifted, seconds = (sum(column) for column in list(zip(*found, strict=True))[:3])
            is_refused = found[-1][-1] == _REFUSED
            shown = f"{wilson(clean, len(found))}, {lifted} lifted, {seconds / len(found):.1f} s"
            row.append(_REFUSED if is_refused else shown)
        rows.append(row)
    print(markdown_table(("", *policies), rows))


def _play(policy: AnyPolicy, cell: str, seed: int) -> list[Any]:
    """Whether the episode of a seed was clean, whether the target was lifted, CPU time [s], and why it failed."""
    known = reality.LEVELS
    reality.LEVELS = replace(known, pose=2 * known.pose) if cell == _DOUBLED else known
    env, started = gym.make("clutter_env/Retrieve-o15-v0", **{"obstructed": True, **CELLS[cell]}), time.process_time()
    try:
        score = play_scene(seed, env, policy)
    except PolicyError:
        return [False, False, 0.0, _REFUSED]
    finally:
        reality.LEVELS = known
        env.close()
    return [score.clean, score.lifted, round(time.process_time() - started, 2), score.failure]


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
