"""Household goals in physics: is a goal that the planner's geometry calls reached a success of the environment?

    python -m scripts.goal_judges run outputs/judges.jsonl
    python -m scripts.goal_judges table outputs/judges.jsonl

Scenes are those of `goal_measures.py` with household objects, other than for "clear". The default expert plans and
carries out; at the end `goal.unmet` of the scene as it is then is compared with `is_success`. Two kinds of difference
are told apart: the judges disagree about a fact, which is a defect; or all facts hold for both, and the environment
asks for more, that nothing was shoved or thrown over: then that is named. `run` goes on where it ended.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from clutter_env.envs.success import TOTAL_PATH
from clutter_env.policies.playing import played
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from planners import ExpertConfig, Infeasible, Scene, TampExpert, warmup
from planners.goals import Goal
from scripts.goal_measures import CASES, FIRST_SEED, TASKS, opened

FIRST = FIRST_SEED + 1000 * len(CASES)
"""Far from the scenes of `goal_measures.py`."""
PLAYED = [k for k, (task, _, objects) in enumerate(CASES) if objects == "household" and task != "clear"]
"""The cases that are played, in each run through all cases."""
ELSEWHERE = "an object ended more than 2 cm from where it was carried to"
"""The reason that is left if no other one is: see `goal_monitor.SETTLING`."""


@dataclass(frozen=True)
class Run:
    """Play the scenes that a file lacks."""

    out: tyro.conf.Positional[Path]
    """File of JSON lines."""
    scenes: int = 200
    planning_s: float = 60.0
    """[s] of wall time for one solve."""
    minutes: float = 60.0
    """[min] of wall time after which no scene is begun."""


@dataclass(frozen=True)
class Table:
    """Print what a file holds: a row for each task, and each scene that is judged differently."""

    file: tyro.conf.Positional[Path]


def main(command: Run | Table) -> None:
    """Do what is asked."""
    match command:
        case Run():
            run(command)
        case Table(file):
            report(JsonLines(file).values)


def run(arguments: Run) -> None:
    """Play scene after scene, and print the table."""
    file, started = JsonLines(arguments.out), time.monotonic()
    known = {row["seed"] for row in file.values}
    seeds = [FIRST + len(CASES) * (k // len(PLAYED)) + PLAYED[k % len(PLAYED)] for k in range(arguments.scenes)]
    warmup()
    for seed in progress_bar([seed for seed in seeds if seed not in known]):
        if time.monotonic() - started > 60 * arguments.minutes:
            break
        file.append(play(seed, arguments.planning_s))
    report(file.values)


def play(seed: int, planning_s: float) -> dict[str, Any]:
    """One line: what planner and environment say of the last state of an episode."""
    env, task, layout, *_ = opened(seed)
    inner = env.unwrapped
    start = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    expert = TampExpert(env, config=ExpertConfig(planning_s=planning_s))
    expert.reset()
    row = {"seed": seed, "task": task, "layout": layout, "count": len(start.objects), "goal": str(inner.goal)}
    if isinstance(expert.solution, Infeasible):
        env.close()
        return {**row, "refused": f"{expert.solution.cause}: {expert.solution.detail}"}
    info, spoilt = inner.info, list[str]()
    for step in played(expert, env.step):
        before, info = info, step.info
        if any(info[name] > before[name] for name in ("num_fallen", "num_disturbed")):
            spoilt.append(f"{expert.phase}: fallen {info['num_fallen']}, disturbed {info['num_disturbed']}")
    end = Scene.from_mujoco(inner.model, inner.data, inner.robot, regions=inner.regions)
    unmet = inner.goal.unmet(end, start)
    row |= {
        "refused": "",
        "unmet": [str(Goal((fact,))) for fact in unmet],
        "unmet_by_environment": info["unmet"],
        "is_success": info["is_success"],
        "why": why_no_success(info, inner.is_gentle),
        "spoilt": spoilt,
        "expert": expert.report.result,
        "replans": expert.report.replans,
        "sim_s": expert.report.sim_s,
    }
    env.close()
    return row


def why_no_success(info: dict[str, Any], is_gentle: bool) -> str:
    """What the environment asks for besides the facts of the goal, and did not get; "" for nothing."""
    reasons = {
        "an object fell": info["num_fallen"] > 0,
        "an object slid more than 5 cm": info["num_disturbed"] > 0,
        "objects slid more than 10 cm together": info["total_path"] > TOTAL_PATH,
        "the robot pressed hard": not is_gentle,
        "the hand had not let go for 0.5 s": not info["lifted"] and not info["unmet"],
        "the simulation was unstable": info["unstable"],
    }
    found = [reason for reason, is_so in reasons.items() if is_so]
    return ", ".join(found or [ELSEWHERE] if not info["is_success"] else [])


# The table.


def report(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each task, and what differs."""
    columns = ("task", "scenes", "refused", "played", "reached for both", "judged the same", "differently")
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for task in (*TASKS, "all"):
        if of_task := [row for row in rows if task in (row["task"], "all")]:
            print(f"| {task} | {' | '.join(map(str, _counts(of_task)))} |")
    done = [row for row in rows if not row["refused"]]
    others = [row for row in done if bool(row["unmet"]) == row["is_success"]]
    disagree = [row for row in done if bool(row["unmet"]) != bool(row["unmet_by_environment"])]
    print(f"\n{len(disagree)} in which the judges disagree about facts")
    print(f"{len(others)} judged differently: {Counter(row['why'] for row in others)}")
    for row in others + [row for row in disagree if row not in others]:
        print(f"  {_name(row)}: unmet {row['unmet'] or 'nothing'}, by the environment {row['unmet_by_environment']}")
        print(f"    {row['why']}; {'; '.join(row['spoilt'])}")
    failed = [row for row in done if row["unmet"] and not row["is_success"]]
    print(f"{len(failed)} in which both say that the goal is not reached")
    for row in failed:
        print(f"  {_name(row)}: {len(row['unmet'])} facts, by the environment {row['unmet_by_environment']}")
        print(f"    {row['why']}; the expert: {row['expert']}")


def _counts(rows: Sequence[dict[str, Any]]) -> tuple[int, ...]:
    done = [row for row in rows if not row["refused"]]
    reached = sum(not row["unmet"] and row["is_success"] for row in done)
    same = sum(bool(row["unmet"]) != row["is_success"] for row in done)
    return len(rows), len(rows) - len(done), len(done), reached, same, len(done) - same


def _name(row: dict[str, Any]) -> str:
    return f"{row['seed']} {row['task']} {row['layout']} {row['count']}"


if __name__ == "__main__":
    main(
        tyro.cli(
            Annotated[Run, tyro.conf.subcommand("run")] | Annotated[Table, tyro.conf.subcommand("table")],
            description=__doc__,
        )
    )
