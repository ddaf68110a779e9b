"""Objects that touch, or nearly, before anything moves: one can be lifted, but comes no nearer to the others."""

from __future__ import annotations

import numpy as np
import pytest

from irm.gjk import are_within
from planners import Solution, solve
from planners.collision.world import SUPPORT_SLACK, CollisionWorld, with_clearance_around
from planners.motion.mujoco_check import MujocoCollisionChecker
from planners.scene import Body, HeldObject, Scene, Solid
from tests.planners.scenes import HEIGHT, UPRIGHT, table_scene


def _close(gap: float, kind: str = "box") -> Scene:
    """An object on the table, and another one beside it at that distance [m], which may be negative."""
    half, place = np.array([0.022, 0.022, 0.08]), np.array([-0.2, 0.0, HEIGHT + 0.08])
    one, other = (
        Body(name, kind, half, place + [0.0, y, 0.0], UPRIGHT)  # type: ignore[arg-type]  # a shape
        for name, y in (("a", 0.0), ("b", 0.044 + gap))
    )
    return table_scene(one, other)


@pytest.mark.parametrize("kind", ["box", "cylinder"])
@pytest.mark.parametrize("gap", [-0.0015, 0.0, 0.0002, 0.001, 0.0024, 0.003, 0.02])
def test_what_is_near_at_the_start_of_a_lift_may_stay_as_near_but_come_no_nearer(gap: float, kind: str) -> None:
    scene = _close(gap, kind)
    world = CollisionWorld.from_scene(scene)
    around = with_clearance_around(world, "a")
    body, reach = scene.body("a"), np.eye(4)
    reach[:3, 3] = (0.0, 0.0, 0.4)  # in the gripper of a robot that is far away
    held = HeldObject("a", reach)
    assert (around.yields > 0.0) == (gap < around.padding + SUPPORT_SLACK)

    def is_hit(by: float) -> bool:
        """Whether the object, as it counts when it is held, is too near to the other one after a move by that much."""
        attached = around.query(0.1, held).attached
        smaller = around.obstacles.pieces._replace(
            half=np.stack([attached.solids.half[0], scene.body("b").half_extents]),
            position=np.stack([body.position + [0.0, by, 0.0], scene.body("b").position]),
        )
        return bool(are_within(smaller, 0, smaller, 1, around.padding, np.empty((4, 3))))

    assert not is_hit(0.0)
    assert is_hit(max(gap, 0.0) + SUPPORT_SLACK + 0.0003)
    assert np.array_equal(around.obstacles.pieces.half, world.obstacles.pieces.half)


@pytest.mark.parametrize("gap", [-0.0015, 0.0, 0.001, 0.0024, 0.003])
def test_a_thin_bowl_that_touches_its_neighbour_may_be_lifted_off_it(gap: float) -> None:
    """Walls of 3 mm made smaller on both sides are in the middle of themselves, where they touched all the same."""
    walls = [
        Solid("wall", (0.0, y, 0.0), (0.05, 0.0015, 0.02), "box")  # type: ignore[arg-type]  # tuples serve
        for y in (-0.05, 0.05)
    ]
    bowl = Body.of_pieces("bowl", walls, (-0.2, 0.0, HEIGHT + 0.02))
    half = np.array([0.022, 0.022, 0.08])
    other = Body("b", "box", half, (-0.2, 0.0735 + gap, HEIGHT + 0.08), UPRIGHT)  # type: ignore[arg-type]  # tuples serve
    scene = table_scene(bowl, other)
    around, reach = with_clearance_around(CollisionWorld.from_scene(scene), "bowl"), np.eye(4)
    reach[:3, 3] = (0.0, 0.0, 0.4)
    counted = around.query(0.1, HeldObject("bowl", reach)).attached.solids

    def is_hit(by: float) -> bool:
        """Whether the wall beside the other object, as it counts when it is held, is too near after such a move."""
        place = np.array((-0.2, by, HEIGHT + 0.02)) + counted.position[1] - reach[:3, 3]
        pieces = around.obstacles.pieces
        two = pieces._replace(
            half=np.stack([counted.half[1], half]),
            position=np.stack([place, other.position]),
            rotation=np.stack([np.eye(3)] * 2),
            core=pieces.core[:2],
            radius=pieces.radius[:2],
        )
        return bool(are_within(two, 0, two, 1, around.padding, np.empty((4, 3))))

    assert not is_hit(0.0)
    assert is_hit(max(gap, 0.0) + SUPPORT_SLACK + 0.0003)


@pytest.mark.parametrize("gap", [0.0, 0.001, 0.003])
def test_an_object_that_touches_its_neighbour_is_lifted_beside_it(gap: float) -> None:
    found = solve(_close(gap), "a", rng=np.random.default_rng(0))
    assert isinstance(found, Solution), found
    assert not found.clearances
    for action in found.actions:
        checker = MujocoCollisionChecker(action.scene)
        assert checker.deepest_penetration(action.trajectory).penetration < 0.001


@pytest.mark.parametrize("tilt", [0.0, 0.02, 0.05])
def test_an_object_that_leans_on_one_and_presses_into_another_is_lifted(tilt: float) -> None:
    """A cube that has come to rest on two others: it is deeper in one than a contact, and beside the edge of the other.

    Both count as under it, and lowered by the padding they were still in the way.
    """
    half, cosine, sine = np.full(3, 0.01), np.cos(tilt / 2), np.sin(-tilt / 2)
    turned = (cosine, 0.0, sine, 0.0)
    low, leaning = np.array([-0.004, 0.0, HEIGHT + 0.01]), np.array([-0.03, 0.0, HEIGHT + 0.0106])
    # Its lowest corner, which is over nothing, is as deep as the tilt makes it.
    top = np.array([-0.0112, 0.0, HEIGHT + 0.0294 - 0.004 * tilt])
    bodies = [
        Body("low", "box", half, low, UPRIGHT),
        Body("leaning", "box", half, leaning, (np.cos(tilt), 0.0, np.sin(-tilt), 0.0)),  # type: ignore[arg-type]  # tuples serve
        Body("top", "box", half, top, turned),  # type: ignore[arg-type]  # tuples serve
    ]
    scene = table_scene(*bodies)
    around, row, reach = with_clearance_around(CollisionWorld.from_scene(scene), "top"), scene.index("top"), np.eye(4)
    reach[:3, 3] = (0.0, 0.0, 0.4)
    counted = around.obstacles.pieces.half.copy()
    counted[row] = around.query(0.1, HeldObject("top", reach)).attached.solids.half[0]
    pieces = around.obstacles.pieces._replace(half=counted)
    hit = [other for other in range(2) if are_within(pieces, row, pieces, other, around.padding, np.empty((4, 3)))]
    assert not hit
