"""Demonstrations of the canonical expert: phases, contacts, keyframes, names and units, in HDF5 and in Minari."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from clutter_env.data.collect import demonstrate
from clutter_env.data.dataset import Dataset, Job
from clutter_env.data.episode import CONTACT_SKILLS, Episode, record
from clutter_env.policies.experts import make_expert
from clutter_env.task import Task

pytest.importorskip("h5py")
import h5py

from clutter_env.data.episode_file import read_episode, write_episode
from clutter_env.data.minari import export_minari

TASK = Task("clutter_env/Retrieve-o1-v0")
JOB = Job(TASK, "canonical", episodes=1)
PICK_PHASES = ["drive", "ready", "transit", "approach", "close", "lift", "retreat"]


@pytest.fixture(scope="module")
def episode() -> Episode:
    env = TASK.make()
    return record(TASK, env, make_expert(env, "canonical"), seed=0)


@pytest.fixture(scope="module")
def dataset(episode: Episode, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    found = Dataset.open_for(JOB, tmp_path_factory.mktemp("demos") / "d")
    write_episode(found.episode_path(0), episode)
    found.finish([0])
    return found


def test_phases_come_in_order_and_lead_to_one_contact(episode: Episode) -> None:
    labels, steps = episode.labels, len(episode)
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


def test_the_robot_is_at_the_keyframe_when_the_phase_ends(episode: Episode) -> None:
    """Within what the arm lags: 2 cm of the base and torso, 0.1 rad of the joints."""
    robot, labels = episode.observations["robot"], episode.labels
    changes = [k for k in range(1, len(episode)) if labels.phases[k] != labels.phases[k - 1] and labels.phases[k]]
    assert len(changes) >= 5
    for k in changes:
        keyframe = labels.keyframe[k - 1]
        away = robot[k, [0, 1, *range(4, 12)]] - keyframe[[0, 1, *range(3, 11)]]
        assert np.abs(away).max() < 0.1
        assert np.hypot(*away[:2]) < 0.02


def test_what_belongs_to_an_action_stands_in_the_row_of_the_state_before(episode: Episode, dataset: Dataset) -> None:
    with h5py.File(dataset.episode_path(0), "r") as file:
        for name, values in file["infos"].items():
            assert len(values) == len(episode) + 1, name
        names = [name.decode() for name in file["expert/phases"][()]]
        assert tuple(names[index] for index in file["infos/phase"][:-1]) == episode.labels.phases
        assert file["infos/phase"][-1] == file["infos/skill"][-1] == file["infos/contact_object"][-1] == -1
        assert np.isnan(file["infos/keyframe"][-1]).all()


def test_every_array_names_its_numbers_and_their_units(dataset: Dataset) -> None:
    with h5py.File(dataset.episode_path(0), "r") as file:
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


def test_minari_reads_them(episode: Episode, dataset: Dataset, tmp_path: Path) -> None:
    minari = pytest.importorskip("minari")
    folder = export_minari(dataset, tmp_path)
    back = next(iter(minari.MinariDataset(str(folder / "data")).iterate_episodes()))
    assert len(back.infos["phase"]) == len(back.infos["is_success"]) == len(episode) + 1
    np.testing.assert_array_equal(back.infos["keyframe"][:-1], episode.labels.keyframe)
    np.testing.assert_array_equal(back.infos["contact_tcp"][:-1], episode.labels.contact_tcp)


def test_the_report_says_how_many_contacts_are_not_straight(episode: Episode) -> None:
    assert episode.report["contacts"] == 1
    assert episode.report["not_straight"] == 0


def test_only_clean_successes_are_demonstrations(monkeypatch: pytest.MonkeyPatch) -> None:
    env = TASK.make()
    good = record(TASK, env, make_expert(env, "canonical"), seed=0)
    assert good.succeeded
    assert good.is_clean
    disturbed = dataclasses.replace(good, num_disturbed=good.num_disturbed + 1)
    monkeypatch.setattr("clutter_env.learning.demonstrations.collect.record", lambda *_: disturbed)
    outcome = demonstrate(JOB, 0)
    assert outcome.reason.startswith("not clean")
    assert not outcome.content


def test_the_file_gives_the_labels_back(episode: Episode, dataset: Dataset) -> None:
    back = read_episode(dataset.episode_path(0))
    assert back.columns == episode.columns
    assert back.labels.phases == episode.labels.phases
    np.testing.assert_array_equal(back.labels.keyframe, episode.labels.keyframe)
