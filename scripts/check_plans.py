"""Replay plans in a MuJoCo model of their own, at a tenth of the planner's step, and print the deepest penetration.

    python scripts/check_plans.py --layout shelf --objects 16 --grasps all --plans 20
    python scripts/check_plans.py --task stack --objects 8 --grasps all --plans 20
    python scripts/check_plans.py --object-set household --grasps all --plans 20

Scenes are resets of the environment from --seed on; with --task, of Rearrange, whose own goal is planned for. The
planner's own check is not used: this model has other contact bits, it begins with the poses of the first scene alone,
and it carries each object rigidly from where the object stands when the gripper takes it. What the planner says about
later scenes, grasp transforms or excluded links is not read.
Furniture must be boxes, as in all layouts.

Two more things are checked. The plan says of nothing that it has moved but of what its gripper has carried. And where
the replay ends, the objects are put into the environment's physics: nothing falls or slides, and the environment says
that the goal is reached; of a target, that the gripper has raised it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.envs.rearrange import RearrangeEnv
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.progress import progress_bar
from planners import BoundAction, Infeasible, Scene, Solution, solve
from planners.goals import LIFTED
from planners.motion.trajectory import Phase

TOLERANCE = 0.001
"""[m] Penetration that a plan may have."""
STEP = 0.0006
"""[m] that a geom may move between two replayed states: a tenth of the step of the planner's collision checks."""

CREEP = 0.005
"""[m] that an object may move in physics where the plan leaves it, and between what plan and replay say."""
SETTLE_STEPS = 20
"""Control steps, one second, in which the end of a plan is watched."""

