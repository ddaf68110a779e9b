"""The blockers that the page names are confirmed by MuJoCo, and a wrong one is not."""

from __future__ import annotations

import dataclasses

from planners.drawing.why import RefusedBy, why_grasps
from planners.grasping.families import find_grasp_set
from scripts.why_checked import PARTS, Tally, check, check_places
from tests.planners.plans import solved
from tests.planners.scenes import random_scene


def test_every_blocker_of_a_scene_is_confirmed() -> None:
    scene = random_scene(15, 1)
    tallies = {part: Tally() for part in PARTS}
    check(scene, why_grasps(scene, find_grasp_set("side")), tallies)
    assert tallies["hand"].named > 50
    assert tallies["arm"].named > 20
    assert all(tally.refuted == 0 for tally in tallies.values()), tallies


def test_a_wrong_name_is_found() -> None:
    scene = random_scene(15, 1)
    answers = why_grasps(scene, find_grasp_set("side"))
    free = next(one for answer in answers for one in answer.grasps if one.grasp is not None and not one.blockers)
    owner = next(answer for answer in answers if free in answer.grasps)
    other = next(name for name in scene.names if name != owner.name)
    wrong = dataclasses.replace(free, blockers=(RefusedBy(other, "hand"),))
    tallies = {part: Tally() for part in PARTS}
    check(scene, [dataclasses.replace(owner, grasps=(wrong,))], tallies)
    assert tallies["hand"].refuted == 1


def test_what_stands_at_a_refused_place_is_confirmed() -> None:
    tally = Tally()
    check_places(solved(), tally)
    assert tally.named > 10
    assert tally.refuted == 0, tally
