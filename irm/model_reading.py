"""Reading of the arm between two frames of a MuJoCo model: joint axes, limits, tool, and collision shapes.

All quantities are read at joint positions 0, in the base frame: the line of each joint's axis, and the pose of the tip.
They determine the frames of the chain. Each frame has its origin on its joint's axis, and z along it.
"""

from __future__ import annotations

import itertools
import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from irm.errors import ChainError
from irm.gjk import BOX, CYLINDER, ELLIPSOID, HULL
from irm.rotations import frame_along
from irm.self_contact import BASE, counted_pairs, is_solid
from irm.shapes import NO_SHAPES, Shapes, with_pairs

_LOG = logging.getLogger(__name__)

Floats = NDArray[np.float64]
CONTINUOUS = 2 * np.pi
"""[rad] Limits of a continuous joint: minus and plus this value."""
_UNNAMED = "MuJoCo Model"
"""MuJoCo's name for a model without a name."""
_PARALLEL = 1e-9
"""Largest difference of entries of equal unit vectors or rotations, due to rounding."""
_SAME_AXIS = 1e-12
"""Tolerance as `_PARALLEL` where one direction replaces the other. The solver proves a NO with a tolerance of 1e-8
m."""
APPROACHES = {
    name: np.array(rows, dtype=float)
    for name, rows in {
        "x": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "-x": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        "y": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        "-y": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        "z": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "-z": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    }.items()
}
"""R_tip_tcp: the shortest turn whose x axis is the named axis of the tip."""


class _Joint(NamedTuple):
    """One joint at zero: a point on its axis and its direction, in the base frame [m]."""

    name: str
    slides: bool
    point: Floats
    axis: Floats
    lower: float
    upper: float


_NO_LIFT = _Joint("", True, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0, 0.0)


_MESH_KINDS = (".stl", ".obj", ".msh")
_LARGEST = 5.0
"""[m] Longest plausible mesh. In millimetres, even a link of 1 cm is longer."""
MARK = 0.015
"""[m] Longest side of a visual shape that marks a frame and is no part of the robot."""
_TILTED = 1e-3
"""[rad] Largest tilt of a base frame's z axis from the vertical. Files round their angles."""
_HAIR = 1e-9
"""[rad], [m] Gap by which equal limits of a URDF file are crossed, because MuJoCo silently drops equal limits."""
_MOST_TURNS, _LARGEST_IN_DEGREES = 7.0, 720.0
"""[rad] Limits of all hinges of an arm between these values are degrees. No arm turns farther than once each way at
every joint, and larger numbers stand for no limit."""
_URDF_COMPILER = {
    "fusestatic": "false",
    # Links without a mass are common in URDF files, and MuJoCo refuses those that move.
    "boundmass": "1e-6",
    "boundinertia": "1e-9",
    "balanceinertia": "true",
    # The names of meshes are absolute paths at this point.
    "strippath": "false",
}
"""MuJoCo's compiler settings for a URDF file. They override those of the file."""


class UnreadMesh(NamedTuple):
    """A mesh of a URDF file that yields no shape of the model: its use (collision or visual) and the reason."""

    is_for_collisions: bool
    reason: str


class LoadedModel(NamedTuple):
    """A compiled model, and the data of a URDF file that MuJoCo does not keep.

    Attributes:
        model: the model compiled by MuJoCo.
        unread: meshes that cannot be read, by the names of their links.
        velocities: velocity limits of joints by their names [rad/s], [m/s], without limits of 0.
    """

    model: mujoco.MjModel
    unread: dict[str, UnreadMesh]
    velocities: dict[str, float]


