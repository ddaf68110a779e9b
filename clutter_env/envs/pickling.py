"""Pickles of environments: keyword arguments, what `gym.Env` keeps, and a saved state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym

__all__ = ["kept_attributes", "make_again"]

_KEPT = ("spec", "action_space", "observation_space", "_np_random", "_np_random_seed")
"""Attributes of gym.Env that a pickle takes along as they are; the spaces have random generators of their own."""


def kept_attributes(env: gym.Env) -> dict[str, Any]:
    """The attributes of `gym.Env` that a pickle takes along."""
    return {name: env.__dict__[name] for name in _KEPT if name in env.__dict__}


def make_again(
    make: Callable[..., Any], keywords: dict[str, Any], attributes: dict[str, Any], saved: bytes | None
) -> Any:
    """The environment of a pickle.

    Args:
        make: its class.
        keywords: its keyword arguments.
        attributes: from `kept_attributes`.
        saved: bytes from `save_state`; None if `reset` had not been called.
    """
    env = make(**keywords)
    env.__dict__.update(attributes)
    if saved is not None:
        env.restore_state(saved)
    return env
