"""`Search`: find and lift a target that no camera sees at the start."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from scipy import ndimage

from clutter_env.config import EnvConfig
from clutter_env.envs.observation import POSITION_BOUND
from clutter_env.envs.reset_options import MAX_DRAWS, ResetOptions, draw_scene
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError, OptionError, StateError, check_choice, check_integer, check_number
from clutter_env.rendering.cameras import FIRST_OBJECT, FURNITURE, MAX_DEPTH
from clutter_env.scene.random_scene import screened
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import World

_MOST_PIXELS = 1e5
"""Bound of a camera matrix's numbers."""
_FEWEST_RAYS = 576
"""Rays along each side of an image, at least: three by three for each pixel of the default size. OpenGL moves edges by
parts of a pixel, and whether a target is hidden should hardly depend on the size of the images."""
_WIDEST = math.cos(math.radians(60.0))
"""Cosine of the angle from a camera's axis to the rim of the widest image. The camera turns towards objects outside
it."""
_PARALLEL = 1e-12
"""Component of a direction, of the order of one, below which a ray is regarded as parallel to a face."""
_SEEN_GROUPS = np.array((1, 0, 0, 0, 0, 0), np.uint8)
"""Geoms that hide a target from a camera: furniture and objects, not the robot, whose arm may move away."""


@dataclass(frozen=True)
class SearchConfig(EnvConfig):
    """The keyword arguments of `SearchEnv`: those of `EnvConfig`, and those that make perception hard.

    Raises:
        ConfigError: see `EnvConfig`. Or a value is outside its range.
    """

    num_objects: int = 10
    layout: Any = "shelf"
    shapes: str = "mixed"
    obs_mode: str = "rgbd"
    cameras: Any = ("head",)
    segmentation: bool = True
    image_size: int = 192
    head: str = ""
    """As in `EnvConfig`. "commanded" if not given and the robot's head moves."""
    visible_fraction: float = 0.0
    """Largest share of the target's silhouette that the observed cameras may see from where they are at the start, the
    robot's own body left out."""
    mask_errors: float = 0.0
    """Probability that an object's mask is missed. The same holds for a mask that is merged with a neighbour's, and for
    a jagged edge. They are drawn again for every image."""
    depth_noise: float = 0.0
    """[m] standard deviation of the noise of each pixel's depth."""
    frame_every: int = 1
    """Control steps from one image to the next. In between the last one is shown again."""

    def __post_init__(self) -> None:
        if self.head == "":
            moves = bool(self.find_robot().head_joints)
            object.__setattr__(self, "head", "commanded" if moves else "fixed")
        check_choice("obs_mode", self.obs_mode, ("rgbd",))
        check_choice("segmentation", self.segmentation, (True,))
        super().__post_init__()
        check_choice("obstructed", self.obstructed, (False,))
        check_choice("reality", self.reality, (0.0,))
        # One that stands is put where its arm reaches the target, from where its camera may see it.
        check_choice("base", self.base, ("holonomic", "differential"))
        if self.find_object_set().kinds or self.find_object_set().are_cylinders_lying:
            raise ConfigError(f"object_set={self.object_set!r}: only upright cylinders and boxes can be searched for")
        check_number("visible_fraction", self.visible_fraction, (0.0, 1.0), "")
        check_number("mask_errors", self.mask_errors, (0.0, 0.3), "")
        check_number("depth_noise", self.depth_noise, (0.0, 0.1), "m")
        check_integer("frame_every", self.frame_every, 1, 10)
        check_integer("num_objects", self.num_objects, 2)


