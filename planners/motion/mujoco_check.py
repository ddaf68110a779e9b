"""Paths and trajectories checked once more, by MuJoCo's own collision detection, self-collision included."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robot_reading import collision_geoms
from assets.robots import RobotSpec
from irm.chain import link_of_body
from planners.collision.scene_arrays import robot_arrays
from planners.motion.path import WholeBodyPath
from planners.motion.trajectory import Trajectory, phases_of
from planners.scene import HeldObject, Scene, SceneError, StaticObstacle

_ROBOT, _OTHER = 1, 2
"""Collision bits: the robot collides with itself and all other geoms; of these only held objects with others."""
_OTHER_BITS = {"contype": _OTHER, "conaffinity": 0}
OBJECT, _OBSTACLE = "object/", "obstacle/"
"""Prefixes of names in the model, so that an object or obstacle may have the name of a geom or joint of the robot."""
_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
TOLERANCE = 0.0005
"""[m] Penetration that an accepted path may have where it is checked; between the steps it may be as much again."""
STEP = 0.01
"""[m] that a point of the robot may move between two checks: past a cylinder of 25 mm radius 0.5 mm are missed."""


def scene_model(scene: Scene) -> mujoco.MjModel:
    """Robot, ground, static obstacles and free bodies for the objects, with the collision bits of this module."""
    spec = mujoco.MjSpec.from_file(str(scene.robot.mjcf_path))
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT, _ROBOT | _OTHER
    _exclude_neighbours(spec, scene)
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **_OTHER_BITS)
    for obstacle in scene.static_obstacles:
        _add_obstacle(spec, obstacle)
    for body in scene.objects:
        name, half = OBJECT + body.name, body.half_extents
        size = half if body.shape == "box" else [half[0], half[2], 0.0]
        added = spec.worldbody.add_body(name=name)
        added.add_freejoint(name=name)
        added.add_geom(name=name, type=_GEOMS[body.shape], size=size, **_OTHER_BITS)
    return spec.compile()


def _add_obstacle(spec: mujoco.MjSpec, obstacle: StaticObstacle) -> None:
    """Its true shape, whatever its contact bits were in the simulation that it was read from."""
    name, half, quaternion = _OBSTACLE + obstacle.name, obstacle.half_extents, np.empty(4)
    mujoco.mju_mat2Quat(quaternion, obstacle.rotation.ravel())
    shape: dict[str, object] = {"type": _GEOMS[obstacle.shape]}
    if obstacle.shape == "hull":
        spec.add_mesh(
            name=name, uservert=obstacle.vertices.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        )
        shape["meshname"] = name
    elif obstacle.shape == "capsule":
        shape["size"] = [half[0], half[2] - half[0], 0.0]
    elif obstacle.shape == "cylinder":
        shape["size"] = [half[0], half[2], 0.0]
    else:
        shape["size"] = half
    spec.worldbody.add_geom(name=name, pos=obstacle.position, quat=quaternion, **shape, **_OTHER_BITS)


def _exclude_neighbours(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Exclude contacts between bodies on the same link or on neighbouring links."""
    model = spec.compile()
    links = link_of_body(model, scene.robot)
    for first, second in itertools.combinations(range(1, model.nbody), 2):
        if abs(links[first] - links[second]) <= 1:
            spec.add_exclude(bodyname1=model.body(first).name, bodyname2=model.body(second).name)


class ModelPositions:
    """Positions of the joints, `qpos` (nq,), of a `scene_model`: they are set to those of a scene, then changed."""

    def __init__(self, model: mujoco.MjModel, scene: Scene, qpos: NDArray[np.float64]) -> None:
        robot, self.qpos = scene.robot, qpos
        self._columns = [int(model.joint(name).qposadr[0]) for name in (*robot.drive_joints, robot.finger_joints[0])]
        self._second_finger = int(model.joint(robot.finger_joints[1]).qposadr[0])
        self._start = {body.name: int(model.joint(OBJECT + body.name).qposadr[0]) for body in scene.objects}
        for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            qpos[model.joint(joint).qposadr[0]] = angle
        for body in scene.objects:
            self.put(body.name, body.position, body.quaternion)

    def move(self, state: NDArray[np.float64]) -> None:
        """Move the robot to a whole-body configuration and finger position (12,)."""
        self.qpos[self._columns] = state
        self.qpos[self._second_finger] = state[-1]

    def put(self, name: str, position: NDArray[np.float64], quaternion: NDArray[np.float64]) -> None:
        """Put an object at a pose."""
        start = self._start[name]
        self.qpos[start : start + 3] = position
        self.qpos[start + 3 : start + 7] = quaternion


