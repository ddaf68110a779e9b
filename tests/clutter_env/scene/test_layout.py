"""Laws of the random scenes: on the table, apart, at rest, as many as promised."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np
import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError, OptionError
from clutter_env.scene.layout import LAYOUTS, TABLE_HEIGHT, Box, Layout, find_layout, furniture, supports_of
from clutter_env.scene.object_sets import MAX_OBJECTS, SHAPE_SETS, capacity
from clutter_env.simulation.world import SUNK
from planners.scene import Scene

BOX_NAMES = {"table_top", "table_leg_0", "table_leg_1", "table_leg_2", "table_leg_3"}
FRONT_NAMES = {"counter_left", "counter_right", "wall"}
SHELF_NAMES = {"shelf_left", "shelf_right", "shelf_board"}
CHEST_NAMES = {"chest_left", "chest_right", "chest_back", "chest_top"}


def test_every_promised_count_fits_the_default_table() -> None:
    assert capacity(LAYOUTS["paper"], "cylinder") == MAX_OBJECTS


@pytest.mark.parametrize("name", LAYOUTS)
def test_furniture_has_the_names_others_rely_on(name: str) -> None:
    layout = LAYOUTS[name]
    boxes = {box.name: box for box in furniture(layout)}
    expected = BOX_NAMES | (FRONT_NAMES if layout.is_front_only else set())
    expected |= SHELF_NAMES if layout.board_height else set()
    expected |= {"shelf_board_upper"} if layout.second_board_height else set()
    expected |= {"shelf_board_top"} if layout.third_board_height else set()
    expected |= CHEST_NAMES if layout.has_drawers else set()
    expected |= {"chest_divider_0", "chest_divider_1"} if layout.opens == "drawers" else set()
    if name == "fridge":
        expected = {one for one in expected if "leg" not in one} | {"table_base"}
    expected |= {box.name for box in layout.boxes}
    assert set(boxes) == expected
    top = boxes["table_top"]
    assert top.position[2] + top.half_extents[2] == pytest.approx(TABLE_HEIGHT)
    if layout.is_front_only:
        counter = boxes["counter_left"]
        assert counter.position[2] + counter.half_extents[2] == pytest.approx(TABLE_HEIGHT)
        assert counter.half_extents[0] == top.half_extents[0]


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_model_declares_the_supports_of_its_layout(name: str) -> None:
    env = RetrieveEnv(num_objects=1, layout=name)
    others = ("counter_left", "counter_right") if LAYOUTS[name].is_front_only else ()
    boards = {"two_boards": ("shelf_board",), "fridge": ("shelf_board", "shelf_board_upper")}
    expected = LAYOUTS[name].supports or ("table_top", *others, *boards.get(name, ()))
    if LAYOUTS[name].opens == "drawer":  # the table, where it is in front of the chest
        before = ("table_top",) if LAYOUTS[name].front else ()
        expected = ("drawer_floor", *before, *others, "chest_top")
    if LAYOUTS[name].opens == "drawers":
        floors = tuple(f"{side}_drawer_floor" for side in ("left", "middle", "right"))
        expected = (*floors, *others, "chest_top")
    assert supports_of(LAYOUTS[name]) == expected
    assert Scene.from_mujoco(env.model, env.data, env.robot, support=env.support_name).supports == expected


@pytest.mark.parametrize(
    "supports",
    [("counter_left",), ("table_top", "desk"), "table_top", 3, (), ("table_top", ["desk"]), ("table_top", "step")],
)
def test_supports_are_boxes_within_reach_and_the_table_is_the_first(supports: Any) -> None:
    step = Box("step", (1.0, 0.0, 0.1), (0.2, 0.2, 0.1))
    with pytest.raises(ConfigError, match=r"supports=.*'table_top' first; valid names: table_top, counter_left"):
        Layout("own", 0.7, 1.0, boxes=(step,), supports=supports)


def test_a_layout_of_its_own_with_a_support_of_its_own_goes_through_json() -> None:
    side = Box("side_table", (0.0, 1.0, 0.375), (0.3, 0.2, 0.375))
    layout = Layout("own", 0.7, 1.0, is_front_only=False, boxes=(side,), supports=("table_top", "side_table"))
    assert supports_of(find_layout(json.loads(json.dumps(asdict(layout))))) == layout.supports


@pytest.mark.parametrize(("name", "shapes"), [(name, SHAPE_SETS[i % 3]) for i, name in enumerate(LAYOUTS)])
def test_objects_stand_still_and_the_robot_is_clear(name: str, shapes: str) -> None:
    env = RetrieveEnv(num_objects=min(20, capacity(LAYOUTS[name], shapes)), layout=name, shapes=shapes)
    rest = np.zeros(env.action_space.shape)
    rest[-1] = 1.0
    for seed in range(3):
        env.reset(seed=seed)
        assert env.data.ncon == 0, "robot and objects touch nothing at the start"
        assert (env.data.tree_asleep[1:] >= 0).all()
        for _ in range(3):
            env.step(rest)
        assert np.array_equal(env.measurements.poses[:, :2], env.world.scene.positions)
        scene = env.world.scene
        sunk = SUNK * (scene.levels > 0) if LAYOUTS[name].has_drawers else 0.0
        heights = TABLE_HEIGHT + scene.levels + scene.half_extents[:, 2] - sunk
        assert np.array_equal(env.measurements.poses[:, 2], heights)


def test_refitted_bodies_are_those_of_a_compiled_model() -> None:
    """The numbers written at a reset against a model compiled with the same sizes from scratch."""
    env = RetrieveEnv(num_objects=8, shapes="mixed")
    env.reset(seed=6)
    scene, index = env.world.scene, env.world.index
    spec = mujoco.MjSpec()
    for slot in range(8):
        x, y, z = scene.half_extents[slot]
        body = spec.worldbody.add_body(name=str(slot), pos=[0, 0, float(slot)])
        body.add_freejoint()
        kind = mujoco.mjtGeom.mjGEOM_BOX if scene.is_box[slot] else mujoco.mjtGeom.mjGEOM_CYLINDER
        size = [x, y, z] if scene.is_box[slot] else [x, z, 0]
        body.add_geom(type=kind, size=size, mass=scene.masses[slot])
    compiled = spec.compile()
    bodies = index.object_bodies
    principal = np.sort(env.model.body_inertia[bodies], axis=1)
    assert np.allclose(principal, np.sort(compiled.body_inertia[1:], axis=1), rtol=1e-9)
    assert np.allclose(env.model.body_mass[bodies], compiled.body_mass[1:])
    assert np.allclose(env.model.body_invweight0[bodies], compiled.body_invweight0[1:], rtol=1e-9)
    assert np.allclose(env.model.dof_invweight0[index.object_dof], compiled.dof_invweight0, rtol=1e-9)
    assert np.allclose(env.model.geom_rbound[index.object_geoms], compiled.geom_rbound)
    assert np.allclose(env.model.geom_aabb[index.object_geoms], compiled.geom_aabb)
    assert np.allclose(env.model.dof_length[index.object_dof], compiled.dof_length)
    assert (env.model.body_ipos[bodies] == 0).all()


@pytest.mark.parametrize(("object_set", "shapes"), [("standard", "mixed"), ("lying", "mixed")])
def test_constants_of_the_objects_are_those_that_mujoco_derives(object_set: str, shapes: str) -> None:
    """All fields of the model against `mj_setConst`, but for what only cameras and lights that track a body use."""
    env = RetrieveEnv(num_objects=10, shapes=shapes, object_set=object_set)
    env.reset(seed=6)
    env.reset(seed=7)
    model = env.model
    names = [name for name in dir(model) if isinstance(getattr(model, name, None), np.ndarray)]
    ours = {name: getattr(model, name).copy() for name in names}
    model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for name in set(names) - {"cam_poscom0", "light_poscom0"}:
        assert np.allclose(ours[name], getattr(model, name), rtol=1e-14, atol=0, equal_nan=True), name


def test_colours_are_distinct_and_only_the_target_is_red() -> None:
    env = RetrieveEnv(num_objects=60)
    env.reset(seed=0)
    colours = env.model.geom_rgba[env.world.index.object_geoms, :3]
    assert len({tuple(colour) for colour in colours}) == 60
    redness = colours[:, 0] - colours[:, 1:].max(axis=1)
    assert int(redness.argmax()) == env.target_slot
    others = np.delete(redness, env.target_slot)
    assert redness.max() - others.max() > 0.15


def test_the_second_row_stands_on_the_board_and_is_lifted_from_there() -> None:
    env = RetrieveEnv(num_objects=6, layout="two_boards")
    env.reset(seed=0)
    board = next(box for box in furniture(LAYOUTS["two_boards"]) if box.name == "shelf_board")
    top = board.position[2] + board.half_extents[2]
    poses, scene = env.world.measure().poses, env.world.scene
    bottoms = poses[:, 2] - scene.half_extents[:, 2]
    assert np.allclose(bottoms[::2], TABLE_HEIGHT)
    assert np.allclose(bottoms[1::2], top)
    for target in ("object_00", "object_01"):
        env.reset(seed=0, options={"target": target})
        assert env._monitor.lift == pytest.approx(0.0, abs=1e-6)


def test_described_objects_stand_in_the_row_that_is_asked_for() -> None:
    env = RetrieveEnv(num_objects=2, layout="two_boards")
    can = {"shape": "cylinder", "radius": 0.03, "height": 0.15, "position": (0.0, 0.0)}
    env.reset(options={"objects": [can, can | {"row": 1}]})
    assert env.world.scene.levels.tolist() == list(LAYOUTS["two_boards"].levels)
    with pytest.raises(OptionError, match="overlap"):
        env.reset(options={"objects": [can, can]})
    with pytest.raises(OptionError, match=r"row=2 .* from 0 to 1"):
        env.reset(options={"objects": [can | {"row": 2}]})
