"""A policy that looks up a published results file, and three forged files: which of them a verifier's table measures.

    python -m scripts.forgeries --scenes 20

Prints the two tables of docs/verification.md. The published file is one of `results/`. The look-up policy sees
observations, and plays the actions of the published scene that begins with the same objects; on others it gives up.
"""

from __future__ import annotations

import shutil
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import tyro

from clutter_env.evaluation.challenge import check, new_challenge, play, register
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.evaluation.verify import verify
from clutter_env.reporting.files import read_json, write_json
from clutter_env.reporting.intervals import newcombe, wilson
from clutter_env.reporting.tables import markdown_table

ROOT = Path(__file__).parents[1]
SUITE, EXPERT = "all-25-v3", "lookahead"
PUBLISHED, MODULE = "published.json.xz", "mine"
POLICY = f'''
from pathlib import Path
import numpy as np
import clutter_env
from clutter_env.evaluation.recording import Recording
from clutter_env.reporting.files import read_json


class LooksUp:
    """Plays the published actions of the scene that begins with the same objects."""

    def __init__(self):
        content, self.known = read_json(Path("{PUBLISHED}")), {{}}
        scenes = clutter_env.suite(content["suite"]).test
        env = scenes[0].make()
        for scene, values in zip(scenes[:COUNT], content["recordings"]):
            observation, _ = scene.reset(env)
            self.known[observation["objects"].tobytes()] = Recording.from_json(values).actions

    def reset(self, info):
        self.left, self.done = None, False

    def act(self, observation):
        if self.left is None:
            self.left = list(self.known.get(observation["objects"].tobytes(), ()))
        self.done = len(self.left) < 2
        return self.left.pop(0) if self.left else np.zeros(12, np.float32)
'''


class Forged(NamedTuple):
    """A forged file: what is wrong with it, and what is found."""

    what: str
    confirmed: bool
    measured: bool
    why: str


def main(scenes: int = 20, workers: int = 1) -> None:
    """Play, forge, check, and print the tables.

    Args:
        scenes: Public and fresh scenes.
        workers: Number of processes.
    """
    with TemporaryDirectory() as folder, chdir(folder):
        shutil.copy(ROOT / "results" / f"{SUITE}_{EXPERT}.json.xz", PUBLISHED)
        Path(f"{MODULE}.py").write_text(POLICY.replace("COUNT", str(scenes)))
        name, ledger, file = f"{MODULE}:LooksUp", Path("ledger.jsonl"), Path("challenge.json")
        public = evaluate(name, SceneSet(SUITE, count=scenes), workers=workers)
        new_challenge(register(name, SUITE, scenes, [Path(PUBLISHED)]), ledger, file, workers)
        fresh = play(file, ledger, [Path(PUBLISHED)], workers=workers)
        expert = evaluate(EXPERT, SceneSet(str(file)), workers=workers)
        won = [(found.num_clean, scenes) for found in (public, fresh)]
        rows = [[where, str(wilson(*one))] for where, one in zip(("public", "fresh"), won, strict=True)]
        print(markdown_table([f"the look-up policy, {scenes} scenes of {SUITE}", "clean success"], rows))
        print(f"difference {newcombe(*won)}; the expert on the fresh scenes: {expert.clean}\n")
        found = [
            _tried(what, content, file, ledger, workers) for what, content in _forgeries(name, public, fresh, expert)
        ]
        print(
            markdown_table(
                ["file", "`verify`", "`challenge check`", "why"],
                [
                    [
                        one.what,
                        "confirmed" if one.confirmed else "not confirmed",
                        "measured" if one.measured else "not measured",
                        one.why,
                    ]
                    for one in found
                ],
            )
        )


def _forgeries(
    name: str, public: Evaluation, fresh: Evaluation, expert: Evaluation
) -> list[tuple[str, dict[str, Any]]]:
    """Three results files under the policy's name that it has not earned."""
    mine = replace(expert, policy=name, weights=fresh.weights, traits=fresh.traits, floors=fresh.floors)
    half = len(fresh.episodes) // 2
    part = replace(fresh, episodes=(*fresh.episodes[:half], *expert.episodes[half:]))
    published = replace(public, policy=name)
    return [
        ("the published actions under its own name, public scenes", results(published)),
        ("the expert's actions on the fresh scenes under its own name", results(mine)),
        ("its own actions on the first half of them, the expert's on the rest", results(part)),
    ]


def _tried(what: str, content: dict[str, Any], file: Path, ledger: Path, workers: int) -> Forged:
    """What is found of a forged file."""
    path = Path("forged.json")
    write_json(path, content)
    assert read_json(path)["policy"] == content["policy"]
    confirmed = verify(path, workers).is_confirmed
    found = check(file, path, ledger, 10, workers=workers)
    why = list(found.problems)
    if found.same is not None and found.same < found.again:
        why.insert(0, f"run again, it does the same on {found.same} of {found.again} scenes")
    return Forged(what, confirmed, found.is_measured, why[0] if why else "")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
