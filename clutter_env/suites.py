"""Suites: fixed sets of scenes on which policies are compared. docs/suites.md has the rules.

A scene is an environment id, keyword arguments, and the seed and options of a reset. The suite's file also keeps
digests of the state after the reset. A scene that differs on another machine or with another version is therefore an
error, not a slightly different figure.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np

import assets
from clutter_env.errors import SuiteError

SPLITS = ("test", "validation")
FILE = ".json"
"""Suffix of a suite's name that is a file."""
GRASPS = ("side", "all")
"""Grasp sets for which the suites have lower bounds: level side grasps, and grasps of all kinds."""
_DIGITS = 12
"""Hexadecimal digits of the digest of one part of a scene."""
_ARRAYS = ("half_extents", "positions", "yaws", "masses", "base")


@dataclass(frozen=True)
class Floor:
    """The minimum number of clearances, see `planners.clearance_floor` and `planners.lower_bound`.

    For Rearrange: picks beyond those of the objects that the goal moves.

    Attributes:
        count: number of clearances, None if no plan exists.
        is_proved: `count` is exact for the grasps and base poses that the planner sampled then. Otherwise it is an
            upper bound.
        cause: the reason if no plan exists, else "".
    """

    count: int | None
    is_proved: bool
    cause: str = ""


@dataclass(frozen=True)
class SuiteScene:
    """One scene of a suite.

    Attributes:
        suite: name of the suite.
        split: "test" or "validation".
        index: of the scene in its split.
        env_id: of the environment.
        keywords: keyword arguments of `gymnasium.make`.
        max_steps: control steps after which an episode is over, see docs/suites.md.
        seed, options: of the reset.
        target: name of the target.
        floor_side: for side grasps.
        floor_all: for grasps of all kinds.
        digests: of each part of the first state, see `scene_digests`.
    """

    suite: str
    split: str
    index: int
    env_id: str
    keywords: Mapping[str, Any]
    max_steps: int
    seed: int
    options: Mapping[str, Any]
    target: str
    floor_side: Floor | None
    floor_all: Floor | None
    digests: Mapping[str, str]

    def floor(self, grasps: str) -> Floor:
        """The floor for a grasp set.

        Raises:
            SuiteError: neither "side" nor "all", or the floor has not been computed.
        """
        if grasps not in GRASPS:
            raise SuiteError(f"no floors for grasps={grasps!r}; the suites have them for: {', '.join(GRASPS)}")
        found = self.floor_side if grasps == "side" else self.floor_all
        if found is None:
            raise SuiteError(f"suite {self.suite!r} has no floors for grasps={grasps!r}")
        return found

    def make(self, **keywords: Any) -> gym.Env[Any, Any]:
        """Make the environment of this scene, with more keyword arguments that do not change the scene.

        Raises:
            SuiteError: a keyword argument of the suite is given another value.
        """
        for name in keywords:
            if name in self.keywords and keywords[name] != self.keywords[name]:
                raise SuiteError(
                    f"{name}={keywords[name]!r}: suite {self.suite!r} is made with {self.keywords[name]!r}"
                )
        return gym.make(self.env_id, max_episode_steps=self.max_steps, **{**self.keywords, **keywords})

    def reset(self, env: gym.Env[Any, Any]) -> tuple[Any, dict[str, Any]]:
        """Start the episode of this scene, with its time limit. Return observation and info.

        Args:
            env: from `make` of this or another scene of the suite.

        Raises:
            SuiteError: the first state differs from that with which the suite was made, and the message names the
                differences. Or the environment has no time limit.
        """
        if not env.set_wrapper_attr("_max_episode_steps", self.max_steps, force=False):
            raise SuiteError("the environment has no time limit; use the one that the `make` of a scene returns")
        if env.spec is not None:
            env.spec.max_episode_steps = self.max_steps
        observation, info = env.reset(seed=self.seed, options=dict(self.options))
        self.check(env)
        return observation, info

    def check(self, env: gym.Env[Any, Any]) -> None:
        """Compare the present state, after a reset, with that with which the suite was made.

        Raises:
            SuiteError: they differ. The message names the differences.
        """
        found = scene_digests(env)
        wrong = [name for name, digest in self.digests.items() if found.get(name) != digest]
        if wrong:
            raise SuiteError(
                f"scene {self.index} of suite {self.suite!r} ({self.split}, seed {self.seed}) is not the one that the "
                f"suite was made with; what differs: {', '.join(wrong)}"
            )


