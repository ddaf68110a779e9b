"""The exceptions of this package; their messages say what was wrong and list what is valid."""

from __future__ import annotations


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
