"""Our environments for robomimic, whose own wrapper is for the older `gym`.

from clutter_env.data.robomimic_env import register

register()
metadata = FileUtils.get_env_metadata_from_dataset("demo.hdf5")  # of `clutter-env export --to robomimic`
env = EnvUtils.create_env_from_metadata(metadata)
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clutter_env.data.episode import physics_state, saved_state
from clutter_env.errors import LearningError
from clutter_env.task import Task
from clutter_env.version import version

GYM_TYPE = 2
"""robomimic's number of Gymnasium environments (`EnvType.GYM_TYPE`)."""
_BYTES = 6
"""Bytes in a number."""
_SPARE = 2
"""Ratio of the length of a row of `get_state` to that of the first state, because later states are a little longer."""
_WRAPPER = "robomimic.envs.env_gym"


def numbers_of(state: bytes, width: int) -> NDArray[np.float64]:
    """Encode a saved state as numbers (width,), six bytes in each. The first number is the number of bytes.

    robomimic keeps states as rows of numbers. Integers below 2⁴⁸ are exact in them.
    """
    padded = state.ljust((width - 1) * _BYTES, b"\0")
    rows = np.zeros((width - 1, 8), np.uint8)
    rows[:, :_BYTES] = np.frombuffer(padded, np.uint8).reshape(-1, _BYTES)
    return np.insert(rows.view("<u8").ravel().astype(np.float64), 0, len(state))


def bytes_of(numbers: NDArray[np.float64]) -> bytes:
    """Decode the saved state of `numbers_of`. Other numbers give bytes that are no state."""
    count = int(min(max(numbers[0], 0.0), _BYTES * len(numbers)))
    whole = np.clip(np.nan_to_num(numbers[1:]), 0.0, 2.0 ** (8 * _BYTES) - 1).astype("<u8")
    return whole.view(np.uint8).reshape(-1, 8)[:, :_BYTES].tobytes()[:count]


