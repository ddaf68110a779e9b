"""Images of one environment: `render()`, its window, camera observations. Rendering starts with the first image."""

from __future__ import annotations

import importlib
import time
import zlib
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from clutter_env.config import EnvConfig
from clutter_env.errors import RenderingUnavailable
from clutter_env.rendering.calibration import back_project, camera_matrix, camera_pose, heights
from clutter_env.rendering.framing import FRAMED_CAMERA, across, whole_scene
from clutter_env.rendering.renderer import Renderer, add_marks, has_display
from clutter_env.scene.layout import Layout
from clutter_env.simulation.world import Mark, World

ROBOT, FURNITURE, FIRST_OBJECT = 1, 2, 3
"""Values of a segmentation: the robot, furniture, the object in slot 0. Ground and sky are 0."""
POINT_BOUND = 16.0
"""[m] Clip of points in observations."""
_ON_GROUND = 0.02
"""[m] Points lower than this are regarded as ground, which has more points than all objects together."""
MAX_DEPTH = 8.0
"""[m] Clip of the depth images in observations."""
_WINDOW_ASPECT = 1.5
"""Width over height of MuJoCo's initial window, a little less."""
_MOST_LAG = 0.1
"""[s] A simulation that is farther behind the clock, for example after planning, does not catch up."""
_REFRESH = 0.03
"""[s] between two updates while nothing moves."""


