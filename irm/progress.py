"""Progress of long work, shown by a function that the caller passes: this package writes nothing to a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from irm.errors import ReachabilityError

__all__ = ["ProgressBar", "watched"]

ProgressBar = Callable[..., Iterable[Any]]
"""Called with items, `desc=` (what is being done) and `total=`; yields the same items. For example `tqdm.tqdm`."""


def watched(items: Iterable[Any], name: str, total: int, progress: ProgressBar | None) -> Iterable[Any]:
    """The items, shown by `progress` if there is one.

    Raises:
        ReachabilityError: `progress` is neither None nor a function.
    """
    if progress is None:
        return items
    if not callable(progress):
        raise ReachabilityError(f"progress={progress!r} must be None or a function that shows progress: tqdm.tqdm")
    return progress(items, desc=name, total=total)
