"""Warming up: kernels and maps are compiled, built or loaded before the clock of a solve starts."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numba.core import event

from assets.robots import RobotSpec
from irm.maps.cache import cache_file
from planners.scene import Body, RobotState, Scene, StaticObstacle

__all__ = ["warm_once"]

_LOG = logging.getLogger(__name__)

_TABLE_HEIGHT = 0.75
"""[m]"""
_TARGET, _TARGET_X = "object_00", 0.25
_RING = 0.14
"""[m] from the target to the objects around it."""
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])

_warm: set[tuple[RobotSpec, type]] = set()
"""What this process has warmed up: robots, with the kind of their follower."""


class Warmable(Protocol):
    """What is warmed up: a planner."""

    @property
    def robot(self) -> RobotSpec:
        """Its robot."""
        ...

    @property
    def follower(self) -> object:
        """Its model of how joints follow TCP poses, or None."""
        ...


def warm_once(planner: Warmable, exercise: Callable[[Scene, str], None]) -> None:
    """Exercise a planner in a small scene, unless this process has done so; microseconds if it has.

    Args:
        planner: its robot and follower say what has to be loaded.
        exercise: runs what a solve runs for a target in a scene.
    """
    key = planner.robot, type(planner.follower)
    if key in _warm:
        return
    path = cache_file(planner.robot)
    if not path.exists():
        _LOG.warning("building the reachability map of %s, once (about a minute); kept in %s", planner.robot.name, path)
    with event.install_listener("numba:compile", _Announcement()):
        exercise(warmup_scene(planner.robot), _TARGET)
    _warm.add(key)


class _Announcement(event.Listener):  # type: ignore[misc]  # numba has no type hints
    """Logs that kernels are being compiled when the first one is; kernels loaded from the cache are not reported."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002  the listener's interface
        """A kernel is being compiled."""
        if not self._said:
            self._said = True
            _LOG.warning("compiling the planner's kernels, once per machine (some minutes)")

    def on_end(self, event: event.Event) -> None:
        """A kernel has been compiled."""


def warmup_scene(robot: RobotSpec) -> Scene:
    """A target at the back of a table in a half ring of objects: one of them has to be cleared first."""
    static_obstacles = (
        _box("table_top", (0.0, 0.0, _TABLE_HEIGHT - 0.02), (0.35, 0.5, 0.02)),
        _box("counter_left", (0.0, 0.8, 0.375), (0.35, 0.3, 0.375)),
        _box("counter_right", (0.0, -0.8, 0.375), (0.35, 0.3, 0.375)),
        _box("wall", (0.37, 0.0, 0.8), (0.02, 1.1, 0.8)),
    )
    ring = [np.radians(angle) for angle in (-90.0, -45.0, 0.0, 45.0, 90.0)]
    objects = [_object(_TARGET, "cylinder", _TARGET_X, 0.0)]
    for number, angle in enumerate(ring, start=1):
        x, y = _TARGET_X - _RING * np.cos(angle), _RING * np.sin(angle)
        objects.append(_object(f"object_{number:02d}", "box" if number % 2 else "cylinder", x, y))
    state = RobotState(np.array([-1.1, 0.0, 0.0]), np.array(robot.home), robot.max_finger_position)
    return Scene(robot, state, tuple(objects), static_obstacles)


def _box(name: str, position: tuple[float, float, float], half: tuple[float, float, float]) -> StaticObstacle:
    return StaticObstacle(name, np.array(position), np.array(half))


def _object(name: str, shape: str, x: float, y: float) -> Body:
    half = np.array([0.03, 0.03, 0.08])
    position = np.array([x, y, _TABLE_HEIGHT + half[2]])
    return Body(name, "box" if shape == "box" else "cylinder", half, position, _UPRIGHT)
