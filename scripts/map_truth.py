"""Wrong answers of `classify` and `decide`, and best bases without a free configuration, judged by MuJoCo.

    python scripts/map_truth.py --arms fetch pr2:left pr2:right tests/data/arms/panda.xml:base:tcp:z

An arm is a robot of the package by name, with the arm after a colon, or an MJCF or URDF file with base, tip and
approach axis. The judge is MuJoCo: its kinematics, and its distances between the
geoms of the pairs that count (`Shapes.pairs`).
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

import assets
from assets.robot_reading import collision_geoms
from clutter_env.reporting.tables import markdown_table
from irm import ArmChain, ExactSolver, InverseReachabilityMap, ReachabilityMap, Status, classify, decide, tcp_poses
from irm.model_reading import is_solid, load_model, load_urdf, tcp_pose_of_model
from irm.rotations import world_to_base
from irm.shapes import CLEARANCE

Floats = NDArray[np.float64]
NO, UNKNOWN, YES = (answer.value for answer in (Status.NO, Status.UNKNOWN, Status.YES))
_SAME = 1e-4
"""[m] by which a pose may differ, and a distance be smaller, before an answer counts as wrong."""


@dataclass(frozen=True)
class Judge:
    """An arm and its model: `frame` are base, tip and approach axis; `still` positions of joints that are not the
    arm's; `geoms` in the order of the chain's shapes."""

    chain: ArmChain
    model: mujoco.MjModel
    frame: tuple[str, str, str]
    still: dict[str, float]
    geoms: list[int]

    def pose(self, q: Floats) -> Floats:
        """T_base_tcp (4, 4) of a configuration (1 + n,)."""
        return tcp_pose_of_model(self.model, self.still | self._named(q), *self.frame)

    def distance(self, q: Floats) -> float:
        """[m] between the two nearest geoms of a pair that counts, 1 cm at most."""
        data = mujoco.MjData(self.model)
        for name, value in (self.still | self._named(q)).items():
            data.joint(name).qpos = value
        mujoco.mj_kinematics(self.model, data)
        pairs = [(self.geoms[i], self.geoms[j]) for i, j in self.chain.shapes.pairs.tolist()]
        near = [mujoco.mj_geomDistance(self.model, data, a, b, 0.01, None) for a, b in pairs]
        return float(min(near, default=0.01))

    def _named(self, q: Floats) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.chain.joints, q, strict=True) if name}


def judge_of(text: str) -> Judge:
    """The arm that the text names."""
    name, *rest = text.split(":")
    if Path(name).suffix in (".xml", ".urdf"):
        base, tip, approach = rest
        model = load_urdf(Path(name)) if name.endswith(".urdf") else load_model(Path(name))
        chain = ArmChain.from_mjcf(model, base, tip, approach)
        root = model.body_rootid[model.joint(chain.joints[-1]).bodyid[0]]
        mine = is_solid(model) & (model.body_rootid[model.geom_bodyid] == root)
        mine &= model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
        return Judge(chain, model, (base, tip, approach), {}, np.flatnonzero(mine)[::-1].tolist())
    robot = assets.robot(name).using(rest[0]) if rest else assets.robot(name)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    still = dict(zip(robot.still_joints, robot.still_configuration, strict=True))
    still |= dict.fromkeys(robot.finger_joints, robot.max_finger_position)
    frame = robot.base_body, robot.tcp_site, "x"
    return Judge(ArmChain.from_robot(robot), model, frame, still, collision_geoms(model, robot))


def measure(text: str, poses: int, bases: int, voxel: float) -> list[str]:
    """A row of the table."""
    judge, rng = judge_of(text), np.random.default_rng(0)
    chain = judge.chain
    start = time.process_time()
    rm = ReachabilityMap.build(chain, voxel=voxel)
    built = time.process_time() - start
    middle, half = (chain.lower + chain.upper) / 2, np.minimum((chain.upper - chain.lower) / 2, np.pi)
    Q = middle + rng.uniform(-1, 1, (poses, chain.size)) * half
    Q = Q[[judge.distance(q) > CLEARANCE for q in Q]]
    reachable = np.array([judge.pose(q) for q in Q])
    start = time.process_time()
    known = decide(rm, reachable)
    micros = (time.process_time() - start) / len(reachable) * 1e6
    random = _random_poses(chain, poses, rng)
    status, q = ExactSolver(chain, rm.grid.torso_range).solve(random)
    false_yes = sum(not _holds(judge, q[k], random[k]) for k in np.flatnonzero(status == YES))
    by_map = classify(rm, random)
    false_yes_map = int(np.count_nonzero((by_map == YES) & (status == NO)))
    false_no_map = int(np.count_nonzero(classify(rm, reachable) == NO))
    free = _best_bases(judge, rm, bases, rng)
    return [
        text.split("/")[-1],
        f"{built:.0f}",
        f"{np.count_nonzero(rm.manipulability):,}",
        f"{len(reachable):,} + {len(random):,}",
        f"{false_yes_map} / {false_no_map}",
        f"{false_yes} / {np.count_nonzero(known == NO)}",
        f"{100 * np.mean(known == UNKNOWN):.2f}%",
        f"{micros:.0f}",
        f"{free[0]} of {free[1]}",
    ]


def _holds(judge: Judge, q: Floats, T: Floats) -> bool:
    """Whether a configuration reaches a pose, free of self-collision."""
    return bool(np.abs(judge.pose(q) - T).max() < _SAME and judge.distance(q) > CLEARANCE - _SAME)


def _random_poses(chain: ArmChain, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform positions in the ball of the stretched arm, uniform rotations."""
    direction = rng.normal(size=(count, 3))
    direction *= chain.reach * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(direction, axis=1, keepdims=True)
    R, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = R * np.linalg.det(R)[:, None, None]
    T[:, :3, 3] = chain.shoulder + (0.0, 0.0, (chain.lower[0] + chain.upper[0]) / 2) + direction
    return T