class SearchEnv(RetrieveEnv):
    """`RetrieveEnv` without the objects' poses: images and masks, the robot's own state, and a description of the
    target.

    Keyword arguments are the fields of `SearchConfig`. Reset options: `target`, which must be hidden, `objects`,
    `state`. The observation has `robot`, `tcp`, `gripper` and `head`. Each camera has `rgb`, `depth`, `segmentation`,
    its matrix `K` (3, 3) and its pose at the time of the image, `T_base_camera` (4, 4). `target` (7,) has colour
    (red, green, blue), whether it is a box, half extents [m]. Drawers and doors add `joints`, see `Observer`. The
    masks are numbered from 3 on, separately in every image, so a number does not identify an object. Success is that of
    `RetrieveEnv`. The info contains the true state.

    Example:
        >>> import gymnasium as gym, clutter_env
        >>> env = gym.make("clutter_env/Search-o5-v0", image_size=64, visible_fraction=1.0)
        >>> observation, info = env.reset(seed=0)
        >>> sorted(observation)[:5]
        ['gripper', 'head', 'head_K', 'head_T_base_camera', 'head_depth']
    """

    config: SearchConfig
    config_type: ClassVar[type[EnvConfig]] = SearchConfig

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        self._shown: dict[str, NDArray[Any]] = {}

    @cached_property
    def workplace(self) -> mujoco.MjModel:
        """The robot and the furniture, without any object: the knowledge before the first image."""
        return self._make_world(shapes=()).model

    def visible_shares(self, scene: TableScene, head: Sequence[float] | None = None) -> NDArray[np.float64]:
        """Share of each object's silhouette that an observed camera sees, (n,): the largest share over the cameras.

        The robot stands at the scene's base pose, in its home configuration. Its own body hides nothing, and a camera
        sees all around it. Turning the head moves its camera: `head` is the head's direction, if not straight ahead.
        """
        return self._visible_shares(scene, range(scene.num_objects), head)

    def _visible_shares(
        self, scene: TableScene, slots: Iterable[int], head: Sequence[float] | None = None
    ) -> NDArray[np.float64]:
        """`visible_shares` of the objects in some slots alone."""
        world = self._world_for(scene)
        world.reset(scene)
        if head is not None:
            world.data.qpos[[world.model.joint(name).qposadr[0] for name in self.robot.head_joints]] = head
            mujoco.mj_kinematics(world.model, world.data)
            mujoco.mj_camlight(world.model, world.data)
        cameras, size = self.config.observed_cameras, int(self.config.image_size)
        return np.array([max(visible_share(world, slot, camera, size) for camera in cameras) for slot in slots])

    def save_state(self) -> bytes:
        """As in `BaseEnv`. The present image is not part of it."""
        if self.config.frame_every > 1:
            raise StateError("states are saved with frame_every=1: the image shown is no part of them")
        return super().save_state()

    def restore_state(self, state: bytes) -> None:
        """As in `BaseEnv`. The next observation shows a new image."""
        super().restore_state(state)
        self._shown = {}

    def _check_options(self, options: object) -> ResetOptions:
        checked = super()._check_options(options)
        if checked.obstructed:
            raise OptionError("option 'obstructed' is of Retrieve; targets of Search are hidden, see visible_fraction")
        if any(entry.get("lying") is True for entry in checked.objects or ()):
            raise OptionError("option 'objects': only upright cylinders and boxes can be searched for")
        return checked

    def _draw_scene(self, options: ResetOptions) -> TableScene:
        most = float(self.config.visible_fraction)
        is_random = options.objects is None and options.target is None
        for _ in range(MAX_DRAWS if is_random else 1):
            drawn: TableScene | None = draw_scene(self.np_random, self.layout, self.config, options)
            if is_random and most < 1 and self.layout.opens is None:
                assert drawn is not None
                drawn = screened(self.np_random, self.layout, drawn)
            if drawn is not None and (most >= 1 or self._visible_shares(drawn, (drawn.target,))[0] <= most):
                return drawn
        raise OptionError(
            f"no target of which at most {most:.0%} is seen; ask for more objects or for another layout"
            if is_random
            else f"the cameras see more than {most:.0%} of the target; hide it, or allow more by visible_fraction"
        )

    def _make_observation_space(self) -> spaces.Dict:
        added: dict[str, spaces.Space[Any]] = {"target": spaces.Box(0.0, 1.0, (7,), np.float32)}
        for name in self.config.observed_cameras:
            added[f"{name}_K"] = spaces.Box(0.0, _MOST_PIXELS, (3, 3), np.float64)
            added[f"{name}_T_base_camera"] = spaces.Box(-POSITION_BOUND, POSITION_BOUND, (4, 4), np.float64)
        return spaces.Dict({**super()._make_observation_space().spaces, **added})

    def observe_world(self, target: int, hold_progress: float, lift_left: float) -> dict[str, Any]:
        """The observation. Between two frames it repeats the last image. See `Observer.observe`."""
        vectors = self._observer.observe(self.world, self.measurements, target, hold_progress, lift_left)
        if len(self._actions) % self.config.frame_every == 0 or not self._shown:
            images = self._rendering.images(self.world)
            self._shown = {name: self._seen(name, image) for name, image in images.items()}
            for kind, of_camera in self._rendering.calibration(self.world).items():
                self._shown |= {f"{name}_{kind}": value for name, value in of_camera.items()}
        shown = {name: value.copy() for name, value in self._shown.items()}
        return {**vectors, **shown, "target": self._description()}

    def _seen(self, name: str, image: NDArray[Any]) -> NDArray[Any]:
        """An image with the errors of depth and masks. Masks are numbered in order of appearance.

        The errors are a function of the image and the time, not of the state, so they depend on no hidden object.
        """
        rng = np.random.default_rng(zlib.crc32(name.encode() + np.float64(self.data.time).tobytes() + image.tobytes()))
        if name.endswith("_depth") and self.config.depth_noise:
            noisy = image + self.config.depth_noise * rng.standard_normal(image.shape)
            return np.clip(noisy, 0.0, MAX_DEPTH).astype(np.float32)
        if not name.endswith("_segmentation"):
            return image
        labels = image[..., 0].copy()
        if self.config.mask_errors:
            spoil(labels, self.config.mask_errors, rng)
        values, first = np.unique(labels, return_index=True)
        order = np.argsort(first[values >= FIRST_OBJECT], kind="stable")
        numbers = np.arange(256, dtype=np.uint8)
        numbers[values[values >= FIRST_OBJECT][order]] = FIRST_OBJECT + np.arange(len(order))
        return numbers[labels][..., None]

    def _description(self) -> NDArray[np.float32]:
        """Colour, whether it is a box, and half extents of the target."""
        scene, slot = self.world.scene, self.target_slot
        return np.array((*self.world.colour(slot)[:3], scene.is_box[slot], *scene.half_extents[slot]), np.float32)


