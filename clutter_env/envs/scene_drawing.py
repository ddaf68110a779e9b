"""The scene of a new episode: drawn at random, described by the user, or one whose target is obstructed."""

from __future__ import annotations

import numpy as np

from clutter_env.config import EnvConfig
from clutter_env.envs.reset_options import ResetOptions, explicit_scene
from clutter_env.errors import OptionError
from clutter_env.scene.layout import Layout
from clutter_env.scene.obstruction import UNREACHABLE, count_blockers, side_approaches
from clutter_env.scene.random_scene import sample_scene
from clutter_env.scene.table_scene import TableScene

__all__ = ["MAX_DRAWS", "draw_scene"]

MAX_DRAWS = 1000
"""Random scenes that are drawn until one has an obstructed target."""


def draw_scene(rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions) -> TableScene:
    """The scene that the options describe, random where they leave it open.

    Raises:
        OptionError: see `explicit_scene`; there is no object of the wanted target's name; or `obstructed` is asked for
            and the wanted target, or every object, can be grasped from the side.
    """
    least = int(config.obstructed if options.obstructed is None else options.obstructed)
    if least:
        return _draw_obstructed(rng, layout, config, options, least)
    scene = _draw_any(rng, layout, config, options)
    wanted = options.target_index(scene.num_objects)
    return scene if wanted is None else scene.with_target(wanted)


def _draw_any(rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions) -> TableScene:
    if options.objects is None:
        return sample_scene(rng, layout, config.num_objects, config.shapes, config.find_object_set())
    return explicit_scene(rng, layout, options.objects, config.num_objects)


def _draw_obstructed(
    rng: np.random.Generator, layout: Layout, config: EnvConfig, options: ResetOptions, least: int
) -> TableScene:
    """A scene whose target has at least `least` objects in the way; random scenes are drawn until there is one."""
    if problem := config.obstruction_problem(least):
        raise OptionError(f"option 'obstructed': {problem}")
    robot = config.find_robot()
    is_random = options.objects is None and options.target is None
    for _ in range(MAX_DRAWS if is_random else 1):
        scene = _draw_any(rng, layout, config, options)
        blockers = count_blockers(side_approaches(robot.full_name), layout, scene, robot.max_opening)
        wanted = options.target_index(scene.num_objects)
        if wanted is not None and blockers[wanted] >= least:
            return scene.with_target(wanted)
        if wanted is not None:
            raise OptionError(f"option 'target': {options.target} {_unobstructed(blockers[wanted], least)}")
        if len(obstructed := np.flatnonzero(blockers >= least)):
            return scene.with_target(int(obstructed[rng.integers(len(obstructed))]))
    what = f"none of {MAX_DRAWS} random scenes has" if is_random else "the scene does not have"
    raise OptionError(
        f"option 'obstructed': {what} a target with {least} or more objects in the way; ask for more objects"
    )


def _unobstructed(blockers: int, least: int) -> str:
    if blockers == UNREACHABLE:
        return "is not obstructed but out of reach: no side grasp reaches it, whatever is moved"
    return f"is not obstructed: a side grasp has {blockers} objects in its way, not {least} or more"
