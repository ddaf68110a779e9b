"""Options of an environment, checked before anything is built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

from assets import InvalidRobot, RobotSpec, UnknownRobot, robot as find_robot
from clutter_env.errors import ConfigError, check_choice, check_integer
from clutter_env.scene.layout import Layout, find_layout
from clutter_env.scene.object_sets import OBJECT_SETS, SHAPE_SETS, ObjectSet, capacity, slot_shapes

CONTROL_HZ = 20
TIMESTEP = 0.002
"""[s] of one physics step."""
PHYSICS_STEPS = round(1 / (CONTROL_HZ * TIMESTEP))
"""Physics steps in one control step."""

RENDER_MODES = ("human", "rgb_array", "depth_array")
CONTROL_MODES = ("joint", "ee")
REWARD_MODES = ("sparse", "dense")
OBSTRUCTED = (False, True, 2, 3)
"""Values of `obstructed`: the least number of objects in the way of every side grasp of the target."""
SUCCESS_KINDS = ("clean", "lifted")
OBS_MODES = ("state", "rgbd", "pointcloud")
HEAD_MODES = ("fixed", "commanded")
BASES = ("holonomic", "differential", "fixed")
EFFECTS = ("poses", "joints", "camera", "frames", "observation_delay", "action_delay", "friction", "mass", "size")
"""Effects by which `reality` makes the world differ from the robot's knowledge, see `envs.reality`."""
SCENE_CAMERAS = ("scene", "top")
"""Views of every scene: the whole scene, and from above. The robot adds its own cameras."""
IMAGE_SIZE_RANGE = (16, 2048)
"""[pixels] Range of the width and height of images."""
MOST_POINTS = 2**20


