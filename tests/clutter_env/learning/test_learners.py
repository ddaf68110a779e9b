"""Every learner for a few hundred steps, and the laws of what they are made of."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from clutter_env.envs.goal import GOAL_TOLERANCE  # noqa: E402
from clutter_env.envs.observation import OBJECT_FIELDS  # noqa: E402
from clutter_env.envs.skill import BODY_FIELDS  # noqa: E402
from clutter_env.learning.comparison.evaluation import held_out_seeds, play  # noqa: E402
from clutter_env.learning.demonstrations.collect import collect  # noqa: E402
from clutter_env.learning.demonstrations.dataset import Dataset, Job  # noqa: E402
from clutter_env.learning.errors import LearningError, UnknownTask  # noqa: E402
from clutter_env.learning.policies.agents import load_agent  # noqa: E402
from clutter_env.learning.policies.features import feature_vector  # noqa: E402
from clutter_env.learning.policies.policy import Policy  # noqa: E402
from clutter_env.learning.policies.priced import DISTANCE_PRICE, MOTION_PRICE, NEAR_PRICE  # noqa: E402
from clutter_env.learning.policies.rl import GRIPPER_SCALE, GoalFeatures, ScaledActions, make_model, training_env  # noqa: E402
from clutter_env.learning.policies.runs import load_run  # noqa: E402
from clutter_env.learning.skills.network import SkillNetwork  # noqa: E402
from clutter_env.learning.task import Task  # noqa: E402
from clutter_env.learning.training.bc import CloneConfig, Examples, clone, examples_of  # noqa: E402
from clutter_env.learning.training.run import Run  # noqa: E402
from clutter_env.learning.training.training import train  # noqa: E402
from clutter_env.parallel import run_jobs  # noqa: E402
from planners.skills.geometry import DIRECTIONS  # noqa: E402

REACH, PICK = Task("clutter_env/Reach-v0"), Task("clutter_env/Pick-v0")
SKILL = Task("clutter_env/Skill-o5-v0", {"simulation": "kinematic"})


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four replayed demonstrations of Pick."""
    folder = tmp_path_factory.mktemp("demos") / "pick"
    job = Job(PICK, "pick", episodes=4)
    collect(job, Dataset.open_for(job, folder), partial(run_jobs, workers=2))
    return folder


def run(task: Task, algorithm: str, steps: int, directory: Path, **more: Any) -> Run:
    return Run(task, algorithm, steps, directory, checkpoint_every=steps, evaluation_episodes=1, **more)


@pytest.mark.parametrize(("algorithm", "task"), [("sac", REACH), ("ppo", SKILL), ("maskable_ppo", SKILL)])
def test_reinforcement_learns_saves_and_resumes(algorithm: str, task: Task, tmp_path: Path) -> None:
    steps = 300 if task is REACH else 512
    history = train(run(task, algorithm, steps, tmp_path / "run")).history
    assert [entry["steps"] for entry in history] == [steps]
    with pytest.raises(LearningError, match="--resume"):
        train(run(task, algorithm, steps, tmp_path / "run"))
    history = train(run(task, algorithm, 2 * steps, tmp_path / "run"), resume=True).history
    assert [entry["steps"] for entry in history] == [steps, 2 * steps]
    env = task.make()
    assert play(env, load_agent(tmp_path / "run", env), held_out_seeds(1)[0]).steps > 0
    assert load_run(tmp_path / "run")["algorithm"] == algorithm


def test_tqc_corrects_an_imitation_and_resumes(demos: Path, tmp_path: Path) -> None:
    task = run(PICK, "tqc", 150, tmp_path / "run", demonstrations=demos, imitation_steps=50)
    history = train(task).history
    assert [entry["steps"] for entry in history] == [0, 150]
    assert all(entry.keys() == {"steps", "success", "validation"} for entry in history)
    train(replace(task, steps=160), resume=True)
    env = PICK.make()
    assert play(env, load_agent(tmp_path / "run", env), held_out_seeds(1)[0]).steps == 100


def test_cloning_and_dagger_act(demos: Path, tmp_path: Path) -> None:
    train(run(PICK, "bc", 200, tmp_path / "bc", demonstrations=demos))
    history = train(
        run(PICK, "dagger", 100, tmp_path / "dagger", demonstrations=demos, rounds=2, round_episodes=1)
    ).history
    assert [entry["round"] for entry in history] == [0, 1, 2]
    assert 400 == history[0]["examples"] <= history[2]["examples"] <= 600
    env = PICK.make()
    for name in ("bc", "dagger"):
        assert play(env, load_agent(tmp_path / name, env), held_out_seeds(1)[0]).steps == 100


def test_an_algorithm_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LearningError, match="for this one: sac, tqc"):
        train(run(REACH, "maskable_ppo", 10, tmp_path / "run"))
    with pytest.raises(UnknownTask, match="clutter_env/Reach-v0"):
        train(run(Task("clutter_env/Nothing-v0"), "sac", 10, tmp_path / "run"))
    with pytest.raises(UnknownTask, match="joint"):
        Task("clutter_env/Reach-v0", {"control_mode": "none"}).make()
    assert not (tmp_path / "run").exists()


