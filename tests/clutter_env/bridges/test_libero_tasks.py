"""LIBERO's goals in a small world with names like LIBERO's; LIBERO itself is needed by the last test alone."""

from __future__ import annotations

import os
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from clutter_env.bridges import libero_tasks
from clutter_env.bridges.libero_tasks import LiberoTask
from clutter_env.bridges.remote import BridgeError, Remote
from planners import Scene, Solution, TampExpert, goals
from planners.facts import At
from planners.goals import Goal, Open, Turned
from tests.planners.containers import box_walls, round_walls

TOP, ARM = 0.9, 0.912
"""[m] height of the table, and of what the arm is bolted to."""
HOME = (0.0, -0.161, 0.0, -2.4446, 0.0, 2.2267, 0.7854)

KITCHEN = f"""
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="floor" type="plane" size="3 3 1"/>
  <body name="table" pos="0 0 {TOP / 2}">
    <geom name="table_collision" type="box" size="0.5 0.6 {TOP / 2}"/>
    <site name="table_right_region" type="box" size="0.05 0.04 0.007" pos="-0.1 0.2 {TOP / 2}"/>
  </body>
  <body name="can_1_main" pos="-0.1 -0.25 {TOP + 0.0401}"><freejoint name="can_1_joint0"/>
    <geom name="can_1_g1" type="cylinder" size="0.025 0.04" mass="0.05"/></body>
  <body name="box_1_main" pos="-0.15 0 {TOP + 0.0201}"><freejoint name="box_1_joint0"/>
    <geom name="box_1_g1" type="box" size="0.03 0.03 0.02" mass="0.05"/></body>
  <body name="basket_1_main" pos="-0.05 0.35 {TOP + 0.0001}"><freejoint name="basket_1_joint0"/>
    {box_walls(0.14, 0.14, 0.06)}
    <site name="basket_1_contain_region" type="box" size="0.07 0.07 0.03" pos="0 0 0.04"/></body>
  <body name="cabinet_1_main" pos="0.2 0 {TOP}">
    <geom name="cabinet_1_left" type="box" size="0.1 0.005 0.06" pos="0 0.105 0.06"/>
    <geom name="cabinet_1_right" type="box" size="0.1 0.005 0.06" pos="0 -0.105 0.06"/>
    <geom name="cabinet_1_top" type="box" size="0.1 0.11 0.005" pos="0 0 0.125"/>
    <site name="cabinet_1_top_side" type="box" size="0.09 0.1 0.0015" pos="0 0 0.13"/>
    <body name="cabinet_1_drawer" pos="-0.02 0 0.05">
      <joint name="cabinet_1_level" type="slide" axis="1 0 0" range="-0.16 0.01" damping="5"/>
      <geom name="cabinet_1_front" type="box" size="0.005 0.095 0.04" pos="-0.1 0 0" mass="0.3"/>
      <geom name="cabinet_1_back" type="box" size="0.005 0.095 0.03" pos="0.09 0 0" mass="0.3"/>
      <geom name="cabinet_1_side" type="box" size="0.09 0.004 0.03" pos="0 0.09 0" mass="0.3"/>
      <geom name="cabinet_1_other" type="box" size="0.09 0.004 0.03" pos="0 -0.09 0" mass="0.3"/>
      <geom name="cabinet_1_bottom" type="box" size="0.09 0.09 0.004" pos="0 0 -0.03" mass="0.3"/>
      <geom name="cabinet_1_handle" type="box" size="0.006 0.04 0.008" pos="-0.13 0 0" mass="0.1"/>
      <site name="cabinet_1_top_region" type="box" size="0.08 0.08 0.03"/>
    </body>
  </body>
  <body name="stove_1_main" pos="-0.3 -0.4 {TOP}">
    <geom name="stove_1_plate" type="box" size="0.1 0.1 0.01" pos="0.2 0 0.01"/>
    <site name="stove_1_cook_region" type="box" size="0.08 0.08 0.002" pos="0.2 0 0.012"/>
    <body name="stove_1_button" pos="0 0 0.01">
      <joint name="stove_1_button" type="hinge" axis="0 0 1" range="-0.005 2.1" damping="1"/>
      <geom name="stove_1_knob" type="box" size="0.012 0.03 0.02" pos="0 0 0.02" mass="0.1"/></body>
  </body>
  <body name="pan_1_main" pos="0.33 0.3 {TOP + 0.0201}"><freejoint name="pan_1_joint0"/>
    <geom name="pan_1_g1" type="cylinder" size="0.06 0.02" mass="0.3"/>
    <geom name="pan_1_g2" type="box" size="0.01 0.08 0.01" pos="0 0.14 0" mass="0.02"/></body>
  <body name="rack_1_main" pos="0.35 -0.4 {TOP}">
    <geom name="rack_1_sheet" type="box" size="0.1 0.08 0.004" pos="0 0 0.1" euler="0.5 0 0"/>
    <geom name="rack_1_foot" type="box" size="0.1 0.08 0.004" pos="0 0 0.004"/>
    <site name="rack_1_top_region" type="box" size="0.1 0.05 0.002" pos="0 0.02 0.12" euler="0.5 0 0"/>
  </body>
</worldbody></mujoco>"""

