"""The paper's experiment (Fig. 3), and the cost of maps: times of placement queries for cups on a table, by the
classical and the proposed map; of building, inverting, saving and loading maps. All times are CPU times of one thread.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/map_speed.py --queries 500

The map of 7,899 poses is a file as the authors have it (ryul1206/inverse-reachability-repositioning): 18 columns. It is
written from the robot's own map, and read by `examples/import_pose_tables.py`; `--table` takes another file, theirs.
"""

from __future__ import annotations

import runpy
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.figure import Figure
from numpy.typing import NDArray

from assets.robots import RobotSpec
from clutter_env.cli.robot import robot_by_name
from clutter_env.reporting.progress import progress_bar
from clutter_env.reporting.tables import NOTHING, markdown_table
from irm import ExactSolver
from irm.answers import YES, BasePlacement, Status
from irm.free_space import EVERYWHERE, FreeSpace
from irm.inverse_map import ClassicalInverseReachabilityMap, InverseReachabilityMap
from irm.query_kernels import base_turns, bases_of_key
from irm.query_keys import FULL_TURN, YAW_STEP, as_position, as_yaw_range, find_key, yaw_window
from irm.reachability_map import ReachabilityMap, cached_map
from irm.rotations import rotations, wrap_to_pi

_EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "import_pose_tables.py"
read_pose_table = runpy.run_path(str(_EXAMPLE))["read_pose_table"]


def full_scan(
    inverse_map: InverseReachabilityMap,
    position: Iterable[float],
    *,
    pitch: float = 0.0,
    roll: float = 0.0,
    yaw_range: tuple[float, float] = FULL_TURN,
    free_space: FreeSpace | None = None,
    yaw_step: float = YAW_STEP,
) -> BasePlacement:
    """The best base, found by a test of every base of the key at every yaw (section 3.2.2 of the paper).

    Arguments as in `InverseReachabilityMap.query`. The status is never better than UNKNOWN, and NO only where the map
    has no key.
    """
    grid, bases = inverse_map.reachability_map.grid, inverse_map.bases
    space = free_space or EVERYWHERE
    point, bounds = as_position(position), as_yaw_range(yaw_range)
    key = find_key(grid, point[2], pitch, roll)
    if key is None:
        return BasePlacement.nothing(Status.NO)
    turns = base_turns(yaw_window(grid, key, bounds, yaw_step))
    own_x, own_y, own_yaw, mu = bases_of_key(bases, key.number)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x = point[0] + c * own_x - s * own_y
    y = point[1] + s * own_x + c * own_y
    score = np.where(space.are_free(x, y), mu, 0.0)
    if score.size == 0 or not score.max() > 0:
        return BasePlacement.nothing(Status.UNKNOWN)
    turn, base = np.unravel_index(int(score.argmax()), score.shape)
    yaw = wrap_to_pi(float(turns[turn] + own_yaw[base]))
    approach_yaw = turns[turn] + key.yaw_shift
    row = [x[turn, base], y[turn, base], yaw, approach_yaw, mu[base], np.nan, 0.0]
    return BasePlacement.of_rows(np.array([row]))


TABLE = (0.8, 1.6)
"""[m] Depth and width of the table."""
GROWN = 0.3
"""[m] by which the table's outline is grown, as in the paper's Fig. 2."""
CUP_HEIGHTS = (0.75, 0.94)
"""[m] TCP heights for the cups, and for the map that is restricted to them."""
RANGES = {"180": (-np.pi, np.pi), "90": (-np.pi / 2, np.pi / 2)}
"""Approach yaws, as the paper names them."""
BATCH = 20_000
PAPER = {"R180": (1180.6, 313.3), "P180": (249.7, 25.4), "R90": (695.0, 156.6), "P90": (138.6, 15.5)}
"""Mean and deviation [ms] in the paper, Fig. 3, with 7,899 poses (Python 2.7)."""
ON_RINGS = (7_899, 26_000)
"""Sizes of the paper: of its restricted map, and of its whole one."""
Query = Callable[..., BasePlacement]


