"""Motions between two contacts as one: shorter, free, within the limits, and the same at the contacts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from assets.robots import FETCH
from planners import Planner, Solution, solve
from planners.collision.world import STEP, CollisionWorld
from planners.motion.arm import tcp_poses
from planners.motion.path import CLEARANCE, WholeBodyPath
from planners.motion.timing import round_corners
from planners.motion.trajectory import CONTROL_STEP, Trajectory, is_contact, join, phases_of
from planners.scene import SELF_BIT, Scene
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.solution import BoundAction
from planners.warming import warmup_scene
from tests.planners.pieces import bowl
from tests.planners.plans import assert_free
from tests.planners.scenes import HEIGHT, random_scene, random_shelf, table_scene

TARGET = "object_00"
OFF_LINE = 0.001
"""[m] off the planned lines, as `planners.motion.contact_free` counts it."""


def plan(monkeypatch: pytest.MonkeyPatch, scene: Scene, target: str, is_shortened: bool) -> Solution:
    """A plan that clears an object, with or without its motions made one."""
    with monkeypatch.context() as patch:
        if not is_shortened:
            patch.setattr(MotionLayer, "shortened", lambda _, actions, _end: tuple(actions))
        found = Planner(FETCH, grasps="side").solve(scene, target)
    assert isinstance(found, Solution)
    assert found.clearances
    return found


@pytest.fixture(scope="module")
def plans() -> tuple[Solution, Solution]:
    """The same plan, as it was planned action by action and shortened."""
    return both_plans(warmup_scene(FETCH), TARGET)


def both_plans(scene: Scene, target: str) -> tuple[Solution, Solution]:
    with pytest.MonkeyPatch.context() as monkeypatch:
        return plan(monkeypatch, scene, target, False), plan(monkeypatch, scene, target, True)


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
    assert_free(plans[1])


def test_a_plan_that_saves_time_keeps_the_limits_and_touches_nothing() -> None:
    found = Planner(FETCH, grasps="side", saves_time=True).solve(warmup_scene(FETCH), TARGET)
    assert isinstance(found, Solution)
    whole = join([action.trajectory for action in found.actions])
    rates = np.diff(np.hstack([whole.base, whole.q]), axis=0) / CONTROL_STEP
    changes = np.diff(np.vstack([np.zeros(11), rates, np.zeros(11)]), axis=0) / CONTROL_STEP
    assert (np.abs(rates[:, 2:]) <= np.array(FETCH.max_velocity)[2:]).all()
    assert (np.abs(changes[:, 2:]) <= np.array(FETCH.max_acceleration)[2:]).all()
    assert_free(found)


def test_base_and_arm_move_together(plans: tuple[Solution, Solution]) -> None:
    def steps_together(solution: Solution) -> int:
        whole = join([action.trajectory for action in solution.actions])
        moves = np.abs(np.diff(np.hstack([whole.base, whole.q]), axis=0)) > 1e-6
        return int((moves[:, :3].any(axis=1) & moves[:, 3:].any(axis=1)).sum())

    assert steps_together(plans[0]) == 0
    assert steps_together(plans[1]) > 20


@pytest.mark.parametrize(("seed", "target"), [(1, "object_01"), (4, "object_01")])
def test_in_a_shelf_the_robot_keeps_its_distance_where_it_drives_off_the_planned_lines(seed: int, target: str) -> None:
    """The base lags behind by some mm; on a line with a rigid arm that changes nothing, elsewhere it needs room."""
    planned, shorter = both_plans(random_shelf(12, seed), target)
    checked = 0
    for before, after in zip(motions_between_contacts(planned), motions_between_contacts(shorter), strict=True):
        as_planned = np.vstack([phase.states[:, :-1] for _, phase in before])
        for action, phase in after:
            world, held = CollisionWorld.from_scene(action.scene, CLEARANCE - STEP / 2), phase.phases[0]
            X = phase.states[:, :-1]
            is_off = np.array([distance(world, x, as_planned) > 3 * OFF_LINE for x in X])
            drives = np.abs(np.diff(X[:, :3], axis=0)).max(axis=1) > 1e-6
            for k in np.flatnonzero(is_off[:-1] & is_off[1:] & drives):
                opening = FETCH.opening(phase.finger_position[k])
                hits = world.path_hits(X[k : k + 2], opening, held.touched if held.held else None, 1 << SELF_BIT)
                assert not hits, (action, held.name, world.names_of(hits))
                checked += 1
    assert checked > 20


def motions_between_contacts(solution: Solution) -> list[list[tuple[BoundAction, Trajectory]]]:
    """The phases between contacts, with their actions."""
    phases = [(action, phase) for action in solution.actions for phase in phases_of(action.trajectory)]
    groups = itertools.groupby(phases, key=lambda pair: is_contact(pair[1].phases[0]))
    return [list(group) for in_contact, group in groups if not in_contact]


def distance(world: CollisionWorld, x: np.ndarray, polygon: np.ndarray) -> float:
    """[m] Upper bound of how far any point of the robot is from where it is on a polygon of configurations (n, 11)."""
    reach = world.robot.reach
    start, along = polygon[:-1] * reach, np.diff(polygon, axis=0) * reach
    share = ((x * reach - start) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
    nearest = start + np.clip(share, 0.0, 1.0)[:, None] * along
    return float(np.abs(x * reach - nearest).sum(axis=1).min())


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


def test_a_plan_that_mujoco_refutes_at_the_end_is_made_again_with_every_motion_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, refusal, asked = random_scene(25, 3), MotionLayer.refusal, []
    expected = solve(scene, "object_07", grasps="side")
    assert isinstance(expected, Solution)

    def refuse_at_the_end(self: MotionLayer, scene: Scene, paths: Sequence[WholeBodyPath | Trajectory]) -> str:
        asked.append(self.checks_at_end)
        return "two bodies overlap" if self.checks_at_end else refusal(self, scene, paths)

    monkeypatch.setattr(MotionLayer, "refusal", refuse_at_the_end)
    again = solve(scene, "object_07", grasps="side")
    assert set(asked) == {True, False}
    assert isinstance(again, Solution)
    for one, other in zip(expected.actions, again.actions, strict=True):
        assert np.array_equal(one.trajectory.states, other.trajectory.states)


def test_what_is_held_at_its_rim_is_lifted_before_anything_turns() -> None:
    scene = table_scene(bowl("bowl", (0.05, 0.1, HEIGHT)))
    found = Planner(FETCH, grasps="all").solve(scene, "bowl")
    assert isinstance(found, Solution)
    phases = [phase for action in found.actions for phase in phases_of(action.trajectory)]
    number = next(k for k, phase in enumerate(phases) if phase.phases[0].name == "close")
    robot = CollisionWorld.from_scene(scene).robot
    after = tcp_poses(robot, np.vstack([phase.states[:, :-1] for phase in phases[number + 1 :]]))
    before = tcp_poses(robot, np.vstack([phase.states[:, :-1] for phase in phases[:number]]))[::-1]
    contact = after[0]
    beside = np.linalg.norm(contact[:2, 3] - scene.body("bowl").position[:2])
    assert beside > 0.05, "at its rim"
    top = scene.body("bowl").position[2] + scene.body("bowl").half_extents[2] - contact[2, 3]
    for poses, height in ((after, 0.5 * beside), (before, top)):
        straight = poses[: np.argmax(poses[:, 2, 3] > contact[2, 3] + height)]
        assert len(straight) > 3
        np.testing.assert_allclose(straight[:, :2, 3], np.tile(contact[:2, 3], (len(straight), 1)), atol=0.002)
        np.testing.assert_allclose(straight[:, :3, :3], np.tile(contact[:3, :3], (len(straight), 1, 1)), atol=0.01)
