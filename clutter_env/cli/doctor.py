"""Check this installation: working parts, missing parts, and how to install them.

    clutter-env doctor

Nothing is installed or changed. The exit code is 1 if an environment or the planner cannot run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from packaging.requirements import Requirement


@dataclass(frozen=True)
class Arguments:
    """Check this installation."""

    json: Path | None = None
    """Write the findings to this file."""


class Finding(NamedTuple):
    """Result of one check.

    Attributes:
        state: "missing" for parts that only some uses need, "broken" for parts that all need.
        said: the finding.
        cure: the remedy, "" if everything works.
    """

    name: str
    state: Literal["ok", "missing", "broken"]
    said: str
    cure: str = ""


def run(arguments: Arguments) -> int:
    """Print a line for each finding. Return 1 if something is broken."""
    from clutter_env.reporting.files import write_json

    found = []
    for finding in findings():
        found.append(finding)
        print(f"{finding.state:8} {finding.name:14} {finding.said}")
        if finding.cure:
            print(f"{'':23} {finding.cure}")
    broken = [finding.name for finding in found if finding.state == "broken"]
    missing = [finding.name for finding in found if finding.state == "missing"]
    print(f"\n{_summary(broken, missing)}")
    if arguments.json is not None:
        write_json(arguments.json, [finding._asdict() for finding in found])
    return int(bool(broken))


def findings() -> Iterator[Finding]:
    """The checks, one after another, the quickest first."""
    yield _machine()
    yield from _libraries()
    yield from _extras()
    yield _kept_kernels()
    for name, check, cure in (
        ("environment", _step, "install the versions of constraints.txt, see the quickstart"),
        ("planner", _plan, "install the versions of constraints.txt, see the quickstart"),
    ):
        yield _tried(name, check, "broken", cure)
    yield _tried("pictures", _draw, "missing", "docs: Troubleshooting, pictures without a display")


def _summary(broken: list[str], missing: list[str]) -> str:
    if broken:
        return f"does not work: {', '.join(broken)}"
    return f"works; not installed: {', '.join(missing)}" if missing else "all works"


def _machine() -> Finding:
    import os
    import platform

    from clutter_env.version import version

    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores"
    return Finding("clutter-env", "ok", f"{version()} on {system}")


def _libraries() -> Iterator[Finding]:
    """Versions of the core's dependencies, compared with those that the package requires."""
    for needed in _needed(""):
        found = _version(needed.name)
        fits = bool(found) and needed.specifier.contains(found, prereleases=True)
        cure = "" if fits else f"pip install '{needed.name}{needed.specifier}'"
        yield Finding(needed.name, "ok" if fits else "broken", found or "not installed", cure)


def _extras() -> Iterator[Finding]:
    """Extras that are installed completely, and the missing packages of the others."""
    from importlib import metadata

    for extra in metadata.metadata("clutter-env").get_all("Provides-Extra") or ():
        if extra in _NOT_FOR_USERS:
            continue
        lacking = [needed.name for needed in _needed(extra) if not _version(needed.name)]
        said = f"without {', '.join(lacking)}" if lacking else "installed"
        cure = f"pip install 'clutter-env[{extra}]'" if lacking else ""
        yield Finding(f"[{extra}]", "missing" if lacking else "ok", said, cure)


_NOT_FOR_USERS = ("all", "dev", "docs")
"""Extras that bring together others, or are for work on the package itself."""


def _needed(extra: str) -> Iterator[Requirement]:
    """The libraries of an extra on this machine, those of the core for ""."""
    from importlib import metadata

    from packaging.requirements import Requirement

    for line in metadata.requires("clutter-env") or ():
        needed = Requirement(line)
        is_core = needed.marker is None or needed.marker.evaluate({"extra": ""})
        is_of_extra = needed.marker is not None and not is_core and needed.marker.evaluate({"extra": extra})
        if is_of_extra or (is_core and not extra):
            yield needed


def _version(library: str) -> str:
    """The installed version, "" without one."""
    from importlib import metadata

    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return ""


def _kept_kernels() -> Finding:
    """Whether compiled kernels can be kept, and how many are."""
    import os

    from irm.kinematics import fk_frames

    folder = getattr(fk_frames._cache, "cache_path", None)
    if folder is None:
        return Finding("kernels", "missing", "cannot be kept", "set NUMBA_CACHE_DIR to a folder that can be written")
    # Next to the sources each package has a folder. Elsewhere all lie below one folder.
    is_beside = Path(folder).name == "__pycache__"
    root = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(folder).parents[1 if is_beside else 0])
    count = sum(len([*(root / package if is_beside else root).rglob("*.nbi")]) for package in ("irm", "planners"))
    if not count:
        return Finding("kernels", "missing", f"none compiled yet, to be kept in {root}", "clutter-env warmup")
    return Finding("kernels", "ok", f"compiled, in {root}")


def _tried(name: str, check: Callable[[], str], state: Literal["missing", "broken"], cure: str) -> Finding:
    """The result of a check, or the exception that it raised. Every exception is caught, because the command reports
    defects."""
    try:
        return Finding(name, "ok", check())
    except Exception as problem:
        return Finding(name, state, f"{type(problem).__name__}: {problem}", cure)


def _step() -> str:
    import gymnasium as gym

    import clutter_env  # noqa: F401  registers the environments

    env = gym.make("clutter_env/Retrieve-o5-v0")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    return "makes a step"


def _plan() -> str:
    import time

    import gymnasium as gym

    import clutter_env  # noqa: F401  registers the environments
    from clutter_env.reporting.progress import shown_compilation
    from planners import Scene, Solution, solve, warmup

    with shown_compilation():
        warmup()
    env = gym.make("clutter_env/Retrieve-o5-v0")
    _, info = env.reset(seed=0)
    inner: Any = env.unwrapped
    started = time.process_time()
    found = solve(Scene.from_mujoco(inner.model, inner.data, inner.robot), info["target"])
    env.close()
    if not isinstance(found, Solution):
        raise RuntimeError(f"no plan where there is one: {found.detail}")
    return f"plans in {time.process_time() - started:.2f} s of CPU time"


def _draw() -> str:
    from clutter_env.rendering.renderer import make_context

    context = make_context(64, 64)
    context.free()
    return f"drawn with {type(context).__module__.removeprefix('mujoco.')}"