def read_arm(model: mujoco.MjModel | str | Path, base: str, tip: str, approach: str) -> dict[str, Any]:
    """Read the fields of the `ArmChain` from `base` to `tip`, see `ArmChain.from_mjcf`. `_frames` places the frames.

    Raises:
        ChainError: no such file, body or site, or the joints between them are not those of an arm.
    """
    for frame in (base, tip):
        if not isinstance(frame, str):  # MuJoCo looks up any value: None would end the process
            raise ChainError(f"base and tip are names of the model, not {frame!r}")
    name = ""
    if not isinstance(model, mujoco.MjModel):
        name, model = Path(model).stem, load_model(Path(model))
    base_body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, base)
    if base_body < 0:
        raise ChainError(f"there is no body {base!r}; there are {_listed(model, mujoco.mjtObj.mjOBJ_BODY)}")
    is_site, number = _find_tip(model, tip)
    tip_body = int(model.site_bodyid[number]) if is_site else number
    numbers = _joints_between(model, base_body, tip_body, (base, tip))
    _check_limits(model, numbers)
    _check_numbers(model)
    data = mujoco.MjData(model)
    _check_base_is_upright(model, data, base_body)
    data.qpos[model.jnt_qposadr[numbers]] = 0.0
    mujoco.mj_kinematics(model, data)
    T_base_world: Floats = np.asarray(np.linalg.inv(_pose(data.xmat[base_body], data.xpos[base_body])), dtype=float)
    R, origin = T_base_world[:3, :3], T_base_world[:3, 3]
    joints = [
        _Joint(
            str(model.joint(k).name) or f"joint {k}",
            int(model.jnt_type[k]) == int(mujoco.mjtJoint.mjJNT_SLIDE),
            R @ data.xanchor[k] + origin,
            R @ data.xaxis[k],
            *(model.jnt_range[k].tolist() if model.jnt_limited[k] else (-CONTINUOUS, CONTINUOUS)),
        )
        for k in numbers
    ]
    lift, hinges = _lift_and_hinges(joints, (base, tip))
    _check_joints_are_free(model, base_body, numbers)
    T_base_tip = T_base_world @ _tip_pose(model, data, tip)
    T_base_tip[:3, :3] = T_base_tip[:3, :3] @ _tool_rotation(approach)
    offsets, axes, tool = _frames(hinges, T_base_tip)
    joints = [lift, *hinges]
    own_name = bytes(model.names).split(b"\0", 1)[0].decode()
    return {
        "robot": own_name if own_name not in ("", _UNNAMED) else name or "arm",
        "offsets": offsets,
        "axes": axes,
        "lower": np.array([joint.lower for joint in joints]),
        "upper": np.array([joint.upper for joint in joints]),
        "tip": tool,
        "joints": tuple(joint.name for joint in joints),
        "shapes": _shapes_of_arm(model, numbers, bool(lift.name), (offsets, axes, tool), T_base_world),
    }


def load_robot(path: Path, mesh_scale: float = 1.0, radians: bool = False) -> LoadedModel:
    """Load an MJCF or URDF file with all its meshes, each scaled by `mesh_scale`.

    With `radians`, angles of an MJCF file are in radians regardless of its `<compiler>`. Those of a URDF file always
    are. The first element of the file tells its kind, not its name. For a URDF file see `load_urdf`.

    Raises:
        ChainError: the file is neither.
        FileNotFoundError: no such file.
    """
    text, unread, velocities = _mujoco_urdf(path) if _first_element(path) == "robot" else ("", {}, {})
    try:
        spec = mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(path))
        for mesh in spec.meshes:
            mesh.scale = mesh.scale * mesh_scale
        if radians:
            spec.compiler.degree = False
        return LoadedModel(spec.compile(), unread, velocities)
    except ValueError as problem:
        kind = "a URDF" if text else "an MJCF"
        raise ChainError(f"{path} cannot be read as {kind} file: {problem}") from problem


def load_model(path: Path) -> mujoco.MjModel:
    """Load the model of an MJCF file. Raises `ChainError` if it cannot be read."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as problem:
        raise ChainError(f"{path} cannot be read as an MJCF file: {problem}") from problem


def arm_joints(model: mujoco.MjModel, base: str, tip: str) -> list[int]:
    """Ids of the joints of an arm, a lift first. Arguments and errors as in `read_arm`."""
    read_arm(model, base, tip, "x")
    is_site, number = _find_tip(model, tip)
    body = int(model.site_bodyid[number]) if is_site else number
    return _joints_between(model, int(model.body(base).id), body, (base, tip))


def tip_frame(model: mujoco.MjModel, body: int, tip: str, approach: str) -> Floats:
    """T_body_tcp (4, 4) of a tip, with x along the approach, at the model's initial joint positions."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T = np.linalg.inv(_pose(data.xmat[body], data.xpos[body])) @ _tip_pose(model, data, tip)
    T[:3, :3] = T[:3, :3] @ _tool_rotation(approach)
    return np.asarray(T)


