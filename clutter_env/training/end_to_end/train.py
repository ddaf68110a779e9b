"""Trains the end-to-end policy: plans of random scenes, then the network."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import torch

from clutter_env.errors import LearningError
from clutter_env.policies.end_to_end.anchors import table_cells
from clutter_env.policies.end_to_end.policy import KIND
from clutter_env.policies.weights import save_weights, trained_in
from clutter_env.training.end_to_end.examples import examples_of_plans
from clutter_env.training.end_to_end.fit import Steps, fit

WEIGHTS_FILE = "weights.npz"


def train_end_to_end(
    directory: Path,
    plans: int = 440,
    seed: int = 0,
    log: Callable[[str], object] = lambda _: None,
    steps: Steps = Steps(),  # noqa: B008  frozen
) -> Path:
    """Train, and return the file of the weights, in a directory with the examples.

    Args:
        directory: of the run. Examples that are there are read, so that a run that was stopped goes on.
        plans: how many to learn from.
        seed: of scenes and network.
        log: is told how the training goes on.
        steps: gradient steps.

    Raises:
        LearningError: fewer than one plan, a negative seed, or the plans lack what a part learns from.
        PolicyError: a file of examples is damaged.
    """
    for name, value, least in (("scenes", plans, 1), ("seed", seed, 0)):
        if value < least:
            raise LearningError(f"{name}={value} is not valid; it must be at least {least}")
    torch.set_num_threads(1)
    started = time.process_time()
    examples = examples_of_plans(directory / "plans", plans, seed)
    found = len(set(examples.picks.seed.tolist()))
    log(f"{len(examples.picks.seed)} picks of {found} plans after {time.process_time() - started:.0f} s of CPU time")
    env = gym.make("clutter_env/Retrieve-o15-v0")
    network = fit(examples, table_cells(env.get_wrapper_attr("layout")), steps, seed, log)
    info = trained_in(env, KIND, "side")
    spent = {"plans": found, "seed": seed, "cpu_s": round(time.process_time() - started)}
    info = replace(info, provenance={**info.provenance, "trained_with": spent})
    save_weights(directory / WEIGHTS_FILE, network, info)
    log(f"{directory / WEIGHTS_FILE} after {time.process_time() - started:.0f} s of CPU time")
    return directory / WEIGHTS_FILE
