"""Drag a gripper in the browser, and see where the base may stand: bases coloured by μ, the arm, and what touches.

    pip install viser
    python examples/drag_gripper.py --robot fetch     # then open the address that it prints

The robot stands at the best base, or where sliders put it; what touches there, however the arm reaches, is red.
"""

from __future__ import annotations

import importlib
import math
import threading
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import tyro
from matplotlib import colormaps
from numpy.typing import NDArray

from assets import RobotSpec
from assets.robots import robot as find_robot
from irm import ArmChain, BasePlacement, InverseReachabilityMap, all_solutions, cached_map, free_angles
from irm.rotations import world_to_base

Array = NDArray[np.float64]

_TOUCHING = 0.002
"""[m] Shapes that are nearer count as touching, as in the map."""
_ARROW = 0.08
"""[m] Length of the arrow of a base."""
_GREY, _RED = (170, 176, 184), (220, 40, 40)
_HEIGHTS, _ANGLES = 8, 36
"""Torso heights and values of the free joint that are tried at the base of the slider."""


@dataclass(frozen=True)
class View:
    """What is shown for one pose of the gripper.

    Attributes:
        placement: the bases of highest μ.
        base: (3,) x, y [m], yaw [rad] at which the robot stands.
        q: (1 + n,) torso [m] and arm [rad]; None where the arm does not get there from that base.
        touching: numbers of the geoms that touch each other, of the robot's model.
        said: the answer in a sentence.
    """

    placement: BasePlacement
    base: Array
    q: Array | None
    touching: frozenset[int]
    said: str


class Viewpoint:
    """Answers for one robot."""

    def __init__(self, robot: RobotSpec) -> None:
        self.robot, self.chain = robot, ArmChain.from_robot(robot)
        self.bases = InverseReachabilityMap(cached_map(robot))
        self.model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
        self.data = mujoco.MjData(self.model)
        self.geoms = robot.collision_geoms(self.model)
        self._columns = [self.model.joint(name).qposadr[0] for name in robot.drive_joints]
        self._pairs = np.array(self.geoms)[robot.shapes.pairs].tolist()

    def of(self, T_world_tcp: Array, count: int, base: Array | None = None) -> View:
        """The `count` best bases for a pose (4, 4), the robot at the first of them, or at `base` (3,)."""
        placement = self.bases.query(T_world_tcp, k=count, exact=True)
        at = base if base is not None else placement.poses[0] if placement else np.zeros(3)
        q = None
        if base is None and placement.configurations is not None and len(placement):
            q = placement.configurations[0]
        if q is None or not np.isfinite(q).all():
            q = self._any_configuration(at, T_world_tcp)
        touching = frozenset[int]() if q is None else self._touching(at, q)
        best = f", best μ {placement.manipulability[0]:.3f}" if placement else ""
        names = sorted({str(self.model.body(self.model.geom_bodyid[geom]).name) for geom in touching})
        here = f"; touching: {', '.join(names)}" if names else "" if q is not None else "; out of the arm's reach"
        return View(placement, at, q, touching, f"{placement.status.name}, {len(placement)} bases{best}{here}")

    def _any_configuration(self, base: Array, T_world_tcp: Array) -> Array | None:
        """One that reaches, free or not; the one with the fewest geoms that touch."""
        T = world_to_base(base) @ T_world_tcp
        torsos = np.linspace(self.chain.lower[0], self.chain.upper[0], _HEIGHTS)
        found = all_solutions(self.chain, T, torsos, free_angles(self.chain, _ANGLES))
        return min(found, key=lambda q: len(self._touching(base, q)), default=None)

    def _touching(self, base: Array, q: Array) -> frozenset[int]:
        self.place(base, q)
        near = (
            pair
            for pair in self._pairs
            if mujoco.mj_geomDistance(self.model, self.data, *pair, 2 * _TOUCHING, None) < _TOUCHING
        )
        return frozenset(geom for pair in near for geom in pair)

    def place(self, base: Array, q: Array) -> None:
        """Move the model there."""
        self.data.qpos[self._columns] = np.concatenate([base, q])
        mujoco.mj_kinematics(self.model, self.data)


