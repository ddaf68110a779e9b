"""Recorded episodes: they replay, and the planner's have phases, pick-place actions, keyframes, names and units."""

from __future__ import annotations

import dataclasses

import h5py
import numpy as np
import pytest

from clutter_env.data.dataset import Dataset
from clutter_env.data.episode import CONTACT_SKILLS, Episode
from clutter_env.data.episode_file import episode_arrays
from clutter_env.data.replay import replay, replay_in_fresh_process
from clutter_env.policies.experts import find_expert
from clutter_env.provenance import provenance
from clutter_env.task import Task
from tests.clutter_env.data.conftest import recorded

PICK_PHASES = ["drive", "ready", "transit", "approach", "close", "lift", "retreat"]


def test_an_episode_replays_and_a_changed_one_does_not(pick_episode: Episode) -> None:
    assert pick_episode.succeeded
    result = replay(pick_episode)
    assert result.is_identical
    assert result.is_success
    actions = pick_episode.actions.copy()
    actions[10] = -actions[10] + 0.01
    result = replay(dataclasses.replace(pick_episode, actions=actions))
    assert (result.is_identical, result.first_difference) == (False, 11)


def test_an_episode_replays_in_another_process(planned_dataset: Dataset) -> None:
    assert replay_in_fresh_process(planned_dataset.episode_path(0)).is_identical


def test_an_episode_says_what_it_was_recorded_with(planned_episode: Episode) -> None:
    env = planned_episode.task.make()
    assert planned_episode.provenance == provenance(env)
    env.close()


def test_phases_come_in_order_and_lead_to_one_pick(planned_episode: Episode) -> None:
    labels, steps = planned_episode.labels, len(planned_episode)
    assert len(labels) == steps
    phases = list(dict.fromkeys(name for name in labels.phases if name))
    assert phases == PICK_PHASES[: len(phases)]
    assert phases[-2:] in (["close", "lift"], ["lift", "retreat"])
    moving = np.array([bool(name) for name in labels.phases])
    assert (labels.skill[moving] == CONTACT_SKILLS.index("pick")).all()
    assert (labels.object[moving] == 0).all()
    assert len(np.unique(labels.contact_tcp[moving].round(9), axis=0)) == 1
    assert np.isnan(labels.contact_base[~moving]).all()
    assert (labels.object[~moving] == -1).all()
    assert np.isfinite(labels.keyframe).all()
    assert (planned_episode.report["contacts"], planned_episode.report["not_straight"]) == (1, 0)


def test_the_robot_is_at_the_keyframe_when_the_phase_ends(planned_episode: Episode) -> None:
    """Within what the arm lags: 2 cm of the base and torso, 0.1 rad of the joints."""
    robot, labels = planned_episode.observations["robot"], planned_episode.labels
    steps = range(1, len(planned_episode))
    changes = [k for k in steps if labels.phases[k] != labels.phases[k - 1] and labels.phases[k]]
    assert len(changes) >= 5
    for k in changes:
        keyframe = labels.keyframe[k - 1]
        away = robot[k, [0, 1, *range(4, 12)]] - keyframe[[0, 1, *range(3, 11)]]
        assert np.abs(away).max() < 0.1
        assert np.hypot(*away[:2]) < 0.02


def test_every_array_names_its_numbers_and_their_units(planned_dataset: Dataset) -> None:
    with h5py.File(planned_dataset.episode_path(0), "r") as file:
        arrays = {f"infos/{name}": array for name, array in file["infos"].items()}
        arrays |= {f"observations/{name}": array for name, array in file["observations"].items()}
        arrays |= {name: file[name] for name in ("actions", "rewards", "terminations", "truncations")}
        for name, array in arrays.items():
            names, units = list(array.attrs["names"]), list(array.attrs["units"])
            assert array.attrs["about"], name
            assert len(names) == len(units) == len(set(names)), name
            assert len(names) == int(np.prod(array.shape[1:])) or name == "infos/state", name
        assert list(file["observations/objects"].attrs["names"])[2] == "object_0.x"
        assert list(file["infos/keyframe"].attrs["units"]) == ["m", "m", "rad", "m", *["rad"] * 7, "m"]


@pytest.mark.parametrize("env_id", ["clutter_env/ArmReach-v0", "clutter_env/ArmPick-v0"])
def test_episodes_with_a_fixed_base_are_recorded_and_name_their_numbers(env_id: str) -> None:
    """They could not be: their observations have no entry of the base."""
    episode = recorded(Task(env_id), find_expert(env_id), 0)
    assert episode.succeeded
    for name, values in episode_arrays(episode).items():
        if name != "infos/state":
            assert len(episode.columns[name].names) == int(np.prod(values.shape[1:])), name
    assert replay(episode).is_identical


def test_what_belongs_to_an_action_stands_in_the_row_of_the_state_before(
    planned_episode: Episode, planned_dataset: Dataset
) -> None:
    with h5py.File(planned_dataset.episode_path(0), "r") as file:
        assert {len(values) for values in file["infos"].values()} == {len(planned_episode) + 1}
        names = [name.decode() for name in file["expert/phases"][()]]
        assert tuple(names[index] for index in file["infos/phase"][:-1]) == planned_episode.labels.phases
        assert file["infos/phase"][-1] == file["infos/skill"][-1] == file["infos/contact_object"][-1] == -1
        assert np.isnan(file["infos/keyframe"][-1]).all()
