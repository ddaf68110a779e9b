"""Registers the environments with `lerobot-eval`. LeRobot imports it, in an environment where LeRobot is installed.

    lerobot-eval --env.discover_packages_path=clutter_env.bridges.lerobot --env.type=clutter_env \
        --env.env_id=clutter_env/Retrieve-o1-v0 --env.observations=images --policy.path=CHECKPOINT
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig

from clutter_env.bridges.hub import ENV_ID, make_one

_GYM_ID = "clutter_env/LeRobot-v0"
# Without Gymnasium's outer wrappers, behind which LeRobot does not find the task in words.
gym.register(_GYM_ID, "clutter_env.bridges.hub:make_one", order_enforce=False, disable_env_checker=True)


@EnvConfig.register_subclass("clutter_env")
@dataclass
class ClutterEnv(EnvConfig):
    """An environment of this package as LeRobot configures it.

    Attributes:
        env_id, observations, suite, language: see `clutter_env.bridges.hub.make_one`.
        keywords: of the environment, as in --env.keywords='{"control_mode": "ee"}'.
    """

    env_id: str = ENV_ID
    observations: str = "environment_state"
    suite: str = ""
    language: bool = False
    keywords: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        with closing(make_one(self.env_id, self.observations, self.suite, self.language, **self.keywords)) as env:
            self.task, self.fps = env.get_wrapper_attr("task"), int(env.metadata["render_fps"])
            assert isinstance(env.observation_space, spaces.Dict)
            parts = {"action": env.action_space, **env.observation_space.spaces}
        images: Any = parts.pop("pixels", {})
        kinds = {"action": FeatureType.ACTION, "agent_pos": FeatureType.STATE, "environment_state": FeatureType.ENV}
        self.features = {name: PolicyFeature(kinds[name], part.shape or ()) for name, part in parts.items()}
        self.features |= {
            f"pixels/{name}": PolicyFeature(FeatureType.VISUAL, image.shape) for name, image in images.items()
        }
        keys = {
            "action": "action",
            "agent_pos": "observation.state",
            "environment_state": "observation.environment_state",
        }
        self.features_map = keys | {f"pixels/{name}": f"observation.images.{name}" for name in images}

    @property
    def gym_id(self) -> str:
        """Under which `gym.make` finds `make_one`."""
        return _GYM_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """The arguments of `make_one`. LeRobot films its first episodes."""
        chosen = {name: getattr(self, name) for name in ("env_id", "observations", "suite", "language")}
        return {**chosen, "render_mode": "rgb_array", **self.keywords}
