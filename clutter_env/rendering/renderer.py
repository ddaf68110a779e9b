"""Rendering with any OpenGL backend of the machine. No OpenGL library is loaded before the first image.

OpenGL may be used only by the process that opened it, and a context only by the thread that made it. A forked process
has a copy of the driver's memory without its threads, and hangs in its first call.
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
from PIL import Image

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
"""Rendered groups: the scene (0), the meshes (1) and the primitives (2) that no mesh replaces."""
_GEOM, _PLANE, _NOTHING = (
    int(mujoco.mjtObj.mjOBJ_GEOM),
    int(mujoco.mjtGeom.mjGEOM_PLANE),
    int(mujoco.mjtGeom.mjGEOM_NONE),
)
"""Integers, because comparing MuJoCo's enumerations is slow."""
_SKY = np.array((235, 242, 248), np.uint8).view("V3")[0]
"""Colour of empty pixels in camera observations. It is a single value, which NumPy writes ten times as fast."""
_FINENESS = 2
"""Pictures for people are drawn this many times as wide and high, and averaged, so that no edge is jagged."""
_FLOOR = (0.70, 0.71, 0.73, 1.0)
_SHADOW_PIXELS, _SHADOW_REACH = 2560, 2.4
"""Pixels of the shadow map along each side, and its half side in extents of the model. MuJoCo's 4096 pixels are
slow."""
_SHADOW_CENTRE, _SUN_DISTANCE = np.array((-3.0, 2.6, 0.4)), 4.0
"""[m] Centre of the shadow map, and distance to the sun. On its sunward side the floor gets stripes, outside all usual
views."""
_opened_by: set[int] = set()
"""Processes that have opened OpenGL: this process, or those from which it was forked."""


def has_display() -> bool:
    """Whether a window could be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def make_context(width: int, height: int) -> Any:
    """Make an off-screen context: the backend that MUJOCO_GL names, else the first that works.

    Raises:
        RenderingUnavailable: none works, and the message names the missing packages. Or this process was forked from a
            process that had rendered.
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
        except Exception as error:  # each backend fails in its own way, and all failures are reported below
            failures.append(f"{wanted or backend.removeprefix('mujoco.')}: {error}")
    raise RenderingUnavailable(f"no OpenGL context ({'; '.join(failures)}); {_DEBIAN_PACKAGES}")


def _open(backend: str, width: int, height: int) -> Any:
    _opened_by.add(os.getpid())
    # Undo PyOpenGL's choice of platform when the backend does not work.
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
    """Raise RenderingUnavailable if this process was forked from a process that had opened OpenGL."""
    if _opened_by - {os.getpid()}:
        raise RenderingUnavailable(
            "this process was forked from one that had rendered, and OpenGL does not survive a fork; start worker "
            "processes by spawning: gym.make_vec(..., vectorization_mode='async', vector_kwargs={'context': 'spawn'}), "
            "AsyncVectorEnv(..., context='spawn'), multiprocessing.get_context('spawn')"
        )


def add_marks(scene: mujoco.MjvScene, marks: Iterable[Mark]) -> None:
    """Add marks to the scene to be drawn."""
    for mark in marks:
        cosine, sine = math.cos(mark.yaw), math.sin(mark.yaw)
        turn = np.array((cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0))
        size, box = np.append(mark.half_extents, _MARK_HALF_HEIGHT), mujoco.mjtGeom.mjGEOM_BOX
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], box, size, mark.centre, turn, np.asarray(mark.rgba, np.float32))
        scene.ngeom += 1


