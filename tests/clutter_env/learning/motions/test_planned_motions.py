"""Motions of plans that are not simulated, and their phases under a board."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import assets  # noqa: E402
import clutter_env  # noqa: E402, F401  registers the environments
from assets.robots import FETCH  # noqa: E402
from clutter_env.policies.registry import load_policy, policy_grasps  # noqa: E402
from clutter_env.training.motion_examples import cut_at_corners, is_driven  # noqa: E402
from clutter_env.learning.training.bc import examples_of  # noqa: E402
from clutter_env.learning.keyframes.fit import FitConfig  # noqa: E402
from clutter_env.training.motion_fit import fit_keyframes  # noqa: E402
from clutter_env.training.motion_demonstrations import Motion  # noqa: E402
from clutter_env.policies.motion.network import KeyframeNetwork  # noqa: E402
from clutter_env.learning.keyframes.phases import BOARD_PHASES  # noqa: E402
from clutter_env.policies.motion.network_input import DRIVEN, PHASES  # noqa: E402
from clutter_env.training.motion_demonstrations import planned_motions  # noqa: E402
from clutter_env.learning.policies.runs import MOVER_FILE  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from planners.motion.arm import tcp_pose  # noqa: E402
from planners.scene import RobotState  # noqa: E402

OPEN = Task("clutter_env/Retrieve-o5-v0", {"obstructed": True})
SHELF = Task("clutter_env/Retrieve-o10-v0", {"layout": "shelf", "obstructed": True})


@pytest.fixture(scope="module")
def in_the_open() -> list[Motion]:
    return list(planned_motions(OPEN.make(), "all", range(6)))


@pytest.fixture(scope="module")
def under_a_board() -> list[Motion]:
    return list(planned_motions(SHELF.make(), "side", range(2)))


def gripper_at(keyframe: np.ndarray) -> np.ndarray:
    return tcp_pose(FETCH, RobotState(keyframe[:3], keyframe[3:11], 0.0))


def ends(motion: Motion) -> dict[str, np.ndarray]:
    """The keyframe of each phase."""
    return {phase: motion.keyframes[steps.stop - 1] for phase, steps in motion.runs()}


def test_a_planned_motion_shows_what_a_demonstration_shows(in_the_open: list[Motion]) -> None:
    for motion in in_the_open:
        assert not is_driven(motion)
        names = PHASES[motion.contact.skill]
        assert set(ends(motion)) - {"home"} <= set(names)
        last = ends(motion)["approach" if motion.contact.skill == "pick" else "lower"]
        np.testing.assert_allclose(gripper_at(last), motion.contact.tcp, atol=1e-6)
        np.testing.assert_allclose(motion.reading.tcp[-1], gripper_at(motion.keyframes[-1]), atol=1e-5)
        assert len(motion.reading.base) == len(motion.phases) + 1


def test_all_grasps_are_shown_level_and_tilted(in_the_open: list[Motion]) -> None:
    pitches = {round(float(np.degrees(np.arcsin(-motion.contact.tcp[2, 0])))) for motion in in_the_open}
    assert {0, 60} <= pitches


def test_under_a_board_the_arm_is_rigid_on_the_drives_between_corners(under_a_board: list[Motion]) -> None:
    assert {motion.contact.skill for motion in under_a_board} == {"pick", "place"}
    for motion in under_a_board:
        assert is_driven(motion)
        cut = cut_at_corners(motion)
        found = ends(cut)
        assert [name for name in found if name in BOARD_PHASES[motion.contact.skill]] == [
            name for name in BOARD_PHASES[motion.contact.skill] if name in found
        ]
        assert set(DRIVEN) <= set(found)
        for one, other in (("transit", "enter"), ("enter", "reach"), ("back", "leave")):
            np.testing.assert_allclose(found[one][3:11], found[other][3:11], atol=1e-9)
        np.testing.assert_allclose(found["reach"][:2], motion.contact.base[:2], atol=1e-6)
        np.testing.assert_allclose(gripper_at(found["reach"])[:2, 3], motion.contact.tcp[:2, 3], atol=1e-6)
        along = found["reach"][:2] - found["enter"][:2]
        np.testing.assert_allclose(along, 0.1 * motion.contact.tcp[:2, 0], atol=1e-6)
        for phase, steps in cut.runs():
            if phase in DRIVEN:
                q = motion.reading.q[steps]
                np.testing.assert_allclose(q, np.broadcast_to(q[0], q.shape), atol=1e-6)


def test_a_network_says_what_it_was_fitted_to(
    in_the_open: list[Motion], under_a_board: list[Motion], tmp_path: Path
) -> None:
    for motions, is_under_board in ((in_the_open, False), (under_a_board, True)):
        examples = examples_of(FETCH, motions)
        assert examples.is_under_board == is_under_board
        network = fit_keyframes(FETCH, examples, FitConfig(steps=2, batch=16))
        network.save(tmp_path / "network.npz")
        loaded = KeyframeNetwork.load(tmp_path / "network.npz")
        assert loaded.is_under_board == is_under_board
        assert loaded.has_seen("pick", "lift")
        assert loaded.has_seen("pick", "approach") != is_under_board
    assert not KeyframeNetwork.load(assets.path("policies/keyframes-side.npz")).is_under_board


def test_a_mover_is_trained_from_plans_alone(tmp_path: Path) -> None:
    run = Run(SHELF, "keyframes", 2, tmp_path / "run", episodes=1, evaluation_episodes=1)
    (entry,) = train(run).history
    assert entry["motions"] >= 3
    assert KeyframeNetwork.load(tmp_path / "run" / MOVER_FILE).is_under_board


@pytest.mark.parametrize("problem", ["all", "shelf"])
def test_policies_of_the_further_problems_are_built_in(problem: str) -> None:
    for name in ("keyframes", "planned-decisions", "planned-motions"):
        policy = load_policy(f"{name}-{problem}", seed=0)
        assert policy_grasps(policy) == ("all" if problem == "all" else "side")