_ROBOT, _AT_REST, _HELD = 1, 2, 4
"""Contact bits: the robot touches itself and what is at rest, the held object touches both."""
_MARGIN = 0.03
"""[m] Distance up to which MuJoCo reports pairs of geoms; where the nearest is farther, states are left out."""
_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
"""By the shape of a convex piece."""
_OBJECT = "object/"
"""Prefix of the names of objects in the model; the robot may have geoms of the same names."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    task: str = ""
    """Task of Rearrange; not given: retrieval."""
    robot: str = "fetch"
    """Name of the robot, which acts with one arm."""
    objects: int = 15
    """Number of objects, the target among them."""
    layout: str = ""
    """Layout of the table; that of the task, and "paper" for retrieval, if not given."""
    object_set: str = ""
    """Sizes or kinds of the objects; those of the task, and "standard" for retrieval, if not given."""
    grasps: Literal["side", "tilted", "top", "all"] = "side"
    """Grasp set of the plans."""
    obstructed: bool = False
    """Leave out scenes in which a level gripper takes the target at once."""
    plans: int = 40
    """Plans to replay; scenes without a plan are counted apart."""
    seed: int = 400_000
    """First seed of the scenes."""
    time_limit: float = 60.0
    """[s] of wall time for one solve."""


def main(arguments: Arguments) -> None:
    """Solve, replay, report."""
    env = _environment(arguments)
    found: dict[int, DeepestContact] = {}
    wrong: dict[int, str] = {}
    actions = clearances = without = 0
    with progress_bar(desc="plans", total=arguments.plans) as bar:
        for seed in itertools.count(arguments.seed):
            if len(found) == arguments.plans:
                break
            env.reset(seed=seed)
            regions, goal = (env.regions, env.goal) if isinstance(env, RearrangeEnv) else ((), env.target)
            scene = Scene.from_mujoco(env.model, env.data, env.robot, regions=regions)
            plan = solve(scene, goal, time_limit=arguments.time_limit, grasps=arguments.grasps)
            if isinstance(plan, Infeasible):
                without += 1
                continue
            replay = PlanReplay(scene)
            found[seed], moved = DeepestContact(), 0.0
            for action in plan.actions:
                moved = max(moved, replay.farthest_from(action.scene))
                found[seed] = max(found[seed], replay.deepest_contact([action]))
            problem = f"moves {1e3 * moved:.1f} mm what is not carried" if moved > CREEP else ""
            if problem := problem or end_problem(env, plan, replay):
                wrong[seed] = problem
            actions, clearances = actions + len(plan.actions), clearances + len(plan.clearances)
            bar.update()
    env.close()
    deep = {seed: contact for seed, contact in found.items() if contact.depth > TOLERANCE}
    worst = max(found.values(), default=DeepestContact())
    print(
        f"{arguments.task or 'retrieval'}, {env.layout.name}, {arguments.robot}, {arguments.objects} objects, "
        f"{arguments.grasps}: {len(found)} plans, {actions} actions, {clearances} clearances, {without} scenes without "
        f"a plan; deepest {worst}; over {1e3 * TOLERANCE:.0f} mm: {len(deep)}; wrong ends or moves: {len(wrong)}"
    )
    for seed, contact in deep.items():
        print(f"  seed {seed}: {contact}")
    for seed, problem in wrong.items():
        print(f"  seed {seed}: {problem}")


def _environment(arguments: Arguments) -> RearrangeEnv | RetrieveEnv:
    keywords: dict[str, Any] = {"num_objects": arguments.objects, "robot": arguments.robot}
    if arguments.layout:
        keywords["layout"] = arguments.layout
    if arguments.object_set:
        keywords["object_set"] = arguments.object_set
    if arguments.task:
        return RearrangeEnv(task=arguments.task, **keywords)
    return RetrieveEnv(obstructed=arguments.obstructed, **keywords)


def end_problem(env: RearrangeEnv | RetrieveEnv, plan: Solution, replay: PlanReplay) -> str:
    """What is wrong with the end of a replay, "" if nothing is; the environment is where it was when it was reset."""
    target = plan.target
    if target:
        held = plan.actions[-1].trajectory.phases[-1].held if plan.actions else ""
        raised = replay.position(target)[2] - env.data.body(target).xpos[2]
        if held != target or raised < LIFTED:
            return f"{target} is raised by {1e3 * raised:.0f} mm, in the gripper is {held or 'nothing'}"
    for name in set(env.object_names) - {target}:  # nothing can have taken the place where the target stood
        env.data.joint(f"{name}_joint").qpos = replay.pose(name)
    mujoco.mj_forward(env.model, env.data)
    there = {name: env.data.body(name).xpos.copy() for name in env.object_names}
    for _ in range(SETTLE_STEPS):
        info = env.step(np.zeros(env.action_size))[-1]
    slid, name = max((float(np.linalg.norm(env.data.body(one).xpos - there[one])), one) for one in there)
    if slid > CREEP:
        return f"{name} slides or falls by {1e3 * slid:.0f} mm at the end"
    return "" if target or info["lifted"] else f"the goal is not reached: {info['unmet']} facts do not hold"


class DeepestContact(NamedTuple):
    """Where the replay of a plan penetrates deepest.

    Attributes:
        depth: [m], 0 for no penetration.
        geoms: names of the two geoms.
        action: the action of the plan.
        phase: name of the phase of its trajectory.
    """

    depth: float = 0.0
    geoms: tuple[str, str] = ("", "")
    action: str = ""
    phase: str = ""

    def __str__(self) -> str:
        where = f" ({' and '.join(self.geoms)}, {self.action}, {self.phase})" if self.depth else ""
        return f"{1e3 * self.depth:.3f} mm{where}"


class PlanReplay:
    """A model of a scene in which trajectories are replayed one after another.

    Two kinds of contact do not count: fingers with the object that the phase says they touch (they are commanded to
    close completely), and parts of the robot that penetrate in its home configuration.
    """

    def __init__(self, scene: Scene) -> None:
        """Build the model.

        Raises:
            ValueError: a static obstacle is no box.
        """
        robot = scene.robot
        self._model = _build(scene)
        self._data = mujoco.MjData(self._model)
        joints = (*robot.drive_joints, *robot.finger_joints)
        self._columns = np.array([self._model.joint(name).qposadr[0] for name in joints])
        self._fingers = {int(self._model.joint(name).bodyid[0]) for name in robot.finger_joints}
        self._tcp = self._data.site(robot.tcp_site)
        self._held, self._T_tcp_object, self._least_finger = "", np.eye(4), 0.0
        self._scene = scene
        for joint, angle in zip(robot.still_joints, robot.still_configuration, strict=True):
            self._data.joint(joint).qpos = angle
        for body in scene.objects:
            self._data.joint(_OBJECT + body.name).qpos = [*body.position, *body.quaternion]
        self._place(np.array([*scene.state.base, *robot.home, 0.0]))
        self._touching_at_home = {
            frozenset(geoms)
            for distance, *geoms in self._contacts()
            if distance < 0.0 and all(self._model.geom_contype[geom] == _ROBOT for geom in geoms)
        }
        if scene.held is not None:
            self._place(np.array([*scene.state.base, *scene.state.q, scene.state.finger_position]))
            self._data.joint(_OBJECT + scene.held.name).qpos = _as_qpos(self._tcp_pose @ scene.held.T_tcp_object)
            self._take(scene.held.name)

    def deepest_contact(self, actions: Iterable[BoundAction], step: float = STEP) -> DeepestContact:
        """Replay actions from where the last ones ended.

        Args:
            actions: of a plan, in order.
            step: [m] that a geom may move between two states. States are left out where the geoms are so far apart
                that none of them can be reached.
        """
        worst = DeepestContact()
        for action in actions:
            trajectory = action.trajectory
            states, times = trajectory.states, trajectory.times
            for i in range(len(times) - 1):
                phase = trajectory.phase((times[i] + times[i + 1]) / 2)
                self._change_grip(states[i], phase.held)
                part, parts = 0, self._parts(states[i], states[i + 1], step)
                while part <= parts:
                    self._place(states[i] + part / parts * (states[i + 1] - states[i]))
                    distance, geoms = self._nearest(phase)
                    if -distance > worst.depth:
                        worst = DeepestContact(-distance, geoms, str(action), phase.name)
                    part += max(1, int(distance / (2 * step)))
        return worst

    def pose(self, name: str) -> Array:
        """Position [m] and quaternion (7,) of an object now."""
        return np.array(self._data.joint(_OBJECT + name).qpos)

    def position(self, name: str) -> Array:
        """Position (3,) [m] of an object now."""
        return self.pose(name)[:3]

    def farthest_from(self, scene: Scene) -> float:
        """[m] between where an object stands now and where it stands in a scene, at most; of those not in a gripper."""
        standing = [body for body in scene.objects if body.name not in (self._held, *scene.held_names)]
        return max((float(np.linalg.norm(body.position - self.position(body.name))) for body in standing), default=0.0)

    def _change_grip(self, state: Array, held: str) -> None:
        """Take what is held from now on where it stands, leave what is no longer held where it is."""
        if held == self._held:
            return
        self._place(state)
        if self._held:
            self._set_bits(self._held, _AT_REST, 0)
            self._held, self._least_finger = "", 0.0
        if held:
            self._take(held)

    def _take(self, name: str) -> None:
        mujoco.mj_kinematics(self._model, self._data)
        body, T_world_object = self._data.body(_OBJECT + name), np.eye(4)
        T_world_object[:3, :3], T_world_object[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        self._held, self._T_tcp_object = name, np.linalg.inv(self._tcp_pose) @ T_world_object
        self._set_bits(name, _HELD, _ROBOT | _AT_REST)
        robot, width = self._scene.robot, self._scene.body(name).width_in_gripper(self._T_tcp_object)
        self._least_finger = robot.finger_position(width)

    def _set_bits(self, name: str, contype: int, conaffinity: int) -> None:
        """Of an object; MuJoCo keeps the bits of geoms once more for each body."""
        body = self._model.body(_OBJECT + name).id
        geoms = slice(self._model.body_geomadr[body], self._model.body_geomadr[body] + self._model.body_geomnum[body])
        for of, i in (("geom", geoms), ("body", body)):
            getattr(self._model, f"{of}_contype")[i] = contype
            getattr(self._model, f"{of}_conaffinity")[i] = conaffinity

    @property
    def _tcp_pose(self) -> Array:
        T_world_tcp = np.eye(4)
        T_world_tcp[:3, :3], T_world_tcp[:3, 3] = self._tcp.xmat.reshape(3, 3), self._tcp.xpos
        return T_world_tcp

    def _place(self, state: Array) -> None:
        """The robot in a state (12,), and the held object with it; fingers that press on it stay at its width."""
        finger = max(state[-1], self._least_finger)
        self._data.qpos[self._columns] = [*state[:-1], finger, finger]
        mujoco.mj_kinematics(self._model, self._data)
        if self._held:
            self._data.joint(_OBJECT + self._held).qpos = _as_qpos(self._tcp_pose @ self._T_tcp_object)
            mujoco.mj_kinematics(self._model, self._data)

    def _parts(self, start: Array, end: Array, step: float) -> int:
        """Parts of a straight motion in which no point of a geom moves more than `step` [m], nor the fingers."""
        positions, rotations = [], []
        for state in (start, end):
            self._place(state)
            positions.append(self._data.geom_xpos.copy())
            rotations.append(self._data.geom_xmat.reshape(-1, 3, 3).copy())
        cosines = (np.einsum("nij,nij->n", *rotations) - 1) / 2
        radii = self._model.geom_rbound
        moved = np.linalg.norm(positions[1] - positions[0], axis=1) + radii * np.arccos(np.clip(cosines, -1.0, 1.0))
        return max(1, int(np.ceil(moved.max() / step)))

    def _contacts(self) -> list[tuple[float, int, int]]:
        """Distance [m], negative for penetrations, and geoms of all pairs that are nearer than `_MARGIN`."""
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return []
        found = zip(self._data.contact.dist, self._data.contact.geom, strict=True)
        return [(float(distance), int(a), int(b)) for distance, (a, b) in found]

    def _nearest(self, phase: Phase) -> tuple[float, tuple[str, str]]:
        """The least distance [m] between geoms whose contact counts, `_MARGIN` at most, and their names."""
        touched = -1 if phase.touched is None else int(self._model.body(_OBJECT + phase.touched.name).id)
        nearest, pair = _MARGIN, (-1, -1)
        for distance, *geoms in self._contacts():
            bodies = {int(self._model.geom_bodyid[geom]) for geom in geoms}
            is_grip = touched in bodies and bool(bodies & self._fingers)
            if distance < nearest and not is_grip and frozenset(geoms) not in self._touching_at_home:
                nearest, pair = distance, (geoms[0], geoms[1])
        if nearest >= 0.0:
            return nearest, ("", "")
        first, second = (self._model.geom(geom).name.removeprefix(_OBJECT) for geom in pair)
        return nearest, (first, second)


def _build(scene: Scene) -> mujoco.MjModel:
    """The robot, a floor, boxes for the furniture, and a free body for each object."""
    spec = mujoco.MjSpec.from_file(str(scene.robot.mjcf_path))
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT, _ROBOT | _AT_REST
    at_rest = {"contype": _AT_REST, "conaffinity": 0}
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **at_rest)
    for obstacle in scene.static_obstacles:
        if obstacle.shape != "box":
            raise ValueError(f"furniture must be boxes to be replayed; {obstacle.name!r} is a {obstacle.shape}")
        box, quaternion = mujoco.mjtGeom.mjGEOM_BOX, np.empty(4)
        mujoco.mju_mat2Quat(quaternion, obstacle.rotation.ravel())
        spec.worldbody.add_geom(
            name=obstacle.name, type=box, pos=obstacle.position, quat=quaternion, size=obstacle.half_extents, **at_rest
        )
    for body in scene.objects:
        is_box, (x, y, z) = body.shape == "box", body.half_extents
        kind = mujoco.mjtGeom.mjGEOM_BOX if is_box else mujoco.mjtGeom.mjGEOM_CYLINDER
        added = spec.worldbody.add_body(name=_OBJECT + body.name)
        added.add_freejoint(name=_OBJECT + body.name)
        if body.shape != "pieces":
            added.add_geom(name=_OBJECT + body.name, type=kind, size=[x, y, z] if is_box else [x, z, 0.0], **at_rest)
        for index, piece in enumerate(body.pieces):
            (x, y, z), quaternion, name = piece.half_extents, np.empty(4), f"{_OBJECT}{body.name}/{index}"
            mujoco.mju_mat2Quat(quaternion, piece.rotation.ravel())
            shape: dict[str, Any] = {"type": _GEOMS[piece.shape], "pos": piece.position, "quat": quaternion}
            if piece.shape == "hull":
                spec.add_mesh(name=name, uservert=piece.vertices.ravel())
                shape["meshname"] = name
            else:
                sizes = {"cylinder": [x, z, 0.0], "capsule": [x, z - x, 0.0]}
                shape["size"] = sizes.get(piece.shape, [x, y, z])
            added.add_geom(name=name, **shape, **at_rest)
    for geom in spec.geoms:
        geom.margin = _MARGIN
    return spec.compile()


def _as_qpos(T: Array) -> Array:
    """Position and quaternion (7,) of a pose."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(T[:3, :3]).ravel())
    return np.concatenate([T[:3, 3], quaternion])


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
