"""Insertion of a robot of this project into a user's MuJoCo model, in place of a robot there."""

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
from planners.scene.mujoco_reading import floor_planes
from planners.scene.solid import SceneError

_SAME = 0.001
"""[m] Largest height of a floor that is taken to be at z = 0, as the planner does."""


def insert_robot(
    scene: str | Path | mujoco.MjSpec,
    robot: RobotSpec,
    base: ArrayLike = (0.0, 0.0, 0.0),
    *,
    without: Iterable[str] = (),
    prefix: str | None = None,
) -> mujoco.MjModel:
    """Make a model of a scene with a robot in it, for `prepare` and `Scene.from_mujoco`.

    Keyframes of the scene are left out, because they lack the robot.

    Args:
        scene: MJCF file, its text, or a specification, which is not modified.
        robot: robot to insert.
        base: x, y [m], yaw [rad] of its base with its joints at 0, on the highest floor of the scene (a colliding
            plane), or at z = 0 without a floor. Or x, y, z [m], yaw [rad].
        without: names of bodies to leave out, such as another robot, with everything that they carry, and their
            actuators, constraints and sensors.
        prefix: prefix of all names of the robot. By default it has no prefix or, if a name exists in the scene, the
            robot's name and a slash. `robot_prefix` finds it.

    Raises:
        SceneError: MuJoCo cannot read the scene, or the scene lacks such a body, or already has names of the robot
            behind the prefix. Or the base is not three or four finite numbers. The message gives the reason.
    """
    if isinstance(without, str):
        raise SceneError(f"without is a collection of names of bodies, not one string; use [{without!r}]")
    left_out, numbers = tuple(dict.fromkeys(without)), _base(base)
    tried = (prefix,) if prefix is not None else ("", f"{robot.name}/")
    for number, before in enumerate(tried, 1):
        try:
            return _inserted(_read(scene, left_out), robot, numbers, before)
        except (ValueError, OSError) as problem:
            if isinstance(problem, SceneError):
                raise
            if number < len(tried) and "repeated name" in str(problem):
                continue
            what = f"robot {robot.name!r} cannot be put into this scene: {problem}"
            try:  # the scene alone, so that its errors are not blamed on the robot
                with _no_warnings_of_mujoco():
                    _read(scene, left_out).compile()
            except (ValueError, OSError) as fault:
                rest = f" without {', '.join(left_out)}" if left_out else ""
                what = f"MuJoCo cannot read this scene{rest}, even with no robot put in: {fault}"
            raise SceneError(what) from problem
    raise AssertionError("the last prefix is returned, or refused")


def _base(base: ArrayLike) -> tuple[float, float, float | None, float]:
    """Parse a base of three numbers, without z, or four: x, y, z [m] and yaw [rad]."""
    try:
        given = np.array(base, dtype=float).ravel()
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.size not in (3, 4) or not np.isfinite(given).all():
        raise SceneError(f"base is x, y [m], yaw [rad], three finite numbers, or x, y, z, yaw, not {base!r:.100}")
    x, y, *z, yaw = given.tolist()
    return x, y, z[0] if z else None, yaw


def _inserted(
    spec: mujoco.MjSpec, robot: RobotSpec, base: tuple[float, float, float | None, float], prefix: str
) -> mujoco.MjModel:
    """Compile a scene with a robot behind a prefix. The specification is modified."""
    x, y, z, yaw = base
    for key in list(spec.keys):
        spec.delete(key)
    spec.compiler.fusestatic = False  # fusing would remove bodies of the robot
    height = _floor_of(spec) if z is None else z
    frame = spec.worldbody.add_frame(pos=[x, y, height], quat=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
    with warnings.catch_warnings(), _no_warnings_of_mujoco():
        warnings.simplefilter("ignore")  # without a prefix the robot keeps its names, as intended
        spec.attach(mujoco.MjSpec.from_file(str(robot.mjcf_path)), frame=frame, prefix=prefix)
        return spec.compile()


def _floor_of(spec: mujoco.MjSpec) -> float:
    """Height of the highest floor of a scene without a robot [m], 0 without a floor."""
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        return 0.0
    with _no_warnings_of_mujoco():
        model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = [float(data.geom_xpos[plane, 2]) for plane in floor_planes(model, data)]
    height = max(heights, default=0.0)
    return height if abs(height) > _SAME else 0.0


@contextmanager
def _no_warnings_of_mujoco() -> Iterator[None]:
    """Silence MuJoCo's warnings, which it otherwise writes to standard error and to a file in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)  # noqa: ARG005  what it gets
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _read(scene: str | Path | mujoco.MjSpec, without: Iterable[str]) -> mujoco.MjSpec:
    """A copy of the scene without these bodies. Raises `SceneError` for a body that it lacks."""
    if isinstance(scene, mujoco.MjModel):
        raise SceneError("scene is an MJCF file, its text or an MjSpec: no robot can be put into a compiled MjModel")
    if isinstance(scene, mujoco.MjSpec):
        spec = scene.copy()
    else:
        spec = mujoco.MjSpec.from_string(scene) if "<" in str(scene) else mujoco.MjSpec.from_file(str(scene))
    names = [body.name for body in spec.bodies[1:] if body.name]  # all except the world, which every scene needs
    for name in without:
        if name not in names:
            raise SceneError(f"no body {name!r} to leave out; bodies: {', '.join(names) or 'none'}")
        if (body := spec.body(name)) is not None:  # otherwise it was deleted with its parent
            spec.delete(body)
    return spec
