"""The content of a page as JSON values and one compressed block of arrays, for `data.js`.

It has the scene's shapes, the frames, and for each plan its actions, regions, candidates, base poses and paths.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.contact import Contact, contact_of
from planners.drawing.choices import ClearancePicture, DrawnSurface, choices_of
from planners.drawing.why import GraspAnswer, ObjectAnswer, PlaceAnswer, why_grasps, why_places
from planners.expert.report import Frame, Note, Recording, Solve
from planners.grasping.base_placement import Placer, placer_of
from planners.grasping.families import grasp_set_name
from planners.motion.arm import tcp_pose
from planners.placing.negative_goal_region import SupportGrid
from planners.scene import RobotState, Scene
from planners.search.report import SearchReport
from planners.tamp.solution import BoundAction, Solution

_ALIGNMENT = 4
"""Alignment [bytes] of arrays for the browser."""
_SHAPES = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2}
"""Number of sizes of a shape, three by default."""
_GROUPS = 3
"""First group of geoms that are invisible: they only collide."""
_LENGTH, _TURN = 2e-4, 1 / 32767
"""Resolution of the 16 bits of a position [m], up to 6.5 m, and of a quaternion's component."""
_SKILLS = {
    "MoveBase": "drive",
    "PickUp": "pick",
    "PutDownGeneral": "place",
    "PutDownForClearance": "place",
    "Open": "open",
    "Close": "open",
}
_BASES = 48
"""Most base poses of the map to show for a gripper pose, best first."""
_STRIDE = 2
"""Samples of a trajectory per point of a path."""
_NGR1, _NGR2, _OUTSIDE = 1, 2, 4
"""Bits of a cell."""


def page_text(recording: Recording, title: str, rows: Mapping[str, str], result: str) -> str:
    """Recording and rows of its report as JSON text.

    The result is "success", "failure", "plan", or "running" for an episode that goes on.
    """
    arrays, model, bodies = ArrayBlock(), recording.model, moving_bodies(recording.model)
    indices = {model.body(body).name: index for index, body in enumerate(bodies)}
    content = {
        **model_values(model, bodies, arrays),
        "num_bodies": len(bodies),
        "objects": [{"name": name.rpartition("/")[2], "body": indices[name]} for name in recording.objects],
        "target": recording.target,
        "title": title,
        "result": result,
        "frames": frame_values(model, recording.frames, bodies, arrays),
        "solves": [solve_values(solve, arrays) for solve in recording.solves],
        "notes": note_values(recording.notes),
        "rows": list(rows.items()),
    }
    return arrays.text(content)


def frame_values(
    model: mujoco.MjModel, frames: Sequence[Frame], bodies: Sequence[int], arrays: ArrayBlock
) -> dict[str, Any]:
    """Times, poses of bodies, and actions of some frames of a recording.

    Poses have steps of 16 bits. Positions beyond their range are clipped. Each number has its first value and then
    differences, mostly zeros, which compress well. They wrap around like the sums that undo them.
    """
    numbers = np.rint(_poses(model, bodies, frames) / np.repeat((_LENGTH, _TURN), (3, 4)))
    rows = numbers.clip(-32767, 32767).astype(np.int16).reshape(len(frames), 7 * len(bodies)).T
    changes = np.diff(rows, axis=1, prepend=np.zeros((len(rows), 1), np.int16))
    phases = sorted({frame.phase for frame in frames})
    return {
        "times": arrays.add([frame.time for frame in frames]),
        "poses": arrays.add(changes, "int16"),
        "solve": arrays.add([frame.solve for frame in frames], "int16"),
        "action": arrays.add([frame.action for frame in frames], "int16"),
        "phase": arrays.add([phases.index(frame.phase) for frame in frames], "int16"),
        "phases": phases,
    }


def solve_values(solve: Solve, arrays: ArrayBlock) -> dict[str, Any]:
    """A plan with its layers, or the reason for its absence. For a search, its decisions with their beliefs."""
    outcome: Any = solve.outcome
    if isinstance(outcome, SearchReport):
        return {"time": 0.0, "summary": outcome.failure, "history": [], "choices": [], **_search(outcome, arrays)}
    plan = _plan(outcome, arrays) if getattr(outcome, "actions", ()) else {"actions": [], "choices": []}
    if solve.scene is not None and solve.grasps:
        plan["why"] = arrays.add_values(_why(solve, solve.scene))
    history = [
        {"plan": list(turn.plan), "verified": turn.verified, "facts": list(turn.new_facts), "reason": turn.reason}
        for turn in outcome.stats.history
    ]
    return {"time": round(solve.time, 3), "summary": outcome.summary(), "history": history, **plan}


