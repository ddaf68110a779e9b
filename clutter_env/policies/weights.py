"""Files of trained weights: purpose and data of their training, and the weights that come with the package.

A file is an .npz with an array for each parameter, and the entry "about" with JSON text, as `save_weights`
writes it. Nothing is pickled: a file cannot execute code.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import assets
from clutter_env.envs.base import layout_identity, robot_identity
from clutter_env.policies.protocol import PolicyError, PublicInfo
from clutter_env.provenance import provenance
from clutter_env.reporting.files import json_text, write_atomically

PROBLEMS = ("side", "all", "shelf")
"""Problems for which weights of both levels are in the package: level grasps, all grasps, level grasps under a
shelf."""
_FILES = {"motions": "keyframes", "decisions": "decisions", "end-to-end": "end-to-end"}
_ALONE = {"end-to-end": ("side",)}
"""Problems of kinds for which not all have weights."""


@dataclass(frozen=True)
class WeightsInfo:
    """Purpose and origin of weights.

    Attributes:
        kind: "motions", "decisions" or "end-to-end".
        robot, layout: names of the robot and layout of the training. Your own are stored with all fields.
        grasps: name of the grasp set.
        provenance: version, commit and environment of the training, as far as known.
    """

    kind: str
    robot: str | Mapping[str, Any]
    layout: str | Mapping[str, Any]
    grasps: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def check(self, public: PublicInfo) -> None:
        """Refuse a scene with another robot or layout (`PolicyError`)."""
        other = WeightsInfo(self.kind, robot_identity(public.robot), layout_identity(public.layout), self.grasps)
        if (self.robot, self.layout) != (other.robot, other.layout):
            raise PolicyError(f"these are {self}; the environment needs {other}")
        rows = getattr(public.observation_space, "spaces", {}).get("objects")
        if rows is not None and rows.high[-1] > 1:  # the column of kinds
            raise PolicyError(f"these are {self}, for cylinders; the environment has household objects")

    def __str__(self) -> str:
        names = (one if isinstance(one, str) else f"{one['name']} (of your own)" for one in (self.robot, self.layout))
        return "{} for robot {!r} and layout {!r}, grasps {!r}".format(self.kind, *names, self.grasps)


def shipped_path(kind: str, problem: str) -> Path:
    """File of weights that come with the package.

    Raises:
        PolicyError: no weights exist for this problem. The message lists the problems.
    """
    known = _ALONE.get(kind, PROBLEMS)
    if problem not in known:
        raise PolicyError(f"no {kind} are shipped for {problem!r}; there are {', '.join(known)}")
    return assets.path(f"policies/{_FILES[kind]}-{problem}.npz")


def load_weights(path: Path, kind: str) -> tuple[dict[str, torch.Tensor], WeightsInfo]:
    """Read the weights of a file by name, and their purpose.

    Raises:
        PolicyError: the file is missing or damaged, or holds no weights, or weights of another kind.
    """
    with damage_refused(path), np.load(path, allow_pickle=False) as content:
        weights = {name: torch.from_numpy(content[name]) for name in content.files if name != "about"}
        info = WeightsInfo(**json.loads(str(content["about"])))
        if odd := [name for name, values in weights.items() if torch.isnan(values).any()]:
            raise ValueError(f"not a number: {', '.join(odd)}")
    if info.kind != kind:
        raise PolicyError(f"{path} holds {info.kind}, not {kind}")
    return weights, info


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


@contextmanager
def damage_refused(path: Path) -> Iterator[None]:
    """Turn errors of a missing file, or of wrong content, into a `PolicyError` that names the file."""
    if not path.exists():
        raise PolicyError(f"there is no {path.name} in {path.parent}")
    try:
        yield
    except _DAMAGED as problem:
        raise PolicyError(
            f"{path} is damaged, or another version of this package wrote it; train again ({problem})"
        ) from problem


_DAMAGED = (
    *(OSError, ValueError, TypeError, LookupError, RuntimeError, EOFError, MemoryError),
    *(BadZipFile, zlib.error, UnpicklingError),
)
"""Errors of reading a damaged file, such as an unknown compression method or an enormous shape."""
