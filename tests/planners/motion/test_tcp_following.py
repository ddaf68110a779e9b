"""Hits of joints that follow TCP poses: all that their samples hit; the opening is that of the moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from assets.robots import FETCH
from clutter_env.simulation.end_effector import TcpFollower
from planners.collision.world import CollisionWorld
from planners.grasping.candidates import GraspCandidate
from planners.motion.arm import tcp_pose
from planners.motion.path import BlockedBy
from planners.motion.pick_and_place import PickPlaceMotion, plan_pick
from planners.motion.tcp_following import Followed, follow
from planners.motion.timing import pick_trajectory
from planners.motion.trajectory import Trajectory
from planners.scene import RobotState, Scene
from planners.tamp.motion_layer import BoundMotion, MotionLayer
from planners.workspace import Workspace
from tests.planners.scenes import cylinder, table_scene

ALONE = table_scene(cylinder("wanted", 0.0, 0.0), cylinder("other", 0.25, 0.4))


def motion_layer(scene: Scene) -> MotionLayer:
    workspace = Workspace.of(scene.robot, scene, grasps="side", follower=TcpFollower(FETCH)).only_near_home()
    return MotionLayer(workspace, np.random.default_rng(0))


def followed_pick() -> tuple[Scene, GraspCandidate, Trajectory]:
    """The first pick that the controller can follow, from where the base then stands."""
    layer = motion_layer(ALONE)
    for grasp in layer.candidates.for_object(ALONE, "wanted"):
        scene = ALONE.with_state(replace(ALONE.state, base=grasp.base))
        world = CollisionWorld.from_scene(scene)
        motion = plan_pick(world, grasp.base, scene.state.q, grasp.q, "wanted", rng=np.random.default_rng(0))
        if isinstance(motion, PickPlaceMotion):
            trajectory = pick_trajectory(world, motion, scene.state)
            if isinstance(layer._followed(scene, BoundMotion(trajectory, scene), ("wanted",)), BoundMotion):
                return scene, grasp, trajectory
    raise AssertionError("no pick of a single object can be followed")


SCENE, GRASP, TRAJECTORY = followed_pick()
TCP_POSE = tcp_pose(FETCH, RobotState(GRASP.base, GRASP.q, 0.0))


def test_hits_of_a_way_are_those_of_its_samples() -> None:
    objects = [cylinder(f"near_{i}", *(TCP_POSE[:2, 3] + 0.09 * np.array([np.cos(i), np.sin(i)]))) for i in range(6)]
    scene = replace(SCENE, objects=(SCENE.body("wanted"), *objects))
    way = follow(TcpFollower(FETCH), FETCH, np.array(scene.state.q), TRAJECTORY)
    assert way is not None
    world, ignore = CollisionWorld.from_scene(scene, padding=0.0), scene.mask(["wanted"])
    sampled = 0
    for x, finger, held in zip(way.configurations, way.finger_position, way.held, strict=True):
        sampled |= world.hits(x[:3], x[3:], FETCH.finger_gap_closed + 2 * finger, held, ignore)
    assert sampled
    assert sampled & ~way.hits(world, ignore) == 0


def test_fingers_are_only_as_wide_as_they_are_when_they_pass() -> None:
    sides = [cylinder(f"side_{i}", *(TCP_POSE[:2, 3] + i * 0.092 * TCP_POSE[:2, 1])) for i in (-1, 1)]
    world = CollisionWorld.from_scene(replace(SCENE, objects=(SCENE.body("wanted"), *sides)), padding=0.0)
    hover = np.array([GRASP.q[0] + 0.2, *GRASP.q[1:]])
    away, there = (np.concatenate((GRASP.base, q)) for q in (hover, GRASP.q))
    wide, narrow = FETCH.max_finger_position, FETCH.finger_position(GRASP.opening)

    def hits(fingers: list[float]) -> int:
        return Followed(np.array([away, away, there]), np.array(fingers), (None,) * 3).hits(world, 0)

    assert hits([wide, wide, wide])
    assert not hits([narrow, narrow, narrow])
    assert not hits([wide, narrow, narrow])
    assert hits([narrow, narrow, wide])


def test_objects_touched_while_following_are_in_the_way_and_named() -> None:
    way = follow(TcpFollower(FETCH), FETCH, np.array(SCENE.state.q), TRAJECTORY)
    assert way is not None
    middle = way.configurations[len(way.configurations) // 4]
    passed = tcp_pose(FETCH, RobotState(middle[:3], middle[3:], 0.0))[:3, 3]
    blocked = SCENE.with_body(SCENE.body("other").at(passed))
    found = motion_layer(blocked)._followed(blocked, BoundMotion(TRAJECTORY, blocked), ("wanted",))
    assert isinstance(found, BlockedBy)
    assert found.blockers == {"other"}


def test_beside_objects_the_tcp_is_as_near_as_the_world_wants_it() -> None:
    """Each sample is waited for, on the lines longer, and elsewhere as long as before."""
    precise = TcpFollower(FETCH)
    precise.line_tolerance = 0.004
    ways = [follow(one, FETCH, np.array(SCENE.state.q), TRAJECTORY) for one in (TcpFollower(FETCH), precise)]
    loose, near = [way.configurations for way in ways if way is not None]
    assert len(near) > len(loose)
    starts = {phase.name: phase.start for phase in TRAJECTORY.phases}
    before = sum(TRAJECTORY.times < starts["approach"])
    assert (near[:before] == loose[:before]).all()
