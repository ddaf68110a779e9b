"""Findings about problems of a scene, with numbers, their report, and the findings that need the model.

Masses, friction, names and ties are in the model that a scene is read from. `Scene.findings` keeps the problems found
there. `planners.check` finds problems with the places of objects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from assets.robot_motors import ASSUMED, PAYLOAD, Payload, payload_of
from assets.robots import RobotSpec
from planners.scene.mujoco_reading import can_touch, geom_name, robot_bodies
from planners.scene.robot_names import robot_prefix

_GRAVITY = 9.81
"""[m/s²]"""
_BORNE = 0.99
"""Share of its weight above which MuJoCo's `gravcomp` keeps an object in the air."""
_SLIPPERY = 0.05
"""Friction below which the friction, not the weight, is the reason that fingers cannot hold an object."""
_NEAR = 0.01
"""[m] Distance of a free body from all others above which it falls, at least by as much."""
_JOINED = {int(mujoco.mjtEq.mjEQ_WELD): "is welded to", int(mujoco.mjtEq.mjEQ_CONNECT): "is joined (<connect>) to"}


class Reason(StrEnum):
    """Kind of a problem in a scene.

    Attributes:
        SUNK: an object is deeper inside a static obstacle than contacts of simulators allow [mm].
        FLOATING: an object has no contact and falls [mm].
        UNSTABLE: its centre of mass is beside its support [mm].
        TOO_HEAVY: it is heavier than the arm or the fingers can hold [kg].
        SLIPPERY: the fingers cannot hold it for lack of friction [friction].
        TOUCHES_ROBOT: it touches the robot without being held.
        UNNAMED: a body with a free joint has no name, so that no plan can move it.
        TIED: something unknown to the planner holds it, or lets it pass through.
    """

    SUNK = "sunk into furniture"
    FLOATING = "resting on nothing"
    UNSTABLE = "not standing"
    TOO_HEAVY = "too heavy"
    SLIPPERY = "too slippery"
    TOUCHES_ROBOT = "touching the robot"
    UNNAMED = "without a name"
    TIED = "tied"


@dataclass(frozen=True)
class Finding:
    """Problem of an object in a scene.

    Attributes:
        reason: kind of the problem.
        object: name of the object, "" for a body without a name.
        amount: amount in the unit of the reason, 0 for a reason without an amount.
        text: one sentence with the number.
        is_certain: whether a plan that takes the object fails because of it. False if it rests on an assumption.
    """

    reason: Reason
    object: str
    amount: float
    text: str
    is_certain: bool = True

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class SceneReport:
    """Report of a scene's problems. `str()` is grouped by reason, and a report without findings is false."""

    findings: tuple[Finding, ...] = ()

    def about(self, names: Collection[str], reasons: Collection[Reason] = tuple(Reason)) -> tuple[Finding, ...]:
        """The findings about some objects, for some reasons."""
        return tuple(one for one in self.findings if one.object in names and one.reason in reasons)

    def __bool__(self) -> bool:
        return bool(self.findings)

    def __str__(self) -> str:
        lines = []
        for reason in Reason:
            found = [one.text for one in self.findings if one.reason is reason]
            lines += [f"{reason} ({len(found)}):", *(f"  {text}" for text in found)] if found else []
        return "\n".join(lines) or "nothing odd"


def model_findings(
    model: mujoco.MjModel, robot: RobotSpec, bodies: Iterable[int], data: mujoco.MjData | None = None
) -> tuple[Finding, ...]:
    """Find the problems that need the model: those of free bodies without a name, and of `bodies`, given by their ids.
    With a state of the model, also those of the other free bodies, which a planner takes as static."""
    chosen = list(bodies)
    found = [*_weights(model, robot, chosen), *_ties(model, chosen)]
    free = set(model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)].tolist())
    for body in sorted(free - robot_bodies(model, robot)):
        if data is not None and body not in chosen and not _touches(model, data, body):
            name = str(model.body(body).name)
            which = name or f"body {body}"
            text = f"{which}: not movable, but free to fall: nothing is within {1000 * _NEAR:.0f} mm of it"
            if float(model.body_gravcomp[body]) < _BORNE and not any(_ties(model, [body])):
                found.append(Finding(Reason.FLOATING, name, 1000 * _NEAR, text))
        if not model.body(body).name:
            geoms = np.flatnonzero(can_touch(model) & (model.body_rootid[model.geom_bodyid] == body)).tolist()
            parts = ", ".join(geom_name(model, geom) for geom in geoms[:3]) or "none that can touch"
            text = f"body {body} (geoms: {parts}) has a free joint and no name: it is taken as a static obstacle"
            found.append(Finding(Reason.UNNAMED, "", 0.0, text))
    return tuple(found)


