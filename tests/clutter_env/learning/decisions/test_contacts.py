"""Contacts to choose from, what an observation shows, labels and value iteration."""

from __future__ import annotations

import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from assets.robots import FETCH
from clutter_env.learning.decisions.clearing import MOST, RISK, clearing_costs
from clutter_env.learning.decisions.contact_rule import LEAST_STANDOFF, ContactRule
from clutter_env.learning.decisions.examples import object_rows, scene_of
from clutter_env.learning.decisions.greedy import GreedyDecider
from clutter_env.learning.decisions.kinematic import apply_contact, as_observed, is_contact_free, simulate_decisions
from clutter_env.learning.decisions.labels import label_picks
from clutter_env.learning.decisions.observed import observed_scene
from clutter_env.scene.layout import find_layout
from irm.chain import ArmChain
from planners.collision.world import CollisionWorld
from planners.grasping.arm_configurations import ConfigurationGrid, GripperPoses, scan_configurations
from planners.grasping.base_placement import free_ground
from planners.motion.approaches import can_leave

RULE = ContactRule(FETCH, find_layout("paper"))


@pytest.fixture(scope="module")
def env():
    made = gym.make("clutter_env/Retrieve-o5-v0")
    yield made
    made.close()


def test_an_observation_shows_the_scene_in_the_world(env) -> None:
    observation, info = env.reset(seed=3)
    seen, scene = observed_scene(observation), scene_of(env)
    assert seen.bodies[seen.target].name == info["target"]
    assert np.allclose(object_rows(seen.bodies), object_rows(scene.objects), atol=1e-5)
    assert np.allclose(seen.base, scene.state.base, atol=1e-6)
    assert seen.held is None


def test_bases_face_the_gripper_and_stand_on_the_free_floor(env) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    choices = RULE.picks(scene.objects)
    away = choices.tcp[:, :2] - choices.base[:, :2]
    bearing = np.arctan2(away[:, 1], away[:, 0])
    assert np.allclose(bearing, choices.base[:, 2])
    assert np.linalg.norm(away, axis=1).min() >= LEAST_STANDOFF - 1e-9
    assert free_ground(scene).are_free(choices.base[:, 0], choices.base[:, 1]).all()
    assert len(np.unique(choices.index)) == len(scene.objects)


