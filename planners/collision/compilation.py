"""How kernels that allocate nothing are compiled."""

from __future__ import annotations

from irm.compilation import njit

__all__ = ["leaf_kernel"]

leaf_kernel = njit(cache=True, _nrt=False)
"""`numba.njit` without reference counting, for kernels that neither allocate nor return arrays, and call
none that do.

Numba counts references, atomically, to every array that it takes out of a tuple. With the 50 arrays of a collision
query this took more time than the check itself: 6.1 µs with counting, 2.4 µs without, among 25 objects. Numba compiles
inner loops of its own in this way (`numba.misc.mergesort`); see https://github.com/numba/numba/issues/2350. A kernel
that allocates after all is refused when it is compiled ("NRT required but not enabled").
"""
