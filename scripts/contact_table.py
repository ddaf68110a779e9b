"""What grips hold and contacts press: figures behind the rule of success, from physics alone.

    python scripts/contact_table.py

Four tables for one robot:

- slip: an object hangs in the level gripper, and the squeeze is slowly reduced. It should slip where friction carries
  no more than the weight: at m g / 2 μ for each finger.
- creep: the same with the full squeeze, for 30 s.
- touch: the closed hand meets the table at some speed, level or with the fingers pointing down at 60°, the arm stops,
  and is withdrawn. The effective mass is that of the arm along the vertical, from its inertia matrix.
- press: base and arm push on for half a second against the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.tables import markdown_table
from clutter_env.scene.layout import TABLE_HEIGHT
from clutter_env.simulation.control import JointController
from clutter_env.simulation.pressing import Pressing, is_gentle

_HEIGHT = 1.1
"""[m] of the gripper above the ground while it holds something."""
_RADIUS = 0.03
"""[m] of the object."""
_SLIPPING = 0.005
"""[m/s] by which an object moves in the fingers when it slips; a hold creeps by less than 0.1 mm/s."""
_GRAVITY = 9.81
_TRACTION = 0.6
"""Friction of wheels on the ground."""


def main(
    robot: str = "fetch",
    hold_s: float = 30.0,
    only_touch: bool = False,
    damping: tuple[float, ...] = (),
    armature: tuple[float, ...] = (),
) -> None:
    """Measure and print.

    Args:
        robot: a name.
        hold_s: how long a hold is watched [s].
        only_touch: print the third table alone.
        damping: of the arm's motors in that table, from the shoulder [N m s/rad]; that of the robot by default.
        armature: reflected inertia of these motors, likewise [kg m²].
    """
    rows = [[*row] for row in touch_rows(robot, damping, armature)]
    touch = markdown_table(TOUCH, rows)
    if only_touch:
        print(touch)
        return
    rows = [[*row] for row in slip_rows(robot)]
    print(markdown_table(["friction", "mass kg", "m g / 2 μ, N", "slips at, N", "ratio"], rows))
    rows = [[*row] for row in creep_rows(robot, hold_s)]
    print(markdown_table(["mass kg", f"creep in {hold_s:.0f} s, mm"], rows))
    print(touch)
    rows = [[*row] for row in press_rows(robot)]
    print(markdown_table(["pushed by", "mean of 0.5 s, N", "traction, N", "largest share of a motor's limit"], rows))


TOUCH = [
    "fingers point down by, °",
    "speed m/s",
    "effective mass kg",
    "peak N",
    "largest mean of 0.1 s, N",
    "impulse beyond 50 N, N s",
    "slide of a table of 10 kg, mm",
    "gentle",
]
"""Head of the third table."""


class Meter(Pressing):
    """One that remembers the largest force [N] of a physics step too."""

    peak = 0.0

    def add(self, forces: Sequence[float]) -> None:
        """Take further physics steps into account."""
        self.peak = max(self.peak, *forces)
        super().add(forces)


class Bench:
    """A robot in "ee" control before a table with one object, and the steps that the tables share."""

    def __init__(self, robot: str, mass: float = 0.2, friction: float = 0.8) -> None:
        self.env = RetrieveEnv(num_objects=1, control_mode="ee", robot=robot)
        objects = [{"radius": _RADIUS, "height": 0.14, "position": (0.2, 0.3), "mass": mass}]
        self.env.reset(seed=0, options={"objects": objects})
        self.model, self.data, self.index = self.env.model, self.env.data, self.env.world.index
        self.model.geom_friction[self.index.object_geoms, 0] = friction
        self.base = np.array((-1.5, 0.0, 0.0))
        self.point = np.array((self.base[0] + 0.75, 0.0, _HEIGHT))
        self.width, self.mass, self.pitch = self.env.robot.max_opening, mass, 0.0
        self.steps(8.0)

    def change_motors(self, damping: tuple[float, ...], armature: tuple[float, ...]) -> None:
        """Give the arm's motors another damping and inertia, unless these are empty; the robot stands still."""
        if damping:
            self.model.actuator_biasprm[self.index.drive_actuators[4:], 2] = np.negative(damping)
        if armature:
            self.model.dof_armature[self.index.drive_dof[4:]] = armature
            mujoco.mj_setConst(self.model, mujoco.MjData(self.model))
        if damping or armature:
            world = self.env.world
            world.controller = JointController(self.model, self.index, self.env.robot)
            world.controller.reset(self.data)

    def step(self) -> None:
        """One control step towards base, point, pitch and width."""
        pose, cosine, sine = np.eye(4), math.cos(self.pitch), math.sin(self.pitch)
        pose[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
        pose[:3, 3] = self.point
        self.env.step(self.env.ee_action(self.base, pose, self.width))

    def steps(self, seconds: float) -> None:
        """Control steps for so long [s]."""
        for _ in range(round(20 * seconds)):
            self.step()

    def tcp(self) -> NDArray[np.float64]:
        """Position (3,) of the TCP [m]."""
        return np.array(self.data.site_xpos[self.index.tcp_site])

    def take(self) -> None:
        """Put the object between the open fingers and close them."""
        pose = self.data.qpos[self.index.object_qpos]
        pose[:3], pose[3:] = self.tcp(), (1.0, 0.0, 0.0, 0.0)
        self.data.qvel[self.index.object_dof] = 0.0
        gravity = self.model.opt.gravity.copy()
        self.model.opt.gravity[:] = 0.0
        self.width = 0.0
        self.steps(1.5)
        self.model.opt.gravity[:] = gravity
        self.steps(0.5)

    def hangs_at(self) -> float:
        """Height [m] of the object above the TCP."""
        return float(self.data.qpos[self.index.object_qpos][2] - self.tcp()[2])

    def squeeze(self) -> float:
        """Mean normal force of the two fingers on the object [N]."""
        force, total = np.empty(6), 0.0
        pads = {pad for pair in self.index.finger_geoms for pad in pair}
        for number, pair in enumerate(self.data.contact.geom.tolist()):
            if pads.intersection(pair):
                mujoco.mj_contactForce(self.model, self.data, number, force)
                total += force.item(0)
        return total / 2


def slip_rows(robot: str) -> list[tuple[str, ...]]:
    """Rows of the first table."""
    rows: list[tuple[str, ...]] = []
    for friction in (0.2, 0.4, 0.8):
        for mass in (0.1, 0.5, 2.0):
            bench, expected = Bench(robot, mass, friction), mass * _GRAVITY / 2 / friction
            bench.take()
            found = _slip_force(bench, expected)
            rows.append((f"{friction}", f"{mass}", f"{expected:.2f}", f"{found:.2f}", f"{found / expected:.2f}"))
    return rows


def _slip_force(bench: Bench, expected: float) -> float:
    """[N] of each finger at which the object begins to slip while the motors' squeeze falls by 1% a control step."""
    model, data, fingers = bench.model, bench.data, bench.index.finger_actuators
    if bench.squeeze() < expected:
        return math.nan
    while True:
        before, force = bench.hangs_at(), bench.squeeze()
        ranges = model.actuator_forcerange[fingers]
        model.actuator_forcerange[fingers] = np.clip(ranges, -0.99 * force, 0.99 * force)
        bench.step()
        if abs(bench.hangs_at() - before) * 20 > _SLIPPING or not data.ncon:
            return force


def creep_rows(robot: str, hold_s: float) -> list[tuple[str, ...]]:
    """Rows of the second table."""
    rows: list[tuple[str, ...]] = []
    for mass in (0.2, 1.0, 2.0, 5.0):
        bench = Bench(robot, mass)
        bench.take()
        before = bench.hangs_at()
        bench.steps(hold_s)
        rows.append((f"{mass}", f"{1e3 * (before - bench.hangs_at()):.2f}"))
    return rows


def touch_rows(robot: str, damping: tuple[float, ...] = (), armature: tuple[float, ...] = ()) -> list[tuple[str, ...]]:
    """Rows of the third table."""
    rows: list[tuple[str, ...]] = []
    for pitch, speed in (*((0.0, speed) for speed in (0.05, 0.12, 0.2, 0.3)), (60.0, 0.05), (60.0, 0.12)):
        bench = Bench(robot)
        bench.change_motors(damping, armature)
        bench.base = np.array((-1.05, 0.0, 0.0))
        bench.point = np.array((-0.25, 0.0, TABLE_HEIGHT + 0.25))
        bench.width, bench.pitch = 0.0, math.radians(pitch)
        bench.steps(4.0)
        bench.env.world.on_furniture = meter = Meter()
        while not bench.env.world.on_furniture.force and bench.point[2] > TABLE_HEIGHT - 0.1:
            bench.point[2] -= speed / 20
            bench.step()
        mass = effective_mass(bench)
        start = bench.tcp()
        for _ in range(10):
            bench.point = start + (0.0, 0.0, 0.05)
            bench.step()
        figures = (
            f"{mass:.1f}",
            f"{meter.peak:.0f}",
            f"{meter.force:.0f}",
            f"{meter.impulse:.2f}",
            f"{1e3 * meter.slide:.2f}",
        )
        rows.append((f"{pitch:.0f}", f"{speed}", *figures, "yes" if is_gentle(meter) else "no"))
    return rows


def effective_mass(bench: Bench) -> float:
    """Mass [kg] of the robot at the TCP along the vertical: 1 / (J M⁻¹ Jᵀ)."""
    model, data = bench.model, bench.data
    jacobian, inverse = np.zeros((3, model.nv)), np.zeros((1, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, bench.index.tcp_site)
    mujoco.mj_solveM(model, data, inverse, jacobian[2:3])
    return float(1.0 / (inverse[0] @ jacobian[2]))


def press_rows(robot: str) -> list[tuple[str, ...]]:
    """Rows of the fourth table: the net force on the table, against traction, and how hard the motors work."""
    rows: list[tuple[str, ...]] = []
    bench = Bench(robot)
    bench.base = np.array((-0.95, 0.0, 0.0))
    bench.point = np.array((-0.15, 0.0, TABLE_HEIGHT + 0.1))
    bench.width = 0.0
    bench.steps(4.0)
    while bench.point[2] > TABLE_HEIGHT - 0.05:
        bench.point[2] -= 0.002
        bench.step()
    rows.append(("the arm, downwards", *pressed(bench)))
    bench = Bench(robot)
    bench.steps(1.0)
    bench.base = np.array((0.5, 0.0, 0.0))
    bench.point = np.array((1.25, 0.0, _HEIGHT))
    bench.steps(5.0)
    rows.append(("the base, at the table's edge", *pressed(bench)))
    return rows


def pressed(bench: Bench) -> tuple[str, str, str]:
    """Net force and traction [N], and the largest share of a motor's limit, while a robot presses."""
    force, index = net_force(bench), bench.index
    limits = bench.model.actuator_forcerange[index.drive_actuators, 1]
    share = np.abs(bench.data.actuator_force[index.drive_actuators]) / limits
    traction = _TRACTION * float(bench.model.body_subtreemass[index.base_body]) * _GRAVITY
    return f"{force:.0f}", f"{traction:.0f}", f"{share.max():.2f}"


def net_force(bench: Bench) -> float:
    """Mean [N] over half a second of the net force of the robot's contacts with furniture."""
    force, sizes, reader = np.empty(6), list[float](), bench.env.world._reader
    for _ in range(10):
        bench.step()
        contacts, total = reader.read(bench.data), np.zeros(3)
        for number in contacts.of_robot:
            mujoco.mj_contactForce(bench.model, bench.data, number, force)
            total += bench.data.contact.frame[number].reshape(3, 3).T @ force[:3]
        sizes.append(float(np.linalg.norm(total)))
    return float(np.mean(sizes))


if __name__ == "__main__":
    tyro.cli(main)
