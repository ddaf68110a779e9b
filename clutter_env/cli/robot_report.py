"""Check of a robot behind `clutter-env robot check`: its data against its MJCF file, its reach, a picture of both."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from assets import RobotSpec
from assets.robot_motors import ASSUMED, payload_of
from assets.robot_shapes import SUNK, lowest_height
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import START_DISTANCE, TABLE_HEIGHT
from clutter_env.scene.object_sets import OBJECT_SETS
from clutter_env.simulation.robot_check import check_robot
from irm import (
    CLOSED_FORM,
    ITERATIVE,
    PARALLEL,
    SPHERICAL,
    ArmChain,
    all_solutions,
    fk_frames,
    forward,
    free_angles,
    link_origins,
    pose_of,
    solver_arrays,
)
from planners import (
    CYLINDER,
    CollisionWorld,
    GeometryError,
    RobotArrays,
    RobotState,
    Scene,
    gripper_clearances,
    robot_arrays,
)

Array = NDArray[np.float64]

_LEVEL = 0.999
"""Smallest cosine between the vertical and the level gripper's z axis."""
_ABOVE_OBJECTS = 0.28
"""[m] of the TCP at home above the table at least: the highest objects, and the lower end of one that is held."""
_HEAVIEST = OBJECT_SETS["standard"].mass[1]
"""[kg] of the standard objects."""
_METHODS = {
    CLOSED_FORM: "the closed form of Fetch's arm",
    SPHERICAL: "closed form: three axes meet in a point",
    PARALLEL: "closed form: three axes are parallel",
    ITERATIVE: "iteration: no closed form is known for this arm, so planning is slow",
}
_STEP = 0.05
"""[m] between gripper positions that are tried."""
_TORSOS, _ANGLES = 6, 18
"""Values of the free parameters that are tried."""
_HOME_HEIGHTS = (0.35, 0.40, 0.45)
"""[m] of the TCP at home above the table: above the objects on it, with one in the gripper."""
_ELBOW_ABOVE = 0.05
"""[m] An elbow that much above the TCP keeps the forearm off the table."""
_TORSO_WEIGHT = 5.0
"""[rad/m] Weight of a metre of the torso relative to a radian of a joint."""
_OFF_THE_TABLE = 0.004
"""[m] Least distance between the gripper and the table. The planner keeps 2 mm."""
_TOUCHING = 0.002
"""[m] between shapes that touch: the planner's padding."""
_TRIED = 200
"""Configurations that are tested for contacts."""
_BOARD = 0.05
"""[m] Thickness of a table."""
_STILL = 0.002
"""[m] The stroke of a lift that is none."""
_AXIS = 0.08
"""[m] Length of a drawn axis."""
_COLOURS = ("tab:red", "tab:green", "tab:blue")


@dataclass(frozen=True)
class RobotReport:
    """Facts about a robot by name, problems to be fixed, and its reach. The reach is None if its files could not be
    read."""

    name: str
    facts: dict[str, str]
    problems: tuple[str, ...]
    reach: LevelReach | None = None

    def facts_text(self) -> str:
        """The name, and facts, one a line."""
        return "\n".join([self.name, *(f"  {name}: {value}" for name, value in self.facts.items())])

    def problems_text(self) -> str:
        """Problems, one a line."""
        return "\n".join(f"  PROBLEM: {problem}" for problem in self.problems) or "  no problem found"


def report_of(robot: RobotSpec, table: float = TABLE_HEIGHT) -> RobotReport:
    """Compare the data with the file, and check what environments and planner need at a table of some height [m]."""
    try:
        check_robot(robot)
        robot_arrays(robot)
    except (ConfigError, GeometryError) as problem:
        return RobotReport(robot.name, {}, (str(problem),))
    model, reach = mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), level_reach(robot, table)
    return RobotReport(robot.name, _facts(robot, model, reach), tuple(_problems(robot, model, reach, table)), reach)


