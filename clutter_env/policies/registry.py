"""Policies by name: the built-in ones, training runs, and those of other people by import name."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import logging
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from clutter_env import GOAL_FAMILIES
from clutter_env.errors import ClutterEnvError, missing_extra
from clutter_env.policies.experts import EXPERTS, PLANNERS, GreedyPolicy, RandomPolicy, ScriptedExpert, make_expert
from clutter_env.policies.lerobot import LeRobotPolicy
from clutter_env.policies.protocol import FREE_KEYWORDS, AnyPolicy, PolicyError
from clutter_env.policies.runs import is_run, run_task
from clutter_env.policies.scripted import direct_approach
from clutter_env.suites import GRASPS

_log = logging.getLogger(__name__)
_LOGS = (".jsonl", ".png")
"""Files of a training run that are no part of its policy."""
_BASELINES: Mapping[str, Callable[[int], AnyPolicy]] = {
    "greedy": lambda _: GreedyPolicy(),
    "direct-approach": lambda _: ScriptedExpert("direct-approach", direct_approach, "side"),
    "random": RandomPolicy,
    "random-skills": partial(RandomPolicy, acts_by_skills=True),
}
_SHIPPED = MappingProxyType({"keyframes": "side", "keyframes-all": "all", "keyframes-shelf": "shelf"})
"""Policies of two levels with the weights of the package, see `weights.PROBLEMS`."""
END_TO_END = "end-to-end"
"""The policy of one network with the weights of the package, and, before a colon, with those of a file."""
LEROBOT = "lerobot"
"""Prefix of the name of a LeRobot checkpoint, before the colon."""
BUILT_IN = (*EXPERTS, *_SHIPPED, END_TO_END, *_BASELINES)
"""Names of the built-in policies."""


def load_policy(name: str, seed: int, trust: bool = False, python: str = "") -> AnyPolicy:
    """Load a policy by its name.

    Args:
        name: an entry of `BUILT_IN`, or the directory of a training run. Or "module:Class" of a class without
            arguments. Modules are also looked up in the current directory. Or "ALGORITHM:FILE.zip" of a model that
            Stable-Baselines3 saved, or "lerobot:DIRECTORY" of a LeRobot checkpoint, or "end-to-end:FILE.npz" of trained
            weights.
        seed: of random built-in policies, and of LeRobot policies that draw random numbers.
        trust: whether to load a file of Stable-Baselines3, which executes code in the file. Otherwise only a named
            module executes code.
        python: interpreter of an environment with LeRobot, for "lerobot:DIRECTORY", "" for the present interpreter.

    Raises:
        PolicyError: the policy does not exist, lacks the methods of the protocol, or needs `trust`.
    """
    if name in EXPERTS:
        return make_expert(name)
    if name in _BASELINES:
        return _BASELINES[name](seed)
    kind, _, attribute = name.partition(":")
    if kind == LEROBOT:
        return LeRobotPolicy(Path(attribute), python, seed)
    if name in _SHIPPED or kind == END_TO_END or is_run(name) or attribute.endswith(".zip"):
        try:
            return _learned_policy(name, trust)
        except ModuleNotFoundError as problem:
            raise PolicyError(missing_extra(problem) or str(problem)) from problem
    check_name(name)
    make_own = imported(name, PolicyError(f"policy {name!r} cannot be imported"))
    try:
        inspect.signature(make_own).bind()
    except TypeError as problem:
        raise PolicyError(
            f"policy {name!r} cannot be made: {problem}; name a class, or a function that returns a policy, without "
            "required arguments"
        ) from None
    policy: AnyPolicy = make_own()
    check_policy(policy, name)
    return policy


def check_name(name: str) -> None:
    """Refuse a text that can name no policy (`PolicyError`), before anything is loaded."""
    if ":" not in name and name not in BUILT_IN and not is_run(name):
        raise PolicyError(
            f"no policy {name!r}; give module:Class, the directory of a training run, ALGORITHM:FILE.zip, "
            f"lerobot:DIRECTORY, {END_TO_END}:FILE.npz, or one of {', '.join(BUILT_IN)}"
        )


def imported(name: str, refusal: ClutterEnvError) -> Any:
    """Import the object "module:NAME". Raise the refusal, with its cause, if the module or name does not exist."""
    module, _, attribute = name.partition(":")
    if (here := str(Path.cwd())) not in sys.path:  # a console script does not look in the current directory
        sys.path.insert(0, here)
    try:
        loaded = importlib.import_module(module)
    except ModuleNotFoundError as problem:
        # What a user's own module fails to import is the user's error, with its traceback.
        if problem.name is None or not f"{module}.".startswith(f"{problem.name}."):
            raise
        raise type(refusal)(f"{refusal}: there is no module {problem.name!r}") from problem
    if not hasattr(loaded, attribute):
        raise type(refusal)(f"{refusal}: {module} has no {attribute!r}")
    return getattr(loaded, attribute)


def _learned_policy(name: str, trust: bool) -> AnyPolicy:
    """A policy that needs torch, which the others do without."""
    if name in _SHIPPED:
        from clutter_env.policies.two_level import shipped_policy

        return shipped_policy(_SHIPPED[name])
    if is_run(name):
        from clutter_env.policies.reinforcement import RunPolicy

        return RunPolicy(Path(name))
    algorithm, _, file = name.partition(":")
    if algorithm == END_TO_END:
        from clutter_env.policies.end_to_end.policy import KIND, EndToEndPolicy
        from clutter_env.policies.weights import shipped_path

        if name != END_TO_END and not file:
            raise PolicyError(f"{name!r} names no file; give {END_TO_END}:FILE.npz, or {END_TO_END} alone")
        return EndToEndPolicy.load(Path(file) if file else shipped_path(KIND, "side"))
    executes = f"{file} is a file of Stable-Baselines3, and loading it executes code that is in it"
    if not trust:
        raise PolicyError(f"{executes}; if you trust those who made it: --trust, or load_policy(..., trust=True)")
    _log.warning("%s", executes)
    from clutter_env.policies.reinforcement import ZipPolicy

    return ZipPolicy(algorithm, Path(file))


@dataclass(frozen=True)
class PolicyTraits:
    """Properties of a policy that an evaluation needs.

    Attributes:
        track: "observations", "privileged" for a policy that receives the environment, or "human" for a person's moves.
        env_keywords: keyword arguments that it requires of the environment.
        acts_by_skills: whether it plays the Skill environment of the scenes.
        grasps: "side" or "all", by whose lower bounds its results are broken down.
        kind: name of its class.
        file: of the class, "" if it was defined in a shell.
    """

    track: str
    env_keywords: Mapping[str, Any]
    acts_by_skills: bool
    grasps: str
    kind: str
    file: str

    @classmethod
    def of(cls, policy: AnyPolicy) -> PolicyTraits:
        """Traits of a policy. Raise `PolicyError`, see `check_policy`."""
        check_policy(policy)
        kind = type(policy)
        try:
            file = inspect.getfile(kind)
        except (TypeError, OSError):  # defined in a shell
            file = ""
        return cls(
            track=track_of(policy),
            env_keywords=dict(getattr(policy, "env_keywords", {})),
            acts_by_skills=bool(getattr(policy, "acts_by_skills", False)),
            grasps=str(getattr(policy, "grasps", "all")),
            kind=kind.__qualname__,
            file=file,
        )

    @classmethod
    def read(cls, values: Any) -> PolicyTraits:
        """Traits as reported by a policy's process. They are validated here (`PolicyError`)."""
        match values:
            case {
                "track": "observations" | "privileged" | "human",
                "env_keywords": dict(keywords),
                "acts_by_skills": bool(),
                "grasps": grasps,
                "kind": str(),
                "file": str(),
            } if len(values) == 6 and set(keywords) <= set(FREE_KEYWORDS) and grasps in GRASPS:
                return cls(**values)
        raise PolicyError(
            f"the policy's process says {values!r} of the policy; it may choose {', '.join(FREE_KEYWORDS)}, and "
            f"grasps: {', '.join(GRASPS)}"
        )

    @property
    def place(self) -> str:
        """Its class and the file of that, for messages."""
        return f"{self.kind} in {self.file}" if self.file else self.kind


