"""Forces of the robot on furniture, on itself and on the ground, and whether a robot may press so hard.

Three limits, all from a light table of 10 kg that 50 N slide on a smooth floor (friction 0.5):

- force: the mean over any 0.1 s is at most 50 N. More would push the table away.
- impulse: that of the part of the force which friction does not hold is at most 1 N s, the largest over all intervals
  of time. It is the momentum of the table. Friction brakes the table as soon as the force is below 50 N.
- slide: the distance that the table moves, over all contacts of the episode on furniture and the robot, is at most 5
mm.
  An object on the table has then been moved by one chord, the least motion that is regarded as a disturbance. See
  `envs.success.CHORD`. Many gentle blows add up.

After a short blow with the impulse J the table has the speed J / m and stops after J² / (2 m · 50 N): 1 mm for 1 N s,
so five of the hardest blows make 5 mm. While a longer contact lasts, the table slides too.

A fingertip that touches a board and is withdrawn stays below all of them. ISO/TS 15066 treats contact with people
alike: it permits twice the pressure in the first moments of a contact.

A robot also presses with what it holds or pushes. The force of such objects on furniture counts beyond their weight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from clutter_env.config import TIMESTEP

SUSTAINED_FORCE = 50.0
"""[N] Largest mean force over `FORCE_WINDOW`, and the friction of the table."""
FORCE_WINDOW = 0.1
"""[s]"""
_TABLE_MASS = 10.0
"""[kg]"""
_SHORT_SLIDE = 1e-3
"""[m] by which a single short blow may move the table."""
TRANSIENT_IMPULSE = (2 * _TABLE_MASS * SUSTAINED_FORCE * _SHORT_SLIDE) ** 0.5
"""[N s] Largest impulse beyond `SUSTAINED_FORCE` in one contact: 1 N s."""
TOTAL_SLIDE = 5e-3
"""[m] by which all contacts of an episode together may move the table."""
_WINDOW_STEPS = round(FORCE_WINDOW / TIMESTEP)


class Pressing:
    """Force in one kind of contact over an episode. `add` takes the force of every physics step.

    Attributes:
        force: [N] largest mean over `FORCE_WINDOW` so far.
        impulse: [N s] largest impulse beyond `SUSTAINED_FORCE` so far.
        slide: [m] distance that the table has moved so far.
    """

    def __init__(self) -> None:
        self.force = self.impulse = self.slide = 0.0
        self._momentum = 0.0
        self._recent: deque[float] = deque(maxlen=_WINDOW_STEPS)
        self._steps_raised = self._steps_free = 0

    @property
    def is_pressed(self) -> bool:
        """Whether the table moves, or any force was applied within the last `FORCE_WINDOW`.

        Otherwise a step without a force changes nothing.
        """
        return bool(self._recent) or self._momentum > 0.0

    def add(self, forces: Sequence[float]) -> None:
        """Process the forces [N] of further physics steps, in order."""
        if not self.is_pressed and not any(forces):
            return
        recent, largest, momentum = self._recent, self.force, self._momentum  # local for speed in every physics step
        raised, free, impulse, slide = self._steps_raised, self._steps_free, self.impulse, self.slide
        for force in forces:
            if recent or force != 0.0:
                recent.append(force)
                if force > largest:
                    raised = _WINDOW_STEPS
                if raised:  # a window whose forces are all below the largest mean cannot exceed it
                    raised -= 1
                    mean = sum(recent) / _WINDOW_STEPS
                    if mean > largest:
                        largest = mean
                free = 0 if force != 0.0 else free + 1
                if free == _WINDOW_STEPS:
                    recent.clear()
                    free = 0
            if force > SUSTAINED_FORCE or momentum > 0.0:
                before = momentum
                momentum += (force - SUSTAINED_FORCE) * TIMESTEP
                if momentum < 0.0:
                    momentum = 0.0
                if momentum > impulse:
                    impulse = momentum
                slide += (before + momentum) / 2 / _TABLE_MASS * TIMESTEP
        self.force, self.impulse, self.slide, self._momentum = largest, impulse, slide, momentum
        self._steps_raised, self._steps_free = raised, free

    def memory(self) -> list[float]:
        """The `REMEMBERED` numbers that a saved state must keep.

        Force, impulse, slide, the table's momentum [N s], forces of the window.
        """
        before = [0.0] * (_WINDOW_STEPS - len(self._recent))
        return [self.force, self.impulse, self.slide, self._momentum, *before, *self._recent]

    @staticmethod
    def is_memory(memory: Sequence[float]) -> bool:
        """Whether `REMEMBERED` numbers agree: no largest value may be less than the present value."""
        force, impulse, slide, momentum, *recent = memory
        return force >= sum(recent) / _WINDOW_STEPS and impulse >= momentum and (impulse > 0.0) == (slide > 0.0)

    @classmethod
    def recall(cls, memory: Sequence[float]) -> Pressing:
        """Restore a `Pressing` from its `memory`."""
        pressing = cls()
        force, impulse, slide, momentum, *recent = memory
        if any(recent):
            pressing._recent.extend(recent)
            pressing._steps_raised = _WINDOW_STEPS
            pressing._steps_free = next(steps for steps, each in enumerate(reversed(recent)) if each != 0.0)
        pressing.force, pressing.impulse, pressing.slide, pressing._momentum = force, impulse, slide, momentum
        return pressing


def total_slide(*pressings: Pressing) -> float:
    """Sum [m] of the slides in several kinds of contact."""
    return sum(pressing.slide for pressing in pressings)


def is_gentle(*pressings: Pressing) -> bool:
    """Whether these kinds of contact, which share `TOTAL_SLIDE`, have kept all limits."""
    is_each = all(each.force <= SUSTAINED_FORCE and each.impulse <= TRANSIENT_IMPULSE for each in pressings)
    return is_each and total_slide(*pressings) <= TOTAL_SLIDE


REMEMBERED = 4 + _WINDOW_STEPS
"""Length of the `memory` of `Pressing`. No entry is negative."""
