"""`reset(options=...)`: checked before anything in the environment changes, and the scene that the options ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clutter_env.config import OBSTRUCTED, EnvConfig
from clutter_env.envs.side_approaches import approaches_of
from clutter_env.errors import OptionError, check_choice, check_integer, check_number
from clutter_env.scene.layout import Layout
from clutter_env.scene.obstruction import UNREACHABLE, side_grasps
from clutter_env.scene.random_scene import sample_base, sample_joints, sample_scene
from clutter_env.scene.table_scene import TableScene, object_name

MAX_DRAWS = 1000
"""Random scenes that are drawn until one has an obstructed target."""


def draw_scene(rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions) -> TableScene:
    """The scene that the options describe, random where they leave it open.

    Raises:
        OptionError: see `explicit_scene`. Or no object has the target's name. Or `obstructed` is requested, and too few
            objects obstruct the named target, or no object that is sufficiently obstructed can be freed.
    """
    least = int(config.obstructed if options.obstructed is None else options.obstructed)
    if least:
        return _draw_obstructed(rng, layout, config, options, least)
    scene = _draw_any(rng, layout, config, options)
    wanted = options.target_index(scene.num_objects)
    return scene if wanted is None else scene.with_target(wanted)


def _draw_any(rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions) -> TableScene:
    if options.objects is None:
        return sample_scene(rng, layout, config.num_objects, config.shapes, config.find_object_set())
    return explicit_scene(rng, layout, options.objects, config.num_objects)


def _draw_obstructed(
    rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions, least: int
) -> TableScene:
    """A scene whose target has at least `least` objects in the way. Random scenes are drawn until one has such a
    target.

    A target drawn at random can be freed with side grasps, according to `SideGrasps.can_be_freed`. A target that the
    user names need not.
    """
    if problem := config.obstruction_problem(least):
        raise OptionError(f"option 'obstructed': {problem}")
    robot, approaches = config.find_robot(), approaches_of(config.find_robot(), layout)
    is_random = options.objects is None and options.target is None
    for _ in range(MAX_DRAWS if is_random else 1):
        scene = _draw_any(rng, layout, config, options)
        grasps = side_grasps(approaches, layout, scene, robot.max_opening)
        blockers = grasps.fewest_blockers()
        wanted = options.target_index(scene.num_objects)
        if wanted is not None and blockers[wanted] >= least:
            return scene.with_target(wanted)
        if wanted is not None:
            reason = f"a side grasp has {blockers[wanted]} objects in its way, not {least} or more"
            if blockers[wanted] == UNREACHABLE:
                reason = "no side grasp reaches it, whatever is moved"
            raise OptionError(f"option 'target': {options.target} is not obstructed: {reason}")
        obstructed = np.flatnonzero(blockers >= least).tolist()
        while obstructed:
            target = obstructed.pop(int(rng.integers(len(obstructed))))
            if grasps.can_be_freed(target):
                return scene.with_target(target)
    what = f"none of {MAX_DRAWS} random scenes has" if is_random else "the scene does not have"
    raise OptionError(
        f"option 'obstructed': {what} a target with {least} or more objects in the way that side grasps can free; "
        "ask for more objects, or name the target"
    )


_COMMON_KEYS = ("shape", "position", "height", "yaw", "mass", "row")
_SHAPE_KEYS: Mapping[str, tuple[str, ...]] = {"cylinder": ("radius",), "box": ("depth", "width")}
_OPTIONAL_KEYS: Mapping[str, tuple[str, ...]] = {"cylinder": ("lying",), "box": ()}
RADIUS_LIMITS, WIDTH_LIMITS = (0.01, 0.10), (0.02, 0.20)
"""[m] radius of a cylinder, depth and width of a box."""
HEIGHT_LIMITS = (0.04, 0.39)
"""[m]"""
HEADROOM_MARGIN = 0.01
"""[m] Least distance between an object's top and the lowest obstacle above it."""
POSITION_LIMITS = (-2.0, 2.0)
"""[m] along x and y."""
YAW_LIMITS = (-2 * math.pi, 2 * math.pi)
"""[rad]"""
MASS_LIMITS = (0.01, 5.0)
"""[kg]"""
DEFAULT_MASS = 0.2
TOUCH_TOLERANCE = 1e-6
"""[m] Objects may touch. Deeper overlaps are refused."""


