"""A checkpoint of LeRobot for another process: one JSON object a line comes in, one goes out.

It runs where LeRobot is installed and imports nothing of this project. What LeRobot prints goes to standard error.
"""

import base64
import json
import os
import sys
import traceback
from typing import Any

os.environ.setdefault("HF_HUB_OFFLINE", "1")  # a checkpoint is a directory; nothing is downloaded for it
ANSWERS = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)

import numpy as np  # noqa: E402  the lines above come first
import torch  # noqa: E402
from lerobot.configs.policies import PreTrainedConfig  # noqa: E402
from lerobot.envs.utils import preprocess_observation  # noqa: E402
from lerobot.policies.factory import get_policy_class, make_pre_post_processors  # noqa: E402

torch.set_num_threads(1)  # several policies share a machine


class Checkpoint:
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
        """Start an episode; the random numbers of every episode are the same."""
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


def main() -> None:
    """Answer until the input ends."""
    checkpoint = Checkpoint()
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(checkpoint, request.pop("call"))(**request)
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=ANSWERS, flush=True)


if __name__ == "__main__":
    main()