ROOTS = {name: f"{name}_main" for name in ("can_1", "box_1", "basket_1", "cabinet_1", "stove_1", "rack_1", "pan_1")}
SITES = {
    "table_right_region": (None, []),
    "basket_1_contain_region": ("basket_1", []),
    "cabinet_1_top_side": ("cabinet_1", []),
    "cabinet_1_top_region": ("cabinet_1", ["cabinet_1_level"]),
    "stove_1_cook_region": ("stove_1", []),
    "rack_1_top_region": ("rack_1", []),
}
RANGES = {
    "cabinet_1": {"default_open_ranges": [-0.16, -0.14], "default_close_ranges": [0.0, 0.005]},
    "stove_1": {"default_turnon_ranges": [0.5, 2.1], "default_turnoff_ranges": [-0.005, 0.0]},
}


class Recorded:
    """Answers as LIBERO's worker does, of a world in which nothing moves."""

    def __init__(self, *facts: tuple[str, ...]) -> None:
        spec = mujoco.MjSpec.from_string(KITCHEN)
        arm = mujoco.MjSpec.from_file(str(libero_tasks._panda().mjcf_path))
        spec.attach(arm, prefix="robot0_", frame=spec.worldbody.add_frame(pos=[-0.83, 0.0, 0.0]))
        model = spec.compile()
        qpos = model.qpos0.copy()
        qpos[model.joint("robot0_lift_joint").qposadr[0]] = ARM - 0.5
        for number, value in enumerate(HOME, start=1):
            qpos[model.joint(f"robot0_joint{number}").qposadr[0]] = value
        for name in ("robot0_finger_joint1", "robot0_finger_joint2"):
            qpos[model.joint(name).qposadr[0]] = 0.04
        qpos[model.joint("robot0_finger_joint2").qposadr[0]] *= -1  # as robosuite counts it
        names = [model.joint(k).name for k in range(model.njnt)]
        self.start: dict[str, Any] = {
            "xml": spec.to_xml(),
            "root": "robot0_base",
            "home": HOME,
            "base": (-0.66, 0.0, ARM),
            "joints": {name: int(model.joint(name).qposadr[0]) for name in names},
            "arm": [f"robot0_joint{number}" for number in range(1, 8)],
            "fingers": ["robot0_finger_joint1", "robot0_finger_joint2"],
            "most": [0.05] * 3 + [0.5] * 3,
            "stiffness": 150.0,
            "lag": 2 / np.sqrt(150.0),
            "strength": [80.0] * 5 + [12.0] * 2,
            "site": "robot0_tcp",
            "elbow": HOME,
            "language": "do it",
            "goal": facts,
            "roots": ROOTS,
            "object_joints": {"cabinet_1": ["cabinet_1_level"], "stove_1": ["stove_1_button"]},
            "ranges": RANGES,
            "sites": {
                name: {"parent": parent, "joints": joints, "size": model.site(name).size.tolist()}
                for name, (parent, joints) in SITES.items()
            },
            "qpos": qpos.tolist(),
            "is_success": False,
            "is_moving": False,
            "done": False,
        }

    def __call__(self, *_: Any, **__: Any) -> dict[str, Any]:
        return self.start


class Falling(Recorded):
    """A world in which the can falls onto the table within some steps."""

    def __init__(self, steps: int, *facts: tuple[str, ...]) -> None:
        super().__init__(*facts)
        self._left, self._height = steps, self.start["joints"]["can_1_joint0"] + 2
        self.start["qpos"][self._height] += 0.02 * steps
        self.start["is_moving"] = True

    def __call__(self, call: str, **_: Any) -> dict[str, Any]:
        if call == "step" and self._left:
            self._left -= 1
            self.start["qpos"][self._height] -= 0.02
            self.start["is_moving"] = self._left > 0
        return self.start


def task(*facts: tuple[str, ...]) -> LiberoTask:
    return LiberoTask(cast(Remote, Recorded(*facts)), "libero_goal", 3)


