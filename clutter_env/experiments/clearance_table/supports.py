"""Where a table's plans may put objects: names of its layout's supports, "table" or "all"."""

from __future__ import annotations

from clutter_env.errors import ConfigError
from clutter_env.scene.layout import TABLE, find_layout, supports_of
from planners.placing.surfaces import Supports

__all__ = ["chosen_supports"]


def chosen_supports(layout: str, words: tuple[str, ...]) -> Supports:
    """What the words of `--supports` stand for in `solve`; none of them leave the choice to the grasp set.

    Args:
        layout: name of the layout.
        words: "all", "table" for the table top alone, or names of the layout's supports.

    Raises:
        ConfigError: the layout has no such support; the message lists those that it has. Or no such layout.
    """
    if not words:
        return None
    if words == ("all",):
        return "all"
    declared = supports_of(find_layout(layout))
    names = tuple(TABLE if word == "table" else word for word in words)
    if unknown := [name for name in names if name not in declared]:
        raise ConfigError(
            f"supports={' '.join(unknown)} is not valid in layout {layout!r}; "
            f"valid ones: all (alone), table, {', '.join(declared)}"
        )
    return names
