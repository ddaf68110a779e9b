"""Object masks: sets of objects as 64-bit words, object i of a scene as bit i."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

STATIC_BIT = 63
"""Bit of a hit mask for static obstacles and the ground."""
SELF_BIT = 62
"""Bit of a hit mask for the robot itself."""
FIXED_BITS = 1 << STATIC_BIT | 1 << SELF_BIT
"""Collisions that clearing cannot remove."""
MAX_OBJECTS = 60
"""Most objects in a scene: one bit each in a 64-bit word, in addition to the two bits above."""

Mask: TypeAlias = int | np.int64
"""Set of objects, a Python int outside compiled code."""
