"""Play a suite of scenes with a policy and write one results file.

    clutter-env evaluate --suite side-15-v3 --policy lookahead
    clutter-env evaluate --suite side-15-v3 --policy my_module:MyPolicy --split validation

A policy has the methods `reset(info)` and `act(observation)`. The rules are in docs/suites.md. The 100 scenes of a
suite take some three minutes on two cores with the expert and 15 objects. With a slow policy and 40 objects they take
up to half an hour.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Arguments:
    """Evaluate a policy on a suite."""

    suite: str = "side-15-v3"
    """Name of the suite."""
    policy: str = "lookahead"
    """lookahead, ngr, dogar, srivastava, canonical: the expert with side grasps, or, as lookahead-all, …, with all
    grasps. keyframes, keyframes-all, keyframes-shelf: learned decisions and motions. end-to-end: one network. greedy,
    random-skills, direct-approach, scripted, random. For other scenes: reach, pick, armreach, armpick and armretrieve.
    The directory of a training run. module:Class. end-to-end:FILE.npz, weights of `clutter-env train end-to-end`.
    lerobot:DIRECTORY, a checkpoint of LeRobot. With --trust, a model of Stable-Baselines3 as ALGORITHM:FILE.zip."""
    split: str = "test"
    """"test" for results to report, "validation" to tune a policy."""
    scenes: int | None = None
    """Number of scenes, the first ones. Such results are not results on the suite."""
    count_crashes: bool = False
    """Count an exception of the policy as a failed episode. Otherwise it ends the evaluation."""
    workers: int = 2
    """Number of processes."""
    ray: str = ""
    """Address of Ray ("auto", "local", …): play there instead of in processes of this machine."""
    seed: int = 0
    """Random seed of the built-in random policies."""
    feasibility: Literal["oracle", "none"] = "oracle"
    """For policies that act by skills: whether skills without a free grasp are refused, or tried all the same."""
    trust: bool = False
    """Load models of Stable-Baselines3 (ALGORITHM:FILE.zip), which executes code that is in the file."""
    python: str = ""
    """For lerobot:DIRECTORY: the interpreter of an environment in which LeRobot is installed."""
    json: Path | None = None
    """The results file. outputs/evaluate/SUITE_POLICY.json if not given."""


def run(arguments: Arguments) -> None:
    """Play, print, write."""
    from clutter_env.evaluation.evaluate import EPISODE_S, evaluate
    from clutter_env.evaluation.scenes import SceneSet
    from clutter_env.evaluation.tables import markdown_by_floor, markdown_short, results, summarise
    from clutter_env.policies.registry import check_name
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.progress import LateBar

    check_name(arguments.policy)
    scenes = SceneSet(arguments.suite, arguments.split, count=arguments.scenes)
    count = len(scenes.scenes)
    names = ("seed", "feasibility", "trust", "python", "workers", "ray", "count_crashes")
    chosen = {name: getattr(arguments, name) for name in names}
    with LateBar(total=count, unit="episode", seconds=EPISODE_S * count / arguments.workers) as bar:
        evaluation = evaluate(arguments.policy, scenes, begin=bar.begin, tick=bar.update, **chosen)
    content, row = results(evaluation), summarise(arguments.policy, [evaluation])
    clean = evaluation.num_clean
    print(f"{arguments.policy} solved {clean} of {count} scenes of {scenes.name} cleanly.\n")
    print(markdown_short(row))
    if evaluation.floors:
        print(f"Lower bounds are for {evaluation.traits.grasps} grasps.\n\n{markdown_by_floor([row])}")
    print(f"objects moved {row.moved.mean:.2f}, cleared {row.cleared.mean:.2f}, on average over all episodes")
    if content["crashes"]:
        print(f"\n{content['crashes']} episodes, counted as failures, ended with an exception of the policy")
    # The table stands on the screen before the file is written: a full disk does not lose it.
    name = f"{arguments.suite}_{arguments.policy.replace(':', '.').replace('/', '.')}.json"
    file = arguments.json or Path("outputs/evaluate") / name
    write_json(file, content)
    print(f"\ndigest: {content['digest']}\nwritten: {file}; all columns: clutter-env compare --files {file}")