def note_values(notes: Sequence[Note]) -> list[dict[str, Any]]:
    """Deviations, with repetitions at one time left out."""
    return [{"time": round(time, 3), "text": text} for (time, text), _ in itertools.groupby(notes)]


class ArrayBlock:
    """Collects arrays for the page's `decode` in `data.js`."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def add(self, values: ArrayLike, dtype: str = "float32") -> dict[str, Any]:
        """Add values to the block: "float32", "int16", "int32" or "uint8", little-endian. Return their place in it."""
        array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
        self._bytes += bytes(-len(self._bytes) % _ALIGNMENT)
        place = {"at": len(self._bytes), "size": int(array.size), "type": dtype}
        self._bytes += array.tobytes()
        return place

    def add_values(self, values: Any) -> dict[str, Any]:
        """Add JSON values to the block, where they are compressed. Return their place in it."""
        return self.add(np.frombuffer(json.dumps(values, separators=(",", ":")).encode(), np.uint8), "uint8")

    def text(self, content: Any) -> str:
        """JSON text of the content and all added arrays, without a "<" that could end the page's script element."""
        packed = base64.b64encode(zlib.compress(bytes(self._bytes), 9)).decode()
        return json.dumps({"content": content, "arrays": packed}, separators=(",", ":")).replace("<", "\\u003c")


def model_values(model: mujoco.MjModel, bodies: Sequence[int], arrays: ArrayBlock) -> dict[str, Any]:
    """Shapes to draw, each with the index of its body in `bodies`, or with -1 and a pose in the world."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [geom for geom in range(model.ngeom) if _is_visible(model, geom)]
    used = sorted({int(model.geom_dataid[geom]) for geom in geoms if _shape(model, geom) == "mesh"})
    return {
        "geoms": [_geom(model, data, geom, bodies, used) for geom in geoms],
        "meshes": [_mesh(model, mesh, arrays) for mesh in used],
    }


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies with a visible geom that are not fixed to the world."""
    owners = {int(model.geom_bodyid[geom]) for geom in range(model.ngeom) if _is_visible(model, geom)}
    return [body for body in sorted(owners) if model.body_weldid[body] != 0]


def _poses(model: mujoco.MjModel, bodies: Sequence[int], frames: Sequence[Frame]) -> NDArray[np.float64]:
    """Positions [m] and quaternions (n, k, 7) of bodies, without jumps of a quaternion to -q."""
    data = mujoco.MjData(model)
    rows = []
    for frame in frames:
        data.qpos[:] = frame.qpos
        mujoco.mj_kinematics(model, data)
        rows.append(np.concatenate((data.xpos[bodies], data.xquat[bodies]), axis=1))
    poses = np.array(rows).reshape(len(frames), len(bodies), 7)
    for before, now in itertools.pairwise(poses):
        now[(before[:, 3:] * now[:, 3:]).sum(axis=1) < 0, 3:] *= -1
    return poses


def _is_visible(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_group[geom] < _GROUPS and geom_colour(model, geom)[3] > 0 and _shape(model, geom))


def _shape(model: mujoco.MjModel, geom: int) -> str:
    """Name of the shape, "" for a shape that a page does not draw, such as a height field."""
    return _SHAPES.get(mujoco.mjtGeom(int(model.geom_type[geom])), "")


def geom_colour(model: mujoco.MjModel, geom: int) -> NDArray[np.float32]:
    """RGBA (4,) of a geom, or of its material."""
    material = int(model.geom_matid[geom])
    rgba: NDArray[np.float32] = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return rgba


