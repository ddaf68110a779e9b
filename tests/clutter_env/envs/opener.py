"""Scripts in "ee" mode that open a drawer or a door: honestly, by the handle, and otherwise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clutter_env.envs.opening import OpenEnv
from clutter_env.envs.retrieve import ClutterTaskEnv
from tests.clutter_env.envs.side_grasp import CLOSED, OPEN, PRE_GRASP, SideGrasp, _profile, _rotation

SLOW = 0.06
"""[m/s] of a handle that is pulled gently."""


class Opener(SideGrasp):
    """A robot before a drawer or a door."""

    def __init__(self, env: ClutterTaskEnv, seed: int = 0, **options: object) -> None:
        env.reset(seed=seed, options=options or None)
        super().__init__(env)  # type: ignore[arg-type]  # of Open, which has no target
        assert env.world.opening is not None
        self.opening = env.world.opening
        self.bar = env.model.geom(self.opening.bar).id

    @property
    def info(self) -> dict:
        return self.record[-1][4]

    @property
    def handle(self) -> NDArray[np.float64]:
        """Where the middle of the handle's bar is, (3,) [m]."""
        return self.env.data.geom_xpos[self.bar].copy()

    def take_handle(self) -> None:
        """Close the fingers around the bar, from straight ahead."""
        point = self.handle
        self.drive_to(np.array([self.base[0], point[1], 0.0]))
        self.drive_to(np.array([point[0] - self.standoff, point[1], 0.0]))
        self.reach(point - (PRE_GRASP, 0, 0))
        self.reach(point)
        self.grip(CLOSED)

    def grip(self, width: float) -> None:
        self.width = width
        self.wait(0.6)

    def pull(self, share: float = 0.95, speed: float = SLOW) -> None:
        """Move the base, and the hand with it, with the handle to a share of the range."""
        start, amount = self.env.world.opened, (share - self.env.world.opened) * self.opening.travel
        base, point, yaw = self.base.copy(), self.point.copy(), self.yaw
        axis, hinge = np.array(self.opening.axis), np.array(self.opening.origin)
        arm = 1.0 if self.opening.is_slide else float(np.linalg.norm((point - hinge)[:2]))
        assert start < share
        for part in _profile(abs(amount) * arm / speed):
            if self.opening.is_slide:
                self.base[:2] = base[:2] + part * amount * axis[:2]
                self.point = point + part * amount * axis
            else:
                angle = part * amount * float(axis[2])
                turn = _rotation(angle)
                self.point = hinge + turn @ (point - hinge)
                self.base[:2] = (hinge + turn @ (np.array([*base[:2], hinge[2]]) - hinge))[:2]
                self.base[2], self.yaw = base[2] + angle, yaw + angle
            self.step()

    def leave(self) -> None:
        """Open the fingers and back away."""
        self.grip(OPEN)
        away = 0.2 * np.array((math.cos(self.base[2]), math.sin(self.base[2]), 0.0))
        self.drive_to(self.base - away)

    def open_slowly(self) -> dict:
        """Open it by the handle, gently, and let go; the info of the end."""
        self.take_handle()
        self.pull()
        self.wait(0.6)
        return self.info


def opener(layout: str, seed: int = 0, **keywords: object) -> Opener:
    """One before a layout, with few objects."""
    return Opener(OpenEnv(**{"layout": layout, "num_objects": 4, "control_mode": "ee", **keywords}), seed)