class Renderer:
    """Renders one model through any of its cameras, colour or depth.

    Pictures for people have smooth edges, and shadows on a darker floor. Camera observations lack these and are faster.

    Raises:
        RenderingUnavailable: this machine has no working OpenGL. The methods raise it in other threads or processes
            than that in which the renderer was made.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model = model
        self._size = width, height
        model.vis.quality.shadowsize, model.vis.map.shadowclip = _SHADOW_PIXELS, _SHADOW_REACH
        buffer = model.vis.global_
        buffer.offwidth, buffer.offheight = max(buffer.offwidth, width), max(buffer.offheight, height)
        self._process, self._thread = os.getpid(), threading.get_ident()
        self._context = make_context(width, height)
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
    has_shadows: bool = True
    """Whether pictures for people have them; from near they are coarse."""
    _context: Any = None
    _is_fine: bool = False

    def colour(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera) -> NDArray[np.uint8]:
        """Colours (height, width, 3) uint8. `camera` is the name of a camera of the model, or a free camera."""
        width, height = (_FINENESS * side for side in self._size)
        if not self._is_fine:
            self._check_owner()
            self._context.make_current()
            mujoco.mjr_resizeOffscreen(width, height, self._device)
            self._is_fine = True
        picture, flags = np.empty((height, width, 3), np.uint8), self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self.has_shadows
        self._draw(data, camera, picture, None, for_people=True)
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        return np.asarray(Image.fromarray(picture[::-1]).reduce(_FINENESS))

    def depth(self, data: mujoco.MjData, camera: str | mujoco.MjvCamera) -> NDArray[np.float32]:
        """Distances (height, width) along the camera's axis [m]. Empty pixels have that of the far plane."""
        width, height = self._size
        buffer = np.empty((height, width), np.float32)
        self._draw(data, camera, None, buffer)
        return self._metric(buffer)

    def camera_images(
        self, data: mujoco.MjData, camera: str, labels: NDArray[np.uint8] | None
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8] | None]:
        """Colour and depth, rendered at once, and (height, width) the label of the geom at each pixel.

        Args:
            data: the state.
            camera: name of a camera of the model.
            labels: (ngeom,) labels of the model's geoms. Empty pixels get 0. Without labels the third image is None.
                With labels, boards that are transparent for people are opaque in the colours too.
        """
        width, height = self._size
        picture, buffer = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 0  # the sky takes a fifth of the time, and is seldom in view
        self._draw(data, camera, picture, buffer, is_opaque=labels is not None)
        flags[mujoco.mjtRndFlag.mjRND_SKYBOX] = 1
        picture.view("V3")[..., 0][buffer == 0] = _SKY
        colour = np.ascontiguousarray(picture[::-1])
        if labels is None:
            return colour, self._metric(buffer), None
        # Render the scene again with each geom in a colour that encodes its label. Geoms of label 1 are left out,
        # because their meshes have most facets. Pixels whose depth differs now show them.
        values = labels.tolist()
        for geom in self._scene.geoms[: self._scene.ngeom]:
            geom.segid = values[geom.objid] if geom.objtype == _GEOM else 0  # drawn as this number plus 1
            if geom.segid == 1:
                geom.type = _NOTHING
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        behind = np.empty_like(buffer)
        self._read(picture, behind)
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 0
        found = np.where(behind == buffer, picture[..., 0], np.uint8(2))
        return colour, self._metric(buffer), np.maximum(found[::-1], 1) - np.uint8(1)

    def _metric(self, buffer: NDArray[np.float32]) -> NDArray[np.float32]:
        """Distances [m], upright, from the graphics device's depth buffer, which is 0 at the far plane."""
        extent = self._model.stat.extent
        near, far = self._model.vis.map.znear * extent, self._model.vis.map.zfar * extent
        return np.ascontiguousarray((near / (near / far + (1 - near / far) * buffer))[::-1]).astype(np.float32)

    def _draw(
        self,
        data: mujoco.MjData,
        camera: str | mujoco.MjvCamera,
        picture: NDArray[np.uint8] | None,
        depth: NDArray[np.float32] | None,
        for_people: bool = False,
        is_opaque: bool = False,
    ) -> None:
        self._check_owner()
        self._context.make_current()
        view = camera
        if isinstance(view, str):
            view = mujoco.MjvCamera()
            view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, view, everything, self._scene)
        if view.type == mujoco.mjtCamera.mjCAMERA_FIXED:
            self._leave_out_of_sight(data, view.fixedcamid)
        if for_people:
            self._light_for_people()
        if is_opaque:
            for geom in self._scene.geoms[: self._scene.ngeom]:
                geom.rgba[3] = 1.0
        add_marks(self._scene, self.marks)
        self._read(picture, depth)

    def _light_for_people(self) -> None:
        """Let the sun cast shadows, on a floor dark enough to show them."""
        for light in self._scene.lights[: self._scene.nlight]:
            if not light.headlight:
                light.castshadow, light.pos[:] = True, _SHADOW_CENTRE - _SUN_DISTANCE * np.array(light.dir)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.type == _PLANE:
                geom.rgba[:] = _FLOOR

    def _read(self, picture: NDArray[np.uint8] | None, depth: NDArray[np.float32] | None) -> None:
        """Draw the scene and read the result."""
        height, width = next(image.shape[:2] for image in (picture, depth) if image is not None)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, self._device)
        mujoco.mjr_readPixels(picture, depth, viewport, self._device)

    def _leave_out_of_sight(self, data: mujoco.MjData, camera: int) -> None:
        """Leave out geoms outside a camera's view, because a software renderer spends time on every facet."""
        model, (width, height) = self._model, self._size
        up = math.tan(math.radians(model.cam_fovy[camera]) / 2)
        right = up * width / height
        near = model.vis.map.znear * model.stat.extent
        # Normals of the sides of the view frustum, inwards, in the camera's frame and in the world's.
        sides = np.array(((-1, 0, -right), (1, 0, -right), (0, -1, -up), (0, 1, -up), (0, 0, -1)))
        sides = sides @ data.cam_xmat[camera].reshape(3, 3).T
        axes, boxes = data.geom_xmat.reshape(-1, 3, 3), model.geom_aabb
        centres = data.geom_xpos + (axes @ boxes[:, :3, None])[..., 0] - data.cam_xpos[camera]
        reach = (np.abs(sides @ axes) * boxes[:, None, 3:]).sum(axis=-1)  # of a box towards each side
        is_seen = (centres @ sides.T + reach > (0, 0, 0, 0, near)).all(axis=1)
        is_seen |= model.geom_type == _PLANE
        hidden = (~is_seen).tolist()
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == _GEOM and hidden[geom.objid]:
                geom.type = _NOTHING

    def _check_owner(self) -> None:
        """Raise RenderingUnavailable if the context was made in another process or in another thread."""
        if self._process != os.getpid():
            _check_no_fork()
        if self._thread != threading.get_ident():
            raise RenderingUnavailable(
                "this environment has rendered in another thread, and an OpenGL context belongs to its thread; render "
                "and close in one thread, or make one environment for each thread"
            )

    def __del__(self) -> None:
        """Free the resources if `close` was not called. MuJoCo would free those of whichever context is current
        then."""
        is_owner = self._context is not None and threading.get_ident() == self._thread
        if is_owner and not sys.is_finalizing():
            self.close()

    def close(self) -> None:
        """Free the OpenGL resources. May be called twice. A forked process has none to free."""
        if self._context is not None and self._process == os.getpid():
            self._check_owner()
            self._context.make_current()
            self._device.free()
            self._context.free()
        self._context = None
