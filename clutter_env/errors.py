"""Exceptions of this package, and checks that raise them. The messages name the wrong value and list the valid
values."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Integral, Real

EXTRAS = {
    **dict.fromkeys(("torch", "stable_baselines3", "sb3_contrib", "tensorboard"), "rl"),
    **dict.fromkeys(("h5py", "minari", "pyarrow", "av"), "data"),
    "ray": "distributed",
}
"""Modules that not every installation has, and the extra of the package that installs each."""


INSTALL = "pip install 'clutter-env["
"""Part of every message about an extra that is not installed. It survives the way from another process."""


def missing_extra(problem: BaseException) -> str:
    """Name of the module that is not installed by this exception, and how to install it. "" for all other
    exceptions."""
    name = (problem.name or "").partition(".")[0] if isinstance(problem, ModuleNotFoundError) else ""
    return f"{name} is not installed; {INSTALL}{EXTRAS[name]}]'" if name in EXTRAS else ""


class ClutterEnvError(ValueError):
    """Base of every exception raised here for misuse."""


class ConfigError(ClutterEnvError):
    """A keyword argument of an environment is unknown or invalid."""


class OptionError(ClutterEnvError):
    """An entry of `reset(options=...)` is unknown or invalid."""


class ActionError(ClutterEnvError):
    """An action is not a finite vector of the action space's shape. The environment has not changed."""


class StateError(ClutterEnvError):
    """The bytes given to `restore_state` are not a saved state of an environment like this one."""


class RenderingUnavailable(ClutterEnvError, RuntimeError):
    """This machine cannot render. The message names what is missing."""


class SuiteError(ClutterEnvError):
    """No such suite, or a scene that differs from that with which the suite was made."""


class UsageError(ClutterEnvError):
    """Arguments of a command do not go together, or name something that does not exist."""


class NoHome(UsageError, RuntimeError):
    """No home configuration of a robot is found. The message gives the reason and a remedy."""


class LearningError(ClutterEnvError):
    """A wrong argument for data, policies, training or evaluation."""


class DatasetError(LearningError):
    """A directory or file lacks the required content. The message describes its content."""


class CollectionError(LearningError, RuntimeError):
    """The collection had to stop because of a full disk, dying workers or too many rejected seeds. Stored episodes stay
    valid."""


class UnknownExpert(LearningError):
    """No expert of that name for that environment. The message lists the known experts."""


class UnknownTask(LearningError):
    """No environment of that name, or not with those keyword arguments. The message lists the known environments."""


def check_choice(name: str, value: object, valid: Iterable[object], error: type[ClutterEnvError] = ConfigError) -> None:
    """Raise an error unless `value` is one of `valid` (compared by type and value)."""
    choices = list(valid)
    if not any(type(value) is type(choice) and value == choice for choice in choices):
        raise error(f"{name}={value!r} is not valid; valid values: {', '.join(repr(c) for c in choices)}")


def check_integer(
    name: str, value: object, lowest: int, highest: int | None = None, error: type[ClutterEnvError] = ConfigError
) -> int:
    """The value as an int. Raise an error unless it is an integer between `lowest` and `highest`, both included."""
    wanted = f"an integer of at least {lowest}" if highest is None else f"an integer from {lowest} to {highest}"
    most = math.inf if highest is None else highest
    if not isinstance(value, Integral) or isinstance(value, bool) or not lowest <= int(value) <= most:
        raise error(f"{name}={value!r} is not valid; it must be {wanted}")
    return int(value)


def check_number(
    name: str, value: object, limits: tuple[float, float], unit: str, error: type[ClutterEnvError] = ConfigError
) -> float:
    """The value as a float. Raise an error unless it is a number between the limits, both included."""
    lowest, highest = limits
    if not isinstance(value, Real) or isinstance(value, bool) or value < lowest or not value <= highest:
        raise error(f"{name}={value!r} must be a number from {lowest:.4g} to {highest:.4g} [{unit}]")
    return float(value)
