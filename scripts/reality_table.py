"""Clean success of the expert and of the learned policy over the reality dial, each effect alone and all together.

Episodes are kept in a file, one a line: a run that was interrupted goes on where it was. Ten scenes of every cell are
played before the next ten, so that an interrupted table has all cells.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.config import EFFECTS
from clutter_env.envs.reality import LEVELS
from clutter_env.evaluation.score import play_scene
from clutter_env.policies.experts import PLANNERS, PlannerExpert
from clutter_env.policies.protocol import AnyPolicy
from clutter_env.policies.registry import load_policy
from clutter_env.reporting.files import JsonLines
from clutter_env.seeds import HELD_OUT

TOGETHER = "together"
_BLOCK = 10
_PLANNING_S = 60.0
"""Wall time for one plan: after something went wrong a search can take minutes."""


def main(
    effects: tuple[str, ...] = (TOGETHER, *EFFECTS),
    shares: tuple[float, ...] = (0.0, 0.5, 1.0, 0.25),
    policies: tuple[str, ...] = ("lookahead", "keyframes"),
    scenes: int = 50,
    base: str = "holonomic",
    out: Path = Path("outputs/reality.jsonl"),
) -> None:
    """Play scenes of `clutter_env/Retrieve-o15-v0` with obstructed targets in every cell, and print the table.

    Args:
        effects: Names of effects, or "together".
        shares: Values of the dial; the cells of one are played before those of the next.
        policies: As of `clutter-env evaluate`.
        scenes: Seeds from 1,000,000 on.
        base: How the base moves.
        out: The file of the episodes.
    """
    kept = JsonLines(out)
    played = {tuple(row[:5]): row for row in kept.values}
    for first in range(0, scenes, _BLOCK):
        block = range(first, min(first + _BLOCK, scenes))
        for share, effect, policy, scene in product(shares, effects, policies, block):
            key = (policy, base, *_cell(effect, share), scene)
            if key not in played:
                score = _play(policy, base, *key[2:4], HELD_OUT + scene)
                kept.append([*key, score.clean, score.lifted, score.failure, round(score.sim_s, 2)])
                played[key] = kept.values[-1]
    for policy in policies:
        print(f"\n| {policy} | {' | '.join(map(str, sorted(shares)))} |\n|{'---|' * (len(shares) + 1)}")
        for effect in effects:
            cells = [
                [played[policy, base, *_cell(effect, share), n] for n in range(scenes)] for share in sorted(shares)
            ]
            shown = [f"{sum(row[5] for row in rows)} ({sum(row[6] for row in rows)})" for rows in cells]
            print(f"| {effect} | {' | '.join(shown)} |")


def _cell(effect: str, share: float) -> tuple[str, float]:
    """The first cell with the same episodes: at 0 all are alike, delays are whole steps."""
    if effect.endswith("delay"):
        steps = getattr(LEVELS, effect)
        share = math.floor(share * steps + 0.5) / steps
    return (effect, share) if share else (TOGETHER, 0.0)


def _play(policy: str, base: str, effect: str, share: float, seed: int) -> Any:
    reality: float | Mapping[str, float] = share if effect == TOGETHER else {effect: share}
    env = gym.make("clutter_env/Retrieve-o15-v0", obstructed=True, reality=reality, base=base)
    score = play_scene(seed, env, _policy(policy))
    env.close()
    return score


@cache
def _policy(name: str) -> AnyPolicy:
    return PlannerExpert(PLANNERS[name], _PLANNING_S) if name in PLANNERS else load_policy(name, 0)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
