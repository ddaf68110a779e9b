"""Demonstrations of a world with names like LIBERO's: what is kept, and how it is laid out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import h5py
import numpy as np
import pytest

from clutter_env.bridges.libero_demos import collect_states, parse_states
from clutter_env.bridges.remote import BridgeError, Remote
from tests.clutter_env.bridges.test_libero_tasks import Recorded

SOLVED_AFTER, SIZE, STATE = 4, 8, 23
COLUMNS = {"gripper_states": 2, "joint_states": 7, "ee_states": 6, "states": STATE, "robot_states": 9}


class Played(Recorded):
    """A worker that calls the task solved after some steps, and whose replays end as they are told to."""

    def __init__(self, replays: bool) -> None:
        super().__init__(("on", "can_1", "box_1"))
        self.replays, self.steps, self.replayed = replays, 0, list[Any]()

    def __call__(self, call: str = "", *_: Any, **given: Any) -> dict[str, Any]:
        if call == "replay":
            self.replayed.append(given["actions"])
            shapes = {name: (width,) for name, width in COLUMNS.items()}
            shapes |= dict.fromkeys(("agentview_rgb", "eye_in_hand_rgb"), (SIZE, SIZE, 3))
            count = len(given["actions"])
            np.savez(given["into"], **{name: np.full((count, *shape), 7) for name, shape in shapes.items()})
            said = dict.fromkeys(("bddl_file", "bddl", "problem", "domain", "language", "image_convention"), "it")
            return {"is_success": self.replays, "model_file": "<mujoco/>", "env_kwargs": {}, **said}
        self.steps = self.steps + 1 if call == "step" else 0
        return {**self.start, "is_success": self.steps >= SOLVED_AFTER}


def test_an_episode_that_replays_is_kept_in_the_layout_of_liberos_files(tmp_path: Path) -> None:
    file, worker = tmp_path / "demos.hdf5", Played(replays=True)
    states = (4, 7)
    results = collect_states(cast(Remote, worker), "libero_goal", 3, states, file, SIZE)
    assert [(one.state, one.reason) for one in results] == [(4, ""), (7, "")]
    with h5py.File(file) as content:
        data = content["data"]
        assert (data.attrs["num_demos"], data.attrs["total"]) == (2, sum(one.steps for one in results))
        for number, (result, actions) in enumerate(zip(results, worker.replayed, strict=True)):
            demo = data[f"demo_{number}"]
            assert result.steps == demo.attrs["num_samples"] >= SOLVED_AFTER
            np.testing.assert_array_equal(demo["actions"], actions)
            assert np.abs(actions).max() <= 1.0
            assert demo["rewards"][()].sum() == demo["rewards"][-1] == demo["dones"][-1] == 1
            assert set(demo["obs"]) == {
                "agentview_rgb",
                "eye_in_hand_rgb",
                "gripper_states",
                "joint_states",
                "ee_states",
                "ee_pos",
                "ee_ori",
            }
            assert demo["obs/agentview_rgb"].shape == (result.steps, SIZE, SIZE, 3)
            assert demo["obs/ee_ori"].shape == (result.steps, 3)
            assert demo["states"].shape == (result.steps, STATE)
    assert collect_states(cast(Remote, worker), "libero_goal", 3, states, file, SIZE) == []


def test_an_episode_that_does_not_replay_is_not_kept(tmp_path: Path) -> None:
    file = tmp_path / "demos.hdf5"
    (result,) = collect_states(cast(Remote, Played(replays=False)), "libero_goal", 3, (0,), file, SIZE)
    assert result.reason == "does not replay"
    assert not file.exists()


def test_states_are_ranges_and_numbers() -> None:
    assert parse_states("0,4,7-9, 4") == (0, 4, 7, 8, 9)
    for wrong in ("", "a", "3-1", "1-"):
        with pytest.raises(BridgeError, match="0-19"):
            parse_states(wrong)
