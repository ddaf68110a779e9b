"""Figures of a robot's maps, as Figs. 1 and 2 of the paper: the reachability map, both inverse maps, and the base
poses for a cup on a table. Blue is high manipulability and red is low, as in the paper.

    python scripts/map_figures.py --robot fetch --out outputs/maps
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import tyro
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.cli.robot import robot_by_name
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.rendering.renderer import make_context
from clutter_env.scene.layout import TABLE_HEIGHT, Box, Layout, furniture
from clutter_env.simulation.model import add_meshes, has_visuals
from irm.chain import ArmChain
from irm.free_space import FreeSpace
from irm.inverse_map import InverseReachabilityMap, inverse_reachability
from irm.inverse_table import inverse_reachability_on_floor
from irm.query_kernels import base_turns, bases_of_key
from irm.query_keys import YAW_STEP, find_key, yaw_window
from irm.reachability_map import ReachabilityMap, cached_map
from irm.rotations import rotation
from irm.verification import Verified, tcp_poses, verify
from planners import CollisionWorld, Scene

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
CUP_RADIUS, CUP_HALF_HEIGHT = 0.035, 0.05
"""[m]"""


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


class MapRenderer:
    """Renders one robot among furniture; call `close` at the end."""

    def __init__(
        self,
        robot: RobotSpec,
        size: tuple[int, int],
        boxes: Sequence[Box] = (),
        cup: tuple[float, float, float] | None = None,
    ) -> None:
        """`size` in pixels; `cup` is the centre of an upright cylinder [m]."""
        spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
        if has_visuals(robot):
            add_meshes(spec, robot)
        _furnish(spec, boxes, cup)
        self._size = size[0] * SMOOTHING, size[1] * SMOOTHING
        spec.visual.global_.offwidth, spec.visual.global_.offheight = self._size
        self._model: mujoco.MjModel = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._columns = [self._model.joint(name).qposadr[0] for name in robot.drive_joints]
        for joint in robot.finger_joints:
            self._data.joint(joint).qpos = robot.max_finger_position
        for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            self._data.joint(joint).qpos = angle
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
        self._data.qpos[self._columns] = np.concatenate([base, q])
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


def _furnish(spec: mujoco.MjSpec, boxes: Sequence[Box], cup: tuple[float, float, float] | None) -> None:
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
            pos=cup,
            size=[CUP_RADIUS, CUP_HALF_HEIGHT, 0],
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


COLOURS = "turbo_r"
TABLE = Layout("figure", depth=0.8, width=1.6, is_front_only=False)
GROWN = 0.3
"""[m] by which the table's outline is grown, as in the paper."""
REACH = 1.6
"""[m] of floor shown around the table's middle."""
SPACING = 0.06
"""[m] Edge of the squares of floor; of each, the best candidate is drawn."""
YAWS = (-np.pi / 2, np.pi / 2)
"""Approach yaws allowed: from the robot's side of the table."""
PURPLE = "#7b2cbf"
PIXELS = 900


def draw_placement(robot: RobotSpec, cup: tuple[float, float]) -> Figure:
    """From above: the candidate bases of one TCP pose and the best valid one; beside it, the robot at this base.

    Args:
        robot: any robot with a map.
        cup: x, y of the cup, from the middle of the table [m].

    Raises:
        ValueError: no base is valid for this cup.
    """
    floor = FreeSpace.from_boxes([(0.0, 0.0, TABLE.depth, TABLE.width)], GROWN, (-REACH, -REACH, REACH, REACH))
    inverse_map = InverseReachabilityMap(cached_map(robot, orientations=266, pitches=(0.0,), heights=(0.7, 1.2)))
    tcp = np.array([*cup, TABLE_HEIGHT + robot.grasp_height])
    everywhere = _candidates(inverse_map, tcp)
    free = inverse_map.query(tcp, yaw_range=YAWS, free_space=floor, k=5)
    env = RetrieveEnv(num_objects=1, layout=TABLE, robot=robot)
    env.reset(seed=0)
    scene = replace(Scene.from_mujoco(env.model, env.data, robot), objects=())
    world, opening = CollisionWorld.from_scene(scene), robot.max_opening
    chosen = verify(
        ArmChain.from_robot(robot),
        free,
        lambda rank: tcp_poses(tcp, free.approach_yaw[rank]),
        lambda base, q: not world.hits(base, q, opening),
    )
    if not isinstance(chosen, Verified):
        raise ValueError(f"no base is valid for a cup at {tcp[:2]}; choose a position nearer to the table's edge")
    renderer = MapRenderer(robot, (PIXELS, PIXELS), furniture(TABLE), (*cup, TABLE_HEIGHT + CUP_HALF_HEIGHT))
    above = View((0.0, 0.0, 1.0), 6.0, 90.0, -90.0, 2 * REACH)
    robot_above = renderer.picture(chosen.base, chosen.configurations[0], above, show_floor=False)
    beside = renderer.picture(chosen.base, chosen.configurations[0], View((-0.2, 0.1, 0.65), 3.2, 68.0, -28.0))
    renderer.close()
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    plan, photograph = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _draw_plan(plan, everywhere, floor, chosen, cup, robot_above)
    photograph.imshow(beside)
    photograph.set_axis_off()
    mu = float(free.manipulability[chosen.rank])
    x, y, yaw = chosen.base
    photograph.set_title(f"the base at x = {x:.2f} m, y = {y:.2f} m, yaw = {np.degrees(yaw):.0f}°: μ = {mu:.3f}")
    return figure


