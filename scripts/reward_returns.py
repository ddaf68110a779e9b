"""Returns of the dense reward: finishing against hovering, oscillating, dropping and re-picking, and idling.

    python scripts/reward_returns.py

Every behaviour starts at the reset of a suite's scene; all but finishing go on until the time limit. Prints the table
of `docs/notes/environments.md`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping
from itertools import chain, repeat
from pathlib import Path
from typing import Any, cast

import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.parallel import Crash, Killed, run_jobs
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.task import family
from planners import TampExpert

DISCOUNTS = (0.95, 0.99, 1.0)
FINISHING = "finishing"
HEAD = (
    "suite",
    "behaviour",
    *(f"γ = {discount:g}" for discount in DISCOUNTS),
    *(f"less than finishing, γ = {discount:g}" for discount in DISCOUNTS),
    "least lead of finishing, γ = 0.99",
)
ABOVE = 0.32
"""[m] of the TCP above the table while the gripper hovers: higher than any object of the suites."""
AHEAD = 0.12
"""[m] of the TCP before the front edge of a shelf, over which the gripper cannot hover."""
STANDOFF = 0.80
"""[m] from the base to the TCP, where the arm reaches well."""
RAISED, FURTHER = 0.02, 3.0
"""[m] by which the expert lifts the target before it is stopped, and how many times as far the target is held then."""
ROOM = 0.02
"""[m] by which the gripper opens wider than the target."""
PERIOD = 30
"""Control steps for which a pose is approached before the next one."""

Array = NDArray[Any]
Actions = Iterator[Array]


def main(
    scenes: int = 50,
    wholly: int = 11,
    grasps: str = "side",
    workers: int = 2,
    file: Path = Path("outputs/reward_returns.jsonl"),
) -> None:
    """Play the behaviours and print the table.

    Args:
        scenes: Number of scenes of each suite, the first ones of its test split.
        wholly: Number of those in which every behaviour is played; in the others finishing, hovering and oscillating.
        grasps: Grasp set of the expert: with "side" it has to clear in most of the scenes.
        workers: Number of processes.
        file: Returns of each scene; those that stand in it are not played again.
    """
    records = JsonLines(file)
    known = {tuple(record["job"]): record["returns"] or {} for record in records.values}  # {}: the expert has failed
    env_ids = {name: clutter_env.suite(name).test[0].env_id for name in clutter_env.suite_names()}
    suites = [name for name, env_id in env_ids.items() if family(env_id) == "retrieve"]
    jobs = [(name, index, grasps) for index in range(scenes) for name in suites]
    wanted = {job: list(BEHAVIOURS)[: None if job[1] < wholly else SOME] for job in jobs}
    done = {job for job, returns in known.items() if not returns or set(wanted.get(job, ())) <= returns.keys()}
    todo = [(*job, wanted[job]) for job in jobs if job not in done]
    for (*job, _), returns in progress_bar(run_jobs(play, todo, workers), total=len(todo), unit="scene"):
        if isinstance(returns, Crash | Killed):
            raise RuntimeError(f"{job}: {returns}")
        records.append({"job": job, "returns": returns})
    found = {tuple(record["job"]): record["returns"] for record in records.values}
    table = [rows(name, [found[job] for job in jobs if job[0] == name and found[job]]) for name in suites]
    print(markdown_table(HEAD, list(chain.from_iterable(table))), end="")


def rows(name: str, scenes: list[dict[str, list[float]]]) -> Iterator[tuple[str, ...]]:
    """The table's rows of a suite: means over its scenes."""
    for behaviour in scenes[0] if scenes else ():
        played = [scene for scene in scenes if behaviour in scene]
        returns = np.array([scene[behaviour] for scene in played])
        leads = np.array([scene[FINISHING] for scene in played]) - returns
        means = [f"{value:.3f}" for value in returns.mean(axis=0)]
        won = [f"{np.count_nonzero(column > 0)} of {len(played)}" for column in leads.T]
        least = f"{leads[:, DISCOUNTS.index(0.99)].min():.0e}"
        is_finishing = behaviour == FINISHING
        yield (name, behaviour, *means, *((("–",) * 4) if is_finishing else (*won, least)))


