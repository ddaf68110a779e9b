"""Drawers and doors that stop short of their ends. A second stop at the same place is taken as the end."""

from __future__ import annotations

from dataclasses import replace

from planners.scene import Opening, Scene

_SAME_STOP = 0.05
"""Share of the range within which two stops are at the same place."""


class Stops:
    """Stops of drawers and doors in an episode."""

    def __init__(self) -> None:
        self._stopped: dict[str, float] = {}
        self._ends: dict[str, float] = {}

    def note(self, opening: Opening) -> None:
        """Note where a part stopped that was not moved as far as planned. A second stop at this place becomes its end.

        Only a part that has moved gets an end: otherwise the handle may have slipped.
        """
        before, near = self._stopped.get(opening.name), _SAME_STOP * abs(opening.open - opening.shut)
        if before is not None and abs(opening.position - before) < near and opening.share > _SAME_STOP:
            self._ends[opening.name] = opening.position
        self._stopped[opening.name] = opening.position

    def applied(self, scene: Scene) -> Scene:
        """The scene with the known ends, or the same scene without any."""
        if not self._ends:
            return scene
        openings = (replace(one, open=self._ends.get(one.name, one.open)) for one in scene.openings)
        return replace(scene, openings=tuple(openings))
