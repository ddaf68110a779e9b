"""Files of trained weights: what they were trained for and with, and the ones that come with the package.

A file is an .npz with an array for each parameter, and the entry "about": `WeightsInfo` as JSON text.
"""

from __future__ import annotations

import json
import logging
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import BadZipFile

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import assets
from clutter_env.envs.base import layout_identity
from clutter_env.policies.protocol import PolicyError
from clutter_env.provenance import differences, provenance
from clutter_env.reporting.files import json_text, write_atomically

SHIPPED: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "motions": {"side": "keyframes-side.npz", "all": "keyframes-all.npz", "shelf": "keyframes-shelf.npz"},
        "decisions": {"side": "decisions-side.npz", "all": "decisions-all.npz", "shelf": "decisions-shelf.npz"},
    }
)
"""Files in `assets/policies/`, by what was learned and by problem: level grasps, all grasps, under a shelf."""
_ABOUT = "about"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class WeightsInfo:
    """What weights are for, and how they were made.

    Attributes:
        kind: "motions" or "decisions".
        robot, grasps: names of those that they were trained for.
        layout: likewise; of a layout of the user's own all its fields.
        provenance: version, commit and environment that they were made with, as far as known.
    """

    kind: str
    robot: str
    layout: str | Mapping[str, Any]
    grasps: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_env(cls, kind: str, env: gym.Env[Any, Any], grasps: str) -> WeightsInfo:
        """Weights that are trained in an environment."""
        return cls(kind, *_robot_and_layout(env), grasps, provenance(env))

    def check(self, env: gym.Env[Any, Any]) -> None:
        """Refuse an environment with another robot or layout (`PolicyError`); log what else has changed since."""
        robot, layout = _robot_and_layout(env)
        if (robot, layout) != (self.robot, self.layout):
            raise PolicyError(
                f"these weights ({self.kind}) are for robot {self.robot!r} and layout {self.layout!r}; the environment "
                f"has robot {robot!r} and layout {layout!r}"
            )
        if _LOG.isEnabledFor(logging.INFO):
            for difference in differences(self.provenance, provenance(env)):
                _LOG.info("weights (%s): %s", self.kind, difference)


def _robot_and_layout(env: gym.Env[Any, Any]) -> tuple[str, str | Mapping[str, Any]]:
    return env.get_wrapper_attr("robot").name, layout_identity(env.get_wrapper_attr("layout"))


def shipped_path(kind: str, problem: str) -> Path:
    """The file of weights that come with the package.

    Raises:
        PolicyError: there are none for this problem; the message lists the problems.
    """
    if problem not in SHIPPED[kind]:
        raise PolicyError(f"no {kind} are shipped for {problem!r}; there are {', '.join(SHIPPED[kind])}")
    return assets.path(f"policies/{SHIPPED[kind][problem]}")


def save_weights(path: Path, network: nn.Module, info: WeightsInfo) -> None:
    """Write the weights of a network; missing directories are made.

    Raises:
        OSError: the disk is full or cannot be written.
    """
    content = BytesIO()
    arrays: dict[str, Any] = {name: value.numpy() for name, value in network.state_dict().items()}
    arrays[_ABOUT] = np.array(json_text(asdict(info)))
    np.savez_compressed(content, **arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())


def load_weights(path: Path, kind: str) -> tuple[dict[str, torch.Tensor], WeightsInfo]:
    """The weights of a file by name, and what they are for.

    Raises:
        PolicyError: there is no such file, it holds no weights, or those of another kind.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        info = WeightsInfo(**json.loads(str(arrays.pop(_ABOUT))))
        weights = {name: torch.from_numpy(value) for name, value in arrays.items()}
    except KeyError:
        raise PolicyError(f"{path} does not say what its weights are for: version 0.1 wrote it; train again") from None
    except (OSError, ValueError, TypeError, EOFError, BadZipFile, zlib.error) as problem:
        raise PolicyError(f"{path} holds no weights of this package: {problem}") from problem
    if info.kind != kind:
        raise PolicyError(f"{path} holds {info.kind}, not {kind}")
    return weights, info
