"""What LIBERO's goals mean in a scene of ours: facts of BDDL, about objects, fixtures and regions of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clutter_env.bridges.remote import BridgeError
from planners import ControlledWorld, Goal, Region, Scene, goals
from planners.facts import YAW_TOLERANCE
from planners.hollows import hollow_of
from planners.scene import Opening, StaticObstacle

Array = NDArray[np.float64]

_SPARE = 0.01
"""[m] by which a place is aimed at more closely than LIBERO's check asks."""
_BEYOND = 0.01
"""[m] or [rad] by which something is moved farther than LIBERO's check asks."""
_TURN = 0.3
"""[rad] A knob is turned by so much more than LIBERO's check asks, or up to twice that."""
_UNDER, _ABOVE, _THIN = 0.03, 0.03, 0.01
"""[m] below the lower end of a region, and, of one that is thin, above its middle, between which the face is on which
things stand in it."""


@dataclass(frozen=True)
class Wanted:
    """A goal, and what the scene needs for it.

    Attributes:
        goal: of the planner.
        regions: that it names.
        supports: names of geoms on which things are to be put.
    """

    goal: Goal
    regions: tuple[Region, ...] = ()
    supports: tuple[str, ...] = ()


def wanted_in(start: dict[str, Any], world: ControlledWorld) -> Wanted:
    """The goal of a task of LIBERO.

    Args:
        start: what `libero_worker.py` told of it.
        world: of the task; its sites are LIBERO's.

    Raises:
        BridgeError: a fact that no goal can say here; the message says which.
    """
    scene = Scene.from_mujoco(
        world.model, world.data, world.robot, movable=world.object_names, support=world.support_name, more_supports=()
    )
    return Translation(start, world.model, world.data, scene).wanted()


