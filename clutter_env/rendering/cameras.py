"""The images of one environment: `render()`, its window, camera observations; opened with the first image."""

from __future__ import annotations

import importlib
import time
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.config import EnvConfig
from clutter_env.errors import RenderingUnavailable
from clutter_env.rendering.framing import FRAMED_CAMERA, across, whole_scene
from clutter_env.rendering.renderer import Renderer, add_marks, has_display
from clutter_env.scene.layout import Layout
from clutter_env.simulation.world import Mark, World

MAX_DEPTH = 8.0
"""[m] Clip of the depth images in observations."""
_WINDOW_ASPECT = 1.5
"""Width over height of MuJoCo's window before its user changes it, a little less."""
_MOST_LAG = 0.1
"""[s] A simulation that is farther behind the clock, for example after planning, does not catch up."""
_REFRESH = 0.03
"""[s] between two updates while nothing moves."""


class EnvRenderer:
    """The renderers of one environment, one for each image size; they are made anew when its world changes."""

    def __init__(self, config: EnvConfig) -> None:
        self._config = config
        self._cameras, self._layout = config.find_robot().cameras, config.find_layout()
        self._renderers: dict[tuple[int, int], Renderer] = {}
        self._window: Window | None = None
        self._world: World | None = None

    @property
    def largest(self) -> tuple[int, int]:
        """Width and height [pixels] of the largest image."""
        size = self._config.image_size if self._config.obs_mode == "rgbd" else 0
        return max(self._config.width, size), max(self._config.height, size)

    def render(self, world: World) -> NDArray[Any] | None:
        """What `render()` returns in this configuration's mode; see `BaseEnv.render`."""
        mode = self._config.render_mode
        if mode is None:
            return None
        if mode == "human":
            self._use(world)
            if self._window is None:
                self._window = Window(world.model, world.data, self._layout, self._config.camera)
            self._window.show(world.marks)
            return None
        width, height = self._config.width, self._config.height
        renderer, camera = self._renderer(world, width, height), self._config.camera
        if camera == FRAMED_CAMERA:
            camera = whole_scene(world.model, self._layout, across(self._layout), width / height)
        return renderer.colour(world.data, camera) if mode == "rgb_array" else renderer.depth(world.data, camera)

    def observation(self, world: World) -> dict[str, NDArray[Any]]:
        """Colour (height, width, 3) uint8 and depth (height, width) float32 [m] images of the robot's cameras."""
        size = self._config.image_size
        renderer = self._renderer(world, size, size)
        images: dict[str, NDArray[Any]] = {}
        for camera in self._cameras:
            colour, depth = renderer.colour_and_depth(world.data, camera)
            images[f"{camera}_rgb"] = colour
            images[f"{camera}_depth"] = np.minimum(depth, MAX_DEPTH)
        return images

    def observation_spaces(self) -> dict[str, spaces.Space[Any]]:
        """The spaces of `observation`."""
        size = self._config.image_size
        parts: dict[str, spaces.Space[Any]] = {}
        for camera in self._cameras:
            parts[f"{camera}_rgb"] = spaces.Box(0, 255, (size, size, 3), np.uint8)
            parts[f"{camera}_depth"] = spaces.Box(0.0, MAX_DEPTH, (size, size), np.float32)
        return parts

    def wait_for_window(self) -> None:
        """Keep the window, if there is one, open until its user closes it."""
        if self._window is not None:
            self._window.wait()

    def close(self) -> None:
        """Free renderers and window."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        if self._window is not None:
            self._window.close()
            self._window = None

    def _renderer(self, world: World, width: int, height: int) -> Renderer:
        """The renderer of that size; cameras are put where their bodies are: a step leaves them one substep back."""
        self._use(world)
        mujoco.mj_camlight(world.model, world.data)
        if (width, height) not in self._renderers:
            self._renderers[width, height] = Renderer(world.model, width, height)
        renderer = self._renderers[width, height]
        renderer.marks = world.marks
        return renderer

    def _use(self, world: World) -> None:
        """Close what was opened for another world."""
        if self._world is not world:
            self.close()
            self._world = world


class Window:
    """MuJoCo's own viewer, which shows one world in real time, robot and table in view, until its user closes it.

    Raises:
        RenderingUnavailable: there is no display.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: Layout, camera: str) -> None:
        self._data = data
        if not has_display():
            raise RenderingUnavailable("render_mode='human' needs a display; set DISPLAY, or use 'rgb_array'")
        viewer = importlib.import_module("mujoco.viewer")
        self._viewer = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        with self._viewer.lock():
            view = self._viewer.cam
            if camera != FRAMED_CAMERA:
                view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera).id
            else:  # this view the mouse can move
                framed = whole_scene(model, layout, across(layout), _WINDOW_ASPECT)
                view.type, view.lookat[:] = framed.type, framed.lookat
                view.azimuth, view.elevation, view.distance = framed.azimuth, framed.elevation, framed.distance
        self._shown, self._due = data.time, time.monotonic()
        self._marks: tuple[Mark, ...] = ()

    def show(self, marks: tuple[Mark, ...] = ()) -> None:
        """Show the present state when its time has come; nothing once the window has been closed."""
        if not self._viewer.is_running():
            return
        passed = self._data.time - self._shown
        now = time.monotonic()
        self._due = max(self._due, now - _MOST_LAG) + passed if passed >= 0 else now
        self._shown = self._data.time
        time.sleep(max(self._due - now, 0.0))
        if marks is not self._marks:
            with self._viewer.lock():
                self._viewer.user_scn.ngeom = 0
                add_marks(self._viewer.user_scn, marks)
            self._marks = marks
        self._viewer.sync()

    def wait(self) -> None:
        """Keep the window open until its user closes it."""
        while self._viewer.is_running():
            self._viewer.sync()
            time.sleep(_REFRESH)

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()
