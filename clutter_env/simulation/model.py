"""The MuJoCo model of robot, furniture and objects, its physics options and meshes, and an index of its elements."""

from __future__ import annotations

import importlib.util
import itertools
import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets import ActingJoints, RobotSpec, paired_name, robot_contacts
from clutter_env.config import TIMESTEP
from clutter_env.errors import ConfigError
from clutter_env.scene.household import KINDS, Kind
from clutter_env.scene.layout import TABLE_HEIGHT, Layout, furniture, openings_of, supports_of
from clutter_env.scene.opening import DOOR, DRAWER, DRAWERS, Opening
from clutter_env.scene.table_scene import object_name

PARKED_X = -3.0
"""[m] where the base stands in the model's reference configuration: clear of everything, so that objects may start
asleep."""
_BITS = {"contype": 1, "conaffinity": 3}
"""Contact bits of furniture and objects."""
_GROUND_BITS = {"contype": 1, "conaffinity": 3}
_ROBOT_CONTACT = {"contype": 2, "conaffinity": 2, "condim": 1, "priority": 0}
"""The robot collides with itself too, without friction. Pairs without self-collision are excluded, body by body. The
friction of its contacts is that of the other geom, whatever its file says."""
_FURNITURE_CONTACT: dict[str, Any] = {**_BITS, "priority": 1, "friction": (0.2, 0.005, 0.0001)}
_OBJECT_CONTACT: dict[str, Any] = {
    **_BITS,
    "priority": 1,
    "friction": (0.8, 0.005, 0.0005),
    "solref": (0.01, 1.0),
}
"""Contacts of an object have the object's friction. Of two geoms with equal priorities MuJoCo takes the larger
friction. Furniture has 0.2, as a smooth board, and the fingers have no friction of their own."""
_PAD_CONTACT: dict[str, Any] = {
    "condim": 4,
    "priority": 1,
    "friction": (1e-5, 0.02, 0.0005),
    "solref": (0.004, 1.0),
    "solimp": (0.95, 0.99, 0.001, 0.5, 2.0),
    "solmix": 1e3,
}
"""Contact of a finger's pad, which has no friction of its own, see above. MuJoCo takes the larger number of dimensions,
here the pad's. It also takes the larger torsional friction, that of a pad that yields over an area. `solmix` gives the
contact the pad's stiffness, which a hold without creep needs."""
_OBJECT_ROLLING_DAMPING = 2e-4
"""[N m s] Damping of the objects' rotation."""
_OBJECT_ROLLING_FRICTION = 3e-3
"""[N m] Friction of the rotation about an object's own axis. A rolling cylinder stops within a second and rests on
slopes of up to 3°. Tipping is about the other axes and not affected."""
_FURNITURE_COLOURS = {
    "table": (0.80, 0.68, 0.53, 1.0),
    "counter": (0.83, 0.84, 0.85, 1.0),
    "wall": (0.90, 0.90, 0.88, 1.0),
    "shelf": (0.66, 0.54, 0.41, 1.0),
    "partition": (0.90, 0.90, 0.88, 0.35),
    "second": (0.80, 0.68, 0.53, 1.0),
    "chest": (0.78, 0.70, 0.58, 1.0),
}
_FRONT_COLOUR, _HANDLE_COLOUR, _INSIDE_COLOUR = (
    (0.47, 0.60, 0.62, 1.0),
    (0.22, 0.23, 0.25, 1.0),
    (0.86, 0.82, 0.74, 1.0),
)
"""Colours of drawers and doors: front, handle, and the inside of a drawer."""
_OPENING_DENSITY = 300.0
"""[kg/m³] of doors and drawers: light wood, or hollow panels."""
TRAY_COLOURS = {
    "tray_red": (0.80, 0.25, 0.22, 1.0),
    "tray_green": (0.30, 0.62, 0.33, 1.0),
    "tray_blue": (0.25, 0.42, 0.78, 1.0),
}
"""Colours of the trays of layout "trays", and of the objects that belong in them."""
_OTHER_COLOUR = (0.72, 0.74, 0.76, 1.0)
"""Colour of furniture that a layout adds."""
_FRIDGE_COLOUR, _FRIDGE_DOOR = (0.88, 0.90, 0.92, 1.0), (0.78, 0.82, 0.85, 1.0)
_GLASS_ALPHA = 0.45
"""Opacity of the shelves behind a door, which are seen from the front."""
_SHELVES_ALPHA = 0.2
"""Total opacity of the shelves above objects, seen from above."""
_TOP_X = -0.45
"""[m] of the camera "top": between the table and where the robot starts."""
_GROUND_SIZE = 15.0
"""[m] Drawn extent of the ground. For contacts the ground is infinite. Infinite drawn ground doubles the time of an
image."""
_SLICES, _STACKS = 24, 6
"""Facets of drawn cylinders and capsules, around and along their axes. They limit the speed of software renderers."""
_TRACTION, _GRAVITY = 0.6, 9.81
"""Friction of rubber wheels on a floor. [m/s²] Gravity."""
_ANCHORED = 1e7
"""[kg], [kg m²] Armature of the joints of a fixed base, so large that the arm cannot move it."""
_BODY = mujoco.mjtObj.mjOBJ_BODY
_EXTENT = 2.0
"""[m] MuJoCo's measure of the scene, which scales the camera's near and far planes to 0.02 m and 100 m."""