@dataclass(frozen=True)
class EnvConfig:
    """The keyword arguments of the environments. The constructor checks them.

    A layout or a robot is a name, an object, or the object's fields as a dictionary (`dataclasses.asdict`).
    `env.spec.to_json()` writes dictionaries.

    Raises:
        ConfigError: a value has the wrong type or is outside its range. The message lists the valid values.
    """

    num_objects: int = 15
    """Objects on the table, the target among them."""
    layout: str | Layout | Mapping[str, Any] = "paper"
    """Table and surroundings: a name in `LAYOUTS`, or a `Layout`."""
    control_mode: str = "joint"
    """Meaning of an action's numbers: "joint" or "ee"."""
    reward_mode: str = "sparse"
    success: str = "clean"
    """Kind of success: "lifted", or "clean": lifted, and no object has fallen or been disturbed."""
    terminate_on_fallen: bool = False
    """Whether the episode ends when an object falls."""
    obs_mode: str = "state"
    robot: str | RobotSpec | Mapping[str, Any] = "fetch"
    """A name known to `assets.robots.robot`, or a `RobotSpec`."""
    render_mode: str | None = None
    shapes: str = "cylinder"
    """Shapes of the objects: "cylinder", "box" or "mixed"."""
    object_set: str = "standard"
    """Sizes and masses of random objects: a name in `OBJECT_SETS`."""
    obstructed: bool | int = False
    """Whether no side grasp reaches the target before another object moves. 2 or 3: at least so many objects are in the
    way of every side grasp. By `scene.obstruction`, which needs no planner."""
    camera: str = "scene"
    """The camera that `render()` looks through."""
    width: int = 480
    """Pixels of a rendered image."""
    height: int = 480
    """Pixels of a rendered image."""
    image_size: int = 96
    """Pixels along each side of the images of an "rgbd" observation, or of those from which a "pointcloud" is made."""
    cameras: Sequence[str] = ()
    """The cameras of image observations. All of the robot's own if none is named. "top" is above the table."""
    segmentation: bool = False
    """Whether image observations say of every pixel or point what it shows."""
    num_points: int = 2048
    """Points in a "pointcloud" observation."""
    head: str = "fixed"
    """Whether an action has two numbers more, at its end, for the head: "commanded" or "fixed"."""

    base: str = "holonomic"
    """How the base moves: "differential" cannot move sideways, and an action has no number for that. "fixed" stands
    where the arm can work, and an action has no numbers for the base. A `RobotSpec` that is not holonomic says so
    itself."""
    reality: float | Mapping[str, float] = 0.0
    """From 0, exact and at once, to 1: share of all `EFFECTS`, or of some by name."""

    def __post_init__(self) -> None:
        check_choice("base", self.base, BASES)
        layout, robot = self.find_layout(), self.find_robot()
        object.__setattr__(self, "base", robot.base_drive)
        check_choice("control_mode", self.control_mode, ("joint",) if robot.acts_with_all_arms else CONTROL_MODES)
        check_choice("reward_mode", self.reward_mode, self.reward_modes)
        check_choice("success", self.success, SUCCESS_KINDS)
        check_choice("terminate_on_fallen", self.terminate_on_fallen, (False, True))
        check_choice("obs_mode", self.obs_mode, OBS_MODES)
        check_choice("render_mode", self.render_mode, (None, *RENDER_MODES))
        check_choice("shapes", self.shapes, SHAPE_SETS)
        check_choice("object_set", self.object_set, OBJECT_SETS)
        check_choice("obstructed", self.obstructed, OBSTRUCTED)
        check_choice("camera", self.camera, (*SCENE_CAMERAS, *robot.cameras))
        if self.obs_mode != "state" and not robot.cameras:
            raise ConfigError(f"obs_mode={self.obs_mode!r} needs a robot with cameras; robot {robot.name!r} has none")
        is_list = isinstance(self.cameras, Sequence) and not isinstance(self.cameras, str)
        if not is_list or len(set(map(str, self.cameras))) < len(self.cameras):
            raise ConfigError(f"cameras={self.cameras!r} is not valid; it must be different names, such as ('head',)")
        for camera in self.cameras:
            check_choice("cameras", camera, ("top", *robot.cameras))
        check_choice("segmentation", self.segmentation, (False, True))
        for name in ("cameras", "segmentation"):
            if self.obs_mode == "state" and (value := getattr(self, name)):
                with_images = ", ".join(repr(mode) for mode in OBS_MODES if mode != "state")
                raise ConfigError(f"{name}={value!r} needs obs_mode {with_images}: 'state' has no images")
        self.find_reality()
        if not isinstance(self.reality, Mapping):
            object.__setattr__(self, "reality", float(self.reality))
        check_choice("head", self.head, HEAD_MODES)
        if self.head == "commanded" and not robot.head_joints:
            raise ConfigError(f"head='commanded' needs a robot whose head moves; that of robot {robot.name!r} does not")
        for name in ("width", "height", "image_size"):
            object.__setattr__(self, name, check_integer(name, getattr(self, name), *IMAGE_SIZE_RANGE))
        object.__setattr__(self, "num_points", check_integer("num_points", self.num_points, 1, MOST_POINTS))
        # Convert NumPy integers to Python's. Otherwise results computed from them would be NumPy's too.
        object.__setattr__(self, "num_objects", check_integer("num_objects", self.num_objects, 0))
        fit = capacity(layout, self.shapes, self.find_object_set())
        if self.num_objects > fit:
            shapes = "" if self.find_object_set().kinds else f"shapes={self.shapes!r} and "
            raise ConfigError(
                f"num_objects={self.num_objects} does not fit layout {layout.name!r} with {shapes}"
                f"object_set={self.object_set!r}: at most {fit} fit"
            )
        if self.obstructed and (problem := self.obstruction_problem(int(self.obstructed))):
            raise ConfigError(f"obstructed={self.obstructed!r}: {problem}")

    @property
    def reward_modes(self) -> tuple[str, ...]:
        """Values of `reward_mode` in this configuration."""
        return REWARD_MODES

    def obstruction_problem(self, least: int) -> str:
        """Reason why targets with at least this many objects in the way cannot be drawn here, "" if they can."""
        if self.find_layout().opens:
            return f"layout={self.find_layout().name!r} is shut at the start: no grasp reaches anything"
        if not self.find_object_set().has_side_grasps:
            known = ", ".join(repr(name) for name, entry in OBJECT_SETS.items() if entry.has_side_grasps)
            return f"object_set={self.object_set!r} is too low for side grasps; valid values: {known}"
        if self.num_objects <= least:
            return f"num_objects={self.num_objects} is not valid; it must be at least {least + 1}"
        return ""

    @property
    def observed_cameras(self) -> tuple[str, ...]:
        """Cameras of the observation, () if it has no images."""
        return () if self.obs_mode == "state" else tuple(self.cameras) or self.find_robot().cameras

    def find_reality(self) -> dict[str, float]:
        """The share of each effect, by name.

        Raises:
            ConfigError: an unknown effect, or a share that is no number from 0 to 1.
        """
        given = self.reality
        shares = dict(given) if isinstance(given, Mapping) else dict.fromkeys(EFFECTS, given)
        for name, share in shares.items():
            check_choice("reality", name, EFFECTS)
            if isinstance(share, bool) or not isinstance(share, Real) or not 0 <= share <= 1:
                raise ConfigError(f"reality={given!r} is not valid; it must be from 0 to 1, or such numbers by effect")
        return {name: float(shares.get(name, 0.0)) for name in EFFECTS}

    @property
    def slot_shapes(self) -> tuple[str, ...]:
        """Shape, or kind, of the object in every slot of a random scene."""
        return slot_shapes(self.shapes, int(self.num_objects), self.find_object_set())

    def find_object_set(self) -> ObjectSet:
        """Ranges of sizes and masses that `object_set` names."""
        return OBJECT_SETS[self.object_set]

    def find_layout(self) -> Layout:
        """Find the layout that `layout` names or describes.

        Raises:
            ConfigError: no such layout.
        """
        return find_layout(self.layout)

    def find_robot(self) -> RobotSpec:
        """Find the robot that `robot` names or describes.

        Raises:
            ConfigError: no such robot.
        """
        try:
            robot = find_robot(self.robot)
            return robot if self.base == "holonomic" else getattr(robot, self.base)()
        except (UnknownRobot, InvalidRobot) as problem:
            raise ConfigError(f"robot: {problem}") from None

    @classmethod
    def from_keywords(cls, keywords: dict[str, Any]) -> EnvConfig:
        """The configuration that these keyword arguments describe.

        Raises:
            ConfigError: an unknown name or an invalid value. The message lists the valid ones.
        """
        known = [entry.name for entry in fields(cls)]
        for name in keywords:
            if name not in known:
                raise ConfigError(f"unknown keyword argument {name!r}; known ones: {', '.join(known)}")
        return cls(**keywords)
