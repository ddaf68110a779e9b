"""Grasps as data: families of the user's, what they refuse, and refusals that name what they hold for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from assets import FETCH, PR2, InvalidRobot, RobotSpec
from planners import SIDE, Cause, GraspFamily, Infeasible, Planner, Scene, Solution, clearance_floor, solve
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import gripper_hits
from planners.grasping.candidates import gripper_poses
from planners.grasping.families import GRASP_SETS, InvalidGraspFamily, UnknownGraspSet, grasp_set_name
from planners.grasping.grasp_poses import GraspPose, generate_grasps, gripper_clearances, too_wide
from planners.scene import Body
from tests.planners.scenes import HEIGHT, cylinder, random_scene, shelf_scene, table_scene

STEEP = GraspFamily("steep", math.radians(70), directions=8, depth=0.03)


@pytest.mark.parametrize("pitch", [0.0, 1e-9, math.radians(30), math.pi / 2])
@pytest.mark.parametrize("depth", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("robot", [FETCH, PR2], ids=lambda robot: robot.name)
def test_a_family_of_any_pitch_and_depth_holds_the_object_with_half_a_pad_at_least(
    robot: RobotSpec, pitch: float, depth: float
) -> None:
    body = cylinder("a", 0.0, 0.0)
    grasps = generate_grasps(body, robot, (GraspFamily("own", pitch, depth=depth),))
    assert grasps
    for grasp in grasps:
        assert np.isfinite(grasp.T_world_tcp).all()
        assert grasp.T_world_tcp[2, 3] <= body.top - gripper_clearances(robot).pad_half_height + 1e-9


def test_the_values_of_a_family_are_those_of_its_grasps() -> None:
    body = cylinder("a", 0.0, 0.0)
    family = GraspFamily("own", 0.0, directions=6, height=0.05, axis_offset=0.01)
    grasps = generate_grasps(body, FETCH, (family,))
    assert len(grasps) == 6
    for grasp in grasps:
        position, heading = grasp.T_world_tcp[:3, 3], grasp.T_world_tcp[:3, 0]
        assert position[2] == pytest.approx(body.bottom + 0.05)
        np.testing.assert_allclose(body.position[:2] - position[:2], 0.01 * heading[:2], atol=1e-12)
    level = replace(family, height=None, axis_offset=None, directions=24)
    for one, other in zip(generate_grasps(body, FETCH, (level,)), generate_grasps(body, FETCH, (SIDE,)), strict=True):
        assert np.array_equal(one.T_world_tcp, other.T_world_tcp)
    assert not generate_grasps(body, FETCH, (replace(family, max_width=0.05),))


def test_straight_down_pads_wider_than_the_object_fit_beside_its_neighbour() -> None:
    """Cubes of 2 cm stand 5 mm apart, one a little behind the other: only at its far half is there room for a pad."""
    half = np.full(3, 0.01)
    cube = Body("cube", "box", half, np.array([-0.1, 0.0, HEIGHT + 0.01]), np.eye(4)[0])
    other = Body("other", "box", half, np.array([-0.075, 0.022, HEIGHT + 0.01]), np.eye(4)[0])
    world = CollisionWorld.from_scene(table_scene(cube, other))

    def free(offset: float | None) -> list[GraspPose]:
        down = GraspFamily("down", math.pi / 2, depth=0.02, axis_offset=offset)
        grasps = [one for one in generate_grasps(cube, FETCH, (down,)) if abs(math.sin(one.yaw)) < 0.5]
        hits = gripper_hits(world, gripper_poses(grasps), grasps[0].opening, ignore=world.scene.mask(["cube"]))
        return [grasp for grasp, hit in zip(grasps, hits, strict=True) if not hit]

    assert not free(None)
    beside = free(0.008)
    assert len(beside) == 1, "on the far side of the other cube"
    T = beside[0].T_world_tcp
    np.testing.assert_allclose(T[:2, 3] - cube.position[:2], -0.008 * T[:2, 2], atol=1e-9)


def test_the_gripper_opens_as_far_as_its_robot_says() -> None:
    body = cylinder("a", 0.0, 0.0)
    wide, narrow = (generate_grasps(body, replace(FETCH, finger_gap=gap))[0].opening for gap in (0.012, 0.005))
    assert wide - narrow == pytest.approx(2 * 0.007)
    assert wide == generate_grasps(body, FETCH)[0].opening
    with pytest.raises(InvalidRobot, match="finger_gap"):
        replace(FETCH, finger_gap=0.0)


@pytest.mark.parametrize(
    "values",
    [
        {"pitch": -0.1},
        {"pitch": 2.0},
        {"pitch": math.nan},
        {"directions": 0},
        {"depth": -0.01},
        {"height": math.nan},
        {"axis_offset": math.inf},
        {"max_width": -1.0},
        {"depth": 0.02, "height": 0.03},
        {"shape": "pieces"},
    ],
    ids=str,
)
def test_a_family_with_a_value_out_of_range_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(InvalidGraspFamily, match="own"):
        GraspFamily("own", **{"pitch": 0.0, **values})  # type: ignore[arg-type]  # on purpose


@pytest.mark.parametrize("grasps", ["sideways", (), [], 3, ("side",), (SIDE, "top"), None], ids=repr)
def test_what_is_no_grasp_set_is_refused_with_the_valid_names(grasps: object) -> None:
    with pytest.raises(UnknownGraspSet, match="side, tilted, top, all"):
        Planner(FETCH, grasps=grasps)  # type: ignore[arg-type]  # on purpose


def test_a_family_for_one_shape_takes_no_other() -> None:
    round_one, square = cylinder("round", 0.0, 0.0), replace(cylinder("square", 0.0, 0.0), shape="box")
    family = GraspFamily("own", 0.0, shape="cylinder")
    assert generate_grasps(round_one, FETCH, (family,))
    assert not generate_grasps(square, FETCH, (family,))
    assert generate_grasps(square, FETCH, (family, SIDE))
    assert too_wide(square, FETCH, (family,)) == "no family of grasps is for square, a box"


def test_a_plan_is_made_of_the_grasps_of_the_families_given() -> None:
    scene = random_scene(8, 3)
    found = solve(scene, "object_02", grasps=[STEEP], rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    for action in found.actions:
        if action.name == "PickUp":
            assert action.grip is not None
            T = np.linalg.inv(action.grip[1].T_tcp_object)  # the pose of the TCP in the frame of the object
            assert math.asin(-T[2, 0]) == pytest.approx(STEEP.pitch, abs=1e-3)
    for name, families in GRASP_SETS.items():
        by_name, by_family = (clearance_floor(scene, "object_02", grasps=one) for one in (name, families))
        assert by_name == by_family
        assert repr(name) in by_name.grasps


def test_what_is_wider_than_the_gripper_is_said_to_be_too_wide() -> None:
    wide = cylinder("wide", -0.1, 0.0, radius=0.06)
    scene = table_scene(wide, cylinder("behind", 0.05, 0.0))
    found, floor = solve(scene, "wide"), clearance_floor(scene, "wide")
    assert isinstance(found, Infeasible)
    assert (found.cause, floor.cause) == (Cause.TOO_WIDE, Cause.TOO_WIDE)
    assert floor.is_infeasible
    assert "120 mm wide" in found.detail
    assert "opens 102 mm" in found.detail
    narrow = GraspFamily("narrow", 0.0, max_width=0.05)
    found = solve(scene, "behind", grasps=(narrow,))
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TOO_WIDE
    assert "take 50 mm at most" in found.detail
    assert not too_wide(scene.body("behind"), FETCH, (SIDE,))


def _refused() -> tuple[Scene, str]:
    """Under a board so low that no gripper fits above the object, and only level grasps could."""
    return shelf_scene(cylinder("object_00", 0.0, 0.0, height=0.39)), "object_00"


def test_a_refusal_names_the_grasps_that_it_holds_for() -> None:
    scene, target = _refused()
    found = solve(scene, target, grasps="top")
    assert isinstance(found, Infeasible)
    assert f"with the grasps of {grasp_set_name(GRASP_SETS['top'])}" in found.detail
    assert grasp_set_name((STEEP, SIDE)) == "families 'steep', 'side'"
    assert grasp_set_name(GRASP_SETS["side"]) == "'side'"
    assert grasp_set_name((*GRASP_SETS["all"], STEEP)) == "'all' and families 'steep'"
