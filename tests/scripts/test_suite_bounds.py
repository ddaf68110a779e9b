"""The bounds of the suites' files, beside those of today."""

from __future__ import annotations

import clutter_env
from scripts.suite_bounds import bound_of, table


def test_a_scene_whose_target_needs_no_clearance_from_another_base_pose() -> None:
    """The suite's file says three: none of the three base poses looked at then had a free way."""
    (scene,) = (one for one in clutter_env.suite("deep-15-v2").test if one.seed == 2070037)
    row = bound_of(scene, "side")
    assert (row["file"], row["today"], row["moved"], row["proved"]) == (3, 0, 0, True)
    *_, line = table([row])
    assert line == "| `deep-15-v2` | side | 1 | 3 | 0 | 1 | 0 | 0 | 1 |"
