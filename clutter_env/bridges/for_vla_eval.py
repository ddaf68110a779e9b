"""The suites as a benchmark of vla-eval, the harness for vision-language-action models. Import it where vla-eval is
installed.

    benchmarks:
      - benchmark: clutter_env.bridges.for_vla_eval:SuiteBenchmark
        episodes_per_task: 100
        params: {suite: side-15-v3}

An episode is a scene of the suite's test split, in order. Success is that of the environment, clean by default.
`clutter_env.policies.vla_eval_server` serves a policy of this package, to try the harness without a model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import IMAGE_RGB, LANGUAGE, RAW, STATE_JOINT, DimSpec

from clutter_env.bridges.hub import image_entries, joined, number_groups
from clutter_env.suites import Suite, suite as named_suite

_SENTENCE = "instruction"
_INFO = ("target", "unmet", "goal")
"""Of the reset's info, what the policies of this package read."""


class SuiteBenchmark(StepBenchmark):
    """Scenes of a suite.

    A model receives `images` by the names of the cameras, (h, w, 3) uint8. It receives `state`, the robot's own
    numbers, and `task_description`, the sentence of the episode's goal. Its answer: `actions`, a vector of the
    environment's action space or its rows one after the other, as vla-eval asks for them.

    Args:
        suite: name of a suite of the package.
        exact: send the environment's whole observation in place of images, as `observation`, for policies of this
            package. Then positions of objects are exact.
        keywords: more keyword arguments of the environment, such as {"cameras": ["head", "gripper"]}.

    Raises:
        SuiteError: there is no such suite, or the keyword arguments change its scenes.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"gpu", "cpu"})

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:  # noqa: ARG003  the harness's interface
        """MuJoCo finds what there is by itself, or by MUJOCO_GL."""
        return {}

    def __init__(self, suite: str, exact: bool = False, keywords: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self._suite, self._exact = named_suite(suite), exact
        self._env = made(self._suite, exact, keywords)

    def get_tasks(self) -> list[dict[str, Any]]:
        """One task: the suite. Its episodes are the scenes."""
        return [{"name": self._suite.name, "suite": self._suite.name}]

    def get_metadata(self) -> dict[str, Any]:
        """Numbers of steps and of scenes."""
        scenes = self._suite.test
        return {"max_steps": max(scene.max_steps for scene in scenes), "max_episodes_per_task": len(scenes)}

    def reset(self, task: Mapping[str, Any]) -> dict[str, Any]:
        """Start the episode of the scene with the number that the harness counts."""
        observation, info = self._suite.test[task.get("episode_idx", 0)].reset(self._env)
        first = {name: info[name] for name in _INFO if name in info} if self._exact else {}
        return {**observation, **({"info": first} if first else {})}

    def step(self, action: Mapping[str, Any]) -> StepResult:
        """Do one control step of 0.05 s. A target that is lifted ends the episode, cleanly or not."""
        numbers = np.asarray(action["actions"], np.float32)
        observation, reward, terminated, truncated, info = self._env.step(numbers)
        is_over = terminated or truncated or bool(info["target"] and info["lifted"]) or bool(action.get("done"))
        self._recorder.record_step(reward=float(reward), action=numbers, success=bool(info["is_success"]))
        return StepResult(obs=observation, reward=float(reward), done=is_over, info=info)

    def make_obs(self, raw_obs: Mapping[str, Any], task: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ARG002
        """The message to the model."""
        words = {"task_description": raw_obs[_SENTENCE]}
        if self._exact:
            numbers = {name: part for name, part in raw_obs.items() if name not in (_SENTENCE, "info")}
            return {**words, "observation": numbers, "info": raw_obs.get("info", {})}
        images = {camera: raw_obs[name] for camera, name in image_entries(raw_obs).items()}
        return {**words, "images": images, "state": joined(raw_obs, number_groups(raw_obs, "images")["agent_pos"])}

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """Whether the episode was a success."""
        return {"success": bool(step_result.info.get("is_success", False))}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """The action: see docs/retrieve.md for its parts, which depend on the robot and on `control_mode`."""
        inner: Any = self._env.unwrapped
        return {"action": action_spec(self._env.action_space, inner.control_mode)}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Content of the messages of `make_obs`."""
        if self._exact:
            return {"observation": RAW, "language": LANGUAGE}
        cameras = image_entries(dict(self._env.observation_space.items()))  # type: ignore[attr-defined]  # a Dict
        return {**dict.fromkeys(cameras, IMAGE_RGB), "state": STATE_JOINT, "language": LANGUAGE}

    def cleanup(self) -> None:
        """Close the environment."""
        self._env.close()


def made(suite: Suite, exact: bool, keywords: Mapping[str, Any] | None) -> gym.Env[Any, Any]:
    """The environment of a suite, with the sentence of the goal. See `SuiteBenchmark`."""
    mode = {} if exact else {"obs_mode": "rgbd"}
    return suite.test[0].make(**{"instruction": True, **mode, **(keywords or {})})


def action_spec(space: gym.Space[Any], control_mode: str) -> DimSpec:
    """Properties that vla-eval compares between model and benchmark: the size of the action, and the kind of
    control."""
    assert isinstance(space, spaces.Box)
    return DimSpec("action", int(space.shape[0]), f"clutter_env_{control_mode}", (-1.0, 1.0))
