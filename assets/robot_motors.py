"""Motors of a robot: torques from its file, torques that gravity requires, and assumed torques where the file has none.

A joint without a torque in the file is assumed to have `_MARGIN` times the torque that holds the outstretched arm with
an object. Gravity may pull in any direction, so that a joint about the vertical has its share too. A joint that bears
no load, such as a wrist that turns the hand, has `_LEAST` of the largest torque.
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
"""[kg] Mass of the heaviest object of the standard set."""
ASSUMED = "assumed_torques"
"""Name of the text in a made robot's file that lists its joints with assumed torques."""
_GRAVITY = 9.81
"""[m/s²]"""
_MARGIN = 2.0
"""Ratio of assumed to required torque. Published torques of the loaded joints hold 2.1 to 4.7 times the weight of arm
and object for Fetch, and 1.5 to 3.6 times for the Panda."""
_LEAST = 0.1
"""Least share of an arm's largest torque, or stiffness. The last joints of Fetch and Panda have 0.06 and 0.14 of it."""
_BENT = 0.002
"""[rad] Deflection of a joint under an object of `PAYLOAD`. It is 1.0 to 1.8 mrad with the gains of PR2's arm
controllers, and 2.2 to 3.9 mrad with those of libfranka's joint impedance example for the Panda."""
_SAMPLES = 2000
"""Random configurations in the search for the largest torques."""


@dataclass(frozen=True)
class Motor:
    """The position servo of a joint.

    Attributes:
        limit: largest torque [N m], or force of a slide [N].
        stiffness: [N m/rad], or [N/m] of a slide.
        is_assumed: whether the limit is assumed, because the file has none.
    """

    limit: float
    stiffness: float
    is_assumed: bool


class Payload(NamedTuple):
    """Payload of a robot with its arm stretched out.

    Attributes:
        kg: mass at the TCP, in addition to the arm's own weight. Negative if the motors cannot hold the arm itself.
        joint: name of the first joint that gives way.
        limit: its largest torque [N m].
        weightless_kg: `kg` if springs or counterweights bear the arm, as `gravcomp` does in a simulation.
    """

    kg: float
    joint: str
    limit: float
    weightless_kg: float


def given_limit(model: mujoco.MjModel, joint: int) -> float | None:
    """Largest torque [N m], or force [N], of a joint in its file. None if the file has no limit.

    It is the least of two kinds of limits. The first is `actuatorfrcrange`, to which MuJoCo maps the `effort` of a URDF
    file. The second is the range of the joint's actuators: `forcerange`, and for motors `ctrlrange` times gain, each
    times `gear`. A limit of 0 means no limit.
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
    """Motors of lift and arm by the names of their joints.

    Args:
        model: of the robot. It may lack the motors.
        lift: name of its joint.
        arm: names of joints, shoulder first.
        tcp: name of the site between the finger tips.
        given: limits of joints by their names, [N m] and [N]. Other limits are assumed.
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
"""[N/m] Stiffness of a lift, as for the package's robots."""


def payload_of(model: mujoco.MjModel, joints: Sequence[str], tcp: str) -> Payload | None:
    """Payload of a robot at its TCP in the worst of `_SAMPLES` configurations. None if no motor has a limit.

    Args:
        model: of the robot, with an upright base. Its actuators have the names of its joints.
        joints: names of the arm's joints.
        tcp: name of the site between the finger tips.
    """
    limits = np.array([_limit(model, name) for name in joints])
    own, per_kg = _weights(model, joints, tcp, np.array([0.0, 0.0, -1.0]))
    per_kg = np.where(np.abs(per_kg) > _NO_LEVER, per_kg, np.nan)
    if not (np.isfinite(limits) & np.isfinite(per_kg).any(axis=0)).any():
        return None
    # The object's weight either adds to the arm's weight, or counteracts it, so that the joint holds more.
    kg = np.nanmin((limits - own * np.sign(per_kg)) / np.abs(per_kg), axis=0, initial=np.inf)
    weightless = np.nanmin(limits / np.abs(per_kg), axis=0, initial=np.inf)
    first = int(kg.argmin())
    return Payload(float(kg[first]), joints[first], float(limits[first]), float(weightless.min()))


_NO_LEVER = 1e-6
"""[N m] Torque of a kilogram at the TCP below which a joint does not bear it."""


def _limit(model: mujoco.MjModel, name: str) -> float:
    """Largest torque [N m] or force [N] of a joint's motor."""
    motor, joint = model.actuator(name), model.joint(name)
    limits = [np.inf]
    if motor.forcelimited[0]:
        limits.append(float(np.abs(motor.forcerange).max()))
    if model.jnt_actfrclimited[joint.id]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint.id]).max()))
    return min(limits)


def _moments(model: mujoco.MjModel, joints: Sequence[str], tcp: str) -> tuple[Floats, Floats]:
    """Largest torques (n,) of the joints' loads with an object, and of the object alone (n,).

    The object's weight is assumed to add to the arm's, and gravity to pull in the worst direction. A torque is linear
    in gravity, so that its largest value is the norm of those for three axes.
    """
    weights = [_weights(model, joints, tcp, axis) for axis in np.eye(3)]
    objects = [PAYLOAD * np.abs(per_kg) for _, per_kg in weights]
    both = [np.abs(own) + weight for (own, _), weight in zip(weights, objects, strict=True)]
    needed, of_object = (np.linalg.norm(torques, axis=0).max(axis=0) for torques in (both, objects))
    return needed, of_object


def _weights(model: mujoco.MjModel, joints: Sequence[str], tcp: str, down: Floats) -> tuple[Floats, Floats]:
    """Torques (s, n) in random configurations that hold the joints' loads, and those of a kilogram at the TCP (s, n) [N
    m].

    Gravity pulls along `down` (3,). Other joints are at 0.
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
