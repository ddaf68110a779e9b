"""The exceptions of this package: all say what was wrong and what would have been right."""

from __future__ import annotations

__all__ = ["ActionError", "ClutterEnvError", "ConfigError", "OptionError", "RenderingUnavailable", "StateError"]


class ClutterEnvError(ValueError):
    """Base of every exception raised here for misuse."""


class ConfigError(ClutterEnvError):
    """A keyword argument of an environment is unknown or invalid."""


class OptionError(ClutterEnvError):
    """An entry of `reset(options=...)` is unknown or invalid."""


class ActionError(ClutterEnvError):
    """An action is not a finite vector of the action space's shape; the environment has not changed."""


class StateError(ClutterEnvError):
    """Bytes given to `restore_state` are no saved state of this kind of environment."""


class RenderingUnavailable(ClutterEnvError, RuntimeError):
    """No picture can be drawn on this machine; the message says what is missing."""
