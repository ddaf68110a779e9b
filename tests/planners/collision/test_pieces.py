"""Objects of several convex pieces: their measures, and the collision checks of them beside a slow twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.collision.scene_arrays import body_solids, obstacle_arrays, with_object
from planners.collision.world import CollisionWorld
from planners.motion.arm import tcp_pose
from planners.placing.goal_places import distances
from planners.placing.negative_goal_region import SupportGrid, footprint_mask
from planners.scene import Body, HeldObject, SceneError, Solid
from planners.scene.bodies import release_pitch
from tests.planners.collision.slow_gjk import distance
from tests.planners.motion_scenes import mixed_scene
from tests.planners.pieces import bottle, cut_in_two, mug


def test_what_is_between_the_fingers_is_measured_at_the_pads() -> None:
    body = mug()
    centre = np.mean([piece.position for piece in body.pieces if piece.name.startswith("wall")], axis=0)

    def width(point: tuple[float, float, float], axis: tuple[float, float, float]) -> float:
        """Of the mug where the TCP is at a point, the fingers closing along a level axis."""
        T = np.eye(4)
        T[:3, 0], T[:3, 1] = np.cross(axis, (0, 0, 1)), axis
        T[:3, 3] = centre + point
        return body.width_in_gripper(np.linalg.inv(T) @ np.block([[np.eye(3), np.zeros((3, 1))], [0, 0, 0, 1.0]]))

    assert width((0.0, 0.0, 0.02), (0.0, 1.0, 0.0)) == pytest.approx(0.076, abs=0.001)  # both walls
    assert width((0.0, 0.036, 0.04), (0.0, 1.0, 0.0)) == pytest.approx(0.004, abs=0.001)  # the rim
    assert width((0.068, 0.0, 0.0), (0.0, 1.0, 0.0)) == pytest.approx(0.010, abs=0.001)  # the handle


def test_an_object_of_pieces_is_as_large_as_their_hull_and_rests_on_its_faces() -> None:
    body = mug(position=(1.0, 0.2, 0.7))
    assert body.bottom == pytest.approx(0.7)
    assert body.top == pytest.approx(0.8)
    assert (np.linalg.norm(body.corners[:, :2] - body.position[:2], axis=1) <= body.radius + 1e-12).all()
    for pitch in (0.0, 0.5, np.pi / 2):
        c, s = np.cos(pitch), np.sin(pitch)
        T = np.eye(4)
        T[:3, :3] = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]
        assert release_pitch(body, HeldObject("mug", np.linalg.inv(T))) == pytest.approx(pitch, abs=0.001)
    with pytest.raises(SceneError, match="no pieces"):
        Body.of_pieces("air", [])


def test_hits_of_objects_of_pieces_are_those_of_their_nearest_piece() -> None:
    scene = mixed_scene(6, 0)
    rng, names = np.random.default_rng(0), scene.names[:4]
    tetrahedron = Solid.hull("hull", 0.05 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)]))
    ball = Solid("ball", np.array((0.1, 0.0, 0.0)), np.full(3, 0.03), "sphere")
    bodies = [mug(names[0]), Body.of_pieces(names[1], [tetrahedron, ball]), *scene.objects[2:4]]
    bodies = [body.at(before.position) for body, before in zip(bodies, scene.objects, strict=False)]
    world = CollisionWorld.from_scene(replace(scene, objects=tuple(bodies)))
    solids, seen = body_solids(bodies[0]), 0
    base, q = scene.state.base, scene.state.q
    T_tcp_world = np.linalg.inv(tcp_pose(scene.robot, scene.state))
    by_robot = world.hits(base, q, 0.1, ignore=1)
    for trial in range(24):
        other = 1 + trial % 3
        held = bodies[0].at(bodies[other].position + rng.uniform(-0.09, 0.09, 3), rng.normal(size=4))
        solids, arrays = body_solids(held), with_object(world.obstacles, 0, held)
        assert np.array_equal(arrays.pieces.position[: len(solids.core)], solids.position)
        hits = world.hits(base, q, 0.1, HeldObject(names[0], T_tcp_world @ held.pose))
        rows = world.obstacles.rows(other)
        gap = min(distance(solids, i, world.obstacles.pieces, j) for i in range(len(solids.core)) for j in rows)
        if abs(gap - world.padding) > 1e-4 and not by_robot >> other & 1:
            assert bool(hits >> other & 1) == (gap < world.padding)
            seen += 1 if gap < world.padding else 100
    assert seen > 200
    assert seen % 100 > 2


def test_arrays_of_a_scene_of_simple_objects_have_one_solid_each() -> None:
    scene = mixed_scene(6, 0)
    arrays = obstacle_arrays(scene)
    assert arrays.first.tolist() == list(range(len(scene.objects) + 1))
    assert np.array_equal(arrays.pieces.position, arrays.centre)


def test_an_object_cut_in_two_is_the_same_to_every_check() -> None:
    scene, rng = mixed_scene(6, 0), np.random.default_rng(1)
    name = scene.names[0]
    whole = Body(name, "box", np.array((0.03, 0.05, 0.08)), scene.objects[0].position, (0.8, 0.1, 0.2, 0.5))
    cut, grid = cut_in_two(whole), SupportGrid(-0.6, -0.6, 0.005, (240, 240), scene.support.top)
    for direction in rng.normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        assert cut.reach(unit) == pytest.approx(whole.reach(unit), abs=1e-12)
    points = whole.position[:2] + rng.uniform(-0.2, 0.2, (200, 2))
    lying = [one.at(one.position, (0.8, 0.0, 0.0, 0.6)) for one in (whole, cut)]
    assert np.allclose(*(distances(points, one) for one in lying), atol=1e-12)
    assert np.array_equal(*(footprint_mask(grid, [one], 0.006) for one in lying))
    worlds = [CollisionWorld.from_scene(replace(scene, objects=(one, *scene.objects[1:]))) for one in (whole, cut)]
    T_tcp_world, seen = np.linalg.inv(tcp_pose(scene.robot, scene.state)), set()
    for other in range(12):
        turn = rng.normal(size=4)
        near = scene.objects[1 + other % 4].position + rng.uniform(-0.09, 0.09, 3)
        moved = whole.at(near, turn / np.linalg.norm(turn))
        held = HeldObject(name, T_tcp_world @ moved.pose)
        hits = [world.hits(scene.state.base, scene.state.q, 0.1, held, ignore=1) for world in worlds]
        assert hits[0] == hits[1]
        seen.add(hits[0])
    assert len(seen) > 3


@pytest.mark.parametrize("body", [mug(), bottle()], ids=lambda body: body.name)
def test_the_distance_from_above_is_that_to_the_nearest_point_of_a_piece(body: Body) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.15, 0.15, (40, 2))
    inside = [rng.dirichlet(np.ones(len(one.outline)), 2000) @ one.outline for one in body.placed]
    edges = [np.linspace(one.outline, np.roll(one.outline, 1, axis=0), 40).reshape(-1, 2) for one in body.placed]
    near = np.concatenate((*inside, *edges))
    slow = np.linalg.norm(points[:, None] - near, axis=2).min(axis=1)
    fast = distances(points, body)
    assert (fast <= slow + 1e-12).all()
    assert np.allclose(fast, slow, atol=0.004 + (fast == 0) * 0.01)
    assert (distances(near, body) < 1e-9).all()
    outside = np.abs(body.outline - body.position[:2]).max(axis=0)
    assert outside == pytest.approx(body.half_extents[:2], abs=0.001)
