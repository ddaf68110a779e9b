"""Scene compiled for fast collision checks, with one bit per object.

    world = CollisionWorld.from_scene(scene)
    world.names_of(world.hits(scene.state.base, scene.state.q, opening=0.1))

The same arrays tell which objects of a scene stand on others, and whether the scene is valid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irm.chain import BASE
from irm.gjk import CYLINDER, Solids, are_any_within, are_within
from irm.kernel_arguments import packed, with_numbers
from planners.collision.hit_kernels import (
    Attached,
    CollisionQuery,
    Scratch,
    edges_that_hit,
    make_scratch,
    many_hits,
    packed_query,
    path_hits,
)
from planners.collision.scene_arrays import (
    Obstacles,
    RobotArrays,
    body_bound,
    body_solids,
    join_solids,
    moved_solids,
    obstacle_arrays,
    robot_of,
    shrunk_solids,
    solid_arrays,
    with_object,
)
from planners.hollows import contents_of
from planners.scene import SELF_BIT, STATIC_BIT, Body, HeldObject, Scene, SceneError, Solid
from planners.scene.bodies import release_pitch, up_axis

PADDING = 0.002
"""[m] Distance that the robot keeps from everything else."""
STEP = 0.006
"""[m] Largest motion of a point of the robot between two checks. A missed collision is at most 1 mm deep."""
SUPPORT_SLACK = 0.0005
"""[m] Overlap allowed of a held object's bottom with a static obstacle, so that it can be lifted from a table."""
_ALL = (1 << 64) - 1
_KEPT = 32
"""Most arrangements kept, counted for each arm. A look-ahead uses one per object to clear."""
_CONTACT = 0.002
"""[m] Largest distance of objects in contact."""
_LEAN = 0.005
"""[m] Largest depth of an object's lowest point below its supporter's highest point, where one of them leans."""
_SIZES = 19
"""Reductions tried for the size of an object that is lifted beside others, 0.25 mm apart."""
OVERLAP = 0.002
"""[m] Largest overlap of objects, and of the robot and static obstacles. More than soft contacts allow."""

_SEARCHED, _GRID = 2.0, 0.05
"""[m] Half width and step of the search for a free base pose around a base pose in collision."""


class _Carried(NamedTuple):
    """Held object, or none, prepared for checks."""

    held: HeldObject | None  # kept alive, as is the robot, because its id is a part of the key
    robot: RobotArrays
    attached: Attached
    width: float  # [m] between the fingers, 0 without an object
    scratch: Scratch  # kernels hold the interpreter's lock, so only one writes to it at a time
    queries: dict[tuple[float, int, float, bool], CollisionQuery]


