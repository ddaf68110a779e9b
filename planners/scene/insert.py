"""A robot of this project put into somebody's MuJoCo model, in place of the robot that is there, if any."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from assets.robots import RobotSpec
from planners.scene.solid import SceneError


def insert_robot(
    scene: str | Path | mujoco.MjSpec,
    robot: RobotSpec,
    base: ArrayLike = (0.0, 0.0, 0.0),
    *,
    without: Iterable[str] = (),
) -> mujoco.MjModel:
    """A model of a scene with a robot in it under its own names, for `prepare` and `Scene.from_mujoco`.

    Keyframes of the scene are left out: they say nothing about the robot.

    Args:
        scene: MJCF file, its text, or a specification, which is not written.
        robot: to put in.
        base: x, y [m], yaw [rad] of its base when its joints are 0, on the ground z = 0.
        without: names of bodies to leave out with all that they carry, actuators, constraints and sensors: another
            robot above all.

    Raises:
        SceneError: a scene that MuJoCo cannot read, that lacks such a body, or that has names of the robot; a base that
            is not three finite numbers. The message says which.
    """
    if isinstance(without, str):
        raise SceneError(f"without is a collection of names of bodies, not one string; use [{without!r}]")
    left_out = tuple(dict.fromkeys(without))
    try:
        x, y, yaw = np.array(base, dtype=float).reshape(3)
    except (TypeError, ValueError):
        x = y = yaw = math.nan
    if not math.isfinite(x + y + yaw):
        raise SceneError(f"base is x, y [m], yaw [rad], three finite numbers, not {base!r:.100}")
    try:
        spec = _read(scene, left_out)
        for key in list(spec.keys):
            spec.delete(key)
        spec.compiler.fusestatic = False  # it would take bodies of the robot away
        frame = spec.worldbody.add_frame(pos=[x, y, 0.0], quat=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
        with warnings.catch_warnings(), _no_warnings_of_mujoco():
            warnings.simplefilter("ignore")  # the robot keeps its names: the planner looks for them
            spec.attach(mujoco.MjSpec.from_file(str(robot.mjcf_path)), frame=frame, prefix="")
            return spec.compile()
    except (ValueError, OSError) as problem:
        if isinstance(problem, SceneError):
            raise
        what = f"robot {robot.name!r} cannot be put into this scene: {problem}"
        try:  # the scene alone, to blame the robot for nothing that is wrong there
            with _no_warnings_of_mujoco():
                _read(scene, left_out).compile()
        except (ValueError, OSError) as fault:
            rest = f" without {', '.join(left_out)}" if left_out else ""
            what = f"MuJoCo cannot read this scene{rest}, even with no robot put in: {fault}"
        raise SceneError(what) from problem


@contextmanager
def _no_warnings_of_mujoco() -> Iterator[None]:
    """Without a handler, MuJoCo writes its own to standard error and to a file in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)  # noqa: ARG005  what it gets
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _read(scene: str | Path | mujoco.MjSpec, without: Iterable[str]) -> mujoco.MjSpec:
    """A copy of the scene without these bodies; raises `SceneError` for a body that it lacks."""
    if isinstance(scene, mujoco.MjModel):
        raise SceneError("scene is an MJCF file, its text or an MjSpec: no robot can be put into a compiled MjModel")
    if isinstance(scene, mujoco.MjSpec):
        spec = scene.copy()
    else:
        spec = mujoco.MjSpec.from_string(scene) if "<" in str(scene) else mujoco.MjSpec.from_file(str(scene))
    names = [body.name for body in spec.bodies[1:] if body.name]  # all but the world, without which there is no scene
    for name in without:
        if name not in names:
            raise SceneError(f"no body {name!r} to leave out; bodies: {', '.join(names) or 'none'}")
        if (body := spec.body(name)) is not None:  # else it went with one that carried it
            spec.delete(body)
    return spec
