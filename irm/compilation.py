"""How kernels are compiled: numba's `njit`, which also works where compiled kernels cannot be kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba

__all__ = ["WITHOUT_REFERENCE_COUNTS", "njit"]

_LOG = logging.getLogger(__name__)
_NO_PLACE = "no locator available"
"""Part of numba's message when neither the package's folder nor the user's cache directory can be written."""

WITHOUT_REFERENCE_COUNTS: dict[str, Any] = {"_nrt": False}
"""Options of `njit` for a kernel that allocates nothing: numba then does not count references to the arrays inside its
arguments, which takes half of the time of a short kernel."""

_warned: set[str] = set()
"""The reason of the warning, once it has been given."""


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit`, with or without options; with `cache` also where the compiled kernel cannot be kept.

    Such a place is a read-only installation whose user has no home directory that can be written, or a full disk.
    Kernels are then compiled in memory, again in every process, and one warning names the variable NUMBA_CACHE_DIR.

    Args:
        function: to be compiled, if the decorator is used without options.
        **options: of `numba.njit`.
    """
    if function is None:
        return lambda decorated: njit(decorated, **options)
    try:
        kernel = numba.njit(**options)(function)
    except RuntimeError as problem:
        if not options.get("cache") or _NO_PLACE not in str(problem):
            raise
        _warn_once("neither the folder of this package nor the user's cache directory can be written")
        return numba.njit(**{**options, "cache": False})(function)
    if options.get("cache"):
        kernel._cache.save_overload = _saves_or_warns(kernel._cache.save_overload)
    return kernel


def _saves_or_warns(save: Callable[..., None]) -> Callable[..., None]:
    """The method of numba's cache that stores a compiled kernel, with a warning in place of an OSError."""

    def save_or_warn(*arguments: Any) -> None:
        """Store a compiled kernel if the disk has room for it."""
        try:
            save(*arguments)
        except OSError as problem:
            _warn_once(str(problem))

    return save_or_warn


def _warn_once(reason: str) -> None:
    if not _warned:
        _warned.add(reason)
        _LOG.warning(
            "compiled kernels cannot be kept: %s. Every process compiles them again (some minutes). Set "
            "NUMBA_CACHE_DIR to a directory that can be written",
            reason,
        )