@dataclass(frozen=True)
class ModelIndex:
    """Addresses of elements in a compiled model. Arrays are read-only."""

    base_body: int
    tcp_site: int
    drive_qpos: NDArray[np.intp]
    drive_dof: NDArray[np.intp]
    drive_actuators: NDArray[np.intp]
    finger_qpos: NDArray[np.intp]
    finger_actuators: NDArray[np.intp]
    finger_geoms: tuple[tuple[int, int], ...]
    """The pads of each gripper."""
    finger_couplings: tuple[int, ...]
    """The equality constraints that make the fingers move alike."""
    still_qpos: NDArray[np.intp]
    still_actuators: NDArray[np.intp]
    opening_qpos: NDArray[np.intp]
    opening_dof: NDArray[np.intp]
    """Of the joints of what opens."""
    handles: NDArray[np.intp]
    """The geoms of its handles: bars and posts."""
    object_bodies: slice
    object_geoms: slice
    """Of all objects, one after the other."""
    geom_slots: NDArray[np.intp]
    """The slot of the object that each of them belongs to."""
    object_bvh: NDArray[np.intp]
    """The bounding boxes of the objects' bodies."""
    object_qpos: slice
    object_dof: slice
    num_objects: int

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: RobotSpec, num_objects: int) -> ModelIndex:
        """The index of a model that `compile_model` made."""

        def qpos(joints: tuple[str, ...]) -> NDArray[np.intp]:
            return _frozen([model.joint(name).qposadr[0] for name in joints])

        def actuators(joints: tuple[str, ...]) -> NDArray[np.intp]:
            return _frozen([model.actuator(name).id for name in joints])

        first = model.body(object_name(0)).id if num_objects else model.nbody
        first_geom = int(model.body_geomadr[first]) if num_objects else model.ngeom
        acting = ActingJoints.of(robot)
        finger_joints = tuple(name for pair in acting.finger_joints for name in pair)
        fingers = [model.joint(name).id for name in finger_joints]
        opening = [name for name in (DRAWER, DOOR, *DRAWERS) if mujoco.mj_name2id(model, _BODY, name) >= 0]
        is_joint = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
        return cls(
            base_body=model.body(robot.base_body).id,
            tcp_site=model.site(robot.tcp_site).id,
            drive_qpos=qpos(acting.names),
            drive_dof=_frozen([model.joint(name).dofadr[0] for name in acting.names]),
            drive_actuators=actuators(acting.names),
            finger_qpos=qpos(finger_joints),
            finger_actuators=actuators(finger_joints),
            finger_geoms=tuple((model.geom(one).id, model.geom(other).id) for one, other in acting.finger_geoms),
            finger_couplings=tuple(np.flatnonzero(is_joint & np.isin(model.eq_obj1id, fingers)).tolist()),
            still_qpos=qpos(robot.still_joints),
            still_actuators=actuators(robot.still_joints),
            opening_qpos=qpos(tuple(f"{name}_joint" for name in opening)),
            opening_dof=_frozen([int(model.joint(f"{name}_joint").dofadr[0]) for name in opening]),
            handles=_frozen(
                [
                    geom
                    for geom in range(model.ngeom)
                    for name in opening
                    if model.body(model.geom_bodyid[geom]).name == name
                    and model.geom(geom).name.startswith((f"{name}_handle", f"{name}_post"))
                ]
            ),
            object_bodies=slice(first, first + num_objects),
            object_geoms=slice(first_geom, model.ngeom),
            geom_slots=_frozen((model.geom_bodyid[first_geom:] - first).tolist()),
            object_bvh=_frozen(model.body_bvhadr[first : first + num_objects].tolist()),
            object_qpos=slice(model.nq - 7 * num_objects, model.nq),
            object_dof=slice(model.nv - 6 * num_objects, model.nv),
            num_objects=num_objects,
        )


