"""Provenance of a recorded file: version, commit and environment, so that a changed one cannot pass for the old.

Results, demonstrations, maps, weights and suites keep `provenance(env)`; their readers say `differences(recorded,
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
"""Keyword arguments of an environment that change its pictures alone."""
IMAGES = "robot in images"
"""The part of an environment's digest that says what its observed images show of the robot: meshes, or the primitives
where these are not installed. Scores, which are those of replayed actions, do not depend on it."""
_ABILITIES = ("cameras", "segmentation", "num_points", "head", "reality", "base")
"""Keyword arguments that count only where they are not the default: records made before there were such stay valid."""
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
"""The source files whose code decides what an environment does, by what they decide."""
_NO_TASKS = ("gymnasium.", "clutter_env.envs.base")
"""Modules of environment classes that define no task."""
_PLATFORM = f"{platform.system()} {platform.machine()}"
_DIGITS = 16
"""Hexadecimal digits of a digest."""


def provenance(env: gym.Env[Any, Any] | str | None = None) -> dict[str, Any]:
    """The record to keep in a file: JSON values.

    Args:
        env: the environment in which something was recorded, or its id; None where there is none.

    Returns:
        `version` of this package; `commit` of the checkout it runs from, with "-dirty" after it if files are changed,
        None for an installed package; `mujoco`, its version; `platform`, system and processor; `arithmetic`, see
        `_arithmetic`; with an environment also `environment`, its digest.
    """
    record = {"version": version(), "commit": _commit(), "mujoco": mujoco.__version__}
    record |= {"platform": _PLATFORM, "arithmetic": _arithmetic()}
    return record if env is None else {**record, "environment": environment_digest(env)}


def environment_digest(env: gym.Env[Any, Any] | str) -> dict[str, Any]:
    """A digest of everything that decides what an environment does, part by part; JSON values.

    Two environments with the same digest have the same model, constants of physics, code of success, reward,
    observation and control, settings and time limit. Comments, docstrings and layout of the code do not count. What
    Skill adds (`simulation`, `budget`, `feasibility`, `geometric_mask`) is no part of it: records name it beside it.

    Args:
        env: an environment, wrapped or not, or the id of a registered one with its default settings.
    """
    return json.loads(_digest_of_id(env)) if isinstance(env, str) else _digest(env)


def differences(recorded: Mapping[str, Any] | None, present: Mapping[str, Any]) -> list[str]:
    """One sentence for everything in which two records of `provenance` differ; empty if nothing does.

    Two commits of the same version are named only if something else differs too: they need not change an environment.
    Environments are compared if both records have one.

    Args:
        recorded: from a file; None or empty for a file of version 0.1, which had no record.
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
    """A digest of the last bits of sines and the like, with which the physics computes: they depend on the C library,
    and with it on whether the processor has FMA."""
    values = [0.0037 * k - 7.5 for k in range(4096)]  # of which a few differ
    return _hash(*(value.hex() for function in (math.sin, math.cos, math.exp) for value in map(function, values)))


@cache
def _commit() -> str | None:
    """The commit of the package's own checkout, None without one: an installed package may lie in someone else's."""

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
        "settings": json.loads(json.dumps(settings, default=int)),  # integers of NumPy's become Python's
        "time limit": env.spec.max_episode_steps if env.spec else None,
        "model": _model_digest(inner.robot, inner.layout, config.slot_shapes),
        "task's code": _code_digest(*sorted(file for file in files if file)),
        **{name: _code_digest(*(str(_PACKAGE / file) for file in rules)) for name, rules in _RULES.items()},
        **({IMAGES: "meshes" if has_visuals(inner.robot) else "primitives"} if config.obs_mode != "state" else {}),
        **({"reality": _code_digest(str(_PACKAGE / "envs/reality.py"))} if "reality" in settings else {}),
    }


@cache
def _model_digest(robot: RobotSpec, layout: Layout, shapes: tuple[str, ...]) -> str:
    """A digest of the MuJoCo model and the robot's limits; neither meshes nor the place of the robot's file count."""
    spec = build_spec(robot, layout, shapes)
    spec.compile()  # which `to_xml` needs
    return _hash(spec.to_xml(), json.dumps({**asdict(robot), "mjcf": ""}))


@cache
def _code_digest(*files: str) -> str:
    """A digest of code without comments, docstrings and layout, the same for every version of Python."""
    return _hash(*(repr(_plain(ast.parse(Path(file).read_text()))) for file in files))


def _plain(node: Any) -> Any:
    """A syntax tree as nested lists, without docstrings and fields that are empty."""
    if isinstance(node, list):
        texts = [entry for entry in node if isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant)]
        return [_plain(entry) for entry in node if entry not in texts]
    if not isinstance(node, ast.AST):
        return node
    fields = [(name, value) for name, value in ast.iter_fields(node) if value not in (None, [])]
    return [type(node).__name__, *((name, _plain(value)) for name, value in fields)]


def _hash(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:_DIGITS]
