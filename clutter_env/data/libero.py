"""Demonstrations in the layout of LIBERO's own HDF5 files, as a LeRobot dataset (format v3.0) with language.

A frame has what is seen before its action. LIBERO's files have what is seen after it, so their first action has no
frame. Images are turned by half a turn and the state has eight numbers, as LeRobot's environment of LIBERO has them:
position of the gripper [m], its rotation vector [rad], and the positions of both fingers [m].
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from clutter_env.data.lerobot import Frames, write_frames
from clutter_env.errors import DatasetError
from clutter_env.reporting.files import written_atomically

_FPS = 20
_CAMERAS = {"image": "agentview_rgb", "image2": "eye_in_hand_rgb"}
"""LeRobot's names of LIBERO's cameras."""
_NAMES = {
    "observation.state": ["x", "y", "z", "rx", "ry", "rz", "finger1", "finger2"],
    "action": ["dx", "dy", "dz", "drx", "dry", "drz", "gripper"],
}


def export_libero(file: Path, directory: Path, tick: Callable[[], object] = lambda: None) -> int:
    """Write the demonstrations of a file, all of one task, and return their number.

    Args:
        file: HDF5 in LIBERO's layout, as `clutter-env collect --env libero:` makes it.
        directory: a new directory.
        tick: called after each episode.

    Raises:
        DatasetError: the directory exists, or the file has no demonstration.
        LearningError: pyarrow or PyAV is not installed.
    """
    if directory.exists():
        raise DatasetError(f"{directory} exists; choose another directory or remove it")
    with h5py.File(file) as content, written_atomically(directory) as part:
        data = content.get("data", {})
        demos = sorted(data, key=lambda name: int(name.rpartition("_")[2]))
        if not demos:
            raise DatasetError(f"{file} has no demonstrations in LIBERO's layout")
        task = str(json.loads(data.attrs["problem_info"])["language_instruction"])
        part.mkdir(parents=True)
        write_frames(part, (_frames(data[name]) for name in demos), len(demos), _FPS, "panda", task, tick)
    return len(demos)


def _frames(demo: Any) -> Frames:
    """Frames of a demonstration of T + 1 actions: T."""
    seen, rewards = demo["obs"], demo["rewards"][1:]
    state = np.hstack((seen["ee_states"][:-1], seen["gripper_states"][:-1]))
    columns = {
        "observation.state": state.astype(np.float32),
        "action": demo["actions"][1:].astype(np.float32),
        "next.reward": rewards.astype(np.float32),
        "next.done": demo["dones"][1:].astype(bool),
        "next.success": rewards > 0,
    }
    images = {name: np.ascontiguousarray(seen[entry][:-1][:, ::-1, ::-1]) for name, entry in _CAMERAS.items()}
    return Frames(columns, images, _NAMES)