def _frozen(values: list[int]) -> NDArray[np.intp]:
    array = np.array(values, dtype=np.intp)
    array.setflags(write=False)
    return array


def compile_model(
    robot: RobotSpec,
    layout: Layout,
    shapes: tuple[str, ...],
    image_size: tuple[int, int] = (480, 480),
    show_meshes: bool = False,
) -> mujoco.MjModel:
    """Compile a model of robot, furniture and one body per entry of `shapes`.

    Args:
        robot, layout: determine names and sizes.
        shapes: "cylinder", "box" or the kind of a household object for each object.
        image_size: width and height [pixels] of the largest image to be rendered.
        show_meshes: show the robot's meshes instead of its primitives, if they are installed.
    """
    spec = build_spec(robot, layout, shapes)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = image_size
    if show_meshes and has_visuals(robot):
        add_meshes(spec, robot)
    model = spec.compile()
    first = model.nv - 6 * len(shapes)
    model.dof_damping[first:].reshape(-1, 6)[:, 3:] = _OBJECT_ROLLING_DAMPING
    model.dof_frictionloss[first:].reshape(-1, 6)[:, 5] = _OBJECT_ROLLING_FRICTION
    return model


def build_spec(robot: RobotSpec, layout: Layout, shapes: tuple[str, ...]) -> mujoco.MjSpec:
    """Build the editable model, see `compile_model`.

    Raises:
        ConfigError: a box of the layout has the name of another geom.
    """
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    taken = {geom.name for geom in spec.geoms} | {"floor", *(object_name(slot) for slot in range(len(shapes)))}
    if "floor" in {geom.name for geom in spec.geoms}:
        raise ConfigError(f"robot {robot.name!r}: the scene has a ground, 'floor'; leave it out of {robot.mjcf!r}")
    moving = [box for opening in openings_of(layout) for box in (*opening.parts, *opening.handle)]
    for box in (*furniture(layout), *moving):
        if box.name in taken:
            raise ConfigError(
                f"layout {layout.name!r}: box {box.name!r} has the name of a geom of robot {robot.name!r}, "
                "of the floor or of an object; give it another one"
            )
    spec.modelname = f"{robot.name}_{layout.name}"
    _set_physics(spec, len(shapes))
    # The reference configuration moves away from the table while joint positions stay world coordinates.
    spec.body(robot.base_body).pos = [PARKED_X, 0.0, 0.0]
    spec.joint(robot.base_joints[0]).ref = PARKED_X
    if robot.base_drive == "fixed":
        for name in robot.base_joints:
            spec.joint(name).armature = _ANCHORED
    _make_solid(spec, robot)
    _add_surroundings(spec, layout)
    for index, shape in enumerate(shapes):
        _add_object(spec, index, shape)
    return spec


