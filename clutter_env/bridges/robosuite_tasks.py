"""robosuite's tasks for one arm, solved through their own `step` and its default controller.

with Remote("venv-robosuite/bin/python", "robosuite_worker.py") as robosuite:
    task = RobosuiteTask(robosuite, "PickPlace", seed=0)
    expert = TampExpert(task.world, planner=task.planner)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)

The action of the default controller moves the gripper: how the arm follows is the controller's to say. So the poses of
the TCP are played, and a plan may begin wherever the arm is.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import assets
from assets import RobotSpec
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.osc import Lead, OscFollower
from clutter_env.bridges.remote import BridgeError, Remote
from planners import (
    AntipodalFamily,
    ControlledWorld,
    FollowingPlanner,
    Goal,
    GraspFamily,
    Region,
    RobotState,
    Scene,
    goals,
    insert_robot,
    tcp_pose,
)

Array = NDArray[np.float64]

_OPENING = 0.08
"""[m] of the Panda's gripper."""
_STILL = 0.004
"""[m] by which the gripper's opening may differ from the one wanted, before it is moved."""
_STEPS = 10
"""Of the environment in which its gripper opens or closes all the way."""
_FINGERS = _OPENING / 2 / (0.05 * _STEPS)
"""[m/s] of one finger."""
_BESIDE = 0.01
"""[m] that the TCP may be behind on lines to and from an object: fingers 12 mm beside it come down on it else."""
GRASPS = tuple(
    GraspFamily(f"{pitch}°, {1000 * depth:.0f} mm deep", np.radians(pitch), depth=depth, shape=shape)
    for depth, shape, pitches in (
        (0.03, None, (90, 75)),
        (0.02, None, (90, 75, 70, 60, 50, 40)),
        (0.01, "cylinder", (90, 70, 60, 50)),
    )
    for pitch in pitches
)
"""Down and deep, where that is possible: the bread, round at its top, slips out of fingers that hold it there. The
can's compartment of PickPlace is out of reach, but for a tilted gripper that holds the can at its top, above the walls.
"""
_HANDLES = tuple(
    AntipodalFamily(f"handle, {pitch}°", np.radians(pitch), lever=(0.03, 0.1), max_width=0.04) for pitch in (90, 75, 60)
)
"""Of the nuts, which have handles of 32 mm."""
_ARM = (0.17, 0.5)
"""[m] x, z of our Panda's arm on its base, with the lift down."""
_COMPARTMENTS = {
    "Milk_main": (-0.1, -0.125, 0.09, 0.115),
    "Bread_main": (0.1, -0.125, 0.09, 0.115),
    "Cereal_main": (-0.1, 0.125, 0.09, 0.115),
    "Can_main": (0.055, 0.075, 0.045, 0.065),  # the part within reach
}
"""[m] x, y from the middle of PickPlace's second bin, and half extents, between walls: where each object is to be."""
_SHORTER = 0.0067
"""[m] by which the fingers of robosuite's hand reach less far than ours: to 2.3 mm beyond the TCP."""
_SAME = 0.02
"""[m] at most from the point that robosuite's controller moves to the TCP of our Panda."""
_SETTLE = 10
"""Steps in which objects come to rest: they begin above the table, and some in each other."""
_AJAR = 0.36
"""[rad] to which the door is pulled: it counts as open from 0.3, and goes to 0.4."""
_BARS = tuple(AntipodalFamily(f"bar, {pitch}°", np.radians(pitch), hangs=True) for pitch in (90, 60, 30, 0))
"""Of what opens."""
_TASKS: dict[str, tuple[tuple[str, ...], Goal | None]] = {
    "Lift": (("table",), goals.holding("cube_main")),
    "Stack": (("table",), goals.on("cubeA_main", "cubeB_main")),
    "PickPlace": (("bin1", "bin2"), goals.and_(*(goals.inside(name, f"for {name}") for name in _COMPARTMENTS))),
    "Door": (("table",), goals.open_("Door_door", amount=_AJAR)),
    "DoorWithoutLatch": (("table",), goals.open_("Door_door", amount=_AJAR)),
    **{f"NutAssembly{kind}": (("table",), None) for kind in ("", "Single", "Square", "Round")},
}
"""By task: on what objects may be put, the first is where they stand, and what is wanted; None: nuts on their pegs."""
_PEGS = {"SquareNut_main": "peg1", "RoundNut_main": "peg2"}
_AWAY = 2.0
"""[m] from the arm: a nut there has been cleared away."""
_ON_PEG = 0.03
"""[m] of the middle of a nut from the axis of its peg, along x and y."""


