"""Refusals with a proof, confirmed by a second search that shares nothing with the bound but shapes and collisions.

    python scripts/goal_proofs.py --scenes 30 --out outputs/proofs.jsonl
    python scripts/goal_proofs.py --scenes 20 --kinds mugs corner

Small scenes are drawn that leave little or no way out, by turns of the kinds, until so many of them are refused with a
proof. What the bound concludes from graphs and packings is then tried out:

- removal: which objects can leave at all, in any order. Every grasp of "all" is scanned anew for each object that is
  left, from a ring of base poses about it in place of those of the reachability map; what is gone is in nobody's way.
- room: whether the objects fit at their ends together with what can never leave, on a fine grid of places, with
  allowance for what it misses.
- order: every sequence of moves to the end or aside, by whether the end is free, with the orders of the goal. Whether
  mugs overlap is seen by random points in one of them that are in the other.
- release: whether the gripper can hold an object at its end with nothing else there, by grasps scanned as for removal.

A refusal is confirmed if one of these finds no way. Grasps that no family has are not tried. As a control the same is
asked of the scenes for which there is a plan: none of the three may say no there.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.files import JsonLines
from clutter_env.reporting.progress import progress_bar
from irm.chain import ArmChain
from planners import Infeasible, Region, Scene, Solution, goals, lower_bound, solve, warmup
from planners.collision.world import CollisionWorld
from planners.goals import At, Goal, Holding, Inside, On
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, gripper_hits, scan_configurations
from planners.grasping.families import GRASP_SETS
from planners.grasping.grasp_poses import generate_grasps
from planners.scene import Body, StaticObstacle
from planners.scene.solid import Solid

Array = NDArray[np.float64]
FIRST_SEED = 49_200_000
BASES = tuple(itertools.product(np.arange(0.45, 1.0, 0.1), np.arange(24) * (np.pi / 12), (-0.5, 0.0, 0.5)))
"""Base poses about a gripper pose: distance [m], direction [rad], and yaw [rad] off the one that faces it."""
TORSOS, ROLLS = 8, 24
"""Arm configurations tried for each base pose; the planner tries 6 times 18."""
PITCH, TURN = 0.002, math.radians(2)
"""[m] and [rad] between the places on a grid where an object may stand."""
OUT = 0.002 + PITCH / 2
"""[m] that an object may stick out of a region: what a goal allows, and what the grid misses."""
SLACK = 0.001 + PITCH * math.sqrt(2)
"""[m] that two objects may overlap: soft contacts, and what the grid misses of both."""
USUAL = ("full cabinet", "row", "wide", "fixed", "circle", "crowded")
"""Kinds of scenes that are drawn if no others are asked for; see `KINDS`."""
WIDE_TURN, POINTS = math.radians(15), 100
"""[rad] between the yaws of a mug, and random points in each of its pieces."""
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Arguments:
    """How many refusals, and where they are noted."""

    scenes: int = 30
    seed: int = FIRST_SEED
    out: Path | None = None
    """File of JSON lines, one for each scene; scenes that it has are not tried again."""
    kinds: tuple[str, ...] = USUAL
    """Names in `KINDS`, by turns."""
    draws: int = 400
    """Scenes drawn at most."""


def main(arguments: Arguments) -> None:
    """Draw scenes until enough are refused with a proof, and print what the second search says."""
    warmup()
    file = JsonLines(arguments.out) if arguments.out else None
    rows = {row["seed"]: row for row in (file.values if file else [])}
    for seed in progress_bar(range(arguments.seed, arguments.seed + arguments.draws)):
        if sum(row["proved"] for row in rows.values()) >= arguments.scenes:
            break
        if seed not in rows:
            rows[seed] = measure(seed, arguments.kinds)
            if file:
                file.append(rows[seed])
    report([*rows.values()])


def measure(seed: int, kinds: Sequence[str] = USUAL) -> dict[str, Any]:
    """One line: whether the scene is refused with a proof, or planned, and which search finds no way."""
    kind, scene, goal = drawn(seed, kinds)
    bound, found, no_way = lower_bound(scene, goal), solve(scene, goal), find_no_way(scene, goal)
    row = {"seed": seed, "kind": kind, "count": len(scene.objects), "goal": str(goal), "no_way": no_way}
    row |= {"proved": bound.picks is None and bound.proved, "planned": isinstance(found, Solution)}
    return row | ({"cause": found.cause, "detail": found.detail} if isinstance(found, Infeasible) else {})


def report(rows: Sequence[dict[str, Any]]) -> None:
    """Print a row for each kind of scene, and each proof that is not confirmed."""
    columns = "scenes", "drawn", "planned", "of these no way", "refused, proved", "of these no way", "by", "causes"
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for kind in (*dict.fromkeys(row["kind"] for row in rows), "all"):
        some = [row for row in rows if kind in (row["kind"], "all")]
        proved, planned = ([row for row in some if row[state]] for state in ("proved", "planned"))
        by, causes = Counter(row["no_way"] or "nothing" for row in proved), Counter(row["cause"] for row in proved)
        counts = len(some), len(planned), *(sum(bool(row["no_way"]) for row in found) for found in (planned, proved))
        cells = *counts[:3], len(proved), counts[3], _words(by), _words(causes)
        print(f"| {kind} | {' | '.join(map(str, cells))} |")
    for row in rows:
        name = f"{row['seed']} {row['kind']} {row['count']}"
        if row["proved"] and not row["no_way"]:
            print(f"  not confirmed: {name}: {row['cause']}: {row['detail']}")
        elif row["planned"] and (row["no_way"] or row["proved"]):
            print(f"  planned, but no way by {row['no_way'] or 'the bound'}: {name}: {row['goal']}")


def _words(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


# The second search.


def find_no_way(scene: Scene, goal: Goal) -> str:
    """Which search finds no way: "removal", "room", "order" or "release"; "" if none of them does."""
    wanted = {fact.object for fact in goal.unmet(scene) if isinstance(fact, Holding | On | Inside | At)}
    leave = removable(scene, wanted | {name for fact in goal.placed for name in _in_the_way(scene, fact)})
    if not wanted <= leave:
        return "removal"
    staying = [body for body in scene.objects if body.name not in leave]
    ends = {fact.object: ends_of(scene, fact) for fact in goal.placed if isinstance(fact, At | Inside)}
    bodies = {name: scene.body(name) for name in ends}
    free = {name: _apart_from(bodies[name], points, staying) for name, points in ends.items()}
    if not any(_arrangements([(bodies[name], free[name]) for name in sorted(free, key=lambda one: len(free[one]))])):
        return "room"
    if not _has_sequence(scene, goal, free, wanted):
        return "order"
    poses = [fact for fact in goal.placed if isinstance(fact, At)]
    return "" if all(is_releasable(scene, fact, ends[fact.object]) for fact in poses) else "release"


def is_releasable(scene: Scene, pose: At, ends: Array) -> bool:
    """Whether some grasp holds an object at some of its ends (n, 3), with nothing else on the table."""
    body = scene.body(pose.object)
    half = body.position[2] - body.bottom
    if not len(ends):
        return False
    for radius, turn in itertools.product((0.0, 0.5 * pose.tolerance, 0.95 * pose.tolerance), range(8)):
        aim = np.array((pose.x, pose.y)) + radius * np.array((math.cos(turn * np.pi / 4), math.sin(turn * np.pi / 4)))
        near = ends[np.argmin(np.hypot(*(ends[:, :2] - aim).T))]
        if radius == 0.0 and turn:
            continue
        there = body.at([near[0], near[1], scene.support.top + half])
        alone = CollisionWorld.from_scene(replace(scene, objects=(there,)))
        if _can_leave(alone, body.name, generate_grasps(there, scene.robot, GRASP_SETS["all"]), 0):
            return True
    return False


def removable(scene: Scene, wanted: Collection[str]) -> set[str]:
    """Names of the objects that can leave, in some order, until all that are wanted have left, or no other one can."""
    world, gone, poses = CollisionWorld.from_scene(scene), set[str](), {}
    for body in scene.objects:
        fits = least_width(body) < scene.robot.max_opening
        poses[body.name] = generate_grasps(body, scene.robot, GRASP_SETS["all"]) if fits else ()
    names = sorted(scene.names, key=lambda name: name not in wanted)
    while not set(wanted) <= gone:
        mask = scene.mask(gone)
        found = next((name for name in names if name not in gone and _can_leave(world, name, poses[name], mask)), None)
        if found is None:
            break
        gone.add(found)
    return gone


def _can_leave(world: CollisionWorld, name: str, grasps: Sequence[Any], gone: int) -> bool:
    """Whether some grasp of an object hits nothing but what is gone."""
    scene, body = world.scene, world.scene.body(name)
    chain, ignore = ArmChain.from_robot(scene.robot), gone | scene.mask([name])
    grid = ConfigurationGrid.over(chain, TORSOS, ROLLS)
    for opening in {grasp.opening for grasp in grasps}:
        alike = [grasp for grasp in grasps if grasp.opening == opening]
        gripper = np.array([(*one.T_world_tcp[:3, 3], one.yaw, one.pitch) for one in alike])
        gripper = gripper[gripper_hits(world, gripper, opening, ignore=ignore) == 0]
        for pose in gripper:
            bases = np.array([_base(pose, *one) for one in BASES])
            pairs = GripperPoses(bases, np.tile(pose, (len(bases), 1)))
            found = scan_configurations(world, pairs, grid, opening, body=body, ignore=ignore, first_free=True)
            if (found.hits == 0).any():
                return True
    return False


def _base(pose: Array, away: float, direction: float, turn: float) -> tuple[float, float, float]:
    """A base pose that sees the TCP of a gripper pose (5,) in a direction, and is turned from that."""
    x, y = pose[0] - away * math.cos(direction), pose[1] - away * math.sin(direction)
    return x, y, (direction + turn + np.pi) % (2 * np.pi) - np.pi


def least_width(body: Body) -> float:
    """[m] between two upright planes that a standing cylinder or box just fits between."""
    return 2 * float(body.half_extents[:2].min())


def ends_of(scene: Scene, fact: At | Inside) -> Array:
    """(n, 3) x, y [m] and yaw [rad] where an object may be at its end, whatever else stands there."""
    body = scene.body(fact.object)
    if isinstance(fact, At):
        found, level = _about(body, fact), scene.support.top
    else:
        region = next(one for one in scene.regions if one.name == fact.region)
        found, level = _within(body, region), scene.support_named(region.support).top
    height = body.top - body.bottom
    for box in scene.static_obstacles:
        if box.lower[2] < level + height - SLACK and box.upper[2] > level + SLACK:
            away = found[:, :2] - box.position[:2]
            found = found[_beyond(away @ box.rotation[:2, :2], box.half_extents) >= _inner_radius(body) - SLACK]
    return found


def _turns(body: Body) -> Array:
    if body.shape == "pieces":
        return np.arange(0.0, 2 * np.pi, WIDE_TURN)
    return np.arange(0.0, np.pi, TURN) if body.shape == "box" else np.zeros(1)


def _about(body: Body, pose: At) -> Array:
    """Places within the tolerance about a pose."""
    steps, turns = np.arange(-pose.tolerance, pose.tolerance + PITCH, PITCH), _turns(body)
    places = np.stack(np.meshgrid(steps, steps, turns), axis=-1).reshape(-1, 3)
    return places[np.hypot(*places.T[:2]) <= pose.tolerance + PITCH] + (pose.x, pose.y, 0.0)


def _within(body: Body, region: Region) -> Array:
    """Places at which an object lies in a region."""
    places, (x, y) = [np.zeros((0, 3))], body.half_extents[:2]
    for turn in _turns(body):
        c, s = abs(math.cos(turn)), abs(math.sin(turn))
        own = np.array((c * x + s * y, s * x + c * y)) if body.shape == "box" else np.array((x, x))
        room = np.array(region.half_extents) + OUT - own
        if (room >= 0).all():
            steps = [np.linspace(-one, one, max(2, math.ceil(2 * one / PITCH))) for one in room]
            local = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
            c, s = math.cos(region.yaw), math.sin(region.yaw)
            points = local @ np.array([[c, s], [-s, c]]) + region.centre
            places.append(np.column_stack((points, np.full(len(points), turn + region.yaw))))
    return np.concatenate(places)


def _inner_radius(body: Body) -> float:
    return float(body.half_extents[:2].min())


def _beyond(local: Array, half_extents: Array) -> Array:
    """(n,) [m] from points (n, 2) in the frame of a box to the box, seen from above."""
    return np.asarray(np.hypot(*np.maximum(np.abs(local) - half_extents[:2], 0.0).T))


def _apart_from(body: Body, places: Array, others: Collection[Body]) -> Array:
    """The places at which an object overlaps none of others that stand; of two boxes one counts as its inner circle."""
    for other in others:
        if other.bottom >= body.top or other.top <= body.bottom or other.name == body.name:
            continue
        if body.shape == "pieces":
            places = places[[not _have_common_point(body, place, other) for place in places]]
            continue
        away = places[:, :2] - other.position[:2]
        if other.shape == "box":
            gap = _beyond(away @ other.rotation[:2, :2], other.half_extents) - _inner_radius(body)
        elif body.shape == "box":
            c, s = np.cos(places[:, 2]), np.sin(places[:, 2])
            local = np.column_stack((c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]))
            gap = _beyond(local, body.half_extents) - _inner_radius(other)
        else:
            gap = np.hypot(*away.T) - _inner_radius(body) - _inner_radius(other)
        places = places[gap >= -SLACK]
    return places


def _have_common_point(body: Body, place: Array, other: Body) -> bool:
    """Whether some random point in an object at a place (3,) is deep in another one where that stands."""
    if math.dist(place[:2], other.position[:2]) > body.radius + other.radius:
        return False
    c, s = math.cos(place[2] - body.yaw), math.sin(place[2] - body.yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    for local in _points_in(body):
        points = (local - (*body.position[:2], 0.0)) @ turn + (*place[:2], 0.0)
        for normals, away in _planes_of(other):
            if (points @ normals.T < away).all(axis=1).any():
                return True
    return False


@lru_cache
def _points_in(body: Body) -> list[Array]:
    """Random points (n, 3) in each piece of an object where it stands."""
    rng, found = np.random.default_rng(0), list[Array]()
    for piece in body.placed:
        normals, away = piece.planes
        points = rng.uniform(piece.lower, piece.upper, (POINTS, 3))
        found.append(points[(points @ normals.T <= away).all(axis=1)])
    return found


@lru_cache
def _planes_of(body: Body) -> list[tuple[Array, Array]]:
    """Planes (k, 3), (k,) about each piece of an object, moved inwards along the table by what a grid misses."""
    planes = [piece.planes for piece in body.placed]
    return [(normals, away - SLACK * np.hypot(*normals.T[:2])) for normals, away in planes]


def _arrangements(ends: Sequence[tuple[Body, Array]]) -> Iterator[bool]:
    """True for each way to put all objects at their ends at once."""
    if not ends:
        yield True
        return
    (body, places), *rest = ends
    for x, y, yaw in places:
        there = body.at([x, y, body.position[2]], (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))
        later = [(other, _apart_from(other, free, [there])) for other, free in rest]
        if all(len(free) for _, free in later):
            yield from _arrangements(later)


def _in_the_way(scene: Scene, fact: Any) -> list[str]:
    """Names of the objects that stand at the end of another one, at some of its points."""
    if not isinstance(fact, At | Inside):
        return []
    body, points = scene.body(fact.object), ends_of(scene, fact)
    others = [one for one in scene.objects if one.name != body.name]
    return [one.name for one in others if len(_apart_from(body, points, [one])) < len(points)]


def _has_sequence(scene: Scene, goal: Goal, ends: dict[str, Array], wanted: Collection[str]) -> bool:
    """Whether some sequence of moves, each to an end or aside, brings all to their ends in the order of the goal."""
    names, bodies = sorted({*ends, *wanted}), {body.name: body for body in scene.objects}
    first = {(a, b) for a, b in goal.order if a in names and b in names}
    at_start = tuple("start" for _ in names)
    seen, open_states = {at_start}, [at_start]
    for state in open_states:
        where = dict(zip(names, state, strict=True))
        if all(where[name] == "end" for name in names if name in ends):
            return True
        for name, to in itertools.product(names, ("aside", "end")):
            # The last move of one object comes before the first one of another: after that it may not move again.
            is_too_late = any(a == name and where[b] != "start" for a, b in first)
            if where[name] == "end" or is_too_late or (to == "end" and name not in ends):
                continue
            standing = [bodies[one] for one in names if one != name and where[one] == "start"]
            if to == "end" and not len(_apart_from(bodies[name], ends[name], standing)):
                continue
            after = tuple(to if one == name else where[one] for one in names)
            if after not in seen:
                seen.add(after)
                open_states.append(after)
    return False


# Scenes: functions of the seed alone.


def drawn(seed: int, kinds: Sequence[str] = USUAL) -> tuple[str, Scene, Goal]:
    """Kind, scene and goal of a seed."""
    rng, kind = np.random.default_rng(seed), kinds[(seed - FIRST_SEED) % len(kinds)]
    return kind, *KINDS[kind](rng)


def _furniture(layout: str, objects: int = 1, seed: int = 0) -> Scene:
    env = RetrieveEnv(num_objects=objects, layout=layout)
    env.reset(seed=seed)
    scene = Scene.from_mujoco(env.model, env.data, env.robot)
    env.close()
    return scene


def _cylinder(scene: Scene, number: int, x: float, y: float, radius: float, height: float = 0.16) -> Body:
    half = np.array([radius, radius, height / 2])
    return Body(f"object_{number:02d}", "cylinder", half, np.array([x, y, scene.support.top + height / 2]), _UPRIGHT)


def _box(scene: Scene, number: int, x: float, y: float, half_x: float, half_y: float, height: float = 0.16) -> Body:
    half = np.array([half_x, half_y, height / 2])
    return Body(f"object_{number:02d}", "box", half, np.array([x, y, scene.support.top + height / 2]), _UPRIGHT)


def _full_cabinet(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """A cabinet as full as it gets, and one of its objects."""
    scene = _furniture("cabinet", 20, int(rng.integers(2**31)))
    return scene, goals.holding(str(rng.choice(scene.names)))


def _row(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """A row of objects across a cabinet, with no room for fingers between them, and one behind it."""
    scene, gap = _furniture("cabinet"), rng.uniform(0.004, 0.012)
    half, depth, bodies = rng.uniform(0.03, 0.036), rng.uniform(0.03, 0.05), list[Body]()
    face = scene.support
    y = -face.extent[1] + gap + half
    while y < face.extent[1] - half:
        bodies.append(_box(scene, len(bodies), -0.08, y, depth, half, rng.uniform(0.14, 0.2)))
        y += 2 * half + gap
    behind = _cylinder(scene, len(bodies), rng.uniform(0.05, 0.15), rng.uniform(-0.25, 0.25), 0.03)
    return replace(scene, objects=(*bodies, behind)), goals.holding(behind.name)


def _wide(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """An object that is to go where one stands that is too wide for the gripper, or that one itself."""
    scene, x, y = _furniture("paper"), rng.uniform(-0.2, 0.1), rng.uniform(-0.3, 0.3)
    wide = _cylinder(scene, 0, x, y, rng.uniform(0.052, 0.08))
    if rng.random() < 0.5:
        wide = _box(scene, 0, x, y, rng.uniform(0.052, 0.08), rng.uniform(0.052, 0.08))
    small = _cylinder(scene, 1, x - 0.2, y, 0.03)
    scene = replace(scene, objects=(wide, small))
    if rng.random() < 0.5:
        return scene, goals.holding(wide.name)
    region = Region("place", scene.support.name, (x, y), (0.05, 0.05))
    return replace(scene, regions=(region,)), goals.inside(small.name, "place")


def _fixed(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """An object between fixed walls, or one that is to go where something is fixed."""
    scene, x, y = _furniture("paper"), rng.uniform(-0.2, 0.1), rng.uniform(-0.3, 0.3)
    body, gap, half, top = _cylinder(scene, 0, x, y, rng.uniform(0.026, 0.034)), rng.uniform(0.004, 0.012), 0.01, 0.1
    if rng.random() < 0.3:
        pole = StaticObstacle("pole", np.array([x, y, scene.support.top + top]), np.array([0.02, 0.02, top]))
        body = _cylinder(scene, 0, x - 0.15, y, 0.03)
        scene = replace(scene, objects=(body,), static_obstacles=(*scene.static_obstacles, pole))
        return scene, goals.at(body.name, (x + rng.uniform(-0.01, 0.01), y))
    walls, away = list[StaticObstacle](), body.radius + gap + half
    for number, (dx, dy) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        middle = np.array([x + dx * away, y + dy * away, scene.support.top + top])
        long = away + half
        extents = np.array([half if dx else long, long if dx else half, top])
        walls.append(StaticObstacle(f"wall_{number}", middle, extents))
    scene = replace(scene, objects=(body,), static_obstacles=(*scene.static_obstacles, *walls))
    return scene, goals.holding(body.name)


def _circle(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """Two or three objects that change places, each before the next one, or only some of them."""
    scene, count = _furniture("paper"), int(rng.integers(2, 4))
    bodies = [_cylinder(scene, k, -0.1, 0.2 * (k - 1), rng.uniform(0.026, 0.034)) for k in range(count)]
    after = [bodies[(k + 1) % count] for k in range(count)]
    moves = goals.and_(*(goals.at(one.name, to.position[:2]) for one, to in zip(bodies, after, strict=True)))
    first, second = rng.permutation(count)[:2]
    return replace(scene, objects=tuple(bodies)), moves & goals.before(bodies[first].name, bodies[second].name)


def _crowded(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """Two or three objects in one small region."""
    scene, count, half = _furniture("paper"), int(rng.integers(1, 4)), rng.uniform(0.03, 0.06)
    bodies = [_cylinder(scene, k, -0.2, 0.15 * (k - 1), rng.uniform(0.028, 0.036)) for k in range(count)]
    bodies[0] = _box(scene, 0, -0.2, -0.15, rng.uniform(0.025, 0.04), rng.uniform(0.025, 0.04))
    region = Region("place", scene.support.name, (0.05, 0.0), (half, half), float(rng.uniform(0, 1)))
    scene = replace(scene, objects=tuple(bodies), regions=(region,))
    return scene, goals.and_(*(goals.inside(body.name, "place") for body in bodies))


def _mug(scene: Scene, number: int, x: float, y: float, radius: float, yaw: float) -> Body:
    """A bottom, a wall of eight boxes and a handle, which puts its centre beside that of the bottom."""
    high, top = 0.05, scene.support.top
    pieces = [Solid("bottom", np.array([0.0, 0.0, 0.004]), np.array([radius, radius, 0.004]), "cylinder")]
    for k, turn in enumerate(np.arange(8) * np.pi / 4):
        c, s = math.cos(turn), math.sin(turn)
        R = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
        middle, half = np.array([radius * c, radius * s, high]), np.array([0.003, 0.4 * radius, high])
        pieces.append(Solid(f"wall {k}", middle, half, "box", R))
    pieces.append(Solid("handle", np.array([radius + 0.015, 0.0, high]), np.array([0.015, 0.006, 0.03])))
    turned = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return Body.of_pieces(f"object_{number:02d}", pieces, (x, y, top), turned)


def _mugs(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """Two or three mugs that change places, or nearly, some of them before others."""
    scene, count = _furniture("paper"), int(rng.integers(2, 4))
    bodies = [
        _mug(scene, k, -0.1, 0.2 * (k - 1), rng.uniform(0.03, 0.036), rng.uniform(-np.pi, np.pi)) for k in range(count)
    ]
    after = [bodies[(k + 1) % count].position[:2] + rng.uniform(-0.04, 0.04, 2) for k in range(count)]
    moves = goals.and_(*(goals.at(one.name, to) for one, to in zip(bodies, after, strict=True)))
    first, second = rng.permutation(count)[:2]
    return replace(scene, objects=tuple(bodies)), moves & goals.before(bodies[first].name, bodies[second].name)


def _corner(rng: np.random.Generator) -> tuple[Scene, Goal]:
    """An object that is to go into a corner, or beside a wall, of a cabinet."""
    scene, radius = _furniture("cabinet"), rng.uniform(0.025, 0.035)
    body = _cylinder(scene, 0, -0.15, rng.uniform(-0.2, 0.2), radius, rng.uniform(0.05, 0.2))
    far, side = scene.support.extent[:2] - radius - rng.uniform(0.002, 0.03, 2)
    x = far if rng.random() < 0.7 else rng.uniform(0.0, far)
    return replace(scene, objects=(body,)), goals.at(body.name, (x, side * rng.choice((-1.0, 1.0))), 0.005)


KINDS: dict[str, Callable[[np.random.Generator], tuple[Scene, Goal]]] = {
    "full cabinet": _full_cabinet,
    "row": _row,
    "wide": _wide,
    "fixed": _fixed,
    "circle": _circle,
    "crowded": _crowded,
    "mugs": _mugs,
    "corner": _corner,
}
"""Scenes that leave little or no way out."""


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
