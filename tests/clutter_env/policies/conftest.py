"""What several tests of policies share."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import pytest

import clutter_env  # noqa: F401  registers the environments

# The learned policies need the extra [rl].
collect_ignore_glob = [] if find_spec("torch") and find_spec("sb3_contrib") else ["test_*.py"]


@pytest.fixture(scope="session")
def env() -> Iterator[gym.Env[Any, Any]]:
    """Retrieve with five objects."""
    made = gym.make("clutter_env/Retrieve-o5-v0")
    yield made
    made.close()