def _touches(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> bool:
    """Whether a free body is near another colliding geom, or has no colliding geom itself."""
    touches, of = can_touch(model), model.body_rootid[model.geom_bodyid]
    own = np.flatnonzero(touches & (of == body)).tolist()
    for one in own:
        for other in np.flatnonzero(touches & (of != body)).tolist():
            away = float(np.linalg.norm(data.geom_xpos[one] - data.geom_xpos[other]))
            is_far = model.geom_rbound[other] > 0 and away - model.geom_rbound[[one, other]].sum() > _NEAR
            if not is_far and mujoco.mj_geomDistance(model, data, one, other, 2 * _NEAR, None) < _NEAR:
                return True
    return not own


def _weights(model: mujoco.MjModel, robot: RobotSpec, bodies: Sequence[int]) -> Iterator[Finding]:
    """Findings about objects heavier than the arm holds, or than the fingers hold by friction."""
    grip = _Grip.of(model, robot)
    frictions, priorities = grip.frictions(model)[bodies], grip.priorities(model)[bodies]
    masses = model.body_subtreemass[bodies]
    # Without friction the capacity is 0, even if the fingers have no limit of force.
    capacities = 2 * frictions / _GRAVITY * np.where(frictions > 0, grip.force, 0.0)
    for index in np.flatnonzero((masses > PAYLOAD) | (masses > capacities)).tolist():
        name, mass, held = str(model.body(bodies[index]).name), float(masses[index]), float(capacities[index])
        payload = _payload(robot) if mass > PAYLOAD else None
        if payload is not None and mass > payload.kg:
            assumed = ", by torques that are assumed" if payload.is_assumed else ""
            holds = f"{robot.name!r} holds {payload.kg:.3g} kg with its arm stretched out{assumed}"
            text = f"{name}: {mass:.3g} kg, and {holds}"
            yield Finding(Reason.TOO_HEAVY, name, mass, text, not payload.is_assumed)
        friction, priority = float(frictions[index]), int(priorities[index])
        if mass > held and friction < _SLIPPERY:
            over = f", which has priority {priority} over theirs, {grip.priority}" if priority > grip.priority else ""
            text = f"{name}: friction {friction:g} in the fingers{over}: they hold {held:.2g} of its {mass:.3g} kg"
            yield Finding(Reason.SLIPPERY, name, friction, text)
        elif mass > held:
            text = f"{name}: {mass:.3g} kg, and the fingers hold {held:.3g} kg by their friction of {friction:g}"
            yield Finding(Reason.TOO_HEAVY, name, mass, text)


@dataclass(frozen=True)
class _Grip:
    """Grip of the fingers: friction, its priority, `condim` (1 for contacts without friction), force of one finger
    [N]."""

    friction: float
    priority: int
    condim: int
    force: float

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: RobotSpec) -> _Grip:
        prefix = robot_prefix(model, robot)
        kinds = ((mujoco.mjtObj.mjOBJ_GEOM, robot.finger_geoms), (mujoco.mjtObj.mjOBJ_ACTUATOR, robot.finger_joints))
        geoms, motors = ([mujoco.mj_name2id(model, kind, prefix + name) for name in names] for kind, names in kinds)
        pads = [geom for geom in geoms if geom >= 0]
        limits = [
            float(np.abs(model.actuator_forcerange[motor]).max()) if model.actuator_forcelimited[motor] else math.inf
            for motor in motors
            if motor >= 0
        ]
        if not pads:  # nothing is known about the fingers
            return cls(math.inf, 0, 3, math.inf)
        return cls(
            float(model.geom_friction[pads, 0].max()),
            int(model.geom_priority[pads].max()),
            int(model.geom_condim[pads].max()),
            min(limits, default=math.inf),
        )

    def frictions(self, model: mujoco.MjModel) -> NDArray[np.float64]:
        """Sliding friction (nbody,) between the fingers and the best geom of each free body, by MuJoCo's rules."""
        over, same = model.geom_priority > self.priority, model.geom_priority == self.priority
        friction = np.where(same, np.maximum(model.geom_friction[:, 0], self.friction), self.friction)
        friction = np.where(over, model.geom_friction[:, 0], friction)
        condim = np.where(same, np.maximum(model.geom_condim, self.condim), self.condim)
        condim = np.where(over, model.geom_condim, condim)
        touches, best = can_touch(model), np.zeros(model.nbody)
        np.maximum.at(best, model.body_rootid[model.geom_bodyid[touches]], np.where(condim > 1, friction, 0.0)[touches])
        return best

    def priorities(self, model: mujoco.MjModel) -> NDArray[np.int64]:
        """Highest priority (nbody,) of the geoms of each free body."""
        touches, most = can_touch(model), np.zeros(model.nbody, dtype=np.int64)
        np.maximum.at(most, model.body_rootid[model.geom_bodyid[touches]], model.geom_priority[touches])
        return most


