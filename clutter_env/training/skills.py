"""Cloning of the skills that lead to the target, before reinforcement learning improves the clone."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch.utils.tensorboard import SummaryWriter

from clutter_env.training.run import Run
from clutter_env.training.settings import PPO
from clutter_env.training.skill_examples import LabelledScenes, SkillExamples, collect_scenes
from clutter_env.training.skill_fit import SkillFitConfig, fit_skills

_SCENES_FOLDER = "scenes"
_SCENES_OF_A_FILE = 100


def clone_skills(run: Run, settings: PPO, model: Any) -> None:
    """Fit the network of a new model to the good skills of `clone_scenes` scenes, the same ones for all seeds of a run.

    The labels are written to the run's directory as they are found; those that are there are not made again.
    """
    folder = run.directory / _SCENES_FOLDER
    folder.mkdir(exist_ok=True)
    env = run.task.make()
    parts = []
    for start in range(0, settings.clone_scenes, _SCENES_OF_A_FILE):
        seeds = range(start, min(settings.clone_scenes, start + _SCENES_OF_A_FILE))
        path = folder / f"{seeds[0]}-{seeds[-1]}.npz"
        if not path.exists():
            collect_scenes(env, seeds, np.random.default_rng(start)).save(path)
        parts.append(LabelledScenes.load(path))
    env.close()
    config = SkillFitConfig(steps=settings.clone_steps, seed=run.seed)
    with SummaryWriter(str(run.directory / "tensorboard")) as writer:
        examples = SkillExamples.of(LabelledScenes.joined(parts))
        report = lambda step, loss: writer.add_scalar("clone/loss", loss, step)  # noqa: E731
        fit_skills(model.policy.mlp_extractor, examples, config, model.policy.value_net, report)
