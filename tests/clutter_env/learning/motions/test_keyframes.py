"""Learned movers: laws of what they are made of, and each learner for a few steps on a few demonstrations."""

from __future__ import annotations

import dataclasses
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

torch = pytest.importorskip("torch")

import assets  # noqa: E402
import clutter_env  # noqa: E402, F401  registers the environments
from assets.robots import FETCH  # noqa: E402
from clutter_env.envs.observation import OBSERVATION_LAYOUT  # noqa: E402
from clutter_env.policies.registry import load_policy  # noqa: E402
from clutter_env.learning.contacts.hierarchical import HierarchicalPolicy  # noqa: E402
from clutter_env.learning.contacts.planned_decider import PlannedDecider  # noqa: E402
from clutter_env.learning.contacts.reading import Reading, read  # noqa: E402
from clutter_env.policies.parsed_observation import planar_pose  # noqa: E402
from clutter_env.learning.demonstrations.dataset import Dataset, Job  # noqa: E402
from clutter_env.learning.demonstrations.episode import Episode, record  # noqa: E402
from clutter_env.learning.demonstrations.episode_file import write_episode  # noqa: E402
from clutter_env.policies.experts import make_expert  # noqa: E402
from clutter_env.learning.errors import DatasetError, LearningError  # noqa: E402
from clutter_env.learning.keyframes.aim import Aim  # noqa: E402
from clutter_env.policies.motion.control import GripperError  # noqa: E402
from clutter_env.training.motion_examples import is_driven  # noqa: E402
from clutter_env.policies.motion.arm import nearest_home  # noqa: E402
from clutter_env.learning.keyframes.configurations import shortest_way, with_wrist_turned  # noqa: E402
from clutter_env.learning.training.bc import examples_of  # noqa: E402
from clutter_env.learning.keyframes.fit import FitConfig  # noqa: E402
from clutter_env.training.motion_fit import fit_keyframes  # noqa: E402
from clutter_env.policies.motion.arm import ArmKinematics  # noqa: E402
from clutter_env.training.motion_demonstrations import Motion, motions_of  # noqa: E402
from clutter_env.learning.keyframes.mover import KeyframeMover  # noqa: E402
from clutter_env.policies.motion.network import KeyframeNetwork  # noqa: E402
from clutter_env.policies.motion.network_input import PHASES  # noqa: E402
from clutter_env.learning.keyframes.postures import PostureChoice  # noqa: E402
from clutter_env.learning.policies.movers import fit_mover, load_mover  # noqa: E402
from clutter_env.learning.policies.runs import MOVER_FILE  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.curve import Curve, Point, draw, markdown, measure, points  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from planners.motion.arm import tcp_pose  # noqa: E402
from planners.scene import RobotState  # noqa: E402

