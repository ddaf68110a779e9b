"""Measure the motion layer: collision checks, whole picks, their timing, and MuJoCo's check of them. CPU times.

    python scripts/motion_benchmark.py --objects 15 25 40 --scenes 10

For every object with a grasp that hits nothing one pick is planned. Medians, and 95th percentiles after the slash.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from typing import Any, Literal

import numpy as np
import tyro

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from planners import CollisionWorld, PlanningContext, Scene
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick
from planners.motion.timing import pick_trajectory

CHECKS = 4_000
UNITS = {"check [µs]": 1e6, "pick [ms]": 1e3, "timing [ms]": 1e3, "MuJoCo's check [ms]": 1e3}


def main(
    objects: tuple[int, ...] = (15, 25, 40),
    scenes: int = 10,
    picks: int = 6,
    layout: str = "paper",
    grasps: Literal["side", "tilted", "top", "all"] = "side",
    seed: int = 0,
) -> None:
    """Measure and print a Markdown table.

    Args:
        objects: numbers of objects to measure.
        scenes: scenes for each.
        picks: objects for which a pick is planned in each scene, at most.
        layout: layout of the table.
        grasps: grasp set of the picks.
        seed: first seed of the scenes.
    """
    rows = []
    for count in objects:
        times: dict[str, list[float]] = defaultdict(list)
        outcomes: Counter[str] = Counter()
        env = RetrieveEnv(num_objects=count, layout=layout)
        for number in progress_bar(range(seed, seed + scenes), desc=f"{count} objects"):
            env.reset(seed=number)
            scene = Scene.from_mujoco(env.model, env.data, env.robot)
            measure(scene, grasps, picks, np.random.default_rng(number), times, outcomes)
        env.close()
        cells = [f"{u * np.median(times[n]):.1f} / {u * np.percentile(times[n], 95):.1f}" for n, u in UNITS.items()]
        rows.append([str(count), *cells, ", ".join(f"{n} {k}" for n, k in outcomes.most_common())])
    print(markdown_table(["objects", *UNITS, "outcomes"], rows))


def measure(
    scene: Scene,
    grasps: str,
    picks: int,
    rng: np.random.Generator,
    times: dict[str, list[float]],
    outcomes: Counter[str],
) -> None:
    """Checks in one scene, then a pick for each object with a free grasp."""
    world, checker, home = CollisionWorld.from_scene(scene), MujocoCollisionChecker(scene), np.array(scene.robot.home)
    candidates = PlanningContext.of(scene.robot, scene, grasps=grasps).grasps()
    free = [g for name in scene.names for g in candidates.for_object(scene, name)[:1] if not g.blockers]

    def timed(name: str, work: Any, *args: Any, **kwargs: Any) -> Any:
        """The result of a call, whose CPU time [s] is kept."""
        start = time.process_time()
        result = work(*args, **kwargs)
        times[name].append(time.process_time() - start)
        return result

    for grasp in free[:picks]:
        near = grasp.q + rng.normal(0, 0.05, (CHECKS, grasp.q.size))
        timed("check [µs]", world.hits_many, grasp.base, near, grasp.opening)
        times["check [µs]"][-1] /= CHECKS
        motion = timed("pick [ms]", plan_pick, world, grasp.base, home, grasp.q, grasp.object, rng=rng)
        outcomes[type(motion).__name__] += 1
        if isinstance(motion, PickPlaceMotion):
            trajectory = timed("timing [ms]", pick_trajectory, scene.robot, motion, scene.state)
            timed("MuJoCo's check [ms]", checker.deepest_penetration, trajectory)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
