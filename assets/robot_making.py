"""Making of a robot for the environments from the file of an arm: base, lift, motors, fingers and simple shapes.

The file is compiled. Then its bodies, joints, inertias and collision shapes are written to a new model. The smallest
box, cylinder or capsule around a mesh, or around each of its parts, replaces the mesh, so that the result needs no
other file. Two sliding fingers with the same opening replace the moving parts of its own gripper, whatever their
linkage. Its other joints are fixed at their positions in the file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtJoint
from numpy.typing import NDArray

from assets.mesh_shapes import JointAxis, quaternion_of as _quaternion, shapes_around
from assets.robot_motors import ASSUMED, Motor, given_limit, motors_of
from assets.robot_parts import InvalidRobot, rotation_of
from assets.robot_reading import ARM_LIMITS, BASE_LIMITS, LIFT_LIMITS, footprint
from assets.robot_shapes import SUNK, lowest_height
from irm.errors import ChainError
from irm.model_reading import MARK, LoadedModel, UnreadMesh, arm_joints, load_robot, tip_frame
from irm.rotations import rotation
from irm.self_contact import CLEARANCE, is_solid, link_of_body

Floats = NDArray[np.float64]
BASE = ("base_x", "base_y", "base_yaw")
FINGERS = ("left_finger", "right_finger")
_NAMES = frozenset((*BASE, *FINGERS, "world", "mobile_base", "lift", "pillar", "gripper", "grip"))
_BASE_GAINS = (20000.0, 20000.0, 10000.0)
"""[N/m], [N/m], [N m/rad] Gains of the base's position servos, as for the robots of the package."""
_TRACTION, _WHEELS = 0.6 * 9.81, 2 / 3
"""[N/kg] Traction of rubber wheels in every direction, and their distance from the centre as a share of the base's
radius. Values of Fetch."""
_FINGER_GAIN, _FINGER_FORCE = 2000.0, 60.0
"""[N/m], [N] Gain and force of a finger, as for Fetch."""
_PAD = np.array([0.035, 0.006, 0.012])
"""[m] Half extents of a finger along the approach, the finger motion and across both."""
_PALM = 0.02
"""[m] Half depth of the palm that carries the fingers."""
_PAD_CENTRE = -0.02
"""[m] Centre of the fingers along the approach, from the TCP."""
_SAMPLES = 2000
"""Random configurations of the contact tests."""
_SELDOM = 0.05
"""Largest share of configurations in which bodies that belong together do not touch, as in `irm.self_contact`."""
_STILL = 1e-3
"""[m] Range of the lift of a robot without a lift."""
_BARE = 0.05
"""[m] Largest distance between two joints whose link needs no shape, because the shapes of its neighbours meet."""
_COLUMN = 0.06
"""[m] Radius of the column that represents the base of an arm without base shapes."""
_TURN_IN_DEGREES = np.radians(6.3)
"""[rad] A whole turn, rounded up, of a file in radians that is read as degrees."""
_LEAST_MASS, _LEAST_INERTIA = 1e-3, 1e-6
"""[kg], [kg m²] of a body without mass or inertia in the file."""


