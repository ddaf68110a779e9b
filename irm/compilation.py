"""How kernels are compiled: numba's `njit`, which also works where compiled kernels cannot be kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba

__all__ = ["njit"]

_LOG = logging.getLogger(__name__)
_NO_PLACE = "no locator available"
"""Part of numba's message when neither the package's folder nor the user's cache directory can be written."""

_warned: set[str] = set()


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit`, with or without options; without `cache` where numba finds no directory for its cache.

    Such a place is a read-only installation whose user has no home directory that can be written. Kernels are then
    compiled in memory, again in every process, and one warning names the variable NUMBA_CACHE_DIR.

    Args:
        function: to be compiled, if the decorator is used without options.
        **options: of `numba.njit`.
    """
    if function is None:
        return lambda decorated: njit(decorated, **options)
    try:
        return numba.njit(**options)(function)
    except RuntimeError as problem:
        if not options.get("cache") or _NO_PLACE not in str(problem):
            raise
        _warn_once()
        return numba.njit(**{**options, "cache": False})(function)


def _warn_once() -> None:
    if not _warned:
        _warned.add(_NO_PLACE)
        _LOG.warning(
            "compiled kernels cannot be kept: neither the folder of this package nor the user's cache directory can be "
            "written. Every process compiles them again (some minutes). Set NUMBA_CACHE_DIR to a directory that can "
            "be written"
        )
