"""Files of trained weights, as `clutter_env.policies.weights` reads them."""

from __future__ import annotations

from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from torch import nn

from clutter_env.envs.base import layout_identity, robot_identity
from clutter_env.policies.weights import WeightsInfo
from clutter_env.provenance import provenance
from clutter_env.reporting.files import json_text, write_atomically


def trained_in(env: gym.Env[Any, Any], kind: str, grasps: str) -> WeightsInfo:
    """What weights are for that are trained in an environment."""
    robot, layout = env.get_wrapper_attr("robot"), env.get_wrapper_attr("layout")
    return WeightsInfo(kind, robot_identity(robot), layout_identity(layout), grasps, provenance(env))


def save_weights(path: Path, network: nn.Module, info: WeightsInfo) -> None:
    """Write the weights of a network; missing directories are made.

    Raises:
        OSError: the disk is full or cannot be written; an old file stays.
    """
    arrays, content = {name: value.numpy() for name, value in network.state_dict().items()}, BytesIO()
    np.savez_compressed(content, allow_pickle=False, **arrays, about=np.array(json_text(asdict(info))))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())
