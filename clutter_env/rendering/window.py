"""The window of `render_mode="human"`: robot and table in view, in real time, open until its user closes it."""

from __future__ import annotations

import importlib
import time
from typing import Any

import mujoco

from clutter_env.errors import RenderingUnavailable
from clutter_env.rendering.framing import FRAMED_CAMERA, across, whole_scene
from clutter_env.rendering.renderer import has_display
from clutter_env.scene.layout import Layout

_ASPECT = 1.5
"""Width over height of MuJoCo's window before its user changes it, a little less."""
_MOST_LAG = 0.1
"""[s] A simulation that is farther behind the clock, for example after planning, does not catch up."""
_REFRESH = 0.03
"""[s] between two updates while nothing moves."""


class Window:
    """MuJoCo's own viewer, which shows one world in real time.

    Raises:
        RenderingUnavailable: there is no display.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: Layout, camera: str) -> None:
        self._data = data
        self._viewer = _open_viewer(model, data)
        with self._viewer.lock():
            _aim(self._viewer.cam, model, layout, camera)
        self._shown, self._due = data.time, time.monotonic()

    def show(self) -> None:
        """Show the present state when its time has come; nothing once the window has been closed."""
        if not self._viewer.is_running():
            return
        passed = self._data.time - self._shown
        now = time.monotonic()
        self._due = max(self._due, now - _MOST_LAG) + passed if passed >= 0 else now
        self._shown = self._data.time
        time.sleep(max(self._due - now, 0.0))
        self._viewer.sync()

    def wait(self) -> None:
        """Keep the window open until its user closes it."""
        while self._viewer.is_running():
            self._viewer.sync()
            time.sleep(_REFRESH)

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


def _open_viewer(model: mujoco.MjModel, data: mujoco.MjData) -> Any:
    """MuJoCo's viewer, updated with `sync()`."""
    if not has_display():
        raise RenderingUnavailable("render_mode='human' needs a display; set DISPLAY, or use 'rgb_array'")
    viewer = importlib.import_module("mujoco.viewer")
    return viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)


def _aim(view: mujoco.MjvCamera, model: mujoco.MjModel, layout: Layout, camera: str) -> None:
    """Look through a camera of the model, or at the whole scene: this view the mouse can move."""
    if camera != FRAMED_CAMERA:
        view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        view.fixedcamid = model.camera(camera).id
        return
    framed = whole_scene(model, layout, across(layout), _ASPECT)
    view.type = framed.type
    view.azimuth, view.elevation, view.distance = framed.azimuth, framed.elevation, framed.distance
    view.lookat[:] = framed.lookat