@dataclass(frozen=True)
class _ArmPayload:
    """Payload of an outstretched arm [kg], and whether it follows from assumed torques."""

    kg: float
    is_assumed: bool


@cache
def _payload(robot: RobotSpec) -> _ArmPayload | None:
    """Payload by the torques of the robot's file. None if it has none."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    found: Payload | None = payload_of(model, robot.arm_joints, robot.tcp_site)
    if found is None:
        return None
    # Springs or counterweights bear the arm if its motors are too weak for it, or if the model says so.
    tip = int(model.site_bodyid[model.site(robot.tcp_site).id])
    is_borne = found.kg <= 0 or float(model.body_gravcomp[tip]) > _BORNE
    is_assumed = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, ASSUMED) >= 0
    return _ArmPayload(found.weightless_kg if is_borne else found.kg, is_assumed)


def _ties(model: mujoco.MjModel, bodies: Iterable[int]) -> Iterator[Finding]:
    """Findings about ties of free bodies that the planner does not know: they hold bodies, or let them pass through
    others."""
    free, found = set(bodies), dict[str, Finding]()
    for ends, what, taken in _joins(model):
        for one, other in itertools.permutations(ends, 2):
            root, name = int(model.body_rootid[one]), model.body(other).name or f"body {other}"
            if root in free and root != model.body_rootid[other]:
                own = str(model.body(root).name)
                text = f"object {own!r} {what} {name!r}: the planner takes it as {taken}"
                found[text] = Finding(Reason.TIED, own, 0.0, text, is_certain=False)
    if model.body_gravcomp.any():
        for body in (one for one in sorted(free) if float(model.body_gravcomp[one]) > _BORNE):
            own = str(model.body(body).name)
            text = f"object {own!r} is held up by its gravcomp: the planner takes it as free"
            found[text] = Finding(Reason.TIED, own, 0.0, text, is_certain=False)
    yield from found.values()


def _joins(model: mujoco.MjModel) -> Iterator[tuple[list[int], str, str]]:
    """Yield ties in a model: ids of the bodies, the relation of one to another in words, and the planner's view of
    it."""
    is_on = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    for tie in np.flatnonzero(model.eq_active0) if is_on else ():
        ends = [int(model.eq_obj1id[tie]), int(model.eq_obj2id[tie])]
        if int(model.eq_objtype[tie]) == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = model.site_bodyid[ends].tolist()
        if (kind := int(model.eq_type[tie])) in _JOINED:
            yield ends, _JOINED[kind], "free"
    wraps = {int(mujoco.mjtWrap.mjWRAP_SITE): model.site_bodyid}
    wraps |= {int(kind): model.geom_bodyid for kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)}
    for tendon in np.flatnonzero(_pulling_tendons(model)):
        first = int(model.tendon_adr[tendon])
        parts = range(first, first + int(model.tendon_num[tendon]))
        found = [(wraps.get(int(model.wrap_type[part])), int(model.wrap_objid[part])) for part in parts]
        bodies = dict.fromkeys(int(of[index]) for of, index in found if of is not None)
        yield list(bodies), f"hangs by tendon {model.tendon(tendon).name or tendon!r} on", "free"
    touching = set(model.geom_bodyid[can_touch(model)].tolist())
    for signature in model.exclude_signature.tolist():
        ends = [signature >> 16, signature & 0xFFFF]
        if touching.issuperset(ends):
            yield ends, "passes through (<exclude>)", "solid"


def _pulling_tendons(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Mark the tendons (ntendon,) that exert forces, unlike those that are only drawn or measured."""
    pulls = (model.tendon_stiffness > 0) | (model.tendon_damping > 0) | (model.tendon_frictionloss > 0)
    pulls |= model.tendon_limited.astype(bool)
    pulls[model.actuator_trnid[model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON), 0]] = True
    ties = model.eq_type == int(mujoco.mjtEq.mjEQ_TENDON)
    pulls[model.eq_obj1id[ties]] = True
    pulls[model.eq_obj2id[ties & (model.eq_obj2id >= 0)]] = True
    return np.asarray(pulls)