@dataclass(frozen=True, eq=False)
class CollisionWorld:
    """Scene compiled for collision checks. Build it once and pass it on.

    Masks are as in `Scene`: bit i is object i, with STATIC_BIT and SELF_BIT added. Three arguments determine a check:
    `opening` of the gripper [m], the `held` object, which moves with the TCP and is no obstacle, and `ignore`, a mask
    of ignored bits.

    Attributes:
        scene: the scene it was compiled from.
        robot, obstacles: arrays of both for kernels.
        padding: distance below which solids are in collision [m].
        yields: reduction of the held object's size in checks against objects [m], see `with_clearance_around`.
        aside: horizontal shift of the held object in these checks (3,) [m], in its frame, see `with_clearance_around`.
    """

    scene: Scene
    robot: RobotArrays
    obstacles: Obstacles
    padding: float = PADDING
    yields: float = 0.0
    aside: tuple[float, ...] = (0.0, 0.0, 0.0)
    _carried: dict[tuple[object, ...], _Carried] = field(repr=False, default_factory=dict)
    _padded: dict[float, CollisionWorld] = field(init=False, repr=False, default_factory=dict)

    @classmethod
    def from_scene(cls, scene: Scene, padding: float = PADDING) -> CollisionWorld:
        """Compile a scene. The robot's head is assumed to be in `robot.head_configuration`.

        Raises:
            GeometryError: the robot has collision geometry that cannot be represented.
        """
        return cls(scene, robot_of(scene), obstacle_arrays(scene), padding)

    def with_padding(self, padding: float) -> CollisionWorld:
        """The same world with another padding [m]."""
        if padding not in self._padded:
            self._padded[padding] = replace(self, padding=padding)
        return self._padded[padding]

    def with_body(self, body: Body) -> CollisionWorld:
        """The same world with the object of that name moved. Only its own rows are compiled again.

        Raises:
            UnknownObject: no object of that name.
        """
        moved = with_object(self.obstacles, self.scene.index(body.name), body)
        return self.with_obstacles(moved, self.scene.with_body(body))

    def with_smaller(self, mask: int, by: float) -> CollisionWorld:
        """The same world with the surfaces of a mask's objects moved inward by `by` [m]."""
        counted = [bool(mask >> i & 1) for i in range(len(self.scene.objects))]
        inwards = by * np.repeat(counted, np.diff(self.obstacles.first))
        pieces = shrunk_solids(self.obstacles.pieces, inwards, by)
        return self.with_obstacles(self.obstacles._replace(pieces=pieces))

    def with_obstacles(self, obstacles: Obstacles, scene: Scene | None = None) -> CollisionWorld:
        """The same world with other obstacles. It does not share the data prepared for checks."""
        return replace(self, scene=scene or self.scene, obstacles=obstacles, _carried={})

    def for_arm(self, arm: str) -> CollisionWorld:
        """The same world with that arm active and empty grippers. This world if the arm is already active."""
        if arm == self.scene.robot.arm_name:
            return self
        scene = replace(self.scene, held=None, aside=()).using(arm)
        return replace(self, scene=scene, robot=robot_of(scene))

    def active(self, ignore: int = 0) -> np.uint64:
        """All bits except those of `ignore` and of objects in idle arms, which are a part of the robot."""
        aside = self.scene.mask(one.held.name for one in self.scene.aside) if self.scene.aside else 0
        return np.uint64(_ALL & ~int(ignore) & ~aside)

    def _carry(self, held: HeldObject | None, robot: RobotArrays) -> _Carried:
        """Data computed once for each held object, and for none. Raises `UnknownObject`.

        Worlds with the same obstacles share it, for any pose of the robot in their scenes and any padding above
        `PADDING`.
        """
        is_in_hand = held is not None and self.scene.held is not None and self.scene.held.name == held.name
        key = id(held), id(robot), min(self.padding, PADDING), self.yields, self.aside, is_in_hand
        if key not in self._carried:
            if held is None:
                width, (attached, scratch) = 0.0, _empty_handed(self.robot, robot)
            else:
                width = self.scene.body(held.name).width_in_gripper(held.T_tcp_object)
                attached = packed(self._attach(held))
                scratch = packed(make_scratch(robot, attached))
            self._carried[key] = _Carried(held, robot, attached, width, scratch, {})
        return self._carried[key]

    def _attach(self, held: HeldObject) -> Attached:
        """The held object's solids for kernels, and copies with raised bottoms, see `Attached`."""
        body = self.scene.body(held.name)
        position, rotation = held.T_tcp_object[:3, 3], held.T_tcp_object[:3, :3]
        solids = body_solids(body.at_pose(np.eye(4)))
        solids = solids._replace(position=solids.position + self.aside)
        both = join_solids((shrunk_solids(solids, self.yields), self._with_raised_bottom(solids, body, held)))
        return Attached(
            bit=self.scene.index(held.name),
            solids=moved_solids(both, rotation, position),
            reach=np.maximum(self.robot.reach, self.robot.tip_reach + np.linalg.norm(position) + body_bound(body)),
        )

    def _with_raised_bottom(self, solids: Solids, body: Body, held: HeldObject) -> Solids:
        """Solids of an object, in its frame, without their lowest layer next to the support. Several pieces are all
        raised.

        The upward direction is that of the object at rest in the scene or, if it is already held, where it is put down.
        """
        if self.scene.held is not None and self.scene.held.name == body.name:
            pitch = release_pitch(body, held)
            up = held.T_tcp_object[:3, :3].T @ (-np.sin(pitch), 0.0, np.cos(pitch))
        else:
            up = body.rotation.T @ up_axis(body)
        # The least height that allows the lift. A motion with more padding keeps the rest of it from the support too.
        raised, axis = 0.5 * (min(self.padding, PADDING) + SUPPORT_SLACK), int(np.abs(up).argmax())
        if body.shape == "pieces":
            return solids._replace(position=solids.position + 2 * raised * up)
        if body.shape == "cylinder" and axis != 2:
            across = np.array((up[0], up[1], 0.0))
            shrunk, step = np.array((raised, raised, 0.0)), raised * across / np.linalg.norm(across)
        else:
            shrunk = raised * np.eye(3)[axis]
            step = shrunk * np.sign(up[axis])
        return solids._replace(half=solids.half - shrunk, position=solids.position + step)

    def query(
        self,
        opening: float,
        held: HeldObject | None = None,
        ignore: int = 0,
        first_only: bool = False,
        robot: RobotArrays | None = None,
    ) -> CollisionQuery:
        """Input of the kernels. With `first_only` they stop at the first hit. `robot`: a part of the robot to check
        alone."""
        carried, active = self._carry(held, robot or self.robot), self.active(ignore)
        # Fingers commanded to close on the held object stay at its width.
        apart, padding = max(float(opening), carried.width), float(self.padding)
        key = apart, int(active), padding, first_only
        if not carried.queries:
            scratch, attached = carried.scratch, carried.attached
            query = CollisionQuery(carried.robot, self.obstacles, attached, scratch, apart, active, padding, first_only)
            carried.queries[key] = packed_query(query)
        elif key not in carried.queries:
            # The queries differ only in numbers.
            known = next(iter(carried.queries.values()))
            carried.queries[key] = with_numbers(
                known, opening=apart, active=active, padding=padding, first_only=first_only
            )
        return carried.queries[key]

    def hits(
        self, base: ArrayLike, q: ArrayLike, opening: float, held: HeldObject | None = None, ignore: int = 0
    ) -> int:
        """Mask of collisions of one configuration: base x [m], y [m], yaw [rad] (3,), torso [m] and arm [rad] (8,)."""
        return int(self.hits_many(base, np.asarray(q, dtype=float)[None], opening, held, ignore)[0])

    def hits_many(
        self, base: ArrayLike, Q: ArrayLike, opening: float, held: HeldObject | None = None, ignore: int = 0
    ) -> NDArray[np.uint64]:
        """Masks of collisions (k,) of each configuration of `Q` (k, 8) at one base pose."""
        query = self.query(opening, held, ignore)
        hits: NDArray[np.uint64] = many_hits(query, np.array(base, dtype=float), np.array(Q, dtype=float, order="C"))
        return hits

    def path_hits(
        self,
        X: ArrayLike,
        opening: float,
        held: HeldObject | None = None,
        ignore: int = 0,
        step: float = STEP,
        first_only: bool = False,
    ) -> int:
        """Mask of collisions of a piecewise straight motion.

        Args:
            X: (k, 11) whole-body configurations, base and `q`.
            opening, held, ignore: as for all checks.
            step: largest motion of any point of the robot between two checks [m].
            first_only: stop at the first hit. The mask is then 0 only without any hit, but may lack other hits.
        """
        query = self.query(opening, held, ignore, first_only)
        return int(path_hits(query, np.array(X, dtype=float, order="C"), float(step)))

    def edges_that_hit(self, X: ArrayLike, opening: float, ignore: int = 0, step: float = STEP) -> NDArray[np.bool_]:
        """Whether each straight part (k - 1,) of a motion is in collision. Arguments as for `path_hits`."""
        query = self.query(opening, None, ignore, first_only=True)
        return np.asarray(edges_that_hit(query, np.array(X, dtype=float, order="C"), float(step)))

    def names_of(self, mask: int) -> tuple[str, ...]:
        """Names of the set bits: names of objects, "a static obstacle", "the robot itself"."""
        special = (("a static obstacle", STATIC_BIT), ("the robot itself", SELF_BIT))
        return (*self.scene.names_of(mask), *(name for name, bit in special if int(mask) >> bit & 1))


