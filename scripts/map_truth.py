"""Wrong answers of `classify` and `decide`, and best bases without a free configuration, judged by MuJoCo; beside a map
in four dimensions as RM4D (Rudorfer 2024) and the same map filled by random configurations alone.

    pip download --no-deps robosuite==1.5.2 dm_control robosuite-models gymnasium-robotics -d wheels   # unzip all four
    python scripts/map_truth.py --wheels wheels --arms panda ur5e --out outputs/truth   # a file for each arm
    python scripts/map_truth.py --arms --out outputs/truth                              # the tables of all files there

The models are read as they come. The judge is MuJoCo: its kinematics, and its distances between the geoms of the pairs
that count (`Shapes.pairs`). The two other maps have the same CPU time and memory, and say YES in a cell that a
random configuration free of self-collision has reached.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.reporting.tables import markdown_table
from irm import (
    ArmChain,
    ExactSolver,
    InverseReachabilityMap,
    ReachabilityMap,
    SelfCollision,
    Status,
    classify,
    decide,
    tcp_poses,
)
from irm.chain import chain_arrays
from irm.grid import nearest_orientation
from irm.ik.numerical import random_seeds
from irm.map_kernels import tcp_frames
from irm.model_reading import load_model, load_urdf, tip_frame
from irm.rotations import world_to_base
from irm.self_contact import CLEARANCE, is_solid

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int64]
Place = Callable[[Floats, Floats], tuple[Integers, Bools]]
"""The cells (n, 4) that orientations and positions are in, and whether a map has them."""
NO, UNKNOWN, YES = (answer.value for answer in (Status.NO, Status.UNKNOWN, Status.YES))
_SAME = 1e-4
"""[m] by which a pose may differ, and a distance be smaller, before an answer counts as wrong."""
_ASKED = 2_000
"""Random poses that `decide` is asked for; the exact solver, which it asks, is asked for all."""
_MANY = 20_000
"""Random configurations at a time."""


class Arm(NamedTuple):
    """A model in a pip package, and the frames between which the arm is."""

    file: str
    base: str
    tip: str
    approach: str


_SUITE, _MORE = "robosuite/models/assets/robots", "robosuite_models/assets/robots"
ARMS = {
    "fetch": Arm("gymnasium_robotics/envs/assets/fetch/reach.xml", "robot0:base_link", "robot0:grip", "x"),
    "pr2 left": Arm(f"{_MORE}/pr2/robot.xml", "base", "left_hand", "x"),
    "pr2 right": Arm(f"{_MORE}/pr2/robot.xml", "base", "right_hand", "x"),
    "panda": Arm(f"{_SUITE}/panda/robot.xml", "base", "right_hand", "z"),
    "ur5e": Arm(f"{_SUITE}/ur5e/robot.xml", "base", "right_hand", "z"),
    "iiwa": Arm(f"{_SUITE}/iiwa/robot.xml", "base", "right_hand", "z"),
    "xarm7": Arm(f"{_SUITE}/xarm7/robot.xml", "base", "right_hand", "z"),
    "jaco6": Arm("dm_control/third_party/kinova/jaco_arm.xml", "b_base", "wristsite", "z"),
    "jaco7": Arm(f"{_SUITE}/jaco/robot.xml", "base", "right_hand", "z"),
    "sawyer": Arm(f"{_SUITE}/sawyer/robot.xml", "base", "right_hand", "z"),
    "baxter": Arm(f"{_SUITE}/baxter/robot.xml", "base", "right_hand", "z"),
    "gen3": Arm(f"{_SUITE}/kinova3/robot.xml", "base", "right_hand", "z"),
    "tiago": Arm(f"{_SUITE}/tiago/robot.xml", "base", "right_hand", "z"),
}


class Judge:
    """An arm of a model, and MuJoCo's word on it."""

    def __init__(self, wheels: Path, arm: Arm) -> None:
        path = wheels / arm.file
        self.model = load_urdf(path) if path.suffix == ".urdf" else load_model(path)
        self.chain = ArmChain.from_mjcf(self.model, arm.base, arm.tip, arm.approach)
        model, data = self.model, mujoco.MjData(self.model)
        mujoco.mj_kinematics(model, data)
        columns = [int(model.joint(name).qposadr[0]) for name in self.chain.joints if name]
        data.qpos[columns] = 0.0
        self._data, self._columns = data, columns
        sites = [model.site(k).name for k in range(model.nsite)]
        body = int(model.site(arm.tip).bodyid[0]) if arm.tip in sites else int(model.body(arm.tip).id)
        self._bodies = [int(model.body(arm.base).id), body]
        self._T_body_tcp = tip_frame(model, body, arm.tip, arm.approach)
        root = model.body_rootid[model.joint(self.chain.joints[-1]).bodyid[0]]
        mine = is_solid(model) & (model.body_rootid[model.geom_bodyid] == root)
        mine &= model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
        geoms = np.flatnonzero(mine)[::-1].tolist()
        self._pairs = [(geoms[i], geoms[j]) for i, j in self.chain.shapes.pairs.tolist()]

    def pose(self, q: Floats) -> Floats:
        """T_base_tcp (4, 4) of a configuration (1 + n,)."""
        data, poses = self._data, np.tile(np.eye(4), (2, 1, 1))
        data.qpos[self._columns] = q[-len(self._columns) :]
        mujoco.mj_kinematics(self.model, data)
        poses[:, :3, :3], poses[:, :3, 3] = data.xmat[self._bodies].reshape(2, 3, 3), data.xpos[self._bodies]
        return np.asarray(np.linalg.inv(poses[0]) @ poses[1] @ self._T_body_tcp)

    def is_free(self, q: Floats, clearance: float = CLEARANCE) -> bool:
        """Whether all geoms of the pairs that count keep a clearance [m]."""
        self._data.qpos[self._columns] = q[-len(self._columns) :]
        mujoco.mj_kinematics(self.model, self._data)
        return all(
            mujoco.mj_geomDistance(self.model, self._data, a, b, 2 * clearance, None) > clearance
            for a, b in self._pairs
        )

    def reaches(self, q: Floats, T: Floats) -> bool:
        """Whether a configuration reaches a pose."""
        return bool(np.abs(self.pose(q) - T).max() < _SAME)

    def holds(self, q: Floats, T: Floats) -> bool:
        """Whether a configuration reaches a pose, free of self-collision."""
        return self.reaches(q, T) and self.is_free(q, CLEARANCE - _SAME)


