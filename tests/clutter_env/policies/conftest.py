"""What several tests of policies share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import pytest

import clutter_env  # noqa: F401  registers the environments


@pytest.fixture(scope="session")
def env() -> Iterator[gym.Env[Any, Any]]:
    """Retrieve with five objects."""
    made = gym.make("clutter_env/Retrieve-o5-v0")
    yield made
    made.close()