def _make_solid(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Enable contacts of the robot with the ground and those self-collisions that the planner checks, and add pads to
    its fingers.

    MuJoCo excludes contacts between bodies, not geoms. Where only some shapes of two bodies are to collide, the bodies
    are excluded and these shapes are paired. The file's own pairs and exclusions are removed. Its pairs would collide
    in any case, and bodies that it excludes from the world would not touch the ground.
    """
    for part in [*spec.pairs, *(one for one in spec.excludes if "world" in (one.bodyname1, one.bodyname2))]:
        spec.delete(part)
    for number, body in enumerate(spec.bodies):
        body.name = body.name or f"robot_body_{number}"
    model, contacts = spec.compile(), robot_contacts(robot)
    _limit_traction(spec, model, robot)
    geoms = {geom.id: geom for geom in spec.geoms}
    for geom in (geoms[number] for number in contacts.solid.tolist()):
        for name, value in _ROBOT_CONTACT.items():
            setattr(geom, name, value)
    for pad in (pad for pair in ActingJoints.of(robot).finger_geoms for pad in pair):
        for name, value in _PAD_CONTACT.items():
            setattr(spec.geom(pad), name, value)
    counted = set(map(tuple, contacts.pairs.tolist()))
    of_bodies: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for pair in itertools.combinations(contacts.solid.tolist(), 2):
        of_bodies[tuple(geoms[number].parent.name for number in pair)].append(pair)
    for (one, other), pairs in of_bodies.items():
        met, (a, b) = counted.intersection(pairs), (int(model.geom_bodyid[number]) for number in pairs[0])
        is_filtered = a == b or a == model.body_parentid[b] or b == model.body_parentid[a]  # MuJoCo filters these itse
        if len(met) < len(pairs) and (met or not is_filtered):
            spec.add_exclude(bodyname1=one, bodyname2=other)
            for pair in met:
                for number in pair:
                    geoms[number].name = geoms[number].name or paired_name(number)
                spec.add_pair(geomname1=geoms[pair[0]].name, geomname2=geoms[pair[1]].name)
    standing = set(contacts.solid.tolist()) - set(contacts.above_ground.tolist())
    for name in {model.body(model.geom_bodyid[number]).name for number in standing}:
        spec.add_exclude(bodyname1="world", bodyname2=name)


def _limit_traction(spec: mujoco.MjSpec, model: mujoco.MjModel, robot: RobotSpec) -> None:
    """Limit the force of the base motors to the traction of the wheels, in every direction."""
    most = _TRACTION * _GRAVITY * float(model.body_subtreemass[model.body(robot.base_body).id]) / math.sqrt(2.0)
    for joint in robot.base_joints[:2]:
        motor = spec.actuator(joint)
        low, high = motor.forcerange if motor.forcelimited else (-most, most)
        motor.forcerange, motor.forcelimited = (max(low, -most), min(high, most)), True


def _add_surroundings(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Add floor, furniture, lights and cameras.

    Each piece of furniture is a body of its own, in the world's frame. MuJoCo compares the world body's geoms with
    every body of the robot. Other bodies it first filters by their bounding boxes.
    """
    world = spec.worldbody
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[_GROUND_SIZE, _GROUND_SIZE, 0.5],
        rgba=[0.93, 0.94, 0.95, 1],
        **_GROUND_BITS,
    )
    boards = [box.name for box in furniture(layout) if box.name.startswith("shelf_board")]
    for box in furniture(layout):
        kind, tray = box.name.partition("_")[0], box.name.partition("_rim")[0]
        colour = list(TRAY_COLOURS.get(tray) or _FURNITURE_COLOURS.get(kind, _OTHER_COLOUR))
        if layout.is_fridge and kind in ("table", "shelf"):
            colour = list(_FRIDGE_COLOUR)
        if box.name in boards:
            colour[3] = _SHELVES_ALPHA / len(boards) if layout.opens is None else _GLASS_ALPHA
        world.add_body().add_geom(
            name=box.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.position,
            size=box.half_extents,
            rgba=colour,
            **_FURNITURE_CONTACT,
        )
    for opening in openings_of(layout):
        _add_opening(world, opening, _FRIDGE_DOOR if layout.is_fridge else _FRONT_COLOUR)
    # Planners read from this custom tuple the geoms on which objects may be placed.
    names = supports_of(layout)
    spec.add_tuple(
        name="supports",
        objtype=[mujoco.mjtObj.mjOBJ_GEOM] * len(names),
        objname=list(names),
        objprm=[0.0] * len(names),
    )
    _add_lights_and_camera(spec, layout)


