"""The random generator of an environment stays as it was when a call is refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import gymnasium as gym

__all__ = ["generator_kept_on_error"]


@contextmanager
def generator_kept_on_error(env: gym.Env) -> Iterator[None]:
    """If the block raises, put back the environment's generator, its state and its seed; they may be None."""
    generator, seed = env._np_random, env._np_random_seed
    state = {} if generator is None else generator.bit_generator.state
    try:
        yield
    except BaseException:
        env._np_random, env._np_random_seed = generator, seed
        if generator is not None:
            generator.bit_generator.state = state
        raise