def play(job: tuple[str, int, str, list[str]]) -> dict[str, list[float]] | None:
    """Returns for each of `DISCOUNTS`, by behaviour; None if the expert does not finish.

    Args:
        job: suite, number of the scene, grasp set of the expert, behaviours to play besides finishing.
    """
    name, index, grasps, behaviours = job
    scene = clutter_env.suite(name).test[index]
    taken: list[Array] = []
    returns: dict[str, list[float]] = {}
    played = [(behaviour, *BEHAVIOURS[behaviour]) for behaviour in behaviours]
    for behaviour, control_mode, act in [(FINISHING, "joint", None), *played]:
        env = scene.make(control_mode=control_mode, reward_mode="dense")
        scene.reset(env)
        inner = cast(RetrieveEnv, env.unwrapped)
        rewards, is_over, info = list[float](), False, dict[str, Any]()
        for action in act(inner, taken) if act else finish(inner, grasps):
            _, reward, terminated, truncated, info = env.step(action)
            rewards.append(float(reward))
            if is_over := terminated or truncated:
                break
        if act is None:
            if not info["is_success"]:
                return None
            taken = list(inner.actions)
        elif not is_over or info["is_success"]:
            raise RuntimeError(f"{behaviour} in scene {index} of {name} has ended early, or was a success: {info}")
        returns[behaviour] = [math.fsum(d**t * reward for t, reward in enumerate(rewards)) for d in DISCOUNTS]
    return returns


def finish(env: RetrieveEnv, grasps: str) -> Actions:
    """The expert's actions."""
    expert = TampExpert(env, grasps=grasps)
    expert.reset()
    while not expert.done:
        yield expert.act()


def hover(env: RetrieveEnv, taken: list[Array], sway: float = 0.0) -> Actions:  # noqa: ARG001  one signature for all
    """Drive before the target, hold the gripper over it, or before the shelf; rise and sink by `sway` [m]."""
    x, y = env.measurements.poses[env.target_slot, :2].tolist()
    height = TABLE_HEIGHT + ABOVE
    if env.layout.board_height is not None:
        x, height = -env.layout.depth / 2 - AHEAD, TABLE_HEIGHT + env.robot.grasp_height
    nearest = -env.layout.depth / 2 - env.robot.base_radius
    base = np.array([min(x - STANDOFF, nearest), y, 0.0])
    pose = np.eye(4)
    pose[:2, 3] = x, y
    while True:
        for raised in (0.0, sway):
            pose[2, 3] = height + raised
            for _ in range(PERIOD):
                yield env.ee_action(base, pose, env.robot.max_opening)


def oscillate(env: RetrieveEnv, taken: list[Array]) -> Actions:
    """Rise and sink over the target by 10 cm."""
    return hover(env, taken, sway=0.1)


def hold_low(env: RetrieveEnv, taken: list[Array]) -> Actions:
    """Act as the expert has done, but hold the target too low."""
    _, raised, _ = yield from lift(env, taken)
    while True:
        yield env.joint_action(raised, 0.0)


def drop_and_pick(env: RetrieveEnv, taken: list[Array]) -> Actions:
    """Lift the target as in `hold_low`, put it back, let go of it, grasp it, lift it, and so on."""
    at_grasp, raised, width = yield from lift(env, taken)
    while True:
        for configuration, opening in ((at_grasp, 0.0), (at_grasp, width), (at_grasp, 0.0), (raised, 0.0)):
            for _ in range(PERIOD):
                yield env.joint_action(configuration, opening)


def lift(env: RetrieveEnv, taken: list[Array]) -> Generator[Array, None, tuple[Array, Array, float]]:
    """The expert's actions until the target leaves the table.

    Returns:
        The robot's configuration when the target was grasped, one in which the target is too low for success, and the
        opening [m] of the gripper in which it is loose.
    """
    target, at_grasp = env.target_slot, None
    bottom = env.world.lowest_point(env.measurements, target)
    for action in taken:
        yield action
        configuration = env.data.qpos[env.world.index.drive_qpos]
        if at_grasp is None and target in env.measurements.grip.held:
            at_grasp = configuration
        if at_grasp is not None and env.world.lowest_point(env.measurements, target) > bottom + RAISED:
            assert env.world.scene is not None
            width = 2 * float(env.world.scene.half_extents[target, :2].max()) + ROOM
            return at_grasp, at_grasp + FURTHER * (configuration - at_grasp), min(width, env.robot.max_opening)
    raise RuntimeError("the same actions have not lifted the target again")


def idle(env: RetrieveEnv, taken: list[Array]) -> Actions:  # noqa: ARG001  one signature for all
    """Stand still."""
    return repeat(np.zeros(env.action_size))


BEHAVIOURS: Mapping[str, tuple[str, Callable[[RetrieveEnv, list[Array]], Actions]]] = {
    "hovering over the target": ("ee", hover),
    "oscillating over the target": ("ee", oscillate),
    "holding the target low": ("joint", hold_low),
    "dropping and re-picking": ("joint", drop_and_pick),
    "idling": ("joint", idle),
}
"""By name: control mode, and actions in an environment, given those that the expert has taken to finish."""
SOME = 2
"""The first behaviours, which are played in every scene."""


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