def spoil(labels: NDArray[np.uint8], probability: float, rng: np.random.Generator) -> None:
    """Write errors into the masks (height, width): some missed, some merged with a neighbour's, some jagged."""
    for label in np.unique(labels[labels >= FIRST_OBJECT]).tolist():
        mask = labels == label
        is_missed, is_merged, is_jagged = rng.random(3) < probability
        ring = ndimage.binary_dilation(mask, iterations=2) & ~mask
        beside = labels[ring & (labels >= FIRST_OBJECT)]
        if is_jagged:
            edge = mask & ~ndimage.binary_erosion(mask)
            labels[edge & (rng.random(mask.shape) < 1 / 2)] = FURNITURE
            labels[ring & (rng.random(mask.shape) < 1 / 4)] = label
        if is_missed:
            labels[mask] = FURNITURE
        elif is_merged and len(beside):
            labels[mask] = beside[0]


def visible_share(world: World, slot: int, camera: str, size: int) -> float:
    """Share of an object's silhouette that a camera sees past furniture and other objects, in the present state.

    Rays go through the middles of all pixels of an image, with `size` on each side, and between them. Those that meet
    the object are cast. The image is as large as the object requires. If the object is far from the camera's axis, the
    image is turned towards it.
    """
    model, data, index = world.model, world.data, world.index
    geom, number = index.object_geoms.start + int(index.geom_slots.searchsorted(slot)), model.camera(camera).id
    eye, R_world_camera = data.cam_xpos[number], data.cam_xmat[number].reshape(3, 3)
    centre, R_world_object, half = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    is_box = model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_BOX)
    extents = half if is_box else half[[0, 0, 1]]
    corners = centre - eye + _CORNERS * extents @ R_world_object.T
    if (corners @ -R_world_camera[:, 2] < _WIDEST * np.linalg.norm(corners, axis=1)).any():
        R_world_camera = _looking_at(centre - eye)
    right, up, back = (corners @ R_world_camera).T
    if (back >= 0).any():
        return 1.0  # the camera touches it
    # Odd, so that the middles of the pixels are among the rays.
    finer = math.ceil(_FEWEST_RAYS / size) // 2 * 2 + 1
    focal_length = finer * size / 2 / math.tan(math.radians(model.cam_fovy[number]) / 2)
    offset = (finer * size - 1) / 2 % 1.0
    sides = [
        np.arange(math.ceil(side.min() - offset), math.floor(side.max() - offset) + 1) + offset
        for side in (right * focal_length / -back, up * focal_length / -back)
    ]
    u, v = (grid.ravel() for grid in np.meshgrid(*sides))
    directions = np.column_stack((u, v, np.full(len(u), -focal_length))) @ R_world_camera.T / focal_length
    is_met = meets((eye - centre) @ R_world_object, directions @ R_world_object, extents, is_box)
    if not (count := np.count_nonzero(is_met)):
        return 0.0
    found, distance = np.empty(count, np.int32), np.empty(count)
    flat = np.ascontiguousarray(directions[is_met].ravel())
    with _as_drawn(model, geom):
        mujoco.mj_multiRay(
            model, data, eye, flat, _SEEN_GROUPS, True, -1, found, distance, None, count, mujoco.mjMAXVAL
        )
    return float((found == geom).mean())


