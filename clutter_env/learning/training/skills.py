"""Clones which skills lead to the target, before reinforcement learning improves the clone."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from clutter_env.training.skill_examples import SkillExamples
from clutter_env.learning.training.bc import examples_of
from clutter_env.learning.skills.fitting import FitConfig, fit
from clutter_env.training.skill_examples import LabelledScenes, collect_scenes
from clutter_env.learning.training.run import Run

__all__ = ["clone_skills"]

SCENES_FOLDER = "scenes"
_SCENES_OF_A_FILE = 100


def clone_skills(run: Run, model: Any) -> None:
    """Fit the network of a new model to the good skills of `run.episodes` scenes, the same ones for all seeds of a run.

    The labels are written to the run's directory as they are found; those that are there are not made again.
    """
    assert run.episodes is not None
    config = FitConfig(steps=run.imitation_steps, seed=run.seed)
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:

        def report(step: int, loss: float) -> None:
            """Log the loss of a gradient step."""
            writer.add_scalar("clone/loss", loss, step)

        fit(model.policy.mlp_extractor, _examples(run), config, model.policy.value_net, report)


def _examples(run: Run) -> SkillExamples:
    """The examples from the run's scenes."""
    assert run.episodes is not None
    folder = run.directory / SCENES_FOLDER
    folder.mkdir(exist_ok=True)
    env = run.task.make()
    parts = []
    for start in range(0, run.episodes, _SCENES_OF_A_FILE):
        seeds = range(start, min(run.episodes, start + _SCENES_OF_A_FILE))
        path = folder / f"{seeds[0]}-{seeds[-1]}.npz"
        if not path.exists():
            collect_scenes(env, seeds, np.random.default_rng(start)).save(path)
        parts.append(LabelledScenes.load(path))
    env.close()
    return examples_of(LabelledScenes.joined(parts))