TASK = Task("clutter_env/Retrieve-o1-v0")
COUNT = 3


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three canonical demonstrations."""
    dataset = Dataset.open_for(Job(TASK, "canonical", episodes=COUNT), tmp_path_factory.mktemp("demos") / "o1")
    env = TASK.make()
    for seed in range(COUNT):
        write_episode(dataset.episode_path(seed), record(TASK, env, make_expert(env, "canonical"), seed))
    dataset.finish(range(COUNT))
    return dataset


@pytest.fixture(scope="module")
def episodes(demos: Dataset) -> list[Episode]:
    return list(demos)


def configurations() -> np.ndarray[Any, np.dtype[np.float64]]:
    rng = np.random.default_rng(0)
    limits = np.array([(max(link.lower, -6.0), min(link.upper, 6.0)) for link in FETCH.chain])
    return rng.uniform(limits[:, 0], limits[:, 1], (200, len(limits)))


def test_kinematics_in_torch_are_those_of_the_planner() -> None:
    q = configurations()
    position, rotation = ArmKinematics(FETCH).tcp(torch.tensor(q, dtype=torch.float32))
    wanted = np.array([tcp_pose(FETCH, RobotState(np.zeros(3), row, 0.0)) for row in q])
    np.testing.assert_allclose(position.numpy(), wanted[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(rotation.numpy(), wanted[:, :3, :3], atol=1e-5)


def test_the_form_nearest_to_home_has_the_same_gripper_pose() -> None:
    q = configurations()
    turned = nearest_home(FETCH, q)
    for row, other in zip(q, turned, strict=True):
        one, same = (tcp_pose(FETCH, RobotState(np.zeros(3), one, 0.0)) for one in (row, other))
        np.testing.assert_allclose(one, same, atol=1e-9)
    np.testing.assert_allclose(nearest_home(FETCH, turned), turned)
    assert np.abs(q - turned).max() > 3


def test_the_shorter_way_is_at_most_half_a_turn() -> None:
    q, home = configurations(), np.array(FETCH.home)
    endless = [3, 5, 7]
    way = shortest_way(FETCH, home, q) - home
    assert np.abs(way[:, endless]).max() <= np.pi + 1e-9
    np.testing.assert_allclose(np.cos(way), np.cos(q - home), atol=1e-9)


def test_the_shorter_way_keeps_within_the_limits() -> None:
    q = np.array(FETCH.home)
    q[5] = FETCH.chain[5].lower + 0.1
    for angle, expected in ((-3.0, -3.0), (-0.3, -0.3), (0.2, 0.2 - 2 * np.pi)):
        goal = np.array(FETCH.home)
        goal[5] = angle
        assert shortest_way(FETCH, q, goal)[5] == pytest.approx(expected)


def test_a_wrist_bent_the_other_way_has_the_same_gripper_pose() -> None:
    q = configurations()
    turned = with_wrist_turned(FETCH, q)
    kinematics = ArmKinematics(FETCH)
    (p, R), (also_p, also_R) = (kinematics.tcp(torch.tensor(one, dtype=torch.float32)) for one in (q, turned))
    np.testing.assert_allclose(p, also_p, atol=1e-5)
    np.testing.assert_allclose(R, also_R, atol=1e-5)
    np.testing.assert_allclose(turned[:, 6], -q[:, 6])


def test_a_demonstration_is_cut_into_the_motion_of_its_contact(episodes: list[Episode]) -> None:
    for episode, motion in zip(episodes, motions_of(episodes), strict=True):
        assert motion.contact.skill == "pick"
        assert motion.index == 0
        assert len(motion.reading.base) == len(motion.actions) + 1 == len(motion.phases) + 1
        assert [phase for phase, _ in motion.runs()] == list(PHASES["pick"])[: len(list(motion.runs()))]
        assert len(motion.actions) <= len(episode)


def test_a_line_that_begins_while_the_base_still_drives_is_no_drive_under_a_board(episodes: list[Episode]) -> None:
    motion = next(motions_of(episodes))
    (steps,) = (steps for phase, steps in motion.runs() if phase == "approach")
    base = motion.reading.base.copy()
    base[steps, 0] -= np.linspace(0.22, 0.0, steps.stop - steps.start)
    assert not is_driven(dataclasses.replace(motion, reading=dataclasses.replace(motion.reading, base=base)))
    rigid = motion.reading.q.copy()
    rigid[steps] = rigid[steps.start]
    assert is_driven(dataclasses.replace(motion, reading=dataclasses.replace(motion.reading, base=base, q=rigid)))


def at(reading: Reading, step: int) -> Reading:
    """One step of the reading of an episode."""
    return Reading(**{entry.name: getattr(reading, entry.name)[step] for entry in dataclasses.fields(Reading)})


def contact_keyframes(motion: Motion) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Keyframes at the end of the approach."""
    return np.array([motion.keyframes[steps][0] for phase, steps in motion.runs() if phase == "approach"])


def test_the_approach_leads_to_the_contact(episodes: list[Episode]) -> None:
    for motion in motions_of(episodes):
        (keyframe,) = contact_keyframes(motion)
        reached = tcp_pose(FETCH, RobotState(keyframe[:3], keyframe[3:11], 0.0))
        np.testing.assert_allclose(reached, motion.contact.tcp, atol=1e-9)


