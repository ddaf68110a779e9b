"""Warm-up: kernels and maps are compiled, built or loaded before a solve."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

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
"""Clearance [m] for the hand around the TCP."""
_TABLE_HEIGHT = 0.75
"""Height of the table [m]."""
_TARGET, _TARGET_X = "object_00", 0.25
_RING = 0.14
"""Distance [m] of the objects around the target."""

_warm: set[tuple[RobotSpec, type]] = set()
"""Robots that this process has warmed up, with the type of their follower."""
_loading: dict[tuple[RobotSpec, type], _Loading] = {}
"""Robots that this process is warming up."""


def warm_once(
    robot: RobotSpec, follower: object, exercise: Callable[[Scene, str], None], deadline: Deadline = NO_DEADLINE
) -> Deadline:
    """Exercise a planner in a small scene, once per process. Later calls take microseconds.

    A thread does this, and continues after the deadline. The next call then waits for it. Robot and type of follower
    determine what is loaded. `exercise` runs the code of a solve for a target in a scene.

    Returns:
        The deadline, later by the time spent on compilation. If it is over, not everything is loaded.
    """
    key = robot, type(follower)
    if key in _warm:
        return deadline
    # If the thread already runs, its compilation before this call does not extend the deadline.
    before = _loading[key].compilation.seconds if key in _loading else 0.0
    if key not in _loading:
        _loading[key] = _Loading(robot, exercise)
    loading = _loading[key]
    until = loading.wait(deadline, before)
    if loading.future.done():
        del _loading[key]
        loading.future.result()  # raises an exception of the exercise
        _warm.add(key)
    return until


class _Loading:
    """A thread that loads or compiles everything that a planner needs. The process waits for it at its end."""

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
        """Wait for the thread or a deadline, and return the deadline, later by the compilation since `before` [s]."""
        while True:
            is_done, until = self.future.done(), Deadline(deadline.at + self.compilation.seconds - before)
            if is_done or until.is_over:
                return until
            wait([self.future], None if math.isinf(until.at) else until.remaining)


@contextmanager
def logged_compilation() -> Iterator[None]:
    """Log the compilation of kernels within the block, for code that uses the planner's kernels without `warm_once`."""
    with event.install_listener("numba:compile", _Compilation()):
        yield


class _Compilation(event.Listener):  # type: ignore[misc]  # numba has no type hints
    """Measures the time of kernel compilation, without loading from the cache.

    It logs a warning once, and the name of each kernel at level INFO.
    """

    def __init__(self) -> None:
        self._begun: list[float] = []
        self._ended_s = 0.0
        self._said = False

    @property
    def seconds(self) -> float:
        """Wall time [s] spent on compilation so far."""
        return self._ended_s + sum(time.monotonic() - begun for begun in self._begun[:1])

    def on_start(self, event: event.Event) -> None:
        """Note the start of a compilation, possibly nested in another one."""
        self._begun.append(time.monotonic())
        if not self._said:
            self._said = True
            _LOG.warning("compiling the planner's kernels, once per machine (about a minute)")
        kernel = getattr((event.data or {}).get("dispatcher"), "py_func", None)
        if kernel is not None and not kernel.__module__.startswith("numba."):
            _LOG.info("compiling %s.%s", kernel.__module__, kernel.__qualname__)

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002  the listener's interface
        """Note the end of a compilation."""
        if len(self._begun) == 1:
            self._ended_s = self.seconds
        self._begun.pop()


def warmup_scene(robot: RobotSpec) -> Scene:
    """A target at the back of a table in a half ring of objects. At least one of them must be cleared first."""
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
    # A gripper that hangs down at home must be in front of the table, not inside it.
    near = max(robot.base_radius, ahead + _HAND if height < _TABLE_HEIGHT + _HAND else 0.0)
    before = -0.37 - near if robot.base_drive == "fixed" else -1.1
    state = RobotState(np.array([before, 0.0, 0.0]), np.array(robot.home), robot.max_finger_position)
    return Scene(robot, state, tuple(objects), tuple(furniture))
