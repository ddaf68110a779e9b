"""Motors of a robot: torques that its file gives, what gravity asks of them, and what is assumed where it gives none.

Where a file gives no torque, a joint is assumed to have `_MARGIN` times what holds the arm and an object stretched out,
whichever way gravity pulls, so that a joint about the vertical has its share. Joints that bear nothing, such as a wrist
that turns the hand, have `_LEAST` of the largest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PAYLOAD = 0.25
"""[kg] of the heaviest object of the standard set."""
ASSUMED = "assumed_torques"
"""Name of the text in a made robot's file that lists its joints whose torques are assumed."""
_GRAVITY = 9.81
"""[m/s²]"""
_MARGIN = 2.0
"""Published torques of Fetch's arm hold 2.1 to 4.7 times the weight of arm and object, the Panda's 1.5 to 3.6 times,
of the joints that bear it."""
_LEAST = 0.1
"""Share of the largest torque, or stiffness, of an arm; the last joints of Fetch and Panda have 0.06 and 0.14 of it."""
_BENT = 0.002
"""[rad] by which an object of `PAYLOAD` bends a joint. The gains of PR2's arm controllers let it bend by 1.0 to 1.8
mrad, those of the joint impedance example of the Panda's maker (libfranka) by 2.2 to 3.9."""
_SAMPLES = 2000
"""Random configurations in which the largest torques are looked for."""


@dataclass(frozen=True)
class Motor:
    """The position servo of a joint.

    Attributes:
        limit: largest torque [N m], of a slide force [N].
        stiffness: [N m/rad]; [N/m].
        is_assumed: whether the file gives no limit.
    """

    limit: float
    stiffness: float
    is_assumed: bool


class Payload(NamedTuple):
    """What a robot can hold with its arm stretched out.

    Attributes:
        kg: at the TCP, beside the arm's own weight; negative if the motors do not even hold that.
        joint: the name of the first joint that gives way.
        limit: its largest torque [N m].
        weightless_kg: the same if springs or counterweights bear the arm, as `gravcomp` does in a simulation.
    """

    kg: float
    joint: str
    limit: float
    weightless_kg: float


def given_limit(model: mujoco.MjModel, joint: int) -> float | None:
    """The largest torque [N m], or force [N], that a file gives a joint; None if it gives none.

    It is the least of `actuatorfrcrange`, as which MuJoCo reads the `effort` of a URDF file, and what the actuators of
    the joint can exert: their `forcerange` and, of motors, `ctrlrange` times gain, times `gear`. A limit of 0 is none.
    """
    found = [float(np.abs(model.jnt_actfrcrange[joint]).max())] if model.jnt_actfrclimited[joint] else []
    at_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for k in range(model.nu):
        if int(model.actuator_trntype[k]) not in at_joint or int(model.actuator_trnid[k, 0]) != joint:
            continue
        gear = abs(float(model.actuator_gear[k, 0]))
        is_motor = int(model.actuator_biastype[k]) == int(mujoco.mjtBias.mjBIAS_NONE)
        if model.actuator_forcelimited[k]:
            found.append(float(np.abs(model.actuator_forcerange[k]).max()) * gear)
        if is_motor and model.actuator_ctrllimited[k]:
            full = float(np.abs(model.actuator_ctrlrange[k]).max())
            found.append(full * abs(float(model.actuator_gainprm[k, 0])) * gear)
    return min((limit for limit in found if limit > 0.0), default=None)


def motors_of(
    model: mujoco.MjModel, lift: str, arm: Sequence[str], tcp: str, given: Mapping[str, float]
) -> dict[str, Motor]:
    """The motors of lift and arm by the names of their joints.

    Args:
        model: of the robot, its motors need not be in it.
        lift: name of its joint.
        arm: names of joints, shoulder first.
        tcp: name of the site between the finger tips.
        given: limits of joints by their names, [N m] and [N]; others are assumed.
    """
    needed, of_object = _moments(model, (lift, *arm), tcp)
    torques = [given.get(name, _MARGIN * bears) for name, bears in zip(arm, needed[1:], strict=True)]
    stiffness = np.maximum(of_object[1:] / _BENT, _LEAST * of_object[1:].max() / _BENT)
    motors = {lift: Motor(given.get(lift, _MARGIN * float(needed[0])), _LIFT_STIFFNESS, lift not in given)}
    for name, torque, gain in zip(arm, torques, stiffness.tolist(), strict=True):
        limit = torque if name in given else max(torque, _LEAST * max(torques))
        motors[name] = Motor(float(limit), gain, name not in given)
    return motors


