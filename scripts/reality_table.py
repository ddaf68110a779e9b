"""Clean success of the expert over the reality dial, each effect alone and all together."""

from __future__ import annotations

import gymnasium as gym
import tyro

import clutter_env  # noqa: F401  registers the environments
from clutter_env.config import EFFECTS
from planners import TampExpert

TOGETHER = "together"


def main(
    effects: tuple[str, ...] = (*EFFECTS, TOGETHER),
    shares: tuple[float, ...] = (0.5, 1.0),
    scenes: int = 20,
    base: str = "holonomic",
) -> None:
    """Play the first scenes of `clutter_env/Retrieve-o15-v0` in every cell.

    Args:
        effects: Names of effects, or "together".
        shares: Values of the dial.
        scenes: Seeds from 0 on.
        base: How the base moves.
    """
    for effect in effects:
        cells = []
        for share in shares:
            reality = share if effect == TOGETHER else {effect: share}
            played = [play(reality, seed, base) for seed in range(scenes)]
            clean, lifted, replans = (sum(column) for column in zip(*played, strict=True))
            cells.append(f"{clean} ({lifted} lifted, {replans} replans)")
        print(f"| {effect} | {' | '.join(cells)} |", flush=True)


def play(reality: float | dict[str, float], seed: int, base: str) -> tuple[bool, bool, int]:
    """One episode: whether the target was lifted cleanly, whether it was lifted, and the number of replans."""
    env = gym.make("clutter_env/Retrieve-o15-v0", reality=reality, base=base)
    _, info = env.reset(seed=seed)
    expert = TampExpert(env)
    expert.reset(info["target"])
    is_over = False
    while not (is_over or expert.done):
        _, _, terminated, truncated, info = env.step(expert.act())
        is_over = terminated or truncated
    env.close()
    return info["is_success"], info["lifted"], expert.report.replans


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
