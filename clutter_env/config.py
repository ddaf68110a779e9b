"""What can be chosen when an environment is made, checked before anything is built."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from numbers import Integral
from typing import Any

from assets.robots import robot as find_robot
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import LAYOUTS, SHAPE_SETS, capacity

__all__ = ["CONTROL_HZ", "PHYSICS_STEPS", "RENDER_MODES", "TIMESTEP", "EnvConfig"]

CONTROL_HZ = 20
TIMESTEP = 0.002
"""[s] of one physics step."""
PHYSICS_STEPS = round(1 / (CONTROL_HZ * TIMESTEP))
"""Physics steps in one control step."""

RENDER_MODES = ("human", "rgb_array", "depth_array")
CONTROL_MODES = ("joint", "ee")
REWARD_MODES = ("sparse", "dense")
OBS_MODES = ("state", "rgbd")
CAMERAS = ("scene", "top", "head", "gripper")
IMAGE_SIZE_RANGE = (16, 2048)
"""Pixels."""


@dataclass(frozen=True)
class EnvConfig:
    """The keyword arguments of the environments; building one checks them.

    Raises:
        ConfigError: a value of the wrong type or outside its range; the message lists the valid ones.
    """

    num_objects: int = 15
    """Objects on the table, the target among them."""
    layout: str = "paper"
    """Table and surroundings, one of `layout.LAYOUTS`."""
    control_mode: str = "joint"
    """What the action's numbers mean: "joint" or "ee"."""
    reward_mode: str = "sparse"
    obs_mode: str = "state"
    robot: str = "fetch"
    render_mode: str | None = None
    shapes: str = "cylinder"
    """What the objects are: "cylinder", "box" or "mixed"."""
    camera: str = "scene"
    """The camera that `render()` looks through."""
    width: int = 480
    """Pixels of a rendered picture."""
    height: int = 480
    """Pixels of a rendered picture."""
    image_size: int = 96
    """Pixels along each side of an "rgbd" observation's images."""

    def __post_init__(self) -> None:
        find_robot(self.robot)
        check_choice("layout", self.layout, LAYOUTS)
        check_choice("control_mode", self.control_mode, CONTROL_MODES)
        check_choice("reward_mode", self.reward_mode, REWARD_MODES)
        check_choice("obs_mode", self.obs_mode, OBS_MODES)
        check_choice("render_mode", self.render_mode, (None, *RENDER_MODES))
        check_choice("shapes", self.shapes, SHAPE_SETS)
        check_choice("camera", self.camera, CAMERAS)
        for name in ("width", "height", "image_size"):
            check_integer(name, getattr(self, name), *IMAGE_SIZE_RANGE)
        check_integer("num_objects", self.num_objects, 0)
        fit = capacity(LAYOUTS[self.layout], self.shapes)
        if self.num_objects > fit:
            raise ConfigError(
                f"num_objects={self.num_objects} does not fit layout {self.layout!r} with shapes={self.shapes!r}: "
                f"at most {fit} fit"
            )

    @classmethod
    def from_keywords(cls, keywords: dict[str, Any]) -> EnvConfig:
        """The configuration that these keyword arguments describe.

        Raises:
            ConfigError: an unknown name or an invalid value; the message lists the valid ones.
        """
        known = [entry.name for entry in fields(cls)]
        for name in keywords:
            if name not in known:
                raise ConfigError(f"unknown keyword argument {name!r}; known ones: {', '.join(known)}")
        return cls(**keywords)


def check_choice(name: str, value: object, valid: Iterable[object]) -> None:
    """Raise ConfigError unless `value` is one of `valid` (compared by type and value)."""
    choices = list(valid)
    if not any(type(value) is type(choice) and value == choice for choice in choices):
        raise ConfigError(f"{name}={value!r} is not valid; valid values: {', '.join(repr(c) for c in choices)}")


def check_integer(name: str, value: object, lowest: int, highest: int | None = None) -> None:
    """Raise ConfigError unless `value` is an integer between `lowest` and `highest`, both included."""
    wanted = f"an integer of at least {lowest}" if highest is None else f"an integer from {lowest} to {highest}"
    is_integer = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_integer or int(value) < lowest or (highest is not None and int(value) > highest):  # type: ignore[call-overload]
        raise ConfigError(f"{name}={value!r} is not valid; it must be {wanted}")
