"""Second check of paths and trajectories by MuJoCo's own collision detection, self-collision included.

MuJoCo checks a motion where the planner's own model cannot prove that it keeps `_NEAR` from everything, also between
the states. For the proof, MuJoCo's distances within a margin are no lower bounds, but those of `irm.gjk` are.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from irm.self_contact import BASE, link_of_body
from planners.collision.hit_kernels import unproved_states
from planners.collision.world import OVERLAP, CollisionWorld
from planners.motion.path import WholeBodyPath, cut, interpolate
from planners.motion.trajectory import Trajectory, phases_of
from planners.scene import HeldObject, Scene, SceneError, Solid
from planners.scene.bodies import pose_matrix
from planners.scene.mujoco_reading import local_pose

_ROBOT, _OTHER = 1, 2
"""Collision bits. The robot collides with itself and all other geoms. Of these, only held objects collide with
others."""
_NEAR = 0.001
"""Distance [m] above which a proof replaces MuJoCo's check. The shapes of the two models may differ by as much."""
_OTHER_GEOM = {"contype": _OTHER, "conaffinity": 0, "margin": 0.0}
_MEMORY = 1 << 25
"""Memory [bytes] for contacts, far more than needed."""
OBJECT, OPENING, _OBSTACLE = "object/", "opening/", "obstacle/"
"""Prefixes of names in the model: an object or obstacle may have the same name as a geom or joint of the robot."""
_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
TOLERANCE = 0.0005
"""Penetration [m] that an accepted path may have at checked states. Between them it may be as much again."""
STEP = 0.01
"""Motion [m] of a point of the robot between two checks. Past a cylinder of 25 mm radius, 0.5 mm can be missed."""


def scene_model(scene: Scene, can_open: bool = False) -> mujoco.MjModel:
    """Build a model of robot, ground, static obstacles and objects (free bodies), with this module's collision bits.

    Drawers and doors are fixed, unless they `can_open`: then they get the joints of the scene's openings.
    """
    spec = mujoco.MjSpec.from_file(str(scene.robot.mjcf_path))
    spec.memory = _MEMORY
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity, geom.margin = _ROBOT, _ROBOT | _OTHER, 0.0
    for first, second in _neighbours(scene.robot):
        spec.add_exclude(bodyname1=first, bodyname2=second)
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **_OTHER_GEOM)
    body_of = _moving_bodies(spec, scene) if can_open else {}
    for obstacle in scene.static_obstacles:
        _add_solid(spec, body_of.get(obstacle.name, spec.worldbody), _OBSTACLE + obstacle.name, obstacle)
    for body in scene.objects:
        name = OBJECT + body.name
        added = spec.worldbody.add_body(name=name)
        added.add_freejoint(name=name)
        for index, solid in enumerate(body.solids):
            _add_solid(spec, added, f"{name}/{index}" if body.pieces else name, solid)
    if any(body.pieces for body in scene.objects):
        # Held objects are placed geom by geom, but the boxes of this phase would stay at their bodies.
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    return spec.compile()


def _moving_bodies(spec: mujoco.MjSpec, scene: Scene) -> dict[str, mujoco.MjsBody]:
    """Body of each part that moves with a drawer or door, by its name. All are in the frame of the world now."""
    body_of: dict[str, mujoco.MjsBody] = {}
    for one in sorted(scene.openings, key=lambda one: -len(one.parts)):  # doors before the levers on them
        body = body_of.get(one.parts[0], spec.worldbody).add_body(name=OPENING + one.name)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if one.kind == "slide" else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=OPENING + one.name, type=kind, axis=one.axis, pos=one.point, ref=one.position)
        body_of.update(dict.fromkeys(one.parts, body))
    return body_of


