"""Objects of several convex pieces: their measures, and the collision checks of them beside a slow twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planners.collision.scene_arrays import body_solids, obstacle_arrays, with_object
from planners.collision.world import CollisionWorld
from planners.motion.arm import tcp_pose
from planners.scene import Body, HeldObject, SceneError, Solid
from planners.scene.bodies import release_pitch
from tests.planners.collision.slow_gjk import distance
from tests.planners.motion_scenes import mixed_scene


def mug(name: str = "mug", position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Body:
    """A floor, eight wall pieces and a handle of three boxes."""
    pieces = [Solid("floor", np.array((0.0, 0.0, 0.003)), np.array((0.038, 0.038, 0.003)), "cylinder")]
    for k in range(8):
        turn = k * np.pi / 4
        c, s = np.cos(turn), np.sin(turn)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        at = R @ (0.036, 0.0, 0.05)
        pieces.append(Solid(f"wall {k}", at, np.array((0.002, 0.0155, 0.05)), "box", R))
    for height in (0.03, 0.08):
        pieces.append(Solid(f"arm {height}", np.array((0.053, 0.0, height)), np.array((0.015, 0.005, 0.005))))
    pieces.append(Solid("grip", np.array((0.068, 0.0, 0.055)), np.array((0.005, 0.005, 0.03))))
    return Body.of_pieces(name, pieces, position)


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
