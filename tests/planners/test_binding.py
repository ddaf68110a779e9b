"""What the motion layer remembers of grasps that motions did not lead to."""

from __future__ import annotations

import numpy as np

from planners.binding import Binder
from planners.grasp_options import GraspCatalogue
from planners.placements import PlacementSearch
from planners.solve import map_placer
from tests.planners.motion_scenes import CHAIN
from tests.planners.scenes import random_scene


def test_an_object_never_counts_as_in_the_way_of_its_own_grasp() -> None:
    scene = random_scene(6, 0)
    placer = map_placer(scene)
    binder = Binder(GraspCatalogue(placer, CHAIN), PlacementSearch(placer, CHAIN), np.random.default_rng(0))
    name, other = "object_00", "object_01"
    first, second = binder.catalogue.options(scene, name)[:2]

    binder.obstruct(scene, first, frozenset({name, other}))
    changed = next(option for option in binder.catalogue.options(scene, name) if option.key == first.key)
    assert changed.blockers == first.blockers | scene.mask([other])

    binder.obstruct(scene, second, frozenset({name}))
    assert second.key not in {option.key for option in binder.catalogue.options(scene, name)}
    assert binder.has_banned