@dataclass(frozen=True)
class Mounting:
    """Settings that turn an arm into a robot. Lengths in m.

    Attributes:
        base: name of the arm's first body, or of the file's own mobile base.
        tip: name of the site or body between the finger tips, or of the flange.
        approach: axis of the tip along which the gripper approaches.
        turn: [rad] about it from the tip's y axis to the axis along which the fingers move.
        on: x and z of `base` on a round base that is built for it. None for a file with its own base on the ground.
        radius: radius of the round base.
        lift: range of a lift that is built under the arm. None for no lift.
        opening: opening of the gripper.
        tool: from the tip to the point between the finger tips, along the approach.
        without: names of bodies that are left out, with everything that they carry.
        apart: names of bodies, in pairs, that cannot touch, whatever their shapes here.
        drive: motion of the base: "holonomic", "differential" or "fixed". With "fixed", the round base is a pedestal as
            high as the arm's base.
        mesh_scale: scale of all meshes: 0.001 for a file in millimetres.
        radians: whether angles of an MJCF file are in radians without a statement in the file.
    """

    base: str
    tip: str
    approach: str = "z"
    turn: float = 0.0
    on: tuple[float, float] | None = None
    radius: float = 0.27
    lift: tuple[float, float] | None = None
    opening: float = 0.085
    tool: float = 0.0
    without: tuple[str, ...] = ()
    apart: tuple[str, ...] = ()
    drive: str = "holonomic"
    mesh_scale: float = 1.0
    radians: bool = False

    def check(self) -> None:
        """Raise `InvalidRobot` if a number is impossible for a robot."""
        lengths = {"radius": self.radius, "opening": self.opening, "mesh_scale": self.mesh_scale}
        others = {"turn": (self.turn,), "tool": (self.tool,), "on": self.on or (), "lift": self.lift or ()}
        wrong = [f"{name} {value:g} must be positive" for name, value in lengths.items() if not 0.0 < value < np.inf]
        for name, values in others.items():
            if not np.isfinite(values).all():
                wrong.append(f"{name} {' '.join(f'{value:g}' for value in values)} must be finite")
        if self.lift and not self.lift[0] < self.lift[1]:
            wrong.append(f"lift {self.lift[0]:g} {self.lift[1]:g}: the lower end comes first")
        if wrong:
            raise InvalidRobot("; ".join(wrong))


class MadeRobot(NamedTuple):
    """The MJCF text of a robot, its page, and notes. `page`: keyword arguments of `RobotSpec.from_mjcf` except `home`.
    `found`: notes by name on the parts of the file and their use."""

    mjcf: str
    page: dict[str, Any]
    found: dict[str, str]


def make_robot(file: Path, mounting: Mounting) -> MadeRobot:
    """Make a robot from the file of an arm.

    Raises:
        InvalidRobot: the file cannot be read, or lacks a name of the mounting. The message lists the names that exist.
    """
    mounting.check()
    try:
        loaded = load_robot(file, mounting.mesh_scale, mounting.radians)
        model = loaded.model
        numbers = arm_joints(model, mounting.base, mounting.tip)
        _check_angles(model, numbers)
        T_last_tcp = tip_frame(model, int(model.jnt_bodyid[numbers[-1]]), mounting.tip, mounting.approach)
    except ChainError as problem:
        raise InvalidRobot(str(problem)) from problem
    bodies = [model.body(body).name for body in range(1, model.nbody)]
    if unknown := [name for name in mounting.without if name not in bodies]:
        raise InvalidRobot(f"there is no body {unknown[0]!r} to leave out; there are {', '.join(bodies)}")
    T_last_tcp[:3, :3] = T_last_tcp[:3, :3] @ rotation(0.0, 0.0, mounting.turn)
    T_last_tcp[:3, 3] += mounting.tool * T_last_tcp[:3, 0]
    maker = _Maker(loaded, mounting, numbers)
    gripper = maker.bodies[int(model.jnt_bodyid[numbers[-1]])]
    _add_gripper(maker.robot, gripper, T_last_tcp, mounting, max(-mounting.tool, maker.front(T_last_tcp)))
    _finish_bodies(maker.robot)
    maker.robot.modelname = file.parent.name if file.stem in ("robot", "model", "scene") else file.stem
    try:
        made = maker.robot.compile()
    except ValueError as problem:
        raise InvalidRobot(f"{file}: the robot that was made of it does not compile: {problem}") from problem
    lift = next((name for name, slides in maker.joints if slides), "lift")
    motors = motors_of(made, lift, [name for name, slides in maker.joints if not slides], "grip", maker.given)
    _add_motors(maker.robot, made, motors)
    names = [made.body(body).name for body in range(1, made.nbody)]
    if len(mounting.apart) % 2 or not set(mounting.apart) <= set(names):
        raise InvalidRobot(f"apart={mounting.apart!r} must be bodies, two by two; there are {', '.join(names)}")
    never, always = maker.uncheckable(made)
    apart = [*never, *zip(mounting.apart[::2], mounting.apart[1::2], strict=True)]
    for one, other in dict.fromkeys([*apart, *always, *maker.neighbours()]):
        maker.robot.add_exclude(bodyname1=one, bodyname2=other)
    page: dict[str, Any] = {"base_joints": BASE, "tip": "grip", "finger_joints": FINGERS}
    page |= {"base": mounting.drive} if mounting.drive != "holonomic" else {}
    arm = [model.joint(k).name for k in numbers if int(model.jnt_type[k]) == int(mjtJoint.mjJNT_HINGE)]
    endless = [model.joint(k).name for k in numbers if not model.jnt_limited[k]]
    fastest = [min(loaded.velocities.get(name, np.inf), ARM_LIMITS[0]) for name in arm]
    page |= {"max_velocity": (*BASE_LIMITS, LIFT_LIMITS[0], *fastest)} if min(fastest) < ARM_LIMITS[0] else {}
    joints = [model.joint(k).name or f"joint {k}" for k in range(model.njnt) if k not in numbers]
    found = {
        "arm in the file": ", ".join(name for name, slides in maker.joints if not slides),
        "lift in the file": ", ".join(name for name, slides in maker.joints if slides) or "none",
        **({"limits": f"none in the file, so these turn without end: {', '.join(endless)}"} if endless else {}),
        "other joints, left out or held where they are": ", ".join(joints) or "none",
        "gripper": f"two sliding fingers in place of its own; that they open to {mounting.opening} m is said by "
        "--opening alone, and where the grasp is by --tip, --tool and --turn",
        "torques [N m], forces [N]": ", ".join(
            f"{name} {motor.limit:.3g}{' (assumed)' if motor.is_assumed else ''}"
            for name, motor in motors.items()
            if name != "lift"
        ),
        "shapes": f"boxes, cylinders and capsules in place of {maker.meshes} meshes",
        **maker.notes,
        "touch only as boxes, so not checked": ", ".join(f"{one} and {other}" for one, other in apart) or "none",
        "touch nearly always, so not checked": ", ".join(f"{one} and {other}" for one, other in always) or "none",
    }
    return MadeRobot(maker.robot.to_xml(), page, found)