def load_urdf(path: Path) -> mujoco.MjModel:
    """Load the model of a URDF file.

    Links keep their names and stay separate bodies, even where they are fixed to others. Their shapes are collision
    shapes. A link without collision shapes has its visual shapes. A missing mesh file yields no shape, and a warning is
    logged for each.

    Raises:
        FileNotFoundError: no such file.
        ChainError: the file is no URDF file.
    """
    text, unread, _ = _mujoco_urdf(path)
    for link, mesh in unread.items():
        _LOG.warning("%s: a mesh of the link %r is no shape: %s", path, link, mesh.reason)
    try:
        return mujoco.MjModel.from_xml_string(text)
    except ValueError as problem:
        raise ChainError(f"{path} cannot be read as a URDF file: {problem}") from problem


def _without_comments(path: Path) -> bytes:
    """The text of an XML file without comments, because MuJoCo accepts comments that XML forbids."""
    return re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL).strip()


def _first_element(path: Path) -> str:
    """The name of an XML file's first element, "" for none."""
    found = re.search(rb"<([A-Za-z_][\w:.-]*)", _without_comments(path))
    return found.group(1).decode() if found else ""


def _mujoco_urdf(path: Path) -> tuple[str, dict[str, UnreadMesh], dict[str, float]]:
    """The text of a URDF file for MuJoCo, with one kind of shapes per link, and the other fields of `LoadedModel`."""
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    # Read without namespaces, as MuJoCo does: a prefix is a part of a name, bound or not.
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(_without_comments(path), True)
        robot = builder.close()
    except expat.ExpatError as problem:
        raise ChainError(f"{path} cannot be read as a URDF file: {problem}") from problem
    if robot.tag != "robot":
        raise ChainError(f"{path} cannot be read as a URDF file: its first element is <{robot.tag}>")
    if any(element.tag.startswith("xacro:") for element in robot.iter()):
        raise ChainError(
            f"{path} is a xacro file, of which a URDF file is still to be made: `xacro {path.name} > robot.urdf` with "
            f"ROS, `xacrodoc {path.name} -o robot.urdf` without it (pip install xacrodoc)"
        )
    extension = robot.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(robot, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    folder = compiler.attrib.pop("meshdir", "")
    compiler.attrib.update(_URDF_COMPILER)
    _write_limits(robot, path)
    unread: dict[str, UnreadMesh] = {}
    for link in robot.iter("link"):
        kept: list[ElementTree.Element] = []
        for tag in ("collision", "visual"):
            for shape in link.findall(tag):
                link.remove(shape)
                mesh = shape.find("geometry/mesh")
                if tag == "visual" and (kept or _is_mark(shape)):
                    continue
                if mesh is not None:
                    found = _mesh_file(path, mesh.get("filename", ""), folder)
                    if isinstance(found, str):
                        unread.setdefault(link.get("name", ""), UnreadMesh(tag == "collision", found))
                        continue
                    mesh.set("filename", str(found))
                shape.tag = "collision"
                kept.append(shape)
        link.extend(kept)
    try:
        given = {
            joint.get("name", ""): float(limit.get("velocity") or 0.0)
            for joint in robot.iter("joint")
            for limit in joint.findall("limit")
        }
    except ValueError as problem:
        raise ChainError(f"{path} cannot be read as a URDF file: a joint's velocity: {problem}") from problem
    velocities = {joint: velocity for joint, velocity in given.items() if velocity > 0.0}
    return ElementTree.tostring(robot, encoding="unicode"), unread, velocities


def _write_limits(robot: ElementTree.Element, path: Path) -> None:
    """Write both limits of each URDF joint that has only one. The other is 0, and MuJoCo would read neither.

    Raises:
        ChainError: a limit is not a number.
    """
    for joint in robot.iter("joint"):
        limit = joint.find("limit")
        if joint.get("type") not in ("revolute", "prismatic") or limit is None:
            continue
        given = {side: limit.get(side) for side in ("lower", "upper")}
        if not any(given.values()):
            continue
        try:
            lower, upper = (float(value or 0.0) for value in given.values())
        except ValueError as problem:
            name = joint.get("name", "")
            raise ChainError(f"{path} cannot be read as a URDF file: a limit of {name!r}: {problem}") from problem
        if lower == upper:  # refused by `_check_limits` where the joint is one of the arm
            lower, upper = lower + _HAIR, upper - _HAIR
        limit.attrib.update(lower=repr(lower), upper=repr(upper))


def _is_mark(visual: ElementTree.Element) -> bool:
    """Whether a visual shape marks a frame: boxes, cylinders or spheres up to `MARK` long."""
    sides = [float(word) for box in visual.iterfind("geometry/box") for word in box.get("size", "").split()]
    for kind in ("cylinder", "sphere"):
        for shape in visual.iterfind(f"geometry/{kind}"):
            sides += [2 * float(shape.get("radius", "inf")), float(shape.get("length", "0"))]
    return bool(sides) and max(sides) <= MARK


def _mesh_file(urdf: Path, name: str, mesh_folder: str) -> Path | str:
    """The file of a URDF's mesh, or the reason why MuJoCo cannot read it.

    `package://` names are searched in the folders above the URDF. Then the bare file name is searched in the `meshdir`
    of the file's `<compiler>`, as MuJoCo does.
    """
    parts = Path(name.removeprefix("package://").removeprefix("file://"))
    folders = [urdf.resolve().parent / mesh_folder, *urdf.resolve().parents]
    tried = [folder / path for folder in folders for path in (parts, Path(*parts.parts[1:]))]
    file = next(filter(Path.is_file, [*tried, folders[0] / parts.name]), None)
    if parts.suffix.lower() not in _MESH_KINDS:
        return (
            f"MuJoCo does not read meshes of the kind of {name!r}, only {', '.join(_MESH_KINDS)}; convert it, for "
            f"example with trimesh: `trimesh.load({parts.name!r}, force='mesh').export({parts.stem + '.obj'!r})`, or "
            "give the link a box, cylinder or sphere"
        )
    if file is None:
        return f"there is no mesh {name!r} in {urdf.parent} or the folders above it"
    return file


def _check_limits(model: mujoco.MjModel, numbers: list[int]) -> None:
    """Raise `ChainError` if a joint's limits leave no motion, which MuJoCo reads as no limits, or seem to be in
    degrees."""
    for k in numbers:
        lower, upper = (round(float(limit), 6) + 0.0 for limit in model.jnt_range[k])
        is_given = lower != 0.0 or upper != 0.0 or model.jnt_range[k].any()
        if is_given and not (np.isfinite((lower, upper)).all() and model.jnt_range[k, 0] < model.jnt_range[k, 1]):
            raise ChainError(
                f"the joint {model.joint(k).name!r} has the limits {lower:g} and {upper:g}, which leave it no motion; "
                "correct them, or make the joint a fixed one, or one without limits (continuous in a URDF file)"
            )
    limits = model.jnt_range[[k for k in numbers if model.jnt_limited[k] and not _slides(model, k)]]
    largest = np.abs(limits).max(axis=1, initial=0.0)
    if len(largest) > 1 and largest.min() > _MOST_TURNS and largest.max() <= _LARGEST_IN_DEGREES:
        raise ChainError(
            f"the joints of the arm turn by up to {largest.max():.4g} rad: the file seems to give degrees where "
            "radians are read; a URDF file has radians, and an MJCF file with degrees has no "
            '<compiler angle="radian"/>'
        )


def _check_numbers(model: mujoco.MjModel) -> None:
    """Raise `ChainError` if a position, size or mass in the file is not finite. MuJoCo reads NaN with a mere
    warning."""
    geoms = np.concatenate([model.geom_pos, model.geom_quat, model.geom_size], axis=1)
    bodies = np.concatenate([model.body_pos, model.body_quat, model.body_inertia, model.body_mass[:, None]], axis=1)
    joints = np.concatenate([model.jnt_pos, model.jnt_axis], axis=1)
    for numbers, owners in ((bodies, range(model.nbody)), (joints, model.jnt_bodyid), (geoms, model.geom_bodyid)):
        wrong = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
        if len(wrong):
            name = model.body(int(owners[wrong[0]])).name
            raise ChainError(
                f"a place, size or mass of {name!r} or of its joint is not a finite number; correct the file"
            )


def _slides(model: mujoco.MjModel, joint: int) -> bool:
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_SLIDE)


