"""Things that go wrong while something is opened: what the expert makes of them.

    python scripts/opening_faults.py --fault shut --scenes 30

Faults: "shut" (somebody shuts the drawer once, when it is open and let go), "slippery" (the handle has friction
0.2), "jams" (it stops at half of its range, always). The expert knows none of them before. A row says whether the
target was taken, by the environment's own rule, or what the expert said in the end.
"""

from __future__ import annotations

import copy
from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import gymnasium
import mujoco
import numpy as np
import tyro

import clutter_env  # noqa: F401  registers the environments
from planners import TampExpert

_STEPS = 4000
"""Control steps of an episode at most."""
_PUSHED, _SPEED, _GAIN, _AWAY = 60, 0.12, 60.0, 0.12
"""Control steps for which somebody pushes, how fast [m/s], [rad/s], how hard [N s/m], [N m s], and how far the hand is
from the handle then [m]."""


@dataclass(frozen=True)
class Arguments:
    """A `fault`, in so many `scenes` from `seed` on, of a `layout`."""

    fault: str = "shut"
    scenes: int = 30
    seed: int = 500_000
    layout: str = "drawer"
    objects: int = 5


class _Unaware:
    """An environment for the expert, who reads the model as it was before the fault, and the true state."""

    def __init__(self, env: Any, model: mujoco.MjModel) -> None:
        self._env, self.perceived = env, SimpleNamespace(model=model, data=env.data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)


def main(arguments: Arguments) -> None:
    """Play all scenes, and print a line for each and a table."""
    env = gymnasium.make(
        f"clutter_env/Retrieve-o{arguments.objects}-v0", layout=arguments.layout, max_episode_steps=_STEPS
    )
    outcomes: Counter[str] = Counter()
    for seed in range(arguments.seed, arguments.seed + arguments.scenes):
        outcome = _played(env, seed, arguments.fault)
        outcomes[outcome.partition(":")[0]] += 1
        print(seed, outcome, flush=True)
    env.close()
    print(arguments.fault, arguments.layout, dict(outcomes))


def _played(env: Any, seed: int, fault: str) -> str:
    """One episode with a fault: "taken", or why not."""
    env.reset(seed=seed)
    world = env.unwrapped
    joint = world.model.joint("drawer_joint" if _has_drawer(world.model) else "door_joint")
    handles, known = _handles(world.model), copy.deepcopy(world.model)
    was, friction = np.array(world.model.jnt_range), np.array(world.model.geom_friction)
    if fault == "slippery":
        world.model.geom_friction[handles, 0] = 0.2
    if fault == "jams":
        world.model.jnt_range[joint.id, 1] *= 0.5
    try:
        return _followed(env, known, joint, handles, fault)
    finally:
        world.model.jnt_range[:], world.model.geom_friction[:] = was, friction


def _followed(env: Any, known: mujoco.MjModel, joint: Any, handles: list[int], fault: str) -> str:
    world = env.unwrapped
    expert = TampExpert(_Unaware(world, known))
    expert.reset()
    at, dof, info = int(joint.qposadr[0]), int(joint.dofadr[0]), {"is_success": False, "lifted": False}
    left = _PUSHED if fault == "shut" else 0
    for _ in range(_STEPS):
        *_, terminated, truncated, info = env.step(expert.act())
        hand = world.data.site(world.robot.tcp_site).xpos
        is_away = min(float(np.linalg.norm(hand - world.data.geom_xpos[one])) for one in handles) > _AWAY
        pushes = left > 0 and ((is_away and world.data.qpos[at] > 0.7 * joint.range[1]) or left < _PUSHED)
        world.data.qfrc_applied[dof] = -_GAIN * (_SPEED + float(world.data.qvel[dof])) if pushes else 0.0
        left -= pushes
        if terminated or truncated or expert.done:
            break
    if info["is_success"]:
        return "taken"
    return f"lifted, not clean: {expert.report.deviations}" if info["lifted"] else f"not taken: {expert.report.result}"


def _has_drawer(model: mujoco.MjModel) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "drawer_joint") >= 0


def _handles(model: mujoco.MjModel) -> list[int]:
    return [geom for geom in range(model.ngeom) if "handle" in model.geom(geom).name]


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