@lru_cache(maxsize=16)
def _empty_handed(robot: RobotArrays, part: RobotArrays) -> tuple[Attached, Scratch]:
    """Empty `Attached`, and memory for checks of a part of the robot or the whole robot, packed."""
    attached = packed(Attached(-1, join_solids(()), np.array(robot.reach)))
    return attached, packed(make_scratch(part, attached))


class CompiledScenes:
    """Cache of compiled scenes. Scenes that differ only in the robot's state or its held object share the arrays.

    Created once per solve and passed down. Two scenes have the same arrangement if they have identical bodies.
    """

    def __init__(self) -> None:
        """Start with nothing compiled."""
        self._worlds: dict[tuple[object, ...], CollisionWorld] = {}

    def world(self, scene: Scene) -> CollisionWorld:
        """The compiled scene, with `scene` as its attribute."""
        key = (scene.robot, *scene.supports, *scene.static_obstacles, *scene.objects, *scene.aside)
        known = self._worlds.pop(key, None)
        if known is None:
            known = CollisionWorld.from_scene(scene)
        elif known.scene is not scene:
            known = replace(known, scene=scene)
        self._worlds[key] = known
        if len(self._worlds) > _KEPT:
            del self._worlds[next(iter(self._worlds))]
        return known


def objects_on(world: CollisionWorld, name: str) -> int:
    """Mask of the objects on or in an object, directly or through others. Raises `UnknownObject`."""
    scene = world.scene
    below = [scene.body(name)]
    found = 0
    for supporter in below:
        for body in contents_of(scene, supporter) if supporter.name not in scene.held_names else ():
            found |= 1 << scene.index(body.name)
            below += [body] if body not in below else []
        for index, body in enumerate(scene.objects):
            if not found >> index & 1 and _stands_on(world, body, supporter):
                found |= 1 << index
                below.append(body)
    return found