def _geom(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int, bodies: Sequence[int], meshes: Sequence[int]
) -> dict[str, Any]:
    body, shape = int(model.geom_bodyid[geom]), _shape(model, geom)
    position, quaternion = model.geom_pos[geom], model.geom_quat[geom]
    if body not in bodies:
        position, quaternion = data.geom_xpos[geom], np.empty(4)
        mujoco.mju_mat2Quat(quaternion, data.geom_xmat[geom])
    return {
        "name": model.geom(geom).name,
        "body": bodies.index(body) if body in bodies else -1,
        "shape": shape,
        "size": _rounded(model.geom_size[geom][: _SIZES.get(shape, 3)]),
        "position": _rounded(position),
        "quaternion": _rounded(quaternion),
        "colour": _rounded(geom_colour(model, geom)),
        "mesh": meshes.index(int(model.geom_dataid[geom])) if shape == "mesh" else -1,
    }


def _mesh(model: mujoco.MjModel, mesh: int, arrays: ArrayBlock) -> dict[str, Any]:
    """A mesh, with its corners in 16 bits relative to its own size."""
    first, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
    triangles = model.mesh_face[faces : faces + model.mesh_facenum[mesh]]
    step = float(np.abs(vertices).max()) / 32767
    return {
        "step": step,
        "vertices": arrays.add(np.rint(vertices / step), "int16"),
        "triangles": arrays.add(triangles, "int32"),
    }


def _rounded(values: ArrayLike) -> list[float]:
    return [round(float(value), 5) for value in np.asarray(values)]


def _plan(plan: Solution, arrays: ArrayBlock) -> dict[str, Any]:
    """Actions of a plan and choices of its clearance locations."""
    first = plan.actions[0].scene
    views = {action.scene.robot.arm_name: action.scene for action in plan.actions}
    placers = {arm: placer_of(scene) for arm, scene in views.items()}
    return {
        "strategy": plan.strategy.name,
        "clearances": list(plan.clearances),
        "base_radius": first.robot.base_radius,
        "actions": [_action(action, placers[action.scene.robot.arm_name], arrays) for action in plan.actions],
        "choices": [
            _choice(choice, places, arrays) for choice, places in zip(choices_of(plan), why_places(plan), strict=True)
        ],
    }


def _why(solve: Solve, scene: Scene) -> dict[str, Any]:
    """What refuses each grasp of each object where it stands before the plan, and what each way to take it costs."""
    answers = why_grasps(scene, solve.grasps, solve.outcome if isinstance(solve.outcome, Solution) else None)
    front = float(np.arctan2(*(scene.support.position[:2] - scene.state.base[:2])[::-1]))
    return {
        "grasps": grasp_set_name(solve.grasps),
        "front": round(front, 3),
        "objects": [_object_why(answer) for answer in answers],
    }


def _object_why(answer: ObjectAnswer) -> dict[str, Any]:
    """Grasps of an object as rows of those with the same answer, the cheapest first, and the row of each grasp."""
    cost = {frozenset(way.blockers): way for way in answer.ways}
    rows: dict[Any, dict[str, Any]] = {}
    of_grasp = []
    for one in answer.grasps:
        row = _row(one)
        of_grasp.append(key := json.dumps(row))
        if row["state"] == "blocked":
            way = cost[frozenset(name for name, _ in row["by"])]
            row |= {"moves": way.moves, "first": list(way.first), "proved": way.proved}
        rows.setdefault(key, row)
    order = sorted(rows, key=lambda key: _worth(rows[key]))
    poses = [
        [round(1000 * float(value)) for value in one.pose[:3]] + [round(float(np.degrees(a)), 1) for a in one.pose[3:]]
        for one in answer.grasps
    ]
    return {
        "name": answer.name,
        "rows": [rows[key] for key in order],
        "grasps": [[*pose, order.index(key)] for pose, key in zip(poses, of_grasp, strict=True)],
        "taken": -1 if answer.taken is None else answer.taken,
    }


def _row(one: GraspAnswer) -> dict[str, Any]:
    if one.grasp is None:
        return {
            "state": "furniture" if one.furniture else "unreached",
            "by": [[name, "hand"] for name in one.furniture],
        }
    if not one.blockers:
        return {"state": "free", "by": []}
    return {"state": "blocked", "by": [[blocker.name, blocker.part] for blocker in one.blockers]}


def _worth(row: Mapping[str, Any]) -> tuple[int, float, int]:
    """Sort key of a row: free, then blocked by its cost, then refused by what does not move."""
    moves = row.get("moves")
    rank = ("free", "blocked", "furniture", "unreached").index(row["state"])
    return rank, math.inf if moves is None else moves, len(row["by"])