class EnvRenderer:
    """The renderers of one environment, one for each image size. They are made again when its world changes."""

    def __init__(self, config: EnvConfig) -> None:
        self._config = config
        self._layout, self._cameras = config.find_layout(), config.observed_cameras
        self._renderers: dict[tuple[int, int], Renderer] = {}
        self._window: Window | None = None
        self._world: World | None = None

    @property
    def largest(self) -> tuple[int, int]:
        """Width and height [pixels] of the largest image."""
        size = self._config.image_size if self._cameras else 0
        return max(self._config.width, size), max(self._config.height, size)

    def render(self, world: World) -> NDArray[Any] | None:
        """The result of `render()` in this configuration's mode, see `BaseEnv.render`."""
        mode = self._config.render_mode
        if mode is None:
            return None
        if mode == "human":
            self._use(world)
            if self._window is None:
                self._window = Window(world, self._layout, self._config.camera)
            self._window.show(world.marks)
            return None
        width, height = self._config.width, self._config.height
        renderer, camera = self._renderer(world, width, height), self._config.camera
        if camera == FRAMED_CAMERA:
            camera = whole_scene(world.model, self._layout, world.scene.base, across(self._layout), width / height)
        return renderer.colour(world.data, camera) if mode == "rgb_array" else renderer.depth(world.data, camera)

    def observation(self, world: World, images: dict[str, NDArray[Any]] | None = None) -> dict[str, NDArray[Any]]:
        """Observation of the cameras, in the form of `obs_mode`, see `observation_spaces`.

        Args:
            world: the world, whose state gives the cameras' poses.
            images: from `images`. Rendered if not given.
        """
        images = self.images(world) if images is None else images
        return images if self._config.obs_mode != "pointcloud" else self._cloud(world, images)

    def observation_spaces(self) -> dict[str, spaces.Box]:
        """The spaces of `observation`.

        Each camera has colour (height, width, 3) uint8, depth (height, width, 1) float32 [m] and optionally a
        segmentation (height, width, 1) uint8. Its values are 0 for ground and sky, `ROBOT`, `FURNITURE`, and
        `FIRST_OBJECT` + slot. Alternatively all cameras together give `num_points` points (n, 3) float32 [m] in the
        base frame, with their colours and segments. Points on the ground are left out. Points are repeated if fewer are
        visible.
        """
        size, count = self._config.image_size, self._config.num_points
        bounds: dict[str, tuple[float, int, Any]]
        bounds = {"rgb": (255, 3, np.uint8), "depth": (MAX_DEPTH, 1, np.float32), "segmentation": (255, 1, np.uint8)}
        parts: dict[str, spaces.Box] = {}
        if self._config.obs_mode == "pointcloud":
            parts["points"] = spaces.Box(-POINT_BOUND, POINT_BOUND, (count, 3), np.float32)
            for name, kind in zip(self._cloud_names[1:], self._kinds, strict=True):
                highest, channels, dtype = bounds[kind]
                parts[name] = spaces.Box(0, highest, (count, channels), dtype)
            return parts
        for camera in self._cameras:
            for kind in ("rgb", "depth", *self._kinds[1:]):
                highest, channels, dtype = bounds[kind]
                parts[f"{camera}_{kind}"] = spaces.Box(0, highest, (size, size, channels), dtype)
        return parts

    def calibration(self, world: World) -> dict[str, dict[str, NDArray[np.float64]]]:
        """Calibration of the observed cameras for `info`: K (3, 3) and T_base_camera (4, 4) by name."""
        if not self._cameras:
            return {}
        size = self._config.image_size
        return {
            "K": {name: camera_matrix(world.model, name, size, size) for name in self._cameras},
            "T_base_camera": {name: camera_pose(world, name) for name in self._cameras},
        }

    @property
    def _kinds(self) -> tuple[str, ...]:
        """Properties of a point besides its position."""
        return ("rgb", "segmentation") if self._config.segmentation else ("rgb",)

    @property
    def _cloud_names(self) -> tuple[str, ...]:
        return ("points", *(f"point_{kind}" for kind in self._kinds))

    def _cloud(self, world: World, images: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Sample the points in the images, one from each of equally long parts of the list of all valid pixels.

        The random numbers depend on the state alone. So the same state gives the same cloud, also after it was
        restored.
        """
        calibration, count = self.calibration(world), self._config.num_points
        placed = [(calibration["K"][name], calibration["T_base_camera"][name]) for name in self._cameras]
        depths = [images[f"{name}_depth"][..., 0] for name in self._cameras]
        wanted = [
            np.flatnonzero((heights(depth, *pose) > _ON_GROUND) & (depth < MAX_DEPTH))
            for depth, pose in zip(depths, placed, strict=True)
        ]
        total, rng = sum(map(len, wanted)), np.random.default_rng(zlib.crc32(world.data.qpos.tobytes()))
        chosen = (
            ((np.arange(count) + rng.random(count)) * (total / count)).astype(np.intp) if total else np.empty(0, int)
        )
        ends = np.cumsum([len(pixels) for pixels in wanted])
        cloud: dict[str, list[NDArray[Any]]] = {name: [] for name in self._cloud_names}
        for name, pose, depth, pixels, end in zip(self._cameras, placed, depths, wanted, ends, strict=True):
            flat = pixels[chosen[(chosen >= end - len(pixels)) & (chosen < end)] - (end - len(pixels))]
            rows, columns = np.divmod(flat, depth.shape[1])
            points = back_project(np.column_stack((columns, rows)), depth.ravel()[flat], *pose)
            cloud["points"].append(np.clip(points, -POINT_BOUND, POINT_BOUND).astype(np.float32))
            for kind in self._kinds:
                cloud[f"point_{kind}"].append(images[f"{name}_{kind}"][rows, columns])
        if not total:
            return {name: np.zeros_like(space.low) for name, space in self.observation_spaces().items()}
        return {name: np.concatenate(parts) for name, parts in cloud.items()}

    def images(self, world: World) -> dict[str, NDArray[Any]]:
        """The images of the observed cameras."""
        images: dict[str, NDArray[Any]] = {}
        labels = _labels(world) if self._config.segmentation else None
        for camera in self._cameras:
            size = self._config.image_size
            colour, depth, segments = self._renderer(world, size, size).camera_images(world.data, camera, labels)
            images[f"{camera}_rgb"] = colour
            images[f"{camera}_depth"] = np.minimum(depth, MAX_DEPTH)[..., None]
            if segments is not None:
                images[f"{camera}_segmentation"] = segments[..., None]
        return images

    def wait_for_window(self) -> None:
        """Keep the window, if any, open until its user closes it."""
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
        """The renderer of that size. The cameras are moved to their bodies, because a step leaves them one substep
        behind."""
        self._use(world)
        mujoco.mj_camlight(world.model, world.data)
        if (width, height) not in self._renderers:
            self._renderers[width, height] = Renderer(world.model, width, height)
        renderer = self._renderers[width, height]
        renderer.marks = world.marks
        return renderer

    def _use(self, world: World) -> None:
        """Close the renderers and the window of another world."""
        if self._world is not world:
            self.close()
            self._world = world


def _labels(world: World) -> NDArray[np.uint8]:
    """Value of the segmentation for each geom (ngeom,)."""
    model, index = world.model, world.index
    labels = np.full(model.ngeom, FURNITURE, np.uint8)
    labels[model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)] = 0
    labels[model.body_rootid[model.geom_bodyid] == model.body_rootid[index.base_body]] = ROBOT
    labels[index.object_geoms] = FIRST_OBJECT + index.geom_slots
    return labels


class Window:
    """MuJoCo's own viewer, which shows one world in real time, robot and table in view, until its user closes it.

    Raises:
        RenderingUnavailable: no display was found.
    """

    def __init__(self, world: World, layout: Layout, camera: str) -> None:
        model, data = world.model, world.data
        self._data = data
        if not has_display():
            raise RenderingUnavailable("render_mode='human' needs a display; set DISPLAY, or use 'rgb_array'")
        viewer = importlib.import_module("mujoco.viewer")
        self._viewer = viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        with self._viewer.lock():
            view = self._viewer.cam
            if camera != FRAMED_CAMERA:
                view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera).id
            else:  # the mouse can move this view
                framed = whole_scene(model, layout, world.scene.base, across(layout), _WINDOW_ASPECT)
                view.type, view.lookat[:] = framed.type, framed.lookat
                view.azimuth, view.elevation, view.distance = framed.azimuth, framed.elevation, framed.distance
        self._shown, self._due = data.time, time.monotonic()
        self._marks: tuple[Mark, ...] = ()

    def show(self, marks: tuple[Mark, ...] = ()) -> None:
        """Show the present state when it is due. Do nothing after the window has been closed."""
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
