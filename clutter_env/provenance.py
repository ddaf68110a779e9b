"""Provenance of a recorded file: version, commit and environment, so that changes since then are detected.

Results, demonstrations, maps, weights and suites store `provenance(env)`. Their readers report `differences(recorded,
provenance(env))`.
"""

from __future__ import annotations

import ast
import hashlib
import json
import math
import platform
import subprocess
import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, fields
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco

from assets import RobotSpec
from clutter_env.config import EnvConfig
from clutter_env.envs.base import layout_identity
from clutter_env.scene.layout import Layout
from clutter_env.simulation.model import build_spec, has_visuals
from clutter_env.version import version

_PACKAGE = Path(__file__).parent
_PICTURES = ("render_mode", "camera", "width", "height")
"""Keyword arguments of an environment that change only its pictures."""
IMAGES = "robot in images"
"""Part of an environment's digest: whether observed images show the robot's meshes, or its primitives where these are
not installed. Scores are those of replayed actions and do not depend on it."""
_ABILITIES = ("cameras", "segmentation", "num_points", "head", "reality", "base", "roles")
"""Keyword arguments that are recorded only if they differ from the default. So records that are older than them stay
valid."""
_RULES = {
    "physics": (
        "envs/base.py",
        *(f"simulation/{name}.py" for name in ("control", "world", "model", "contacts", "pressing")),
    ),
    "end-effector control": ("simulation/end_effector.py", "simulation/self_avoidance.py"),
    "scenes": tuple(
        f"scene/{name}.py" for name in ("layout", "object_sets", "household", "random_scene", "obstruction")
    ),
    "success": ("envs/success.py",),
    "reward": ("envs/reward.py",),
    "observation": ("envs/observation.py",),
}
"""Source files whose code decides an environment's behaviour, by the aspect that they decide."""
_NO_TASKS = ("gymnasium.", "clutter_env.envs.base")
"""Modules of environment classes that define no task."""
_PLATFORM = f"{platform.system()} {platform.machine()}"
_DIGITS = 16
"""Hexadecimal digits of a digest."""


def provenance(env: gym.Env[Any, Any] | str | None = None) -> dict[str, Any]:
    """The record to keep in a file: JSON values.

    Args:
        env: the environment of the recording, or its id, or None.

    Returns:
        `version` of this package. `commit` of its checkout, with the suffix "-dirty" if files are changed, None for an
            installed package. `mujoco`, its version. `platform`, system and processor. `arithmetic`, see `_arithmetic`.
            With an environment also `environment`, its digest.
    """
    record = {"version": version(), "commit": _commit(), "mujoco": mujoco.__version__}
    record |= {"platform": _PLATFORM, "arithmetic": _arithmetic()}
    return record if env is None else {**record, "environment": environment_digest(env)}


def environment_digest(env: gym.Env[Any, Any] | str) -> dict[str, Any]:
    """A digest of everything that decides an environment's behaviour, part by part, as JSON values.

    Two environments with the same digest have the same model, constants of physics, settings and time limit, and the
    same code of success, reward, observation and control. Comments, docstrings and code layout are ignored. The options
    that Skill adds (`simulation`, `budget`, `feasibility`, `geometric_mask`) are not included. Records list them
    separately.

    Args:
        env: an environment, wrapped or not, or the id of a registered environment with its default settings.
    """
    return json.loads(_digest_of_id(env)) if isinstance(env, str) else _digest(env)


def differences(recorded: Mapping[str, Any] | None, present: Mapping[str, Any]) -> list[str]:
    """One sentence for each difference between two records of `provenance`, empty without any.

    Two commits of the same version are named only if something else differs too, because a commit need not change an
    environment. Environments are compared if both records have one.

    Args:
        recorded: from a file. None or empty for a file of version 0.1, which had no record.
        present: of this process.
    """
    if not recorded:
        return ["It was recorded by version 0.1, which did not note what it was made with."]
    said = [
        f"It was recorded with {name} {recorded.get(name)}; this is {present[name]}."
        for name in ("version", "mujoco")
        if recorded.get(name) != present[name]
    ]
    old, new = recorded.get("environment"), present.get("environment")
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for name in sorted({*old, *new} - {"settings"}):
            if old.get(name) != new.get(name) and not (name == IMAGES and name not in old):
                values = f": {old.get(name)}, now {new.get(name)}" if name in ("task", "time limit", IMAGES) else ""
                said.append(f"The environment's {name} has changed{values}.")
        parts = (old.get("settings"), new.get("settings"))
        before, now = (part if isinstance(part, Mapping) else {} for part in parts)
        for name in sorted({*before, *now}):
            if before.get(name) != now.get(name):
                said.append(
                    f"The environment was made with {name}={before.get(name)!r}; this one has {now.get(name)!r}."
                )
    if said and recorded.get("commit") != present["commit"]:
        said.append(f"It was recorded at commit {recorded.get('commit')}; this is {present['commit']}.")
    return said


