"""`reset(options=...)`: checked before anything in the environment changes, and the scene that the options ask for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clutter_env.config import OBSTRUCTED, EnvConfig, check_choice
from clutter_env.errors import ConfigError, OptionError
from clutter_env.scene.layout import Layout
from clutter_env.scene.obstruction import UNREACHABLE, count_blockers, side_approaches
from clutter_env.scene.random_scene import sample_base, sample_scene
from clutter_env.scene.table_scene import TableScene, object_name

MAX_DRAWS = 1000
"""Random scenes that are drawn until one has an obstructed target."""


def draw_scene(rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions) -> TableScene:
    """The scene that the options describe, random where they leave it open.

    Raises:
        OptionError: see `explicit_scene`; there is no object of the wanted target's name; or `obstructed` is asked for
            and the wanted target, or every object, can be grasped from the side.
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
    """A scene whose target has at least `least` objects in the way; random scenes are drawn until there is one."""
    if problem := config.obstruction_problem(least):
        raise OptionError(f"option 'obstructed': {problem}")
    robot = config.find_robot()
    is_random = options.objects is None and options.target is None
    for _ in range(MAX_DRAWS if is_random else 1):
        scene = _draw_any(rng, layout, config, options)
        blockers = count_blockers(side_approaches(robot.full_name), layout, scene, robot.max_opening)
        wanted = options.target_index(scene.num_objects)
        if wanted is not None and blockers[wanted] >= least:
            return scene.with_target(wanted)
        if wanted is not None:
            reason = f"a side grasp has {blockers[wanted]} objects in its way, not {least} or more"
            if blockers[wanted] == UNREACHABLE:
                reason = "no side grasp reaches it, whatever is moved"
            raise OptionError(f"option 'target': {options.target} is not obstructed: {reason}")
        if len(obstructed := np.flatnonzero(blockers >= least)):
            return scene.with_target(int(obstructed[rng.integers(len(obstructed))]))
    what = f"none of {MAX_DRAWS} random scenes has" if is_random else "the scene does not have"
    raise OptionError(
        f"option 'obstructed': {what} a target with {least} or more objects in the way; ask for more objects"
    )


OPTION_NAMES = ("target", "objects", "state", "obstructed")
_COMMON_KEYS = ("shape", "position", "height", "yaw", "mass", "row")
_SHAPE_KEYS: Mapping[str, tuple[str, ...]] = {"cylinder": ("radius",), "box": ("depth", "width")}
_OPTIONAL_KEYS: Mapping[str, tuple[str, ...]] = {"cylinder": ("lying",), "box": ()}
HALF_WIDTH_LIMITS = (0.01, 0.10)
"""[m] radius of a cylinder, half depth and half width of a box."""
HEIGHT_LIMITS = (0.04, 0.39)
"""[m]"""
HEADROOM_MARGIN = 0.01
"""[m] between an object's top and what hangs above the table, at least."""
MASS_LIMITS = (0.01, 5.0)
"""[kg]"""
DEFAULT_MASS = 0.2
TOUCH_TOLERANCE = 1e-6
"""[m] Objects may touch; deeper overlaps are refused."""


