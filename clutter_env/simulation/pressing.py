"""Forces of the robot on furniture, on itself and on the ground, and whether a robot may press so hard.

Two limits, both from a light table of 10 kg that 50 N slide on a smooth floor (friction 0.5):

- sustained: the mean force over any 0.1 s is at most 50 N. More would push the table away.
- transient: the impulse beyond 50 N is at most 1 N s. After an impulse J the table of mass m has the speed J / m. Let
  go of, the floor's friction F stops it after J² / (2 m F). This is one millimetre for J = 1 N s. The impulse is that
  of the part of the force which friction does not hold, the largest over all intervals of time. Blows do not add up.

A fingertip that touches a board and is withdrawn stays below both. ISO/TS 15066 treats contact with people alike: it
permits twice the pressure in the first moments of a contact.

A robot also presses with what it holds or pushes. The force of such objects on furniture counts beyond their weight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from clutter_env.config import TIMESTEP

SUSTAINED_FORCE = 50.0
"""[N] Largest mean force over `FORCE_WINDOW`."""
FORCE_WINDOW = 0.1
"""[s]"""
_TABLE_MASS, _TABLE_SLIDE = 10.0, 1e-3
"""[kg] of the light table, [m] by which a transient contact may move it."""
TRANSIENT_IMPULSE = (2 * _TABLE_MASS * SUSTAINED_FORCE * _TABLE_SLIDE) ** 0.5
"""[N s] Largest impulse beyond `SUSTAINED_FORCE`: 1 N s."""
_WINDOW_STEPS = round(FORCE_WINDOW / TIMESTEP)


class Pressing:
    """Force in one kind of contact over an episode; call `add` after every physics step.

    Attributes:
        force: [N] largest mean over `FORCE_WINDOW` so far.
        impulse: [N s] largest impulse beyond `SUSTAINED_FORCE` so far.
    """

    def __init__(self) -> None:
        self.force = self.impulse = 0.0
        self._momentum = 0.0
        self._recent: deque[float] = deque(maxlen=_WINDOW_STEPS)

    @property
    def is_gentle(self) -> bool:
        """Whether both limits have been kept."""
        return self.force <= SUSTAINED_FORCE and self.impulse <= TRANSIENT_IMPULSE

    @property
    def is_pressed(self) -> bool:
        """Whether there has been a force within the last `FORCE_WINDOW`; if not, a step without one changes nothing."""
        return bool(self._recent)

    def add(self, force: float) -> None:
        """Take the force [N] of one more physics step into account."""
        recent = self._recent
        if force == 0.0 and not recent:
            return
        recent.append(force)
        mean = sum(recent) / _WINDOW_STEPS
        self.force = max(self.force, mean)
        self._momentum = max(self._momentum + (force - SUSTAINED_FORCE) * TIMESTEP, 0.0)
        self.impulse = max(self.impulse, self._momentum)
        if mean == 0.0:
            recent.clear()

    def memory(self) -> list[float]:
        """The `REMEMBERED` numbers that a saved state must keep: force, impulse, open impulse, forces of the window."""
        before = [0.0] * (_WINDOW_STEPS - len(self._recent))
        return [self.force, self.impulse, self._momentum, *before, *self._recent]

    @staticmethod
    def is_memory(memory: Sequence[float]) -> bool:
        """Whether `REMEMBERED` numbers agree: the largest values are those of the present at least."""
        force, impulse, momentum, *recent = memory
        return force >= sum(recent) / _WINDOW_STEPS and impulse >= momentum

    @classmethod
    def recall(cls, memory: Sequence[float]) -> Pressing:
        """The one that had this `memory`."""
        pressing = cls()
        pressing.force, pressing.impulse, pressing._momentum, *recent = memory
        if any(recent):
            pressing._recent.extend(recent)
        return pressing


REMEMBERED = 3 + _WINDOW_STEPS
"""Numbers in the `memory` of `Pressing`; none is negative."""
