"""Compilation of kernels: a `numba.njit` that also works without a writable cache, and that compiles a cached kernel
again when a kernel that it calls has changed."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numba
from numba.core import config
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock

_LOG = logging.getLogger(__name__)
_NO_PLACE = "no locator available"
"""Part of numba's message when neither the package's folder nor the user's cache directory can be written."""

WITHOUT_REFERENCE_COUNTS: dict[str, Any] = {"_nrt": False}
"""Options of `njit` for a kernel without allocation. Numba then skips counting the references to arrays inside its
arguments, which takes half of the time of a short kernel."""

_OPTIMISATION = 1
"""LLVM's optimisation level, 0 to 3. Numba's default, 3, takes a third longer to compile. Its kernels are not faster
and compute the same bits."""


_NEW_OBJECTS = 50_000
"""New objects between two garbage collections while a kernel is compiled. Numba makes millions of objects, and
reference counting frees nearly all of them. With Python's default of 700 (or 2,000), collection takes a tenth of the
time."""


class _Compiler(Compiler):  # type: ignore[misc]  # numba has no type hints
    """Numba's compiler at optimisation level `_OPTIMISATION`."""

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        """Compile a function, then restore the global settings of numba and Python."""
        with global_compiler_lock:
            level, (new_objects, *older) = config.OPT, gc.get_threshold()
            config.OPT = min(level, type(level)(_OPTIMISATION))
            if new_objects:  # 0 means that the user has turned collection off
                gc.set_threshold(max(new_objects, _NEW_OBJECTS), *older)
            try:
                return super().compile_extra(function)
            finally:
                config.OPT = level
                gc.set_threshold(new_objects, *older)


_OPTIONS: dict[str, Any] = {"pipeline_class": _Compiler, "no_cfunc_wrapper": True}
"""Options of all kernels. No kernel is called from C, so numba need not compile each body again for a C wrapper."""

_warned: set[str] = set()
"""Reason of the warning that was logged."""


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit`, with or without options. With `cache`, it also works where the compiled kernel cannot be kept.

    Such a place is a read-only installation whose user has no home directory that can be written, or a full disk.
    Kernels are then compiled in memory, again in every process, and one warning names the variable NUMBA_CACHE_DIR.

    Args:
        function: to be compiled, if the decorator is used without options.
        **options: of `numba.njit`.
    """
    if function is None:
        return lambda decorated: njit(decorated, **options)
    try:
        kernel = numba.njit(**_OPTIONS, **options)(function)
    except RuntimeError as problem:
        if not options.get("cache") or _NO_PLACE not in str(problem):
            raise
        _warn_once("neither the folder of this package nor the user's cache directory can be written")
        return numba.njit(**_OPTIONS, **{**options, "cache": False})(function)
    if options.get("cache"):
        _make_cache_tolerant(kernel._cache)
        kernel._cache._cache_file._version += f" {_digest_of_kernels(function.__module__.partition('.')[0])}"
    return kernel


def _make_cache_tolerant(kept: Any) -> None:
    """Make a kernel's cache warn on a full disk, and behave as empty where it cannot be read.

    A cached kernel of this package may refer to types of another package whose modules have been renamed since.
    """
    save, read = kept.save_overload, kept._cache_file._load_index

    def save_or_warn(*arguments: Any) -> None:
        try:
            save(*arguments)
        except OSError as problem:
            _warn_once(str(problem))

    def read_or_forget() -> dict[Any, str]:
        try:
            kernels: dict[Any, str] = read()
        except (ModuleNotFoundError, AttributeError):
            return {}
        return kernels

    kept.save_overload, kept._cache_file._load_index = save_or_warn, read_or_forget


@cache
def _digest_of_kernels(package: str) -> str:
    """Digest of all files with kernels in this package and in the given package, whose kernels call those of this
    package.

    Numba checks only whether the file of a kernel has changed. This digest extends numba's version in the index of its
    cache. Numba reads the version first, before entries that may name modules that no longer exist.
    """
    digest = sha256()
    for name in sorted({__package__, package} - {"__main__"}):
        spec = find_spec(name)
        folders = spec.submodule_search_locations if spec and spec.submodule_search_locations else ()
        for path in sorted(path for folder in folders for path in Path(folder).rglob("*.py")):
            source = path.read_bytes()
            if b"njit" in source:
                digest.update(path.name.encode() + b"\0" + source)
    return digest.hexdigest()


def _warn_once(reason: str) -> None:
    if not _warned:
        _warned.add(reason)
        _LOG.warning(
            "compiled kernels cannot be kept: %s. Every process compiles them again (about a minute). Set "
            "NUMBA_CACHE_DIR to a directory that can be written",
            reason,
        )