def _facts(robot: RobotSpec, model: mujoco.MjModel, reach: LevelReach) -> dict[str, str]:
    chain, gripper = ArmChain.from_robot(robot), gripper_clearances(robot)
    tcp, stroke = forward(chain, robot.home)[:3, 3], float(chain.upper[0] - chain.lower[0])
    ahead = {"level": reach.straight_ahead, "tilted by 60°": reach.tilted, "from above": reach.from_above}
    reaches = ", ".join(
        f"{name} {f'x = {x.min():.2f} to {x.max():.2f} m' if x.size else 'none'}" for name, x in ahead.items()
    )
    return {
        "arm": f"{chain.size - 1} joints, {_METHODS[solver_arrays(chain).kind]}",
        "lift": f"{robot.chain[0].joint}, {chain.lower[0]:.3g} to {chain.upper[0]:.3g} m"
        if stroke > _STILL
        else "none",
        "gripper": f"opens to {robot.max_opening:.3f} m, palm {1000 * gripper.palm_reach:.0f} mm behind the TCP",
        "motors": _motors(robot, model),
        "base": f"{robot.base_drive}, radius {robot.base_radius:.3f} m, height {robot.base_height:.3f} m",
        "home": f"TCP at ({', '.join(f'{value:.3f}' for value in tcp)}) m",
        "grasps at the table, straight ahead": reaches,
        "cameras": ", ".join(robot.cameras) or "none: no image observations",
    }


def _motors(robot: RobotSpec, model: mujoco.MjModel) -> str:
    """The payload of the stretched arm, and the assumed torques."""
    held = payload_of(model, robot.arm_joints, robot.tcp_site)
    if held is None:
        return "no limits in the file"
    first = f"{held.joint!r} has {held.limit:.3g} N m"
    said = f"hold {held.kg:.2g} kg with the arm stretched out ({first})"
    if held.kg < _HEAVIEST:
        arm = "the arm alone" if held.kg < 0.0 else f"the arm with the {_HEAVIEST} kg of the heaviest standard object"
        said = (
            f"do not hold {arm} stretched out ({first}); where springs or counterweights bear the arm, as gravcomp "
            f"does in a simulation, they hold {held.weightless_kg:.2g} kg"
        )
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, ASSUMED)
    if number < 0:
        return said
    names = bytes(model.text_data)[model.text_adr[number] :].split(b"\0", 1)[0].decode()
    return f"{said}; assumed, since the arm's file gives none: {names}"


def _problems(robot: RobotSpec, model: mujoco.MjModel, reach: LevelReach, table: float) -> Iterator[str]:
    servos = {name: model.actuator(name) for name in (*robot.drive_joints, *robot.finger_joints, *robot.head_joints)}
    if wrong := [n for n, a in servos.items() if a.gainprm[0] <= 0 or not np.isclose(a.biasprm[1], -a.gainprm[0])]:
        yield f"actuators that are not position servos: {', '.join(wrong)}"
    if sinking := [model.body(body).name for body in range(1, model.nbody) if model.body_gravcomp[body] != 1.0]:
        yield f"bodies without gravcomp=1: {', '.join(sinking)}"
    pairs = [{int(a), int(b)} for a, b in zip(model.eq_obj1id, model.eq_obj2id, strict=True)]
    if {model.joint(name).id for name in robot.finger_joints} not in pairs:
        yield "no joint equality couples the fingers"
    pads = [model.geom(name) for name in robot.finger_geoms]
    if soft := [pad.name for pad in pads if pad.condim[0] < 4 or pad.priority[0] < 1]:
        yield f'pads without condim="4" priority="1", from which objects slip: {", ".join(soft)}'
    T = forward(ArmChain.from_robot(robot), robot.home)
    if T[2, 2] < _LEVEL or T[0, 0] < _LEVEL:
        x_axis = np.round(T[:3, 0], 3).tolist()
        yield f"home: the gripper is not level and straight ahead; its x axis is {x_axis}"
    if T[2, 3] < table + _ABOVE_OBJECTS:
        yield f"home: the TCP is {T[2, 3]:.2f} m high; objects need {table + _ABOVE_OBJECTS:.2f} m"
    world = _Arm(robot).world
    if touched := world.names_of(world.hits(np.zeros(3), robot.home, robot.max_opening)):
        yield f"home: the robot touches {' and '.join(touched)}"
    if robot.max_opening <= (widest := 2 * OBJECT_SETS["standard"].radius[1]):
        yield f"the gripper opens to {robot.max_opening:.3f} m; standard objects are up to {widest:.3f} m wide"
    if (palm := gripper_clearances(robot).palm_reach) < (thinnest := OBJECT_SETS["standard"].radius[0]):
        where = f"{1000 * palm:.0f} mm behind" if palm > 0 else f"{-1000 * palm:.0f} mm ahead of"
        yield (
            f"the palm is {where} the TCP, and objects of {1000 * thinnest:.0f} mm radius and more are to be between: "
            f"move the tip ahead; with `robot make`: {1000 * (thinnest - palm):.0f} mm more of --tool"
        )
    held = payload_of(model, robot.arm_joints, robot.tcp_site)
    if held is not None and held.weightless_kg < _HEAVIEST:
        yield (
            f"the motors hold {held.weightless_kg:.2g} kg at the TCP, even if nothing but that weighs on them; "
            f"standard objects weigh up to {_HEAVIEST} kg"
        )
    for name, ahead in _in_the_table(robot, model, table):
        yield (
            f"{name!r} does not move with the arm and reaches {ahead:.2f} m ahead at the height of the table, which "
            f"begins {START_DISTANCE[0]} m ahead of where robots start: leave it out (`robot make --without`), or hold "
            "it elsewhere"
        )
    for name, depth in _below_ground(model):
        yield f"{name!r} is {1000 * depth:.1f} mm below the ground: raise what stands on the base"
    if robot.grasp_height < (least := least_grasp_height(robot)):
        yield f"grasp_height: with {robot.grasp_height} m the gripper nears the table: level grasps need {least}"
    farthest = max(x.max(initial=0.0) for x in (reach.straight_ahead, reach.tilted, reach.from_above))
    front = max((x for x, _ in robot.base_outline), default=robot.base_radius)
    if farthest < front + 0.3:
        yield "no grasp reaches 0.3 m beyond the base at the table's height"


