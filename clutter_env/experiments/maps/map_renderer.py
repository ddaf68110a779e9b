"""Pictures of a robot among boxes, arrows and a cup, for the figures of reachability maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.experiments.maps.posed_robot import PosedRobot
from clutter_env.rendering.renderer import make_context
from clutter_env.scene.layout import Box
from clutter_env.simulation.model import add_meshes, has_visuals

__all__ = ["Arrows", "Cup", "MapRenderer", "View"]

Floats = NDArray[np.float64]

FAR = 30.0
"""[m] Far clipping plane of the camera."""
NEAR = 0.02
"""[m] Near clipping plane."""
MAX_GEOMS = 20_000
"""Largest number of shapes in a picture, arrows included."""
SMOOTHING = 2
"""Rendered pixels along each edge of one pixel of the picture: they are averaged."""
FLOOR = ((0.93, 0.93, 0.94), (0.88, 0.89, 0.91))
"""Colours of the floor's tiles."""
TILE = 0.5
"""[m] edge of the floor's tiles."""
WOOD = (0.80, 0.68, 0.52, 1.0)


class View(NamedTuple):
    """Camera of a picture.

    `target` (3,) [m] is in its middle; `distance` [m], `azimuth` and `elevation` [degrees] as in MuJoCo; `height` [m]
    of the scene that the picture shows in parallel projection, 0 for perspective.
    """

    target: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float
    height: float = 0.0


class Arrows(NamedTuple):
    """Arrows that start at `tails` (n, 3) [m], point along `directions` (n, 3), coloured (n, 4)."""

    tails: Floats
    directions: Floats
    colours: Floats
    length: float
    width: float


class Cup(NamedTuple):
    """An upright cylinder: centre (3,), radius and half height [m]."""

    position: tuple[float, float, float]
    radius: float = 0.035
    half_height: float = 0.05


class MapRenderer:
    """Renders one robot among furniture; call `close` at the end."""

    def __init__(
        self, robot: RobotSpec, size: tuple[int, int], boxes: Sequence[Box] = (), cup: Cup | None = None
    ) -> None:
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
        if has_visuals(robot):
            add_meshes(spec, robot)
        _furnish(spec, boxes, cup)
        self._size = size[0] * SMOOTHING, size[1] * SMOOTHING
        spec.visual.global_.offwidth, spec.visual.global_.offheight = self._size
        self._posed = PosedRobot(spec, robot)
        self._model, self._data = self._posed.model, self._posed.data
        self._model.stat.extent = 1.0
        self._model.vis.map.znear, self._model.vis.map.zfar = NEAR, FAR
        self._fovy = float(self._model.vis.global_.fovy)
        self._context = make_context(*self._size)
        self._device = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._device)

    def picture(
        self,
        base: Floats,
        q: Floats,
        view: View,
        arrows: Sequence[Arrows] = (),
        *,
        show_robot: bool = True,
        show_floor: bool = True,
    ) -> NDArray[np.uint8]:
        """One picture.

        Args:
            base: (3,) x, y [m], yaw [rad].
            q: (1 + n,) torso and arm.
            view: the camera.
            arrows: to draw.
            show_robot, show_floor: whether they are visible.

        Returns:
            (height, width, 4) uint8 RGBA; pixels without a shape are transparent.
        """
        self._posed.put(base, q)
        mujoco.mj_forward(self._model, self._data)
        self._model.vis.global_.fovy = view.height or self._fovy
        scene, option, camera = mujoco.MjvScene(self._model, maxgeom=MAX_GEOMS), mujoco.MjvOption(), mujoco.MjvCamera()
        option.geomgroup[:] = (show_floor, show_robot, show_robot, 0, 0, 0)
        option.sitegroup[:] = 0
        camera.lookat[:] = view.target
        camera.orthographic = view.height > 0
        camera.distance, camera.azimuth, camera.elevation = view.distance, view.azimuth, view.elevation
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, self._data, option, None, camera, everything, scene)
        for some in arrows:
            _add_arrows(scene, some)
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        return self._drawn(scene)

    def _drawn(self, scene: mujoco.MjvScene) -> NDArray[np.uint8]:
        width, height = self._size
        self._context.make_current()
        colour, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, scene, self._device)
        mujoco.mjr_readPixels(colour, depth, viewport, self._device)
        alpha = np.where(depth < depth.max(), 255.0, 0.0)[..., None]
        fine = np.concatenate([colour * (alpha > 0), alpha], axis=2)[::-1]
        shape = (height // SMOOTHING, SMOOTHING, width // SMOOTHING, SMOOTHING, 4)
        coarse = fine.reshape(shape).mean(axis=(1, 3))
        coarse[..., :3] *= 255.0 / np.maximum(coarse[..., 3:], 1.0)
        return coarse.round().clip(0, 255).astype(np.uint8)

    def close(self) -> None:
        """Free the memory of the graphics driver."""
        self._context.make_current()
        self._device.free()
        self._context.free()


def _furnish(spec: mujoco.MjSpec, boxes: Sequence[Box], cup: Cup | None) -> None:
    """Floor, light, furniture, cup."""
    world = spec.worldbody
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.45] * 3
    spec.visual.headlight.specular = [0.0] * 3
    world.add_light(pos=[-2, -2, 5], dir=[0.35, 0.35, -0.9], diffuse=[0.3] * 3, castshadow=False)
    spec.add_texture(
        name="tiles",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=FLOOR[0],
        rgb2=FLOOR[1],
        width=512,
        height=512,
    )
    floor = spec.add_material(name="floor", texrepeat=[0.5 / TILE, 0.5 / TILE], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[4, 4, 1], material="floor", group=0)
    for box in boxes:
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, pos=box.position, size=box.half_extents, rgba=WOOD, group=0, mass=0
        )
    if cup is not None:
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=cup.position,
            size=[cup.radius, cup.half_height, 0],
            rgba=[0.85, 0.1, 0.1, 1],
            group=0,
            mass=0,
        )


def _add_arrows(scene: mujoco.MjvScene, arrows: Arrows) -> None:
    heads = arrows.tails + arrows.directions * arrows.length
    for tail, head, colour in zip(arrows.tails, heads, arrows.colours, strict=True):
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.eye(3).ravel(), colour.astype(np.float32)
        )
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, arrows.width, tail, head)
        scene.ngeom += 1