def _candidates(inverse_map: InverseReachabilityMap, tcp: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The best base of every square of the floor, whether it is free or not: x, y [m], yaw [rad], μ, each (n,)."""
    grid = inverse_map.reachability_map.grid
    key = find_key(grid, float(tcp[2]), 0.0, 0.0)
    if key is None:
        raise ValueError(f"the TCP cannot reach the height {tcp[2]:.2f} m")
    yaws = base_turns(yaw_window(grid, key, YAWS, YAW_STEP))[:, None]
    own_x, own_y, own_yaw, own_mu = bases_of_key(inverse_map.bases, key.number)
    c, s = np.cos(yaws), np.sin(yaws)
    x = (tcp[0] + c * own_x - s * own_y).ravel()
    y = (tcp[1] + s * own_x + c * own_y).ravel()
    yaw, mu = (yaws + own_yaw).ravel(), np.tile(own_mu, len(yaws))
    best_first = np.argsort(-mu, kind="stable")
    squares = np.floor(np.column_stack([x, y])[best_first] / SPACING)
    _, first = np.unique(squares, axis=0, return_index=True)
    best = best_first[first]
    return x[best], y[best], yaw[best], mu[best].astype(float)


def _draw_plan(
    axes: Axes,
    bases: tuple[Floats, Floats, Floats, Floats],
    floor: FreeSpace,
    chosen: Verified,
    cup: tuple[float, float],
    robot_above: NDArray[np.uint8],
) -> None:
    half_depth, half_width = TABLE.depth / 2, TABLE.width / 2
    corner = (-half_depth, -half_width)
    axes.add_patch(Rectangle(corner, TABLE.depth, TABLE.width, facecolor="#e9dcc6", edgecolor="#8d7650", zorder=0))
    round_box = f"round,pad={GROWN},rounding_size={GROWN}"
    axes.add_patch(
        FancyBboxPatch(
            corner, TABLE.depth, TABLE.width, round_box, facecolor="none", edgecolor="#e0a800", linewidth=2.5, zorder=2
        )
    )
    x, y, yaw, mu = bases
    is_free = floor.are_free(x, y)
    scale = Normalize(0, float(mu.max()))
    for mask, alpha in ((~is_free, 0.18), (is_free, 1.0)):
        arrows = axes.quiver(
            x[mask],
            y[mask],
            np.cos(yaw[mask]),
            np.sin(yaw[mask]),
            mu[mask],
            cmap=COLOURS,
            norm=scale,
            alpha=alpha,
            pivot="mid",
            angles="xy",
            scale_units="xy",
            scale=1 / (0.9 * SPACING),
            width=0.0035,
            headwidth=4.5,
            headlength=5,
            headaxislength=4.5,
            zorder=1,
        )
    axes.imshow(robot_above, extent=(-REACH, REACH, -REACH, REACH), alpha=0.85, zorder=3)
    axes.add_patch(Circle(cup, CUP_RADIUS, facecolor="#d91a1a", edgecolor="white", zorder=4))
    base_x, base_y, base_yaw = chosen.base  # the verified base as an arrow along its heading
    axes.quiver(
        base_x,
        base_y,
        np.cos(base_yaw),
        np.sin(base_yaw),
        color=PURPLE,
        angles="xy",
        scale_units="xy",
        scale=1 / 0.42,
        width=0.011,
        zorder=5,
    )
    axes.annotate("cup", cup, (cup[0] + 0.06, cup[1] + 0.06), zorder=5)
    axes.text(half_depth - 0.03, -half_width + 0.05, "table", ha="right", color="#6b5836")
    axes.text(0.0, -half_width - GROWN - 0.09, f"outline grown by {GROWN} m", ha="center", color="#a87e00")
    axes.figure.colorbar(arrows, ax=axes, label="best manipulability μ at this place", shrink=0.85)
    axes.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title("bases from which the arm reaches the cup (faint: too near to the table)")


BLACK = np.array([0.05, 0.05, 0.05, 1.0])
COARSE: dict[str, Any] = {"voxel": 0.15, "orientations": 26}
"""The map of Fig. 1: coarse, so that the arrows do not hide each other."""
SLICE = 0.15
"""[m] Thickness of the slice of Fig. 1b."""
PANEL = (480, 440)
"""Size of one picture of Fig. 1 in pixels."""


def draw_maps(robot: RobotSpec) -> Figure:
    """Fig. 1: the reachability map, and its inverse by equation 4 and by equation 5."""
    rm = ReachabilityMap.build(robot, **COARSE)
    scale = Normalize(0, float(rm.manipulability.max()))
    colours = np.asarray(colormaps[COLOURS](scale(rm.manipulability)))
    home = np.array(robot.home)
    renderer = MapRenderer(robot, PANEL)
    far_half = rm.positions[:, 1] > 0
    p, R = rm.positions, _rotations(rm)
    tcps = Arrows(p[far_half], R[far_half, :, 0], colours[far_half], 0.10, 0.008)
    view = View((0.25, 0.3, 0.88), 3.5, 110.0, -18.0)
    pictures = [renderer.picture(np.zeros(3), home, view, [tcps])]
    for arrows, view in (_bases_of_equation_4(rm, colours), _bases_of_equation_5(rm, colours)):
        pictures.append(renderer.picture(np.zeros(3), home, view, arrows, show_robot=False))
    renderer.close()
    return _panels(pictures, scale)


def _rotations(rm: ReachabilityMap) -> Floats:
    """(n, 3, 3) TCP orientation of every pose."""
    return np.array([rotation(*angles) for angles in rm.grid.orientations.angles])[rm.indices()[1]]


def _bases_of_equation_4(rm: ReachabilityMap, colours: Floats) -> tuple[tuple[Arrows, ...], View]:
    """T_base = T_eff⁻¹ around one TCP pose: a slice through it from the side, as most bases lean or are in the air."""
    R_base, place = inverse_reachability(_rotations(rm), rm.positions)
    sliced = np.abs(place[:, 1]) < SLICE / 2
    tcp = Arrows(np.zeros((1, 3)), np.eye(3)[:1], BLACK[None], 0.4, 0.03)
    bases = Arrows(place[sliced], R_base[sliced, :, 0], colours[sliced], 0.13, 0.011)
    low, high = bases.tails.min(axis=0), bases.tails.max(axis=0)
    view = View((*(low + high) / 2,), 5.0, 90.0, 0.0, float(1.1 * (high - low).max()))
    return (bases, tcp), view


def _bases_of_equation_5(rm: ReachabilityMap, colours: Floats) -> tuple[tuple[Arrows, ...], View]:
    """T_base = Rz(-γ), Rz(π - γ) (x, y, 0) for the TCP R(0, β, α) at (0, 0, z); arrows of high μ are drawn on top."""
    x, y, z = rm.positions.T
    yaw, pitch, _ = rm.yaw_pitch_roll.T
    order = np.argsort(rm.manipulability)
    base_x, base_y, base_yaw = inverse_reachability_on_floor(x, y, yaw)
    lift = 0.02 + 0.02 * np.argsort(order) / len(order)
    place = np.column_stack([base_x, base_y, lift])
    ahead = np.column_stack([np.cos(base_yaw), np.sin(base_yaw), np.zeros(len(yaw))])
    keys = np.unique(np.column_stack([z, pitch]).round(6), axis=0)
    tails = np.column_stack([np.zeros((len(keys), 2)), keys[:, 0]])
    points = np.column_stack([np.cos(keys[:, 1]), np.zeros(len(keys)), -np.sin(keys[:, 1])])
    tcps = Arrows(tails, points, np.tile(BLACK, (len(keys), 1)), 0.12, 0.008)
    bases = Arrows(place, ahead, colours, 0.10, 0.008)
    return (bases, tcps), View((0.0, 0.0, 0.78), 3.4, 110.0, -28.0)


def _panels(pictures: list[NDArray[np.uint8]], scale: Normalize) -> Figure:
    titles = (
        "(a) reachability map (equation 3):\nTCP poses, the half on the robot's left",
        "(b) inverse map (equation 4): slice of the\nbases around one TCP pose (black), from the side",
        "(c) inverse map (equation 5):\nbases on the floor, TCP poses (black)",
    )
    figure = Figure(figsize=(13.2, 4.4), layout="constrained")
    axes = figure.subplots(1, len(pictures))
    for axis, picture, title in zip(axes, pictures, titles, strict=True):
        axis.imshow(picture)
        axis.set_title(title, fontsize=11)
        axis.set_axis_off()
    mu = ScalarMappable(scale, COLOURS)
    figure.colorbar(mu, ax=axes, label="manipulability μ (linear rows in m)", fraction=0.02, pad=0.01)
    return figure


def main(
    robot: str = "fetch", out: Path = Path("outputs/maps"), cup: tuple[float, float] = (0.1, 0.3), dpi: int = 90
) -> None:
    """Draw and save the figures.

    Args:
        robot: name of a robot, or module:NAME of a RobotSpec.
        out: folder of the pictures.
        cup: position of the cup on the table, from its middle: away from the robot, and to the left [m].
        dpi: resolution of the pictures.
    """
    spec = robot_by_name(robot)
    out.mkdir(parents=True, exist_ok=True)
    figures = {"maps": draw_maps(spec), "placement": draw_placement(spec, cup)}
    for name, figure in figures.items():
        figure.savefig(out / f"irm_{name}.png", dpi=dpi, pil_kwargs={"optimize": True})
        print(f"picture: {out / f'irm_{name}.png'}")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
