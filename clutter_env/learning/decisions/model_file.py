"""A learned decider in one small file: the weights of its network, and the contacts that it chooses from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from assets import robot
from clutter_env.learning.decisions.contact_rule import ContactRule
from clutter_env.learning.decisions.network import ContactNetwork
from clutter_env.learning.errors import LearningError
from clutter_env.reporting.files import written_atomically
from clutter_env.scene.layout import find_layout

__all__ = ["DecisionModel"]

_LAYOUT, _GRASPS, _ROBOT, _WIDTH = "layout", "grasps", "robot", "width"


@dataclass(frozen=True)
class DecisionModel:
    """What a `LearnedDecider` is made of."""

    network: ContactNetwork
    rule: ContactRule

    def save(self, path: Path) -> None:
        """Write a compressed npz file: the weights by name, the names of robot, layout and grasp set."""
        path.parent.mkdir(parents=True, exist_ok=True)
        weights = {name: value.numpy() for name, value in self.network.state_dict().items()}
        names = {_LAYOUT: self.rule.layout.name, _GRASPS: self.rule.grasps, _ROBOT: self.rule.robot.name}
        content: dict[str, Any] = {**weights, **names, _WIDTH: self.network.width}
        with written_atomically(path) as part, part.open("wb") as file:
            np.savez_compressed(file, **content)

    @classmethod
    def load(cls, path: Path) -> DecisionModel:
        """What `save` wrote.

        Raises:
            LearningError: there is no such file, or it is not one of a learned decider.
        """
        try:
            with np.load(path, allow_pickle=False) as content:
                values = {name: content[name] for name in content.files}
            network = ContactNetwork(int(values.pop(_WIDTH)))
            rule = ContactRule(
                robot(str(values.pop(_ROBOT))), find_layout(str(values.pop(_LAYOUT))), str(values.pop(_GRASPS))
            )
            network.load_state_dict({name: torch.from_numpy(value) for name, value in values.items()})
        except (OSError, ValueError, KeyError, RuntimeError) as problem:
            raise LearningError(f"{path} holds no learned decider: {problem}") from problem
        return cls(network, rule)