@contextmanager
def _as_drawn(model: mujoco.MjModel, kept: int) -> Iterator[None]:
    """Cylinders, except the geom that is kept, no wider than they are drawn: as prisms with `numslices` sides."""
    sizes = model.geom_size.copy()
    is_round = model.geom_type == int(mujoco.mjtGeom.mjGEOM_CYLINDER)
    is_round[kept] = False
    model.geom_size[is_round, 0] *= math.cos(math.pi / model.vis.quality.numslices)
    try:
        yield
    finally:
        model.geom_size[:] = sizes


_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
"""Of a box, in half extents."""


def _looking_at(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation of a camera that looks along a direction (3,): its axes to the right, up and back as columns."""
    back = -direction / np.linalg.norm(direction)
    right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    return np.column_stack((right, np.cross(back, right), back))


def meets(
    start: NDArray[np.float64], directions: NDArray[np.float64], extents: NDArray[np.float64], is_box: bool
) -> NDArray[np.bool_]:
    """Whether rays from a point (3,) along directions (n, 3) meet a box, or an upright cylinder, around the origin.

    Everything in the object's frame, with its half extents (3,) [m].
    """
    steady = np.where(np.abs(directions) < _PARALLEL, _PARALLEL, directions)
    near, far = np.sort(((-extents - start) / steady, (extents - start) / steady), axis=0)
    if not is_box:  # a disc in place of the rectangle: where |start + t direction| = radius
        a, b = (steady[:, :2] ** 2).sum(axis=1), steady[:, :2] @ start[:2]
        root = b**2 - a * (start[:2] @ start[:2] - extents[0] ** 2)
        half = np.sqrt(np.maximum(root, 0.0)) / a
        near[:, 0], far[:, 0] = np.where(root < 0, np.inf, -b / a - half), np.where(root < 0, -np.inf, -b / a + half)
        near, far = near[:, ::2], far[:, ::2]
    first, last = near.max(axis=1), far.min(axis=1)
    return np.asarray((first <= last) & (last > 0))
