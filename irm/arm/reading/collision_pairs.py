"""Pairs of bodies of a MuJoCo model that may collide with each other."""

from __future__ import annotations

import mujoco
import numpy as np

__all__ = ["body_name", "self_collision_pairs"]


def self_collision_pairs(model: mujoco.MjModel, base: int) -> tuple[tuple[str, str], ...]:
    """Names of the pairs of bodies at and below the body `base` whose geoms the model lets collide.

    As in MuJoCo: by `contype` and `conaffinity`, not within one rigid body, not a body with its parent, and not a pair
    that the model excludes.
    """
    robot = [body for body in range(model.nbody) if _is_below(model, body, base)]
    excluded = {tuple(sorted(divmod(int(pair), 1 << 16))) for pair in model.exclude_signature}
    pairs = []
    for k, first in enumerate(robot):
        for second in robot[k + 1 :]:
            rigid, parents = model.body_weldid[[first, second]], model.body_parentid
            is_parent = (
                model.body_weldid[parents[rigid[0]]] == rigid[1] or model.body_weldid[parents[rigid[1]]] == rigid[0]
            )
            kept = rigid[0] != rigid[1] and not (is_parent and rigid.all()) and (first, second) not in excluded
            if kept and _may_touch(model, first, second):
                pairs.append((body_name(model, first), body_name(model, second)))
    return tuple(pairs)


def body_name(model: mujoco.MjModel, body: int) -> str:
    """The name of a body, or its number if it has none."""
    return str(model.body(body).name) or f"body {body}"


def _is_below(model: mujoco.MjModel, body: int, base: int) -> bool:
    while body not in (base, 0):
        body = int(model.body_parentid[body])
    return body == base


def _may_touch(model: mujoco.MjModel, first: int, second: int) -> bool:
    """Whether some geom of one body may collide with some geom of the other."""
    masks = []
    for body in (first, second):
        geoms = slice(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
        masks.append((model.geom_contype[geoms], model.geom_conaffinity[geoms]))
    (type_1, affinity_1), (type_2, affinity_2) = masks
    return bool(np.any(type_1[:, None] & affinity_2) or np.any(affinity_1[:, None] & type_2))