def test_an_aim_leads_a_gripper_that_is_off_to_the_contact() -> None:
    contact, off = np.eye(4), np.eye(4)
    off[:3, 3] = 0.02, -0.01, 0.005
    aim = Aim()
    for _ in range(60):
        measured = aim.of(contact) @ off
        aim.correct(GripperError.between(measured, contact))
    assert GripperError.between(aim.of(contact) @ off, contact).is_small
    assert np.linalg.norm(GripperError.between(aim.of(contact) @ off, contact).shift) < 1e-4


@pytest.fixture(scope="module")
def network(episodes: list[Episode]) -> KeyframeNetwork:
    """A network fitted for a few seconds."""
    return fit_keyframes(FETCH, examples_of(FETCH, motions_of(episodes)), FitConfig(steps=700, batch=128))


def test_keyframes_of_a_fitted_network_are_those_of_the_demonstrations(
    episodes: list[Episode], network: KeyframeNetwork
) -> None:
    examples = examples_of(FETCH, motions_of(episodes))
    with torch.no_grad():
        predicted = network(torch.tensor(examples.features, dtype=torch.float32))
    position, _ = ArmKinematics(FETCH).tcp(predicted.q)
    wanted, _ = ArmKinematics(FETCH).tcp(torch.tensor(examples.q, dtype=torch.float32))
    error = torch.linalg.norm(position - wanted, dim=1).numpy()[examples.at_contact]
    assert np.median(error) < 0.015
    limits = np.array([(link.lower, link.upper) for link in FETCH.chain])
    assert (predicted.q.numpy() >= limits[:, 0] - 1e-5).all()
    assert (predicted.q.numpy() <= limits[:, 1] + 1e-5).all()


def run(demos: Dataset, algorithm: str, directory: Path, steps: int = 20) -> Run:
    return Run(TASK, algorithm, steps, directory, demonstrations=demos.directory, evaluation_episodes=1)


@pytest.mark.parametrize("algorithm", ["keyframes", "chunks", "flow"])
def test_every_learner_trains_and_acts_the_same_after_loading(demos: Dataset, tmp_path: Path, algorithm: str) -> None:
    trained = train(run(demos, algorithm, tmp_path / "run"))
    assert [entry["demonstrations"] for entry in trained.history] == [COUNT]
    env = TASK.make()
    actions = []
    for _ in range(2):
        observation, info = env.reset(seed=1_000_000)
        policy = HierarchicalPolicy(PlannedDecider(), load_mover(algorithm, tmp_path / "run" / MOVER_FILE))
        policy.reset(env, info)
        taken = [policy.act(observation)]
        for _ in range(15):
            observation, *_ = env.step(taken[-1])
            taken.append(policy.act(observation))
        actions.append(taken)
    np.testing.assert_array_equal(*actions)
    assert np.abs(actions[0]).max() > 0.1


def test_demonstrations_of_a_script_or_without_contacts_are_refused(tmp_path: Path, demos: Dataset) -> None:
    task = Task("clutter_env/Retrieve-o1-v0", {"control_mode": "ee"})
    scripted = Dataset.open_for(Job(task, "scripted", episodes=1), tmp_path / "scripted")
    scripted.finish([])
    with pytest.raises(DatasetError, match="canonical"):
        points(Curve([scripted.directory], ["keyframes"], [1], 1, 1, 1))
    with pytest.raises(LearningError, match="keyframes, chunks, flow"):
        points(Curve([demos.directory], ["sac"], [1], 1, 1, 1))
    with pytest.raises(DatasetError, match="no weights"):
        load_mover("keyframes", tmp_path / "none.npz")
    with pytest.raises(DatasetError, match="canonical"):
        examples_of(FETCH, [])


