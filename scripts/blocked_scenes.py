"""What learners make of the scenes of ArmRetrieve-o3 in which an object is in the way of the target.

    python -m scripts.blocked_scenes ends arm_retrieve_o3_sac.zip
    python -m scripts.blocked_scenes recognise
    python -m scripts.blocked_scenes clone --roles

`ends`: where episodes of a saved SAC end, how far from the target and from the object in the way, and what its critic
expects there of its own action and of the script's. `recognise`: how often a small network that is shown first
observations tells whether something is in the way, for several numbers of scenes to learn from. `clone`: how often a
network succeeds that regresses the script's actions on its observations.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
import tyro
from stable_baselines3 import SAC

from clutter_env.data.episode import Episode, record
from clutter_env.envs.arm_retrieve import ArmRetrieveEnv
from clutter_env.policies.experts import make_expert
from clutter_env.policies.scripted import arm_retrieve
from clutter_env.reporting.tables import markdown_table
from clutter_env.seeds import HELD_OUT
from clutter_env.task import Task

ENV = "clutter_env/ArmRetrieve-o3-v0"
SHOWN, BATCH, UPDATES, CLONING = (300, 600, 1200, 2400), 256, 3000, 20_000


def ends(
    model: tyro.conf.Positional[str], first: int = HELD_OUT + 10_000, scenes: int = 100, roles: bool = False
) -> None:
    """Play blocked scenes and print where episodes end.

    Args:
        model: File of a model that SAC saved.
        first: Seed of the first scene.
        scenes: Number of scenes, of which those with something in the way are played.
        roles: Whether the model was trained with the keyword `roles`.
    """
    sac, env = SAC.load(model), gym.make(ENV, roles=roles)
    rows, count = [], Counter[str]()
    for seed in range(first, first + scenes):
        observation, info = env.reset(seed=seed)
        inner = cast(ArmRetrieveEnv, env.unwrapped)
        if not (blocking := inner.in_the_way):
            continue
        terminated = truncated = False
        while not (terminated or truncated):
            tcp, centres = inner.tcp + inner.origin, inner.standing().centres
            away = [float(np.hypot(*(tcp[:2] - centres[slot]))) for slot in (inner.target_slot, blocking[0])]
            action, _ = sac.predict(observation, deterministic=True)
            expected = [expect(sac, observation, each) for each in (action, arm_retrieve(inner)[1])]
            observation, _, terminated, truncated, info = env.step(action)
        end = how_it_ended(info, terminated)
        count[end] += 1
        if end != "success":
            rows.append((f"{seed}", end, *[f"{100 * metres:.1f}" for metres in away], *[f"{q:.1f}" for q in expected]))
    heads = ("seed", "end", "cm from the target", "cm from the object in the way", "Q", "Q of the script's action")
    print(markdown_table(heads, rows), end="")
    print(", ".join(f"{end} {number}" for end, number in count.most_common()))


def expect(sac: SAC, observation: dict[str, Any], action: Any) -> float:
    """The smaller value that the two critics give an action (4,)."""
    seen, _ = sac.policy.obs_to_tensor(observation)
    with torch.no_grad():
        values = sac.critic(seen, torch.as_tensor(np.clip(action, -1, 1)[None], dtype=torch.float32))
    return min(float(value) for value in values)


def how_it_ended(info: dict[str, Any], terminated: bool) -> str:
    """One word for the end of an episode."""
    if info["is_success"]:
        return "success"
    if info["num_disturbed"] or info["num_fallen"]:
        return "disturbed"
    return "pressed" if terminated else "time"


def recognise(scenes: int = 3000) -> None:
    """Train on first observations and print the accuracy on those of the last 600 scenes.

    Args:
        scenes: Number of scenes, more than 3,000 is of no use.
    """
    torch.manual_seed(0)
    env, seen, is_blocked = gym.make(ENV), [], []
    for seed in range(scenes):
        observation, _ = env.reset(seed=seed)
        seen.append(observation["observation"])
        is_blocked.append(bool(cast(ArmRetrieveEnv, env.unwrapped).in_the_way))
    inputs, labels = torch.tensor(np.array(seen)), torch.tensor(is_blocked).float()
    rows = []
    for shown in SHOWN:
        network = small_network(inputs.shape[1], 1, 128)
        optimiser = torch.optim.Adam(network.parameters(), 1e-3)
        for _ in range(UPDATES):
            drawn = torch.randint(0, shown, (BATCH,))
            loss = torch.nn.functional.binary_cross_entropy_with_logits(network(inputs[drawn])[:, 0], labels[drawn])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        with torch.no_grad():
            is_right = (network(inputs[-600:])[:, 0] > 0) == (labels[-600:] > 0)
        rows.append((f"{shown}", f"{float(is_right.float().mean()):.3f}"))
    print(markdown_table(("scenes", "accuracy on 600 others"), rows), end="")


def clone(demonstrations: int = 600, scenes: int = 100, roles: bool = False, objects: int = 3) -> None:
    """Clone the script and print how episodes end, in free and in blocked scenes.

    Args:
        demonstrations: Number of scenes that the script plays; failures are left out.
        scenes: Number of held-out scenes.
        roles: Whether observations say what is in the way.
        objects: Number of objects: 1, 3 or 5.
    """
    task = Task(f"clutter_env/ArmRetrieve-o{objects}-v0", {"roles": roles})
    env, script = task.make(), make_expert("armretrieve")
    network = fitted([record(task, env, script, seed) for seed in range(demonstrations)])
    count = Counter[tuple[str, str]]()
    for seed in range(HELD_OUT + 10_000, HELD_OUT + 10_000 + scenes):
        observation, info = env.reset(seed=seed)
        kind = "blocked" if cast(ArmRetrieveEnv, env.unwrapped).in_the_way else "free"
        terminated = truncated = False
        while not (terminated or truncated):
            with torch.no_grad():
                action = network(torch.tensor(observation["observation"])[None])[0].numpy()
            observation, _, terminated, truncated, info = env.step(np.clip(action, -1, 1))
        count[kind, how_it_ended(info, terminated)] += 1
    rows = [(*key, f"{number}") for key, number in sorted(count.items())]
    print(markdown_table(("scenes", "end", "of them"), rows), end="")


def fitted(episodes: list[Episode]) -> torch.nn.Module:
    """A network (n) -> (4,) fitted to the actions of the episodes that succeeded."""
    torch.manual_seed(0)
    kept = [episode for episode in episodes if episode.succeeded]
    inputs = torch.tensor(np.concatenate([episode.observations["observation"][:-1] for episode in kept]))
    actions = torch.tensor(np.clip(np.concatenate([episode.actions for episode in kept]), -1, 1)).float()
    network = small_network(inputs.shape[1], actions.shape[1], 256)
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.02, CLONING)
    for _ in range(CLONING):
        drawn = torch.randint(0, len(inputs), (BATCH,))
        loss = torch.nn.functional.l1_loss(network(inputs[drawn]), actions[drawn])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return network


def small_network(inputs: int, outputs: int, width: int) -> torch.nn.Sequential:
    """Two hidden layers."""
    hidden = (torch.nn.Linear(inputs, width), torch.nn.ReLU(), torch.nn.Linear(width, width), torch.nn.ReLU())
    return torch.nn.Sequential(*hidden, torch.nn.Linear(width, outputs))


if __name__ == "__main__":
    torch.set_num_threads(1)
    tyro.extras.subcommand_cli_from_dict({"ends": ends, "recognise": recognise, "clone": clone}, description=__doc__)
