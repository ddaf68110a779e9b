"""MetaWorld's environments for another process, by `answer.py`, where `metaworld` is installed."""

import os
import warnings
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")  # nothing is drawn, but it is imported

import gymnasium as gym
import metaworld  # noqa: F401  registers its environments
import numpy as np


class Worker:
    """One environment: a task as MetaWorld draws it from a seed, to be solved once."""

    def __init__(self) -> None:
        self.env: Any = None

    def reset(self, id: str, seed: int) -> dict[str, Any]:
        """A new episode: its MJCF file, where the bodies stand on the world, joints and the state."""
        if self.env is not None:
            self.env.close()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.env = gym.make("Meta-World/MT1", env_name=id, seed=seed, terminate_on_success=True)
            self.observation, _ = self.env.reset(seed=seed)
        self.done = self.is_success = False
        self.inner = self.env.unwrapped
        model = self.inner.model
        standing = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
        joints = [model.joint(number) for number in range(model.njnt)]
        return {
            "file": self.inner.model_name,
            "bodies": {model.body(body).name: model.body_pos[body].tolist() for body in standing},
            "joints": {joint.name: int(joint.qposadr[0]) for joint in joints},
            "lowest": self.inner.mocap_low.tolist(),
            "highest": self.inner.mocap_high.tolist(),
            "speed": float(self.inner.action_scale),
            "horizon": int(self.inner.max_path_length),
            **self.state(),
        }

    def step(self, action: list[float]) -> dict[str, Any]:
        """One step of the environment: x, y, z of the hand, and the fingers."""
        self.observation, _, terminated, truncated, info = self.env.step(np.array(action, dtype=np.float32))
        self.is_success = self.is_success or bool(info["success"])
        self.done = bool(terminated or truncated)
        return self.state()

    def state(self) -> dict[str, Any]:
        """Joint positions, the hand, where it was commanded, its fingers [m], and what the environment says.

        MetaWorld's evaluation ends an episode at its first success. So a task that succeeded once stays solved.
        """
        data = self.inner.data
        fingers = [float(data.geom(name).xpos[1]) for name in ("rightpad_geom", "leftpad_geom")]
        return {
            "qpos": data.qpos.tolist(),
            "hand": self.observation[:3].tolist(),
            "commanded": data.mocap_pos[0].tolist(),
            "fingers": fingers,
            "is_success": self.is_success,
            "done": self.done,
        }
