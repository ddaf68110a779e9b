"""A plan as ROS 2 messages in an MCAP file for Foxglove, rerun or rosbag2. ROS itself is not needed.

| topic | type | content |
|---|---|---|
| `/joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | torso and arms, once |
| `/joint_states` | `sensor_msgs/msg/JointState` | base, torso, arms, a finger of each gripper, at every control step |
| `/tf` | `tf2_msgs/msg/TFMessage` | base, links and objects in the frame `world` |
| `/markers` | `visualization_msgs/msg/MarkerArray` | solids of the robot, the objects and the static obstacles, once |
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from planners.drawing.page.content import geom_colour
from planners.drawing.page.page import plan_recording
from planners.tamp.joint_trajectory import JointTrajectory
from planners.tamp.solution import Solution

_WORLD = "world"
_CUBE, _SPHERE, _CYLINDER, _TRIANGLES = 1, 2, 3, 11
"""Kinds of markers."""
_GROUND = np.array([10.0, 10.0, 0.002])
"""Size [m] of the slab that represents the floor."""
_PREFIXES = ("object/", "obstacle/")

# ROS 2 message definitions, without comments and constants. A part of a definition follows the name of its type.
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n"
        "bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n"
        "string mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials"
    ),
}
_TYPES = {
    "trajectory_msgs/msg/JointTrajectory": (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points"
    ),
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/msg/MarkerArray": "visualization_msgs/Marker[] markers",
}


class MissingExtra(ImportError):
    """An extra of this package is missing for a file format. The message says how to install it."""


def write_mcap(plan: Solution, path: Path) -> None:
    """Write a plan as ROS 2 messages, as `Solution.to_mcap` does. Time 0 is the beginning of the plan."""
    try:
        writer_module = import_module("mcap_ros2.writer")
    except ImportError as error:
        raise MissingExtra("MCAP files need the extra 'ros': pip install 'clutter-env[ros]'") from error
    trajectory, recording = plan.to_joint_trajectory(), plan_recording(plan)
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        schemas = {name: writer.register_msgdef(name, _definition(name)) for name in _TYPES}

        def write(topic: str, kind: str, time: float, message: dict[str, Any]) -> None:
            stamp = round(1e9 * time)
            writer.write_message(topic, schemas[kind], message, log_time=stamp, publish_time=stamp)

        write("/markers", "visualization_msgs/msg/MarkerArray", 0.0, {"markers": list(_markers(recording.model))})
        write("/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", 0.0, _trajectory_message(trajectory))
        for time, message in _joint_states(plan, trajectory):
            write("/joint_states", "sensor_msgs/msg/JointState", time, message)
        data = mujoco.MjData(recording.model)
        for frame in recording.frames:
            data.qpos[:] = frame.qpos
            mujoco.mj_kinematics(recording.model, data)
            write("/tf", "tf2_msgs/msg/TFMessage", frame.time, {"transforms": list(_transforms(data, frame.time))})
        writer.finish()


def _definition(kind: str) -> str:
    """A message definition, followed by the definitions of all its parts."""
    texts, waiting, known = [_TYPES[kind]], [_TYPES[kind]], set[str]()
    while waiting:
        for line in waiting.pop().splitlines():
            part = line.split()[0].removesuffix("[]")
            if part in _PARTS and part not in known:
                known.add(part)
                waiting.append(_PARTS[part])
                texts.append(f"MSG: {part}\n{_PARTS[part]}")
    return f"\n{'=' * 80}\n".join(texts)


def _time(time: float) -> dict[str, int]:
    nanoseconds = round(1e9 * time)
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def _header(time: float, frame: str = _WORLD) -> dict[str, Any]:
    return {"stamp": _time(time), "frame_id": frame}


def _trajectory_message(trajectory: JointTrajectory) -> dict[str, Any]:
    points = [
        {"positions": q.tolist(), "velocities": v.tolist(), "time_from_start": _time(t)}
        for t, q, v in zip(trajectory.times, trajectory.positions, trajectory.velocities, strict=True)
    ]
    return {"header": _header(0.0), "joint_names": list(trajectory.joint_names), "points": points}


def _joint_states(plan: Solution, trajectory: JointTrajectory) -> Iterator[tuple[float, dict[str, Any]]]:
    """Times [s] and messages: the base's three joints, those of torso and arms, then one finger of each gripper."""
    robots = {action.scene.robot.arm_name: action.scene.robot for action in plan.actions}
    robot = plan.actions[0].scene.robot
    fingers = [robots[arm].finger_joints[0] for arm in trajectory.arms]
    names = [*robot.base_joints, *trajectory.joint_names, *fingers]
    opened = np.column_stack(
        [
            [robots[arm].finger_position(float(width)) for width in trajectory.gripper[:, column]]
            for column, arm in enumerate(trajectory.arms)
        ]
    )
    rows = np.column_stack((trajectory.base, trajectory.positions, opened))
    for time, row in zip(trajectory.times, rows, strict=True):
        yield float(time), {"header": _header(time), "name": names, "position": row.tolist()}


