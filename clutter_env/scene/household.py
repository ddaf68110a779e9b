"""Household objects made of convex parts, with real sizes, masses and colours. The parts are primitives and convex
hulls.

The object in slot i of a scene is always of the same kind, see `slot_kinds`. Positions, yaws and the target are random.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clutter_env.scene.table_scene import TableScene

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

_SIDES = 48
"""Points around a cylinder. Between two points its surface is 0.2% of the radius outside their hull."""
_SEGMENTS = 10
"""Hulls of a curved wall."""
CERAMIC, STEEL, GLASS, CARDBOARD, WOOD, PLASTIC = (
    (0.93, 0.91, 0.86),
    (0.55, 0.57, 0.60),
    (0.72, 0.83, 0.86),
    (0.80, 0.62, 0.38),
    (0.62, 0.43, 0.26),
    (0.20, 0.45, 0.75),
)
ON_CERAMIC, ON_GLASS, ON_WOOD, ON_CARDBOARD, ON_METAL, ON_PLASTIC = 0.6, 0.5, 0.5, 0.5, 0.4, 0.4
"""Coefficients of friction of dry surfaces on wood: brick 0.6, wood 0.25 to 0.5, metals 0.2 to 0.6 (CRC Handbook of
Chemistry and Physics). Fingertips of rubber have no less."""


@dataclass(frozen=True, eq=False)
class Part:
    """A convex part in the frame of its object.

    Attributes:
        shape: a capsule's or cylinder's axis is z.
        size: [m] as in MuJoCo: half extents of a box, radius and half length of a cylinder or capsule, radius
            of a sphere, () for a hull.
        position: (3,) [m] of the centre. For a hull: of the origin of its points.
        quaternion: (4,) wxyz.
        colour: red, green, blue.
        weight: share of the object's mass, relative to the sum of the weights of all parts.
        points: (k, 3) [m] corners of a hull.
    """

    shape: Literal["box", "cylinder", "capsule", "sphere", "hull"]
    size: tuple[float, ...]
    position: Array
    colour: Colour
    weight: float = 1.0
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @cached_property
    def cloud(self) -> tuple[Array, float]:
        """Points (k, 3) [m] in the frame of the object, and a radius [m]. The part is the hull of balls of this radius
        about the points."""
        if self.shape == "hull":
            return self.position + self.points, 0.0
        if self.shape == "sphere":
            return self.position[None], self.size[0]
        if self.shape == "box":
            local, radius = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * self.size, 0.0
        elif self.shape == "capsule":
            local, radius = np.array([(0.0, 0.0, -self.size[1]), (0.0, 0.0, self.size[1])]), self.size[0]
        else:
            turns = np.arange(_SIDES) * (2 * math.pi / _SIDES)
            ring = np.column_stack((np.cos(turns), np.sin(turns), np.zeros(_SIDES))) * self.size[0]
            local, radius = np.concatenate((ring - (0, 0, self.size[1]), ring + (0, 0, self.size[1]))), 0.0
        return self.position + local @ _matrix(self.quaternion).T, radius


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of household object. Its frame is at the centre of the box around the upright object.

    Attributes:
        name: of the kind.
        mass: [kg]
        friction: coefficient of its contacts with furniture and fingers.
        parts: its convex parts.
    """

    name: str
    mass: float
    friction: float
    parts: tuple[Part, ...]

    @classmethod
    def of(cls, name: str, mass: float, friction: float, *parts: Part | Sequence[Part]) -> Kind:
        """Make a kind from parts in any frame."""
        given = tuple(itertools.chain.from_iterable([part] if isinstance(part, Part) else part for part in parts))
        low = np.min([part.cloud[0].min(axis=0) - part.cloud[1] for part in given], axis=0)
        high = np.max([part.cloud[0].max(axis=0) + part.cloud[1] for part in given], axis=0)
        middle = (low + high) / 2
        return cls(name, mass, friction, tuple(replace(part, position=part.position - middle) for part in given))

    @cached_property
    def half_extents(self) -> Array:
        """Half extents (3,) [m] of the box around it."""
        return np.max(
            [np.abs(points).max(axis=0) + radius for points, radius in (part.cloud for part in self.parts)], 0
        )

    @cached_property
    def cloud(self) -> tuple[Array, Array]:
        """Points (k, 3) [m] and radii (k,) [m] of balls whose hull is the object with its hollows filled."""
        points, radii = zip(*(part.cloud for part in self.parts), strict=True)
        return np.concatenate(points), np.repeat(radii, [len(each) for each in points])


