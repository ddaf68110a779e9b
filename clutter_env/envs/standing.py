"""Base pose of a robot with a fixed base in a scene, found with the planner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clutter_env.errors import OptionError
from clutter_env.scene.table_scene import TableScene
from clutter_env.simulation.world import World
from planners import CollisionWorld, Scene, SceneError, standing_place, validate


def stand(world: World, scene: TableScene, base: tuple[float, float, float] | None) -> TableScene:
    """The scene with the base at the given pose, or where its arm can take the target and most of the other objects.

    If it could take nothing from any pose, the base stays at the scene's pose.

    Args:
        world: in which the scene is set up.
        scene: objects and target.
        base: x, y [m], yaw [rad], None for any.

    Raises:
        OptionError: the base would collide.
    """
    world.reset(scene)
    snapshot = Scene.from_mujoco(world.model, world.data, world.robot)
    if base is None:
        found = standing_place(snapshot, (world.names[scene.target],) if scene.target >= 0 else ())
        return scene if found is None else replace(scene, base=found)
    wanted, robot = np.array(base), world.robot.holonomic()
    try:
        validate(CollisionWorld.from_scene(replace(snapshot, robot=robot, state=replace(snapshot.state, base=wanted))))
    except SceneError as problem:
        raise OptionError(f"option 'base': {problem}") from None
    return replace(scene, base=wanted)