def _search(report: SearchReport, arrays: ArrayBlock) -> dict[str, Any]:
    """Decisions of a search, each with the places left at that time, on every support."""
    beliefs = [
        [_cells(grid, _NGR2 * step.places[name].astype(np.uint8), arrays) for name, grid in step.grids.items()]
        for step in report.steps
    ]
    actions = [
        {"kind": step.kind, "text": step.text, "path": None, "base_path": None, "bases": None} for step in report.steps
    ]
    return {"actions": actions, "beliefs": beliefs}


def _action(action: BoundAction, placer: Placer, arrays: ArrayBlock) -> dict[str, Any]:
    robot, trajectory = action.scene.robot, action.trajectory
    states = [RobotState(*row) for row in zip(trajectory.base, trajectory.q, trajectory.finger_position, strict=True)]
    kept = [*states[:-1:_STRIDE], states[-1]]
    contact = contact_of(action)
    return {
        "kind": _SKILLS.get(action.name, "other"),
        "name": action.name,
        "args": list(action.args),
        "object": action.target,
        "because": action.obstructed,
        "duration": round(trajectory.duration, 2),
        "path": arrays.add([tcp_pose(robot, state)[:3, 3] for state in kept]),
        "base_path": arrays.add(np.array([state.base for state in kept])),
        "bases": None if contact is None else arrays.add(_bases(contact, placer)),
    }


def _bases(contact: Contact, placer: Placer) -> NDArray[np.float64]:
    """Base poses (k, 3) from which the map reaches the gripper pose of a contact, the planned one first."""
    T = contact.tcp
    pitch = math.atan2(-T[2, 0], T[2, 2])
    found, _ = placer.bases(np.array([(*T[:3, 3], contact.yaw, pitch)]), _BASES)
    return np.vstack((contact.base, found))


def _choice(picture: ClearancePicture, places: Sequence[PlaceAnswer], arrays: ArrayBlock) -> dict[str, Any]:
    allowed = {tuple(place) for place in picture.ordered}
    rows = [row for row, place in enumerate(picture.candidates) if tuple(place) not in allowed]
    refused, answers = picture.candidates[rows], [places[row] for row in rows]
    reasons = list(dict.fromkeys(answers))
    return {
        "object": picture.moved,
        "surfaces": [_surface(surface, arrays) for surface in picture.surfaces],
        "ordered": arrays.add(_on_surfaces(picture.surfaces, picture.ordered)),
        "refused": arrays.add(_on_surfaces(picture.surfaces, refused)),
        "refused_by": arrays.add([reasons.index(answer) for answer in answers], "int16"),
        "reasons": [
            {"standing": one.standing, "furniture": one.furniture, "off": one.off, "ways": one.ways} for one in reasons
        ],
        "chosen": None if picture.chosen is None else [float(value) for value in picture.chosen],
        "radius": next(body.radius for body in picture.bodies if body.name == picture.moved),
    }


def _surface(surface: DrawnSurface, arrays: ArrayBlock) -> dict[str, Any]:
    """Cells of a support, as a picture of bytes with x along the rows and y along the columns."""
    grid, region = surface.grid, surface.region
    cells = _NGR1 * region.ngr1.astype(np.uint8) + _NGR2 * region.ngr2.astype(np.uint8)
    if surface.in_work is not None:
        cells += _OUTSIDE * (~surface.in_work).astype(np.uint8)
    return _cells(grid, cells, arrays)


def _cells(grid: SupportGrid, cells: NDArray[np.uint8], arrays: ArrayBlock) -> dict[str, Any]:
    return {
        "extent": [float(edge) for edge in grid.extent],
        "height": grid.height,
        "shape": list(grid.shape),
        "cells": arrays.add(cells, "uint8"),
    }


def _on_surfaces(surfaces: Sequence[DrawnSurface], places: ArrayLike) -> NDArray[np.float64]:
    """Places (n, 2) with the height of their surface: (n, 3) [m]."""
    points = np.asarray(places, dtype=float).reshape(-1, 2)
    heights = np.full(len(points), surfaces[0].grid.height)
    for surface in surfaces:
        x_low, x_high, y_low, y_high = surface.grid.extent
        inside = (points >= (x_low, y_low)).all(axis=1) & (points <= (x_high, y_high)).all(axis=1)
        heights[inside] = surface.grid.height
    return np.column_stack((points, heights))