def measure(judge: Judge, poses: int, bases: int, voxel: float) -> dict[str, Any]:
    """Counts and times of one arm."""
    chain, rng = judge.chain, np.random.default_rng(0)
    ReachabilityMap.build(chain, voxel=0.25, orientations=6, samples=1000)  # compiles
    start = time.process_time()
    rm = ReachabilityMap.build(chain, voxel=voxel)
    built = time.process_time() - start
    middle, half = (chain.lower + chain.upper) / 2, np.minimum((chain.upper - chain.lower) / 2, np.pi)
    Q = middle + rng.uniform(-1, 1, (poses, chain.size)) * half
    Q = Q[[judge.is_free(q) for q in Q]]
    reachable, random = np.array([judge.pose(q) for q in Q]), random_poses(chain, poses, rng)
    decide(rm, random[:10])
    start = time.process_time()
    known, decided = decide(rm, reachable), decide(rm, random[:_ASKED])
    micros = (time.process_time() - start) / (len(reachable) + len(decided)) * 1e6
    status, q = ExactSolver(chain, rm.grid.torso_range).solve(random)
    by_map, by_map_known = classify(rm, random), classify(rm, reachable)
    memory = sum(column.nbytes for column in rm.packed if isinstance(column, np.ndarray))
    *best, query = _best_bases(judge, rm, bases, rng)
    answers: dict[str, Any] = {
        "build": built,
        "memory": memory / 1e6,
        "poses": [len(reachable), len(random)],
        "decide": {
            "false_yes": sum(not judge.holds(q[k], random[k]) for k in np.flatnonzero(status == YES)),
            "contradicts": int(np.count_nonzero(np.abs(decided - status[: len(decided)]) == YES - NO)),
            "false_no": int(np.count_nonzero(known == NO)),
            "unknown_reachable": float(np.mean(known == UNKNOWN)),
            "unknown_random": float(np.mean(status == UNKNOWN)),
            "micros": micros,
        },
        "classify": [
            int(np.count_nonzero((by_map == YES) & (status == NO))),
            int(np.count_nonzero(by_map_known == NO) + np.count_nonzero((by_map == NO) & (status == YES))),
        ],
        "bases": best,
        "query": query,
    }
    truth = status != UNKNOWN
    grid, rm4d = np.zeros(rm.grid.shape, dtype=bool), FourDimensions(chain, rm, memory)
    for R, p in _free_poses(chain, rm, built):
        index, inside = _cells_of(rm, R, p)
        grid[tuple(index[inside].T)] = True
        index, inside = rm4d.place(R, p)
        rm4d.cells[tuple(index[inside].T)] = True
    for name, place, cells in (
        ("map", partial(_cells_of, rm), rm.reachable),
        ("rm4d", rm4d.place, rm4d.cells),
        ("sampled", partial(_cells_of, rm), grid),
    ):
        said, known_to = _ask(place, cells, random[truth]), _ask(place, cells, reachable)
        right, out_of_reach = float(np.mean(said == (status[truth] == YES))), status[truth] == NO
        answers[name] = [right, float(np.mean(said[out_of_reach])), float(1.0 - np.mean(known_to))]
    return answers


