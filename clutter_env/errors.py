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