def _add_opening(world: mujoco.MjsBody, opening: Opening, front: tuple[float, ...]) -> None:
    """Add a closed drawer or door on its joint. Each reset sets friction and damping."""
    body = world.add_body(name=opening.name, pos=opening.origin)
    body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_INIT
    body.add_joint(
        name=opening.joint,
        type=mujoco.mjtJoint.mjJNT_SLIDE if opening.is_slide else mujoco.mjtJoint.mjJNT_HINGE,
        axis=opening.axis,
        range=(0.0, opening.travel),
        limited=True,
    )
    for box in (*opening.parts, *opening.handle):
        is_handle = box in opening.handle
        colour = _HANDLE_COLOUR if is_handle else front if box is opening.parts[0] else _INSIDE_COLOUR
        body.add_geom(
            name=box.name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[place - origin for place, origin in zip(box.position, opening.origin, strict=True)],
            size=box.half_extents,
            rgba=colour,
            density=_OPENING_DENSITY,
            **(_OBJECT_CONTACT if is_handle else _FURNITURE_CONTACT),
        )


def _add_lights_and_camera(spec: mujoco.MjSpec, layout: Layout) -> None:
    """Add soft light, a pale sky and the camera "top"."""
    spec.visual.quality.offsamples = 0
    spec.visual.quality.numslices, spec.visual.quality.numstacks = _SLICES, _STACKS
    spec.stat.extent, spec.stat.center = _EXTENT, [0.0, 0.0, TABLE_HEIGHT]
    spec.visual.headlight.ambient = [0.42, 0.42, 0.42]
    spec.visual.headlight.diffuse = [0.32, 0.32, 0.32]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.97, 0.98, 1.0],
        rgb2=[0.86, 0.90, 0.94],
        width=64,
        height=384,
    )
    world = spec.worldbody
    world.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[-1.5, 1.5, 4],
        dir=[0.45, -0.35, -1],
        diffuse=[0.45, 0.45, 0.45],
        castshadow=False,
    )
    height = TABLE_HEIGHT + 1.2 * (max(layout.width, layout.depth) + 1.0)
    world.add_camera(name="top", pos=[_TOP_X, 0, height], xyaxes=[0, -1, 0, 1, 0, 0], fovy=45)


def kind_model(kind: str) -> mujoco.MjModel:
    """Model of one household object alone, as body 1, with the same properties as in all models."""
    spec = mujoco.MjSpec()
    _add_object(spec, 0, kind)
    return spec.compile()


def _add_object(spec: mujoco.MjSpec, index: int, shape: str) -> None:
    """Add a free body. `apply_scene` sets its size, mass and pose."""
    body = spec.worldbody.add_body(name=object_name(index), pos=[0.0, 0.0, 3.0 + index])
    body.add_freejoint(name=f"{object_name(index)}_joint")
    body.sleep = mujoco.mjtSleepPolicy.mjSLEEP_INIT
    if shape in KINDS:
        _add_parts(spec, body, KINDS[shape])
        return
    body.explicitinertial = True
    body.mass, body.inertia = 0.2, [1e-3, 1e-3, 1e-3]
    body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    is_box = shape == "box"
    body.add_geom(
        name=object_name(index),
        type=mujoco.mjtGeom.mjGEOM_BOX if is_box else mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.03, 0.03, 0.08] if is_box else [0.03, 0.08, 0],
        **_OBJECT_CONTACT,
    )