@dataclass(frozen=True)
class Timing:
    """One column of the box plot.

    Attributes:
        poses: of the map.
        method: letter of the map (R: equation 4, P: equation 5), "compiled" or "batch", and the range of yaws.
        times: CPU times of one thread [ms].
        same_best: queries in which the best μ equals that of the compiled query exactly.
    """

    poses: int
    method: str
    times: tuple[float, ...]
    same_best: int


def map_of_size(robot: RobotSpec, poses: int, seed: int, table: Path) -> ReachabilityMap:
    """A map with a given number of poses.

    That of the paper is the `table`, written if it does not exist. 26,000 are a random part of the 62-orientation map.
    Any other size gives the whole map of 114 orientations at a fixed torso height.
    """
    if poses not in ON_RINGS:
        return cached_map(robot, orientations=114, lift=False)
    whole = cached_map(robot)
    if poses == ON_RINGS[0]:
        if not table.exists():
            write_table(whole, poses, seed, table)
        return ReachabilityMap.from_poses(*read_pose_table(table), robot=table.stem)
    height = whole.positions[:, 2]
    candidates = np.flatnonzero((height > 0.4) & (height < 1.4))
    return whole.subset(np.sort(np.random.default_rng(seed).choice(candidates, poses, replace=False)))


def write_table(rm: ReachabilityMap, poses: int, seed: int, file: Path) -> None:
    """A part of a map at the heights of cups, with the 18 columns of the paper's authors: x, y, z of the TCP and of the
    end effector [m]; roll, pitch and yaw of a frame whose z axis is the approach [degrees]; μ; torso and arm."""
    assert rm.chain is not None
    height = rm.positions[:, 2]
    candidates = np.flatnonzero((height > CUP_HEIGHTS[0]) & (height < CUP_HEIGHTS[1]) & (rm.manipulability > 0))
    rng = np.random.default_rng(seed)
    some = rm.subset(np.sort(rng.choice(candidates, 2 * poses, replace=False)))
    angles, T = some.yaw_pitch_roll, np.tile(np.eye(4), (len(some), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotations(*angles.T), some.positions
    status, q = ExactSolver(rm.chain).solve(T)
    rows = np.sort(rng.choice(np.flatnonzero(status == YES), poses, replace=False))
    hand = T[:, :3, 3] - rm.chain.tip[0] * T[:, :3, 0]
    turns = np.degrees(angles[:, ::-1] + (0.0, np.pi / 2, 0.0))
    columns = np.column_stack([T[:, :3, 3], hand, turns, some.manipulability, q])[rows]
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(file, columns, fmt="%.6f", delimiter=",")


def measure_speed(rm: ReachabilityMap, queries: int, seed: int) -> list[Timing]:
    """Times of all methods on one map: R180, P180, R90, P90, and the compiled query alone and in batches."""
    floor = FreeSpace.from_boxes([(0.0, 0.0, *TABLE)], radius=GROWN)
    proposed, classical = InverseReachabilityMap(rm), ClassicalInverseReachabilityMap(rm)
    cups = _cups(queries, seed)
    results = []
    for name, yaw_range in RANGES.items():
        keywords: dict[str, Any] = {"yaw_range": yaw_range, "free_space": floor}
        scan: Query = lambda cup, **how: full_scan(proposed, cup, **how)  # noqa: E731
        alone = keywords | {"exact": False}  # the map by itself, as the paper's
        answers, fast = _timed(proposed.query, cups, alone, f"compiled {name}, {len(rm)} poses")
        for letter, query, given in (("R", classical.query, alone), ("P", scan, keywords)):
            others, spent = _timed(query, cups, given, f"{letter}{name}, {len(rm)} poses")
            same = sum(bool(_best(a) == _best(b)) for a, b in zip(answers, others, strict=True))
            results.append(Timing(len(rm), f"{letter}{name}", spent, same))
        results.append(Timing(len(rm), f"compiled {name}", fast, len(cups)))
        how: dict[str, Any] = {"yaw_ranges": yaw_range, "free_space": floor}
        own = proposed.query_batch(cups, **how).manipulability[:, 0]
        same = sum(bool(_best(a) == (0.0 if np.isnan(mu) else mu)) for a, mu in zip(answers, own, strict=True))
        times = []
        for k in range(10):
            many = _cups(BATCH, seed + 1 + k)
            start = time.process_time_ns()
            proposed.query_batch(many, **how)
            times.append((time.process_time_ns() - start) * 1e-6 / BATCH)
        results.append(Timing(len(rm), f"batch {name}", tuple(times), same))
    results.append(_own_ranges(proposed, floor, cups, seed))
    return results


def _own_ranges(proposed: InverseReachabilityMap, floor: FreeSpace, cups: NDArray[np.float64], seed: int) -> Timing:
    """Calls as the planner makes them: each with one yaw of its own and three bases."""
    yaws = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(cups))
    proposed.query(cups[0], yaw_range=(0.0, 0.0), free_space=floor, k=3, exact=False)
    times, same = [], 0
    for cup, yaw in zip(cups, yaws.tolist(), strict=True):
        start = time.process_time_ns()
        answer = proposed.query(cup, yaw_range=(yaw, yaw), free_space=floor, k=3, exact=False)
        times.append((time.process_time_ns() - start) * 1e-6)
        same += bool(_best(answer) == _best(full_scan(proposed, cup, yaw_range=(yaw, yaw), free_space=floor)))
    return Timing(len(proposed), "compiled own 180", tuple(times), same)


def _cups(count: int, seed: int) -> NDArray[np.float64]:
    """(n, 3) TCP positions above the table."""
    rng = np.random.default_rng(seed)
    half_depth, half_width = TABLE[0] / 2 - 0.05, TABLE[1] / 2 - 0.05
    low, high = (-half_depth, -half_width, CUP_HEIGHTS[0] + 0.03), (half_depth, half_width, CUP_HEIGHTS[1] - 0.001)
    return rng.uniform(low, high, size=(count, 3))


def _timed(
    query: Query, cups: NDArray[np.float64], keywords: dict[str, Any], title: str
) -> tuple[list[BasePlacement], tuple[float, ...]]:
    query(cups[0], **keywords)
    answers, times = [], []
    for cup in progress_bar(cups, title):
        start = time.process_time_ns()
        answers.append(query(cup, **keywords))
        times.append((time.process_time_ns() - start) * 1e-6)
    return answers, tuple(times)


def _best(placement: BasePlacement) -> float:
    return float(placement.manipulability[0]) if len(placement) else 0.0


def speed_table(rows: Sequence[Timing], queries: int) -> str:
    """Mean, deviation, median and ratio to the classical map, as a Markdown table."""
    head = ("poses", "query", "mean ± deviation [ms]", "median [ms]", "faster than equation 4 (median)", "same best μ")
    body = [
        (
            "7,899 (paper)",
            in_words(name),
            f"{mean} ± {spread}",
            NOTHING,
            f"{PAPER[f'R{name[1:]}'][0] / mean:.2g}",
            NOTHING,
        )
        for name, (mean, spread) in PAPER.items()
    ]
    for row in rows:
        angle = row.method.lstrip("RP").split()[-1]
        reference = next(r for r in rows if r.poses == row.poses and r.method == f"R{angle}")
        times = np.array(row.times)
        ratio = np.median(reference.times) / np.median(times)
        spread, median = f"{times.mean():.3g} ± {times.std():.2g}", f"{np.median(times):.3g}"
        body.append(
            (f"{row.poses:,}", in_words(row.method), spread, median, f"{ratio:,.3g}", f"{row.same_best} of {queries}")
        )
    return markdown_table(head, body)


def plot_speed(rows: Sequence[Timing], file: Path) -> None:
    """One box plot for every map, as the paper's Fig. 3."""
    sizes = list(dict.fromkeys(row.poses for row in rows))
    most = max(sum(row.poses == poses for row in rows) for poses in sizes)
    figure = Figure(figsize=(3.2 + 4.2 * len(sizes), 1.4 + 0.34 * most), layout="constrained")
    axes = figure.subplots(1, len(sizes), sharex=True, sharey=True, squeeze=False)[0]
    for axis, poses in zip(axes, sizes, strict=True):
        mine = [row for row in rows if row.poses == poses]
        boxes = axis.boxplot(
            [row.times for row in mine],
            orientation="horizontal",
            tick_labels=[in_words(row.method) for row in mine],
            patch_artist=True,
            showfliers=False,
            medianprops={"color": "black"},
            widths=0.6,
        )
        for box, row in zip(boxes["boxes"], mine, strict=True):
            box.set(facecolor=_COLOURS[row.method[0]], alpha=0.75)
        printed = [(PAPER[row.method], place) for place, row in enumerate(mine, start=1) if row.method in PAPER]
        if poses == ON_RINGS[0]:
            (means, spreads), places = np.transpose([entry for entry, _ in printed]), [place for _, place in printed]
            said = "the paper, another computer: mean and standard deviation"
            axis.errorbar(means, places, xerr=spreads, fmt="kD", markersize=4, capsize=3, label=said)
            figure.legend(loc="outside lower center", frameon=False, fontsize=9)
        axis.set(title=f"map of {poses:,} poses", xscale="log", xlabel="CPU time of one query [ms]")
        axis.grid(axis="x", alpha=0.3)
    axes[0].invert_yaxis()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=130)


