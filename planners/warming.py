"""Warming up: kernels and maps are compiled, built or loaded before a solve."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Protocol

import numpy as np
from numba.core import event

from assets.robots import RobotSpec
from irm.cache import cache_file, is_map_at_hand
from planners.clock import NO_DEADLINE, Deadline
from planners.grasping.base_placement import map_parameters
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
_loading: dict[tuple[RobotSpec, type], _Loading] = {}
"""What it is warming up."""


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


def warm_once(planner: Warmable, exercise: Callable[[Scene, str], None], deadline: Deadline = NO_DEADLINE) -> Deadline:
    """Exercise a planner in a small scene, unless this process has done so; microseconds if it has.

    That is done in a thread, which goes on where the deadline comes first; the next call then waits for it.

    Args:
        planner: its robot and follower say what has to be loaded.
        exercise: runs what a solve runs for a target in a scene.
        deadline: how long to wait. Compilation, once per machine, does not count.

    Returns:
        the deadline, later by the time that was spent on compilation; if it is over, not all is loaded.
    """
    key = planner.robot, type(planner.follower)
    if key in _warm:
        return deadline
    if key in _loading:
        compiled_s = _loading[key].compiled_s
    else:
        compiled_s = 0.0
        _loading[key] = _Loading(planner.robot, exercise)
    until = _loading[key].wait(deadline, compiled_s)
    if _loading[key].is_done:
        _loading.pop(key).check()
        _warm.add(key)
    return until


class _Loading:
    """A thread that loads or compiles what a planner needs. A process does not end before it has ended."""

    def __init__(self, robot: RobotSpec, exercise: Callable[[Scene, str], None]) -> None:
        """Start it."""
        self._compilation = _Compilation()
        executor = ThreadPoolExecutor(max_workers=1)
        self._future = executor.submit(self._load, robot, exercise)
        executor.shutdown(wait=False)

    def _load(self, robot: RobotSpec, exercise: Callable[[Scene, str], None]) -> None:
        parameters = map_parameters(robot)
        if not is_map_at_hand(robot, **parameters):
            path = cache_file(robot, **parameters)
            _LOG.warning("building the reachability map of %s, once; kept in %s", robot.name, path)
        with event.install_listener("numba:compile", self._compilation):
            exercise(warmup_scene(robot), _TARGET)

    @property
    def is_done(self) -> bool:
        """Whether it has ended."""
        return self._future.done()

    def check(self) -> None:
        """Raise what the exercise has raised."""
        self._future.result()

    @property
    def compiled_s(self) -> float:
        """[s] of wall time spent on compilation so far."""
        return self._compilation.seconds

    def wait(self, deadline: Deadline, before: float) -> Deadline:
        """Wait until it has ended or a deadline is over; the deadline, later by the compilation since `before` [s]."""
        while True:
            is_done, until = self.is_done, Deadline(deadline.at + self.compiled_s - before)
            if is_done or until.is_over:
                return until
            wait([self._future], None if math.isinf(until.at) else until.remaining)


class _Compilation(event.Listener):  # type: ignore[misc]  # numba has no type hints
    """Measures for how long kernels are compiled; loading from the cache does not count.

    Says once, as a warning, that it happens, and as information which one it is.
    """

    def __init__(self) -> None:
        self._begun: list[float] = []
        self._ended_s = 0.0
        self._said = False

    @property
    def seconds(self) -> float:
        """[s] of wall time spent on compilation so far."""
        return self._ended_s + sum(time.monotonic() - begun for begun in self._begun[:1])

    def on_start(self, event: event.Event) -> None:
        """A kernel is being compiled, perhaps inside the compilation of another one."""
        self._begun.append(time.monotonic())
        if not self._said:
            self._said = True
            _LOG.warning("compiling the planner's kernels, once per machine (about a minute)")
        kernel = getattr((event.data or {}).get("dispatcher"), "py_func", None)
        if kernel is not None and not kernel.__module__.startswith("numba."):
            _LOG.info("compiling %s.%s", kernel.__module__, kernel.__qualname__)

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002  the listener's interface
        """A kernel has been compiled."""
        if len(self._begun) == 1:
            self._ended_s = self.seconds
        self._begun.pop()


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