def _add_solid(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, solid: Solid) -> None:
    """Add a solid with its true shape, whatever its contact bits were in the original simulation."""
    half, quaternion = solid.half_extents, np.empty(4)
    mujoco.mju_mat2Quat(quaternion, solid.rotation.ravel())
    shape: dict[str, object] = {"type": _GEOMS[solid.shape]}
    if solid.shape == "hull":
        spec.add_mesh(name=name, uservert=solid.vertices.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
        shape["meshname"] = name
    elif solid.shape == "capsule":
        shape["size"] = [half[0], half[2] - half[0], 0.0]
    elif solid.shape == "cylinder":
        shape["size"] = [half[0], half[2], 0.0]
    else:
        shape["size"] = half
    body.add_geom(name=name, pos=solid.position, quat=quaternion, **shape, **_OTHER_GEOM)


@cache
def _neighbours(robot: RobotSpec) -> tuple[tuple[str, str], ...]:
    """Names of pairs of bodies on the same link or on neighbouring links, whose contacts are ignored.

    For a fixed base, contacts between base and world are ignored, too.
    """
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    links, pairs = link_of_body(model, robot.drive_joints[3:]), itertools.combinations(range(1, model.nbody), 2)
    near = [(a, b) for a, b in pairs if abs(links[a] - links[b]) <= 1]
    near += [(0, b) for b in range(1, model.nbody) if links[b] == BASE and robot.base_drive == "fixed"]
    return tuple((model.body(a).name, model.body(b).name) for a, b in near)


class ModelPositions:
    """Joint positions `qpos` (nq,) of a `scene_model`, set to those of a scene and then changed."""

    def __init__(self, model: mujoco.MjModel, scene: Scene, qpos: NDArray[np.float64]) -> None:
        robot, self.qpos, self._model = scene.robot, qpos, model
        joints = (*robot.drive_joints, robot.finger_joints[0])
        self._columns = np.array([int(model.joint(name).qposadr[0]) for name in joints])
        self._second_finger = int(model.joint(robot.finger_joints[1]).qposadr[0])
        self._start = {body.name: int(model.joint(OBJECT + body.name).qposadr[0]) for body in scene.objects}
        for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            qpos[model.joint(joint).qposadr[0]] = angle
        for body in scene.objects:
            self.put(body.name, body.position, body.quaternion)

    def open(self, name: str, position: float) -> None:
        """Set an opening to a position [m] or [rad], in a model built with `can_open`."""
        self.qpos[self._model.joint(OPENING + name).qposadr[0]] = position

    def move(self, state: NDArray[np.float64]) -> None:
        """Move the robot to a whole-body configuration and finger position (12,)."""
        self.qpos[self._columns] = state
        self.qpos[self._second_finger] = state[-1]

    def put(self, name: str, position: NDArray[np.float64], quaternion: NDArray[np.float64]) -> None:
        """Set the pose of an object."""
        start = self._start[name]
        self.qpos[start : start + 3] = position
        self.qpos[start + 3 : start + 7] = quaternion


class PenetrationReport(NamedTuple):
    """The deepest penetration of a motion.

    Attributes:
        penetration: depth [m], 0 for none.
        pair: names of the two geoms.
        where: (11,) whole-body configuration at this penetration.
        bodies: names of the two bodies. Obstacles are no bodies and have their own name here.
    """

    penetration: float
    pair: tuple[str, str]
    where: NDArray[np.float64]
    bodies: tuple[str, str] = ("", "")

    def __str__(self) -> str:
        one, other = self.bodies
        return f"{one} and {other} overlap by {1000 * self.penetration:.1f} mm"


class MujocoCollisionChecker:
    """Checker of motions in a MuJoCo model of a scene. The model is separate from any simulation."""

    def __init__(self, scene: Scene, world: CollisionWorld | None = None) -> None:
        """Build the model. For the same objects at other poses, `move_to` is faster. `world` is the compiled scene."""
        robot = scene.robot
        self.scene, self._signature = scene, signature(scene)
        self._model = model = scene_model(scene)
        self._data = mujoco.MjData(model)
        self._positions = ModelPositions(model, scene, self._data.qpos)
        data, self._tcp = self._data, model.site(robot.tcp_site).id
        # Views of MuJoCo's memory are kept: creating a view takes longer than using it.
        self._geom_xpos, self._geom_axes = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        self._site_xpos, self._site_axes = data.site_xpos, data.site_xmat.reshape(-1, 3, 3)
        self._gripper = _gripper_geoms(model, robot)
        of_objects = {body.name: model.body(OBJECT + body.name).id for body in scene.objects}
        self._geoms = {name: np.flatnonzero(model.geom_bodyid == body).tolist() for name, body in of_objects.items()}
        self._names = {geom: name for name, geoms in self._geoms.items() for geom in geoms}
        # Poses of the geoms in the frames of their objects: MuJoCo chooses the origin of a mesh itself.
        self._in_object = {geom: pose_matrix(*local_pose(model, "geom", geom)) for geom in self._names}
        # Pairs of the robot's shapes are limited to the planner's. Others touch in nearly every configuration, such as
        # boxes around the meshes of short links.
        geoms = robot.collision_geoms(model)
        counted = {frozenset((geoms[one], geoms[other])) for one, other in robot.shapes.pairs.tolist()}
        self._uncounted = set(map(frozenset, itertools.combinations(geoms, 2))) - counted
        self._world = (world or CollisionWorld.from_scene(scene)).with_padding(_NEAR)

    def move_to(self, scene: Scene, world: CollisionWorld | None = None) -> None:
        """Move the objects to their poses in another scene. Raises `SceneError` if more than their poses differs."""
        if scene is not self.scene and signature(scene) != self._signature:
            raise SceneError("a collision checker serves scenes with the same robot, static obstacles and objects only")
        if scene is not self.scene:
            self._world = (world or CollisionWorld.from_scene(scene)).with_padding(_NEAR)
        self.scene = scene
        for body in scene.objects:
            self._positions.put(body.name, body.position, body.quaternion)

    def accepts(self, motion: WholeBodyPath | Trajectory, step: float = STEP) -> bool:
        """Whether no penetration is deeper than `TOLERANCE`. See `deepest_penetration`."""
        return self.deepest_penetration(motion, step, TOLERANCE).penetration <= TOLERANCE

    def deepest_penetration(
        self, motion: WholeBodyPath | Trajectory, step: float = STEP, enough: float = np.inf
    ) -> PenetrationReport:
        """Find the deepest penetration of a motion.

        For an object that touches others when it is taken, only additional depth is reported. States are skipped where
        `unproved_states` proves a distance of at least `_NEAR`, there and half-way to the neighbouring states.

        Args:
            motion: a path, or a trajectory, whose phases give the held objects. A released object stays where it is.
            step: largest motion [m] of a point of the robot between two configurations.
            enough: depth [m] beyond which the check ends.
        """
        worst, world = PenetrationReport(0.0, ("", ""), np.zeros(len(self.scene.robot.drive_joints))), self._world
        segments = list(self._segments(motion))
        for states, held, ignore in segments:
            query = world.query(0.0, held, ignore)
            fine = self._refine(states, held, query.attached.reach, step)
            grips, before = self._grips(held), dict[tuple[int, int], float]()
            for geom in grips:
                self._let_collide(geom, _OTHER)
            ignored = {geom for name in self.scene.names_of(ignore) for geom in self._geoms[name]}
            for row in np.flatnonzero(unproved_states(query, fine)):
                if worst.penetration > enough:
                    break
                self._place(fine[row], held)
                before = self._depths(held) if row == 0 else before
                worst = self._worse(worst, fine[row], before, grips, ignored)
            if held is not None and states is not segments[-1][0]:
                # The object stays at its last pose from now on.
                self._place(fine[-1], held)
                (position, R), quaternion = self._held_pose(held, self._tcp), np.empty(4)
                mujoco.mju_mat2Quat(quaternion, R.ravel())
                self._positions.put(held.name, position, quaternion)
                world = world.with_body(self.scene.body(held.name).at(position, quaternion))
            for geom in grips:
                self._let_collide(geom, 0)
        self.move_to(self.scene)
        return worst

    def _grips(self, held: HeldObject | None) -> dict[int, set[int]]:
        """Geoms of held objects, each with the geoms of its gripper, which may touch it."""
        grips = {} if held is None else dict.fromkeys(self._geoms[held.name], self._gripper)
        for one in self.scene.aside:
            gripper = _gripper_geoms(self._model, self.scene.robot.using(one.arm))
            grips |= dict.fromkeys(self._geoms[one.held.name], gripper)
        return grips

    def _depths(self, held: HeldObject | None) -> dict[tuple[int, int], float]:
        """Depths [m] of a held object in others, in the last contacts, up to the overlap that a valid scene allows."""
        if held is None:
            return {}
        contact, geoms, depths = self._data.contact, self._geoms[held.name], dict[tuple[int, int], float]()
        for distance, (one, other) in zip(contact.dist, contact.geom.tolist(), strict=True):
            if one in geoms or other in geoms:
                depths[one, other] = max(depths.get((one, other), 0.0), -float(distance))
        return {pair: depth for pair, depth in depths.items() if 0.0 < depth <= OVERLAP}

    def _segments(
        self, motion: WholeBodyPath | Trajectory
    ) -> Iterator[tuple[NDArray[np.float64], HeldObject | None, int]]:
        """Parts of a motion with the same held object, or none, and the mask of ignored objects.

        The states of each part are whole-body configurations and finger positions (k, 12).
        """
        if not isinstance(motion, Trajectory):
            X = motion.configurations
            finger = self.scene.robot.finger_position(motion.opening)
            yield np.column_stack([X, np.full(len(X), finger)]), motion.held, motion.ignore
            return

        def kind(piece: Trajectory) -> tuple[bool, HeldObject | None]:
            return bool(piece.phases[0].held), piece.phases[0].touched

        for (is_held, touched), pieces in itertools.groupby(phases_of(motion), key=kind):
            states = np.vstack([piece.states for piece in pieces])
            between = () if touched is None or is_held else (touched.name,)
            yield states, touched if is_held else None, self.scene.mask(between)

    def _refine(
        self, states: NDArray[np.float64], held: HeldObject | None, reach: NDArray[np.float64], step: float
    ) -> NDArray[np.float64]:
        """Insert states (m, 12) at most `step` [m] apart for any point. Fingers stay at a held object's width."""
        if held is not None:
            width = self.scene.body(held.name).width_in_gripper(held.T_tcp_object)
            states = np.column_stack((states[:, :-1], states[:, -1].clip(self.scene.robot.finger_position(width))))
        parts = np.ceil(np.abs(np.diff(states, axis=0)) @ np.append(reach, 1.0) / step).astype(int)
        return interpolate(cut(np.maximum(parts, 1)), np.arange(len(states)), states)

    def _place(self, state: NDArray[np.float64], held: HeldObject | None) -> None:
        """Place the robot and its held objects, and find contacts."""
        self._positions.move(state)
        mujoco.mj_kinematics(self._model, self._data)
        if held is not None:
            self._place_held(held, self._tcp)
        for one in self.scene.aside:
            self._place_held(one.held, self._model.site(self.scene.robot.using(one.arm).tcp_site).id)
        mujoco.mj_collision(self._model, self._data)

    def _place_held(self, held: HeldObject, tcp: int) -> None:
        """Place an object in the gripper of this TCP site."""
        position, R = self._held_pose(held, tcp)
        for geom in self._geoms[held.name]:
            T = self._in_object[geom]
            self._geom_xpos[geom] = R @ T[:3, 3] + position
            self._geom_axes[geom] = R @ T[:3, :3]

    def _held_pose(self, held: HeldObject, tcp: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position (3,) and rotation (3, 3) in the world of an object in the gripper of this TCP site."""
        R = self._site_axes[tcp]
        return R @ held.T_tcp_object[:3, 3] + self._site_xpos[tcp], R @ held.T_tcp_object[:3, :3]

    def _let_collide(self, geom: int, bits: int) -> None:
        """Let a held object collide with others, or not. MuJoCo keeps the bits of geoms once more per body."""
        self._model.geom_conaffinity[geom] = self._model.body_conaffinity[self._model.geom_bodyid[geom]] = bits

    def _worse(
        self,
        worst: PenetrationReport,
        state: NDArray[np.float64],
        before: dict[tuple[int, int], float],
        grips: dict[int, set[int]],
        ignored: set[int],
    ) -> PenetrationReport:
        """The deeper one of a report and the last contacts, reduced by their depths `before`."""
        contact = self._data.contact
        for distance, (one, other) in zip(contact.dist.tolist(), contact.geom.tolist(), strict=True):
            depth = -distance - before.get((one, other), 0.0)
            is_grip = other in grips.get(one, ()) or one in grips.get(other, ())
            is_left_out = is_grip or {one, other} & ignored or frozenset((one, other)) in self._uncounted
            if depth > worst.penetration and not is_left_out:
                first, second = (
                    self._names.get(geom) or self._model.geom(geom).name.removeprefix(_OBSTACLE)
                    for geom in (one, other)
                )
                bodies = self._body_name(one, first), self._body_name(other, second)
                worst = PenetrationReport(depth, (first, second), state[:-1].copy(), bodies)
        return worst

    def _body_name(self, geom: int, name: str) -> str:
        """Name of the robot's body that a geom belongs to. Otherwise the geom's own `name`."""
        body = int(self._model.geom_bodyid[geom])
        return name if not body or geom in self._names else self._model.body(body).name


def signature(scene: Scene) -> tuple[object, ...]:
    """Data that a model is built from, except the poses of objects."""

    def of_solids(solids: Sequence[Solid]) -> tuple[object, ...]:
        return tuple(
            (one.name, one.shape, *(a.tobytes() for a in (one.position, one.half_extents, one.rotation, one.vertices)))
            for one in solids
        )

    objects = tuple((body.name, body.shape, *body.half_extents, of_solids(body.pieces)) for body in scene.objects)
    return scene.robot.name, scene.robot.arm_name, objects, of_solids(scene.static_obstacles)


def _gripper_geoms(model: mujoco.MjModel, robot: RobotSpec) -> set[int]:
    """Collision geoms of the active arm's last link: wrist, palm and fingers."""
    links = link_of_body(model, robot.drive_joints[3:])
    last = len(robot.chain) - 1
    return {geom for geom in robot.collision_geoms(model) if links[int(model.geom_bodyid[geom])] == last}
