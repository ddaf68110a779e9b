"""Laws of the pitch at which a held object is released, and of how it then rests."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planners.placing.locations import put_down, rotated
from planners.scene import Body, HeldObject
from planners.scene.bodies import release_pitch
from tests.planners.scenes import HEIGHT, table_scene

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
LYING = np.array([math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0])
"""The object's z axis points along the world's x."""


def body(shape: str, quaternion: np.ndarray) -> Body:
    half = np.array((0.03, 0.03, 0.08) if shape == "cylinder" else (0.025, 0.02, 0.08))
    return Body("object_00", shape, half, np.array([0.1, 0.0, 1.2]), quaternion)


def held_at(thing: Body, pitch: float, yaw: float = 0.0) -> HeldObject:
    """The object taken by a gripper 2 cm above its centre."""
    T_world_tcp = rotated(yaw, pitch)
    T_world_tcp[:3, 3] = thing.position + (0.0, 0.0, 0.02)
    return HeldObject(thing.name, np.linalg.inv(T_world_tcp) @ thing.pose)


@pytest.mark.parametrize("shape", ["cylinder", "box"])
@pytest.mark.parametrize("pitch", np.radians((-5.0, 0.0, 20.0, 40.0, 60.0, 90.0)))
def test_what_stood_when_it_was_taken_is_released_at_the_pitch_of_the_grasp(shape: str, pitch: float) -> None:
    thing = body(shape, UPRIGHT)
    assert release_pitch(thing, held_at(thing, pitch)) == pytest.approx(pitch, abs=1e-3)


@pytest.mark.parametrize("shape", ["cylinder", "box"])
def test_what_lay_and_was_taken_from_above_can_be_stood_up(shape: str) -> None:
    """The fingers closed across its axis: a level gripper holds it upright."""
    thing = body(shape, LYING)
    assert release_pitch(thing, held_at(thing, math.pi / 2)) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("shape", ["cylinder", "box"])
def test_what_lay_and_was_taken_by_its_end_at_a_slant_is_laid_down_again(shape: str) -> None:
    thing = body(shape, LYING)
    assert release_pitch(thing, held_at(thing, math.radians(40))) == pytest.approx(math.radians(40), abs=1e-3)


@pytest.mark.parametrize("shape", ["cylinder", "box"])
@pytest.mark.parametrize("quaternion", [UPRIGHT, LYING])
@pytest.mark.parametrize("pitch", np.radians((0.0, 40.0, 90.0)))
def test_a_released_object_rests_on_the_support_where_it_was_let_go(
    shape: str, quaternion: np.ndarray, pitch: float
) -> None:
    thing = body(shape, quaternion)
    held = held_at(thing, pitch)
    scene = table_scene(thing).with_held(held)
    yaw, release = 0.3, release_pitch(thing, held)
    rests = put_down(scene, np.array([-0.1, 0.2, 1.0, yaw, release]), scene.support.top)
    assert rests.bottom == pytest.approx(HEIGHT)
    dropped = rotated(yaw, release) @ held.T_tcp_object
    np.testing.assert_allclose(rests.position[:2], dropped[:2, 3] + (-0.1, 0.2), atol=1e-9)
    turn = dropped[:3, :3].T @ rests.rotation
    assert math.acos(min(1.0, (np.trace(turn) - 1) / 2)) < 2e-3
    lowest = max(np.abs(rests.rotation[2]))
    assert lowest == pytest.approx(1.0) or (shape == "cylinder" and abs(rests.rotation[2, 2]) < 1e-9)