class HouseholdScene(TableScene):
    """A scene of household objects. `slot_kinds` names the kind of object in each slot."""

    @property
    def shapes(self) -> tuple[str, ...]:
        """The kind of each object."""
        return slot_kinds(self.num_objects)


def slot_kinds(count: int) -> tuple[str, ...]:
    """Names of the kinds of a scene's objects. The kinds follow one another in a cycle."""
    return tuple(itertools.islice(itertools.cycle(KINDS), count))


def as_household(scene: TableScene) -> TableScene:
    """Return `scene` as a household scene if its objects have those half extents, otherwise unchanged.

    For scenes that were read from numbers.
    """
    found = HouseholdScene(**{name: getattr(scene, name) for name in scene.__dataclass_fields__})
    half_extents = [KINDS[kind].half_extents for kind in found.shapes]
    return found if np.array_equal(scene.half_extents, np.reshape(half_extents, (-1, 3))) else scene


def _matrix(quaternion: Sequence[float]) -> Array:
    """Rotation matrix (3, 3) of a quaternion wxyz. Normalising again would change the last digits of scenes."""
    w, x, y, z = quaternion
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
    )


def _box(size: Sequence[float], at: Sequence[float], colour: Colour, weight: float = 1.0) -> Part:
    return Part("box", tuple(size), np.array(at, dtype=float), colour, weight)


def _upright(radius: float, low: float, high: float, colour: Colour, weight: float = 1.0) -> Part:
    """Upright cylinder between two heights [m]."""
    return Part("cylinder", (radius, (high - low) / 2), np.array((0.0, 0.0, (low + high) / 2)), colour, weight)


def _rod(radius: float, start: Sequence[float], end: Sequence[float], colour: Colour, weight: float = 1.0) -> Part:
    """Capsule between the centres of its caps."""
    one, other = np.array(start, dtype=float), np.array(end, dtype=float)
    length = float(np.linalg.norm(other - one))
    x, y, z = (other - one) / length
    turn = np.array((1.0 + z, -y, x, 0.0))  # shortest rotation of the z axis to it; no rod points straight down
    return Part("capsule", (radius, length / 2), (one + other) / 2, colour, weight, tuple(turn / np.linalg.norm(turn)))


def _hull(points: Sequence[Sequence[float]] | Array, colour: Colour, weight: float = 1.0) -> Part:
    return Part("hull", (), np.zeros(3), colour, weight, points=np.array(points, dtype=float))


def _turned(profile: Sequence[tuple[float, float]], colour: Colour, weight: float = 1.0, sides: int = 16) -> Part:
    """Hull of circles (radius, height) [m] about the z axis."""
    turns = np.arange(sides) * (2 * math.pi / sides)
    return _hull([(r * math.cos(a), r * math.sin(a), z) for r, z in profile for a in turns], colour, weight)


def _wall(
    low: tuple[float, float], high: tuple[float, float], thick: float, colour: Colour, weight: float
) -> list[Part]:
    """Wall between two circles (radius, height) [m], `thick` [m] inwards."""
    parts = []
    for k in range(_SEGMENTS):
        a, b = 2 * math.pi * k / _SEGMENTS, 2 * math.pi * (k + 1) / _SEGMENTS
        corners = [
            (r * math.cos(turn), r * math.sin(turn), z)
            for radius, z in (low, high)
            for r in (radius, radius - thick)
            for turn in (a, b)
        ]
        parts.append(_hull(corners, colour, weight / _SEGMENTS))
    return parts


BLUE, GREEN, SKY, BLACK, WHITE = (
    (0.25, 0.45, 0.72),
    (0.20, 0.50, 0.32),
    (0.35, 0.55, 0.80),
    (0.16, 0.16, 0.17),
    (0.92, 0.94, 0.96),
)
_HANDLE = (
    ((0.040, 0.0, 0.025), (0.068, 0.0, 0.030)),
    ((0.068, 0.0, 0.030), (0.068, 0.0, 0.072)),
    ((0.040, 0.0, 0.078), (0.068, 0.0, 0.072)),
)
_BOWL = ((0.034, 0.004), (0.062, 0.022), (0.073, 0.045), (0.075, 0.065))
_ALONG_X, _ALONG_Y = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
"""Quaternions that lay a cylinder along an axis."""
_GABLE = [(a, b, 0.19) for a in (-0.035, 0.035) for b in (-0.035, 0.035)] + [(a, 0.0, 0.225) for a in (-0.035, 0.035)]
_TURNS = np.arange(14) * (2 * math.pi / 14)
_TUBE = [(0.07, 0.020 * math.cos(a), 0.020 + 0.020 * math.sin(a)) for a in _TURNS]
_TUBE_END = [(-0.07, y, z) for y in (-0.027, 0.027) for z in (0.0, 0.003)]
_APPLE = [(0.038 * math.cos(a), 0.036 * math.sin(a)) for a in np.linspace(-1.15, 1.25, 9)]

