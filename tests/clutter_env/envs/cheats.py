"""Ways to move an object that are no carrying, each followed by a lift of the target: scripts in "ee" mode.

None of them deserves a clean success; what each does to the other object is said in its docstring.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clutter_env.envs.retrieve import ClutterTaskEnv
from clutter_env.scene.layout import TABLE_HEIGHT
from tests.clutter_env.envs.side_grasp import CLOSED, OPEN, PRE_GRASP, SideGrasp

RADIUS, HEIGHT = 0.03, 0.14
LOW, MIDDLE = 0.055, 0.6 * HEIGHT
"""[m] of the gripper above the table: where a push does not topple, where an object is grasped."""
TIP = 0.0235
"""[m] by which the pads reach beyond the TCP."""
TAP = 0.009
"""[m] above and below the table's top, between which a hand that taps on it is sent."""
TARGET, OTHER = 0, 1


def cylinder(x: float, y: float) -> dict:
    """The description of an object for `reset`."""
    return {"shape": "cylinder", "radius": RADIUS, "height": HEIGHT, "position": (x, y)}


SCENE = (cylinder(-0.18, -0.12), cylinder(-0.24, 0.2), cylinder(-0.24, 0.36), cylinder(-0.24, 0.05))
"""The objects of a cheat: the target, and what is done something to."""


class Cheat(SideGrasp):
    """A robot before a target and other objects; by default one other, and it could grasp both at once.

    Of Rearrange, `options` has the goal in place of the target.
    """

    def __init__(
        self, env: ClutterTaskEnv, objects: Sequence[dict] | None = None, options: dict[str, Any] | None = None
    ) -> None:
        objects = objects or (cylinder(-0.18, -0.12), cylinder(-0.24, 0.2))
        env.reset(seed=0, options={"objects": objects, **(options or {"target": "object_00"})})
        super().__init__(env)

    def at(self, slot: int, height: float = MIDDLE) -> np.ndarray:
        """Position (3,) of the TCP around an object."""
        x, y = self.env.measurements.poses[slot, :2]
        return np.array([x, y, TABLE_HEIGHT + height])

    def before(self, point: np.ndarray) -> None:
        """Drive and reach to the place before a point, from above."""
        self.drive_to(np.array([self.base[0], point[1], 0.0]))
        self.drive_to(np.array([point[0] - self.standoff, point[1], 0.0]))
        self.reach(point - (PRE_GRASP, 0, -0.25))
        self.reach(point - (PRE_GRASP, 0, 0))

    def grasp(self, slot: int, width: float = CLOSED) -> None:
        """Close the fingers around an object, to this width [m]."""
        self.before(self.at(slot))
        self.reach(self.at(slot))
        self.grip(width)

    def grip(self, width: float) -> None:
        self.width = width
        self.wait(0.6)

    def leave(self) -> None:
        """Open the fingers, draw back, rise."""
        self.grip(OPEN)
        self.reach(self.point - (PRE_GRASP, 0, 0))
        self.reach(self.point + (0, 0, 0.25))

    def drag(self, slot: int, far: float) -> None:
        """Grip an object, drag it so far [m] along the table, and let go of it."""
        self.grasp(slot)
        self.reach(self.point + (0, far, 0), speed=0.06)
        self.leave()

    def throw(self, slot: int, stride: float, closed: int, steps: int) -> None:
        """Lift an object, swing it sideways by `stride` [m] a step, and let go of it after so many `closed` steps."""
        self.grasp(slot)
        self.reach(self.point + (0, 0, 0.01))
        start = self.point.copy()
        for i in range(1, steps + 1):
            self.point = start + (0, stride * i, 0)
            self.width = CLOSED if i <= closed else OPEN
            self.step()
        self.wait(0.6)
        self.leave()

    def take_target(self) -> dict:
        """Take the target and lift it; the info of the end."""
        self.grasp(TARGET)
        self.reach(self.point + (0, 0, 0.16))
        self.wait(1.0)
        return self.info

    @property
    def info(self) -> dict:
        return self.record[-1][4]


def push_with_two_fingers(cheat: Cheat) -> None:
    """Both fingertips push it 9 cm along the table."""
    there = cheat.at(OTHER, LOW)
    cheat.before(there)
    cheat.grip(0.64 * 2 * RADIUS)
    cheat.reach(there + (0.05, 0.0, 0.0), speed=0.03)
    cheat.leave()


def drag_in_the_grip(cheat: Cheat) -> None:
    """It is gripped, and dragged 12 cm along the table."""
    cheat.drag(OTHER, 0.12)


def vibrate_in_the_grip(cheat: Cheat) -> None:
    """It is gripped and shaken up and down at 10 Hz, 12 cm along the table; at most ends of steps it is in the air."""
    cheat.grasp(OTHER)
    start = cheat.point.copy()
    cheat.reach(start)
    for i in range(40):
        cheat.point = start + (0, 0.003 * i, -0.002 if i % 2 else 0.002)
        cheat.step()
    cheat.wait(0.3)
    cheat.leave()


def nudge_and_touch(cheat: Cheat) -> None:
    """One finger nudges it 4 mm, both fingers touch it, and so on, 18 times: 7 cm along the table."""
    cheat.before(cheat.at(OTHER, LOW))
    cheat.reach(cheat.at(OTHER, LOW))
    cheat.grip(2 * RADIUS + 0.012)
    for _ in range(18):
        cheat.reach(cheat.point + (0, 0.010, 0), speed=0.03)
        cheat.reach(cheat.point - (0, 0.006, 0), speed=0.03)
        cheat.grip(CLOSED)
        cheat.grip(2 * RADIUS + 0.012)
    cheat.leave()