def _tied_joints(model: mujoco.MjModel, constraint: int, numbers: list[int]) -> list[int]:
    """The joints of an arm that an <equality> couples: by a fixed tendon, or between two bodies of the robot."""
    kind, one, other = (int(rows[constraint]) for rows in (model.eq_type, model.eq_obj1id, model.eq_obj2id))
    if kind == int(mujoco.mjtEq.mjEQ_TENDON):
        wraps = [
            wrap
            for tendon in (one, other)
            if tendon >= 0
            for wrap in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        ]
        is_joint = int(mujoco.mjtWrap.mjWRAP_JOINT)
        tied = {int(model.wrap_objid[wrap]) for wrap in wraps if int(model.wrap_type[wrap]) == is_joint}
        return [k for k in numbers if k in tied]
    if kind not in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)):
        return []
    if int(model.eq_objtype[constraint]) == int(mujoco.mjtObj.mjOBJ_SITE):
        one, other = int(model.site_bodyid[one]), int(model.site_bodyid[other])
    if model.body_rootid[one] != model.body_rootid[other]:  # such as the body that a mouse drags
        return []
    between = {one, *_carriers(model, one)} ^ {other, *_carriers(model, other)}
    return [k for k in numbers if int(model.jnt_bodyid[k]) in between]


def _check_joints_are_free(model: mujoco.MjModel, base: int, numbers: list[int]) -> None:
    """Raise `ChainError` if a joint of the arm follows another joint, or if the arm's first joint is left out."""
    hinge, slide = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    own = np.flatnonzero(model.jnt_bodyid == base)
    kinds = [int(kind) for kind in model.jnt_type[np.isin(model.jnt_bodyid, [base, *_carriers(model, base)])]]
    drives = kinds.count(slide) >= 2 and kinds.count(hinge) == 1  # a base along x and y, and about z
    if hinge in model.jnt_type[own] and not drives:
        joints, parent = ", ".join(repr(model.joint(k).name) for k in own), model.body(model.body_parentid[base]).name
        raise ChainError(
            f"the joint {joints} moves {model.body(base).name!r} itself, so it would not be one of the arm's: choose "
            f"{parent!r}, which carries it, as the base"
        )
    for k in range(model.neq):
        one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if int(model.eq_type[k]) == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_active0[k] and one in numbers:
            leader = f"follows {model.joint(other).name!r}" if other >= 0 else "is held where it is"
            raise ChainError(
                f"the joint {model.joint(one).name!r} {leader} (<mimic> in a URDF file, <equality> in an MJCF file), "
                "and the joints of an arm move freely; choose a base and a tip between which none does"
            )
        tied = _tied_joints(model, k, numbers) if model.eq_active0[k] else []
        if tied:
            raise ChainError(
                f"an <equality> of the file ties {', '.join(repr(model.joint(joint).name) for joint in tied)} "
                "together, and the joints of an arm move freely; choose a base and a tip between which it ties none, "
                "or take it out of the file"
            )