@dataclass(frozen=True)
class ResetOptions:
    """The options of a reset, with their types checked. `objects` are still the user's descriptions."""

    target: str | None = None
    objects: tuple[Mapping[str, Any], ...] | None = None
    state: bytes | None = None
    obstructed: bool | int | None = None
    base: tuple[float, float, float] | None = None

    @classmethod
    def of(cls, options: object) -> Self:
        """Check the dictionary given to `reset`.

        Raises:
            OptionError: an unknown name, a wrong type, or a saved state together with another option.
        """
        if options is None:
            return cls()
        known = [entry.name for entry in fields(cls)]
        if not isinstance(options, Mapping):
            raise OptionError(f"options must be a dictionary with keys from {', '.join(known)}, not {options!r}")
        for name in options:
            if name not in known:
                raise OptionError(f"unknown option {name!r}; known options: {', '.join(known)}")
        given = {name: value for name, value in options.items() if value is not None}
        if "state" in given and len(given) > 1:
            raise OptionError("option 'state' brings its own objects and target; give it alone")
        if not isinstance(given.get("target", ""), str):
            raise OptionError(f"option 'target' must be an object's name such as 'object_00', not {given['target']!r}")
        if not isinstance(given.get("state", b""), bytes):
            raise OptionError(f"option 'state' must be bytes from save_state(), not {type(given['state']).__name__}")
        check_choice("option 'obstructed'", given.get("obstructed", False), OBSTRUCTED, OptionError)
        if "objects" in given:
            objects = given["objects"]
            if not isinstance(objects, Sequence) or not all(isinstance(entry, Mapping) for entry in objects):
                raise OptionError(f"option 'objects' must be a list of dictionaries, not {objects!r}")
            given["objects"] = tuple(objects)
        if "base" in given:
            if not _is_row(base := given["base"], 3):
                raise OptionError(f"option 'base' must be x, y [m] and yaw [rad], not {base!r}")
            limits = (("m", POSITION_LIMITS), ("m", POSITION_LIMITS), ("rad", YAW_LIMITS))
            given["base"] = tuple(
                check_number("option 'base'", value, limit, unit, OptionError)
                for value, (unit, limit) in zip(base, limits, strict=True)
            )
        return cls(**given)

    def target_index(self, count: int) -> int | None:
        """The slot of the requested target, None if it is drawn at random.

        Raises:
            OptionError: no object has that name.
        """
        if self.target is None:
            return None
        names = [object_name(slot) for slot in range(count)]
        if self.target not in names:
            raise OptionError(f"option 'target': no object {self.target!r}; objects: {', '.join(names)}")
        return names.index(self.target)


def explicit_scene(
    rng: np.random.Generator, layout: Layout, descriptions: Sequence[Mapping[str, Any]], max_objects: int
) -> TableScene:
    """The scene that the option `objects` describes. The base pose and the target are drawn from `rng`.

    Each description is {"shape": "cylinder", "radius", "height", "position": (x, y)} or {"shape": "box", "depth",
    "width", "height", "position"}, all in metres, with optional "yaw" [rad], "mass" [kg] and "row". Row 0 is the table,
    or the drawer of a layout with a drawer. Row 1 is the shelf above it in a layout with two rows, or the table in
    front of the drawer. With drawers side by side the row is the number from the left. A cylinder with "lying": True
    lies on its side with its axis along its yaw. Its height is then its length.

    Raises:
        OptionError: an invalid description, too many objects, an object over the table's edge or too high for the
            layout, or an overlap.
    """
    if not 1 <= len(descriptions) <= max_objects:
        raise OptionError(f"option 'objects' holds {len(descriptions)} objects; it must be 1 to {max_objects}")
    rows = [_parsed(index, entry, layout) for index, entry in enumerate(descriptions)]
    scene = TableScene(
        **{name: np.array([row[name] for row in rows]) for name in rows[0]},
        base=sample_base(rng, layout),
        target=int(rng.integers(len(rows))),
        joints=sample_joints(rng, layout),
    )
    heights = 2 * scene.standing_extents[:, 2]
    outlines = [_outline(scene, index) for index in range(scene.num_objects)]
    for index, ((corners, radius), height) in enumerate(zip(outlines, heights, strict=True)):
        surface = layout.surfaces[int(descriptions[index].get("row", 0))]
        half = np.array(surface.half_extents)
        if (np.abs(corners - surface.centre) + radius > half + TOUCH_TOLERANCE).any():
            x, y = map(_range_text, surface.centre, surface.half_extents)
            raise OptionError(
                f"{object_name(index)} reaches over the edge of layout {layout.name!r}: "
                f"x must stay {x} m and y {y} m, the object's size included"
            )
        if height > layout.headroom - HEADROOM_MARGIN + TOUCH_TOLERANCE:
            raise OptionError(
                f"{object_name(index)} is {height:.3g} m high; layout {layout.name!r} has {layout.headroom:.3g} m "
                f"above it, of which {HEADROOM_MARGIN} m stay free"
            )
        for other in range(index):
            is_beside = scene.levels[other] == scene.levels[index]
            if is_beside and _separation(outlines[other], outlines[index]) < -TOUCH_TOLERANCE:
                raise OptionError(f"{object_name(other)} and {object_name(index)} overlap; move one of them")
    return scene