def test_demonstrations_of_another_task_are_refused(demos: Path, tmp_path: Path) -> None:
    with pytest.raises(LearningError, match="not of clutter_env/Reach-v0"):
        train(run(REACH, "bc", 10, tmp_path / "run", demonstrations=demos))
    with pytest.raises(LearningError, match="clutter-env collect"):
        train(run(REACH, "bc", 10, tmp_path / "other"))
    with pytest.raises(LearningError, match="control_mode"):
        train(
            run(
                Task("clutter_env/Pick-v0", {"control_mode": "joint"}),
                "bc",
                10,
                tmp_path / "third",
                demonstrations=demos,
            )
        )


def test_cloning_fits_what_a_network_can_say() -> None:
    rng = np.random.default_rng(0)
    features = rng.normal(size=(500, 4)).astype(np.float32)
    actions = np.tanh(features[:, :2] * (1, -1)).astype(np.float32)
    policy = clone(Examples(features, actions), CloneConfig(steps=600, width=64))
    with torch.no_grad():
        error = np.abs(policy(torch.from_numpy(features)).numpy() - actions).mean()
    assert error < 0.05


def test_a_policy_survives_its_file(tmp_path: Path) -> None:
    policy = Policy(5, 2)
    policy.save(tmp_path / "p.pt")
    features = torch.randn(3, 5)
    assert torch.equal(policy(features), Policy.load(tmp_path / "p.pt")(features))


def test_examples_are_the_dataset(demos: Path) -> None:
    examples = examples_of(Dataset(demos))
    assert len(examples) == 400
    assert examples.actions.shape == (400, 10)


def test_features_do_not_depend_on_the_order_of_the_objects() -> None:
    env = Task("clutter_env/Retrieve-o5-v0").make()
    observation, _ = env.reset(seed=0)
    rows = observation["objects"].reshape(5, len(OBJECT_FIELDS))
    other = {**observation, "objects": rows[[3, 1, 4, 0, 2]].ravel()}
    assert np.array_equal(feature_vector(observation), feature_vector(other))


@pytest.mark.parametrize("task", [REACH, PICK])
def test_torch_features_are_the_numpy_ones(task: Task) -> None:
    env = task.make()
    observation, _ = env.reset(seed=1)
    batch = {name: torch.from_numpy(np.asarray(value))[None] for name, value in observation.items()}
    ours = GoalFeatures(env.observation_space)(batch)[0].numpy()
    assert np.allclose(ours, feature_vector(observation), atol=1e-5)


def test_scaled_actions_are_undone() -> None:
    env = ScaledActions(REACH.make())
    action = np.linspace(-1, 1, 10, dtype=np.float32)
    assert np.allclose(env.reverse_action(env.action(action)), action)
    assert np.allclose(env.action(np.ones(10, np.float32))[3:6], GRIPPER_SCALE)


def test_distance_and_motion_have_a_price_in_rewards_with_hindsight() -> None:
    model = make_model("sac", training_env("sac", REACH.make()), 0)
    model.learn(150)
    drawn = model.replay_buffer.sample(200)
    reached = drawn.next_observations
    away = (reached["achieved_goal"] - reached["desired_goal"]).float().norm(dim=1, keepdim=True)
    price = MOTION_PRICE * drawn.actions.square().mean(dim=1, keepdim=True) + DISTANCE_PRICE * away
    price += NEAR_PRICE * away.minimum(torch.tensor(GOAL_TOLERANCE))
    assert torch.allclose(drawn.rewards + price, -(away > GOAL_TOLERANCE).float(), atol=1e-5)
    assert (price > 0).all()
    at_full_speed = 3 / drawn.actions.shape[1] * MOTION_PRICE
    assert at_full_speed < 1 + (DISTANCE_PRICE + NEAR_PRICE) * GOAL_TOLERANCE, "the fastest way stays the best one"


@pytest.mark.parametrize("algorithm", ["sac", "tqc"])
def test_critics_know_the_price_of_motion(algorithm: str) -> None:
    model = make_model(algorithm, training_env(algorithm, REACH.make()), 0)
    for critic in (model.critic, model.critic_target):
        for network in critic.q_networks:
            torch.nn.init.zeros_(network.network[-1].weight)
            torch.nn.init.zeros_(network.network[-1].bias)
    observation, _ = REACH.make().reset(seed=0)
    seen, _ = model.policy.obs_to_tensor(observation)
    action = torch.linspace(-1, 1, 10)[None]
    for critic in (model.critic, model.critic_target):
        values = torch.as_tensor(torch.cat(critic(seen, action)) if algorithm == "sac" else critic(seen, action))
        assert torch.allclose(values, -MOTION_PRICE * action.square().mean(), atol=1e-6)
    moved = {id(weight) for group in model.critic.optimizer.param_groups for weight in group["params"]}
    assert {id(weight) for weight in model.critic.parameters()} == moved


def test_renumbering_the_objects_renumbers_the_logits() -> None:
    count, width = 5, len(BODY_FIELDS) + DIRECTIONS
    network = SkillNetwork(count)
    rows = torch.rand(1, count, width)
    rows[:, :, 1] = torch.nn.functional.one_hot(torch.tensor([2]), count)
    order = [3, 0, 4, 1, 2]
    rest = torch.rand(1, 2)
    one, value = network(torch.cat((rows.flatten(1), rest), 1))
    other, same_value = network(torch.cat((rows[:, order].flatten(1), rest), 1))
    per_object = one[:, :-1].reshape(1, count, DIRECTIONS)[:, order].flatten(1)
    assert torch.allclose(other[:, :-1], per_object, atol=1e-5)
    assert torch.allclose(other[:, -1], one[:, -1], atol=1e-5)
    assert torch.allclose(value, same_value, atol=1e-5)
