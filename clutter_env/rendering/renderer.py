"""Rendering of images with the OpenGL that the machine has; no OpenGL library is loaded before the first image.

OpenGL may be used by the process that opened it, and a context only by the thread that made it: a forked process has a
copy of the driver's memory without its threads, and hangs in its first call.
"""

from __future__ import annotations

import importlib
import math
import os
import sys
import threading
from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.errors import RenderingUnavailable
from clutter_env.simulation.world import Mark

_DEBIAN_PACKAGES = (
    "on Debian or Ubuntu install libegl1 libegl-mesa0 libgl1-mesa-dri (EGL), or libosmesa6 (OSMesa, software only)"
)
_OFF = ("disable", "disabled", "off", "false", "0")
_MAX_GEOMS = 2000
_MARK_HALF_HEIGHT = 0.001
"""[m] of the drawn marks."""
_GEOM_GROUPS = (1, 1, 1, 0, 0, 0)
"""Rendered: the scene (0), the meshes (1) and the primitives (2) that no mesh replaces."""
_opened_by: set[int] = set()
"""Processes that have opened OpenGL: this one, or those from which it was forked."""


def has_display() -> bool:
    """Whether a window could be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def make_context(width: int, height: int) -> Any:
    """An off-screen context: the one that MUJOCO_GL names, else the first that works.

    Raises:
        RenderingUnavailable: none works; the message names the missing packages. Or this process was forked from
            one that had rendered.
    """
    _check_no_fork()
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in _OFF:
        raise RenderingUnavailable(f"rendering is switched off by MUJOCO_GL={wanted}; unset it to render images")
    backends = ["mujoco.gl_context"] if wanted or has_display() else ["mujoco.egl", "mujoco.osmesa"]
    failures = []
    for backend in backends:
        try:
            return _open(backend, width, height)
        except Exception as error:  # each backend fails in its own way; all failures are reported below
            failures.append(f"{wanted or backend.removeprefix('mujoco.')}: {error}")
    raise RenderingUnavailable(f"no OpenGL context ({'; '.join(failures)}); {_DEBIAN_PACKAGES}")


def _open(backend: str, width: int, height: int) -> Any:
    _opened_by.add(os.getpid())
    # PyOpenGL's choice of platform is undone when the backend does not work.
    before = os.environ.get("PYOPENGL_PLATFORM")
    try:
        context = importlib.import_module(backend).GLContext(width, height)
        context.make_current()
    except Exception:
        if before is None:
            os.environ.pop("PYOPENGL_PLATFORM", None)
        raise
    return context


def _check_no_fork() -> None:
    """Raise RenderingUnavailable if this process was forked from one that had opened OpenGL."""
    if _opened_by - {os.getpid()}:
        raise RenderingUnavailable(
            "this process was forked from one that had rendered, and OpenGL does not survive a fork; start worker "
            "processes by spawning: gym.make_vec(..., vectorization_mode='async', vector_kwargs={'context': 'spawn'}), "
            "AsyncVectorEnv(..., context='spawn'), multiprocessing.get_context('spawn')"
        )


def add_marks(scene: mujoco.MjvScene, marks: Iterable[Mark]) -> None:
    """Add marks to what is about to be drawn."""
    for mark in marks:
        cosine, sine = math.cos(mark.yaw), math.sin(mark.yaw)
        turn = np.array((cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0))
        size, box = np.append(mark.half_extents, _MARK_HALF_HEIGHT), mujoco.mjtGeom.mjGEOM_BOX
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], box, size, mark.centre, turn, np.asarray(mark.rgba, np.float32))
        scene.ngeom += 1


class Renderer:
    """Renders one model through any of its cameras, colour or depth; without shadows and multisampling.

    Raises:
        RenderingUnavailable: this machine has no working OpenGL. Its methods raise it in another thread or process
            than the one in which the renderer was made.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model = model
        self._size = width, height
        buffer = model.vis.global_
        buffer.offwidth, buffer.offheight = max(buffer.offwidth, width), max(buffer.offheight, height)
        self._process, self._thread = os.getpid(), threading.get_ident()
        self._context: Any = make_context(width, height)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = _GEOM_GROUPS
        self._option.sitegroup[:] = 0
        self._device = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._device)
        self._device.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    marks: tuple[Mark, ...] = ()
    """Shown from the next image on."""

    def colour(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera) -> NDArray[np.uint8]:
        """(height, width, 3) uint8; `camera` is the name of a camera of the model, or a free camera."""
        width, height = self._size
        picture = np.empty((height, width, 3), np.uint8)
        self._draw(data, camera, picture, None)
        return np.ascontiguousarray(picture[::-1])

    def depth(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera) -> NDArray[np.float32]:
        """(height, width) distance along the camera's axis [m]; the far plane where nothing is."""
        width, height = self._size
        buffer = np.empty((height, width), np.float32)
        self._draw(data, camera, None, buffer)
        return self._metric(buffer)

    def colour_and_depth(self, data: mujoco.MjData, camera: str) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Colour and depth as above, rendered once."""
        width, height = self._size
        picture, buffer = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        self._draw(data, camera, picture, buffer)
        return np.ascontiguousarray(picture[::-1]), self._metric(buffer)

    def _metric(self, buffer: NDArray[np.float32]) -> NDArray[np.float32]:
        """Distances [m], upright, from the graphics device's depth buffer (0 at the far plane)."""
        extent = self._model.stat.extent
        near, far = self._model.vis.map.znear * extent, self._model.vis.map.zfar * extent
        return np.ascontiguousarray((near / (near / far + (1 - near / far) * buffer))[::-1]).astype(np.float32)

    def _draw(
        self,
        data: mujoco.MjData,
        camera: str | mujoco.MjvCamera,
        picture: NDArray[np.uint8] | None,
        depth: NDArray[np.float32] | None,
    ) -> None:
        self._check_owner()
        self._context.make_current()
        view = camera
        if isinstance(view, str):
            view = mujoco.MjvCamera()
            view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, view, everything, self._scene)
        add_marks(self._scene, self.marks)
        viewport = mujoco.MjrRect(0, 0, *self._size)
        mujoco.mjr_render(viewport, self._scene, self._device)
        mujoco.mjr_readPixels(picture, depth, viewport, self._device)

    def _check_owner(self) -> None:
        """Raise RenderingUnavailable if the context was made in another process or in another thread."""
        if self._process != os.getpid():
            _check_no_fork()
        if self._thread != threading.get_ident():
            raise RenderingUnavailable(
                "this environment has rendered in another thread, and an OpenGL context belongs to its thread; render "
                "and close in one thread, or make one environment for each thread"
            )

    def close(self) -> None:
        """Free the OpenGL resources; may be called twice. A forked process has none to free."""
        if self._context is not None and self._process == os.getpid():
            self._check_owner()
            self._context.make_current()
            self._device.free()
            self._context.free()
        self._context = None
