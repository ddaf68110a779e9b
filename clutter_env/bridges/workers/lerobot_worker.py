"""A checkpoint of LeRobot for another process, by `answer.py`, where LeRobot is installed."""

import base64
import os
from typing import Any

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # a checkpoint is a directory; nothing is downloaded for it

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

torch.set_num_threads(1)  # several policies share a machine


class Worker:
    """A policy with its own processing of observations and actions."""

    policy: Any
    before: Any
    after: Any
    seed: int

    def load(self, path: str, seed: int) -> dict[str, Any]:
        """Load the policy for the CPU."""
        config = PreTrainedConfig.from_pretrained(path)
        config.device = "cpu"
        if hasattr(config, "pretrained_backbone_weights"):
            config.pretrained_backbone_weights = None  # those of the checkpoint follow
        self.policy = get_policy_class(config.type).from_pretrained(path, config=config)
        device = {"device_processor": {"device": config.device}}
        self.before, self.after = make_pre_post_processors(config, path, preprocessor_overrides=device)
        self.seed = seed
        return {}

    def reset(self) -> dict[str, Any]:
        """Start an episode. The random numbers of every episode are the same."""
        torch.manual_seed(self.seed)
        for part in (self.policy, self.before, self.after):
            part.reset()
        return {}

    def act(self, numbers: dict[str, list[float]], images: dict[str, Any], task: str) -> dict[str, Any]:
        """The next action for numbers by LeRobot's keys, images (shape, base64 of the bytes) and a task in words."""
        observation: dict[str, Any] = {name: np.array([values], np.float32) for name, values in numbers.items()}
        if images:
            observation["pixels"] = {
                name: np.frombuffer(base64.b64decode(content), np.uint8).reshape(1, *shape).copy()
                for name, (shape, content) in images.items()
            }
        with torch.inference_mode():
            batch = self.before({**preprocess_observation(observation), "task": [task]})
            action = self.after(self.policy.select_action(batch))
        return {"action": action[0].tolist()}