def _check_angles(model: mujoco.MjModel, numbers: list[int]) -> None:
    """Raise `InvalidRobot` if the ranges of all hinges look like radians read as degrees."""
    hinges = [k for k in numbers if int(model.jnt_type[k]) == int(mjtJoint.mjJNT_HINGE)]
    widest = float(np.abs(model.jnt_range[hinges]).max())
    if model.jnt_limited[hinges].all() and widest <= _TURN_IN_DEGREES:
        raise InvalidRobot(
            f"the joints of the arm turn by no more than {widest:.3g} rad: the file seems to give radians, without "
            '<compiler angle="radian"/>; then say --radians'
        )


class _Uncheckable(NamedTuple):
    """Pairs of bodies' names. `as_boxes`: their shapes touch, but their meshes never do. `always`: they touch nearly
    always."""

    as_boxes: list[tuple[str, str]]
    always: list[tuple[str, str]]


@dataclass
class _Touches:
    """Numbers of configurations in which two bodies touch (`shapes`) or not (`apart`), and whether their meshes ever
    touched."""

    shapes: int = 0
    apart: int = 0
    meshes: bool = False


class _Maker:
    """Copier of a compiled model's bodies into a new `robot`. `bodies`: the new bodies by their old ids. `joints`:
    (name, slides). `given`: limits of their motors by their names."""

    def __init__(self, loaded: LoadedModel, mounting: Mounting, numbers: list[int]) -> None:
        self.model, self.mounting, self.numbers = loaded.model, mounting, numbers
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.root, self.first = self.model.body(mounting.base).id, int(self.model.jnt_bodyid[numbers[0]])
        self.notes: dict[str, str] = {}
        self.robot = mujoco.MjSpec()
        self.bodies: dict[int, Any] = {}
        self.joints: list[tuple[str, bool]] = []
        self.given: dict[str, float] = {}
        self.meshes = 0
        self.robot.compiler.degree, self.robot.compiler.autolimits = False, True
        self.solid = self._solid()
        self._check_shapes(loaded.unread)
        base = self.robot.worldbody.add_body(name="mobile_base", **_inertia(60.0, [2.0, 2.0, 2.0]))
        for name, axis in zip(BASE, np.eye(3), strict=True):
            base.add_joint(name=name, type=mjtJoint.mjJNT_HINGE if name == BASE[2] else mjtJoint.mjJNT_SLIDE, axis=axis)
        if mounting.on is None:
            self._add_own_base(base)
        else:
            self._add_round_base(base, *mounting.on)

    def _add_round_base(self, base: Any, x: float, z: float) -> None:
        """Add a round base, a lift unless the file has one, and on them the arm with everything that its base
        carries."""
        model, mounting, r = self.model, self.mounting, self.mounting.radius
        if not z > 0.1:
            raise InvalidRobot(f"on={mounting.on!r}: the arm stands on a base that is higher than 0.1 m")
        is_fixed, place = mounting.drive == "fixed", np.array([x, 0.0, z])
        height = min(z - 0.01, z if is_fixed else 0.34) / 2
        base.add_geom(
            name="wheels", type=mjtGeom.mjGEOM_CYLINDER, size=[r, height - 0.02, 0], pos=[0, 0, height + 0.02]
        )
        if z - 0.01 > 2 * height + 0.04:
            half = (z - 0.01 - 2 * height) / 2
            base.add_geom(
                name="column", type=mjtGeom.mjGEOM_CYLINDER, size=[0.1, half, 0], pos=[x, 0, 2 * height + half]
            )
        carrier = base if self._has_lift() else self._add_lift(base, place)
        # The arm's base is a separate body, or on a pedestal without a lift a part of it: see `RobotSpec.fixed`.
        stands = is_fixed and mounting.lift is None
        made = self.bodies[self.root] = (base if stands else carrier).add_body(
            name=self._name(model.body(self.root).name, "arm_base"), pos=place if stands else np.zeros(3)
        )
        self._add_geoms(made, self.root)
        self._add_column(made)
        for child in self._children(self.root):
            self._copy(child, carrier)

    def _add_own_base(self, base: Any) -> None:
        """Add the file's own base on the ground, a lift unless the file has one, and the arm on it.

        The body that carries the arm's first link moves with an added lift, so that it stays the neighbour of that
        link. It stays on the base if it has the base's only shape, such as a chassis on a frame without shapes.
        """
        model, up = self.model, np.zeros(3)
        stand = int(model.body_parentid[self.first])
        self._add_geoms(base, self.root)
        self.bodies[self.root] = base
        moved = self.first if self._has_lift() or self._is_all_of_the_base(stand) else stand
        for child in self._children(self.root):
            self._copy(child, base, besides=moved)
        up[2] = self._raised(base)
        carrier = base if self._has_lift() else self._add_lift(base, np.zeros(3))
        self._copy(moved, carrier, up=up)

    def _is_all_of_the_base(self, stand: int) -> bool:
        """Whether all shapes of the base belong to a body and the bodies that it carries."""
        left = set(self._below(self.root)) - set(self._below(stand))
        return not any(self._solid_geoms(body) for body in left if not self._is_left_out(body))

    def _raised(self, base: Any) -> float:
        """Height by which a base and everything on it is raised [m], because in the file it reaches below the
        ground."""
        made = self.robot.compile()
        if not any(made.body_weldid[made.geom_bodyid] == made.body(base.name).id):
            name = self.model.body(self.root).name
            raise InvalidRobot(f"the base {name!r} has no shape in the file; say where the arm stands on one: --on X Z")
        data = mujoco.MjData(made)
        mujoco.mj_kinematics(made, data)
        depths = [-lowest_height(made, data, geom) for geom in range(made.ngeom)]
        depth, geom = max(zip(depths, range(made.ngeom), strict=True))
        if depth <= SUNK:
            return 0.0
        body = made.body(made.geom_bodyid[geom]).name
        name = self.model.body(self.root).name if body == base.name else body
        self.notes["raised"] = f"the robot by {1000 * depth:.1f} mm: so far below the ground {name!r} is in the file"
        for part in (*base.geoms, *base.bodies):
            part.pos = part.pos + (0.0, 0.0, depth)
        return depth

    def _has_lift(self) -> bool:
        return int(self.model.jnt_type[self.numbers[0]]) == int(mjtJoint.mjJNT_SLIDE)

    def _add_lift(self, base: Any, place: Floats) -> Any:
        """Add the body of a lift with the mounting's range. Without one, the range is an unused millimetre."""
        low, high = self.mounting.lift or (0.0, _STILL)
        lift = base.add_body(name="lift", pos=place, **_inertia(5.0, [0.1, 0.1, 0.1]))
        lift.add_joint(
            name="lift", type=mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], range=[low, high], armature=1, damping=[50, 0, 0]
        )
        if self.mounting.on is not None and high > _STILL:
            lift.add_geom(name="pillar", type=mjtGeom.mjGEOM_CYLINDER, size=[0.08, high / 2, 0], pos=[0, 0, -high / 2])
        return lift

    def _copy(self, body: int, parent: Any, besides: int = -1, up: Floats | None = None) -> None:
        """Copy a body with everything that it carries, except moving bodies beyond the arm's last joint.

        Args:
            body: body of the file.
            parent: body of the robot.
            besides: body of the file that is left out, with everything that it carries.
            up: (3,) offset on `parent` from the body's place on the root [m]. None places it relative to its own parent
                in the file.
        """
        model = self.model
        if body == besides:
            return
        own = [k for k in range(model.njnt) if int(model.jnt_bodyid[k]) == body]
        beyond = int(model.jnt_bodyid[self.numbers[-1]]) in self._above(body)
        if model.body(body).name in self.mounting.without or (beyond and own and own[0] not in self.numbers):
            return
        place, quat = (model.body_pos[body], model.body_quat[body]) if up is None else self._on_root(body, up)
        made = parent.add_body(
            name=self._name(model.body(body).name, f"body_{body}"),
            pos=place,
            quat=quat,
            **_inertia(
                float(model.body_mass[body]), model.body_inertia[body], model.body_ipos[body], model.body_iquat[body]
            ),
        )
        self.bodies[body] = made
        for k in own:
            if k in self.numbers:
                name, slides = (
                    self._name(model.joint(k).name, f"joint_{k}"),
                    int(model.jnt_type[k]) == int(mjtJoint.mjJNT_SLIDE),
                )
                self.joints.append((name, slides))
                if (limit := given_limit(model, k)) is not None:
                    self.given[name] = limit
                joint = made.add_joint(name=name, type=mjtJoint(int(model.jnt_type[k])), axis=model.jnt_axis[k])
                joint.pos, joint.ref = model.jnt_pos[k], model.qpos0[model.jnt_qposadr[k]]
                if model.jnt_limited[k]:
                    joint.range = model.jnt_range[k]
                joint.armature, joint.damping = (1.0, [50, 0, 0]) if slides else (0.1, [2, 0, 0])
        self._add_geoms(made, body)
        for child in self._children(body):
            self._copy(child, made, besides)

    def _on_root(self, body: int, up: Floats) -> tuple[Floats, Floats]:
        """Position [m] and quaternion wxyz of a body in the frame of the root, shifted by `up` (3,)."""
        R = self.data.xmat[self.root].reshape(3, 3)
        place = R.T @ (self.data.xpos[body] - self.data.xpos[self.root])
        return place + up, _quaternion(R.T @ self.data.xmat[body].reshape(3, 3))

    def _solid(self) -> NDArray[np.bool_]:
        """Mark the geoms that are shapes: those with collision bits. A body without any uses all its geoms except marks
        of frames."""
        model, solid = self.model, is_solid(self.model)
        is_drawn = ~solid & (2 * model.geom_aabb[:, 3:].max(axis=1) > MARK)
        for body in range(1, model.nbody):
            if not solid[of_body := model.geom_bodyid == body].any():
                solid |= of_body & is_drawn
        return np.asarray(solid & (model.geom_type != int(mjtGeom.mjGEOM_PLANE)))

    def _check_shapes(self, unread: Mapping[str, UnreadMesh]) -> None:
        """Raise `InvalidRobot` if a link of the arm has no shape, or a body lacks a shape because its mesh is not read.

        A link whose two joints are near each other needs no shape. The last link has the gripper.
        """
        model, data = self.model, self.data
        moved = [int(model.jnt_bodyid[k]) for k in self.numbers]
        links: dict[int, list[int]] = {body: [] for body in moved}
        for body in (body for body in self._below(self.root) if not self._is_left_out(body)):
            link = next((one for one in (body, *self._above(body)) if one in links), -1)
            if link >= 0:
                links[link].append(body)
            mesh = unread.get(name := model.body(body).name)
            if mesh is None or self._solid_geoms(body):
                continue
            if mesh.is_for_collisions:
                raise InvalidRobot(f"the link {name!r} has no shape: {mesh.reason}; or leave it out: --without {name}")
            self.notes[f"no shape of {name}"] = mesh.reason
        bare = []
        for body, bodies in links.items():
            here = max(k for k in self.numbers if int(model.jnt_bodyid[k]) == body)
            tip, to_tip = data.xanchor[here], here == self.numbers[-1]
            there = data.xanchor[self.numbers[self.numbers.index(here) + 1]] if not to_tip else tip
            name, is_bare = model.body(body).name, not any(self._solid_geoms(one) for one in bodies)
            if is_bare and np.linalg.norm(there - tip) > _BARE:
                bare += [name + (f" ({unread[name].reason})" if name in unread else "")]
        if bare:
            raise InvalidRobot(
                f"these links have no shape in the file, neither for collisions nor for the eye, so nothing would keep "
                f"them from passing through things: {', '.join(bare)}; give each a box, cylinder, sphere or mesh"
            )

    def _is_left_out(self, body: int) -> bool:
        """Whether a body, or a body that carries it, is named to be left out, or moves beyond the arm's last joint."""
        model, last, on_arm = self.model, int(self.model.jnt_bodyid[self.numbers[-1]]), False
        for one in reversed((body, *self._above(body))):
            first = int(model.body_jntadr[one])
            if model.body(one).name in self.mounting.without or (on_arm and first >= 0 and first not in self.numbers):
                return True
            on_arm = on_arm or one == last
        return False

    def _add_column(self, base: Any) -> None:
        """Add a column up to the first joint as the base of an arm whose base has no shape in the file."""
        still = [one for one in self._below(self.root) if self.first not in (one, *self._above(one))]
        if any(self._solid_geoms(one) for one in still if not self._is_left_out(one)):
            return
        R = self.data.xmat[self.root].reshape(3, 3)
        _, _, height = R.T @ (self.data.xanchor[self.numbers[0]] - self.data.xpos[self.root])
        if height > _BARE:
            size = [_COLUMN, height / 2, 0]
            base.add_geom(type=mjtGeom.mjGEOM_CYLINDER, size=size, pos=[0, 0, height / 2], mass=0)
            self.notes["base of the arm"] = (
                f"{self.model.body(self.root).name!r} has no shape in the file: a column of {_COLUMN} m radius up to "
                "the first joint stands for it"
            )

    def _add_geoms(self, to: Any, body: int) -> None:
        """Add the shapes of a body."""
        model = self.model
        for geom in self._solid_geoms(body):
            kind, place = mjtGeom(int(model.geom_type[geom])), (model.geom_pos[geom], model.geom_quat[geom])
            if kind == mjtGeom.mjGEOM_MESH:
                self.meshes += 1
                for shape in shapes_around(*_surface(model, geom), self._joints_of(body)):
                    to.add_geom(**shape, mass=0)
            else:  # the planner knows no ellipsoids, so a box replaces it
                kind = mjtGeom.mjGEOM_BOX if kind == mjtGeom.mjGEOM_ELLIPSOID else kind
                to.add_geom(type=kind, size=model.geom_size[geom], mass=0, pos=place[0], quat=place[1])

    def _joints_of(self, body: int) -> tuple[JointAxis, JointAxis] | None:
        """The arm's joint that moves a body, and the next joint, in the frame of the body. None if either is
        missing."""
        here = [k for k in self.numbers[:-1] if int(self.model.jnt_bodyid[k]) == body]
        if not here:
            return None
        R, place = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
        following = self.numbers[self.numbers.index(here[-1]) + 1]
        first, second = (
            JointAxis((self.data.xanchor[k] - place) @ R, self.data.xaxis[k] @ R) for k in (here[-1], following)
        )
        return first, second

    def neighbours(self) -> Iterator[tuple[str, str]]:
        """Yield the arm's first link and the body that it stands on, if the robot has a lift between them."""
        stand = self.bodies.get(int(self.model.body_parentid[self.first]))
        if stand is not None and stand.name != self.bodies[self.first].parent.name:
            yield stand.name, self.bodies[self.first].name

    def uncheckable(self, made: mujoco.MjModel) -> _Uncheckable:
        """Find pairs of bodies on distant links whose contacts are meaningless, in many random configurations.

        The rule of `irm.self_contact` leaves out two shapes that nearly always touch. In a body of several shapes, each
        shape may touch less often although one of them always does.
        """
        numbers, names = self.numbers, [name for name, _ in self.joints]
        models = [(made, mujoco.MjData(made)), (self.model, mujoco.MjData(self.model))]
        columns = [[int(made.joint(name).qposadr[0]) for name in names], self.model.jnt_qposadr[numbers]]
        geoms: dict[int, list[Any]] = {
            old: [np.flatnonzero(made.geom_bodyid == made.body(new.name).id), self._solid_geoms(old)]
            for old, new in self.bodies.items()
        }
        lift = [] if any(slides for _, slides in self.joints) else ["lift"]
        links = link_of_body(made, [*lift, *names])
        link = {old: links[made.body(new.name).id] for old, new in self.bodies.items()}
        pairs = {
            pair: _Touches() for pair in itertools.combinations(geoms, 2) if abs(link[pair[0]] - link[pair[1]]) > 1
        }
        limited = self.model.jnt_limited[numbers].astype(bool)[:, None]
        low, high = np.where(limited, self.model.jnt_range[numbers], (-np.pi, np.pi)).T
        for q in np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(low))):
            for (model, data), column in zip(models, columns, strict=True):
                data.qpos[column] = q
                mujoco.mj_kinematics(model, data)
            for (one, other), touches in tuple(pairs.items()):
                touch = (
                    any(
                        mujoco.mj_geomDistance(*world, a, b, 2 * CLEARANCE, None) < CLEARANCE
                        for a, b in itertools.product(geoms[one][k], geoms[other][k])
                    )
                    for k, world in enumerate(models)
                )
                if next(touch):
                    touches.shapes += 1
                    touches.meshes = touches.meshes or next(touch)
                else:
                    touches.apart += 1
                if touches.meshes and touches.apart > _SELDOM * _SAMPLES:
                    del pairs[one, other]
        named = {(self.bodies[one].name, self.bodies[other].name): found for (one, other), found in pairs.items()}
        return _Uncheckable(
            [pair for pair, found in named.items() if found.shapes and not found.meshes],
            [pair for pair, found in named.items() if found.meshes],
        )

    def front(self, T_last_tcp: Floats) -> float:
        """Farthest point of the last link's shapes, and of bodies fixed to it, along the approach from the TCP [m]."""
        model, data, last = self.model, mujoco.MjData(self.model), int(self.model.jnt_bodyid[self.numbers[-1]])
        mujoco.mj_kinematics(model, data)
        reached = [-np.inf]
        for geom in (geom for body in self._below(last) if body in self.bodies for geom in self._solid_geoms(body)):
            corners = model.geom_aabb[geom, :3] + model.geom_aabb[geom, 3:] * list(itertools.product((-1, 1), repeat=3))
            world = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            there = (world - data.xpos[last]) @ data.xmat[last].reshape(3, 3)
            reached.append(float(((there - T_last_tcp[:3, 3]) @ T_last_tcp[:3, 0]).max()))
        return max(reached)

    def _solid_geoms(self, body: int) -> list[int]:
        """The geoms of a body of the file that are collision shapes."""
        first, count = int(self.model.body_geomadr[body]), int(self.model.body_geomnum[body])
        return [geom for geom in range(first, first + count) if self.solid[geom]]

    def _children(self, body: int) -> list[int]:
        """The children of a body. Of the world's children, only the robot, because a scene may hold other bodies."""
        children = [k for k in range(1, self.model.nbody) if k != body and int(self.model.body_parentid[k]) == body]
        return children if body else [k for k in children if k in (self.first, *self._above(self.first))]

    def _above(self, body: int) -> list[int]:
        """The ancestors of a body, the nearest first."""
        found = []
        while body:
            body = int(self.model.body_parentid[body])
            found.append(body)
        return found

    def _below(self, body: int) -> list[int]:
        """A body and its descendants."""
        return [body, *(below for child in self._children(body) for below in self._below(child))]

    def _name(self, name: str, otherwise: str) -> str:
        return f"own_{name}" if name in _NAMES else name or otherwise


