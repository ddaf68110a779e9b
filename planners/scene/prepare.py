"""Preparation of a user's model for execution: a copy with the necessary changes, each of which is reported."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robots import RobotSpec
from planners.scene.findings import model_findings
from planners.scene.mujoco_reading import can_touch, geom_name, robot_bodies
from planners.scene.robot_names import robot_prefix
from planners.scene.solid import SceneError

COMMAND_STEP = 0.01
"""[s] Interval of motor commands. A time step must divide it."""
_IMPRATIO = 10.0
"""Ratio of the stiffness of friction to that of normal forces, as in the environments of this project."""
_EULER_STEP = 0.005
"""[s] Longest time step with the explicit integrator. Fetch's arm shakes with longer steps."""
_MARGIN = 0.002
"""[m] Greatest margin of a geom. The margins of two geoms add up, and an object 5 mm above a face is not at rest on
it."""
_DISABLED = {
    mujoco.mjtDisableBit.mjDSBL_CONTACT: "contacts",
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT: "constraints",
    mujoco.mjtDisableBit.mjDSBL_ACTUATION: "motors",
}
"""Flags of MuJoCo that disable a part of the physics that every grasp needs."""
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_NAMED = 6
"""Most names of geoms in a line of a printed `Prepared`. The others are only counted."""


class Change(NamedTuple):
    """Change of a model: the property, its values before and after, and the reason."""

    what: str
    before: str
    after: str
    reason: str


@dataclass(frozen=True, eq=False)
class Prepared:
    """Model fit for `execute`, and its changes. `str()` groups the changes by their reason.

    Attributes:
        model: a copy. States of the original are states of the copy.
        changes: changes in the order of the model. Empty if it was already fit.
        not_mended: remaining problems, in words, for which plans will fail or deviate: free bodies that are too heavy
            or too slippery for the robot or have no name, their welds, tendons and contact exclusions. See
            `planners.check`.
    """

    model: mujoco.MjModel
    changes: tuple[Change, ...]
    not_mended: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = []
        for reason in dict.fromkeys(change.reason for change in self.changes):
            alike: dict[tuple[str, str, str], list[str]] = {}
            for change in self.changes:
                if change.reason == reason:
                    what, _, name = change.what.partition(" of ")
                    alike.setdefault((what, change.before, change.after), []).append(name)
            lines.append(f"{reason}:")
            for (what, before, after), names in alike.items():
                more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
                of = f" of {', '.join(names[:_NAMED])}{more}" if any(names) else ""
                lines.append(f"  {what}{of}: {before} -> {after}")
        return "\n".join((*(lines or ["no changes"]), *(f"not mended: {what}" for what in self.not_mended)))