def with_clearance_around(world: CollisionWorld, name: str) -> CollisionWorld:
    """The same world, adapted so that an object can be lifted although others are already nearer than the padding.

    Objects under it are lowered by the padding and `SUPPORT_SLACK`. Where others are beside it, or it leans on or
    presses into one, the held object is reduced by the missing distance. So the lift may come nearer to them by
    `SUPPORT_SLACK` at most. The walls of a bowl are too thin for that: it is shifted away by the missing distance
    instead. The robot itself keeps the padding from these objects.
    """
    body, scene, gap = world.scene.body(name), world.scene, world.padding + SUPPORT_SLACK
    index, obstacles, yields, far = scene.index(name), world.obstacles, 0.0, max(gap, _CONTACT)
    aside = np.zeros(3)
    away = np.hypot(*(obstacles.centre - obstacles.centre[index])[:, :2].T) - obstacles.radius - obstacles.radius[index]
    above = np.maximum(obstacles.bottom - obstacles.top[index], obstacles.bottom[index] - obstacles.top)
    # Overlaps up to `OVERLAP` are compensated. Objects that overlap more stay in collision.
    sizes = np.linspace(0.0, gap + OVERLAP, _SIZES)
    for row in np.flatnonzero((away < far) & (above < far)).tolist():
        other, lacks = scene.objects[row], gap
        if row == index or other.name in scene.held_names:
            continue
        if _stands_on(world, body, other):
            world, lacks = world.with_body(other.at(other.position - [0.0, 0.0, gap])), world.padding
        # Sizes increase, so the first that keeps the distance is the least reduction.
        smaller = ((size, shrunk_solids(obstacles.pieces, size)) for size in sizes)
        rows, others = obstacles.rows(index), (world.obstacles.pieces, obstacles.rows(row))
        apart = (float(size) for size, shrunk in smaller if not _are_near((shrunk, rows), others, lacks))
        least = next(apart, None)
        if least is None:
            aside = aside + _shift_off(world, body, other, sizes, lacks)
        yields = max(yields, least or 0.0)
    return replace(world, yields=yields, aside=tuple(aside.tolist())) if yields or aside.any() else world


