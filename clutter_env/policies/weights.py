"""Files of trained weights: purpose and data of their training, and the weights that come with the package.

A file is an .npz with an array for each parameter, and the entry "about" with JSON text, as `scripts/shipped_weights`
writes it. Nothing is pickled: a file cannot execute code.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch

import assets
from clutter_env.envs.base import layout_identity, robot_identity
from clutter_env.policies.protocol import PolicyError, PublicInfo

PROBLEMS = ("side", "all", "shelf")
"""Problems for which weights of both levels are in the package: level grasps, all grasps, level grasps under a
shelf."""
_FILES = {"motions": "keyframes", "decisions": "decisions"}


@dataclass(frozen=True)
class WeightsInfo:
    """Purpose and origin of weights.

    Attributes:
        kind: "motions" or "decisions".
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
    if problem not in PROBLEMS:
        raise PolicyError(f"no {kind} are shipped for {problem!r}; there are {', '.join(PROBLEMS)}")
    return assets.path(f"policies/{_FILES[kind]}-{problem}.npz")


def load_weights(path: Path, kind: str) -> tuple[dict[str, torch.Tensor], WeightsInfo]:
    """Read the weights of a file by name, and their purpose.

    Raises:
        PolicyError: the file is missing or damaged, or holds no weights, or weights of another kind.
    """
    with damage_refused(path), np.load(path, allow_pickle=False) as content:
        weights = {name: torch.from_numpy(content[name]) for name in content.files if name != "about"}
        info = WeightsInfo(**json.loads(str(content["about"])))
    if info.kind != kind:
        raise PolicyError(f"{path} holds {info.kind}, not {kind}")
    return weights, info


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