def _in_the_table(robot: RobotSpec, model: mujoco.MjModel, table: float) -> Iterator[tuple[str, float]]:
    """Bodies that do not move with the arm and are in the table where the robot starts, and how far ahead they are [m].

    A geom is included with the box around it if this box reaches below the table's top but not wholly below its board.
    """
    data = mujoco.MjData(model)
    for joint, value in zip(
        (*robot.drive_joints[3:], *robot.still_joints), (*robot.home, *robot.still_configuration), strict=True
    ):
        data.qpos[model.joint(joint).qposadr] = value
    mujoco.mj_kinematics(model, data)
    ahead: dict[str, float] = {}
    for geom, link in zip(robot.collision_geoms(model), robot.shapes.link.tolist(), strict=True):
        R, half = data.geom_xmat[geom].reshape(3, 3), model.geom_aabb[geom, 3:]
        centre, extent = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3], np.abs(R) @ half
        low, high = centre[2] - extent[2], centre[2] + extent[2]
        if link <= 0 and low < table and high > table - _BOARD:
            name = model.body(model.geom_bodyid[geom]).name
            ahead[name] = max(ahead.get(name, 0.0), float(centre[0] + extent[0]))
    return ((name, x) for name, x in ahead.items() if x > START_DISTANCE[0])


def _below_ground(model: mujoco.MjModel) -> Iterator[tuple[str, float]]:
    """Bodies of the robot, its joints at 0, that reach below the ground, and how far [m]."""
    data, bodies = mujoco.MjData(model), dict[str, float]()
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    for geom in np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0)):
        if int(model.body_weldid[model.geom_bodyid[geom]]) == int(model.body_rootid[model.geom_bodyid[geom]]):
            name, depth = model.body(model.geom_bodyid[geom]).name, -lowest_height(model, data, int(geom))
            bodies[name] = max(bodies.get(name, 0.0), depth)
    return ((name, depth) for name, depth in bodies.items() if depth > SUNK)


def least_grasp_height(robot: RobotSpec) -> float:
    """Height [m] of the TCP above the table in level grasps at which the last link clears the table, rounded up to 5
    mm."""
    shapes, last = robot.shapes, robot.shapes.link == len(robot.chain) - 1
    up = robot.tcp_rotation[:, 2]
    below = (np.array(robot.tcp_offset) - shapes.position[last]) @ up + shapes.radius[last]
    below += (np.abs(up @ shapes.rotation[last]) * shapes.half[last]).sum(axis=1)
    return math.ceil((float(below.max()) + _OFF_THE_TABLE) * 200) / 200


