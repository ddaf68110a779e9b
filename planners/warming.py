"""Warming up: kernels and maps are compiled, built or loaded before a solve."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait

import numpy as np
from numba.core import event

from assets.robots import RobotSpec
from irm.reachability_map import cache_file, is_map_at_hand
from planners.clock import NO_DEADLINE, Deadline
from planners.grasping.base_placement import map_parameters
from planners.motion.arm import tcp_pose
from planners.scene import Body, RobotState, Scene, StaticObstacle

_LOG = logging.getLogger(__name__)

_HAND = 0.2
"""[m] about the TCP."""
_TABLE_HEIGHT = 0.75
"""[m]"""
_TARGET, _TARGET_X = "object_00", 0.25
_RING = 0.14
"""[m] from the target to the objects around it."""

_warm: set[tuple[RobotSpec, type]] = set()
"""Robots that this process has warmed up, with the kind of their follower."""
_loading: dict[tuple[RobotSpec, type], _Loading] = {}
"""Robots that it is warming up."""


def warm_once(
    robot: RobotSpec, follower: object, exercise: Callable[[Scene, str], None], deadline: Deadline = NO_DEADLINE
) -> Deadline:
    """Exercise a planner in a small scene, unless this process has done so; microseconds if it has.

    That is done in a thread, which goes on where the deadline comes first; the next call then waits for it. Robot and
    type of follower say what has to be loaded; `exercise` runs what a solve runs for a target in a scene.

    Returns:
        the deadline, later by the time that was spent on compilation; if it is over, not all is loaded.
    """
    key = robot, type(follower)
    if key in _warm:
        return deadline
    # Of a thread that runs already, compilation before this call was not waited for.
    before = _loading[key].compilation.seconds if key in _loading else 0.0
    if key not in _loading:
        _loading[key] = _Loading(robot, exercise)
    loading = _loading[key]
    until = loading.wait(deadline, before)
    if loading.future.done():
        del _loading[key]
        loading.future.result()  # raises what the exercise has raised
        _warm.add(key)
    return until


class _Loading:
    """A thread that loads or compiles what a planner needs. A process does not end before it has ended."""

    def __init__(self, robot: RobotSpec, exercise: Callable[[Scene, str], None]) -> None:
        self.compilation = _Compilation()
        executor = ThreadPoolExecutor(max_workers=1)
        self.future = executor.submit(self._load, robot, exercise)
        executor.shutdown(wait=False)

    def _load(self, robot: RobotSpec, exercise: Callable[[Scene, str], None]) -> None:
        parameters = map_parameters(robot)
        if robot.base_drive != "fixed" and not is_map_at_hand(robot, **parameters):
            path = cache_file(robot, **parameters)
            _LOG.warning("building the reachability map of %s, once; kept in %s", robot.name, path)
        with event.install_listener("numba:compile", self.compilation):
            exercise(warmup_scene(robot), _TARGET)

    def wait(self, deadline: Deadline, before: float) -> Deadline:
        """Wait until it has ended or a deadline is over; the deadline, later by the compilation since `before` [s]."""
        while True:
            is_done, until = self.future.done(), Deadline(deadline.at + self.compilation.seconds - before)
            if is_done or until.is_over:
                return until
            wait([self.future], None if math.isinf(until.at) else until.remaining)


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
    boxes = {
        "table_top": ((0.0, 0.0, _TABLE_HEIGHT - 0.02), (0.35, 0.5, 0.02)),
        "counter_left": ((0.0, 0.8, 0.375), (0.35, 0.3, 0.375)),
        "counter_right": ((0.0, -0.8, 0.375), (0.35, 0.3, 0.375)),
        "wall": ((0.37, 0.0, 0.8), (0.02, 1.1, 0.8)),
    }
    furniture = [StaticObstacle(name, np.array(position), np.array(half)) for name, (position, half) in boxes.items()]
    ring = np.radians((-90.0, -45.0, 0.0, 45.0, 90.0))
    places = [(0.0, 0.0), *((-_RING * np.cos(angle), _RING * np.sin(angle)) for angle in ring)]
    half = np.array([0.03, 0.03, 0.08])
    objects = [
        Body(
            f"object_{number:02d}",
            "box" if number % 2 else "cylinder",
            half,
            np.array([_TARGET_X + x, y, _TABLE_HEIGHT + half[2]]),
            np.array([1.0, 0.0, 0.0, 0.0]),
        )
        for number, (x, y) in enumerate(places)
    ]
    home = RobotState(np.zeros(3), np.array(robot.home), 0.0)
    ahead, _, height = tcp_pose(robot, home)[:3, 3]
    # A gripper that hangs down at home must be before the table, not in it.
    near = max(robot.base_radius, ahead + _HAND if height < _TABLE_HEIGHT + _HAND else 0.0)
    before = -0.37 - near if robot.base_drive == "fixed" else -1.1
    state = RobotState(np.array([before, 0.0, 0.0]), np.array(robot.home), robot.max_finger_position)
    return Scene(robot, state, tuple(objects), tuple(furniture))
