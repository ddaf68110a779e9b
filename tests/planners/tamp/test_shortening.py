"""Motions between two contacts as one: shorter, free, within the limits, and the same at the contacts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Solution
from planners.motion.contact_free import phases_of
from planners.motion.mujoco_check import TOLERANCE, MujocoCollisionChecker
from planners.motion.timing import round_corners
from planners.motion.trajectory import CONTROL_STEP, Trajectory, join
from planners.tamp import algorithm1
from planners.warming import warmup_scene

TARGET = "object_00"


def plan(monkeypatch: pytest.MonkeyPatch, is_shortened: bool) -> Solution:
    """A plan that clears an object, with or without its motions made one."""
    with monkeypatch.context() as patch:
        if not is_shortened:
            patch.setattr(algorithm1, "shorten", lambda actions, *_: tuple(actions))
        found = Planner(FETCH, grasps="side").solve(warmup_scene(FETCH), TARGET)
    assert isinstance(found, Solution)
    assert found.clearances
    return found


@pytest.fixture(scope="module")
def plans() -> tuple[Solution, Solution]:
    """The same plan, as it was planned action by action and shortened."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        return plan(monkeypatch, is_shortened=False), plan(monkeypatch, is_shortened=True)


def contacts(solution: Solution) -> list[Trajectory]:
    """The phases in which the fingers close on an object or let it go."""
    phases = [phase for action in solution.actions for phase in phases_of(action.trajectory)]
    return [phase for phase in phases if phase.phases[0].name in ("close", "open")]


def test_the_plan_is_the_same_but_for_the_time_it_takes(plans: tuple[Solution, Solution]) -> None:
    planned, shorter = plans
    assert [str(action) for action in planned.actions] == [str(action) for action in shorter.actions]
    for one, other in zip(planned.actions, shorter.actions, strict=True):
        for before, after in zip(one.trajectory.phases, other.trajectory.phases, strict=True):
            assert (before.name, before.held) == (after.name, after.held)
    for one, other in zip(contacts(planned), contacts(shorter), strict=True):
        np.testing.assert_allclose(one.states, other.states, atol=1e-9)
    assert shorter.duration < 0.95 * planned.duration


def test_actions_join_and_start_where_their_scenes_say(plans: tuple[Solution, Solution]) -> None:
    for before, after in itertools.pairwise(plans[1].actions):
        np.testing.assert_allclose(before.trajectory.states[-1], after.trajectory.states[0], atol=1e-9)
    for action in plans[1].actions:
        state, start = action.scene.state, action.trajectory.states[0]
        np.testing.assert_allclose(start, [*state.base, *state.q, state.finger_position])


def test_the_shorter_motions_keep_the_limits_and_touch_nothing(plans: tuple[Solution, Solution]) -> None:
    whole = join([action.trajectory for action in plans[1].actions])
    rates = np.diff(np.hstack([whole.base, whole.q]), axis=0) / CONTROL_STEP
    changes = np.diff(np.vstack([np.zeros(11), rates, np.zeros(11)]), axis=0) / CONTROL_STEP
    assert (np.abs(rates[:, 2:]) <= np.array(FETCH.max_velocity)[2:]).all()
    assert (np.abs(changes[:, 2:]) <= np.array(FETCH.max_acceleration)[2:]).all()
    assert np.hypot(*rates[:, :2].T).max() <= np.hypot(*FETCH.max_velocity[:2])
    assert (np.abs(np.diff(whole.finger_position)) <= FETCH.max_finger_velocity * CONTROL_STEP + 1e-12).all()
    for action in plans[1].actions:
        checker = MujocoCollisionChecker(action.scene)
        assert checker.deepest_penetration(action.trajectory).penetration <= TOLERANCE


def test_base_and_arm_move_together(plans: tuple[Solution, Solution]) -> None:
    def steps_together(solution: Solution) -> int:
        whole = join([action.trajectory for action in solution.actions])
        moves = np.abs(np.diff(np.hstack([whole.base, whole.q]), axis=0)) > 1e-6
        return int((moves[:, :3].any(axis=1) & moves[:, 3:].any(axis=1)).sum())

    assert steps_together(plans[0]) == 0
    assert steps_together(plans[1]) > 20


@pytest.mark.parametrize("half_width", [0.0, 0.07, 0.3, 10.0])
def test_rounded_corners_keep_the_ends_and_stay_near(half_width: float) -> None:
    polygon = np.zeros((4, 11))
    polygon[1:, 4], polygon[2:, 5], polygon[3:, 0] = 1.0, 1.0, 0.5
    path, at = round_corners(FETCH, polygon, half_width)
    np.testing.assert_allclose(path[[0, -1]], polygon[[0, -1]], atol=1e-12)
    assert (at[0], at[-1]) == (0.0, 3.0)
    assert (np.diff(at) >= 0).all()
    on_polygon = np.column_stack([np.interp(at, np.arange(4), column) for column in polygon.T])
    assert np.abs(path - on_polygon).max() <= 0.5 * half_width * max(FETCH.max_velocity) + 1e-9


def test_a_straight_motion_has_no_corners_to_round() -> None:
    ends = np.vstack([np.zeros(11), np.linspace(0.1, 0.5, 11)])
    path, at = round_corners(FETCH, ends, 0.3)
    np.testing.assert_allclose(path, at[:, None] * ends[1], atol=1e-9)
