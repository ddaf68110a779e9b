"""Plans for goals in the scenes of Rearrange: how many are found, in how many picks, in which time; or done in physics.

    python scripts/goal_benchmark.py --task sort --objects 20 --scenes 50
    python scripts/goal_benchmark.py --task stack --objects 8 --scenes 40 --physics --out stack.jsonl
    python scripts/goal_benchmark.py --task set --objects 8 --scenes 12 --fault topple

With --physics the expert carries its plan out, and the environment judges: clean success, by the rule of the suites.
With --fault something happens to an object in mid-episode, once; then clean means that the goal is reached at the end,
that no other object has fallen or been disturbed, and that the furniture was not pressed hard. Each fault waits for its
moment; where that does not come, the episode is one without a fault, and the output says how many there were.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import tyro

import clutter_env
from assets.robots import robot as find_robot
from clutter_env.policies.playing import played
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from planners import ExpertConfig, Planner, Scene, Solution, TampExpert, solve, warmup
from planners.goals import occupants

_GAP = 0.15
"""[m] from where a fault puts an object to the middles of others and to the gripper, at least."""
_ABOVE = 0.03
"""[m] between the top of an object and the foot of what stands on it, at most."""
_SETTLED = 5
"""Control steps after which what a fault has done itself has been counted."""


@dataclass(frozen=True)
class Arguments:
    """What to plan for: `task` of Rearrange with so many `objects`, in so many `scenes` from `seed` on."""

    task: str = "sort"
    objects: int = 20
    scenes: int = 50
    seed: int = 200_000
    layout: str = ""
    """That of the task if not given."""
    robot: str = "fetch"
    all_arms: bool = False
    """Let all arms of the robot act."""
    saves_time: bool = False
    """Plan for little simulated time with one arm too, without physics. With all arms it is always so."""
    physics: bool = False
    """Let the expert carry the plans out."""
    fault: str = ""
    """In physics: what happens, a name in `FAULTS`."""
    time_limit: float = 300.0
    """[s] of wall time for one solve."""
    out: Path | None = None
    """File of JSON lines, one for each scene; scenes that it has are not tried again."""
    minutes: float = math.inf
    """No scene is begun after so much wall time; run the same command again to go on."""


def main(arguments: Arguments) -> None:
    """Try the scenes that are left, and print one row."""
    robot = find_robot(arguments.robot)
    robot = robot.with_all_arms() if arguments.all_arms else robot
    warmup(robot)
    keywords: dict[str, Any] = {"layout": arguments.layout} if arguments.layout else {}
    env = gymnasium.make(
        "clutter_env/Rearrange-o8-v0",
        max_episode_steps=clutter_env.rearrange_time_limit(arguments.objects),
        num_objects=arguments.objects,
        task=arguments.task,
        robot=robot,
        **keywords,
    )
    file = JsonLines(arguments.out) if arguments.out else None
    rows = {row["seed"]: row for row in (file.values if file else [])}
    is_physics = arguments.physics or arguments.fault
    in_physics, by_plan = partial(carried_out, fault=arguments.fault), partial(planned, saves_time=arguments.saves_time)
    try_scene = in_physics if is_physics else by_plan
    seeds, started = range(arguments.seed, arguments.seed + arguments.scenes), time.monotonic()
    for seed in progress_bar([seed for seed in seeds if seed not in rows]):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        env.reset(seed=seed)
        rows[seed] = {"seed": seed, **try_scene(env, time_limit=arguments.time_limit)}
        if file:
            file.append(rows[seed])
    report(arguments, [rows[seed] for seed in seeds if seed in rows])


def report(arguments: Arguments, rows: list[dict[str, Any]]) -> None:
    """Print the summary, and a line for each scene without success."""
    done = [row for row in rows if row["success"]]
    median, late = np.quantile([row["cpu_s"] for row in rows], (0.5, 0.95))
    bounds = [row for row in done if row["bound"] is not None]
    picks, least = sum(row["picks"] for row in bounds), sum(row["bound"] for row in bounds)
    print(
        f"{arguments.task}, {arguments.objects} objects, {arguments.robot}"
        f"{' with all arms' * arguments.all_arms}"
        f"{f', {arguments.fault}' * bool(arguments.fault)}: {len(done)} of {len(rows)} "
        f"{'clean' if 'sim_s' in rows[0] else 'planned'}; picks / bound {picks} / {least}; CPU time of planning "
        f"{median:.2f} s in the median, 95% {late:.2f} s"
    )
    if times := [row["duration"] for row in done if "duration" in row]:
        print(f"  simulated time of the plans {np.median(times):.1f} s in the median, {sum(times):.1f} s in all")
    if "sim_s" in rows[0]:
        again = Counter(row["replans"] for row in done)
        print(
            f"  simulated time {np.median([row['sim_s'] for row in done]):.0f} s in the median; "
            f"plans made anew: {', '.join(f'{times} × {count}' for count, times in sorted(again.items()))}"
        )
    if arguments.fault:
        print(f"  the fault came in {sum(bool(row['fault']) for row in rows)} episodes")
    for row in rows:
        if not row["success"]:
            print(f"  {row['seed']}: {row['cause']}")


def planned(env: Any, time_limit: float, saves_time: bool = False) -> dict[str, Any]:
    """Plan for the goal of a reset environment."""
    inner = env.unwrapped
    scene = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    before = time.process_time()
    planner = Planner(inner.robot, saves_time=True) if saves_time else None
    found = (planner.solve if planner else solve)(scene, inner.goal, time_limit=time_limit)
    row = {"success": isinstance(found, Solution), "cpu_s": time.process_time() - before}
    if not isinstance(found, Solution):
        return {**row, "cause": f"{found.cause}: {found.detail}"}
    assert found.end is not None
    assert inner.goal.holds(found.end, scene)
    bound = None if found.bound is None else found.bound.least
    return {**row, "picks": found.picks, "bound": bound, "duration": found.duration}


def carried_out(env: Any, time_limit: float, fault: str = "") -> dict[str, Any]:
    """Let the expert bring the goal about in physics, and let a fault happen."""
    expert = TampExpert(env, config=ExpertConfig(planning_s=time_limit))
    tamper, happened, own = FAULTS.get(fault, _nothing), "", (0, 0)
    rng = np.random.default_rng(env.unwrapped.np_random_seed)
    expert.reset()
    plan, info, steps_since = expert.solution, env.unwrapped.info, 0
    for step in played(expert, env.step):
        info = step.info
        steps_since += bool(happened)
        happened = happened or tamper(env.unwrapped, expert, rng)
        if 0 < steps_since <= _SETTLED:
            own = info["num_fallen"], info["num_disturbed"]
    found, force, spoilt = (
        expert.report,
        info["furniture_force"],
        (info["num_fallen"], info["num_disturbed"]),
    )
    done = bool(info["is_success"])
    if happened:
        done = bool(info["lifted"]) and spoilt == own and env.unwrapped.is_gentle
    counts = f"unmet {info['unmet']}, fallen {spoilt[0]}, disturbed {spoilt[1]}, {force:.0f} N"
    return {
        "success": done,
        "cause": "" if done else f"{found.result} ({counts}) {happened}; {'; '.join(found.deviations)}",
        "lifted": bool(info["lifted"]),
        "fault": happened,
        "cpu_s": found.planning_s,
        "sim_s": found.sim_s,
        "replans": found.replans,
        "picks": plan.picks if isinstance(plan, Solution) else 0,
        "bound": plan.bound.least if isinstance(plan, Solution) and plan.bound else None,
    }


# Faults: each returns what it has done, "" as long as its moment has not come.


def _nothing(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:  # noqa: ARG001  as of the faults
    return ""


def push(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:
    """The object to which the gripper comes stands elsewhere."""
    name = _moved_in(expert, "PickUp", "transit")
    return f"{name} is pushed" if name and _put_anywhere(env, name, rng) else ""


def topple(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:
    """Another object than the one to which the gripper comes lies down elsewhere."""
    if not (name := _moved_in(expert, "PickUp", "transit")):
        return ""
    other = str(rng.choice([one.name for one in _free_objects(env, name)]))
    return f"{other} topples" if _put_anywhere(env, other, rng, lying=True) else ""


def drop(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:
    """The object in the gripper is lost, and stands elsewhere."""
    name = _moved_in(expert, "PutDownGeneral", "transit")
    return f"{name} is dropped" if name and _put_anywhere(env, name, rng) else ""


def occupy(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:
    """Another object comes to stand where the one in the gripper is to be put."""
    if not (name := _moved_in(expert, "PutDownGeneral", "transit")):
        return ""
    assert isinstance(expert.solution, Solution)
    released = [action.released for action in expert.solution.actions if action.target == name]
    place = next(body for body in released if body is not None)
    for other in rng.permutation([one.name for one in _free_objects(env, name)]):
        if _put(env, str(other), [*place.position[:2], place.bottom]):
            return f"{other} occupies the place of {name}"
    return ""


def fill(env: Any, expert: TampExpert, rng: np.random.Generator) -> str:
    """A stranger to the goal comes to stand in a region that is still to be filled."""
    name = _moved_in(expert, "PickUp", "transit")
    scene = Scene.from_mujoco(env.model, env.data, env.robot, regions=env.regions)
    wanted = {fact.region for fact in env.goal.placed if hasattr(fact, "region")} if name else set()
    strangers = [one.name for one in _free_objects(env, name) if one.name not in str(env.goal)]
    for region in env.regions:
        if region.name in wanted and not occupants(scene, region.name):
            for other in rng.permutation(strangers):
                if _put(env, str(other), [*region.centre, scene.support_named(region.support).top]):
                    return f"{other} fills {region.name}"
    return ""


FAULTS: dict[str, Callable[[Any, TampExpert, np.random.Generator], str]] = {
    one.__name__: one for one in (push, topple, drop, occupy, fill)
}


def _moved_in(expert: TampExpert, action: str, phase: str) -> str:
    """Name of the object that the action moves if the expert is in that phase of it, else ""."""
    found, _, name = expert.phase.partition(":")[0].partition(" ")
    return name if found == action and expert.phase.endswith(f": {phase}") else ""


def _free_objects(env: Any, but: str) -> list[Any]:
    """The upright objects on which nothing stands, one of them left out."""
    bodies = Scene.from_mujoco(env.model, env.data, env.robot).objects
    return [
        body
        for body in bodies
        if body.name != but
        and body.is_upright
        and all(np.linalg.norm(other.foot - [*body.position[:2], body.top]) > _ABOVE for other in bodies)
    ]


def _put_anywhere(env: Any, name: str, rng: np.random.Generator, lying: bool = False) -> bool:
    """Put an object where neither another one nor the gripper is near on the table; whether there is such a place."""
    face, others = env.world.model.geom(env.support_name), [one for one in env.object_names if one != name]
    near = np.array([env.data.site(env.robot.tcp_site).xpos, *(env.data.body(one).xpos for one in others)])[:, :2]
    for _ in range(300):
        place = rng.uniform(-1, 1, 2) * (face.size[:2] - 0.1)
        is_free = np.linalg.norm(place - near, axis=1).min() > _GAP
        if is_free and _put(env, name, [*place, face.pos[2] + face.size[2]], lying):
            return True
    return False


def _put(env: Any, name: str, foot: Any, lying: bool = False) -> bool:
    """Put an object with its foot at (3,) [m], upright or on its side; not if it would touch more than one thing."""
    joint, geom = env.data.joint(f"{name}_joint"), env.model.geom(name)
    before = joint.qpos.copy()
    height = geom.size[0] if lying else geom.size[2 if geom.type == mujoco.mjtGeom.mjGEOM_BOX else 1]
    joint.qpos[:] = *foot, 1.0, 0.0, 0.0, 0.0
    joint.qpos[2] += height
    if lying:
        joint.qpos[3:5] = math.sqrt(0.5)
    mujoco.mj_forward(env.model, env.data)
    touched = {int(pair) for pair in env.data.contact.geom[(env.data.contact.geom == geom.id).any(axis=1)].ravel()}
    if len(touched - {geom.id}) > 1:
        joint.qpos[:] = before
        mujoco.mj_forward(env.model, env.data)
        return False
    joint.qvel[:] = 0.0
    return True


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
