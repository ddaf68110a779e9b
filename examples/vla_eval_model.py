"""A model for vla-eval that sees the scenes of a suite, and does not move: the place of one that does.

    venv-vla/bin/python examples/vla_eval_model.py

See docs/guides/vla_eval.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import vla_eval
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.specs import IMAGE_RGB, LANGUAGE, STATE_JOINT, DimSpec

CONFIG = Path(__file__).parent / "vla_eval.yaml"


class StandsStill(PredictModelServer):
    """Says what it receives, and answers with zeros."""

    def predict(self, obs, ctx):
        """The action for an observation."""
        if ctx.is_first:
            shapes = {name: image.shape for name, image in obs["images"].items()}
            print(obs["task_description"], shapes, obs["state"].shape)
        return {"actions": np.zeros(12, np.float32)}

    def get_action_spec(self):
        """Twelve velocities."""
        return {"action": DimSpec("action", 12, "clutter_env_joint", (-1.0, 1.0))}

    def get_observation_spec(self):
        """What it looks at."""
        return {"head": IMAGE_RGB, "gripper": IMAGE_RGB, "state": STATE_JOINT, "language": LANGUAGE}


if __name__ == "__main__":
    shorter = {"episodes_per_task": 1, "max_steps": 20}
    (found,) = vla_eval.evaluate(StandsStill(), CONFIG, benchmark_overrides=shorter)
    print(f"mean success: {found['mean_success']}")