class Translation:
    """Translates facts of BDDL."""

    def __init__(self, start: dict[str, Any], model: mujoco.MjModel, data: mujoco.MjData, scene: Scene) -> None:
        self._start, self._model, self._data, self._scene = start, model, data, scene
        self._supports: list[str] = []
        self._regions: dict[str, Region] = {}

    def wanted(self) -> Wanted:
        """The goal of all facts."""
        found = [self._fact(*fact) for fact in self._start["goal"]]
        return Wanted(goals.and_(*found), tuple(self._regions.values()), tuple(dict.fromkeys(self._supports)))

    def _fact(self, kind: str, *names: str) -> Goal:
        match kind.lower(), names:
            case "on", (name, place) if place in self._start["sites"]:
                return self._at_site(name, place, self._place_on(place))
            case "in", (name, place) if place in self._start["sites"]:
                return self._in_site(name, place)
            case "on", (name, place):
                return self._on_object(name, place)
            case "open", (name,):
                return self._opened(name, "default_open_ranges")
            case "close", (name,):
                return goals.and_(*(goals.closed(one.name) for one in self._openings(name)))
            case "turnon", (name,):
                return self._opened(name, "default_turnon_ranges")
            case "turnoff", (name,):
                return goals.and_(*(goals.closed(one.name) for one in self._openings(name)))
            case "up", (name,):
                body = self._scene.body(self._root(name))
                x, y, _ = body.position
                return goals.holding(body.name, (x, y, 1.0 - self._origin_of(name)[2] + body.position[2] + _SPARE))
        raise BridgeError(f"no goal is known for ({kind} {' '.join(names)})")

    # Places.

    def _root(self, name: str) -> str:
        """Name of the body of an object or fixture."""
        known = self._start["roots"]
        if name not in known:
            raise BridgeError(f"nothing is called {name!r}; there are {', '.join(known)}")
        return str(known[name])

    def _origin_of(self, name: str) -> Array:
        """(3,) [m] in the scene: LIBERO's checks are about origins of bodies."""
        return np.asarray(self._data.body(self._root(name)).xpos - (0.0, 0.0, self._scene.ground))

    def _off_middle(self, name: str) -> Array:
        """(2,) [m] from an object's origin to the middle that the planner places, seen from above."""
        return np.asarray((self._scene.body(self._root(name)).position - self._origin_of(name))[:2])

    def _on_object(self, name: str, place: str) -> Goal:
        """On another object: planned over its middle, where LIBERO wants the origins one above the other."""
        return goals.on(self._root(name), self._root(place))

    def _site(self, name: str) -> tuple[Array, Array, Array]:
        """Middle (3,) [m] in the scene, axes (3, 3) as columns and half extents (3,) [m] of a region."""
        site = self._data.site(name)
        size = self._start["sites"][name]["size"]
        return site.xpos - (0.0, 0.0, self._scene.ground), site.xmat.reshape(3, 3), np.array(size)

    def _extent(self, name: str) -> Array:
        """(3,) [m] half extents of a region along the axes of the world, as LIBERO works them out."""
        _, axes, size = self._site(name)
        return np.abs(axes @ size)

    def _at_site(self, name: str, site: str, face: StaticObstacle) -> Goal:
        """On a face, the origin over a region; several objects share the area that keeps all origins there."""
        (x, y, _), extent = self._site(site)[0], self._extent(site)
        one, away = self._root(name), self._off_middle(name)
        most = float(extent[:2].min()) - _SPARE
        room = most - float(np.hypot(*away))
        self._supports.append(face.name)
        if sum(site in fact for fact in self._start["goal"]) > 1:
            narrow = float(min(self._scene.body(one).half_extents[:2]))
            return self._in_region(one, site, face, np.full(2, max(room, _SPARE) + narrow))
        if (
            room < _SPARE < np.hypot(*away)
        ):  # as of a pan with its handle: where its origin is depends on the yaw, which it keeps
            pose = (x + away[0], y + away[1], self._scene.body(one).yaw)
            tolerance = max(most - YAW_TOLERANCE * float(np.hypot(*away)), _SPARE)
            return goals.on(one, face.name) & goals.at(one, pose, tolerance=tolerance)
        return goals.on(one, face.name) & goals.at(one, (x, y), tolerance=max(room, _SPARE))

    def _in_region(self, body: str, site: str, face: StaticObstacle, half: Array) -> Goal:
        """Within a rectangle of a face about the middle of a region of LIBERO's."""
        x, y, _ = self._site(site)[0]
        self._supports.append(face.name)
        self._regions.setdefault(site, Region(site, face.name, (float(x), float(y)), (float(half[0]), float(half[1]))))
        return goals.inside(body, site)

    def _place_on(self, site: str) -> StaticObstacle:
        """The face on which things stand in a region."""
        (x, y, z), extent = self._site(site)[0], self._extent(site)
        parent = self._start["sites"][site]["parent"]
        own = self._bodies_of(parent) if parent else None
        level = [one for one in self._scene.static_obstacles if one.has_level_top and one.is_under(np.array((x, y)))]
        if own is not None:
            level = [one for one in level if one.body in own]
        near = [one for one in level if z - extent[2] - _UNDER <= one.top <= z + _ABOVE * (extent[2] < _THIN)]
        if not near:
            raise BridgeError(f"nothing level is under the region {site!r}{self._slant(site, own)}")
        return max(near, key=lambda one: one.top)

    def _slant(self, site: str, own: set[str] | None) -> str:
        """What slants under a region, of a fixture's bodies or of all, "" if nothing does."""
        middle, extent = self._site(site)[0], self._extent(site)
        corners = middle[:2] + extent[:2] * np.array(((1, 1), (1, -1), (-1, 1), (-1, -1), (0, 0)))
        slanting = [
            one
            for one in self._scene.static_obstacles
            if one.shape == "box"
            and not one.has_level_top
            and (own is None or one.body in own)
            and one.top >= middle[2] - extent[2] - _UNDER
            and one.is_under(corners).any()
        ]
        if not slanting:
            return ""
        face = max(slanting, key=lambda one: one.top)
        angle = np.degrees(np.arccos(np.abs(face.rotation[2]).max()))
        return f": {face.name} slants by {angle:.0f} degrees, and things are put on level faces alone"

    def _in_site(self, name: str, site: str) -> Goal:
        """In a region: of a container that moves, or a drawer, in that; else on what is its floor."""
        body = self._model.body(int(self._model.site(site).bodyid[0])).name
        is_moving = body in self._scene.names or any(one.name == body for one in self._scene.openings)
        if is_moving and hollow_of(self._scene, body) is not None:
            return goals.inside(self._root(name), body)
        return self._in_region(self._root(name), site, self._place_on(site), self._extent(site)[:2])

    def _bodies_of(self, name: str) -> set[str]:
        """Names of the bodies of an object or fixture."""
        root = self._model.body(self._root(name)).id
        found = {root}
        for body in range(root + 1, self._model.nbody):
            if int(self._model.body_parentid[body]) in found:
                found.add(body)
        return {self._model.body(body).name for body in found}

    # What opens.

    def _openings(self, name: str) -> list[Opening]:
        """What moves on the joints of a region or a fixture."""
        sites = self._start["sites"]
        joints: Sequence[str] = sites[name]["joints"] if name in sites else self._start["object_joints"].get(name, ())
        bodies = [self._model.body(int(self._model.jnt_bodyid[self._model.joint(one).id])).name for one in joints]
        found = [one for one in self._scene.openings if one.name in bodies]
        if not found:
            raise BridgeError(f"{name!r} has nothing that opens")
        return found

    def _opened(self, name: str, ranges: str) -> Goal:
        """Open or turned by as much as LIBERO's check asks: one of several is enough."""
        sites = self._start["sites"]
        thing = sites[name]["parent"] if name in sites else name
        one, limits = self._openings(name)[0], self._start["ranges"][thing].get(ranges)
        if not limits:
            raise BridgeError(f"LIBERO does not say when {thing!r} is open")
        towards = np.sign(one.open - one.shut)
        least = min(limits) if ranges == "default_turnon_ranges" or towards > 0 else max(limits)
        share = (least + towards * _BEYOND - one.shut) / (one.open - one.shut)
        if ranges == "default_turnon_ranges":
            least = abs(float(share * (one.open - one.shut)))
            return goals.turned(one.name, least + _TURN, tolerance=_TURN)
        return goals.open_(one.name, share=float(np.clip(share, 0.01, 1.0)))
