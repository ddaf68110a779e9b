"""Object masks: sets of objects as 64-bit words, object i of a scene as bit i."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

STATIC_BIT = 63
"""Bit of a hit mask for static obstacles and the ground."""
SELF_BIT = 62
"""Bit of a hit mask for the robot itself."""
FIXED_BITS = 1 << STATIC_BIT | 1 << SELF_BIT
"""Hits that no clearing can remove."""
MAX_OBJECTS = 60
"""Objects in one scene at most: one bit each in a 64-bit word, besides the two bits above."""

Mask: TypeAlias = int | np.int64
"""A set of objects; a Python int outside compiled code."""
