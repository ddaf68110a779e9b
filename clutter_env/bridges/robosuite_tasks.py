"""robosuite's tasks for one arm, solved through their own `step` and its default controller.

with Remote("venv-robosuite/bin/python", "robosuite_worker.py") as robosuite:
    task = RobosuiteTask(robosuite, "PickPlace", seed=0)
    expert = TampExpert(task.world, planner=task.planner)
    expert.reset()
    while not (expert.done or task.world.is_over):
        task.world.step(expert.act())
    print(expert.report, task.is_solved)

The default controller is that of `clutter_env.bridges.osc_task`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

import assets
from assets import RobotSpec
from clutter_env.bridges.kept import kept_mjcf
from clutter_env.bridges.osc_task import BESIDE, OscTask
from clutter_env.bridges.remote import BridgeError, Remote
from planners import (
    AntipodalFamily,
    ControlledWorld,
    FollowingPlanner,
    Goal,
    GraspFamily,
    Region,
    Scene,
    goals,
)

Array = NDArray[np.float64]

_STEPS = 10
"""Of the environment in which its gripper opens or closes all the way."""
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
can's compartment of PickPlace is out of reach, except for a tilted gripper that holds the can at its top, above the
walls.
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
"""By task: supports on which objects may be put, the first is the one where they stand, and the goal. None: nuts on
their pegs."""
_PEGS = {"SquareNut_main": "peg1", "RoundNut_main": "peg2"}
_AWAY = 2.0
"""[m] from the arm: a nut there has been cleared away."""
_ON_PEG = 0.03
"""[m] of the middle of a nut from the axis of its peg, along x and y."""


class RobosuiteTask(OscTask):
    """One episode of Lift, Stack or PickPlace (all four objects): a `Controller`, and the world to plan in.

    Attributes:
        world: for `TampExpert`, with the goal of the task.
        planner: for `TampExpert`: its plans are such that the arm can follow them.
        dt: [s] of one step.
        done: the time is up.
        is_solved: what the environment's own check said after the last step.
        steps: taken so far, of `horizon`.
    """

    def __init__(self, robosuite: Remote, id: str, seed: int, robot: str = "Panda") -> None:
        """Reset the environment.

        Raises:
            BridgeError: the task is none of those above, or robosuite does not have the robot, or it has another arm
                than a Panda's.
        """
        if id not in _TASKS:
            raise BridgeError(f"no goal is known for {id!r}; there are {', '.join(_TASKS)}")
        supports, goal = _TASKS[id]
        is_door, options = id.startswith("Door"), {}
        if is_door:
            id, options = "Door", {"use_latch": id == "Door"}
        start = robosuite("reset", id=id, robot=robot, seed=seed, options=options)
        x, y, z = start["base"]
        place = np.array([x - _ARM[0], y, 0.0]), z - _ARM[1]
        super().__init__(robosuite, start, _simple(start["xml"]), _panda(takes_thin=goal is None), place, _STEPS)
        self.horizon = start["horizon"]
        for _ in range(_SETTLE):
            self._step(np.zeros(6), 0.0)
        self._begin()
        self.planner = FollowingPlanner(
            self.robot,
            grasps=_BARS if is_door else GRASPS if goal else _HANDLES,
            controller=self.follower(start, robot),
            steps_left=lambda: self.horizon - self.steps,
        )
        model = self.model
        free = [model.joint(int(k)) for k in np.flatnonzero(model.jnt_type == 0)]
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
            line_tolerance=BESIDE,
        )
        if goal is None:
            self.world.goal = _on_pegs(self.world)
        if id == "PickPlace":
            self.world.regions = _compartments(self.world)


@cache
def _panda(takes_thin: bool) -> RobotSpec:
    """Our Panda on a base that stands. For thin objects it has the fingers of robosuite's hand, which are shorter."""
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
