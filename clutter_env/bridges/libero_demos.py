"""Demonstrations of LIBERO's tasks in the layout of its own files; each is kept only if it replays.

    clutter-env collect --env libero:libero_goal/3 --states 0-19 --python venv-libero/bin/python

An episode is played, and its actions are then played again in another environment of LIBERO's, which has the cameras.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clutter_env.bridges.libero_tasks import SETTLE, LiberoTask
from clutter_env.bridges.remote import BridgeError, Remote
from planners import GoalError, SceneError, TampExpert

IMAGE_SIZE = 128
"""Pixels along each side of the images in LIBERO's own files."""
_HELD = 10
"""Steps for which LIBERO's check must hold before an episode ends, as in robosuite's collection of demonstrations."""
_PLANNING = 60.0
"""[s] of wall time for a plan."""
_OBSERVED = ("agentview_rgb", "eye_in_hand_rgb", "gripper_states", "joint_states", "ee_states")


@dataclass(frozen=True)
class StateResult:
    """What became of a frozen initial state: the steps of its demonstration, or the reason why there is none."""

    state: int
    steps: int = 0
    reason: str = ""


def parse_states(text: str) -> tuple[int, ...]:
    """Numbers of initial states: "0-19", "3" or "0,4,7-9".

    Raises:
        BridgeError: the text is none of these.
    """
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdigit() or (dash and not (last.isdigit() and int(last) >= int(first))):
            raise BridgeError(f"states={text!r} is not valid; for example: 0-19, or 0,4,7-9")
        found += range(int(first), int(last or first) + 1)
    return tuple(dict.fromkeys(found))


def collect_states(
    libero: Remote,
    suite: str,
    task: int,
    states: tuple[int, ...],
    file: Path,
    image_size: int = IMAGE_SIZE,
    report: Callable[[StateResult], None] = lambda _: None,
) -> list[StateResult]:
    """Demonstrate a task from frozen initial states, in their order; those that the file has are not tried again.

    Args:
        libero: the worker.
        suite, task: of LIBERO.
        states: numbers of frozen initial states.
        file: HDF5, made if there is none.
        image_size: [pixels] of both cameras.
        report: called with every result.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    results = []
    for state in _missing(file, states):
        result = _demonstrate(libero, suite, task, state, file, image_size)
        results.append(result)
        report(result)
    return results


def _missing(file: Path, states: tuple[int, ...]) -> Iterator[int]:
    """The states that a file has no demonstration of."""
    there = set[int]()
    if file.exists():
        with h5py.File(file) as content:
            there = {int(demo.attrs["init_state_number"]) for demo in content["data"].values()}
    return (state for state in states if state not in there)


def _demonstrate(libero: Remote, suite: str, task: int, state: int, file: Path, image_size: int) -> StateResult:
    try:
        played = LiberoTask(libero, suite, task, state)
        expert = TampExpert(played.world, planner=played.planner, config=replace(played.config, planning_s=_PLANNING))
        expert.reset()
    except (SceneError, GoalError, BridgeError) as problem:
        return StateResult(state, reason=f"scene: {problem}")
    limit, held = played.limit or np.inf, 0
    while not (expert.done or played.world.is_over) and held < _HELD and played.steps < limit:
        played.world.step(expert.act())
        held = held + 1 if played.is_solved else 0
    if not played.is_solved:
        return StateResult(state, reason=expert.report.failure or "not solved")
    with tempfile.TemporaryDirectory() as folder:
        into = Path(folder) / "seen.npz"
        asked = {"suite": suite, "task": task, "state": state, "settle": SETTLE}
        answer = libero("replay", **asked, actions=played.actions, size=image_size, into=str(into))
        if not answer["is_success"]:
            return StateResult(state, reason="does not replay")
        with np.load(into) as seen:
            _append(file, state, np.array(played.actions), dict(seen), answer)
    return StateResult(state, played.steps)


def _append(file: Path, state: int, actions: Any, seen: dict[str, Any], answer: dict[str, Any]) -> None:
    """Add a demonstration to a file, as LIBERO's `create_dataset.py` lays it out."""
    with h5py.File(file, "a") as content:
        data = content.require_group("data")
        if "problem_info" not in data.attrs:
            info = {
                "problem_name": answer["problem"],
                "domain_name": answer["domain"],
                "language_instruction": answer["language"],
            }
            env = {
                "type": 1,
                "env_name": answer["problem"],
                "problem_name": answer["problem"],
                "bddl_file": answer["bddl_file"],
                "env_kwargs": answer["env_kwargs"],
            }
            data.attrs.update(
                {
                    "env_name": answer["problem"],
                    "problem_info": json.dumps(info),
                    "env_args": json.dumps(env),
                    "bddl_file_name": answer["bddl_file"],
                    "bddl_file_content": answer["bddl"],
                    "macros_image_convention": answer["image_convention"],
                    "num_demos": 0,
                    "total": 0,
                }
            )
        demo = data.create_group(f"demo_{data.attrs['num_demos']}")
        observed = demo.create_group("obs")
        for name in _OBSERVED:
            compressed = {"compression": "gzip"} if name.endswith("_rgb") else {}
            observed.create_dataset(name, data=seen[name], **compressed)
        observed.create_dataset("ee_pos", data=seen["ee_states"][:, :3])
        observed.create_dataset("ee_ori", data=seen["ee_states"][:, 3:])
        last = np.zeros(len(actions), np.uint8)
        last[-1] = 1
        columns = {"states": seen["states"], "robot_states": seen["robot_states"], "rewards": last, "dones": last}
        for name, values in {"actions": actions, **columns}.items():
            demo.create_dataset(name, data=values)
        demo.attrs.update(
            {
                "num_samples": len(actions),
                "model_file": answer["model_file"],
                "init_state": seen["states"][0],
                "init_state_number": state,
            }
        )
        data.attrs["num_demos"] += 1
        data.attrs["total"] += len(actions)