@pytest.mark.parametrize(
    ("fact", "goal"),
    [
        (("on", "can_1", "box_1"), goals.on("can_1_main", "box_1_main")),
        (("in", "can_1", "basket_1_contain_region"), goals.inside("can_1_main", "basket_1_main")),
        (("in", "can_1", "cabinet_1_top_region"), goals.inside("can_1_main", "cabinet_1_drawer")),
        (("close", "cabinet_1_top_region"), goals.closed("cabinet_1_drawer")),
        (("turnoff", "stove_1"), goals.closed("stove_1_button")),
        (
            ("on", "can_1", "table_right_region"),
            goals.on("can_1_main", "table_collision") & goals.at("can_1_main", (-0.1, 0.2), tolerance=0.03),
        ),
        (
            ("on", "can_1", "cabinet_1_top_side"),
            goals.on("can_1_main", "cabinet_1_top") & goals.at("can_1_main", (0.2, 0.0), tolerance=0.08),
        ),
    ],
    ids=str,
)
def test_a_fact_of_liberos_is_a_goal(fact: tuple[str, ...], goal: Goal) -> None:
    assert str(task(fact).world.goal) == str(goal)


def test_what_is_opened_or_turned_goes_beyond_what_liberos_check_asks() -> None:
    wanted = task(("open", "cabinet_1_top_region"), ("turnon", "stove_1")).world.goal
    assert wanted is not None
    opened, turned = wanted.openings
    assert isinstance(opened, Open)
    assert isinstance(turned, Turned)
    assert (opened.opening, turned.opening) == ("cabinet_1_drawer", "stove_1_button")
    assert 0.01 - 0.17 * opened.share < -0.14
    assert 0.5 < turned.angle - turned.tolerance < 2.1


def test_what_has_its_origin_far_from_its_middle_goes_where_its_origin_is_in_the_region() -> None:
    """LIBERO's pan has it in the middle of its disc: its handle was put there, and the check never held."""
    wanted = task(("on", "pan_1", "stove_1_cook_region")).world.goal
    assert wanted is not None
    (at,) = (fact for fact in wanted.facts if isinstance(fact, At))
    assert (at.x, at.y) == pytest.approx((-0.1, -0.4 + 0.08), abs=1e-6)
    assert at.yaw == pytest.approx(0.0)
    assert at.tolerance + 0.08 * at.yaw_tolerance < 0.08


def test_two_objects_share_a_region() -> None:
    both = task(("on", "can_1", "stove_1_cook_region"), ("on", "box_1", "stove_1_cook_region")).world
    assert str(both.goal) == str(
        goals.inside("can_1_main", "stove_1_cook_region") & goals.inside("box_1_main", "stove_1_cook_region")
    )
    (region,) = both.regions
    assert region.support == "stove_1_plate"
    assert region.centre == pytest.approx((-0.1, -0.4))
    assert both.more_supports == ("stove_1_plate",)


def test_a_fact_that_is_not_known_is_told() -> None:
    with pytest.raises(BridgeError, match=r"no goal is known for \(above can_1 box_1\)"):
        task(("above", "can_1", "box_1"))
    with pytest.raises(BridgeError, match="nothing is called 'cup_1'; there are can_1, "):
        task(("on", "cup_1", "box_1"))
    with pytest.raises(BridgeError, match="'can_1' has nothing that opens"):
        task(("open", "can_1"))


def test_the_slant_of_a_region_without_a_level_face_is_told() -> None:
    with pytest.raises(BridgeError, match="under the region 'rack_1_top_region': rack_1_sheet slants by 29 degrees"):
        task(("on", "can_1", "rack_1_top_region"))


def test_a_plan_begins_when_all_is_at_rest() -> None:
    """LIBERO's objects fall from up to 1.2 m into their places, which takes longer than the ten steps before."""
    goal = ("on", "can_1", "box_1")
    one = LiberoTask(cast(Remote, Falling(12, goal)), "libero_goal", 3)
    assert one.world.data.body("can_1_main").xpos[2] == pytest.approx(TOP + 0.0401)
    assert (one.steps, len(one.actions)) == (12, 12)
    assert task(goal).steps == 0
    with_end = LiberoTask(cast(Remote, Falling(1000, goal)), "libero_goal", 3)
    assert with_end.steps == libero_tasks.LONGEST_WAIT


def test_what_has_no_part_in_the_goal_does_not_open() -> None:
    """With four drawers and knobs that were tried one by one, a refusal took minutes."""
    assert [one.name for one in _scene(task(("on", "can_1", "box_1"))).openings] == []
    assert [one.name for one in _scene(task(("turnon", "stove_1"))).openings] == ["stove_1_button"]
    assert [one.name for one in _scene(task(("in", "can_1", "cabinet_1_top_region"))).openings] == ["cabinet_1_drawer"]


