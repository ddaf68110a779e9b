"""Laws of antipodal grasps: where the pads touch, that nothing else is in their way, and which objects they are for."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from assets import RobotSpec
from assets.robots import FETCH, robot as find_robot
from planners import AntipodalFamily, Cause, Infeasible, Region, Solution, goals, solve
from planners.collision.world import PADDING, CollisionWorld
from planners.grasping import antipodal
from planners.grasping.arm_configurations import gripper_hits
from planners.grasping.candidates import gripper_poses
from planners.grasping.families import GRASP_SETS, SIDE, TOP, GraspFamily, InvalidGraspFamily, families_for
from planners.grasping.grasp_poses import GraspPose, generate_grasps, gripper_clearances, too_wide
from planners.scene import Body, Scene, Solid
from tests.planners.pieces import bottle, bottle_with_shoulder, bowl, cut_in_two, mug
from tests.planners.scenes import HEIGHT, cylinder, table_scene

ANTIPODAL = tuple(family for family in GRASP_SETS["all"] if isinstance(family, AntipodalFamily))
LYING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
AT = (0.1, -0.2, HEIGHT)


def standing(body: Body, yaw: float = 0.0) -> Body:
    return body.at(body.position, (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))


THINGS = {
    "mug": mug(position=AT),
    "turned mug": standing(mug(position=AT), 0.7),
    "bottle": bottle(position=AT),
    "lying bottle": bottle().at((0.1, -0.2, HEIGHT + 0.035), LYING),
    "bowl": bowl(position=AT),
}


def grasps_of(body: Body) -> list[tuple[AntipodalFamily, GraspPose]]:
    return [(family, grasp) for family in ANTIPODAL for grasp in generate_grasps(body, FETCH, (family,))]


def closes_on_faces(body: Body, grasp: GraspPose, friction: float) -> bool:
    """Whether a fine walk along the closing line, through the TCP or what the tips hold just ahead of it, is inside the
    object between two points as far from the TCP as each other, with normals within the friction cone."""
    along, ahead = grasp.T_world_tcp[:3, 1], grasp.T_world_tcp[:3, 0]
    steps, least = np.linspace(-0.06, 0.06, 601), math.cos(math.atan(friction)) - 1e-6
    for depth in (0.0, 0.012):
        points = grasp.T_world_tcp[:3, 3] + depth * ahead + steps[:, None] * along
        inside = np.any([is_inside(piece, points) for piece in body.placed], axis=0)
        inside &= np.abs(steps) <= grasp.opening / 2
        if inside.any() and abs(steps[inside][0] + steps[inside][-1]) < 0.001:
            ends = zip(points[inside][[0, -1]], (-along, along), strict=True)
            if all(any(normal @ out > least for normal in normals_at(body, end)) for end, out in ends):
                return True
    return False


def is_inside(piece, points: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]  # a Solid
    normals, away = piece.planes
    return (points @ normals.T <= away + 1e-6).all(axis=1)


@pytest.mark.parametrize("name", THINGS)
def test_the_pads_close_on_two_opposite_faces_and_touch_nothing_before(name: str) -> None:
    body, gripper = THINGS[name], gripper_clearances(FETCH)
    world, found = CollisionWorld.from_scene(table_scene(body), PADDING - 1e-6), grasps_of(body)
    assert len(found) > 10
    for family, grasp in found[::5]:
        R = grasp.T_world_tcp[:3, :3]
        assert np.allclose(R.T @ R, np.eye(3))
        assert R[2, 1] == 0.0, "the fingers close along a level line"
        assert math.asin(-R[2, 0]) == pytest.approx(family.pitch)
        assert grasp.T_world_tcp[2, 3] > body.bottom + gripper.above_support(family.pitch) - 1e-9
        assert grasp.opening <= FETCH.max_opening
        assert closes_on_faces(body, grasp, family.friction)
        heavy = body.mass_centre
        assert family.lever[0] <= np.linalg.norm((grasp.T_world_tcp[:3, 3] - heavy)[:2]) < family.lever[1]
    for opening in {grasp.opening for _, grasp in found}:
        poses = gripper_poses([grasp for _, grasp in found if grasp.opening == opening])
        assert not (gripper_hits(world, poses, opening) & np.uint64(1)).any()


def test_what_the_fingers_touch_first_is_the_face_that_they_hold() -> None:
    """A gripper around a bottle's neck closed on its shoulder, which is as high as the lower edges of the fingers."""
    body = bottle_with_shoulder(AT)
    world = CollisionWorld.from_scene(table_scene(body), 0.0)
    found = [grasp for _, grasp in grasps_of(body)]
    assert any(grasp.T_world_tcp[2, 3] - HEIGHT > 0.19 for grasp in found), "none at the neck"
    for grasp in found:
        if -grasp.T_world_tcp[2, 0] < 0.1 and grasp.T_world_tcp[2, 3] - HEIGHT > 0.17:
            assert not (gripper_hits(world, gripper_poses([grasp]), 0.031) & np.uint64(1)).any()


