"""Confirm the scores of a results file: its recorded actions are played again in fresh environments.

    clutter-env verify outputs/evaluate/side-15-v3_lookahead.json
    clutter-env verify results.json --policy my_module:MyPolicy --scenes 50

A replay takes about a second for 1,000 steps. It proves the scores, and not who made them. With --policy the policy
itself also plays fresh scenes of the kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Arguments:
    """Verify a results file."""

    file: Annotated[Path, tyro.conf.Positional]
    """The results file of `clutter-env evaluate --json FILE`."""
    policy: str = ""
    """Also run this policy on fresh scenes. Names are those of `clutter-env evaluate`."""
    scenes: int = 20
    """Number of fresh scenes."""
    first_seed: int | None = None
    """Seed of the first fresh scene. Random if not given, so that no policy can know the scenes."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    workers: int = 2
    """Number of processes."""
    json: Path | None = None
    """Write what was found to this file."""


def run(arguments: Arguments) -> int:
    """Replay, compare, and print differences. Return 1 if the scores are not confirmed."""
    import secrets
    from dataclasses import replace
    from tempfile import TemporaryDirectory

    from clutter_env.evaluation.evaluate import EPISODE_S, evaluate
    from clutter_env.evaluation.verify import FRESH_SEEDS, fresh_scenes, read_results, replay_seconds, verify
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.intervals import newcombe
    from clutter_env.reporting.progress import progress_bar

    workers, count = arguments.workers, arguments.scenes
    content = read_results(arguments.file)
    claims, chosen = content["episodes"], {name: getattr(arguments, name) for name in ("trust", "python", "workers")}
    with progress_bar(total=len(claims), unit="episode", seconds=replay_seconds(claims) / workers) as bar:
        found = verify(arguments.file, workers, bar.update)
    seed = secrets.choice(FRESH_SEEDS) if arguments.first_seed is None else arguments.first_seed
    if arguments.policy:
        with TemporaryDirectory() as folder:
            scenes, feasibility = (
                fresh_scenes(arguments.file, count, seed, Path(folder), workers),
                content["feasibility"],
            )
            with progress_bar(total=count, unit="episode", seconds=EPISODE_S * count / workers) as bar:
                fresh = evaluate(arguments.policy, scenes, feasibility=feasibility, tick=bar.update, **chosen)
        other = () if fresh.traits.track == found.track else (f"the policy is of the {fresh.traits.track} track",)
        success = fresh.clean
        found = replace(found, fresh=success, differences=found.differences + other)
    said = f"{found.clean} clean successes in {found.episodes} episodes of {found.scenes}"
    if found.is_confirmed:
        _show(f"confirmed: {said}, by replay of the recorded actions")
        if found.other_than:
            _show("with the same digits, although the file was made with something else:", *found.other_than)
    else:
        _show(f"NOT confirmed: {said}", *found.differences)
        if found.other_than:
            _show("not comparable: the differences may come from what the file was made with:", *found.other_than)
    _show(f"claimed: policy {found.policy}, of the {found.track} track; its files are {found.weights}")
    if found.fresh is not None:
        _show(f"{arguments.policy} on {arguments.scenes} fresh scenes from seed {seed}: clean success {found.fresh}")
        less = newcombe((found.clean, found.episodes), (fresh.num_clean, len(fresh.scores)))
        said = "more than there" if less.low > 0 else "no difference that so many scenes show"
        _show(f"in the file it has {less} more: {said}")
    if arguments.json is not None:
        write_json(arguments.json, found)
    return 0 if found.is_confirmed else 1


def _show(*lines: str) -> None:
    """Print lines, in which text from the file cannot move the cursor of a terminal."""
    print(*("".join(sign if sign.isprintable() else "?" for sign in line) for line in lines), sep="\n  ")