class LevelReach(NamedTuple):
    """TCP positions x, y, z [m] in the base frame, and those that a level gripper, yaw 0, reaches: (nx, ny, nz).

    The robot has no self-collision there. `tilted` and `from_above` are x straight ahead of other grasps on the table.
    """

    x: Array
    y: Array
    z: Array
    reached: NDArray[np.bool_]
    tilted: Array
    from_above: Array

    @property
    def straight_ahead(self) -> Array:
        """(k,) [m] x straight ahead at the height of a grasp on the table."""
        return np.asarray(self.x[self.reached[:, self.y.size // 2, self.z.size // 2]])


class HomeCandidate(NamedTuple):
    """A configuration `q` (1 + n,) with a level gripper, and its mean distance to grasps [rad]."""

    q: Array
    distance: float


class _Arm:
    """All configurations of a robot for a TCP pose, without those in which it touches itself."""

    def __init__(self, robot: RobotSpec) -> None:
        self.chain = ArmChain.from_robot(robot)
        self.solver = solver_arrays(self.chain)
        self.angles = free_angles(self.chain, _ANGLES)
        self.torsos = np.unique(np.linspace(self.chain.lower[0], self.chain.upper[0], _TORSOS))
        state = RobotState(np.zeros(3), np.array(robot.home), robot.max_finger_position)
        self.world = CollisionWorld.from_scene(Scene(robot, state, (), ()))
        self.opening = robot.max_opening

    def configurations(self, x: float, y: float, z: float, pitch: float = 0.0, yaw: float = 0.0) -> Array:
        """(k, 1 + n) for a TCP at a place [m] with a pitch and a yaw [rad]."""
        c, s, d, level = np.cos(yaw), np.sin(yaw), np.sin(pitch), np.cos(pitch)
        T = [[c * level, -s, c * d, x], [s * level, c, s * d, y], [-d, 0.0, level, z], [0.0, 0.0, 0.0, 1.0]]
        return all_solutions(self.chain, np.array(T), self.torsos, self.angles)

    def free(self, Q: Array) -> NDArray[np.bool_]:
        """(k,) whether the robot does not touch itself or the floor in configurations (k, 1 + n)."""
        return np.asarray(self.world.hits_many(np.zeros(3), Q, self.opening) == 0)

    def straight_ahead(
        self, x: float, z: float, pitch: float = 0.0, yaw: float = 0.0, elbow: float = _ELBOW_ABOVE
    ) -> Array:
        """Those whose elbow is so far above the TCP [m], with joints that go round in [-π, π]."""
        found = self.configurations(x, 0.0, z, pitch, yaw)
        heights = np.array([link_origins(self.chain, q)[[self.solver.elbow, -1], 2] for q in found]).reshape(-1, 2)
        is_high = heights[:, 0] - heights[:, 1] > elbow
        turned = (found + np.pi) % (2 * np.pi) - np.pi
        goes_round = self.chain.upper - self.chain.lower > 2 * np.pi
        return np.asarray(np.where(goes_round, turned, found)[is_high])


def level_reach(robot: RobotSpec, table: float = TABLE_HEIGHT) -> LevelReach:
    """Region that the level gripper of a robot reaches straight ahead, around grasps on a table of some height [m]."""
    arm = _Arm(robot)
    height = table + robot.grasp_height
    x, y = np.arange(0.3, 1.301, _STEP), np.arange(-0.8, 0.801, 2 * _STEP)
    z = np.array([height - 0.4, height - 0.2, height, height + 0.2, height + 0.4])
    reached = np.zeros((x.size, y.size, z.size), dtype=np.bool_)
    for i, j, k in np.ndindex(reached.shape):
        found = arm.configurations(float(x[i]), float(y[j]), float(z[k]))
        reached[i, j, k] = bool(len(found)) and bool(arm.free(found).any())
    others = [
        np.array([place for place in x if arm.free(arm.configurations(float(place), 0.0, table + up, pitch)).any()])
        for pitch, up in ((np.pi / 3, 0.06), (np.pi / 2, 0.08))
    ]
    return LevelReach(x, y, z, reached, *others)


def home_candidates(robot: RobotSpec, count: int = 3, table_height: float = TABLE_HEIGHT) -> list[HomeCandidate]:
    """Configurations for `home`, best first: near to the grasps of objects on a table [m], with a high elbow.

    The present home of the robot does not matter.
    """
    arm, table = _Arm(robot), table_height + robot.grasp_height
    for elbow in (_ELBOW_ABOVE, -np.inf):  # of an arm that stands low, the elbow may be anywhere
        goals = [
            found
            for pitch, height in ((0.0, table), (np.pi / 3, table + 0.06), (np.pi / 2, table + 0.08))
            for x in (0.6, 0.75, 0.9)
            for yaw in (-0.5, 0.0, 0.5)
            if len(found := arm.straight_ahead(x, height, pitch, yaw, elbow))
        ]
        candidates = []
        for x in np.arange(0.45, 0.76, _STEP):
            for z in _HOME_HEIGHTS:
                found = arm.straight_ahead(float(x), table_height + z, elbow=elbow)
                candidates += list(found[arm.free(found)]) if len(found) else []
        if candidates and goals:
            break
    weight = np.array([_TORSO_WEIGHT, *[1.0] * (arm.chain.size - 1)])
    rated = [
        HomeCandidate(q, float(np.mean([np.linalg.norm((goal - q) * weight, axis=1).min() for goal in goals])))
        for q in (candidates if goals else [])
    ]
    return sorted(rated, key=lambda candidate: candidate.distance)[:count]


def why_no_home(robot: RobotSpec, table: float) -> str:
    """The reason why `home_candidates` finds none: grasps out of reach, or which bodies touch, and what to do."""
    arm, ahead = _Arm(robot), (0.45, 0.6, 0.75)
    places = [(0.0, robot.grasp_height), (np.pi / 3, 0.06), (np.pi / 2, 0.08)]
    grasps = np.concatenate([arm.configurations(x, 0.0, table + z, pitch) for pitch, z in places for x in ahead])
    homes = np.concatenate([arm.configurations(x, 0.0, table + z) for z in _HOME_HEIGHTS for x in ahead])
    where, low, high = f"a table of {table} m, {ahead[0]} to {ahead[-1]} m ahead", _HOME_HEIGHTS[0], _HOME_HEIGHTS[-1]
    cure = "try another height or place (--on), a lift (--lift 0 0.4), a longer --tool, or another --table"
    if not len(grasps):
        return f"the arm reaches no grasp on {where}; {cure}"
    if not len(homes):
        return f"the arm reaches grasps on {where}, but with a level gripper nothing {low} to {high} m above it; {cure}"
    Q = np.concatenate([grasps, homes])
    most = _most_often_touching(robot, Q)
    reason = f"most often these touch: {most}" if most else "none has a level gripper straight ahead of the base"
    return (
        f"{int(arm.free(Q).sum())} of {len(Q)} configurations for grasps and homes touch neither the robot itself nor "
        f"the ground; {reason}. Where boxes in place of meshes touch but the robot does not, say --apart BODY BODY; "
        "else try another height or place (--on), or a lift (--lift 0 0.4)"
    )


def _most_often_touching(robot: RobotSpec, Q: Array) -> str:
    """The three pairs of bodies, the ground among them, that touch most often in configurations (k, 1 + n)."""
    model, counts = mujoco.MjModel.from_xml_path(str(robot.mjcf_path)), Counter[tuple[str, str]]()
    data, geoms = mujoco.MjData(model), np.array(robot.collision_geoms(model))
    above = geoms[robot.shapes.link >= 0]
    tried = Q[:: 1 + len(Q) // _TRIED]

    def name(geom: int) -> str:
        return str(model.body(model.geom_bodyid[geom]).name)

    for q in tried:
        data.qpos[[model.joint(link.joint).qposadr[0] for link in robot.chain]] = q
        mujoco.mj_kinematics(model, data)
        touching = {
            (min(name(one), name(other)), max(name(one), name(other)))
            for one, other in geoms[robot.shapes.pairs].tolist()
            if mujoco.mj_geomDistance(model, data, one, other, 0.01, None) < _TOUCHING
        }
        low = {(name(geom), "the ground") for geom in above.tolist() if lowest_height(model, data, geom) < _TOUCHING}
        # What is counted first stands first among equals, in the same order each time.
        counts.update([*sorted(low), *sorted(touching)])
    return ", ".join(f"{one} and {other} ({count / len(tried):.0%})" for (one, other), count in counts.most_common(3))


def draw_robot(robot: RobotSpec, reach: LevelReach, file: Path) -> None:
    """Write one page: the robot at home from two sides, and the reach of its level gripper from above, by height."""
    figure = Figure(figsize=(13, 10))
    parts: Any = figure.subfigures(2, 1, height_ratios=(2.6, 1))
    above, below = parts
    chain = ArmChain.from_robot(robot)
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    fk_frames(chain.offsets, chain.axes, chain.tip, np.array(robot.home), R, p)
    frames = [pose_of(np.concatenate([p[k], R[k].ravel()])) for k in range(chain.size + 1)]
    above.suptitle(
        f"{robot.name} at home: collision shapes of base (grey), arm (blue) and gripper (orange); dashed: the table\n"
        "frames of the joints and of the TCP: x red, y green, z blue; between the fingers x must point ahead, y across"
    )
    x, y, z = (0.45, 0.9, 0.9, 0.45, 0.45), (0.7, 0.7, -0.7, -0.7, 0.7), reach.z[reach.z.size // 2] - robot.grasp_height
    for column, (elevation, azimuth) in enumerate(((18, -60), (0, -90))):
        axes: Any = above.add_axes((0.02 + 0.48 * column, -0.02, 0.48, 0.98), projection="3d", proj_type="ortho")
        axes.plot(x, y, z, color="0.3", linestyle="--", linewidth=1.0)
        _draw_shapes(axes, robot_arrays(robot), frames)
        for T in frames:
            for direction, colour in zip(T[:3, :3].T, _COLOURS, strict=True):
                axes.plot(*np.transpose([T[:3, 3], T[:3, 3] + _AXIS * direction]), color=colour, linewidth=1.5)
        axes.set_box_aspect((1, 1, 1.1), zoom=1.0 + 0.25 * column)
        axes.set(xlim=(-0.7, 0.9), ylim=(-0.8, 0.8), zlim=(0, 1.76), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
        axes.view_init(elevation, azimuth)
        if elevation == 0:
            axes.set(yticks=[], ylabel="")
    turn, count = np.linspace(0, 2 * np.pi, 60), reach.z.size
    outline = (
        np.array(robot.base_outline) if robot.base_outline else robot.base_radius * np.c_[np.cos(turn), np.sin(turn)]
    )
    outline = np.concatenate([outline, outline[:1]])
    for k, height in enumerate(reach.z):
        plan = below.add_subplot(1, count, k + 1)
        plan.pcolormesh(reach.y, reach.x, reach.reached[:, :, k], cmap="Greens", vmin=0, vmax=1.4, shading="nearest")
        plan.plot(*outline[:, ::-1].T, color="black")
        plan.set(xlim=(0.85, -0.85), ylim=(-0.35, 1.35), aspect="equal", xlabel="y [m]")
        plan.set_title(f"level gripper at {height:.2f} m", fontsize=9)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)


def _draw_shapes(axes: Any, arrays: RobotArrays, frames: list[Array]) -> None:
    """Draw the collision shapes. `frames` (4, 4) are those of all joints and of the TCP, in the base frame."""
    for solid in range(arrays.core.size):
        link = int(arrays.link[solid])
        T = np.eye(4) if link < 0 else frames[link]
        T = T @ pose_of(np.concatenate([arrays.position[solid], arrays.rotation[solid].ravel()]))
        colour = "0.35" if link < 0 else ("tab:orange" if link == len(frames) - 2 else "steelblue")
        for line in _outline(arrays, solid):
            axes.plot(*(line @ T[:3, :3].T + T[:3, 3]).T, color=colour, linewidth=0.6)


def _outline(arrays: RobotArrays, solid: int) -> Iterator[Array]:
    """Lines (n, 3) of a solid in its own frame: rings about its axis, and four lines along it."""
    (a, b, c), radius = arrays.half[solid], float(arrays.radius[solid])
    is_round = radius > 0.0 or arrays.core[solid] == CYLINDER
    turn = np.linspace(0, 2 * np.pi, 17) if is_round else np.pi * np.array([0.25, 0.75, 1.25, 1.75, 0.25])
    size = (radius or a) if is_round else np.sqrt(2) * np.array([a, b])
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) * size
    for share in (1.0, 0.7) if radius > 0.0 else (1.0,):  # the smaller ones are on round ends
        for end in (-1, 1):
            height = end * (c + np.sqrt(1 - share**2) * radius)
            yield np.column_stack([share * ring, np.full(len(ring), height)])
    for x, y in ring[: -1 : len(ring) // 4]:
        yield np.array([[x, y, -c], [x, y, c]])
