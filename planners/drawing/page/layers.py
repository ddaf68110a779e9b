"""What a plan rests on, as values of a page: regions, candidates, base poses of the map, paths of the gripper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planners.drawing.choices import Choice, choices_of
from planners.drawing.page.arrays import ArrayBlock
from planners.drawing.region import DrawnSurface
from planners.grasping.base_placement import MapPlacer, inverse_map
from planners.motion.arm import tcp_pose
from planners.motion.trajectory import Phase
from planners.scene import RobotState
from planners.tamp.solution import BoundAction, Solution

__all__ = ["plan_values"]

_SKILLS = {"MoveBase": "drive", "PickUp": "pick", "PutDownGeneral": "place", "PutDownForClearance": "place"}
_CONTACTS = ("close", "open")
"""Phases that begin where the gripper closes on an object or lets it go."""
_BASES = 48
"""Base poses of the map shown for a gripper pose at most, best first."""
_STRIDE = 2
"""Samples of a trajectory between two points of a path."""
_NGR1, _NGR2, _OUTSIDE = 1, 2, 4
"""Bits of a cell."""


def plan_values(plan: Solution, arrays: ArrayBlock) -> dict[str, Any]:
    """The actions of a plan and the choices of its clearance locations.

    Args:
        plan: with actions.
        arrays: gets regions, candidates, base poses and paths.
    """
    first = plan.actions[0].scene
    views = {action.scene.robot.arm_name: action.scene for action in plan.actions}
    placers = {arm: MapPlacer.of_scene(inverse_map(scene.robot), scene) for arm, scene in views.items()}
    return {
        "strategy": plan.strategy.name,
        "clearances": list(plan.clearances),
        "base_radius": first.robot.base_radius,
        "actions": [_action(action, placers[action.scene.robot.arm_name], arrays) for action in plan.actions],
        "choices": [_choice(choice, arrays) for choice in choices_of(plan)],
    }


def _action(action: BoundAction, placer: MapPlacer, arrays: ArrayBlock) -> dict[str, Any]:
    robot, trajectory = action.scene.robot, action.trajectory
    states = [RobotState(*row) for row in zip(trajectory.base, trajectory.q, trajectory.finger_position, strict=True)]
    kept = [*states[:-1:_STRIDE], states[-1]]
    contact = next((phase for phase in trajectory.phases if phase.name in _CONTACTS), None)
    return {
        "kind": _SKILLS.get(action.name, "other"),
        "name": action.name,
        "args": list(action.args),
        "object": action.target,
        "because": action.obstructed,
        "duration": round(trajectory.duration, 2),
        "path": arrays.add([tcp_pose(robot, state)[:3, 3] for state in kept]),
        "base_path": arrays.add(np.array([state.base for state in kept])),
        "bases": None if contact is None else arrays.add(_bases(action, contact, placer)),
    }


def _bases(action: BoundAction, contact: Phase, placer: MapPlacer) -> NDArray[np.float64]:
    """Base poses (k, 3) from which the map reaches the gripper's pose at a contact, and the planned one first."""
    sample = action.trajectory.sample(contact.start)
    T = tcp_pose(action.scene.robot, RobotState(sample.base, sample.q, sample.finger_position))
    yaw, pitch = math.atan2(-T[0, 1], T[1, 1]), math.atan2(-T[2, 0], T[2, 2])
    found, _ = placer.bases(np.array([(*T[:3, 3], yaw, pitch)]), _BASES)
    return np.vstack((sample.base, found))


def _choice(choice: Choice, arrays: ArrayBlock) -> dict[str, Any]:
    picture = choice.picture
    allowed = {tuple(place) for place in picture.ordered}
    refused = [place for place in picture.candidates if tuple(place) not in allowed]
    return {
        "object": choice.name,
        "surfaces": [_surface(surface, arrays) for surface in picture.surfaces],
        "ordered": arrays.add(_on_surfaces(picture.surfaces, picture.ordered)),
        "refused": arrays.add(_on_surfaces(picture.surfaces, refused)),
        "chosen": None if picture.chosen is None else [float(value) for value in picture.chosen],
        "radius": next(body.radius for body in picture.bodies if body.name == choice.name),
    }


def _surface(surface: DrawnSurface, arrays: ArrayBlock) -> dict[str, Any]:
    """The cells of a support: x along the rows, y along the columns of a picture of bytes."""
    grid, region = surface.grid, surface.region
    cells = _NGR1 * region.ngr1.astype(np.uint8) + _NGR2 * region.ngr2.astype(np.uint8)
    if surface.in_work is not None:
        cells += _OUTSIDE * (~surface.in_work).astype(np.uint8)
    return {
        "extent": [float(edge) for edge in grid.extent],
        "height": grid.height,
        "shape": list(grid.shape),
        "cells": arrays.add(cells, "uint8"),
    }


def _on_surfaces(surfaces: Sequence[DrawnSurface], places: ArrayLike) -> NDArray[np.float64]:
    """Places (n, 2) with the height of the surface that each lies on: (n, 3) [m]."""
    points = np.asarray(places, dtype=float).reshape(-1, 2)
    heights = np.full(len(points), surfaces[0].grid.height)
    for surface in surfaces:
        x_low, x_high, y_low, y_high = surface.grid.extent
        inside = (points >= (x_low, y_low)).all(axis=1) & (points <= (x_high, y_high)).all(axis=1)
        heights[inside] = surface.grid.height
    return np.column_stack((points, heights))
