"""A camera of a robot and the solids that may hide something from it, read from the robot's model."""

from __future__ import annotations

from math import radians, tan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.errors import QueryError

if TYPE_CHECKING:
    import mujoco

__all__ = ["BASE", "BOX", "CAPSULE", "CYLINDER", "RobotView", "link_of_body", "read_view"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BASE = -1
"""Link number of what is fixed to the base; 0 is the torso with the head, 1 … n are the links of the arm."""

BOX, CYLINDER, CAPSULE = 0, 1, 2
"""Kinds of solids; a sphere is a capsule of length 0."""


class RobotView(NamedTuple):
    """A camera and p solids, for kernels. Lengths in metres.

    Attributes:
        kind: (p,) BOX, CYLINDER or CAPSULE.
        size: (p, 3) half extents of a box; radius, radius and half length of the others, whose axis is z.
        bound: (p,) radius of the ball about the solid's centre that contains it.
        link: (p,) the link that each solid is part of; `position` (p, 3) and `rotation` (p, 3, 3) in that link's frame.
        camera_link: the link that the camera is part of.
        camera, camera_rotation: (3,) and (3, 3) its place in that link's frame; it looks along -z, and y is up.
        slope: tangent of half the vertical field of view. The image is square.
    """

    kind: Integers
    size: Floats
    bound: Floats
    link: Integers
    position: Floats
    rotation: Floats
    camera_link: int
    camera: Floats
    camera_rotation: Floats
    slope: float


def read_view(robot: RobotSpec, camera: str, opening: float) -> RobotView:
    """What a camera of the robot sees past, with the head in `robot.still_configuration`.

    Every geom that is drawn counts. In place of a mesh or an ellipsoid its bounding box counts.

    Args:
        robot: with a model.
        camera: name of one of the model's cameras.
        opening: between the pads of the gripper [m].

    Raises:
        QueryError: the model has no such camera; the message lists those it has.
    """
    import mujoco  # a function needs the simulator, the package does not

    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names:
        raise QueryError(f"{robot.name} has no camera {camera!r}; its cameras: {', '.join(names) or 'none'}")
    data = _posed(model, robot, opening)
    bodies, links = _link_bodies(model, robot), link_of_body(model, robot)

    def in_link(body: int, position: Floats, matrix: Floats) -> tuple[Floats, Floats]:
        carrier = bodies[links[body] + 1]
        frame = data.xmat[carrier].reshape(3, 3)
        return frame.T @ (position - data.xpos[carrier]), frame.T @ matrix.reshape(3, 3)

    geoms = [geom for geom in range(model.ngeom) if _is_drawn(model, geom, bodies[0])]
    owners = [int(model.geom_bodyid[geom]) for geom in geoms]
    shapes = [_shape(model, geom) for geom in geoms]
    centres = [
        data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ shape.centre
        for geom, shape in zip(geoms, shapes, strict=True)
    ]
    places = [in_link(*of) for of in zip(owners, centres, data.geom_xmat[geoms], strict=True)]
    eye = model.camera(camera).id
    owner = int(model.cam_bodyid[eye])
    camera_place = in_link(owner, data.cam_xpos[eye], data.cam_xmat[eye])
    return RobotView(
        kind=np.array([shape.kind for shape in shapes], dtype=np.int64),
        size=np.array([shape.size for shape in shapes]),
        bound=np.array([shape.bound for shape in shapes]),
        link=np.array([links[body] for body in owners], dtype=np.int64),
        position=np.array([position for position, _ in places]),
        rotation=np.array([rotation for _, rotation in places]),
        camera_link=links[owner],
        camera=camera_place[0],
        camera_rotation=np.ascontiguousarray(camera_place[1]),
        slope=tan(radians(model.cam_fovy[eye]) / 2),
    )


class _Shape(NamedTuple):
    """Kind, size and bound as in `RobotView`, and the solid's centre in the geom's frame."""

    kind: int
    size: tuple[float, float, float]
    bound: float
    centre: Floats


def _posed(model: mujoco.MjModel, robot: RobotSpec, opening: float) -> mujoco.MjData:
    """The model with base, torso and arm at 0, the head as the robot holds it, and an open gripper."""
    import mujoco  # see `read_view`

    data = mujoco.MjData(model)
    positions = dict.fromkeys(robot.drive_joints, 0.0)
    positions |= dict.fromkeys(robot.finger_joints, robot.finger_position(opening))
    positions |= dict(zip(robot.still_joints, robot.still_configuration, strict=True))
    for name, position in positions.items():
        data.joint(name).qpos[0] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    return data


def link_of_body(model: mujoco.MjModel, robot: RobotSpec) -> list[int]:
    """The link that each body of a model belongs to: that of the nearest joint of the chain that moves it. The head
    belongs to the torso, the fingers to the last link; BASE for the base and for what is not part of the robot."""
    bodies, links = _link_bodies(model, robot), list[int]()
    for body in range(model.nbody):
        parent = links[int(model.body_parentid[body])] if body else BASE
        links.append(bodies.index(body) - 1 if body in bodies else parent)
    return links


def _link_bodies(model: mujoco.MjModel, robot: RobotSpec) -> list[int]:
    """The base's body, and the body that each joint of the chain moves."""
    return [model.body(robot.base_body).id, *(int(model.joint(link.joint).bodyid[0]) for link in robot.chain)]


def _is_drawn(model: mujoco.MjModel, geom: int, base: int) -> bool:
    return model.body_rootid[model.geom_bodyid[geom]] == model.body_rootid[base] and model.geom_rgba[geom, 3] > 0


def _shape(model: mujoco.MjModel, geom: int) -> _Shape:
    import mujoco  # see `read_view`

    kind, (a, b, c) = model.geom_type[geom], model.geom_size[geom].tolist()
    centre = np.zeros(3)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return _Shape(CAPSULE, (a, a, 0.0), a, centre)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return _Shape(CAPSULE, (a, a, b), a + b, centre)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _Shape(CYLINDER, (a, a, b), float(np.hypot(a, b)), centre)
    if kind != mujoco.mjtGeom.mjGEOM_BOX:
        centre, (a, b, c) = model.geom_aabb[geom, :3].copy(), model.geom_aabb[geom, 3:].tolist()
    return _Shape(BOX, (a, b, c), float(np.linalg.norm((a, b, c))), centre)