def throw(cheat: Cheat) -> None:
    """It is lifted, swung sideways and released in the swing."""
    cheat.throw(OTHER, 0.03, closed=8, steps=12)


def drop(cheat: Cheat) -> None:
    """It is carried up, and dropped from 12 cm."""
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.12))
    cheat.leave()


def drop_over_the_edge(cheat: Cheat) -> None:
    """It is carried to before the table and released."""
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.12))
    cheat.drive_to(cheat.base - (0.5, 0, 0))
    cheat.leave()


def shove_with_what_is_held(cheat: Cheat) -> None:
    """A third object, carried, shoves it."""
    cheat.grasp(2)
    cheat.reach(cheat.point + (0, 0, 0.01))
    cheat.reach(cheat.point - (0, 0.16, 0), speed=0.06)
    cheat.reach(cheat.point + (0, 0.10, 0))
    cheat.reach(cheat.point - (0, 0, 0.01))
    cheat.leave()


def topple_and_erect(cheat: Cheat) -> None:
    """It is pushed over at its top, then picked up and put down once more."""
    there = cheat.at(OTHER, HEIGHT)
    cheat.before(there)
    cheat.grip(CLOSED)
    cheat.reach(there + (0.05, 0, 0))
    cheat.leave()
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.1))
    cheat.leave()


def press_on_the_table(cheat: Cheat) -> None:
    """The closed gripper presses on the table beside it, with more than 50 N."""
    cheat.before(cheat.at(OTHER) + (0, 0.15, 0))
    cheat.grip(CLOSED)
    cheat.reach(cheat.point + (PRE_GRASP, 0, -0.15))
    cheat.leave()


def press_with_what_is_held(cheat: Cheat) -> None:
    """It is lifted a little and pressed on the table, with more than 50 N."""
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.02))
    cheat.reach(cheat.point - (0, 0, 0.12))
    cheat.reach(cheat.point + (0, 0, 0.10))
    cheat.leave()


def lean_on_the_table(cheat: Cheat) -> None:
    """Closed fingers press on the table beside it for half a second, with 50 to 100 N."""
    cheat.before(cheat.at(OTHER) + (0, 0.15, 0))
    cheat.grip(CLOSED)
    cheat.reach(cheat.point + (PRE_GRASP, 0, 0.02 - MIDDLE), speed=0.05)
    while cheat.info["furniture_force"] < 55 and cheat.point[2] > TABLE_HEIGHT - 0.3:
        cheat.point = cheat.point - (0, 0, 0.001)
        cheat.step()
    cheat.wait(0.5)
    cheat.reach(cheat.point + (0, 0, 0.2))
    cheat.leave()


def tap_on_the_table(cheat: Cheat) -> None:
    """The closed hand taps on the table beside the target, 40 times, each time less hard than a single blow may be."""
    cheat.before(cheat.at(TARGET) - (0, 0.18, 0))
    cheat.grip(CLOSED)
    cheat.reach(cheat.point + (PRE_GRASP, 0, 0.07 - MIDDLE), speed=0.05)
    while not cheat.env.world.on_furniture.is_pressed:
        cheat.point = cheat.point - (0, 0, 0.0005)
        cheat.step()
    touching = cheat.point
    for _ in range(40):
        cheat.point = touching + (0, 0, TAP)
        cheat.wait(0.5)
        cheat.point = touching - (0, 0, TAP)
        while not cheat.env.world.on_furniture.is_pressed:
            cheat.step()
    cheat.reach(cheat.point + (0, 0, 0.2))
    cheat.leave()


def drive_into_the_table(cheat: Cheat) -> None:
    """The base drives against the table at full speed."""
    start = cheat.base.copy()
    cheat.drive_to(start + (1.2, 0, 0), speed=1.0)
    cheat.drive_to(start)


def shake_in_the_grip(cheat: Cheat) -> None:
    """It is gripped and shaken to and fro on the table, by some 4 mm, 40 times."""
    cheat.grasp(OTHER)
    start = cheat.point.copy()
    for i in range(80):
        cheat.point = start + (0, 0.006 if i % 2 else -0.006, 0)
        cheat.step()
        cheat.step()
    cheat.point = start
    cheat.leave()


def shove_a_row(cheat: Cheat) -> None:
    """It and two others are shoved by 4 cm each."""
    for slot in (OTHER, 2, 3):
        there = cheat.at(slot, LOW)
        cheat.before(there)
        cheat.grip(CLOSED)
        cheat.reach(there + (0.043 - TIP - RADIUS, 0.0, 0.0), speed=0.03)
        cheat.leave()


CHEATS: dict[str, Callable[[Cheat], None]] = {
    cheat.__name__: cheat
    for cheat in (
        push_with_two_fingers,
        drag_in_the_grip,
        vibrate_in_the_grip,
        nudge_and_touch,
        throw,
        drop,
        drop_over_the_edge,
        shove_with_what_is_held,
        topple_and_erect,
        press_on_the_table,
        press_with_what_is_held,
        lean_on_the_table,
        tap_on_the_table,
        drive_into_the_table,
        shake_in_the_grip,
        shove_a_row,
    )
}