def _add_gripper(robot: mujoco.MjSpec, wrist: Any, T_wrist_tcp: Floats, mounting: Mounting, front: float) -> None:
    """Add a palm with two sliding fingers to the body of the last joint, whose shapes end at `front` [m]."""
    quat = _quaternion(T_wrist_tcp[:3, :3])

    def at(x: float) -> Floats:
        return np.asarray(T_wrist_tcp[:3, 3] + T_wrist_tcp[:3, 0] * x)

    gripper = wrist.add_body(name="gripper", **_inertia(0.3, [1e-4] * 3))
    gripper.add_site(name="grip", pos=at(0.0), quat=quat)
    back = _PAD_CENTRE - _PAD[0] - 0.005
    size = [_PALM, mounting.opening / 2 + 2 * _PAD[1], 0.025]
    gripper.add_geom(name="palm", type=mjtGeom.mjGEOM_BOX, size=size, pos=at(back - _PALM), quat=quat, mass=0)
    if (neck := back - 2 * _PALM - front) > 0:  # no wider than a flange, so that the wrist can bend
        place = {"pos": at(front + neck / 2), "quat": quat}
        gripper.add_geom(name="neck", type=mjtGeom.mjGEOM_BOX, size=[neck / 2, 0.025, 0.025], **place, mass=0)
    for name, side in zip(FINGERS, (1.0, -1.0), strict=True):
        finger = wrist.add_body(name=name, pos=at(_PAD_CENTRE), quat=quat, **_inertia(0.1, [1e-4] * 3))
        finger.add_joint(
            name=name,
            type=mjtJoint.mjJNT_SLIDE,
            axis=[0, side, 0],
            range=[0, mounting.opening / 2],
            armature=1,
            damping=[20, 0, 0],
        )
        pad = finger.add_geom(name=name, type=mjtGeom.mjGEOM_BOX, size=_PAD, pos=[0, _PAD[1] * side, 0])
        pad.condim, pad.friction, pad.priority, pad.solref = 4, [1, 0.02, 0.0005], 1, [0.004, 1]
        pad.solimp[:3] = 0.95, 0.99, 0.001
    coupling = robot.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=FINGERS[0], name2=FINGERS[1])
    coupling.data[1], coupling.solref = 1, [0.004, 1]