@dataclass(frozen=True)
class ResetOptions:
    """The options of a reset, their types checked; `objects` are still the user's descriptions."""

    target: str | None = None
    objects: tuple[Mapping[str, Any], ...] | None = None
    state: bytes | None = None
    obstructed: bool | int | None = None

    @classmethod
    def of(cls, options: object) -> ResetOptions:
        """Check the dictionary given to `reset`.

        Raises:
            OptionError: an unknown name, a wrong type, or a saved state together with another option.
        """
        if options is None:
            return cls()
        if not isinstance(options, Mapping):
            raise OptionError(f"options must be a dictionary with keys from {', '.join(OPTION_NAMES)}, not {options!r}")
        for name in options:
            if name not in OPTION_NAMES:
                raise OptionError(f"unknown option {name!r}; known options: {', '.join(OPTION_NAMES)}")
        given = {name: value for name, value in options.items() if value is not None}
        if "state" in given and len(given) > 1:
            raise OptionError("option 'state' brings its own objects and target; give it alone")
        if not isinstance(given.get("target", ""), str):
            raise OptionError(f"option 'target' must be an object's name such as 'object_00', not {given['target']!r}")
        if not isinstance(given.get("state", b""), bytes):
            raise OptionError(f"option 'state' must be bytes from save_state(), not {type(given['state']).__name__}")
        try:
            check_choice("option 'obstructed'", given.get("obstructed", False), OBSTRUCTED)
        except ConfigError as problem:
            raise OptionError(str(problem)) from None
        if "objects" in given:
            objects = given["objects"]
            if isinstance(objects, str | bytes) or not isinstance(objects, Sequence):
                raise OptionError(f"option 'objects' must be a list of dictionaries, not {objects!r}")
            for entry in objects:
                if not isinstance(entry, Mapping):
                    raise OptionError(f"option 'objects' must be a list of dictionaries; it holds {entry!r}")
            given["objects"] = tuple(objects)
        return cls(**given)

    def target_index(self, count: int) -> int | None:
        """The slot of the wanted target, None where it is drawn at random.

        Raises:
            OptionError: there is no object of that name.
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
    """The scene that the option `objects` describes; the base pose and the target are drawn from `rng`.

    Each description is {"shape": "cylinder", "radius", "height", "position": (x, y)} or {"shape": "box", "depth",
    "width", "height", "position"}, all in metres, with optional "yaw" [rad], "mass" [kg] and "row": 0 for the table, 1
    for the shelf above it in a layout with two rows. A cylinder with "lying": True lies on its side, its axis along
    its yaw; its height is then its length.

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
    )
    footprints = [_footprint(scene, index) for index in range(scene.num_objects)]
    half = np.array([layout.depth, layout.width]) / 2
    for index, (shape, height) in enumerate(zip(footprints, 2 * scene.standing_extents[:, 2], strict=True)):
        if (np.abs(shape.corners) + shape.radius > half + TOUCH_TOLERANCE).any():
            raise OptionError(
                f"{object_name(index)} reaches over the edge of layout {layout.name!r}: "
                f"x must stay within ±{half[0]:.3g} m and y within ±{half[1]:.3g} m, the object's size included"
            )
        if height > layout.headroom - HEADROOM_MARGIN + TOUCH_TOLERANCE:
            raise OptionError(
                f"{object_name(index)} is {height:.3g} m high; layout {layout.name!r} has {layout.headroom:.3g} m "
                f"above it, of which {HEADROOM_MARGIN} m stay free"
            )
        for other in range(index):
            is_beside = scene.levels[other] == scene.levels[index]
            if is_beside and _separation(footprints[other], shape) < -TOUCH_TOLERANCE:
                raise OptionError(f"{object_name(other)} and {object_name(index)} overlap; move one of them")
    return scene


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
    full = 2 * HALF_WIDTH_LIMITS[0], 2 * HALF_WIDTH_LIMITS[1]
    if shape == "box":
        half_x, half_y = (_number(place, key, entry[key], *full) / 2 for key in ("depth", "width"))
    else:
        half_x = half_y = _number(place, "radius", entry["radius"], *HALF_WIDTH_LIMITS)
    return {
        "half_extents": (half_x, half_y, _number(place, "height", entry["height"], *HEIGHT_LIMITS) / 2),
        "is_box": shape == "box",
        "positions": _position(place, entry["position"]),
        "yaws": _number(place, "yaw", entry.get("yaw", 0.0), -2 * math.pi, 2 * math.pi),
        "masses": _number(place, "mass", entry.get("mass", DEFAULT_MASS), *MASS_LIMITS),
        "is_lying": is_lying,
        "levels": _level(place, entry.get("row", 0), layout),
    }


def _number(place: str, key: str, value: object, lowest: float, highest: float) -> float:
    is_number = isinstance(value, Real | np.number) and not isinstance(value, bool)
    if not is_number or not lowest <= float(value) <= highest:  # type: ignore[arg-type]  # a number
        raise OptionError(f"{place}: {key}={value!r} must be a number from {lowest:.4g} to {highest:.4g}")
    return float(value)  # type: ignore[arg-type]  # a number


def _level(place: str, row: object, layout: Layout) -> float:
    """[m] of a row of objects above the table."""
    rows = range(len(layout.levels))
    if isinstance(row, bool) or not isinstance(row, int | np.integer) or row not in rows:
        valid = ", ".join(map(str, rows))
        raise OptionError(f"{place}: row={row!r} is not valid in layout {layout.name!r}; valid rows: {valid}")
    return layout.levels[row]


def _position(place: str, value: object) -> tuple[float, float]:
    if not isinstance(value, Sequence | np.ndarray) or isinstance(value, str) or len(value) != 2:
        raise OptionError(f"{place}: position={value!r} must be (x, y) in metres on the table")
    x, y = (_number(place, f"position {axis}", entry, -2.0, 2.0) for axis, entry in zip("xy", value, strict=True))
    return x, y


Polygon = NDArray[np.float64]


class _Footprint(NamedTuple):
    """A disc or a rectangle on the table: its centre, its corners (4, 2) or its centre alone, and its radius."""

    centre: Polygon
    corners: Polygon
    radius: float


def _footprint(scene: TableScene, index: int) -> _Footprint:
    centre = scene.positions[index]
    half_x, half_y, _ = scene.standing_extents[index]
    if not scene.is_angular[index]:
        return _Footprint(centre, centre[None], float(half_x))
    cosine, sine = math.cos(scene.yaws[index]), math.sin(scene.yaws[index])
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (half_x, half_y)
    return _Footprint(centre, centre + signs @ np.array([[cosine, sine], [-sine, cosine]]), 0.0)


def _separation(a: _Footprint, b: _Footprint) -> float:
    """Largest gap over the separating axes [m]: negative if and only if the two overlap."""
    axes = [*_edge_normals(a), *_edge_normals(b)]
    for shape, other in ((a, b), (b, a)):
        if len(shape.corners) == 1:
            offsets = other.corners - shape.centre
            nearest = offsets[np.argmin(np.linalg.norm(offsets, axis=1))]
            distance = np.linalg.norm(nearest)
            if distance > 0:
                axes.append(nearest / distance)
    if not axes:
        return -math.inf
    gaps = []
    for axis in axes:
        on_a, on_b = a.corners @ axis, b.corners @ axis
        gaps.append(max(on_b.min() - on_a.max(), on_a.min() - on_b.max()))
    return float(max(gaps)) - a.radius - b.radius


def _edge_normals(shape: _Footprint) -> list[Polygon]:
    if len(shape.corners) == 1:
        return []
    edges = shape.corners[1:3] - shape.corners[:2]
    return [np.array([-y, x]) / math.hypot(x, y) for x, y in edges]