class RobosuiteTask:
    """One episode of Lift, Stack or PickPlace (all four objects): a `Controller`, and the world to plan in.

    Attributes:
        world: for `TampExpert`; its goal is that of the task.
        planner: for `TampExpert`: its plans are such that the arm can follow them.
        dt: [s] of one step.
        done: the time is up.
        is_solved: what the environment's own check said after the last step.
        steps: taken so far, of `horizon`.
    """

    dt = 0.05

    def __init__(self, robosuite: Remote, id: str, seed: int, robot: str = "Panda") -> None:
        """Reset the environment.

        Raises:
            BridgeError: the task is none of those above, or robosuite does not have the robot, or it has another arm
                than a Panda's.
        """
        if id not in _TASKS:
            raise BridgeError(f"no goal is known for {id!r}; there are {', '.join(_TASKS)}")
        self._robosuite, self.steps = robosuite, 0
        supports, goal = _TASKS[id]
        is_door, options = id.startswith("Door"), {}
        if is_door:
            id, options = "Door", {"use_latch": id == "Door"}
        start = robosuite("reset", id=id, robot=robot, seed=seed, options=options)
        x, y, z = start["base"]
        home = (z - _ARM[1], *start["home"])
        self.robot = replace(
            _panda(takes_thin=goal is None), home=home, plans_torso=False, max_finger_velocity=_FINGERS
        )
        self._base, self._lift = np.array([x - _ARM[0], y, 0.0]), home[:1]
        model = insert_robot(_simple(start["xml"]), self.robot, self._base, without=[start["root"]])
        joints = start["joints"]
        free = [model.joint(int(k)) for k in np.flatnonzero(model.jnt_type == 0)]
        self._objects = [(joints[joint.name], int(joint.qposadr[0])) for joint in free]
        hinges = [model.joint(int(k)) for k in np.flatnonzero(model.jnt_type != 0)]
        self._hinges = [(joints[one.name], int(one.qposadr[0])) for one in hinges if one.name in joints]
        self._arm = [joints[name] for name in start["arm"]]
        self._columns = [model.joint(name).qposadr[0] for name in self.robot.arm_joints]
        self._theirs = [joints[name] for name in start["fingers"]]
        self._fingers = [model.joint(name).qposadr[0] for name in self.robot.finger_joints]
        self._most, self._lag, self.horizon = np.array(start["most"]), start["lag"] / self.dt, start["horizon"]
        self._qpos = model.qpos0.copy()
        self._qpos[model.joint(self.robot.torso_joint).qposadr[0]] = home[0]
        self._read(start)
        for _ in range(_SETTLE):
            self._step(np.zeros(6), 0.0)
        self._commanded, self._lead = _OPENING / 2, Lead(self._tcp(), self._lag, self._most)
        self.planner = FollowingPlanner(
            self.robot,
            grasps=_BARS if is_door else GRASPS if goal else _HANDLES,
            controller=self._follower(start, robot),
            steps_left=lambda: self.horizon - self.steps,
        )
        near = [joint for joint in free if np.hypot(*(self.observe()[joint.qposadr[0] :][:2] - self._base[:2])) < _AWAY]
        movable = [model.body(int(joint.bodyid[0])).name for joint in near]
        self.world = ControlledWorld(
            self,
            model,
            self.robot,
            movable=movable,
            support=supports[0],
            more_supports=supports[1:],
            goal=goal,
            line_tolerance=_BESIDE,
        )
        if goal is None:
            self.world.goal = _on_pegs(self.world)
        if id == "PickPlace":
            self.world.regions = _compartments(self.world)

    def _follower(self, start: dict[str, Any], robot: str) -> OscFollower:
        """A model of the controller, with robosuite's own arm; raises `BridgeError` if that is no Panda's."""
        spec = mujoco.MjSpec.from_string(start["xml"])
        for body in spec.worldbody.bodies:
            if body.name != start["root"]:
                spec.delete(body)
        model = spec.compile()
        data = mujoco.MjData(model)
        for joint in (model.joint(number) for number in range(model.njnt)):
            data.qpos[joint.qposadr[0]] = self._state[start["joints"][joint.name]]
        mujoco.mj_kinematics(model, data)
        site, T_world_site = data.site(start["site"]), np.eye(4)
        T_world_site[:3, :3], T_world_site[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        T_site_tcp = np.linalg.inv(T_world_site) @ self._tcp()
        if np.linalg.norm(T_site_tcp[:3, 3]) > _SAME:
            raise BridgeError(f"the arm of robosuite's {robot!r} is not that of a Panda")
        return OscFollower(
            data,
            start["arm"],
            start["site"],
            np.array(start["elbow"]),
            self._base,
            T_site_tcp,
            lift=float(self._lift[0]),
            dt=self.dt,
            stiffness=start["stiffness"],
            lag=self._lag,
            most=self._most,
            strength=np.array(start["strength"]),
            line_tolerance=_BESIDE,
        )

    def _read(self, answer: dict[str, Any]) -> None:
        self._state = np.array(answer["qpos"])
        self._opening = float(np.ptp(self._state[self._theirs]))
        self.is_solved, self.done = answer["is_success"], answer["done"]

    def _tcp(self) -> Array:
        q = np.append(self._lift, self._state[self._arm])
        return tcp_pose(self.robot, RobotState(self._base, q, 0.0))

    def observe(self) -> Array:
        """(nq,) joint positions in our model."""
        for theirs, ours in self._objects:
            self._qpos[ours : ours + 7] = self._state[theirs : theirs + 7]
        for theirs, ours in self._hinges:
            self._qpos[ours] = self._state[theirs]
        self._qpos[self._columns] = self._state[self._arm]
        self._qpos[self._fingers] = self.robot.finger_position(self._opening)
        return self._qpos

    def act(self, configuration: Array, opening: float) -> None:
        """One step of the environment: towards a pose of the gripper, and ahead of it by as much as it stays behind."""
        wanted = tcp_pose(self.robot, RobotState(configuration[:3], configuration[3:], 0.0))
        self._step(self._lead.action(wanted, self._tcp()), self._grip(opening))

    def _step(self, action: Array, grip: float) -> None:
        self._read(self._robosuite("step", action=[*action, grip]))
        self.steps += 1

    def _grip(self, opening: float) -> float:
        """-1 opens the gripper by a tenth, 1 closes it, 0 leaves it; what is held is pressed."""
        holds = self._commanded == 0 and opening < self._opening + _STILL
        if opening < _STILL or holds:
            way = 1.0
        else:
            way = float(np.sign(self._commanded - opening)) if abs(self._commanded - opening) > _STILL else 0.0
        self._commanded = float(np.clip(self._commanded - way * _OPENING / _STEPS, 0.0, _OPENING))
        return way


@cache
def _panda(takes_thin: bool) -> RobotSpec:
    """Our Panda on a base that stands; for thin objects with the fingers of robosuite's hand, which are shorter."""
    robot = assets.robot("panda_mobile").fixed()
    if not takes_thin:
        return robot
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for name in robot.finger_joints:
        spec.joint(name).parent.pos[2] -= _SHORTER
    spec.compile()
    return replace(robot, mjcf=str(kept_mjcf("panda-robosuite", spec.to_xml())))


def _simple(xml: str) -> mujoco.MjSpec:
    """A scene in which a movable mesh is the box around it, a can a cylinder: how deep grasps are can then be said."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.compiler.fitaabb = True
    for body in spec.bodies:
        if any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints):
            for geom in (one for one in body.geoms if one.type == mujoco.mjtGeom.mjGEOM_MESH):
                is_round = body.name.startswith("Can")
                geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER if is_round else mujoco.mjtGeom.mjGEOM_BOX
    return spec


def _scene(world: ControlledWorld) -> Scene:
    return Scene.from_mujoco(
        world.model,
        world.data,
        world.robot,
        movable=world.object_names,
        support=world.support_name,
        more_supports=world.more_supports,
    )


def _on_pegs(world: ControlledWorld) -> Goal:
    """Each nut with its hole around its peg and its handle towards the arm, where the hand is away from the peg."""
    places = []
    for body in _scene(world).objects:
        turned = world.data.body(body.name)  # the hole is about the origin of a nut
        middle = turned.xmat.reshape(3, 3).T @ (body.position - turned.xpos)
        x, y = world.data.body(_PEGS[body.name]).xpos[:2] - middle[:2]
        places.append(goals.at(body.name, (x, y, np.pi), tolerance=_ON_PEG))
    return goals.and_(*places)


def _compartments(world: ControlledWorld) -> tuple[Region, ...]:
    x, y = world.model.body("bin2").pos[:2]
    scene = _scene(world)
    return tuple(
        Region(f"for {name}", scene.supports[1], (x + away[0], y + away[1]), away[2:])
        for name, away in _COMPARTMENTS.items()
    )