_COLOURS = {"R": "#d55e00", "P": "#0072b2", "c": "#009e73", "b": "#cc79a7"}


def in_words(method: str) -> str:
    """What is timed by a method of `Timing`, with its range of approach yaws."""
    if method.startswith("compiled own"):
        return "query, one yaw, three bases"
    kinds = {"R": "equation 4, NumPy", "P": "equation 5, NumPy", "c": "query", "b": "query_batch"}
    return f"{kinds[method[0]]}, ±{method.lstrip('RP').split()[-1]}°"


BUILDS: dict[str, dict[str, Any]] = {
    "62 orientations": {},
    "62 orientations, torso fixed": {"lift": False},
    "level gripper, 15 degrees, 0.7 to 1.2 m": {"orientations": 266, "pitches": (0.0,), "heights": (0.7, 1.2)},
    "266 orientations": {"orientations": 266},
}


def measure_build(robot: RobotSpec, name: str) -> list[str]:
    """A row of the table: CPU times of one thread to build, invert, save and load one of the `BUILDS`."""
    ReachabilityMap.build(robot, voxel=0.25, orientations=6)  # compiles
    times = [time.process_time()]
    rm = ReachabilityMap.build(robot, progress=progress_bar, **BUILDS[name])
    times.append(time.process_time())
    InverseReachabilityMap(rm)
    times.append(time.process_time())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        rm.save(file)
        times.append(time.process_time())
        ReachabilityMap.load(file, robot)
        times.append(time.process_time())
        size = file.stat().st_size / 1e6
    return [name, f"{len(rm):,}", *(f"{seconds:.2f}" for seconds in np.diff(times)), f"{size:.1f}"]


def main(
    robot: str = "fetch",
    queries: int = 500,
    sizes: tuple[int, ...] = (*ON_RINGS, 1_000_000),
    seed: int = 0,
    out: Path = Path("outputs/irm_speed.png"),
    table: Path = Path("outputs/authors_map.csv"),
    builds: bool = True,
) -> None:
    """Measure, and print two tables.

    Args:
        robot: name of a robot, or module:NAME of a RobotSpec.
        queries: random cup positions for each map and each range of approach yaws.
        sizes: poses of the maps: 7899 and 26000 as in the paper; any other number for one of more than a million poses.
        seed: random seed.
        out: where the box plot goes.
        table: file of the map of 7,899 poses; written if it does not exist.
        builds: whether building, inverting, saving and loading is measured too.
    """
    spec = robot_by_name(robot)
    rows = [row for size in sizes for row in measure_speed(map_of_size(spec, size, seed, table), queries, seed)]
    plot_speed(rows, out)
    print(f"{speed_table(rows, queries)}\nbox plot: {out}\n")
    if builds:
        head = ("map", "poses", "build [s]", "invert [s]", "save [s]", "load [s]", "file [MB]")
        print(markdown_table(head, [measure_build(spec, name) for name in BUILDS]))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