def _shift_off(
    world: CollisionWorld, body: Body, other: Body, sizes: NDArray[np.float64], lacks: float
) -> NDArray[np.float64]:
    """The least of some horizontal shifts (3,) [m], in the object's frame, that takes it `lacks` [m] off another one.

    Zero if none does, or if both stand one above the other.
    """
    away, scene = body.position - other.position, world.scene
    away[2] = 0.0
    if not away.any():
        return away
    rows, others = (world.obstacles.rows(scene.index(one.name)) for one in (body, other))
    for shift in np.outer(sizes, away / np.linalg.norm(away)):
        shifted = world.with_body(body.at(body.position + shift)).obstacles.pieces
        if not _are_near((shifted, rows), (world.obstacles.pieces, others), lacks):
            return np.asarray(body.rotation.T @ shift)
    return np.zeros(3)


def with_clearance_at_ends(world: CollisionWorld, start: Body, end: Body | None) -> CollisionWorld:
    """The same world, in which an object can be carried from what it touches to what it touches there.

    Both as `with_clearance_around`; `start` and `end`, None for in the air, are the object, which is in no gripper.
    """
    left = with_clearance_around(world.with_body(start), start.name)
    if end is None:
        return left
    come_to = with_clearance_around(left.with_body(end), end.name)
    return replace(come_to.with_body(start), yields=max(left.yields, come_to.yields), aside=left.aside)


def _stands_on(world: CollisionWorld, body: Body, supporter: Body) -> bool:
    """Whether an object touches another object under it. A held object stands on nothing."""
    scene = world.scene
    is_held = any(name in scene.held_names for name in (body.name, supporter.name))
    # For a sheet thinner than `_LEAN` only the upper half supports, so that it stands neither on itself nor on objects
    # beside it.
    if is_held or body.bottom < max(supporter.top - _LEAN, (supporter.top + supporter.bottom) / 2):
        return False
    obstacles = world.obstacles
    upper, lower = (obstacles.rows(scene.index(one.name)) for one in (body, supporter))
    return _are_near((obstacles.pieces, upper), (obstacles.pieces, lower), _CONTACT)


def are_near(solids: Sequence[Solid], body: Body, gap: float) -> bool:
    """Whether an object is within `gap` [m] of any of the solids in the world."""
    lower, upper = body.corners.min(axis=0) - gap, body.corners.max(axis=0) + gap
    near = [one for one in solids if (one.lower <= upper).all() and (one.upper >= lower).all()]
    if not near:
        return False
    some, others = solid_arrays(near), solid_arrays(body.placed)
    return _are_near((some, range(len(near))), (others, range(len(body.placed))), gap)


def _are_near(some: tuple[Solids, Sequence[int]], others: tuple[Solids, Sequence[int]], padding: float) -> bool:
    """Whether some solids, by their rows, are within `padding` [m] of others."""
    (a, rows), (b, other_rows) = (packed(some[0]), some[1]), (packed(others[0]), others[1])
    for i, j in product(rows, other_rows):
        near = are_within if max(a.core[i], b.core[j]) <= CYLINDER else are_any_within
        if near(a, i, b, j, padding, np.empty((4, 3))):
            return True
    return False


def validate(world: CollisionWorld) -> None:
    """Check that the objects of a scene do not overlap and that the robot is not inside a static obstacle.

    Raises:
        SceneError: they overlap, or it is inside. The message names them.
    """
    scene = world.scene
    pairs = [pair for pair in overlaps(world) if not set(scene.held_names) & set(pair)]
    if pairs:
        raise SceneError(f"objects overlap: {', '.join(f'{one} and {other}' for one, other in pairs)}")
    if is_inside_static(world):
        raise SceneError(_where_inside(scene))


