"""Every blocker that the page names, checked by MuJoCo's own collision detection with the planner's geometry.

    python -m scripts.why_checked --json-file outputs/why_checked.json

For every grasp that the page calls blocked, the robot is placed there in a MuJoCo model of the scene, and the distance
from the named part of it to the named object is measured. A name is confirmed if that is no more than the distance that
the planner keeps from everything. What stands on the object is confirmed by their own distance, a place that is
occupied by the object put there, and furniture by the hand alone at the gripper pose.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import clutter_env  # noqa: F401  registers the environments
from assets.robots import FETCH
from clutter_env.reporting.progress import progress_bar
from irm.self_contact import link_of_body
from planners import Scene, Solution, solve, warmup
from planners.collision.world import PADDING
from planners.drawing.why import GraspAnswer, ObjectAnswer, why_grasps, why_places
from planners.grasping.arm_configurations import gripper_rotation
from planners.grasping.families import find_grasp_set
from planners.motion.mujoco_check import OBJECT, ModelPositions, scene_model
from planners.placing.locations import placement_grid, stand_at
from planners.placing.negative_goal_region import CELL_SIZE
from planners.placing.surfaces import MARGIN
from planners.scene import StaticObstacle
from planners.scene.cover import BACK, LEAST_LIFT, direction_out, distances_out, driven_out_of

Array = NDArray[np.float64]

_OFF = 0.001
"""[m] by which the shapes of the two models may differ, as in `planners.motion.mujoco_check`."""
_STEP = 0.005
"""[m] between positions on a way out."""
_ROUND = CELL_SIZE * math.sqrt(2)
"""[m] by which a cell of the support that an object touches may reach beyond it."""
_FAR = 0.5
"""[m] beyond which a distance is not measured."""
PLANNING_S = 20.0
"""[s] of a plan, whose candidate locations are checked too."""
PARTS = ("hand", "arm", "way out", "on it", "furniture", "place")
SCENES = (("", 15, "side", 30), ("", 25, "side", 30), ("", 40, "all", 20), ("shelf", 15, "all", 20))
"""Layout, objects, grasp set, number of scenes."""


@dataclass
class Tally:
    """Named blockers of one kind.

    Attributes:
        named: how many.
        touching: how many of them are touched.
        near: how many of them are not touched, but nearer than the planner keeps.
        farthest: [m] largest distance of the others, 0 without any.
        examples: of the others.
    """

    named: int = 0
    touching: int = 0
    near: int = 0
    farthest: float = 0.0
    examples: list[str] = field(default_factory=list)

    @property
    def refuted(self) -> int:
        """How many are not confirmed."""
        return self.named - self.touching - self.near

    def add(self, distance: float, example: str, kept: float = PADDING) -> None:
        """Count a blocker at this distance [m], for which a distance `kept` [m] is too near."""
        self.named += 1
        self.touching += distance <= 0.0
        self.near += 0.0 < distance <= kept + _OFF
        if distance > kept + _OFF:
            self.farthest = max(self.farthest, distance)
            self.examples = [*self.examples, example][:5]


class Checker:
    """The robot of a scene at grasps, in MuJoCo."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.model = scene, scene_model(scene)
        self.data = mujoco.MjData(self.model)
        self.positions = ModelPositions(self.model, scene, self.data.qpos)
        model, robot = self.model, scene.robot
        links = link_of_body(model, robot.drive_joints[3:])
        self.robot = list(robot.collision_geoms(model))
        last = len(robot.chain) - 1
        self.hand = [geom for geom in self.robot if links[int(model.geom_bodyid[geom])] == last]
        self.objects = {
            body.name: np.flatnonzero(model.geom_bodyid == model.body(OBJECT + body.name).id).tolist()
            for body in scene.objects
        }
        self.tcp = model.site(robot.tcp_site).id

    def place(self, one: GraspAnswer, away: Array | None = None) -> None:
        """Place the robot at a grasp, its base moved by `away` (2,) [m]."""
        assert one.grasp is not None
        base = one.grasp.base.copy()
        base[:2] += 0.0 if away is None else away
        finger = self.scene.robot.finger_position(one.opening)
        self.positions.move(np.array([*base, *one.grasp.q, finger]))
        mujoco.mj_kinematics(self.model, self.data)

    def place_hand(self, one: GraspAnswer) -> None:
        """Place the hand alone at a gripper pose; the rest of the robot stays where it is."""
        robot, state = self.scene.robot, self.scene.state
        self.positions.move(np.array([*state.base, *state.q, robot.finger_position(one.opening)]))
        mujoco.mj_kinematics(self.model, self.data)
        R, p = self.data.site_xmat[self.tcp].reshape(3, 3).copy(), self.data.site_xpos[self.tcp].copy()
        turn = gripper_rotation(one.pose[3], one.pose[4]) @ R.T
        for geom in self.hand:
            self.data.geom_xpos[geom] = turn @ (self.data.geom_xpos[geom] - p) + one.pose[:3]
            self.data.geom_xmat[geom] = (turn @ self.data.geom_xmat[geom].reshape(3, 3)).ravel()

    def distance(self, some: Iterable[int], others: Sequence[int]) -> float:
        """Smallest distance [m] of two groups of geoms, negative where they overlap."""
        pairs = ((one, other) for one in some for other in others)
        return min((mujoco.mj_geomDistance(self.model, self.data, a, b, _FAR, None) for a, b in pairs), default=_FAR)

    def on_the_way_out(self, name: str, one: GraspAnswer, other: str) -> float:
        """Smallest distance [m] of robot and object to another one at a grasp and on the straight drive out."""
        assert one.grasp is not None
        scene, body = self.scene, self.scene.body(name)
        support = driven_out_of(scene, body)
        direction = direction_out(support, one.grasp.base)
        back = -BACK * np.array([math.cos(one.pose[3]), math.sin(one.pose[3])])
        far = distances_out(support, [one.pose[:2] + back], direction)[0]
        ways = [back * share for share in np.arange(0.0, 1.0, _STEP / BACK)]
        ways += [back + direction * step for step in np.arange(0.0, far + _STEP, _STEP)]
        moving, start, least = self.objects[name], self.scene.body(other), math.inf
        for lift in (0.0, LEAST_LIFT):  # the robot rises: the other object sinks
            self.positions.put(other, start.position - [0.0, 0.0, lift], start.quaternion)
            for way in ways:
                self.positions.put(name, body.position + [*way, 0.0], body.quaternion)
                self.place(one, way)
                least = min(least, self.distance((*self.robot, *moving), self.objects[other]))
        self.positions.put(name, body.position, body.quaternion)
        self.positions.put(other, start.position, start.quaternion)
        return least


