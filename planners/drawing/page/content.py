"""The content of a page: the scene, the frames, the plans and the results of a recording, as JSON values."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from planners.drawing.page.arrays import ArrayBlock, changes
from planners.drawing.page.geometry import body_poses, model_values, moving_bodies, pose_numbers
from planners.drawing.page.layers import plan_values
from planners.expert.report import Frame, Note, Recording, Solve

__all__ = ["frame_values", "note_values", "page_text", "scene_values", "solve_values"]


def page_text(recording: Recording, title: str, rows: Mapping[str, str], result: str) -> str:
    """A whole recording as JSON text.

    Args:
        recording: what is shown.
        title: of the page.
        rows: the report, names and values.
        result: "success", "failure", "plan", or "running" for an episode that goes on.
    """
    arrays, bodies = ArrayBlock(), moving_bodies(recording.model)
    content = {
        **scene_values(recording, bodies, arrays),
        "title": title,
        "result": result,
        "frames": frame_values(recording, recording.frames, bodies, arrays),
        "solves": [solve_values(solve, arrays) for solve in recording.solves],
        "notes": note_values(recording.notes),
        "rows": list(rows.items()),
    }
    return arrays.text(content)


def scene_values(recording: Recording, bodies: Sequence[int], arrays: ArrayBlock) -> dict[str, Any]:
    """What does not change: shapes, objects, the target."""
    model = recording.model
    indices = {model.body(body).name: index for index, body in enumerate(bodies)}
    return {
        **model_values(model, bodies, arrays),
        "num_bodies": len(bodies),
        "objects": [{"name": name.rpartition("/")[2], "body": indices[name]} for name in recording.objects],
        "target": recording.target,
    }


def frame_values(
    recording: Recording, frames: Sequence[Frame], bodies: Sequence[int], arrays: ArrayBlock
) -> dict[str, Any]:
    """Times, poses, and what the robot does, of some frames of a recording."""
    poses = body_poses(recording.model, bodies, (frame.qpos for frame in frames))
    phases = sorted({frame.phase for frame in frames})
    return {
        "times": arrays.add([frame.time for frame in frames]),
        "poses": arrays.add(changes(pose_numbers(poses)), "int16"),
        "solve": arrays.add([frame.solve for frame in frames], "int16"),
        "action": arrays.add([frame.action for frame in frames], "int16"),
        "phase": arrays.add([phases.index(frame.phase) for frame in frames], "int16"),
        "phases": phases,
    }


def solve_values(solve: Solve, arrays: ArrayBlock) -> dict[str, Any]:
    """A plan with its layers, or the reason why there is none."""
    outcome: Any = solve.outcome
    plan = plan_values(outcome, arrays) if getattr(outcome, "actions", ()) else {"actions": [], "choices": []}
    history = [
        {
            "plan": list(turn.plan),
            "verified": turn.verified,
            "facts": list(turn.new_facts),
            "reason": turn.reason,
        }
        for turn in solve.outcome.stats.history
    ]
    return {"time": round(solve.time, 3), "summary": solve.outcome.summary(), "history": history, **plan}


def note_values(notes: Sequence[Note]) -> list[dict[str, Any]]:
    """Deviations; those at one time and of one text count once."""
    return [{"time": round(time, 3), "text": text} for (time, text), _ in itertools.groupby(notes)]
