"""Text about an episode: the plan as in Fig. 13 of Lee & Kim 2019, replanning as in Fig. 11, the report."""

from __future__ import annotations

from collections.abc import Sequence

from planners.expert.report import EpisodeReport
from planners.symbolic.problem import GroundAction, format_plan
from planners.tamp.solution import ReplanRecord, Solution

__all__ = ["plan_text", "replanning_text", "report_rows", "report_text"]

_FACTS = 8
"""Maximum number of new facts printed for one replanning step."""


def plan_text(solution: Solution, robot: str = "fetch") -> str:
    """The plan F as the paper prints it, one action a line, with the robot's name."""
    by = f" (obstructed by {', '.join(solution.clearances)})" if solution.clearances else ""
    plan = format_plan((GroundAction(action.name, action.args) for action in solution.actions), robot)
    return f"Goal: grasp the {solution.target}{by}\n\n{plan}"


def replanning_text(history: Sequence[ReplanRecord]) -> str:
    """For each task plan: its actions, the verified ones (+), the refuted one (x), and the facts learnt from it."""
    return "\n\n".join(_step(number, entry) for number, entry in enumerate(history, start=1))


def _step(number: int, entry: ReplanRecord) -> str:
    lines = [f"Task plan {number}"]
    for index, action in enumerate(entry.plan):
        mark = "+" if index < entry.verified else "x" if index == entry.verified else " "
        lines.append(f"  {mark} {action}")
    lines.append("  refuted; new facts in the initial state:" if entry.new_facts else "  refuted")
    lines += [f"    {fact}" for fact in entry.new_facts[:_FACTS]]
    if len(entry.new_facts) > _FACTS:
        lines.append(f"    ... and {len(entry.new_facts) - _FACTS} more")
    return "\n".join(lines)


def report_rows(report: EpisodeReport, is_success: bool, lifted: bool) -> dict[str, str]:
    """The results of the episode by name; `is_success` and `lifted` are what the environment says."""
    return {
        "success": "yes, by the environment" if is_success else f"no: {report.failure or _reason(lifted)}",
        "target lifted": "yes" if lifted else "no",
        **report.rows(),
    }


def report_text(report: EpisodeReport, is_success: bool, lifted: bool) -> str:
    """The rows of the report, one a line."""
    rows = report_rows(report, is_success, lifted)
    width = max(map(len, rows))
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in rows.items())


def _reason(lifted: bool) -> str:
    """Why an episode is no success although the expert reports no failure."""
    return "an object has fallen or been disturbed" if lifted else "the target was not held up"