@cache
def _arithmetic() -> str:
    """A digest of the last bits of sines and similar functions in the physics. They depend on the C library, and so on
    whether the processor has FMA."""
    values = [0.0037 * k - 7.5 for k in range(4096)]  # a few of these values differ
    return _hash(*(value.hex() for function in (math.sin, math.cos, math.exp) for value in map(function, values)))


@cache
def _commit() -> str | None:
    """Commit of the package's own checkout, None without it, because an installed package may lie in another
    checkout."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", "-C", str(_PACKAGE), *words], capture_output=True, text=True, timeout=5, check=True
        ).stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")) != _PACKAGE.parent.resolve():
            return None
        return git("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.SubprocessError):
        return None


@cache
def _digest_of_id(env_id: str) -> str:
    with closing(gym.make(env_id, disable_env_checker=True)) as env:
        return json.dumps(_digest(env))


def _digest(env: gym.Env[Any, Any]) -> dict[str, Any]:
    outer: Any = env.unwrapped
    inner = getattr(outer, "physics_env", outer)  # of a Skill environment
    config: EnvConfig = inner.config
    defaults = {entry.name: entry.default for entry in fields(config) if entry.name in _ABILITIES}
    settings = {
        name: value
        for name, value in vars(config).items()
        if name not in _PICTURES and (name not in defaults or value != defaults[name])
    }
    settings |= {"layout": layout_identity(inner.layout), "robot": inner.robot.name}
    kinds = {
        kind.__module__: kind for kind in (*type(outer).__mro__, *type(inner).__mro__) if issubclass(kind, gym.Env)
    }
    modules = (*(name for name in kinds if not name.startswith(_NO_TASKS)), *inner.task_modules)
    files = [getattr(sys.modules[module], "__file__", None) for module in modules]
    return {
        "task": type(outer).__name__,
        "settings": json.loads(json.dumps(settings, default=int)),  # NumPy integers become Python's
        "time limit": env.spec.max_episode_steps if env.spec else None,
        "model": _model_digest(inner.robot, inner.layout, config.slot_shapes),
        "task's code": _code_digest(*sorted(file for file in files if file)),
        **{name: _code_digest(*(str(_PACKAGE / file) for file in rules)) for name, rules in _RULES.items()},
        **({IMAGES: "meshes" if has_visuals(inner.robot) else "primitives"} if config.obs_mode != "state" else {}),
        **({"reality": _code_digest(str(_PACKAGE / "envs/reality.py"))} if "reality" in settings else {}),
    }


@cache
def _model_digest(robot: RobotSpec, layout: Layout, shapes: tuple[str, ...]) -> str:
    """A digest of the MuJoCo model and the robot's limits, without meshes and the path of the robot's file."""
    spec = build_spec(robot, layout, shapes)
    spec.compile()  # needed by `to_xml`
    return _hash(spec.to_xml(), json.dumps({**asdict(robot), "mjcf": ""}))


@cache
def _code_digest(*files: str) -> str:
    """A digest of code without comments, docstrings and layout. It is the same for every version of Python."""
    return _hash(*(repr(_plain(ast.parse(Path(file).read_text()))) for file in files))


def _plain(node: Any) -> Any:
    """A syntax tree as nested lists, without docstrings and empty fields."""
    if isinstance(node, list):
        texts = [entry for entry in node if isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant)]
        return [_plain(entry) for entry in node if entry not in texts]
    if not isinstance(node, ast.AST):
        return node
    fields = [(name, value) for name, value in ast.iter_fields(node) if value not in (None, [])]
    return [type(node).__name__, *((name, _plain(value)) for name, value in fields)]


def _hash(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:_DIGITS]