def _ask(place: Place, cells: Bools, T: Floats) -> Bools:
    """Answers for poses (n, 4, 4) by the cells that they are in."""
    index, inside = place(T[:, :3, :3], T[:, :3, 3])
    answers = np.zeros(len(T), dtype=bool)
    answers[inside] = cells[tuple(index[inside].T)]
    return answers


def _cells_of(rm: ReachabilityMap, R: Floats, p: Floats) -> tuple[Integers, Bools]:
    """(n, 4) cells of poses, and (n,) whether the map has them."""
    grid = rm.grid
    x, y = (np.floor((p[:, k] - grid.centre[k]) / grid.voxel) + grid.half for k in (0, 1))
    z = np.floor((p[:, 2] - grid.bottom) / grid.thickness)
    index = np.column_stack([z, nearest_orientation(grid.orientations, R), x, y]).astype(np.int64)
    return index, np.all((index >= 0) & (index < grid.shape), axis=1)


def _free_poses(chain: ArmChain, rm: ReachabilityMap, seconds: float) -> Any:
    """TCP orientations and positions of random configurations free of self-collision, for some CPU time."""
    rng, arrays, is_free = np.random.default_rng(1), chain_arrays(chain), SelfCollision(chain)
    end = time.process_time() + seconds
    while time.process_time() < end:
        q = random_seeds(chain, _MANY, 0.0, rng)
        q[:, 0] = rng.uniform(*rm.grid.torso_range, _MANY)
        yield tcp_frames(arrays, q[is_free.of(q)])


class FourDimensions:
    """As RM4D: cells of height, angle between approach and vertical, and x, y of the arm's first axis as the gripper
    sees it. Rolls, and the range of the first joint, do not count. One byte a cell, in the given memory."""

    def __init__(self, chain: ArmChain, rm: ReachabilityMap, memory: int) -> None:
        self._reach, self._grid = chain.reach, rm.grid
        height = rm.grid.top - rm.grid.bottom
        fine = (memory / (height * np.pi * 4 * chain.reach**2 / (0.05**3 * np.radians(5)))) ** 0.25
        self._edge, self._angle = 0.05 / fine, np.radians(5) / fine
        across = int(2 * chain.reach / self._edge) + 1
        self.cells = np.zeros((int(height / self._edge) + 1, int(np.pi / self._angle) + 1, across, across), dtype=bool)

    def place(self, R: Floats, p: Floats) -> tuple[Integers, Bools]:
        """(n, 4) cells of poses, and (n,) whether the map has them."""
        approach, offset = R[:, :, 0], np.asarray(self._grid.centre) - p[:, :2]
        turn = -np.arctan2(approach[:, 1], approach[:, 0])
        c, s = np.cos(turn), np.sin(turn)
        x, y = c * offset[:, 0] - s * offset[:, 1], s * offset[:, 0] + c * offset[:, 1]
        height, tilt = p[:, 2] - self._grid.bottom, np.arccos(np.clip(approach[:, 2], -1, 1)) / self._angle
        columns = height / self._edge, tilt, (x + self._reach) / self._edge, (y + self._reach) / self._edge
        index = np.floor(np.column_stack(columns)).astype(np.int64)
        return index, np.all((index >= 0) & (index < self.cells.shape), axis=1)


