"""What the search expert knows: the robot's own state, the objects that it has seen, where the target can be."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.collision.world import CollisionWorld, overlaps, validate
from planners.expert.actor import planned_from
from planners.expert.config import ExpertError
from planners.expert.stops import Stops
from planners.scene import Body, HeldObject, RobotState, Scene, SceneError, StaticObstacle
from planners.search.belief import Belief
from planners.search.perception import Description, Seen, View, perceive
from planners.search.sensing import BelievedSensor, RobotReading, opened_as_read

Array = NDArray[np.float64]

_GONE = 0.6
"""Share of an object's cells that must be seen to be empty until it counts as gone."""
_AJAR = 0.05
"""Share to which a drawer is open, at least, that images can show something of."""
_SHRINK = (0.0, 0.001, 0.002, 0.004, 0.008)
"""[m] by which perceived objects are made narrower until they do not overlap."""


class Knowledge:
    """All that observations have told in one episode.

    Attributes:
        robot: which robot it is.
        empty: the furniture and the robot, without any object; what opens is where it was seen last.
        supports: on which objects can stand.
        cameras: names of the cameras; the first of them is aimed.
        target: what it is like.
        observation, reading: the present observation, and the robot's state in it.
        belief: where the target can be.
        objects: those that have been seen.
        held: the object in the gripper, None for none.
    """

    def __init__(
        self, robot: RobotSpec, workplace: mujoco.MjModel, support: str, noise: float, observation: Mapping[str, Any]
    ) -> None:
        """Begin with the first observation; arguments as for `SearchExpert`, errors those of its `reset`."""
        data = mujoco.MjData(workplace)
        mujoco.mj_forward(workplace, data)
        self.robot, self._noise = robot, noise
        self.empty = Scene.from_mujoco(workplace, data, robot, movable=(), support=support)
        self.supports = [self.empty.support_named(name) for name in self.empty.supports]
        own = robot.cameras  # the first of them, which is aimed, is the head's where there is one
        shown = [name.removesuffix("_depth") for name in sorted(observation) if name.endswith("_depth")]
        self.cameras = [name for name in own if name in shown] + [name for name in shown if name not in own]
        if not set(own) & set(shown):
            raise ExpertError(f"cameras={tuple(shown)!r} do not move with the robot; it has {', '.join(own)}")
        self.target = Description.of(observation["target"])
        self.belief = Belief.begin(self.empty, self.target)
        self.objects: tuple[Seen, ...] = ()
        self._stops = Stops()
        self.held: HeldObject | None = None
        self.observation, self.reading = observation, RobotReading.of(observation)

    # What observations tell.

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Take in where the robot is; images count when they are looked at, see `look`."""
        self.observation, self.reading = observation, RobotReading.of(observation, self.reading.drive[2])

    def look(self) -> float:
        """Carve, forget what is gone, and perceive, with each camera; the CPU time [s] of the belief's update."""
        self.carry()
        self._ride()
        started = time.process_time()
        views = [self._view(name) for name in self.cameras]
        for view in views:
            self.belief.update(view, self._noise)
        seconds = time.process_time() - started
        held = self.held.name if self.held else ""
        known = tuple(one for one in self.objects if one.name == held or self.belief.emptied(one.body) < _GONE)
        for view in views:
            known = perceive(view, known, self.supports, self.target, held)
        self.objects = known
        return seconds

    def settle(self, sensor: BelievedSensor) -> None:
        """After a motion: objects have moved as a sensor has followed them."""
        sensor.update(self.reading)
        self._ride()
        self.held = sensor.held
        self._move({body.name: body for body in sensor.bodies if body.name in sensor.brought})

    def opened_in_part(self, name: str) -> None:
        """Note that something was not moved as far as planned; if it stops twice in the same place, it ends there."""
        self._ride()
        self._stops.note(self.empty.opening(name))
        self.empty = self._stops.applied(self.empty)

    def carry(self) -> None:
        """Believe what is held to be where the hand is, or to have been dropped if the fingers press on nothing."""
        if self.held is not None:
            known, in_hand = {one.name: one.body for one in self.objects}, self.held
            body = known[in_hand.name].at_pose(self.reading.T_world_tcp @ in_hand.T_tcp_object)
            if not self.reading.is_gripping:
                self.held = None
            self._move({in_hand.name: body})

    def _ride(self) -> None:
        """Believe what opens to be where it is read to be: with a drawer all moves that stands in it, seen or not."""
        before = replace(self.empty, objects=tuple(one.body for one in self.objects), held=self.held)
        after = opened_as_read(before, self.reading)
        if after is before:
            return
        for old, new in zip(before.openings, after.openings, strict=True):
            if old is not new and old.kind == "slide":
                self.belief = self.belief.slid(old.parts, old.motion(new.position)[:3, 3])
        rides = []
        for one, body in zip(self.objects, after.objects, strict=True):
            T = body.pose @ np.linalg.inv(one.body.pose)
            points = one.points @ T[:3, :3].T + T[:3, 3]
            rides.append(one if body is one.body else replace(one, body=body, points=points))
        self.objects = tuple(rides)
        self.empty = replace(self.empty, static_obstacles=after.static_obstacles, openings=after.openings)
        self.supports = [self.empty.support_named(name) for name in self.empty.supports]

    def _move(self, moved: Mapping[str, Body]) -> None:
        """Objects moved by the robot: what it holds is in its hand, the rest where it let go of it, upright; around
        there nothing is known."""
        kept = []
        for one in self.objects:
            if (body := moved.get(one.name)) is not None:
                if self.held is None or self.held.name != one.name:
                    under = [s.top for s in self.supports if s.is_under(body.position[:2]) and s.top < body.position[2]]
                    height, turn = max(under, default=0.0) + one.body.half_extents[2], body.yaw / 2
                    upright = math.cos(turn), 0.0, 0.0, math.sin(turn)
                    body = one.body.at((*body.position[:2], height), upright)
                self.belief.move(one.body, body, one.sigma)
                T = body.pose @ np.linalg.inv(one.body.pose)
                one = replace(one, body=body, points=one.points @ T[:3, :3].T + T[:3, 3])
            kept.append(one)
        self.objects = tuple(kept)

    @property
    def shown(self) -> list[StaticObstacle]:
        """The supports that images can show: not those in drawers that are shut."""
        shut = {name for one in self.empty.openings if one.share < _AJAR for name in one.parts}
        return [one for one in self.supports if one.name not in shut]

    @property
    def eye(self) -> Array:
        """(3,) [m] where the first camera is."""
        return self._view(self.cameras[0]).T_world_camera[:3, 3]

    def _view(self, camera: str) -> View:
        return View.of(self.observation, camera, self.reading.T_world_base)

    # What is known by now.

    def places(self) -> dict[str, NDArray[np.bool_]]:
        """The cells at which the target can be, by support."""
        return self.belief.places([one.body for one in self.objects], self.empty.static_obstacles)

    def seen_target(self) -> Seen | None:
        """What is known of the target; of two things that look like it the one of which most was seen."""
        return max((one for one in self.objects if one.is_target), key=lambda one: len(one.points), default=None)

    def is_target(self, name: str) -> bool:
        """Whether what has this name still is what is taken for the target: further views may join or lose things."""
        target = self.seen_target()
        return target is not None and target.name == name

    def scene(self) -> Scene:
        """The known objects, narrower where they would overlap; the robot as it is, at home if it is near it.

        Where that does not help, one object has been taken for two: of both, the one of which less was seen is left
        out, never the target or what is held.
        """
        target, known = self.seen_target(), {one.name: one for one in self.objects}
        surety = {name: (one is target, len(one.points)) for name, one in known.items()}
        while True:
            for by in _SHRINK:
                scene = self._scene_of([one.body for one in known.values()], by)
                world = CollisionWorld.from_scene(scene)
                pairs = [pair for pair in overlaps(world) if not set(scene.held_names) & set(pair)]
                if not pairs:
                    return _validated(scene, world)
            for pair in pairs:
                known.pop(min(pair, key=lambda name: surety[name]), None)

    def _scene_of(self, bodies: list[Body], by: float) -> Scene:
        """The scene with some objects, narrower by a distance [m]."""
        drive, robot = self.reading.drive, self.robot
        state = RobotState(drive[:3], planned_from(robot, drive[3:]), robot.finger_position(self.reading.width))
        narrower = (np.maximum(body.half_extents - (by, by, 0.0), 0.005) for body in bodies)
        objects = tuple(replace(body, half_extents=half) for body, half in zip(bodies, narrower, strict=True))
        return replace(self.empty, state=state, objects=objects, held=self.held)


def _validated(scene: Scene, world: CollisionWorld) -> Scene:
    try:
        validate(world)
    except SceneError as error:
        raise ExpertError(f"the robot stands inside the furniture of env.workplace: {error}") from error
    return scene