def track_of(policy: AnyPolicy) -> str:
    """Track of a policy: see `PolicyTraits`."""
    if getattr(policy, "is_human", False):
        return "human"
    return "privileged" if getattr(policy, "is_privileged", False) else "observations"


def policy_files(name: str, module_file: str = "") -> dict[str, str]:
    """SHA-256 of a policy's files, by name. Empty for a policy without files.

    The files are the weights of the package, a training run, a LeRobot checkpoint, a model of Stable-Baselines3, or the
    user's own module.

    Args:
        name: see `load_policy`.
        module_file: the file of the user's module, if it is known. Otherwise it is looked up in the current directory.
    """
    files: list[Path] = []
    if name in (*_SHIPPED, END_TO_END):
        from clutter_env.policies.weights import shipped_path  # needs torch

        kinds = (END_TO_END,) if name == END_TO_END else ("decisions", "motions")
        files = [shipped_path(kind, _SHIPPED.get(name, "side")) for kind in kinds]
    module, _, attribute = name.partition(":")
    if is_run(name) or module == LEROBOT:
        folder = Path(attribute if module == LEROBOT else name)  # of a results file, it may not be here
        files = sorted(path for path in folder.glob("*") if path.is_file() and path.suffix not in _LOGS)
    elif (module == END_TO_END or attribute.endswith(".zip")) and Path(attribute).is_file():
        files.append(Path(attribute))
    elif attribute and (source := Path(module_file or f"{module.replace('.', '/')}.py")).is_file():
        files.append(source)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def check_policy(policy: AnyPolicy, name: str = "") -> None:
    """Refuse an object that is no policy, or whose attributes are not valid (`PolicyError`, which lists the valid
    values)."""
    name = repr(name or type(policy).__name__)
    for method in ("reset", "act"):
        if not callable(getattr(policy, method, None)):
            raise PolicyError(f"policy {name} has no method {method!r}; a policy has reset(info) and act(observation)")
    env = inspect.signature(policy.reset).parameters.get("env")
    if env is not None and env.default is env.empty and not getattr(policy, "is_privileged", False):
        raise PolicyError(
            f"policy {name} has reset(env, info), as in version 0.1; a policy has reset(info), a privileged one "
            "is_privileged = True and reset(info, env)"
        )
    for keyword in getattr(policy, "env_keywords", {}):
        if keyword not in FREE_KEYWORDS:
            raise PolicyError(f"a policy may not choose {keyword!r}; it may choose {', '.join(FREE_KEYWORDS)}")
    grasps = getattr(policy, "grasps", "all")
    if grasps not in GRASPS:
        raise PolicyError(f"a policy's grasps={grasps!r} are not valid; it may have {', '.join(GRASPS)}")


def policy_families(name: str) -> tuple[str, ...]:
    """Families of environments whose scenes a policy can play. For other people's policies: all."""
    with_scripts = ("armretrieve", *GOAL_FAMILIES)
    every = ("retrieve", "rearrange", "search", "skill", "open", *with_scripts)
    if name in with_scripts:
        return (name,)
    if is_run(name):
        own = run_task(Path(name)).family
        return ("retrieve", "skill") if own == "skill" else (own,)
    if name in ("greedy", "random-skills"):
        return ("retrieve", "skill")
    if name in PLANNERS:
        return ("retrieve", "rearrange", "open")
    is_own = name in BUILT_IN or name.startswith(f"{END_TO_END}:")
    return ("retrieve",) if is_own and name != "random" else every