def _range_text(middle: float, half: float) -> str:
    return f"within ±{half:.3g}" if middle == 0 else f"from {middle - half:.3g} to {middle + half:.3g}"


def _parsed(index: int, entry: Mapping[str, Any], layout: Layout) -> dict[str, Any]:
    """The row of one described object in each array of its scene."""
    place = f"option 'objects'[{index}]"
    shape = entry.get("shape", "cylinder")
    if not isinstance(shape, str) or shape not in _SHAPE_KEYS:
        raise OptionError(f"{place}: shape={shape!r} is not valid; valid shapes: {', '.join(_SHAPE_KEYS)}")
    known = (*_COMMON_KEYS, *_SHAPE_KEYS[shape], *_OPTIONAL_KEYS[shape])
    for key in entry:
        if key not in known:
            raise OptionError(f"{place}: unknown key {key!r}; keys of a {shape}: {', '.join(known)}")
    for key in ("position", "height", *_SHAPE_KEYS[shape]):
        if key not in entry:
            raise OptionError(f"{place}: key {key!r} is missing; keys of a {shape}: {', '.join(known)}")
    if not isinstance(is_lying := entry.get("lying", False), bool):
        raise OptionError(f"{place}: lying={is_lying!r} must be True or False")

    def number(key: str, limits: tuple[float, float], unit: str, default: float | None = None) -> float:
        return check_number(f"{place}: {key}", entry.get(key, default), limits, unit, OptionError)

    if shape == "box":
        half_x, half_y = (number(key, WIDTH_LIMITS, "m") / 2 for key in ("depth", "width"))
    else:
        half_x = half_y = number("radius", RADIUS_LIMITS, "m")
    if not _is_row(position := entry["position"], 2):
        raise OptionError(f"{place}: position={position!r} must be (x, y) in metres on the table")
    row = check_integer(
        f"{place}, in layout {layout.name!r}: row", entry.get("row", 0), 0, len(layout.levels) - 1, OptionError
    )
    return {
        "half_extents": (half_x, half_y, number("height", HEIGHT_LIMITS, "m") / 2),
        "is_box": shape == "box",
        "positions": [
            check_number(f"{place}: position", value, POSITION_LIMITS, "m", OptionError) for value in position
        ],
        "yaws": number("yaw", YAW_LIMITS, "rad", 0.0),
        "masses": number("mass", MASS_LIMITS, "kg", DEFAULT_MASS),
        "is_lying": is_lying,
        "levels": layout.levels[row],
    }


def _is_row(value: object, length: int) -> bool:
    """Whether a value is a sequence, or an array with one axis, of that length. Text and bytes are not."""
    if isinstance(value, np.ndarray):
        return value.shape == (length,)
    if not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray | memoryview):
        return False
    return len(value) == length


def _outline(scene: TableScene, index: int) -> tuple[NDArray[np.float64], float]:
    """An object from above: corners (4, 2) and 0, or of a round one its centre (1, 2) and its radius [m]."""
    centre, (half_x, half_y, _) = scene.positions[index], scene.standing_extents[index]
    if not scene.is_angular[index]:
        return centre[None], float(half_x)
    cosine, sine = math.cos(scene.yaws[index]), math.sin(scene.yaws[index])
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (half_x, half_y)
    return centre + signs @ np.array([[cosine, sine], [-sine, cosine]]), 0.0


def _separation(first: tuple[NDArray[np.float64], float], second: tuple[NDArray[np.float64], float]) -> float:
    """Largest gap [m] over the separating axes: negative if and only if the two outlines overlap.

    The axes are along the edges of the rectangles and, for a circle, along the line to the nearest corner.
    """
    (one, radius), (other, other_radius) = first, second
    axes = [corners[side] - corners[0] for corners in (one, other) if len(corners) > 1 for side in (1, 3)]
    if radius + other_radius > 0:
        between = (one[:, None] - other).reshape(-1, 2)
        axes.append(between[np.argmin(np.linalg.norm(between, axis=1))])
    gaps = []
    for axis in axes:
        unit = axis / (math.hypot(*axis) or 1.0)  # no line between a circle and a corner in its centre
        on_one, on_other = one @ unit, other @ unit
        gaps.append(max(on_other.min() - on_one.max(), on_one.min() - on_other.max()))
    return float(max(gaps)) - radius - other_radius
