"""Play one episode of a policy, to look at: in a window, or as a film on a machine without a display.

    clutter-env play --policy keyframes --objects 15
    clutter-env play --policy outputs/my_policy:MyPolicy --objects 5 --film outputs/play

"keyframes" is a trained policy that comes with the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Arguments:
    """Play one episode of a policy."""

    policy: str = "keyframes"
    """A built-in policy, or module:Class; an unknown name lists the built-in ones."""
    objects: int = 15
    """Number of objects on the table, the target among them."""
    seed: int = 1_000_000
    """Random seed of the scene; from 1,000,000 on nothing has been trained on."""
    layout: str = ""
    """Table and surroundings; empty for the paper's table alone."""
    obstructed: bool = True
    """Only targets that no side grasp reaches without moving something."""
    film: Path | None = None
    """Write a film to this file, its ending is added; without it, a window, or on a machine without a display a film in
    outputs/play."""


def run(arguments: Arguments) -> None:
    """Play, and say how it ended."""
    from clutter_env.learning.comparison.played import play_policy, played_task
    from clutter_env.rendering.renderer import has_display

    film = arguments.film
    if film is None and not has_display():
        film = Path("outputs/play") / f"{arguments.policy.replace(':', '.')}-{arguments.objects}-{arguments.seed}"
    task = played_task(arguments.objects, arguments.layout, arguments.obstructed)
    played = play_policy(task, arguments.policy, arguments.seed, film)
    score = played.score
    lifted = "the target was lifted" if score.lifted else f"the target was not lifted ({score.failure})"
    around = f"{score.disturbed} objects disturbed, {score.fallen} fallen"
    print(f"{lifted} after {score.sim_s:.1f} s; {around}: {'clean success' if score.clean else 'no clean success'}")
    if played.film is not None:
        print(f"film: {played.film}")