def random_poses(chain: ArmChain, count: int, rng: np.random.Generator) -> Floats:
    """T_base_tcp (n, 4, 4): uniform positions in the ball of the stretched arm, uniform rotations."""
    direction = rng.normal(size=(count, 3))
    direction *= chain.reach * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(direction, axis=1, keepdims=True)
    R, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = R * np.linalg.det(R)[:, None, None]
    T[:, :3, 3] = chain.shoulder + (0.0, 0.0, (chain.lower[0] + chain.upper[0]) / 2) + direction
    return T


def _best_bases(
    judge: Judge, rm: ReachabilityMap, wanted: int, rng: np.random.Generator
) -> tuple[int, int, int, float]:
    """How many of the best bases of random heights and pitches have a free configuration, without any floor plan; of
    how many; how many of these answers are UNKNOWN; and the median time of a query [µs]."""
    inverse_map, solver = InverseReachabilityMap(rm), ExactSolver(judge.chain, rm.grid.torso_range)
    free, unknown, times = 0, 0, list[float]()
    for pitch in itertools.islice(itertools.cycle(np.unique(rm.grid.orientations.pitch).tolist()), 4 * wanted):
        if len(times) == wanted:
            break
        point = np.array([0.0, 0.0, rng.uniform(rm.grid.bottom, rm.grid.top - 1e-6)])
        start = time.process_time_ns()
        found = inverse_map.query(point, pitch=pitch)
        spent = time.process_time_ns() - start
        if not len(found):
            continue
        times.append(spent / 1e3)
        unknown += found.status is Status.UNKNOWN
        T = world_to_base(found.poses[0]) @ tcp_poses(point, float(found.approach_yaw[0]), pitch)
        status, q = solver.solve(T)
        free += bool(status[0] == YES and judge.holds(q[0], T[0]))
    return free, len(times), unknown, float(np.median(times))


def tables(measured: dict[str, dict[str, Any]]) -> str:
    """The truth table, and the comparison with the two other maps."""
    head = ["arm", "build [s]", "memory [MB]", "poses", "`classify`: false YES / NO", "`decide`: false YES / NO"]
    head += [
        "UNKNOWN of reachable",
        "of random",
        "`decide` [µs]",
        "`query` [µs]",
        "best bases with a free configuration",
    ]
    rows, others = [], []
    for name, m in measured.items():
        exact, (known, random) = m["decide"], m["poses"]
        wrong = exact["false_yes"] + exact["contradicts"]
        row = [name, f"{m['build']:.0f}", f"{m['memory']:.1f}", f"{known:,} + {random:,}"]
        row += ["{} / {}".format(*m["classify"]), f"{wrong} / {exact['false_no']}"]
        row += [f"{100 * exact['unknown_reachable']:.2f}%", f"{100 * exact['unknown_random']:.2f}%"]
        row += [f"{exact['micros']:.0f}", f"{m['query']:.0f}", "{} of {}, {} UNKNOWN".format(*m["bases"])]
        rows.append(row)
        shares = [[f"{share:.1%}" for share in m[kind]] for kind in ("map", "rm4d", "sampled")]
        others.append([name, *(f"{right}, {yes}, {no}" for right, yes, no in shares)])
    compared = markdown_table(["arm", "map", "as RM4D", "filled at random"], others)
    return f"{markdown_table(head, rows)}\n\n{compared}"


def main(
    arms: tuple[str, ...] = tuple(ARMS),
    wheels: Path = Path("wheels"),
    out: Path = Path("outputs/truth"),
    poses: int = 10_000,
    bases: int = 200,
    voxel: float = 0.05,
) -> None:
    """Measure, write a file for each arm, and print the tables of all files.

    Args:
        arms: names of `ARMS`; none to print the tables.
        wheels: folder in which the packages were unpacked.
        out: folder of the files.
        poses: random configurations, and random poses.
        bases: TCP poses whose best base is judged.
        voxel: edge of the map's cells [m].
    """
    out.mkdir(parents=True, exist_ok=True)
    for name in arms:
        measured = measure(Judge(wheels, ARMS[name]), poses, bases, voxel)
        (out / f"{name}.json").write_text(json.dumps(measured, indent=1) + "\n")
    files = [out / f"{name}.json" for name in ARMS]
    print(tables({file.stem: json.loads(file.read_text()) for file in files if file.exists()}))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
