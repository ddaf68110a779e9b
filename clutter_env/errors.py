"""The exceptions of this package, whose messages say what was wrong and list what is valid; checks that raise them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real

EXTRAS = {
    **dict.fromkeys(("torch", "stable_baselines3", "sb3_contrib", "tensorboard"), "rl"),
    **dict.fromkeys(("h5py", "minari", "pyarrow", "av"), "data"),
    "ray": "distributed",
}
"""Modules that not every installation has, and the extra of the package that brings each."""


def missing_extra(problem: BaseException) -> str:
    """The module that an exception says is not installed, and how to install it; "" for all other exceptions."""
    name = (problem.name or "").partition(".")[0] if isinstance(problem, ModuleNotFoundError) else ""
    return f"{name} is not installed; pip install 'clutter-env[{EXTRAS[name]}]'" if name in EXTRAS else ""


class ClutterEnvError(ValueError):
    """Base of every exception raised here for misuse."""


class ConfigError(ClutterEnvError):
    """A keyword argument of an environment is unknown or invalid."""


class OptionError(ClutterEnvError):
    """An entry of `reset(options=...)` is unknown or invalid."""


class ActionError(ClutterEnvError):
    """An action is not a finite vector of the action space's shape; the environment has not changed."""


class StateError(ClutterEnvError):
    """The bytes given to `restore_state` are not a saved state of an environment like this one."""


class RenderingUnavailable(ClutterEnvError, RuntimeError):
    """This machine cannot render; the message says what is missing."""


class SuiteError(ClutterEnvError):
    """No such suite, or a scene of a suite that is not the one that the suite was made with."""


class UsageError(ClutterEnvError):
    """Arguments of a command that do not go together, or name something that there is not."""


class NoHome(UsageError, RuntimeError):
    """No home configuration of a robot is found; the message says why, and what to try."""


class LearningError(ClutterEnvError):
    """A wrong argument for data, policies, training or evaluation."""


class DatasetError(LearningError):
    """A directory or file does not hold what is needed; the message says what it holds."""


class CollectionError(LearningError, RuntimeError):
    """The collection had to stop: full disk, workers that die, too many rejected seeds. Stored episodes stay valid."""


class UnknownExpert(LearningError):
    """No expert of that name for that environment; the message lists the known ones."""


class UnknownTask(LearningError):
    """No environment of that name, or not with those keyword arguments; the message lists the known ones."""


def check_choice(name: str, value: object, valid: Iterable[object], error: type[ClutterEnvError] = ConfigError) -> None:
    """Raise an error unless `value` is one of `valid` (compared by type and value)."""
    choices = list(valid)
    if not any(type(value) is type(choice) and value == choice for choice in choices):
        raise error(f"{name}={value!r} is not valid; valid values: {', '.join(repr(c) for c in choices)}")


def check_integer(
    name: str, value: object, lowest: int, highest: int | None = None, error: type[ClutterEnvError] = ConfigError
) -> int:
    """The value as an int; raise an error unless it is an integer between `lowest` and `highest`, both included."""
    wanted = f"an integer of at least {lowest}" if highest is None else f"an integer from {lowest} to {highest}"
    most = math.inf if highest is None else highest
    if not isinstance(value, Integral) or isinstance(value, bool) or not lowest <= int(value) <= most:
        raise error(f"{name}={value!r} is not valid; it must be {wanted}")
    return int(value)


def check_number(
    name: str, value: object, limits: tuple[float, float], unit: str, error: type[ClutterEnvError] = ConfigError
) -> float:
    """The value as a float; raise an error unless it is a number between the limits, both included."""
    lowest, highest = limits
    if not isinstance(value, Real) or isinstance(value, bool) or value < lowest or not value <= highest:
        raise error(f"{name}={value!r} must be a number from {lowest:.4g} to {highest:.4g} [{unit}]")
    return float(value)