class PenetrationReport(NamedTuple):
    """The deepest penetration of a motion.

    Attributes:
        penetration: its depth [m], 0 for none.
        pair: names of the two geoms.
        where: (11,) whole-body configuration in which it happens.
    """

    penetration: float
    pair: tuple[str, str]
    where: NDArray[np.float64]


class _Segment(NamedTuple):
    """A part of a motion with the same held object, or none."""

    states: NDArray[np.float64]  # (k, 12) whole-body configurations and finger position
    held: HeldObject | None
    ignore: int  # mask of objects that do not count


class MujocoCollisionChecker:
    """Checks motions in a MuJoCo model of a scene. The model is its own, not that of a simulation."""

    def __init__(self, scene: Scene) -> None:
        """Build the model; for the same objects elsewhere `move_to` is faster."""
        robot = scene.robot
        self.scene = scene
        self._model = model = scene_model(scene)
        self._data = mujoco.MjData(model)
        self._positions = ModelPositions(model, scene, self._data.qpos)
        self._tcp = model.site(robot.tcp_site).id
        self._gripper = _gripper_geoms(model, robot)
        self._geoms = {body.name: int(model.geom(OBJECT + body.name).id) for body in scene.objects}

    def move_to(self, scene: Scene) -> None:
        """Put the objects where another scene has them; raises `SceneError` if it differs in more than their poses."""
        if _signature(scene) != _signature(self.scene):
            raise SceneError("a collision checker serves scenes with the same robot, static obstacles and objects only")
        self.scene = scene
        for body in scene.objects:
            self._positions.put(body.name, body.position, body.quaternion)

    def accepts(self, motion: WholeBodyPath | Trajectory, step: float = STEP) -> bool:
        """Whether nothing penetrates deeper than `TOLERANCE`; see `deepest_penetration`."""
        return self.deepest_penetration(motion, step).penetration <= TOLERANCE

    def deepest_penetration(self, motion: WholeBodyPath | Trajectory, step: float = STEP) -> PenetrationReport:
        """The deepest penetration of a motion.

        Args:
            motion: a path, or a trajectory: its phases say what is held, and a released object stays where it is.
            step: [m] that a point of the robot may move between two checked configurations.
        """
        worst = PenetrationReport(0.0, ("", ""), np.zeros(len(self.scene.robot.drive_joints)))
        for segment in self._segments(motion):
            held_geom = -1 if segment.held is None else self._geoms[segment.held.name]
            ignored = {self._geoms[name] for name in self.scene.names_of(segment.ignore)}
            # The geoms of held objects, each with those of the gripper that holds it, which may touch it.
            grips = {} if held_geom < 0 else {held_geom: self._gripper}
            for one in self.scene.aside:
                grips[self._geoms[one.held.name]] = _gripper_geoms(self._model, self.scene.robot.using(one.arm))
            for geom in grips:
                self._let_collide(geom, _OTHER)
            for state in self._refine(segment, step):
                self._place(state, segment.held)
                worst = self._worse(worst, state, grips, ignored)
            if segment.held is not None:
                # From now on the object stays where it was placed last.
                geom, quaternion = self._geoms[segment.held.name], np.empty(4)
                mujoco.mju_mat2Quat(quaternion, self._data.geom_xmat[geom])
                self._positions.put(segment.held.name, self._data.geom_xpos[geom], quaternion)
            for geom in grips:
                self._let_collide(geom, 0)
        self.move_to(self.scene)
        return worst

    def _segments(self, motion: WholeBodyPath | Trajectory) -> Iterator[_Segment]:
        if not isinstance(motion, Trajectory):
            X = motion.configurations
            finger = self.scene.robot.finger_position(motion.opening)
            yield _Segment(np.column_stack([X, np.full(len(X), finger)]), motion.held, motion.ignore)
            return
        for piece in phases_of(motion):
            phase = piece.phases[0]
            held = phase.touched if phase.held else None
            between = () if phase.touched is None or phase.held else (phase.touched.name,)
            yield _Segment(piece.states, held, self.scene.mask(between))

    def _refine(self, segment: _Segment, step: float) -> NDArray[np.float64]:
        """States (m, 12) at most `step` [m] apart for any point of the robot; fingers stay at a held object's width."""
        robot, held, states = robot_arrays(self.scene.robot), segment.held, segment.states.copy()
        reach = robot.reach
        if held is not None:
            body = self.scene.body(held.name)
            states[:, -1] = states[:, -1].clip(
                self.scene.robot.finger_position(body.width_in_gripper(held.T_tcp_object))
            )
            swing = np.linalg.norm(held.T_tcp_object[:3, 3]) + np.linalg.norm(body.half_extents)
            reach = np.maximum(reach, robot.tip_reach + swing)
        parts = np.ceil(np.abs(np.diff(states, axis=0)) @ np.append(reach, 1.0) / step).astype(int)
        at = np.concatenate([[0.0], *(i + np.arange(1, max(n, 1) + 1) / max(n, 1) for i, n in enumerate(parts))])
        return np.column_stack([np.interp(at, np.arange(len(states)), column) for column in states.T])

    def _place(self, state: NDArray[np.float64], held: HeldObject | None) -> None:
        """Place the robot and what its grippers hold, and find contacts."""
        model, data = self._model, self._data
        self._positions.move(state)
        mujoco.mj_kinematics(model, data)
        if held is not None:
            self._place_held(held, self._tcp)
        for one in self.scene.aside:
            self._place_held(one.held, model.site(self.scene.robot.using(one.arm).tcp_site).id)
        mujoco.mj_collision(model, data)

    def _place_held(self, held: HeldObject, tcp: int) -> None:
        """Place an object in the gripper with this TCP site."""
        data, geom, R = self._data, self._geoms[held.name], self._data.site_xmat[tcp].reshape(3, 3)
        data.geom_xpos[geom] = data.site_xpos[tcp] + R @ held.T_tcp_object[:3, 3]
        data.geom_xmat[geom] = (R @ held.T_tcp_object[:3, :3]).ravel()

    def _let_collide(self, geom: int, bits: int) -> None:
        """Let a held object collide with others, or not; MuJoCo keeps the bits of geoms once more per body."""
        self._model.geom_conaffinity[geom] = bits
        self._model.body_conaffinity[self._model.geom_bodyid[geom]] = bits

    def _worse(
        self, worst: PenetrationReport, state: NDArray[np.float64], grips: dict[int, set[int]], ignored: set[int]
    ) -> PenetrationReport:
        """The deeper of a report and the contacts found last; a gripper may touch the object that it holds."""
        if self._data.ncon == 0:
            return worst
        contact = self._data.contact
        for distance, geoms in zip(contact.dist, contact.geom, strict=True):
            if -distance <= worst.penetration:
                continue
            pair = {int(geoms[0]), int(geoms[1])}
            is_grip = any(pair & grips[geom] for geom in pair & grips.keys())
            if not is_grip and not pair & ignored:
                names = (self._model.geom(geom).name for geom in geoms)
                first, second = (name.removeprefix(OBJECT).removeprefix(_OBSTACLE) for name in names)
                worst = PenetrationReport(-float(distance), (first, second), state[:-1].copy())
        return worst


def _signature(scene: Scene) -> tuple[object, ...]:
    """What a model is built from, poses of objects excepted."""
    objects = tuple((body.name, body.shape, *body.half_extents) for body in scene.objects)
    obstacles = tuple(
        (one.name, one.shape, *(a.tobytes() for a in (one.position, one.half_extents, one.rotation, one.vertices)))
        for one in scene.static_obstacles
    )
    return scene.robot.name, scene.robot.arm_name, objects, obstacles


def _gripper_geoms(model: mujoco.MjModel, robot: RobotSpec) -> set[int]:
    """The collision geoms of the active arm's last link: wrist, palm and fingers."""
    links = link_of_body(model, robot)
    last = len(robot.chain) - 1
    return {geom for geom in collision_geoms(model, robot) if links[int(model.geom_bodyid[geom])] == last}