def width_for(state: bytes) -> int:
    """Length of `numbers_of` for a state."""
    return 1 + -(-len(state) // _BYTES)


class RobomimicEnv:
    """An environment with the methods of robomimic's `EnvBase`. `rollout` and the scripts for datasets can use it.

    Observations keep their names. An episode is done when its time is up. `rollout` ends it at success.
    """

    rollout_exceptions = ()
    type = GYM_TYPE

    def __init__(
        self,
        env_name: str,
        render: bool = False,
        render_offscreen: bool = False,
        use_image_obs: bool = False,
        postprocess_visual_obs: bool = True,  # noqa: ARG002  robomimic gives it
        **keywords: Any,
    ) -> None:
        """Make the environment of that id.

        Raises:
            UnknownTask: no environment of that id, or not with these keyword arguments.
            LearningError: images are requested. They are part of our observations, as set by `env_kwargs`.
        """
        if use_image_obs and keywords.get("obs_mode") != "rgbd":
            raise LearningError(f'{env_name} was recorded without images; collect with obs_mode="rgbd"')
        self.name, self._keywords = env_name, keywords
        drawn = {"render_mode": "rgb_array"} if render or render_offscreen else {}
        self.env = Task(env_name, {**keywords, **drawn}).make()
        assert self.env.action_space.shape is not None
        self.action_dimension = self.env.action_space.shape[0]

    @property
    def version(self) -> str:
        """Version of this package. robomimic compares it with that of the metadata."""
        return version()

    def reset(self, seed: int | None = None) -> dict[str, NDArray[Any]]:
        """First observation of an episode, either a new one or that of a seed."""
        self._seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
        observation, self._info = self.env.reset(seed=self._seed)
        return self._seen(observation, 0.0, False)

    def step(self, action: NDArray[Any]) -> tuple[dict[str, NDArray[Any]], float, bool, dict[str, Any]]:
        """Observation, reward, whether the episode is over, info."""
        observation, reward, terminated, truncated, self._info = self.env.step(action)
        return self._seen(observation, float(reward), terminated or truncated), self._reward, self._done, self._info

    def _seen(self, observation: Mapping[str, Any], reward: float, done: bool) -> dict[str, NDArray[Any]]:
        self._observation = {name: np.asarray(value) for name, value in observation.items()}
        self._reward, self._done = reward, done
        return dict(self._observation)

    def reset_to(self, state: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """Continue from a row of a demonstration's `states`, or from `get_state`, if it has the full state.

        Raises:
            LearningError: a row of an old file, without the full state. The first row of an episode that began in the
                scene of a seed is accepted.
            StateError: the full state is not one of this environment.
        """
        row = np.asarray(state["states"], dtype=float)
        known = 1 + len(physics_state(self._started()))
        if len(row) > known:
            self._seed = int(row[0])
            observation, self._info = self.env.reset(options={"state": bytes_of(row[known:])})
            return self._seen(observation, 0.0, False)
        observation = self.reset(seed=max(int(row[0]), 0))
        if not np.array_equal(row, self.get_state()["states"][:known]):
            raise LearningError("only the first state of an episode that began from a seed can be returned to")
        return observation

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """Seed, MuJoCo's state and, where it can be saved, the full state. `reset_to` takes it."""
        parts = [np.array([float(self._seed)]), physics_state(self._started())]
        if saved := saved_state(self.env):
            parts.append(numbers_of(saved, self._width(saved)))
        return {"states": np.concatenate(parts)}

    def _started(self) -> Any:
        """The environment, after a reset."""
        if not hasattr(self, "_seed"):
            self.reset(seed=0)
        return self.env

    def _width(self, saved: bytes) -> int:
        """Common length of all states of an environment, because states differ by some bytes."""
        if not hasattr(self, "_most"):
            self._most = _SPARE * width_for(saved)
        return max(self._most, width_for(saved))

    def render(self, *_: Any, **__: Any) -> Any:
        """The picture of the environment's own camera, (height, width, 3) uint8."""
        return self.env.render()

    def get_observation(self) -> dict[str, NDArray[Any]]:
        """The last observation."""
        return dict(self._observation)

    get_goal = get_observation  # the goal is a part of the observation

    def get_reward(self) -> float:
        """Reward of the last step."""
        return self._reward

    def set_goal(self, **_: Any) -> None:
        """Raise `LearningError`, because goals are those of the seed."""
        raise LearningError("the goal of an episode is that of its seed")

    def is_done(self) -> bool:
        """Whether the episode is over."""
        return self._done

    def is_success(self) -> dict[str, bool]:
        """Success of the environment, under "task"."""
        return {"task": bool(self._info["is_success"])}

    def serialize(self) -> dict[str, Any]:
        """Metadata from which `create_env_from_metadata` makes this environment again."""
        return {"env_name": self.name, "type": GYM_TYPE, "env_version": self.version, "env_kwargs": self._keywords}

    @classmethod
    def create_for_data_processing(cls, env_name: str, *_: Any, **keywords: Any) -> RobomimicEnv:
        """Make an environment for robomimic's scripts. Camera sizes and the kind of reward are the dataset's own."""
        for name in ("camera_names", "camera_height", "camera_width", "reward_shaping"):
            keywords.pop(name, None)
        return cls(env_name, **keywords)


def register() -> None:
    """Make robomimic, in this process, use our environments for a dataset's metadata, in place of those of the older
    gym.

    Raises:
        LearningError: robomimic is not installed.
    """
    try:
        base: Any = importlib.import_module("robomimic.envs.env_base")
    except ImportError as error:
        raise LearningError("robomimic is not installed") from error
    base.EnvBase.register(RobomimicEnv)
    module: Any = ModuleType(_WRAPPER)
    module.EnvGym = RobomimicEnv
    sys.modules[_WRAPPER] = module
