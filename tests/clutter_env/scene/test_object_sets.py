"""Sets of random objects: sizes, room, rest; and the scenes of old seeds, which stay what they were."""

from __future__ import annotations

import hashlib
from typing import Any

import mujoco
import numpy as np
import pytest

from clutter_env.config import EnvConfig
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.scene.layout import LAYOUTS, OBJECT_GAP, TABLE_HEIGHT, Layout
from clutter_env.scene.object_sets import OBJECT_SETS, SHAPE_SETS, capacity
from clutter_env.scene.random_scene import sample_scene

CASES = [(name, shapes) for name in OBJECT_SETS for shapes in SHAPE_SETS]
NAMED = ("paper", "wide", "dense", "shelf", "island")


@pytest.mark.parametrize(("name", "shapes"), CASES)
def test_full_tables_keep_sizes_gaps_and_edges(name: str, shapes: str) -> None:
    objects = OBJECT_SETS[name]
    for seed, table in enumerate(LAYOUTS.values()):
        count = capacity(table, shapes, objects)
        if not count:
            assert objects.kinds, "bottles do not fit a drawer"
            assert table.has_drawers
            continue
        scene = sample_scene(np.random.default_rng(seed), table, count, shapes, objects)
        half = scene.standing_extents
        radii = np.where(scene.is_angular, np.hypot(half[:, 0], half[:, 1]), half[:, 0])
        apart = np.linalg.norm(scene.positions[:, None] - scene.positions, axis=-1) - radii[:, None] - radii
        in_same_row = scene.levels[:, None] == scene.levels
        assert apart[in_same_row & ~np.eye(count, dtype=bool)].min(initial=np.inf) >= OBJECT_GAP
        assert set(scene.levels) == set(table.levels)
        assert 0 <= scene.target < count
        assert (np.abs(scene.positions) + radii[:, None] <= np.array([table.depth, table.width]) / 2 + 0.006).all()
        low, high = objects.heights_on(table)
        assert ((2 * half[:, 2] >= low) & (2 * half[:, 2] <= high)).all()
        assert (2 * half[:, 2]).max() < table.headroom
        assert ((scene.masses >= objects.mass[0]) & (scene.masses <= objects.mass[1])).all()


@pytest.mark.parametrize(("name", "shapes"), CASES)
def test_objects_are_at_rest(name: str, shapes: str) -> None:
    """Awake, for 1 s: nothing moves by more than 1 mm."""
    env = RetrieveEnv(num_objects=12, shapes=shapes, object_set=name)
    for seed in range(2):
        env.reset(seed=seed)
        before = env.measurements.poses[:, :3].copy()
        env.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        idle = env.joint_action(env.data.qpos[env.world.index.drive_qpos], env.robot.max_opening)
        for _ in range(20):
            env.step(idle)
        assert np.abs(env.measurements.poses[:, :3] - before).max() < 1e-3
        env.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    assert (env.measurements.poses[:, 2] > TABLE_HEIGHT).all()


def test_invalid_sets_are_refused_with_the_valid_ones() -> None:
    with pytest.raises(ConfigError, match="'standard', 'low', 'lying', 'tall', 'heavy'"):
        EnvConfig(object_set="small")
    with pytest.raises(ConfigError, match="object_set='lying': at most"):
        EnvConfig(object_set="lying", shapes="box", num_objects=40)


def test_scenes_of_old_seeds_stay_what_they_were() -> None:
    digest = hashlib.sha256()
    for name in NAMED:
        for shapes in ("cylinder", "box", "mixed"):
            for seed in range(20):
                scene: Any = sample_scene(np.random.default_rng(seed), LAYOUTS[name], 15, shapes)
                for part in ("half_extents", "is_box", "positions", "yaws", "masses", "base"):
                    digest.update(getattr(scene, part).tobytes())
                digest.update(bytes([scene.target]))
    assert digest.hexdigest() == "3aff94d3fb59511ae31856b59ea1bde73995f07cc2f32a9350b2b415b3c2f72e"


def place_plainly(rng: np.random.Generator, layout: Layout, radii: np.ndarray) -> np.ndarray:
    """One attempt: batches of candidates, all tested against all objects placed so far."""
    high = np.array([layout.depth, layout.width]) / 2 - OBJECT_SETS["standard"].edge_margin
    positions = np.empty((len(radii), 2))
    for index, radius in enumerate(radii):
        while True:
            candidates = rng.uniform(-high, high, (128 if index > 10 else 8, 2))
            offset = candidates[:, None, :] - positions[:index]
            is_free = ((offset**2).sum(axis=2) > (radii[:index] + (radius + OBJECT_GAP)) ** 2).all(axis=1)
            if is_free.any():
                positions[index] = candidates[is_free.argmax()]
                break
    return positions


@pytest.mark.parametrize("count", [0, 1, 11, 20, 40, 60])
@pytest.mark.parametrize("seed", range(2))
def test_positions_equal_those_of_a_plain_sampler(count: int, seed: int) -> None:
    layout = LAYOUTS["paper"]
    scene = sample_scene(np.random.default_rng(seed), layout, count)
    rng = np.random.default_rng(seed)
    for _ in range(4):  # the sizes, drawn before the positions
        rng.random(count)
    expected = place_plainly(rng, layout, scene.half_extents[:, 0])
    assert np.array_equal(scene.positions, expected)
