"""Wrong answers of `decide` and `ExactSolver` on poses that are made to be hard, judged by MuJoCo; and their times.

    pip download --no-deps robosuite==1.5.2 robosuite-models gymnasium-robotics dm_control rtb-data \\
        trossen-arm-sim openarm-mujoco -d wheels                       # unpack all of them there
    python scripts/adversarial_truth.py measure --poses 8000           # a file for each arm and set; resumes
    git worktree add ../before COMMIT
    PYTHONPATH=../before python scripts/adversarial_truth.py measure --out outputs/before --poses 2000
    python scripts/adversarial_truth.py times --before ../before       # CPU times of both, in turns
    python scripts/adversarial_truth.py table --before outputs/before  # the tables of all files

A pose is that of a configuration within the limits of the model's file, by MuJoCo's kinematics: the joints reach it. If
MuJoCo's distances call that configuration free of self-collision, it is in reach for `decide` too: NO is wrong.
YES is wrong if the solver's configuration exceeds a limit, or MuJoCo does not confirm it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from map_truth import ARMS as KNOWN, Arm, Judge, random_poses  # type: ignore[import-not-found]  # beside this file
from numpy.typing import NDArray

from clutter_env.reporting.tables import markdown_table
from irm import ArmChain, ExactSolver, ReachabilityMap, Status, decide, link_origins
from irm.kinematics import link_frames

Floats = NDArray[np.float64]
NO, UNKNOWN, YES = (answer.value for answer in (Status.NO, Status.UNKNOWN, Status.YES))
ARMS = {
    **KNOWN,
    "puma560": Arm("rtbdata/xacro/unimation_puma560_description/urdf/puma560_robot.urdf", "link1", "link7", "z"),
    "widowx ai": Arm("trossen_arm_sim/assets/wxai_follower.xml", "base_link", "ee_site", "x"),
    "viperx 300s": Arm("robosuite_models/assets/robots/vx300s/robot.xml", "base", "right/gripper", "x"),
    "openarm": Arm(
        "openarm_mujoco-2.3.0/v2/openarm_bimanual.xml", "openarm_left_base_link", "left_ee_control_point", "-z"
    ),
}
_HARD = 0.6
"""Share of the joints of a configuration that are where a set has them; the others are uniform."""
_AT_ONCE = 2_000
_EMPTY = 5
"""Draws without a configuration after which a set ends: an arm may not reach below its base."""
_TIMED, _ROUNDS, _REPEATS = 400, 3, 3
"""Poses of each kind, reachable and random, whose answers are timed, in how many processes, and how often in each."""
_SETS = ("uniform", "limits", "inside", "right angles", "jittered", "straight", "folded", "wrist", "below")
"""The sets of reachable poses."""


def configurations(chain: ArmChain, kind: str, count: int, rng: np.random.Generator) -> Floats:
    """(count, 1 + n) configurations within the limits.

    Kinds: "limits" joints exactly there; "inside" 1 µrad to 1 mrad (or µm, mm) from there; "right angles" at multiples
    of 90°; "jittered" up to 1 mrad beside these; "straight" and "folded" the elbow; "wrist" the axes around the last
    but one joint aligned; "below" the TCP lower than the base's origin; "uniform".
    """
    middle = (chain.lower + chain.upper) / 2
    low, high = np.maximum(chain.lower, middle - np.pi), np.minimum(chain.upper, middle + np.pi)
    q = rng.uniform(low, high, (count, chain.size))
    is_hard, is_low = rng.random(q.shape) < _HARD, rng.random(q.shape) < 0.5
    limits = np.where(is_low, chain.lower, chain.upper)
    right = np.round(q * 2 / np.pi) * np.pi / 2
    right[:, 0] = limits[:, 0]
    right = np.where((right >= chain.lower) & (right <= chain.upper), right, q)
    if kind == "limits":
        q = np.where(is_hard, limits, q)
    elif kind == "inside":
        q = np.where(is_hard, limits + np.where(is_low, 1, -1) * 10 ** rng.uniform(-6, -3, q.shape), q)
    elif kind in ("right angles", "jittered"):
        q = np.where(is_hard, right, q)
        q += rng.uniform(-1e-3, 1e-3, q.shape) if kind == "jittered" else 0.0
    elif kind in ("straight", "folded", "wrist"):
        # half of the others at limits and at right angles, so that several kinds meet
        others = rng.random((count, 1))
        q = np.where(is_hard & (others < 0.25), limits, np.where(is_hard & (others < 0.5), right, q))
        for joint, measure in _singular_joints(chain, kind):
            q[:, joint] = _best_angle(chain, joint, measure, -1.0 if kind == "straight" else 1.0)
    elif kind == "below":
        q = np.where(is_hard & (rng.random((count, 1)) < 0.5), limits, q)
        heights = np.array([link_origins(chain, row)[-1, 2] for row in q])
        q = q[heights < 0.0]
    return np.clip(q, chain.lower, chain.upper)


def _singular_joints(chain: ArmChain, kind: str) -> list[tuple[int, Callable[[Floats, Floats], float]]]:
    """The joint of the elbow, or those between which axes align, and what is smallest or largest there."""
    last = chain.size - 1
    if kind == "wrist":
        middle = last - 1

        def unaligned(R: Floats, _p: Floats) -> float:
            before, after = (R[k][:, chain.axes[k] % 3] for k in (middle - 1, middle + 1))
            return float(np.linalg.norm(np.cross(before, after)))

        return [(middle, unaligned)]
    elbow = 3 if chain.size == 7 else 4
    return [(elbow, lambda _R, p: float(np.linalg.norm(p[last - 1] - p[2])))]


def _best_angle(chain: ArmChain, joint: int, measure: Callable[[Floats, Floats], float], sign: float) -> float:
    """The angle of one joint at which a measure times a sign is smallest, the other joints at the middle: by a grid
    that is refined, rounded to a multiple of 90° that is as good."""
    q = np.clip((chain.lower + chain.upper) / 2 + 0.3, chain.lower, chain.upper)
    low, high = np.clip(chain.lower[joint], -np.pi, np.pi), np.clip(chain.upper[joint], -np.pi, np.pi)

    def value(angle: float) -> float:
        q[joint] = angle
        return sign * measure(*link_frames(chain, q))

    for _ in range(12):
        angles = np.linspace(low, high, 41)
        best = float(min(angles, key=value))
        step = angles[1] - angles[0]
        low, high = max(low, best - step), min(high, best + step)
    rounded = float(np.round(best * 2 / np.pi) * np.pi / 2)
    is_within = chain.lower[joint] <= rounded <= chain.upper[joint]
    return rounded if is_within and abs(rounded - best) < 1e-6 else best


def measure_set(judge: Judge, rm: ReachabilityMap, kind: str, count: int) -> dict[str, Any]:
    """Counts of one set of reachable poses."""
    chain, rng = judge.chain, np.random.default_rng(sum(map(ord, kind)))
    solver = ExactSolver(chain, rm.grid.torso_range)
    counts = dict.fromkeys(("poses", "no", "unknown", "free", "decide_no", "decide_unknown", "wrong_yes"), 0)
    empty = 0
    while counts["poses"] < count and empty < _EMPTY:
        q = configurations(chain, kind, _AT_ONCE, rng)[: count - counts["poses"]]
        empty += not len(q)
        T = np.array([judge.pose(row) for row in q]).reshape(-1, 4, 4)
        free = np.array([judge.is_free(row) for row in q], dtype=bool)
        status, found = solver.reach(T)
        counts["poses"] += len(q)
        counts["no"] += int(np.count_nonzero(status == NO))
        counts["unknown"] += int(np.count_nonzero(status == UNKNOWN))
        counts["wrong_yes"] += _wrong_yes(judge, status, found, T, needs_free=False)
        answers, (exact, found) = decide(rm, T[free]), solver.solve(T[free])
        counts["free"] += int(np.count_nonzero(free))
        counts["decide_no"] += int(np.count_nonzero((answers == NO) | (exact == NO)))
        counts["decide_unknown"] += int(np.count_nonzero(answers == UNKNOWN))
        counts["wrong_yes"] += _wrong_yes(judge, exact, found, T[free], needs_free=True)
    return counts


def _wrong_yes(judge: Judge, status: NDArray[np.int8], q: Floats, T: Floats, needs_free: bool) -> int:
    chain, wrong = judge.chain, 0
    for k in np.flatnonzero(status == YES):
        fits = bool(np.all((q[k] >= chain.lower) & (q[k] <= chain.upper)))
        holds = judge.holds(q[k], T[k]) if needs_free else judge.reaches(q[k], T[k])
        wrong += not (fits and holds)
    return wrong


def measure_random(judge: Judge, rm: ReachabilityMap, count: int) -> dict[str, Any]:
    """Shares of answers for uniform poses, of the joints alone and of `decide`, and wrong YES."""
    T = random_poses(judge.chain, count, np.random.default_rng(7))
    solver = ExactSolver(judge.chain, rm.grid.torso_range)
    status, found = solver.reach(T)
    exact, free = solver.solve(T)
    answers = decide(rm, T)
    wrong = _wrong_yes(judge, status, found, T, False) + _wrong_yes(judge, exact, free, T, True)
    wrong += int(np.count_nonzero((answers == YES) & (exact == NO)))
    return {
        "poses": count,
        "wrong_yes": wrong,
        "reach": [int(np.count_nonzero(status == answer)) for answer in (NO, UNKNOWN, YES)],
        "decide": [int(np.count_nonzero(answers == answer)) for answer in (NO, UNKNOWN, YES)],
    }


def a_map(judge: Judge, file: Path, is_coarse: bool) -> ReachabilityMap:
    """A map for `decide`, built once: of its default resolution, or coarse where only its arm counts."""
    if not file.exists():
        if is_coarse:
            rm = ReachabilityMap.build(judge.chain, voxel=0.2, orientations=26, samples=20_000)
        else:
            rm = ReachabilityMap.build(judge.chain)
        rm.save(file)
    return ReachabilityMap.load(file, judge.chain)


def measure(
    arms: tuple[str, ...] = tuple(ARMS),
    wheels: Path = Path("wheels"),
    out: Path = Path("outputs/adversarial"),
    poses: int = 8_000,
) -> None:
    """Measure what is not measured yet: a file for each arm and set.

    Args:
        arms: names of `ARMS`.
        wheels: folder in which the packages were unpacked.
        out: folder of the files.
        poses: of each set, and twice as many random ones.
    """
    out.mkdir(parents=True, exist_ok=True)
    for name in arms:
        wanted = [kind for kind in (*_SETS, "random") if not (out / f"{name}+{kind}.json").exists()]
        if not wanted:
            continue
        judge = Judge(wheels, ARMS[name])
        rm = a_map(judge, out / f"{name}.npz", is_coarse=True)
        for kind in wanted:
            is_random = kind == "random"
            counts = measure_random(judge, rm, 2 * poses) if is_random else measure_set(judge, rm, kind, poses)
            (out / f"{name}+{kind}.json").write_text(json.dumps(counts) + "\n")
            print(name, kind, counts, flush=True)


def times(
    before: Path,
    arms: tuple[str, ...] = tuple(ARMS),
    wheels: Path = Path("wheels"),
    out: Path = Path("outputs/adversarial"),
) -> None:
    """CPU times of `decide` by this code and by another checkout, in turns: medians [µs] a pose.

    Args:
        before: folder of the other checkout.
        arms, wheels, out: as of `measure`.
    """
    here = Path(__file__).resolve().parents[1]
    out.mkdir(parents=True, exist_ok=True)
    for name in arms:
        if (out / f"{name}+times.json").exists():
            continue
        judge = Judge(wheels, ARMS[name])
        is_asked = ExactSolver(judge.chain).is_iterative or judge.chain.has_closed_form  # in the other checkout
        a_map(judge, out / f"{name}+times.npz", is_coarse=not is_asked)
        taken: dict[Path, list[float]] = {here: [], before.resolve(): []}
        for _ in range(_ROUNDS):
            for code, values in taken.items():
                command = [sys.executable, __file__, "time-one", name, str(wheels.resolve()), str(out.resolve())]
                environment = {**os.environ, "PYTHONPATH": str(code)}
                done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
                values.append(float(done.stdout))
        medians = {"now": float(np.median(taken[here])), "before": float(np.median(taken[before.resolve()]))}
        (out / f"{name}+times.json").write_text(json.dumps(medians) + "\n")
        print(name, medians, flush=True)


def time_one(
    arm: tyro.conf.Positional[str], wheels: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path]
) -> None:
    """Print the CPU time of `decide` for one pose [µs]: half are poses of configurations, half are random."""
    judge = Judge(wheels, ARMS[arm])
    rm, rng = ReachabilityMap.load(out / f"{arm}+times.npz", judge.chain), np.random.default_rng(3)
    known = np.array([judge.pose(q) for q in configurations(judge.chain, "uniform", _TIMED, rng)])
    T = np.concatenate([known, random_poses(judge.chain, _TIMED, rng)])
    decide(rm, T[:: _TIMED // 10])
    spent = []
    for _ in range(_REPEATS):
        start = time.process_time()
        decide(rm, T)
        spent.append(time.process_time() - start)
    print(np.median(spent) / len(T) * 1e6)


def table(out: Path = Path("outputs/adversarial"), before: Path | None = None) -> None:
    """Print the tables of all files.

    Args:
        out: folder of the files.
        before: the same of other code.
    """
    rows, others, total = [], [], 0
    for name in ARMS:
        files = {kind: out / f"{name}+{kind}.json" for kind in (*_SETS, "random", "times")}
        if not files["random"].exists():
            continue
        sets = {kind: json.loads(files[kind].read_text()) for kind in _SETS if files[kind].exists()}
        random = json.loads(files["random"].read_text())
        poses = sum(m["poses"] for m in sets.values())
        total += poses + random["poses"]
        wrong_no = sum(m["no"] for m in sets.values()), sum(m["decide_no"] for m in sets.values())
        wrong_yes = sum(m["wrong_yes"] for m in sets.values()) + random["wrong_yes"]
        open_reach = max((m["unknown"] / max(1, m["poses"]), kind) for kind, m in sets.items())
        open_decide = max((m["decide_unknown"] / max(1, m["free"]), kind) for kind, m in sets.items())
        old = before / f"{name}+random.json" if before else None
        was = json.loads(old.read_text()) if old and old.exists() else None
        told = [before / f"{name}+{kind}.json" for kind in sets] if before else []
        earlier = [json.loads(file.read_text()) for file in told if file.exists()]
        no, unknown, _ = random["reach"]
        share, decided = f"{no / max(1, no + unknown):.2%}", random["decide"][1] / random["poses"]
        spent = json.loads(files["times"].read_text()) if files["times"].exists() else None
        rows.append(
            [name, f"{poses:,} + {random['poses']:,}", "{} / {}".format(*wrong_no), str(wrong_yes)]
            + [f"{share_open:.2%} ({kind})" for share_open, kind in (open_reach, open_decide)]
        )
        others.append(
            [
                name,
                f"{sum(m['no'] for m in earlier)} of {sum(m['poses'] for m in earlier):,}" if earlier else "",
                f"{was['decide'][1] / was['poses']:.2%}" if was else "",
                f"{decided:.2%}",
                f"{was['reach'][0] / max(1, sum(was['reach'][:2])):.2%}" if was else "",
                share,
                "{:.0f}".format(spent["before"]) if spent else "",
                "{:.0f}".format(spent["now"]) if spent else "",
            ]
        )
    head = ["arm", "poses", "wrong NO: `reach` / `decide`", "wrong YES", "most UNKNOWN: `reach`", "`decide`"]
    print(markdown_table(head, rows))
    print(f"\n{total:,} poses.\n")
    head = ["arm", "wrong NO before", "UNKNOWN of random before", "now", "NO of what is not YES before", "now"]
    print(markdown_table([*head, "`decide` before [µs]", "now"], others))


if __name__ == "__main__":
    commands: dict[str, Callable[..., Any]] = {"measure": measure, "times": times, "time-one": time_one, "table": table}
    tyro.extras.subcommand_cli_from_dict(commands, description=__doc__)