def _add_parts(spec: mujoco.MjSpec, body: mujoco.MjsBody, kind: Kind) -> None:
    """Add the geoms of a household object. Hulls are meshes that all objects of the kind share."""
    total, known = sum(part.weight for part in kind.parts), {mesh.name for mesh in spec.meshes}
    for number, part in enumerate(kind.parts):
        mesh = f"{kind.name}_{number}"
        if part.shape == "hull" and mesh not in known:
            inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            spec.add_mesh(name=mesh, uservert=part.points.ravel(), inertia=inertia)
        body.add_geom(
            name=body.name if number == 0 else f"{body.name}/{number}",
            type=_PART_GEOMS[part.shape],
            size=[*part.size, 0.0, 0.0, 0.0][:3],
            pos=part.position,
            quat=part.quaternion,
            mass=kind.mass * part.weight / total,
            rgba=[*part.colour, 1.0],
            **{**_OBJECT_CONTACT, "friction": (kind.friction, *_OBJECT_CONTACT["friction"][1:])},
            **({"meshname": mesh} if part.shape == "hull" else {}),
        )


_PART_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
_SLEEP_TOLERANCE = 5e-3
"""[m/s] Objects slower than this for 20 ms sleep. An object that tips from rest is faster unless within 2° of
balance."""
_WRONG_SPARSE_FACTOR = "4.0.0"
"""The MuJoCo version whose sparse Cholesky factor merges rows that have different descendants (fixed in 4.0.1, issue
3767). Where the robot wedges objects in, its Newton solver can then stop at its iteration limit, far from the solution.
An object then gets hundreds of rad/s."""
_ARENA = 2**24
"""[bytes] for contacts and solver of a scene without objects, MuJoCo's own default."""
_ARENA_PER_OBJECT = 2**19
"""[bytes]"""
_ROWS_PER_OBJECT = 100
"""Constraint rows of an object. Sixty objects awake in one place need 90 each."""
_ROBOT_DOF = 24
"""At least the robot's degrees of freedom."""


def _set_physics(spec: mujoco.MjSpec, num_objects: int) -> None:
    """Set the physics for stable side grasps: elliptic cone, impratio 10, stiff pads. Bodies at rest sleep."""
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10
    option.sleep_tolerance = _SLEEP_TOLERANCE
    option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if mujoco.mj_versionString() == _WRONG_SPARSE_FACTOR:
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        # Room for two copies of the dense Jacobian, one in the order of islands. Pages that are never written take no
        # memory.
        rows, columns = _ROWS_PER_OBJECT * num_objects, 6 * num_objects + _ROBOT_DOF
        spec.memory = _ARENA + _ARENA_PER_OBJECT * num_objects + 2 * 8 * rows * columns


VISUAL_GROUP, HIDDEN_GROUP = 1, 3
"""Geom groups of the meshes shown and of the primitives that they replace."""


def mesh_folder(robot: RobotSpec) -> Path | None:
    """Folder of the robot's meshes, found without importing their package. None if they are not installed."""
    spec = importlib.util.find_spec(robot.mesh_package) if robot.mesh_package else None
    if spec is None or not spec.submodule_search_locations:
        return None
    folder = Path(spec.submodule_search_locations[0]) / robot.mesh_folder
    return folder if folder.is_dir() else None


def has_visuals(robot: RobotSpec) -> bool:
    """Whether every mesh of the robot is installed."""
    folder = mesh_folder(robot)
    return folder is not None and bool(robot.meshes) and all((folder / mesh.file).is_file() for mesh in robot.meshes)


def add_meshes(spec: mujoco.MjSpec, robot: RobotSpec) -> None:
    """Add meshes without mass and contacts and hide the primitives of their bodies."""
    folder = mesh_folder(robot)
    assert folder is not None
    covered = {mesh.body for mesh in robot.meshes}
    for name in covered:
        for geom in spec.body(name).geoms:
            geom.group = HIDDEN_GROUP
    for index, mesh in enumerate(robot.meshes):
        name = f"visual_{index}"
        spec.add_mesh(name=name, file=str(folder / mesh.file))
        spec.body(mesh.body).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            pos=mesh.position,
            quat=mesh.quaternion,
            rgba=mesh.rgba,
            mass=0,
            contype=0,
            conaffinity=0,
            group=VISUAL_GROUP,
        )
