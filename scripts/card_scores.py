"""Scores that the task cards show and no other file has: random actions and the expert, on held-out scenes.

    python -m scripts.card_scores                        # all of them, some 20 minutes of CPU time
    python -m scripts.card_scores clutter_env/Pick-v0    # one environment again

Writes results/cards.json. Every score is that of a replay, as `clutter-env evaluate` makes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import tyro

from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results, summarise
from clutter_env.provenance import provenance
from clutter_env.reporting.files import read_json, write_json
from clutter_env.reporting.progress import progress_bar
from clutter_env.seeds import HELD_OUT

ROOT = Path(__file__).resolve().parents[1]
SCORES = ROOT / "results" / "cards.json"


class Case(NamedTuple):
    """A policy, and how many held-out scenes of an environment it plays."""

    env_id: str
    policy: str
    scenes: int


CASES = (
    *(
        Case(f"clutter_env/{name}-v0", policy, 100)
        for name, script in (
            ("ArmReach", "armreach"),
            ("ArmPick", "armpick"),
            ("ArmRetrieve-o1", "armretrieve"),
            ("Reach", "reach"),
            ("Pick", "pick"),
        )
        for policy in ("random", script)
    ),
    Case("clutter_env/Skill-o5-v0", "random-skills", 50),
    Case("clutter_env/Open-v0", "random", 20),
    Case("clutter_env/Open-v0", "lookahead-all", 20),
    Case("clutter_env/Rearrange-o4-v0", "lookahead-all", 20),
)
"""The scenes of a row are few where an episode takes long."""


@dataclass(frozen=True)
class Arguments:
    """Play what is missing, or some environments again."""

    envs: tyro.conf.Positional[tuple[str, ...]] = ()
    """Ids of environments to play again; all if not given."""


def main(arguments: Arguments) -> None:
    """Play, and write each score as soon as it is known."""
    known: dict[str, Any] = read_json(SCORES) if SCORES.exists() else {}
    chosen = [case for case in CASES if not arguments.envs or case.env_id in arguments.envs]
    for case in progress_bar(chosen, desc="scores", unit="policy"):
        known.setdefault(case.env_id, {})[case.policy] = score(case)
        write_json(SCORES, known)


def score(case: Case) -> dict[str, Any]:
    """The success of a policy with its 95% interval, and what is needed to repeat it."""
    evaluation = evaluate(case.policy, SceneSet(env_id=case.env_id, count=case.scenes))
    row, content = summarise(case.policy, [evaluation]), results(evaluation)
    return {
        "success": round(row.clean.mean, 4),
        "low": round(row.clean.low, 4),
        "high": round(row.clean.high, 4),
        "scenes": case.scenes,
        "first_seed": HELD_OUT,
        "digest": content["digest"],
        "provenance": provenance(case.env_id),
    }


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