def normals_at(body: Body, point: np.ndarray) -> Iterator[np.ndarray]:
    """The normals (3,) of the pieces on whose surface a point lies."""
    for piece in body.placed:
        normals, away = piece.planes
        beyond = point @ normals.T - away
        if abs(beyond.max()) < 0.0005:
            yield normals[beyond.argmax()]


@pytest.mark.parametrize("inset", [0.004, 0.012, 0.02])
def test_lines_are_as_far_from_the_ends_of_a_wall_as_their_family_wants(inset: float) -> None:
    """The tips of an arm that comes within 6 mm of its grasp missed a wall 6 mm below its rim."""
    wall, family = Solid("wall", np.zeros(3), np.array((0.002, 0.03, 0.025))), replace(ANTIPODAL[0], inset=inset)
    heading, up = np.array((0.0, 1.0, 0.0)), np.array((0.0, 0.0, 1.0))
    lines = antipodal._grid(wall, heading, up, -1.0, family)
    assert np.abs(lines).max(axis=0) == pytest.approx(np.array((0.03, 0.025)) - inset)


def test_grasps_turn_with_the_object_and_are_the_same_for_equal_objects() -> None:
    turn, one, other = 1.1, mug(position=AT), standing(mug(position=AT), 1.1)
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
    for (_, before), (_, after) in zip(grasps_of(one), grasps_of(other), strict=True):
        assert np.allclose(after.T_world_tcp[:3, :3], R @ before.T_world_tcp[:3, :3], atol=1e-9)
        away = before.T_world_tcp[:3, 3] - one.position
        assert np.allclose(after.T_world_tcp[:3, 3], other.position + R @ away, atol=1e-9)
    for (_, before), (_, after) in zip(grasps_of(one), grasps_of(mug(position=AT)), strict=True):
        assert np.array_equal(before.T_world_tcp, after.T_world_tcp)


def test_a_box_and_the_same_box_cut_in_two_are_grasped_alike() -> None:
    whole = Body("box", "box", np.array((0.02, 0.03, 0.06)), np.array((0.1, 0.2, HEIGHT + 0.06)), (1.0, 0, 0, 0))
    for pitch in (0.0, 0.7, math.pi / 2):
        family = AntipodalFamily("own", pitch, directions=4)
        widths = [
            {round(grasp.opening, 6) for grasp in generate_grasps(body, FETCH, (family,))}
            for body in (whole, cut_in_two(whole))
        ]
        assert widths[0] == widths[1] == {0.064, 0.084}


def test_the_family_of_a_grasp_set_depends_on_the_object() -> None:
    for families in GRASP_SETS.values():
        assert all(isinstance(one, GraspFamily) for one in families_for(cylinder("a", 0, 0), families))
        assert all(isinstance(one, AntipodalFamily) for one in families_for(mug(), families))
    assert families_for(cylinder("a", 0, 0), ANTIPODAL) == ANTIPODAL
    assert families_for(mug(), (SIDE, TOP)) == ()


def test_what_cannot_be_grasped_across_two_faces_is_refused_with_the_grasps_that_it_is_proved_for() -> None:
    flared, top = bowl(position=AT, slope=0.05), GRASP_SETS["top"]
    assert too_wide(bowl(position=AT), FETCH, top) == ""
    assert "friction cones" in too_wide(flared, FETCH, top)
    assert too_wide(flared, FETCH, (AntipodalFamily("wide", math.pi / 2, friction=2.0),)) == ""
    assert "no family of grasps is an AntipodalFamily" in too_wide(flared, FETCH, (SIDE, TOP))
    scene = table_scene(flared, cylinder("other", -0.1, 0.3))
    found = solve(scene, "bowl", grasps=(SIDE,))
    assert isinstance(found, Infeasible)
    assert found.cause is Cause.TOO_WIDE
    assert "AntipodalFamily, with the grasps of families 'side'" in found.detail