@dataclass(frozen=True)
class Suite:
    """A fixed set of scenes. Iterating over it yields those of the test split.

    Attributes:
        name: with its version, as in "side-15-v3".
        about: description of the scenes.
        digest: SHA-256 of the content of its file.
        made_with: versions of the packages that it was made with.
        test: scenes on which results are reported.
        validation: scenes on which a policy may be tuned.
    """

    name: str
    about: str
    digest: str
    made_with: Mapping[str, str]
    test: tuple[SuiteScene, ...]
    validation: tuple[SuiteScene, ...]

    def __iter__(self) -> Iterator[SuiteScene]:
        return iter(self.test)

    def __len__(self) -> int:
        return len(self.test)

    def split(self, name: str) -> tuple[SuiteScene, ...]:
        """The scenes of a split.

        Raises:
            SuiteError: no such split. The message lists the splits.
        """
        if name not in SPLITS:
            raise SuiteError(f"no split {name!r}; splits: {', '.join(SPLITS)}")
        return self.test if name == "test" else self.validation


def suite_names() -> tuple[str, ...]:
    """Names of the suites."""
    return assets.names("suites")


def suite(name: str) -> Suite:
    """The suite of that name, read once in a process.

    Example:
        >>> import clutter_env
        >>> scene = clutter_env.suite("side-15-v3").test[0]
        >>> env = scene.make()
        >>> observation, info = scene.reset(env)
        >>> info["target"] == scene.target
        True

    A name that ends in ".json" is a file of `clutter-env challenge new`.

    Raises:
        SuiteError: no suite of that name. The message lists the suites, and names the version that replaced it. Or its
            file has been changed, or is not valid.
    """
    if isinstance(name, str) and name.endswith(FILE):
        return read_suite(Path(name))
    names = suite_names()
    if not isinstance(name, str) or name not in names:
        stem = str(name).rpartition("-v")[0]
        newer = "".join(f" {known!r} has replaced it;" for known in names if known.rpartition("-v")[0] == stem)
        raise SuiteError(f"no suite {name!r};{newer} suites: {', '.join(names)}")
    return read_suite(assets.path(f"suites/{name}.json"))


def read_suite(path: Path) -> Suite:
    """Read the suite of a file. Its content is read once in a process.

    Raises:
        SuiteError: the file has been changed, or is not valid.
    """
    try:
        text = path.read_text()
    except (OSError, ValueError) as problem:  # errors of Unicode are ValueErrors
        raise SuiteError(f"the file of suite {path.stem!r} cannot be read: {problem}") from None
    return _parsed(text, f"the file of suite {path.stem!r}")


@lru_cache(maxsize=64)
def _parsed(text: str, place: str) -> Suite:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise SuiteError(f"{place} cannot be read: {problem}") from None
    try:
        digest = content.pop("sha256")
        if digest != content_digest(content):
            raise SuiteError(f"{place} has been changed: its content does not have the digest {digest}")
        shared = {
            "suite": content["name"],
            "env_id": content["env_id"],
            **{key: MappingProxyType(content[key]) for key in ("keywords", "options")},
        }
        splits = {
            split: tuple(SuiteScene(split=split, index=k, **shared, **_read(entry)) for k, entry in enumerate(entries))
            for split, entries in ((split, content["scenes"][split]) for split in SPLITS)
        }
        return Suite(content["name"], content["about"], digest, MappingProxyType(content["made_with"]), **splits)
    except KeyError as problem:
        raise SuiteError(f"{place} lacks the entry {problem}") from None
    except (AttributeError, TypeError) as problem:  # a list where a dictionary should be, and the like
        raise SuiteError(f"{place} is not valid: {problem}") from None


def content_digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of JSON values, independent of the file's layout."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def scene_digests(env: gym.Env[Any, Any]) -> dict[str, str]:
    """Digests of the scene's numbers, its goal in Rearrange, and the positions of all joints in the present state.

    All 64 bits of each number are digested, so that a difference in the last bit shows.
    """
    outer: Any = env.unwrapped
    inner = getattr(outer, "physics_env", outer)  # of a Skill environment
    scene = inner.world.scene
    parts = {name: getattr(scene, name) for name in _ARRAYS}
    parts |= {"shapes": scene.is_box, "target": scene.target, "joint_positions": inner.data.qpos}
    digests = {name: _digest(np.asarray(value, "<f8")) for name, value in parts.items()}
    if "goal" in inner.info:
        # Suites are older than the field `drop`, and none of their regions has one.
        words = [inner.info["goal"], *(repr(region).replace(", drop=0.0", "") for region in inner.regions)]
        digests["goal"] = hashlib.sha256("\n".join(words).encode()).hexdigest()[:_DIGITS]
    return digests


def _digest(numbers: np.ndarray[Any, Any]) -> str:
    return hashlib.sha256(f"{numbers.shape}".encode() + numbers.tobytes()).hexdigest()[:_DIGITS]


def _read(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Read the fields of a scene from an entry of a file."""
    bounds = {name: entry[name] for name in ("floor_side", "floor_all")}
    floors = {name: of and Floor(of["count"], of["is_proved"], of["cause"]) for name, of in bounds.items()}
    plain = {name: entry[name] for name in ("max_steps", "seed", "target")}
    return {**plain, **floors, "digests": MappingProxyType(entry["digests"])}