def _best_bases(judge: Judge, rm: ReachabilityMap, wanted: int, rng: np.random.Generator) -> tuple[int, int]:
    """How many of the best bases of random heights and pitches have a free configuration, without any floor plan."""
    inverse_map, solver = InverseReachabilityMap(rm), ExactSolver(judge.chain, rm.grid.torso_range)
    free = asked = 0
    for pitch in itertools.islice(itertools.cycle(np.unique(rm.grid.orientations.pitch).tolist()), 4 * wanted):
        if asked == wanted:
            break
        point = np.array([0.0, 0.0, rng.uniform(rm.grid.bottom, rm.grid.top - 1e-6)])
        found = inverse_map.query(point, pitch=pitch)
        if not len(found):
            continue
        T = world_to_base(found.poses[0]) @ tcp_poses(point, float(found.approach_yaw[0]), pitch)
        status, q = solver.solve(T)
        asked += 1
        free += bool(status[0] == YES and _holds(judge, q[0], T[0]))
    return free, asked


def main(
    arms: tuple[str, ...] = ("fetch", "pr2:left", "pr2:right"),
    poses: int = 10_000,
    bases: int = 200,
    voxel: float = 0.05,
) -> None:
    """Measure, and print a row for each arm.

    Args:
        arms: robots of the package, NAME or NAME:ARM, or files, FILE:BASE:TIP:APPROACH.
        poses: random configurations, and random poses.
        bases: TCP poses whose best base is judged.
        voxel: edge of the map's cells [m].
    """
    head = ["arm", "build [s]", "free cells", "poses", "map: false YES / NO", "`decide`: false YES / NO"]
    head += ["UNKNOWN of reachable", "µs", "best bases with a free configuration"]
    print(markdown_table(head, [measure(arm, poses, bases, voxel) for arm in arms]))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
