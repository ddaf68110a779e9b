"""How kernels that allocate nothing are compiled."""

from __future__ import annotations

from irm.compilation import njit

leaf_kernel = njit(cache=True, _nrt=False)
"""`numba.njit` without reference counting, for kernels that neither allocate nor return arrays and call none that do.

Numba counts references, atomically, to every array taken out of a tuple. For the 50 arrays of a collision query
this takes longer than the check itself. Numba compiles inner loops of its own in this way (`numba.misc.mergesort`); see
https://github.com/numba/numba/issues/2350. A kernel that allocates after all is refused when it is compiled ("NRT
required but not enabled").
"""
inlined_kernel = njit(cache=True, _nrt=False, forceinline=True)
"""A `leaf_kernel` that is compiled into its callers, for a few lines in an inner loop; it multiplies code."""