_ALL = (
    Kind.of(
        "mug",
        0.32,
        ON_CERAMIC,
        _upright(0.038, 0.0, 0.006, BLUE, 0.2),
        _wall((0.041, 0.0), (0.042, 0.095), 0.005, BLUE, 0.65),
        [_rod(0.005, *ends, BLUE, 0.05) for ends in _HANDLE],
    ),
    Kind.of("packet", 0.20, ON_CARDBOARD, _box((0.030, 0.045, 0.070), (0.0, 0.0, 0.070), CARDBOARD)),
    Kind.of(
        "bottle",
        0.52,
        ON_PLASTIC,
        _upright(0.033, 0.0, 0.135, GREEN, 0.85),
        _turned(((0.033, 0.135), (0.014, 0.175)), GREEN, 0.1),
        _upright(0.013, 0.17, 0.195, GREEN, 0.03),
        _upright(0.015, 0.195, 0.212, (0.9, 0.9, 0.9), 0.02),
    ),
    Kind.of(
        "bowl",
        0.30,
        ON_CERAMIC,
        _upright(0.035, 0.0, 0.005, CERAMIC, 0.16),
        *(_wall(low, high, 0.006, CERAMIC, 0.28) for low, high in itertools.pairwise(_BOWL)),
    ),
    Kind.of(
        "can",
        0.37,
        ON_METAL,
        _upright(0.033, 0.004, 0.111, (0.93, 0.55, 0.12), 0.94),
        [_upright(0.0325, low, low + 0.004, STEEL, 0.03) for low in (0.0, 0.111)],
    ),
    Kind.of(
        "jar",
        0.45,
        ON_GLASS,
        _upright(0.038, 0.0, 0.080, (0.45, 0.30, 0.52), 0.85),
        _upright(0.034, 0.08, 0.09, GLASS, 0.05),
        _upright(0.036, 0.090, 0.105, (0.85, 0.70, 0.20), 0.1),
    ),
    Kind.of(
        "carton",
        0.55,
        ON_CARDBOARD,
        _box((0.035, 0.035, 0.095), (0.0, 0.0, 0.095), (0.93, 0.95, 0.97), 0.95),
        _hull(_GABLE, SKY, 0.05),
    ),
    Kind.of(  # flat at the bottom, with a stalk; its waxy skin is taken as smooth wood
        "apple",
        0.18,
        ON_WOOD,
        _turned(_APPLE, (0.55, 0.70, 0.22), 0.99),
        _rod(0.0025, (0.0, 0.0, 0.034), (0.003, 0.0, 0.046), WOOD, 0.01),
    ),
    Kind.of(
        "glass",
        0.15,
        ON_GLASS,
        _upright(0.034, 0.0, 0.005, GLASS, 0.35),
        _upright(0.005, 0.005, 0.086, GLASS, 0.15),
        _turned(((0.008, 0.085), (0.030, 0.105)), GLASS, 0.2),
        _wall((0.030, 0.105), (0.034, 0.160), 0.004, GLASS, 0.3),
    ),
    Kind.of(  # lying, flat at its end
        "tube",
        0.12,
        ON_PLASTIC,
        _hull(_TUBE + _TUBE_END, WHITE, 0.9),
        Part("cylinder", (0.014, 0.012), np.array((0.081, 0.0, 0.02)), PLASTIC, 0.1, _ALONG_X),
    ),
    Kind.of(
        "pan",
        0.60,
        ON_METAL,
        _upright(0.070, 0.0, 0.005, BLACK, 0.5),
        _wall((0.070, 0.0), (0.080, 0.042), 0.005, BLACK, 0.35),
        _rod(0.009, (0.080, 0.0, 0.034), (0.190, 0.0, 0.046), WOOD, 0.15),
    ),
    Kind.of(  # lying on the side of its head
        "hammer",
        0.45,
        ON_WOOD,
        Part("cylinder", (0.013, 0.045), np.array((0.0, 0.0, 0.013)), STEEL, 0.7, _ALONG_Y),
        _box((0.100, 0.013, 0.009), (0.110, 0.0, 0.009), WOOD, 0.3),
    ),
)
KINDS: Mapping[str, Kind] = MappingProxyType({kind.name: kind for kind in _ALL})
"""Kinds by name, in the order of slots. No kind is red, the colour of the target."""
