"""Knowledge of the search expert: the robot's own state, the seen objects, the possible places of the target."""

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
"""Share of an object's cells that must be seen empty until the object is regarded as gone."""
_AJAR = 0.05
"""Share of its range from which on an open drawer may show something in images."""
_SHRINK = (0.0, 0.001, 0.002, 0.004, 0.008)
"""Amounts [m] by which perceived objects are made narrower until they do not overlap."""


class Knowledge:
    """Knowledge from the observations of one episode.

    Attributes:
        robot: the robot.
        empty: the furniture and the robot without objects, with drawers and doors where they were last seen.
        supports: supports that objects can stand on.
        cameras: names of the cameras. The first one is aimed.
        target: description of the target.
        observation, reading: the present observation, and the robot's state in it.
        belief: the possible places of the target.
        objects: the seen objects.
        held: the object in the gripper, if any.
    """

    def __init__(
        self, robot: RobotSpec, workplace: mujoco.MjModel, support: str, noise: float, observation: Mapping[str, Any]
    ) -> None:
        """Begin with the first observation. Arguments are those of `SearchExpert`, errors those of its `reset`."""
        data = mujoco.MjData(workplace)
        mujoco.mj_forward(workplace, data)
        self.robot, self._noise = robot, noise
        self.empty = Scene.from_mujoco(workplace, data, robot, movable=(), support=support)
        self.supports = [self.empty.support_named(name) for name in self.empty.supports]
        own = robot.cameras  # the first one is aimed: it is on the head if the robot has one there
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

    # Update from observations.

    def observe(self, observation: Mapping[str, Any]) -> None:
        """Update the robot's state. Images are only used by `look`."""
        self.observation, self.reading = observation, RobotReading.of(observation, self.reading.drive[2])

    def look(self) -> float:
        """Update belief and objects with each camera. Return the CPU time [s] of the belief update."""
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
        """Move objects after a motion, as a sensor has followed them."""
        sensor.update(self.reading)
        self._ride()
        self.held = sensor.held
        self._move({body.name: body for body in sensor.bodies if body.name in sensor.brought})

    def opened_in_part(self, name: str, position: float) -> None:
        """Note where a part stopped that was not moved as far as planned. A second stop there becomes its end."""
        self._ride()
        self._stops.note(self.empty.opening(name), position)
        self.empty = self._stops.applied(self.empty)

    def carry(self) -> None:
        """Move a held object with the hand. If the fingers press on nothing, it was dropped."""
        if self.held is not None:
            known, in_hand = {one.name: one.body for one in self.objects}, self.held
            body = known[in_hand.name].at_pose(self.reading.T_world_tcp @ in_hand.T_tcp_object)
            if not self.reading.is_gripping:
                self.held = None
            self._move({in_hand.name: body})

    def _ride(self) -> None:
        """Move drawers and doors to their measured positions, with everything that stands in them, seen or not."""
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
        """Update objects that the robot moved: held ones are in the hand, others upright where they were released.

        The cells around them are unknown again.
        """
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
        """Supports that images can show: not those in shut drawers."""
        shut = {name for one in self.empty.openings if one.share < _AJAR for name in one.parts}
        return [one for one in self.supports if one.name not in shut]

    @property
    def eye(self) -> Array:
        """Position (3,) [m] of the first camera."""
        return self._view(self.cameras[0]).T_world_camera[:3, 3]

    def _view(self, camera: str) -> View:
        return View.of(self.observation, camera, self.reading.T_world_base)

    # Queries.

    def places(self) -> dict[str, NDArray[np.bool_]]:
        """Cells where the target can be, by support."""
        return self.belief.places([one.body for one in self.objects], self.empty.static_obstacles)

    def seen_target(self) -> Seen | None:
        """The seen target. Of several objects that look like it, the one with most seen points."""
        return max((one for one in self.objects if one.is_target), key=lambda one: len(one.points), default=None)

    def is_target(self, name: str) -> bool:
        """Whether the object of this name is still taken for the target: later views may join or drop objects."""
        target = self.seen_target()
        return target is not None and target.name == name

    def scene(self) -> Scene:
        """Scene of the known objects, made narrower if they overlap, and the robot, set to home if near home.

        If objects still overlap, one object was seen as two. Then the one with fewer seen points is left out, but never
        the target or a held object.
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
        """Scene with some objects, made narrower by a distance [m]."""
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