def _finish_bodies(robot: mujoco.MjSpec) -> None:
    """Compensate gravity, and set the collision bits."""
    for body in robot.bodies[1:]:
        body.gravcomp = 1
    for geom in robot.geoms:
        geom.contype, geom.conaffinity = 2, 0


def _add_motors(robot: mujoco.MjSpec, made: mujoco.MjModel, motors: Mapping[str, Motor]) -> None:
    """Add a position servo for each joint. The text `ASSUMED` lists the joints with assumed torques, except an added
    lift.

    The base pushes in every direction with the traction of its wheels, and turns with this force at its wheels.
    """
    push = _TRACTION * float(made.body_subtreemass[made.body("mobile_base").id])
    turn = push * _WHEELS * float(footprint(made, "mobile_base")["base_radius"])
    base = zip(BASE, _BASE_GAINS, (push / np.sqrt(2), push / np.sqrt(2), turn), strict=True)
    servos = {name: (gain, limit) for name, gain, limit in base}
    servos |= {name: (motor.stiffness, motor.limit) for name, motor in motors.items()}
    servos |= dict.fromkeys(FINGERS, (_FINGER_GAIN, _FINGER_FORCE))
    for name, (gain, limit) in servos.items():
        actuator = robot.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=gain, dampratio=1)
        actuator.forcerange, actuator.forcelimited = [-limit, limit], True
    if assumed := [name for name, motor in motors.items() if motor.is_assumed and name != "lift"]:
        robot.add_text(name=ASSUMED, data=", ".join(assumed))


def _inertia(mass: float, inertia: Any, ipos: Any = (0, 0, 0), iquat: Any = (1, 0, 0, 0)) -> dict[str, Any]:
    least = np.maximum(np.asarray(inertia, dtype=float), _LEAST_INERTIA)
    return {"mass": max(mass, _LEAST_MASS), "inertia": least, "ipos": ipos, "iquat": iquat, "explicitinertial": True}


def _surface(model: mujoco.MjModel, geom: int) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices (v, 3) [m] and edges (e, 2) of a mesh geom, in the frame of its body."""
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return vertices @ rotation_of(model.geom_quat[geom]).T + model.geom_pos[geom], edges
