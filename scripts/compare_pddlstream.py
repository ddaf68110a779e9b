"""The problems of PDDLStream's example `packed`, by their planner and by ours: solved, picks, CPU time.

    python scripts/compare_pddlstream.py --folder pddlstream --python other-environment/bin/python

A PR2 puts all blocks (7 x 7 x 10 cm) from a table onto a plate of 27 x 27 cm that lies on it. Both planners have the
same poses, the left arm, grasps from above, any side of the table. Theirs is a checkout of caelan/pddlstream with its
submodules and its FastDownward built, in a Python with `pybullet`; it is run as it is. In place of the plate, 1 mm
thick, ours has a region of the table of the same size.
"""

from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import tyro

from assets import PR2
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from planners import Scene, Solution, solve, warmup
from planners.goals import Goal, Region, inside

WORKER = Path(__file__).with_name("pddlstream_worker.py")
ROBOT = PR2.using("left")
TABLE_TOP, START = 0.73, (-1.0, 0.0)
"""[m] height of the table; where the base stands at first."""
PLATE = Region("plate", "table", (0.0, 0.0), (0.135, 0.135))
BLOCK = (
    '<body name="block_{}" pos="{} {} {}" quat="{} {} {} {}"><freejoint/><geom type="box" size=".035 .035 .05"/></body>'
)
LEG = '<geom type="cylinder" size="0.015 0.35" pos="{} {} 0.35"/>'
WORLD = """<mujoco><include file="{robot}"/><worldbody>
  <geom name="floor" type="plane" size="0 0 1"/>
  <geom name="table" type="box" size="0.3 0.6 0.015" pos="0 0 0.715"/>
  {legs} {blocks}
</worldbody></mujoco>"""


@dataclass(frozen=True)
class Arguments:
    """What to compare.

    Attributes:
        folder: of PDDLStream.
        python: which has what PDDLStream needs.
        blocks: their numbers; 5 is the example's own.
        seeds: how many problems of each number.
        seconds: wall time that each planner may take; 120 is the example's own.
        file: results; problems that stand in it are not solved again.
    """

    folder: Path
    python: Path
    blocks: tuple[int, ...] = (1, 3, 5, 7)
    seeds: int = 10
    seconds: int = 120
    file: Path = Path("outputs/compare_pddlstream.jsonl")


def main(arguments: Arguments) -> None:
    """Solve all problems by both planners, and print the table."""
    records = JsonLines(arguments.file)
    known = {tuple(record["problem"]) for record in records.values}
    problems = [(number, seed) for seed in range(arguments.seeds) for number in arguments.blocks]
    warmup(ROBOT)
    for number, seed in progress_bar([one for one in problems if one not in known], desc="comparing", unit="problem"):
        theirs = their_answer(arguments, number, seed)
        records.append({"problem": [number, seed], "theirs": theirs, "ours": our_answer(theirs["blocks"], arguments)})
    found = {tuple(record["problem"]): record for record in records.values}
    rows = [
        row(number, who, [found[one][who] for one in problems if one[0] == number])
        for number in arguments.blocks
        for who in ("theirs", "ours")
    ]
    head = (
        "blocks",
        "planner",
        "solved",
        "picks of those solved",
        "CPU s of those solved, median",
        "largest",
        "CPU s, all",
    )
    print(markdown_table(head, rows), end="")


def row(number: int, who: str, answers: list[dict[str, Any]]) -> list[str]:
    """Row of the table for one planner."""
    solved = [answer for answer in answers if answer["solved"]]
    cpu = [answer["cpu_s"] for answer in solved] or [np.nan]
    return [
        str(number),
        {"theirs": "PDDLStream", "ours": "clutter-env"}[who],
        f"{len(solved)} of {len(answers)}",
        str(sum(answer["picks"] for answer in solved)),
        f"{np.median(cpu):.2f}",
        f"{max(cpu):.2f}",
        f"{sum(answer['cpu_s'] for answer in answers):.0f}",
    ]


def their_answer(arguments: Arguments, number: int, seed: int) -> dict[str, Any]:
    """PDDLStream's answer, with the poses of the blocks."""
    command = [str(arguments.python.absolute()), str(WORKER.absolute()), str(arguments.folder), str(number), str(seed)]
    run = subprocess.run(
        [*command, str(arguments.seconds)], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise RuntimeError(f"PDDLStream has ended with code {run.returncode}:\n{run.stderr}")
    answer: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return answer


def our_answer(blocks: list[list[float]], arguments: Arguments) -> dict[str, Any]:
    """Our answer to the same problem."""
    scene = scene_of(blocks)
    goal = Goal.of(inside(scene.names[0], PLATE.name))
    for name in scene.names[1:]:
        goal &= inside(name, PLATE.name)
    before, started = time.process_time(), time.perf_counter()
    found = solve(scene, goal, grasps="top", time_limit=arguments.seconds)
    times = {"cpu_s": time.process_time() - before, "wall_s": time.perf_counter() - started}
    if not isinstance(found, Solution):
        return {"solved": False, "picks": 0, "cause": str(found), **times}
    if found.end is None or not goal.holds(found.end, scene):
        raise RuntimeError(f"the plan's end does not reach its goal: {found.summary()}")
    return {"solved": True, "picks": found.picks, "sim_s": found.duration, **times}


def scene_of(blocks: list[list[float]]) -> Scene:
    """Our scene with blocks at these poses: x, y, z [m], quaternion x, y, z, w."""
    standing = [
        BLOCK.format(number, x, y, TABLE_TOP + 0.05, qw, qx, qy, qz)
        for number, (x, y, _, qx, qy, qz, qw) in enumerate(blocks)
    ]
    legs = "".join(LEG.format(x, y) for x in (-0.285, 0.285) for y in (-0.585, 0.585))
    model = mujoco.MjModel.from_xml_string(WORLD.format(robot=ROBOT.mjcf_path, legs=legs, blocks="".join(standing)))
    data = mujoco.MjData(model)
    for joint, value in zip(ROBOT.drive_joints, (*START, 0.0, *ROBOT.home), strict=True):
        data.joint(joint).qpos = value
    mujoco.mj_forward(model, data)
    names = [f"block_{number}" for number in range(len(blocks))]
    return Scene.from_mujoco(model, data, ROBOT, movable=names, support="table", regions=(PLATE,))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
