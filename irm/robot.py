"""The data of a robot that irm reads. Robots offer it; irm knows none by name or by type."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Joint(Protocol):
    """One joint of the chain torso → arm, as `assets.ChainLink`; at zero its frame has `offset` [m] and `rotation`."""

    @property
    def joint(self) -> str:
        """Name."""

    @property
    def offset(self) -> Sequence[float]:
        """(3,) origin of the joint's frame in its parent's [m]."""

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3) orientation of the joint's frame in its parent's."""

    @property
    def direction(self) -> Sequence[float]:
        """(3,) unit vector of the axis in the joint's frame."""

    @property
    def lower(self) -> float:
        """Lower limit [m] or [rad]."""

    @property
    def upper(self) -> float:
        """Upper limit [m] or [rad]."""

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides along its axis."""


class Robot(Hashable, Protocol):
    """A mobile manipulator; attributes as of `assets.RobotSpec`, which says what they mean."""

    @property
    def name(self) -> str:
        """Name of the robot."""

    @property
    def full_name(self) -> str:
        """Name of robot and active arm."""

    @property
    def chain(self) -> Sequence[Joint]:
        """Joints of torso and arm."""

    @property
    def tcp_offset(self) -> Sequence[float]:
        """(3,) origin of the TCP in the last link's frame [m]."""

    @property
    def tcp_rotation(self) -> NDArray[np.float64]:
        """(3, 3) its orientation."""

    @property
    def home(self) -> Sequence[float]:
        """(1 + n,) home configuration."""

    @property
    def plans_torso(self) -> bool:
        """Whether the torso is free."""

    @property
    def closed_form_ik(self) -> str:
        """Name of its closed form, or an empty string."""

    @property
    def map_folder(self) -> Path | None:
        """Folder of maps that come with the robot, or None."""

    @property
    def mjcf_path(self) -> Path:
        """Its MJCF file."""

    @property
    def base_body(self) -> str:
        """Name of the base's body."""

    @property
    def torso_joint(self) -> str:
        """Name of the lift's joint."""

    @property
    def arm_joints(self) -> tuple[str, ...]:
        """Names of the arm's joints."""

    @property
    def tcp_site(self) -> str:
        """Name of the TCP's site."""

    @property
    def finger_joints(self) -> tuple[str, ...]:
        """Names of the fingers' joints."""

    @property
    def max_finger_position(self) -> float:
        """Position of an open finger [m]."""