def test_the_gripper_can_be_raised_from_tilted_contacts(env) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    world, choices = CollisionWorld.from_scene(scene), replace(RULE, grasps="tilted").picks(scene.objects)
    grid, can_be_raised = ConfigurationGrid.about_home(ArmChain.from_robot(FETCH), FETCH.home), []
    for row in range(0, len(choices), len(choices) // 60):
        poses = GripperPoses(choices.base[row : row + 1], choices.tcp[row : row + 1])
        body = scene.objects[choices.index[row]]
        found = scan_configurations(world, poses, grid, 0.09, ignore=1 << int(choices.index[row]))
        if len(found.q):
            can_be_raised.append(can_leave(world, choices.base[row], found.q[0], body.name))
    assert len(can_be_raised) > 20
    assert np.mean(can_be_raised) > 0.9


def test_contacts_mirror_left_to_right(env) -> None:
    env.reset(seed=3)
    bodies = scene_of(env).objects
    mirrored = [body.at(body.position * (1, -1, 1)) for body in bodies]
    one, other = RULE.picks(bodies), RULE.picks(mirrored)
    rounded = [np.round(np.column_stack((found.index, found.base)), 6) for found in (one, other)]
    rounded[1][:, 2:] *= -1
    assert {tuple(row) for row in rounded[0] + 0.0} == {tuple(row) for row in rounded[1] + 0.0}


def test_a_label_does_not_depend_on_the_other_contacts(env) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    world, choices = CollisionWorld.from_scene(scene), RULE.picks(scene.objects)
    some = choices.take(np.arange(0, len(choices), 20))
    together = label_picks(world, some)
    alone = [label_picks(world, some.take(slice(row, row + 1))) for row in range(len(some))]
    assert together.is_reached.tolist() == [label.is_reached[0] for label in alone]
    assert together.blockers.tolist() == [label.blockers[0] for label in alone]
    assert together.is_free.any()
    assert not together.is_free.all()


def test_a_placed_object_stands_where_the_contact_says(env) -> None:
    env.reset(seed=3)
    scene = scene_of(env)
    picks = RULE.picks(scene.objects)
    free = np.flatnonzero(label_picks(CollisionWorld.from_scene(scene), picks).is_free)
    pick = picks.contact(int(free[0]), "pick", scene.objects[picks.index[free[0]]].name)
    holding = apply_contact(scene, pick)
    assert holding.held is not None
    body, points = scene.body(pick.object), RULE.points()
    places = RULE.places(body, holding.held, points)
    for row in (0, len(places) // 2, len(places) - 1):
        placed = apply_contact(holding, places.contact(row, "place", body.name)).body(body.name)
        assert np.allclose(placed.position[:2], points[places.index[row], :2])
        assert placed.bottom == pytest.approx(scene.support.top)


class _FirstFree:
    """Takes the target from the first contact that is free by the planner's geometry."""

    def reset(self) -> None:
        """Nothing to forget."""

    def choose(self, scene):
        """The first free contact of the target."""
        picks = RULE.picks(scene.bodies)
        names = [body.name for body in scene.bodies]
        rows = np.flatnonzero(picks.index == scene.target)
        contacts = (picks.contact(int(row), "pick", names[scene.target]) for row in rows)
        return next((one for one in contacts if not is_contact_free(self.scene, one)), None)


def test_an_episode_ends_with_the_target_taken_or_with_a_contact_that_is_not_free(env) -> None:
    endings = set()
    for seed in range(4):
        _, info = env.reset(seed=seed)
        chooser = _FirstFree()
        chooser.scene = scene_of(env)
        outcome = simulate_decisions(chooser, chooser.scene, info["target"])
        assert outcome.is_taken == (outcome.failure == "")
        assert outcome.clearances == 0
        endings.add(outcome.failure)
    assert "" in endings
    assert as_observed(chooser.scene, info["target"]).held is None


def test_value_iteration_counts_clearances() -> None:
    """Object 0 is behind 1, which is behind 2; object 3 stands alone; 4 and 5 block each other."""
    own = np.arange(6)
    blocks = np.zeros((1, 6, 6))
    for behind, before in ((0, 1), (1, 2), (4, 5), (5, 4)):
        blocks[0, behind, before] = 1.0
    costs = clearing_costs(own, np.zeros(6), blocks)
    assert costs.objects[0].tolist() == [2.0, 1.0, 0.0, 0.0, RISK, RISK]
    assert costs.is_cleared[0].nonzero()[0].tolist() == [0, 1]
    assert (costs.objects <= MOST).all()


def test_value_iteration_prefers_a_small_risk_to_a_clearance() -> None:
    costs = clearing_costs(np.array([0, 1]), np.zeros(2), np.array([[[0.0, 0.02], [0.0, 0.0]]]))
    assert costs.objects[0, 0] == pytest.approx(0.02 * RISK)
    assert not costs.is_cleared.any()
    assert math.isclose(float(costs.contacts[0, 0]), costs.objects[0, 0])


def test_the_greedy_decider_takes_the_target_then_clears_what_is_nearest(env) -> None:
    observation, info = env.reset(seed=3)
    scene, decider = scene_of(env), GreedyDecider(RULE)
    target = scene.body(info["target"])
    first, second = decider.decide(observation), decider.decide(observation)
    away = {body.name: np.linalg.norm(body.position - target.position) for body in scene.objects}
    assert first is not None
    assert second is not None
    assert first.object == target.name
    assert second.object == sorted(away, key=lambda name: away[name])[1]
    assert first.is_straight
    holding = apply_contact(scene, second)
    place = decider.choose(as_observed(holding, target.name))
    assert place is not None
    assert (place.skill, place.object) == ("place", second.object)
    placed = apply_contact(holding, place)
    gaps = [
        np.linalg.norm(body.position[:2] - placed.body(second.object).position[:2]) - 2 * body.radius
        for body in placed.objects
        if body.name != second.object
    ]
    assert min(gaps) > 0.03
    again = decider.choose(as_observed(placed, target.name))
    assert again is not None
    assert again.object == target.name