def show(viewpoint: Viewpoint, port: int, count: int) -> Any:
    """Start the page; the server of viser."""
    viser = importlib.import_module("viser")
    server = viser.ViserServer(port=port)
    scene, model, busy, moved = server.scene, viewpoint.model, threading.Lock(), threading.Event()
    scene.set_up_direction("+z")
    scene.add_grid("/floor", width=6.0, height=6.0, cell_size=0.5)
    gripper = scene.add_transform_controls("/gripper", scale=0.25, position=(0.8, 0.0, 0.8))
    answer = server.gui.add_markdown("")
    stays = server.gui.add_checkbox("the robot stands here:", initial_value=False)
    sliders = [
        server.gui.add_slider(name, -most, most, 0.01, 0.0)
        for name, most in (("x [m]", 2.0), ("y [m]", 2.0), ("yaw [rad]", math.pi))
    ]
    shapes = {geom: _add_geom(scene, model, geom) for geom in viewpoint.geoms}

    def answer_it() -> None:
        T = np.eye(4)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.asarray(gripper.wxyz, dtype=float))
        T[:3, :3], T[:3, 3] = rotation.reshape(3, 3), gripper.position
        view = viewpoint.of(T, count, np.array([slider.value for slider in sliders]) if stays.value else None)
        answer.content = f"**{view.said}**"
        _draw_bases(scene, view.placement)
        viewpoint.place(view.base, np.array(viewpoint.robot.home) if view.q is None else view.q)
        for geom, shape in shapes.items():
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, viewpoint.data.geom_xmat[geom])
            shape.position, shape.wxyz = viewpoint.data.geom_xpos[geom].copy(), quaternion
            shape.color = _RED if geom in view.touching else _GREY

    def update(_event: object = None) -> None:
        moved.set()
        # Events that come while it is answering are answered together, by whoever answers then: the last one counts.
        while moved.is_set() and busy.acquire(blocking=False):
            try:
                moved.clear()
                answer_it()
            finally:
                busy.release()

    for control in (gripper, stays, *sliders):
        control.on_update(update)
    update()
    return server


def _draw_bases(scene: Any, placement: BasePlacement) -> None:
    """An arrow for each base, from red (no μ) to blue (the highest one), as in the paper's figures."""
    x, y, yaw = placement.poses.T
    tails = np.column_stack([x, y, np.full_like(x, 0.01)])
    tips = tails + _ARROW * np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(x)])
    share = placement.manipulability / max(float(placement.manipulability.max(initial=0.0)), 1e-9)
    colours = (255 * colormaps["RdYlBu"](share)[:, None, :3].repeat(2, axis=1)).astype(np.uint8)
    segments = np.stack([tails, tips], axis=1) if len(x) else np.zeros((1, 2, 3))
    scene.add_line_segments("/bases", segments, colours if len(x) else np.zeros((1, 2, 3), np.uint8), thickness=0.012)


def _add_geom(scene: Any, model: mujoco.MjModel, geom: int) -> Any:
    """A geom of the robot as a shape of the page; a mesh as its convex hull has it."""
    name, size = f"/robot/{geom}", model.geom_size[geom]
    kinds = mujoco.mjtGeom
    match int(model.geom_type[geom]):
        case kind if kind == kinds.mjGEOM_BOX:
            return scene.add_box(name, dimensions=tuple(2 * size))
        case kind if kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            return scene.add_cylinder(name, radius=float(size[0]), height=float(2 * size[1]))
        case kind if kind == kinds.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            vertices = model.mesh_vert[first : first + count]
            return scene.add_mesh_simple(name, vertices, model.mesh_face[face : face + faces])
    return scene.add_icosphere(name, radius=float(size[0]))


def main(robot: str = "fetch", port: int = 8080, bases: int = 200) -> None:
    """Show the bases of a robot for a gripper that is dragged; Ctrl-C ends it.

    Args:
        robot: its name.
        port: of the page.
        bases: how many are shown at most.
    """
    show(Viewpoint(find_robot(robot)), port, bases)
    threading.Event().wait()


if __name__ == "__main__":
    tyro.cli(main)