def test_a_curve_is_measured_once_and_drawn(demos: Dataset, tmp_path: Path) -> None:
    todo = points(Curve([demos.directory], ["keyframes"], [1, 2, 10], seeds=1, steps=5, scenes=1))
    assert [point.count for point in todo] == [1, 2]
    results = measure(todo[:1], tmp_path / "results.json", workers=1)
    ticks: list[int] = []
    again = measure(todo[:1], tmp_path / "results.json", workers=1, tick=lambda: ticks.append(1))
    assert again == results
    assert len(ticks) == 1
    draw(results, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 0
    assert "| o1 | keyframes | 1 |" in markdown(results)


def test_seeds_on_the_same_scenes_do_not_narrow_the_interval_of_a_curve() -> None:
    successes = [True] * 8 + [False] * 2
    seeds = {Point("o1", "keyframes", 10, seed, steps=1, scenes=10): successes for seed in range(30)}
    (row,) = markdown(seeds).splitlines()[2:]
    low, high = map(float, row.split("[")[1].split("]")[0].split(", "))
    assert low < 0.75
    assert high > 0.85


def test_the_first_demonstrations_of_a_dataset_are_used(demos: Dataset) -> None:
    few = list(motions_of(islice(demos, 2)))
    every = list(motions_of(demos))
    assert (len(few), len(every)) == (2, COUNT)
    np.testing.assert_array_equal(few[1].actions, every[1].actions)


def test_a_contact_moves_with_its_object_until_the_fingers_close(demos: Dataset) -> None:
    mover = fit_mover("keyframes", FETCH, list(motions_of(demos)), steps=5).mover
    assert isinstance(mover, KeyframeMover)
    env: gym.Env[Any, Any] = TASK.make()
    observation, info = env.reset(seed=0)
    decider = PlannedDecider()
    decider.reset(env, info)
    contact = decider.decide(observation)
    assert contact is not None
    mover.reset(env, info)
    mover.start(contact, observation)
    moved = {name: value.copy() for name, value in observation.items()}
    moved["objects"][2] += 0.01
    mover.act(moved)
    shift = read(moved).position(0) - read(observation).position(0)
    np.testing.assert_allclose(mover.contact.tcp[:3, 3] - contact.tcp[:3, 3], shift, atol=1e-9)
    np.testing.assert_allclose(mover.contact.base[:2] - contact.base[:2], shift[:2], atol=1e-9)


def test_of_two_postures_the_one_that_is_clear_of_an_object_is_chosen(episodes: list[Episode]) -> None:
    motion = next(motions_of(episodes))
    reading = at(motion.reading, 0)
    choice = PostureChoice(KeyframeNetwork.load(assets.path("policies/keyframes-side.npz")), FETCH)
    np.testing.assert_allclose(choice.choose(motion.contact, 0, reading), 0.0)
    (keyframe,) = contact_keyframes(motion)
    frames, _ = ArmKinematics(FETCH).frames(torch.tensor(keyframe[None, 3:11], dtype=torch.float32))
    forearm = frames[0, 5].numpy().astype(float)
    T = np.linalg.inv(planar_pose(reading.base)) @ planar_pose(np.array(motion.contact.base))
    small = reading.objects[0].copy()
    small[OBSERVATION_LAYOUT["objects"]["position"]] = T[:3, :3] @ forearm + T[:3, 3]
    small[OBSERVATION_LAYOUT["objects"]["half_extents"]] = 0.01
    crowded = dataclasses.replace(reading, objects=np.stack((reading.objects[0], small)))
    assert np.abs(choice.choose(motion.contact, 0, crowded)).max() > 0.04


def test_the_policy_of_the_package_takes_a_target_from_observations_alone() -> None:
    policy = load_policy("keyframes", seed=0)
    env: gym.Env[Any, Any] = TASK.make()
    observation, info = env.reset(seed=1_000_003)
    policy.reset(env, info)
    steps = 0
    while not info["lifted"] and steps < 300:
        observation, _, _, _, info = env.step(policy.act(observation))
        steps += 1
    assert info["is_success"]
