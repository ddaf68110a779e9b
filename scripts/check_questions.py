"""The answers to questions about scenes beside an exhaustive check that shares no search with them.

    python -m scripts.check_questions --scenes 700
    python -m scripts.check_questions --scenes 60 --sampled

Which objects must be moved: all orders of taking objects away are tried, shortest first, and the scene that is left
after each is scanned anew for free grasps, from each of the 24 directions alone, with more base poses than the planner
looks at. A free grasp is tried in MuJoCo: the robot is put there with its gripper open, and may touch nothing.
With --sampled the grasps are sampled in MuJoCo instead, see `scripts.sampled_grasps`.
What is touched: points all over each object, against the bar. What falls: the object is put elsewhere in the
simulation, and one second passes.
"""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import tyro

from clutter_env.evaluation.question_balance import Asked, balanced
from clutter_env.evaluation.question_files import asked, scenes as drawn_scenes
from clutter_env.evaluation.questions import BAR, Asker, Question
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import markdown_table
from planners import Scene
from planners.grasping.candidates import GraspCandidate
from planners.grasping.families import SIDE
from planners.workspace import Workspace

DEGREES = tuple((index * 360 // 24 + 180) % 360 - 180 for index in range(24))
"""Directions of the gripper."""
_FALLEN = 0.02
"""[m] An object that ends lower by more than this has fallen."""
_SAME = 0.01
"""[rad] Yaws nearer than this are one direction."""
_POINTS = 200
"""Around an object's outline."""
_AWAY = 50.0
"""[m] to where an object is put that is taken away."""
_SECOND = 500
"""Physics steps."""


@dataclass
class Checker:
    """Checks questions of the scenes of one environment.

    Attributes:
        env: that has been reset to the scene.
    """

    env: gym.Env[Any, Any]
    _workspaces: dict[int, Workspace] = field(default_factory=dict)

    def wrong(self, scene: Scene, questions: list[Question]) -> Iterator[tuple[Question, object]]:
        """The questions whose answer is another one, with what it is."""
        for question in questions:
            found = self._answer(scene, question)
            if found != question.answer:
                yield question, found

    def _answer(self, scene: Scene, question: Question) -> object:
        name = question.about
        match question.kind:
            case "taken now":
                return self._free(scene, name)
            case "fewest":
                return self._smallest(scene, name)[0]
            case "which":
                _, sets = self._smallest(scene, name)
                return tuple(sorted(next(iter(sets)))) if len(sets) == 1 else sets
            case "from where":
                return tuple(sorted(set(self._sides(scene, name))))
            case "touched":
                return tuple(sorted(one for one in scene.names if one != name and _is_touched(scene, name, one)))
            case _:
                return self._fallen(name)

    def _smallest(self, scene: Scene, name: str) -> tuple[int | None, set[frozenset[str]]]:
        """The fewest objects that are taken away before one can be taken, and all sets of so many."""
        states: set[frozenset[str]] = {frozenset()}
        for fewest in count():
            left = {state: _without(scene, state) for state in states}
            if done := {state for state, rest in left.items() if self._free(rest, name)}:
                return fewest, done
            states = {
                state | {other}
                for state, rest in left.items()
                for other in rest.names
                if other != name and self._free(rest, other)
            }
            if not states:
                return None, set()
        raise AssertionError("there are finitely many objects")

    def _free(self, scene: Scene, name: str) -> bool:
        """Whether there is a free grasp of an object, by scans of this scene alone, one for each direction."""
        return any(self._is_free_from(scene, name, degrees) for degrees in DEGREES)

    def _sides(self, scene: Scene, name: str) -> Iterator[str]:
        """The side of each direction from which there is a free grasp."""
        for degrees in DEGREES:
            if self._is_free_from(scene, name, degrees):
                across = 50 < abs(degrees) < 130
                yield ("right" if degrees > 0 else "left") if across else "front" if abs(degrees) < 90 else "behind"

    def _is_free_from(self, scene: Scene, name: str, degrees: int) -> bool:
        if degrees not in self._workspaces:
            yaw = np.deg2rad(degrees)
            alone = replace(SIDE, name=f"{degrees}°", yaws=(yaw - _SAME, yaw + _SAME))
            self._workspaces[degrees] = Workspace.of(scene.robot, scene, grasps=(alone,))
        grasps = self._workspaces[degrees].grasps().for_object(scene, name)
        return any(self._touches_nothing(scene, grasp) for grasp in grasps if not grasp.blockers)

    def _touches_nothing(self, scene: Scene, grasp: GraspCandidate) -> bool:
        """Whether the robot at a grasp, its fingers open, touches no object of the scene in MuJoCo."""
        inner: Any = self.env.unwrapped
        model, index = inner.model, inner.world.index
        data = mujoco.MjData(model)
        data.qpos[:] = inner.data.qpos
        data.qpos[index.drive_qpos] = (*grasp.base, *grasp.q)
        data.qpos[index.finger_qpos] = (grasp.opening - scene.robot.finger_gap_closed) / 2
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        base = model.body_rootid[index.base_body]
        objects = {model.body(name).id for name in scene.names}
        for one, other in (model.geom_bodyid[pair] for pair in data.contact.geom):
            if len({one, other} & objects) == 1 and base in (model.body_rootid[one], model.body_rootid[other]):
                return False
        return True

    def _fallen(self, name: str) -> tuple[str, ...]:
        """What is lower a second after an object has been put far away."""
        inner: Any = self.env.unwrapped
        model = copy.copy(inner.model)
        model.opt.enableflags &= ~int(
            mujoco.mjtEnableBit.mjENBL_SLEEP
        )  # what stands still would stay, whatever is under it
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[:] = inner.data.qpos, inner.data.ctrl
        mujoco.mj_forward(model, data)
        before = {one: float(data.body(one).xpos[2]) for one in inner.world.names}
        place = int(model.body(name).jntadr[0])
        data.qpos[model.jnt_qposadr[place]] += _AWAY
        for _ in range(_SECOND):
            mujoco.mj_step(model, data)
        lower = {one for one, height in before.items() if data.body(one).xpos[2] < height - _FALLEN}
        return tuple(sorted(lower - {name}))


def _without(scene: Scene, names: frozenset[str]) -> Scene:
    """The scene without some objects."""
    return replace(scene, objects=tuple(body for body in scene.objects if body.name not in names))


def _is_touched(scene: Scene, name: str, other: str) -> bool:
    """Whether a point of a cylinder's outline, or of a smaller circle about its axis, is in the bar."""
    tip, body = scene.body(name).position, scene.body(other)
    angles = np.linspace(0.0, 2 * np.pi, _POINTS, endpoint=False)
    radii = np.linspace(0.0, body.half_extents[0], 30)
    points = body.position[:2] + (radii[:, None, None] * np.stack((np.cos(angles), np.sin(angles)), -1)).reshape(-1, 2)
    return bool(((points[:, 0] <= tip[0]) & (np.abs(points[:, 1] - tip[1]) <= BAR / 2)).any())


def main(scenes: int = 700, objects: int = 6, first_seed: int = 20_000_000, sampled: bool = False) -> int:
    """Ask about scenes, check every answer, and print how many are wrong, by kind.

    Args:
        scenes: Number of scenes.
        objects: In each; with more than 6 the check takes long.
        first_seed: Seed of the first scene.
        sampled: Sample the grasps in MuJoCo, without the planner.
    """
    from scripts.sampled_grasps import SampledChecker

    every = list[Asked]()
    found, wrong, spent = Counter[str](), Counter[str](), {"asked": 0.0, "checked": 0.0}
    parts: dict[str, tuple[gym.Env[Any, Any], Asker, Checker]] = {}
    with progress_bar(total=scenes, unit="scene") as bar:
        for kind, seed in drawn_scenes(objects, scenes, first_seed):
            if kind.env_id not in parts:
                env = gym.make(kind.env_id, **kind.keywords)
                parts[kind.env_id] = env, Asker(), (SampledChecker if sampled else Checker)(env)
                asked(env, kind, seed, parts[kind.env_id][1])  # kernels are loaded once
            env, asker, checker = parts[kind.env_id]
            started = time.process_time()
            scene, target, questions, _ = asked(env, kind, seed, asker)
            spent["asked"] += time.process_time() - started
            started = time.process_time()
            found.update(question.kind for question in questions)
            every += [Asked(one, one.about == target, scene.body(one.about).position) for one in questions]
            for question, answer in checker.wrong(scene, questions):
                wrong[question.kind] += 1
                print(f"{kind.env_id}, seed {seed}: {question.text} {question.answer}, and by the check {answer}")
            spent["checked"] += time.process_time() - started
            bar.update()
    rows = [[kind, str(number), str(wrong[kind])] for kind, number in found.items()]
    print(markdown_table(["kind", "questions", "wrong"], [*rows, ["all", str(found.total()), str(wrong.total())]]))
    kept = len(balanced(every, np.random.default_rng(first_seed)))
    print(f"{kept} of them are asked, so that colour, place and kind do not give the answer away")
    print(", ".join(f"{name} in {seconds / scenes:.3f} CPU s a scene" for name, seconds in spent.items()))
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main, description=__doc__))
