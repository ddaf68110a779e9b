"""Refusals tried again with a catalogue of grasps that is four times finer: which of them stand.

    python scripts/refusals.py --layout cabinet --objects 16 --scenes 80 --out refusals.jsonl

Targets as they come. Each scene is asked for its lower bound with the grasp set "all"; where that says that there is no
plan, with a pitch every 5° in place of every 20°, 96 directions in place of 24, each as before and 10 mm short of the
axis.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from planners import GraspFamily, Scene, clearance_floor

_DIRECTIONS, _STEP = 96, 5
"""Grasps of a round object for each pitch, and degrees between pitches."""


@dataclass(frozen=True)
class Arguments:
    """Which scenes: `scenes` resets of a `layout` with so many `objects`, from `seed` on."""

    layout: str = "cabinet"
    objects: int = 16
    scenes: int = 80
    seed: int = 840_000
    out: Path | None = None
    """File of JSON lines, one for each scene; scenes that it has are not tried again."""
    minutes: float = math.inf
    """No scene is begun after so much wall time; run the same command again to go on."""


def main(arguments: Arguments) -> None:
    """Try the scenes that are left, and print one row."""
    env = RetrieveEnv(num_objects=arguments.objects, layout=arguments.layout)
    file, started = JsonLines(arguments.out) if arguments.out else None, time.monotonic()
    rows = {(row["layout"], row["objects"], row["seed"]): row for row in (file.values if file else [])}
    wanted = [(arguments.layout, arguments.objects, arguments.seed + index) for index in range(arguments.scenes)]
    for key in progress_bar([key for key in wanted if key not in rows]):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        env.reset(seed=key[-1])
        scene = Scene.from_mujoco(env.model, env.data, env.robot)
        outcome, again = refusal(scene, env.target, "all"), ""
        if outcome:
            again = refusal(scene, env.target, finer()) or "none"
        layout, objects, seed = key
        rows[key] = {"layout": layout, "objects": objects, "seed": seed, "refused": outcome, "finer": again}
        if file:
            file.append(rows[key])
    done = [rows[key] for key in wanted if key in rows]
    refused = [row for row in done if row["refused"]]
    still = Counter(row["finer"] for row in refused)
    print(
        f"{arguments.layout}, {arguments.objects} objects: {len(done)} scenes, {len(refused)} refused; with finer "
        f"grasps {len(refused) - still['none']} still: {dict(still - Counter(none=still['none']))}"
    )
    for row in refused:
        print(f"  {row['seed']}: {row['refused']}; with finer grasps: {row['finer']}")


def refusal(scene: Scene, target: str, grasps: str | tuple[GraspFamily, ...]) -> str:
    """Cause for which a target is refused, "" if it is not."""
    floor = clearance_floor(scene, target, grasps=grasps)
    return "" if floor.count is not None else f"{'' if floor.proved else 'not proved: '}{floor.cause}"


def finer() -> tuple[GraspFamily, ...]:
    """The catalogue: of every pitch two families, as "all" has them."""
    pitches = range(0, 91, _STEP)
    return tuple(
        GraspFamily(
            f"{degrees}°, {offset}", math.radians(degrees), _DIRECTIONS, 0.02 if degrees else None, None, offset
        )
        for offset, degrees in itertools.product((None, 0.01), pitches)
    )


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