def test_a_can_of_many_boxes_is_a_cylinder_and_what_is_hollow_or_has_corners_is_not() -> None:
    eighths = "".join(
        f'<geom type="box" size="0.03 0.0124 0.04" quat="{np.cos(turn)} 0 0 {np.sin(turn)}" mass="0.01"/>'
        for turn in np.pi / 16 * np.arange(8)
    )
    spec = mujoco.MjSpec.from_string(
        f"""<mujoco><compiler angle="radian"/><worldbody>
        <body name="can"><freejoint/>{eighths}</body>
        <body name="bowl"><freejoint/>{round_walls(0.05, 0.05)}</body>
        <body name="tray"><freejoint/>{box_walls(0.1, 0.1, 0.05) * 2}</body></worldbody></mujoco>"""
    )
    counts = []
    for name in ("can", "bowl", "tray"):
        libero_tasks._make_round(spec, spec.body(name))
        counts.append(len(spec.body(name).geoms))
    assert counts == [1, 17, 10]
    can = spec.compile().geom("can_round")
    assert can.size[:2] == pytest.approx((0.032, 0.04), abs=0.001)


@pytest.mark.parametrize(
    ("quat", "up"),
    [
        ((0.0, 1.0, 0.0, 0.0), 1.0),
        ((0.5, 0.5, 0.5, 0.5), 0.0),
        ((1.0, 0.0, 0.0, 0.0), 1.0),
        ((0.0, 0.6, 0.8, 0.0), 1.0),
    ],
)
def test_a_box_on_its_head_is_upright_and_as_large_and_one_that_lies_is_not(quat: tuple[float, ...], up: float) -> None:
    """A book that stands on its head fitted into no compartment: it was taken for fallen."""
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><body name="book"><freejoint/>
        <geom name="cover" type="box" size="0.02 0.05 0.08" quat="0.9239 0 0.3827 0"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(spec.compile())
    turn = np.zeros(4)
    mujoco.mju_mulQuat(turn, np.array(quat), np.array((0.9239, 0.0, -0.3827, 0.0)))
    data.qpos[3:] = turn
    before = _spans_in(spec, turn)
    mujoco.mj_kinematics(spec.compile(), data)
    libero_tasks._make_upright(spec.body("book"), data.body("book").xmat.reshape(3, 3))
    after, model = _spans_in(spec, turn), spec.compile()
    assert after == pytest.approx(before, abs=1e-4)
    data = mujoco.MjData(model)
    data.qpos[3:] = turn
    mujoco.mj_kinematics(model, data)
    assert data.geom("cover").xmat[8] == pytest.approx(up, abs=1e-4)
    assert np.linalg.det(data.geom("cover").xmat.reshape(3, 3)) == pytest.approx(1.0)


def _spans_in(spec: mujoco.MjSpec, quaternion: np.ndarray) -> np.ndarray:
    """(3,) [m] half extents of the one geom along the axes of the world."""
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[3:] = quaternion
    mujoco.mj_kinematics(model, data)
    return np.asarray(np.abs(data.geom(0).xmat.reshape(3, 3)) @ model.geom(0).size)


def _scene(one: LiberoTask) -> Scene:
    world = one.world
    return Scene.from_mujoco(world.model, world.data, world.robot, movable=world.object_names)


def test_the_arm_stands_where_liberos_does_and_plans_are_found() -> None:
    one = task(("in", "can_1", "basket_1_contain_region"))
    assert one.world.support_name == "table_collision"
    assert one.limit == 300
    expert = TampExpert(one.world, planner=one.planner, config=one.config)
    expert.reset()
    assert isinstance(expert.solution, Solution)
    assert [action.name for action in expert.solution.actions if action.name != "MoveBase"] == [
        "PickUp",
        "PutDownGeneral",
    ]


@pytest.mark.slow
@pytest.mark.skipif("LIBERO_PYTHON" not in os.environ, reason="LIBERO runs in an environment of its own")
def test_a_task_of_libero_is_solved_by_its_own_check() -> None:
    with Remote(os.environ["LIBERO_PYTHON"], "libero_worker.py") as libero:
        with pytest.raises(BridgeError, match="no suite 'libero_11'"):
            LiberoTask(libero, "libero_11")
        one = LiberoTask(libero, "libero_goal", 1)
        expert = TampExpert(one.world, planner=one.planner, config=one.config)
        expert.reset()
        while not (expert.done or one.world.is_over):
            one.world.step(expert.act())
        assert one.is_solved
        assert one.solved_at is not None
        assert one.limit is not None
        assert one.solved_at <= one.limit
