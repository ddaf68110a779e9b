"""Plans with a problem that is kept: after one object has moved by 5 cm, beside those of a new problem.

    python scripts/kept_problem.py --objects 40 --scenes 30

For each scene the problem is solved, one object, drawn, is moved to where it overlaps nothing, and the goal is planned
for once with what was kept and once anew. CPU time of both, in this order, and picks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium
import numpy as np
import tyro

import clutter_env  # noqa: F401  registers the environments
from planners import Infeasible, Planner, Scene, SceneError, Solution, warmup

_BY = 0.05
"""[m] by which an object is moved."""


@dataclass(frozen=True)
class Arguments:
    """So many `objects`, in so many obstructed `scenes` from `seed` on, with a set of `grasps`."""

    objects: int = 40
    scenes: int = 30
    seed: int = 300_000
    grasps: str = "side"


def main(arguments: Arguments) -> None:
    """Plan in all scenes, and print a line for each and one for all."""
    warmup()
    ratios, same = [], 0
    for seed in range(arguments.seed, arguments.seed + arguments.scenes):
        scene, target = _scene(arguments.objects, seed)
        planner = Planner(scene.robot, grasps=arguments.grasps)
        problem = planner.problem(scene, target)
        planner.solve_problem(problem)
        changed = _changed(scene, target, planner, np.random.default_rng(seed))
        kept, kept_s = _timed(lambda: planner.solve_problem(problem.in_scene(changed)))  # noqa: B023  called at once
        fresh, fresh_s = _timed(lambda: planner.solve(changed, target))  # noqa: B023  called at once
        ratios.append(kept_s / fresh_s)
        same += _answer(kept) == _answer(fresh)
        print(f"{seed}: {_answer(kept)} in {kept_s:.2f} s, anew {_answer(fresh)} in {fresh_s:.2f} s")
    print(f"median {np.median(ratios):.2f} of the time, from {min(ratios):.2f} to {max(ratios):.2f}; ", end="")
    print(f"the same picks or cause in {same} of {len(ratios)}")


def _scene(objects: int, seed: int) -> tuple[Scene, str]:
    """An obstructed scene, and its target."""
    env = gymnasium.make(f"clutter_env/Retrieve-o{objects}-v0", obstructed=True)
    _, info = env.reset(seed=seed)
    world = env.unwrapped
    scene = Scene.from_mujoco(world.model, world.data, world.robot)  # type: ignore[attr-defined]  # it has them
    env.close()
    return scene, info["target"]


def _changed(scene: Scene, target: str, planner: Planner, rng: np.random.Generator) -> Scene:
    """The scene with one object moved, other than the target."""
    while True:
        name, turn = str(rng.choice([one for one in scene.names if one != target])), rng.uniform(0.0, 2 * np.pi)
        body = scene.body(name)
        moved = scene.with_body(body.at(body.position + _BY * np.array([np.cos(turn), np.sin(turn), 0.0])))
        try:
            planner.problem(moved, target)
        except SceneError:
            continue
        return moved


def _timed(plan: Callable[[], Solution | Infeasible]) -> tuple[Solution | Infeasible, float]:
    """A plan, and the CPU time [s] that it took."""
    before = time.process_time()
    found = plan()
    return found, time.process_time() - before


def _answer(found: Solution | Infeasible) -> str:
    """The picks of a plan, or why there is none."""
    return f"{found.picks} picks" if isinstance(found, Solution) else str(found.cause)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