def _named(names: str, values: NDArray[np.floating]) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))


def _frame(model: mujoco.MjModel, body: int) -> str:
    """Name of a body's frame: the body's name, without the model's prefix for objects."""
    name = str(model.body(body).name)
    return next((name.removeprefix(prefix) for prefix in _PREFIXES if name.startswith(prefix)), name)


def _transforms(data: mujoco.MjData, time: float) -> Iterator[dict[str, Any]]:
    """Poses of all bodies in the world frame, except the world."""
    for body in range(1, data.model.nbody):
        transform = {"translation": _named("xyz", data.xpos[body]), "rotation": _named("wxyz", data.xquat[body])}
        yield {"header": _header(time), "child_frame_id": _frame(data.model, body), "transform": transform}


def _markers(model: mujoco.MjModel) -> Iterator[dict[str, Any]]:
    """Markers for a model's solids in the frames of their bodies. A capsule is a cylinder and two spheres."""
    number = 0
    for geom in range(model.ngeom):
        position, turn, frame = model.geom_pos[geom], model.geom_quat[geom], _frame(model, int(model.geom_bodyid[geom]))
        for kind, offset, scale, points in _solids(model, geom):
            along = np.empty(3)
            mujoco.mju_rotVecQuat(along, np.array([0.0, 0.0, offset]), turn)
            number += 1
            yield {  # what is left out is 0 or empty
                "header": _header(0.0, frame),
                "ns": frame,
                "id": number,
                "type": kind,
                "pose": {"position": _named("xyz", position + along), "orientation": _named("wxyz", turn)},
                "scale": _named("xyz", scale),
                "color": _named("rgba", geom_colour(model, geom)),
                "frame_locked": True,
                "points": [_named("xyz", point) for point in points],
            }


def _solids(model: mujoco.MjModel, geom: int) -> Iterator[tuple[int, float, NDArray[np.float64], NDArray[np.float64]]]:
    """Marker kind, offset along the geom's z axis [m], scale [m] and corners (n, 3) [m] of the markers of a geom."""
    kind, size, kinds = int(model.geom_type[geom]), np.array(model.geom_size[geom]), mujoco.mjtGeom
    none = np.zeros((0, 3))
    if kind == kinds.mjGEOM_PLANE:
        yield _CUBE, -0.5 * _GROUND[2], _GROUND, none
    elif kind == kinds.mjGEOM_BOX:
        yield _CUBE, 0.0, 2 * size, none
    elif kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
        yield _SPHERE, 0.0, 2 * (size[[0, 0, 0]] if kind == kinds.mjGEOM_SPHERE else size), none
    elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
        yield _CYLINDER, 0.0, 2 * size[[0, 0, 1]], none
        if kind == kinds.mjGEOM_CAPSULE:
            for side in (-1.0, 1.0):
                yield _SPHERE, side * float(size[1]), 2 * size[[0, 0, 0]], none
    elif kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        corners = model.mesh_vert[model.mesh_vertadr[mesh] : model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh]]
        faces = model.mesh_face[model.mesh_faceadr[mesh] : model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]]
        yield _TRIANGLES, 0.0, np.ones(3), corners[faces].reshape(-1, 3)