def check(scene: Scene, answers: Sequence[ObjectAnswer], tallies: dict[str, Tally]) -> None:
    """Add the named blockers of a scene to the tallies."""
    checker = Checker(scene)
    fixed = {one.name: [checker.model.geom(f"obstacle/{one.name}").id] for one in scene.static_obstacles}
    fixed["floor"] = [checker.model.geom("floor").id]
    for answer in answers:
        for one in answer.grasps:
            for blocker in one.blockers:
                geoms = checker.objects[blocker.name]
                if blocker.part == "on it":
                    distance = checker.distance(checker.objects[answer.name], geoms)
                elif blocker.part == "way out":
                    distance = checker.on_the_way_out(answer.name, one, blocker.name)
                else:
                    checker.place(one)
                    distance = checker.distance(checker.hand if blocker.part == "hand" else checker.robot, geoms)
                words = f"{blocker.name} for {answer.name} at {np.degrees(one.pose[3:]).round().tolist()}°"
                tallies[blocker.part].add(distance, words)
            for name in one.furniture:
                checker.place_hand(one)
                tallies["furniture"].add(checker.distance(checker.hand, fixed[name]), f"{name} for {answer.name}")


def check_places(plan: Solution, tally: Tally) -> None:
    """Add the objects that a plan's candidate locations are refused for, because something stands there."""
    puts = [action for action in plan.actions if action.surfaces]
    for put, answers in zip(puts, why_places(plan), strict=True):
        checker, body = Checker(put.scene), put.scene.body(put.target)
        places = np.concatenate([stand_places(surface.support) for surface in put.surfaces])
        for place, answer in zip(places, answers, strict=True):
            there = stand_at(body, place)
            checker.positions.put(body.name, there.position, there.quaternion)
            mujoco.mj_kinematics(checker.model, checker.data)
            for name in answer.standing:
                distance = checker.distance(checker.objects[body.name], checker.objects[name])
                tally.add(distance, f"{name} for {body.name} at {place.round(3).tolist()}", MARGIN + _ROUND)


def stand_places(support: StaticObstacle) -> Array:
    """Candidate locations (n, 3) [m] of a support."""
    places = placement_grid(support)
    return np.column_stack((places, np.full(len(places), support.top)))


def main(
    scenes: int = 100,
    seed: int = 58_000_000,
    json_file: Path | None = None,
) -> None:
    """Check the blockers of all grasps of all objects of random scenes.

    Args:
        scenes: number of scenes.
        seed: random seed of the first scene.
        json_file: file for the counts.
    """
    warmup()
    tallies = {part: Tally() for part in PARTS}
    states = Counter[str]()
    kinds = [kind for *kind, count in SCENES for _ in range(count)]
    step = max(len(kinds) // scenes, 1)
    for index in progress_bar(range(scenes)):
        layout, count, grasps = kinds[index * step % len(kinds)]
        env = gym.make(f"clutter_env/Retrieve-o{count}-v0", **({"layout": layout} if layout else {}))
        _, info = env.reset(seed=seed + index)
        inner = env.unwrapped
        scene = Scene.from_mujoco(inner.model, inner.data, FETCH)  # type: ignore[attr-defined]  # of this package
        answers = why_grasps(scene, find_grasp_set(grasps))
        for answer in answers:
            for one in answer.grasps:
                states["none" if one.grasp is None else "blocked" if one.blockers else "free"] += 1
        check(scene, answers, tallies)
        plan = solve(scene, info["target"], grasps=grasps, time_limit=PLANNING_S)
        if isinstance(plan, Solution):
            check_places(plan, tallies["place"])
        env.close()
    print(f"{sum(states.values())} grasps: {dict(states)}")
    for part, tally in tallies.items():
        print(
            f"{part}: {tally.named} named, {tally.touching} touched, {tally.near} nearer than is kept, "
            f"{tally.refuted} neither (up to {1000 * tally.farthest:.1f} mm) {tally.examples}"
        )
    if json_file is not None:
        json_file.write_text(json.dumps({name: asdict(tally) for name, tally in tallies.items()}, indent=1))


if __name__ == "__main__":
    tyro.cli(main)