@pytest.mark.parametrize(
    "values",
    [
        {"pitch": 2.0},
        {"friction": 0.0},
        {"spacing": -1.0},
        {"most": 0},
        {"directions": 0},
        {"inset": 0.0},
        {"lever": (0.1, 0.0)},
    ],
)
def test_values_out_of_range_are_named(values: dict[str, object]) -> None:
    with pytest.raises(InvalidGraspFamily, match=f"own.*{next(iter(values))}"):
        AntipodalFamily("own", **{"pitch": 0.0, **values})  # type: ignore[arg-type]  # on purpose


@pytest.fixture(scope="module")
def crowded() -> Scene:
    """A mug in a corner, between cylinders."""
    others = [cylinder(f"object_{k:02d}", x, y) for k, (x, y) in enumerate([(-0.2, -0.1), (-0.1, 0.3), (-0.25, 0.1)])]
    return table_scene(mug("mug", (0.0, 0.0, HEIGHT)), *others)


def test_a_mug_is_put_into_a_region_and_stands_there(crowded: Scene) -> None:
    region = Region("left", crowded.support.name, (0.0, 0.3), (0.12, 0.12))
    scene = replace(crowded, regions=(region,))
    plan = solve(scene, goals.inside("mug", "left"), rng=np.random.default_rng(0))
    assert isinstance(plan, Solution), plan
    assert plan.picks == 1
    (put,) = (action.released for action in plan.actions if action.released is not None)
    assert region.contains(put)
    assert put.bottom == pytest.approx(HEIGHT, abs=0.002)
    assert not region.contains(scene.body("mug"))


def test_what_is_too_low_for_its_edge_to_be_held_is_refused_with_both_heights() -> None:
    """A plate: that there are no two faces within the friction cones was said, which was not why."""
    edge = [
        Solid.hull(
            f"edge {k}", [(r * np.cos(a), r * np.sin(a), z) for r in (0.066, 0.07) for a in turns for z in (0, 0.016)]
        )
        for k in range(12)
        for turns in [np.array((k, k + 1)) * np.pi / 6]
    ]
    disc = Solid("disc", np.array((0.0, 0.0, 0.002)), np.array((0.066, 0.066, 0.002)), "cylinder")
    plate = Body.of_pieces("plate", [disc, *edge], AT)
    told = too_wide(plate, FETCH, GRASP_SETS["all"])
    assert re.match(
        r"plate is too low: the pads could hold it up to 10 mm above .*, and the fingertips need \d\d mm", told
    )
    assert too_wide(bowl(position=AT), FETCH, GRASP_SETS["all"]) == ""


@pytest.fixture(scope="module")
def short_fingered(tmp_path_factory: pytest.TempPathFactory) -> RobotSpec:
    """A Panda whose fingertips reach 2.3 mm beyond the TCP."""
    robot = find_robot("panda_mobile")
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for name in robot.finger_joints:
        spec.joint(name).parent.pos[2] -= 0.0067
    spec.compile()
    path = tmp_path_factory.mktemp("robot") / "short.xml"
    path.write_text(spec.to_xml())
    return replace(robot, mjcf=str(path))


@pytest.mark.parametrize("name", THINGS)
def test_the_object_is_between_the_fingers_however_short_they_are(short_fingered: RobotSpec, name: str) -> None:
    body, reach = THINGS[name], gripper_clearances(short_fingered).fingertips
    depths, steps = np.linspace(-0.02, reach, 9), np.linspace(-0.5, 0.5, 201)
    for family in ANTIPODAL:
        for grasp in generate_grasps(body, short_fingered, (family,)):
            R, middle = grasp.T_world_tcp[:3, :3], grasp.T_world_tcp[:3, 3]
            points = middle + depths[:, None, None] * R[:, 0] + grasp.opening * steps[:, None] * R[:, 1]
            assert np.any([is_inside(piece, points.reshape(-1, 3)) for piece in body.placed]), grasp