_LIFT_STIFFNESS = 20000.0
"""[N/m], as that of the lifts of the package's robots."""


def payload_of(model: mujoco.MjModel, joints: Sequence[str], tcp: str) -> Payload | None:
    """What a robot can hold at its TCP in the worst of `_SAMPLES` configurations; None if no motor has a limit.

    Args:
        model: of the robot; its base is upright, and its actuators have the names of its joints.
        joints: names of the arm's joints.
        tcp: name of the site between the finger tips.
    """
    limits = np.array([_limit(model, name) for name in joints])
    own, per_kg = _weights(model, joints, tcp, np.array([0.0, 0.0, -1.0]))
    per_kg = np.where(np.abs(per_kg) > _NO_LEVER, per_kg, np.nan)
    if not (np.isfinite(limits) & np.isfinite(per_kg).any(axis=0)).any():
        return None
    # The object's weight adds to the arm's, or works against it and is held longer.
    kg = np.nanmin((limits - own * np.sign(per_kg)) / np.abs(per_kg), axis=0, initial=np.inf)
    weightless = np.nanmin(limits / np.abs(per_kg), axis=0, initial=np.inf)
    first = int(kg.argmin())
    return Payload(float(kg[first]), joints[first], float(limits[first]), float(weightless.min()))


_NO_LEVER = 1e-6
"""[N m] of a kilogram at the TCP, up to which a joint bears nothing of it."""


def _limit(model: mujoco.MjModel, name: str) -> float:
    """[N m], [N] that the motor of a joint exerts at most."""
    motor, joint = model.actuator(name), model.joint(name)
    limits = [np.inf]
    if motor.forcelimited[0]:
        limits.append(float(np.abs(motor.forcerange).max()))
    if model.jnt_actfrclimited[joint.id]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint.id]).max()))
    return min(limits)


def _moments(model: mujoco.MjModel, joints: Sequence[str], tcp: str) -> tuple[Floats, Floats]:
    """(n,) each: the largest torques of all that joints carry with an object, and of the object alone.

    The object's weight is taken to add to the arm's, and gravity to pull in the worst direction: a torque is linear in
    it, so that its largest value is the norm of those for three axes.
    """
    weights = [_weights(model, joints, tcp, axis) for axis in np.eye(3)]
    objects = [PAYLOAD * np.abs(per_kg) for _, per_kg in weights]
    both = [np.abs(own) + weight for (own, _), weight in zip(weights, objects, strict=True)]
    needed, of_object = (np.linalg.norm(torques, axis=0).max(axis=0) for torques in (both, objects))
    return needed, of_object


def _weights(model: mujoco.MjModel, joints: Sequence[str], tcp: str, down: Floats) -> tuple[Floats, Floats]:
    """(s, n) each, in random configurations: what holds all that joints carry, and a kilogram at the TCP [N m].

    Gravity pulls along `down` (3,). Joints that are not named are at 0.
    """
    gravity, before = _GRAVITY * down, np.array(model.opt.gravity)
    data, site, numbers = mujoco.MjData(model), model.site(tcp).id, [model.joint(name).id for name in joints]
    columns, dofs = model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]
    limited = model.jnt_limited[numbers].astype(bool)[:, None]
    low, high = np.where(limited, model.jnt_range[numbers], (-np.pi, np.pi)).T
    own, per_kg = np.zeros((2, _SAMPLES, len(numbers)))
    held, jacobian = np.zeros(model.nv), np.zeros((3, model.nv))
    data.qpos[:], model.opt.gravity[:] = 0.0, gravity
    for k, q in enumerate(np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(low)))):
        data.qpos[columns] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, held)
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        own[k], per_kg[k] = held[dofs], -(gravity @ jacobian)[dofs]
    model.opt.gravity[:] = before
    return own, per_kg