def _check_base_is_upright(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> None:
    """Raise `ChainError` if the z axis of the base frame is not vertical. It names the upright bodies that carry it."""
    mujoco.mj_kinematics(model, data)
    if (tilt := _tilt(data, base)) <= _TILTED:
        return
    upright = [model.body(body).name for body in _carriers(model, base) if _tilt(data, body) <= _TILTED]
    raise ChainError(
        f"the z axis of {model.body(base).name!r} is {tilt:.3g} rad off the vertical, and answers about the floor take "
        f"it to point up; choose a base that stands upright: {', '.join(map(repr, upright))}"
    )


def _tilt(data: mujoco.MjData, body: int) -> float:
    """[rad] between the z axis of a body and the vertical."""
    x, y, z = data.xmat[body].reshape(3, 3)[:, 2]
    return float(np.arctan2(np.hypot(x, y), z))


def _carriers(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """The ancestors of a body, the nearest first, the world last."""
    while body:
        body = int(model.body_parentid[body])
        yield body


def check_sizes(model: mujoco.MjModel, geoms: Sequence[int]) -> None:
    """Raise `ChainError` if a mesh among the geoms is too large to be in metres."""
    for geom in geoms:
        if int(model.geom_type[geom]) != int(mujoco.mjtGeom.mjGEOM_MESH):
            continue
        length = 2 * float(model.geom_aabb[geom, 3:].max())
        if length > _LARGEST:
            raise ChainError(
                f"a mesh of {model.body(model.geom_bodyid[geom]).name!r} is {length:.3g} m long: its file seems to be "
                'in millimetres; say scale="0.001 0.001 0.001" in the <mesh> of the robot\'s file, or --mesh-scale '
                "0.001 to `robot make`"
            )


def _find_tip(model: mujoco.MjModel, name: str) -> tuple[bool, int]:
    """Whether the name belongs to a site, and the id of this site or of the body with this name."""
    for kind in (mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY):
        number = mujoco.mj_name2id(model, kind, name)
        if number >= 0:
            return kind == mujoco.mjtObj.mjOBJ_SITE, number
    sites, bodies = (_listed(model, kind) for kind in (mujoco.mjtObj.mjOBJ_SITE, mujoco.mjtObj.mjOBJ_BODY))
    raise ChainError(f"there is no site or body {name!r}; there are the sites {sites} and the bodies {bodies}")


def _listed(model: mujoco.MjModel, kind: mujoco.mjtObj) -> str:
    count = model.nbody if kind == mujoco.mjtObj.mjOBJ_BODY else model.nsite
    names = [mujoco.mj_id2name(model, kind, k) for k in range(count)]
    return ", ".join(repr(name) for name in names if name) or "none with a name"


def _tip_pose(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Floats:
    is_site, tip = _find_tip(model, name)
    return _pose(data.site_xmat[tip], data.site_xpos[tip]) if is_site else _pose(data.xmat[tip], data.xpos[tip])


def _pose(R: Floats, p: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(R, (3, 3)), p
    return T


def _tool_rotation(approach: str) -> Floats:
    if approach not in APPROACHES:
        raise ChainError(f"there is no approach axis {approach!r}; there are {', '.join(map(repr, APPROACHES))}")
    return APPROACHES[approach]


def _joints_between(model: mujoco.MjModel, base: int, tip: int, names: tuple[str, str]) -> list[int]:
    """Ids of the joints that move the tip relative to the base, from the base on."""
    found: list[int] = []
    body = tip
    while body != base:
        if body == 0:
            raise ChainError(f"{names[1]!r} is not attached to {names[0]!r}; choose a base among its parents")
        first = int(model.body_jntadr[body])
        found = list(range(first, first + int(model.body_jntnum[body]))) + found if first >= 0 else found
        body = int(model.body_parentid[body])
    known = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    wrong = [k for k in found if int(model.jnt_type[k]) not in known]
    if wrong or not found:
        listed = ", ".join(repr(model.joint(k).name) for k in wrong) or "no joint"
        raise ChainError(
            f"between {names[0]!r} and {names[1]!r} there is {listed}; an arm has hinges, and may have a lift"
        )
    return found


def _lift_and_hinges(joints: list[_Joint], names: tuple[str, str]) -> tuple[_Joint, list[_Joint]]:
    """The lift and the joints of the arm. An arm without a lift gets one that does not move.

    Raises:
        ChainError: these are not the joints of an arm.
    """
    lifts, hinges = [joint for joint in joints if joint.slides], [joint for joint in joints if not joint.slides]
    if len(hinges) not in (6, 7) or len(lifts) > 1 or [*lifts, *hinges] != joints:
        what = ", ".join(f"{joint.name} ({'slide' if joint.slides else 'hinge'})" for joint in joints)
        raise ChainError(
            f"an arm has 6 or 7 hinges, after one vertical slide if it stands on a lift; between {names[0]!r} and "
            f"{names[1]!r} there are: {what}. Choose another base or tip"
        )
    lift = lifts[0] if lifts else _NO_LIFT
    if abs(lift.axis[2] - 1.0) > _PARALLEL or lift.lower <= -CONTINUOUS:
        raise ChainError(f"the lift {lift.name} must slide along the base frame's z axis, up, and have limits")
    return lift, hinges


def _frames(hinges: list[_Joint], T_base_tip: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Offsets (1 + n, 3 or 12), axes (1 + n,) and tip of the chain, from frames of the lift, each hinge, and the TCP.

    If all axes are those of the base frame and the TCP has its orientation, all frames are parallel to it. Otherwise
    each hinge turns about the z axis of its own frame.
    """
    axis_numbers = [int(np.argmax(joint.axis)) for joint in hinges]
    away = [np.abs(joint.axis - np.eye(3)[k]).max() for joint, k in zip(hinges, axis_numbers, strict=True)]
    parallel = max(*away, np.abs(T_base_tip[:3, :3] - np.eye(3)).max()) < _SAME_AXIS
    frames = [np.eye(4), np.eye(4)]
    for joint, origin in zip(hinges, _origins(hinges), strict=True):
        frames.append(_pose(np.eye(3) if parallel else frame_along(joint.axis), origin))
    frames.append(T_base_tip)
    places = [np.linalg.inv(parent) @ frame for parent, frame in itertools.pairwise(frames)]
    rows = np.array([np.concatenate([T[:3, 3], T[:3, :3].ravel()]) for T in places])
    if parallel:
        rows = rows[:, :3]
    return rows[:-1].copy(), np.array([5, *(axis_numbers if parallel else [2] * len(hinges))]), rows[-1].copy()


def _origins(hinges: list[_Joint]) -> list[Floats]:
    """A point on each axis: on the first axis the point nearest to the second axis, then always the point nearest to
    the previous point.

    The sum of their distances is an upper bound of the arm's reach, so it should be small.
    """
    first, second = hinges[:2]
    normal = np.cross(first.axis, np.cross(first.axis, second.axis))
    slope = float(normal @ second.axis)
    along = float(normal @ (first.point - second.point)) / slope if abs(slope) > _PARALLEL else 0.0
    point = second.point + along * second.axis
    points = []
    for joint in hinges:
        point = np.asarray(joint.point + joint.axis * float(joint.axis @ (point - joint.point)))
        points.append(point)
    return points


def tcp_pose_of_model(model: mujoco.MjModel, q: Mapping[str, float], base: str, tip: str, approach: str) -> Floats:
    """T_base_tcp (4, 4) by MuJoCo, with joints at the positions `q`, by their names. "" names no joint."""
    data = mujoco.MjData(model)
    for name, value in q.items():
        if name:
            data.joint(name).qpos = value
    mujoco.mj_kinematics(model, data)
    frame = data.body(base)
    T = np.linalg.inv(_pose(frame.xmat, frame.xpos)) @ _tip_pose(model, data, tip)
    T[:3, :3] = T[:3, :3] @ _tool_rotation(approach)
    return np.asarray(T)


_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): BOX,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): BOX,
    int(mujoco.mjtGeom.mjGEOM_SPHERE): BOX,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): CYLINDER,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ELLIPSOID,
    int(mujoco.mjtGeom.mjGEOM_MESH): HULL,
}
"""The core of each kind of geom. A capsule is a segment and a sphere a point: boxes without width."""


def _shapes_of_arm(
    model: mujoco.MjModel,
    numbers: list[int],
    has_lift: bool,
    frames: tuple[Floats, NDArray[np.int64], Floats],
    T_base_world: Floats,
) -> Shapes:
    """Shapes of the chain's whole robot: of all bodies in the tree of its root.

    Joints outside the chain stay at their initial positions. Without a lift, the base and everything fixed to it are
    the torso, a neighbour of the first link.
    """
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[numbers]] = 0.0
    mujoco.mj_kinematics(model, data)
    moved = {int(model.jnt_bodyid[joint]): k + (not has_lift) for k, joint in enumerate(numbers)}
    links = [BASE if has_lift else 0]
    for body in range(1, model.nbody):  # a parent has a lower number than its children
        links.append(moved.get(body, links[int(model.body_parentid[body])]))
    root = model.body_rootid[model.jnt_bodyid[numbers[0]]]
    mine = is_solid(model) & (model.body_rootid[model.geom_bodyid] == root)
    mine &= model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    places: list[Floats] = [np.asarray(np.linalg.inv(T_base_world), dtype=float)]
    for place in frames[0]:
        T = np.eye(4)
        T[:3, 3], T[:3, :3] = place[:3], place[3:].reshape(3, 3) if place.size > 3 else np.eye(3)
        places.append(places[-1] @ T)
    order = np.flatnonzero(mine)[::-1].tolist()
    check_sizes(model, order)
    return shapes_of(model, data, order, links, places, numbers)


def shapes_of(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: list[int],
    links: Sequence[int],
    places: Sequence[Floats],
    joints: Sequence[int],
    fingers: Mapping[int, float] | None = None,
) -> Shapes:
    """Collision shapes of some geoms, with the pairs that `irm.self_contact` selects.

    Args:
        model: of the robot.
        data: with the chain's joints at 0 and all others at their fixed positions, after `mj_kinematics`.
        geoms: their ids, in the order of the result.
        links: of each body: BASE, 0 … n.
        places: T_world_base, then T_world_link of the n + 1 links (4, 4) each.
        joints: ids of the chain's joints.
        fingers: ids of the bodies of fingers, each with its joint's travel from closed to open [m].

    Raises:
        ChainError: a geom is of another kind than box, capsule, cylinder, sphere, ellipsoid or mesh.
    """
    if not geoms:
        return NO_SHAPES
    count, none = len(geoms), np.zeros((0, 3))
    core, link = np.zeros(count, np.int64), np.array([links[int(model.geom_bodyid[geom])] for geom in geoms])
    half, radius, position, opened = np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3))
    rotation, hulls = np.zeros((count, 3, 3)), [none] * count
    for k, geom in enumerate(geoms):
        kind, size, body = int(model.geom_type[geom]), model.geom_size[geom], int(model.geom_bodyid[geom])
        if kind not in _KINDS:
            raise ChainError(
                f"the geom {model.geom(geom).name!r} is a {mujoco.mjtGeom(kind).name}; a robot consists of boxes, "
                "capsules, cylinders, spheres, ellipsoids and meshes"
            )
        core[k], half[k] = _KINDS[kind], size
        if kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
            half[k] = size[[0, 0, 1]]
        elif kind in (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE)):
            radius[k], half[k] = size[0], (0.0, 0.0, size[1] if kind == int(mujoco.mjtGeom.mjGEOM_CAPSULE) else 0.0)
        elif kind == int(mujoco.mjtGeom.mjGEOM_MESH):
            hulls[k] = hull_corners(model, geom)
            half[k] = np.abs(hulls[k]).max(axis=0)
        T_world_link = places[link[k] + 1]
        turn, origin = T_world_link[:3, :3], T_world_link[:3, 3]
        position[k] = turn.T @ (data.geom_xpos[geom] - origin)
        rotation[k] = turn.T @ data.geom_xmat[geom].reshape(3, 3)
        if fingers is not None and body in fingers:
            opened[k] = turn.T @ data.xaxis[int(model.body_jntadr[body])] * fingers[body]
    bound = np.where(core == CYLINDER, np.hypot(half[:, 0], half[:, 2]), np.linalg.norm(half, axis=1)) + radius
    first = np.cumsum([0, *(len(hull) for hull in hulls)])
    shapes = Shapes(
        *(core, half, radius, bound, link, position, rotation, opened, np.concatenate([none, *hulls]), first),
        *(NO_SHAPES.pairs, NO_SHAPES.groups),
    )
    return with_pairs(shapes, counted_pairs(model, data.qpos, geoms, links, joints), len(places) - 2)


def hull_corners(model: mujoco.MjModel, geom: int) -> Floats:
    """(v, 3) corners of the convex hull of a mesh geom, in the geom's frame [m]."""
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
    return np.asarray(vertices[ConvexHull(vertices).vertices])
