"""What opens and has stopped short of its end: after it has stopped in the same place twice, that is its end."""

from __future__ import annotations

from dataclasses import replace

from planners.scene import Opening, Scene

_SAME_STOP = 0.05
"""Share of its range within which something that opens has stopped in the same place."""


class Stops:
    """Where what opens has stopped in an episode."""

    def __init__(self) -> None:
        self._stopped: dict[str, float] = {}
        self._ends: dict[str, float] = {}

    def note(self, opening: Opening) -> None:
        """Note that something was not moved as far as planned, and where it is; if for the second time, it ends there.

        What has not been moved at all does not end: its handle may have slipped.
        """
        before, near = self._stopped.get(opening.name), _SAME_STOP * abs(opening.open - opening.shut)
        if before is not None and abs(opening.position - before) < near and opening.share > _SAME_STOP:
            self._ends[opening.name] = opening.position
        self._stopped[opening.name] = opening.position

    def applied(self, scene: Scene) -> Scene:
        """The scene with the ends that are known; the same one if there are none."""
        if not self._ends:
            return scene
        openings = (replace(one, open=self._ends.get(one.name, one.open)) for one in scene.openings)
        return replace(scene, openings=tuple(openings))
