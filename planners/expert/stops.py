"""Drawers and doors that stop short of their ends. A second stop at the same place is taken as the end."""

from __future__ import annotations

from dataclasses import replace

from planners.facts import Closed
from planners.goals import Goal
from planners.scene import Opening, Scene

_SAME_STOP = 0.05
"""Share of the range within which two stops are at the same place."""


class Stops:
    """Stops of drawers and doors in an episode."""

    def __init__(self) -> None:
        self._stopped: dict[str, float] = {}
        self._ends: dict[str, float] = {}

    def note(self, opening: Opening, position: float) -> None:
        """Note where [m], [rad] a part stopped that was not moved as far as planned. A second stop there is its end.

        Only a part that has moved gets an end: otherwise the handle may have slipped.
        """
        near = _SAME_STOP * abs(opening.open - opening.shut)
        before, has_moved = self._stopped.get(opening.name), abs(position - opening.shut) > near
        if before is not None and abs(position - before) < near and has_moved:
            self._ends[opening.name] = position
        self._stopped[opening.name] = position

    def applied(self, scene: Scene) -> Scene:
        """The scene with the known ends, or the same scene without any."""
        if not self._ends:
            return scene
        openings = (replace(one, open=self._ends.get(one.name, one.open)) for one in scene.openings)
        return replace(scene, openings=tuple(openings))

    def short_of(self, goal: Goal, scene: Scene) -> str:
        """Message about a part that stops short of where a goal wants it in a scene, "" for none.

        The scene is as measured, without the ends.
        """
        for fact in goal.openings:
            end = self._ends.get(fact.opening)
            if end is None or isinstance(fact, Closed) or fact.holds(scene):
                continue
            opening = scene.opening(fact.opening)
            if abs(fact.position_in(scene) - opening.shut) > abs(end - opening.shut):
                unit = "m" if opening.kind == "slide" else "rad"
                return f"{opening.name!r} stopped twice at {abs(end - opening.shut):.3g} {unit}, short of the goal"
        return ""