def _where_inside(scene: Scene) -> str:
    """Message that names the links of the robot inside static obstacles, and the nearest base pose without a
    collision."""
    bare = replace(scene, objects=(), held=None, aside=(), static_obstacles=())
    around = {"the ground": CollisionWorld.from_scene(bare)}
    if not is_inside_static(around["the ground"]):
        alone = ((one.name, replace(bare, static_obstacles=(one,))) for one in scene.static_obstacles)
        worlds = {name: CollisionWorld.from_scene(single) for name, single in alone}
        around = {name: world for name, world in worlds.items() if is_inside_static(world)}
    names = [scene.robot.base_body, *(link.joint for link in scene.robot.chain)]
    inside = [
        link for link in range(BASE, len(scene.robot.chain)) if any(_is_inside(one, link) for one in around.values())
    ]
    links = ["its base" if link == BASE else f"what {names[link - BASE]} moves" for link in inside]
    base, free = np.round(scene.state.base, 3).tolist(), _nearest_free_base(scene)
    away = "none near it is free" if free is None else f"the nearest free one is {free}"
    parts = f" with {', '.join(links)}" if links else ""
    return f"the robot is inside {' and '.join(around)}{parts} at base pose {base}; {away}"


def _is_inside(world: CollisionWorld, link: int) -> bool:
    """Whether a link of the robot, by its number, overlaps the ground or a static obstacle by more than `OVERLAP`."""
    robot, state = world.robot, world.scene.state
    rows = robot.link == link
    if not rows.any():
        return False
    solids = ("core", "half", "radius", "bound", "link", "position", "rotation", "slides", "slide")
    part = robot._replace(**{name: getattr(robot, name)[rows] for name in solids})
    part = packed(part._replace(self_pairs=np.zeros((0, 2), np.int64), held_from=0))
    query = world.with_padding(-OVERLAP).query(0.0, robot=part)
    hits = many_hits(query, np.array(state.base, dtype=float), np.array(state.q, dtype=float)[None])
    return bool(int(hits[0]) >> STATIC_BIT & 1)


def _nearest_free_base(scene: Scene) -> list[float] | None:
    """The nearest base pose x, y [m], yaw [rad] without a collision in the robot's configuration. None if none is
    found."""
    world, state = CollisionWorld.from_scene(replace(scene, held=None, aside=())), scene.state
    steps = np.arange(-_SEARCHED, _SEARCHED + _GRID / 2, _GRID)
    shifts = np.array(list(product(steps, steps)))
    for shift in shifts[np.argsort(np.hypot(*shifts.T), kind="stable")]:
        base = np.round(state.base + [*shift, 0.0], 3)
        if not world.hits(base, state.q, 0.0):
            return [float(value) for value in base]
    return None


def is_inside_static(world: CollisionWorld) -> bool:
    """Whether the robot at its pose overlaps the ground or a static obstacle by more than `OVERLAP`."""
    state, objects = world.scene.state, world.scene.mask(world.scene.names)
    return bool(world.with_padding(-OVERLAP).hits(state.base, state.q, 0.0, ignore=objects) >> STATIC_BIT & 1)


def overlaps(world: CollisionWorld) -> list[tuple[str, str]]:
    """Pairs of objects that overlap by more than `OVERLAP`."""
    obstacles, names = world.obstacles, world.scene.names
    shrunk = shrunk_solids(obstacles.pieces, OVERLAP / 2, 1e-4)
    found: list[tuple[str, str]] = []
    away = np.linalg.norm(obstacles.centre[:, None, :2] - obstacles.centre[None, :, :2], axis=2)
    for i, j in np.argwhere(np.triu(away < obstacles.radius[:, None] + obstacles.radius, 1)).tolist():
        if _are_near((shrunk, obstacles.rows(i)), (shrunk, obstacles.rows(j)), 0.0):
            found.append((names[i], names[j]))
    return found