def prepare(model: mujoco.MjModel, robot: RobotSpec) -> Prepared:
    """Copy a model so that the robot can touch other bodies, and `execute` can drive it.

    Contact bits: a colliding geom that cannot touch the robot is a ghost to it. It gets the bits of the robot. Planes
    do not, because the base stands in the ground. Margins: objects rest above their supports by the margins, so margins
    over `_MARGIN` become 0. Time step: one that does not divide `COMMAND_STEP` becomes the next shorter step that does.
    One too long for the integrator becomes `_EULER_STEP`. Flags: disabled physics that the robot needs is enabled.
    Contacts: the elliptic friction cone and `_IMPRATIO` keep held objects from creeping out of the fingers. Fingers:
    the range of their position actuators is extended, so that a command to close presses with their whole force on
    objects of any width. Problems of free bodies, such as welds or too much weight, are named but not changed.

    Args:
        model: model that contains the robot. It is not modified.
        robot: which robot it is.

    Raises:
        SceneError: the model lacks parts of the robot, or the robot has no colliding geom.
    """
    mended, changes = copy.copy(model), []
    on_robot = _robot_geoms(model, robot)
    contype = int(np.bitwise_or.reduce(model.geom_contype[on_robot]))
    conaffinity = int(np.bitwise_or.reduce(model.geom_conaffinity[on_robot]))
    for geom in ghosts(model, robot):
        before = f"{model.geom_contype[geom]}/{model.geom_conaffinity[geom]}"
        body = int(model.geom_bodyid[geom])
        # MuJoCo compares the bits of whole bodies first.
        for own, of_body, wanted in (
            (mended.geom_conaffinity, mended.body_conaffinity, contype),
            (mended.geom_contype, mended.body_contype, 0 if contype else conaffinity),
        ):
            own[geom] |= wanted
            of_body[body] |= wanted
        after = f"{mended.geom_contype[geom]}/{mended.geom_conaffinity[geom]}"
        changes.append(
            Change(f"contact bits of {geom_name(model, geom)}", before, after, "the robot passed through it")
        )
    floats = "objects rest so far above what they stand on"
    for geom in np.flatnonzero(can_touch(model) & (model.geom_margin > _MARGIN)).tolist():
        mended.geom_margin[geom] = 0.0
        changes.append(Change(f"margin of {geom_name(model, geom)} [m]", f"{model.geom_margin[geom]:g}", "0", floats))
    creeps, option, steps = "what is held crept out of the fingers", mended.opt, COMMAND_STEP / model.opt.timestep
    longest = _EULER_STEP if option.integrator == mujoco.mjtIntegrator.mjINT_EULER else COMMAND_STEP
    least = round(COMMAND_STEP / longest)
    if steps < least or not np.isclose(steps, round(steps)):
        option.timestep = COMMAND_STEP / max(math.ceil(steps), least)
        why = f"commands change every {COMMAND_STEP:g} s" if steps > least else "the arm would shake"
        changes.append(Change("time step [s]", f"{model.opt.timestep:g}", f"{option.timestep:g}", why))
    for flag, what in _DISABLED.items():
        if option.disableflags & int(flag):
            option.disableflags &= ~int(flag)
            changes.append(Change(what, "disabled", "enabled", "the robot could hold nothing"))
    if option.enableflags & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE) and option.o_margin > _MARGIN:
        changes.append(Change("margin of all contacts [m]", f"{option.o_margin:g}", "0", floats))
        option.o_margin = 0.0
    if option.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        changes.append(Change("friction cone", "pyramidal", "elliptic", creeps))
    if option.impratio < _IMPRATIO:
        changes.append(Change("impratio", f"{option.impratio:g}", f"{_IMPRATIO:g}", creeps))
        option.impratio = _IMPRATIO
    for actuator, low in _full_grips(model, robot):
        before = f"{model.actuator_ctrlrange[actuator, 0]:g}"
        mended.actuator_ctrlrange[actuator, 0] = low
        what = f"least command of {model.actuator(actuator).name} [m]"
        changes.append(Change(what, before, f"{low:g}", "thin objects were held with little force"))
    free = model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)].tolist()
    objects = [body for body in free if body not in robot_bodies(model, robot)]
    return Prepared(mended, tuple(changes), tuple(one.text for one in model_findings(mended, robot, objects)))


def _full_grips(model: mujoco.MjModel, robot: RobotSpec) -> Iterator[tuple[int, float]]:
    """The position actuators of fingers that press less on thinner objects, and the command [m] that corrects it."""
    prefix = robot_prefix(model, robot)
    for name in (prefix + finger for finger in robot.finger_joints):
        actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
        if actuator < 0 or not (model.actuator_forcelimited[actuator] and model.actuator_ctrllimited[actuator]):
            continue
        stiffness, force = -float(model.actuator_biasprm[actuator, 1]), float(model.actuator_forcerange[actuator, 1])
        if stiffness > 0 and model.actuator_ctrlrange[actuator, 0] > -force / stiffness:
            yield actuator, -force / stiffness


def ghosts(model: mujoco.MjModel, robot: RobotSpec, bodies: Collection[int] | None = None) -> tuple[int, ...]:
    """Ids of the colliding geoms that cannot touch any geom of the robot, so that it passes through them.

    Only geoms of the bodies with these ids, or of all bodies, then without planes. Explicit contact pairs and
    exclusions are ignored. Errors are those of `prepare`.
    """
    contype, conaffinity, body = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    is_asked = model.geom_type != _PLANE if bodies is None else np.isin(body, list(bodies))
    others = is_asked & can_touch(model) & ~np.isin(body, list(robot_bodies(model, robot)))
    on_robot = _robot_geoms(model, robot)
    meets = (contype[:, None] & conaffinity[on_robot]) | (conaffinity[:, None] & contype[on_robot])
    return tuple(int(geom) for geom in np.flatnonzero(others & ~meets.any(axis=1)))


def _robot_geoms(model: mujoco.MjModel, robot: RobotSpec) -> NDArray[np.int64]:
    """Ids of the robot's geoms with contact bits."""
    of_robot = np.isin(model.geom_bodyid, list(robot_bodies(model, robot)))
    found = np.flatnonzero(of_robot & ((model.geom_contype != 0) | (model.geom_conaffinity != 0)))
    if not found.size:
        raise SceneError(f"robot {robot.name!r} has no geom that can touch something: set contype in its MJCF")
    return found
