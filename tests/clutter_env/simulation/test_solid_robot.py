"""The robot meets itself and the ground in physics, exactly where the planner looks for it."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.optimize import least_squares

from assets import ActingJoints, robot as find_robot, robot_contacts
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.simulation.pressing import SUSTAINED_FORCE, Pressing
from tests.clutter_env.simulation.test_pressing import largest_mean, watch

ROBOTS = ["fetch", "pr2", "panda_mobile"]
FIRST_LINKS = {frozenset(("r_shoulder_front", "l_shoulder_front"))}
"""Of PR2's arms: out of each other's reach where one arm stays at home, as the planner has it."""


@cache
def counted(name: str) -> set[frozenset[str]]:
    """Names of the pairs of geoms that the planner counts, of all arms."""
    robot, pairs = find_robot(name), set()
    for one in (robot, *(robot.using(arm.name) for arm in robot.idle_arms)):
        model = mujoco.MjModel.from_xml_path(str(one.mjcf_path))
        names = [model.geom(number).name for number in one.collision_geoms(model)]
        pairs |= {frozenset(names[k] for k in pair) for pair in one.shapes.pairs.tolist()}
    return pairs


@pytest.mark.parametrize("name", ROBOTS)
def test_physics_has_the_pairs_of_the_planner(name: str) -> None:
    env = RetrieveEnv(num_objects=1, robot=name)
    env.reset(seed=0)
    model, data = env.model, mujoco.MjData(env.model)
    robot = find_robot(name)
    own = {model.geom(k).name for k in range(model.ngeom) if model.geom_contype[k] == 2}
    joints = [*robot.drive_joints[3:], *robot.still_joints]
    low, high = np.array([model.joint(joint).range for joint in joints]).T
    rng, met = np.random.default_rng(0), set()
    for q in rng.uniform(low, high, (3000, len(joints))):
        for joint, value in zip(joints, q, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = [frozenset(model.geom(k).name for k in pair) for pair in data.contact.geom.tolist()]
        met |= {pair for pair in pairs if pair <= own}
    assert met <= counted(name) | FIRST_LINKS
    touching = {pair for pair in counted(name) if _can_touch(name, pair)}
    assert len(met) > 0.8 * len(touching), "and nearly all that random configurations reach"


def _can_touch(name: str, pair: frozenset[str]) -> bool:
    """Whether some of many random configurations lets the two geoms touch, with all contacts switched on."""
    return pair in _touching(name)


@cache
def _touching(name: str) -> set[frozenset[str]]:
    robot = find_robot(name)
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    model.geom_conaffinity[:] = model.geom_contype
    model.body_conaffinity[:] = model.body_contype
    data, joints = mujoco.MjData(model), [*robot.drive_joints[3:], *robot.still_joints]
    low, high = np.array([model.joint(joint).range for joint in joints]).T
    found = set()
    for q in np.random.default_rng(0).uniform(low, high, (3000, len(joints))):
        for joint, value in zip(joints, q, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found |= {frozenset(model.geom(k).name for k in pair) for pair in data.contact.geom.tolist()}
    return found


@pytest.mark.parametrize("name", ROBOTS)
def test_random_motions_do_not_lead_through_the_robot(name: str) -> None:
    env = RetrieveEnv(num_objects=1, robot=name)
    env.reset(seed=0)
    alone = mujoco.MjModel.from_xml_path(str(env.robot.mjcf_path))
    data, pairs = mujoco.MjData(alone), robot_contacts(env.robot).pairs.tolist()
    rng, worst = np.random.default_rng(0), []
    for _ in range(60):
        action = rng.uniform(-1, 1, env.action_size)
        action[:3] = -0.3, 0.0, 0.0  # away from the table
        for _ in range(8):
            env.step(action)
        for number in range(alone.njnt):
            joint = alone.joint(number).name
            data.joint(joint).qpos = env.data.joint(joint).qpos
        mujoco.mj_kinematics(alone, data)
        worst.append(max(-mujoco.mj_geomDistance(alone, data, one, other, 0.01, None) for one, other in pairs))
    assert max(worst) < 0.006, "motors at their limits press shapes into each other by no more"
    assert env.info["self_force"] > 0.0


def drive(env: RetrieveEnv, q: np.ndarray, seconds: float) -> dict:
    """Drive the joints of torso and arm towards `q` (1 + n,); the last info."""
    goal = env.world.controller.state.target.copy()
    goal[3:] = q
    for _ in range(round(20 * seconds)):
        *_, info = env.step(env.joint_action(goal, env.robot.max_opening))
    return info


def test_a_hand_that_is_driven_into_the_base_stops_there_and_is_not_clean() -> None:
    """The hand was 144 to 237 mm inside Fetch's base, and `info` said nothing."""
    env = RetrieveEnv(num_objects=1)
    env.reset(seed=0)
    robot = env.robot
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    data, palm, base = mujoco.MjData(alone), alone.geom("palm").id, alone.geom("base").id
    low, high = np.array([(link.lower, link.upper) for link in robot.chain]).T
    rng = np.random.default_rng(1)
    while True:
        q = rng.uniform(low, high)
        for joint, value in zip(robot.drive_joints[3:], q, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(alone, data)
        if mujoco.mj_geomDistance(alone, data, palm, base, 0.5, None) < -0.1:
            break
    info = drive(env, q, 6.0)
    inside = mujoco.mj_geomDistance(env.model, env.data, env.model.geom("palm").id, env.model.geom("base").id, 1, None)
    assert inside > -0.005
    assert info["self_force"] > SUSTAINED_FORCE
    assert not env._monitor.is_clean
    drive(env, np.array(robot.home), 6.0)
    assert not env._monitor.is_clean, "it stays so"


def test_the_hand_stays_above_the_ground() -> None:
    env = RetrieveEnv(num_objects=1)
    env.reset(seed=0)
    down = np.array((0.05, 1.2, 1.4, 0.0, 0.0, 0.0, 0.0, 0.0))
    info = drive(env, down, 8.0)
    lowest = min(env.data.site_xpos[env.world.index.tcp_site][2], env.data.geom("palm").xpos[2])
    assert lowest > 0.0
    assert info["self_force"] > 0.0
    met = [{env.model.geom(k).name for k in pair} for pair in env.data.contact.geom.tolist()]
    assert {"floor", "r_finger"} in met
    assert {"floor", "base"} not in met, "the base stands on wheels that are not drawn"


@pytest.mark.parametrize("name", ROBOTS)
def test_the_home_posture_touches_nothing(name: str) -> None:
    env = RetrieveEnv(num_objects=5, robot=name)
    env.reset(seed=0)
    for _ in range(40):
        *_, info = env.step(env._still_action())
    assert (info["self_force"], info["furniture_force"]) == (0.0, 0.0)


def test_the_base_of_any_robot_pushes_no_harder_than_its_wheels_hold(tmp_path: Path) -> None:
    text = find_robot("fetch").mjcf_path.read_text().replace("-410 410", "-2000 2000")
    (tmp_path / "strong.xml").write_text(text)
    strong = replace(find_robot("fetch"), name="strong", mjcf=str(tmp_path / "strong.xml"))
    env = RetrieveEnv(num_objects=1, robot=strong)
    mass = env.model.body_subtreemass[env.world.index.base_body]
    limits = [env.model.actuator(joint).forcerange[1] for joint in strong.base_joints[:2]]
    assert np.hypot(*limits) == pytest.approx(0.6 * 9.81 * mass)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_base_pushes_no_harder_than_its_wheels_hold(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(find_robot(name).mjcf_path))
    x, y, _ = find_robot(name).base_joints
    both = np.hypot(*(model.actuator(joint).forcerange[1] for joint in (x, y)))
    assert both <= 0.6 * 9.81 * model.body_mass.sum()


def test_bodies_whose_shapes_count_in_part_are_paired() -> None:
    """No robot of the package has such bodies: half of the pairs of two bodies are declared not to count."""
    from clutter_env.scene.layout import LAYOUTS
    from clutter_env.simulation import model as module

    robot = find_robot("pr2")
    contacts = robot_contacts(robot)
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    bodies = [tuple(alone.geom_bodyid[pair].tolist()) for pair in contacts.pairs]
    of_many = next(pair for pair in bodies if bodies.count(pair) > 1)
    dropped = bodies.index(of_many)
    fewer = contacts._replace(pairs=np.delete(contacts.pairs, dropped, axis=0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "robot_contacts", lambda _: fewer)
        model = module.build_spec(robot, LAYOUTS["paper"], ()).compile()
    paired = {frozenset((int(one), int(other))) for one, other in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    assert len(paired) == bodies.count(of_many) - 1
    assert model.nexclude > 0


def _unnamed_bodies(text: str) -> str:
    return re.sub(r'<body name="link[1-6]"', "<body", text)


def _with_pair(text: str) -> str:
    """A pair of neighbours, and one whose bodies are excluded: MuJoCo lets both touch."""
    contact = """<contact>
      <pair geom1="column" geom2="lift"/> <pair geom1="base" geom2="hand"/> <exclude body1="base" body2="hand"/>
    </contact>"""
    return text.replace("</mujoco>", contact + "</mujoco>")


def _without_the_ground(text: str) -> str:
    return text.replace("</mujoco>", '<contact><exclude body1="world" body2="hand"/></contact></mujoco>')


@pytest.mark.parametrize("change", [_unnamed_bodies, _with_pair, _without_the_ground])
def test_physics_has_the_pairs_of_the_rule_for_robots_of_files(change: Callable[[str], str], tmp_path: Path) -> None:
    robot = find_robot("panda_mobile")
    text = change(robot.mjcf_path.read_text())
    assert text != robot.mjcf_path.read_text()
    (tmp_path / "own.xml").write_text(text)
    robot = replace(robot, name="own", mjcf=str(tmp_path / "own.xml"), meshes=())
    model = RetrieveEnv(num_objects=1, robot=robot).model
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    own, of_file = (
        np.flatnonzero(m.body_rootid[m.geom_bodyid] == m.body(robot.base_body).id).tolist() for m in (model, alone)
    )
    number = dict(zip(own, of_file, strict=True))
    met = {
        (number[one], number[other]) for one, other in itertools.combinations(own, 2) if can_touch(model, one, other)
    }
    assert met == set(map(tuple, robot_contacts(robot).pairs.tolist()))
    counted = {frozenset(robot.collision_geoms(alone)[k] for k in pair) for pair in robot.shapes.pairs.tolist()}
    assert met == {tuple(sorted(pair)) for pair in counted}, "and of the planner"
    on_ground = {number[geom] for geom in own if can_touch(model, model.geom("floor").id, geom)}
    assert on_ground == set(robot_contacts(robot).above_ground.tolist())


def can_touch(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Whether MuJoCo looks for contacts of two geoms."""
    if {one, other} in [{int(a), int(b)} for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]:
        return True
    bodies = sorted(int(model.geom_bodyid[geom]) for geom in (one, other))
    a, b = (int(model.body_weldid[body]) for body in bodies)
    parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in (a, b)]
    if a == b or (0 not in (a, b) and (a == parents[1] or b == parents[0])):
        return False
    if bodies[0] << 16 | bodies[1] in model.exclude_signature.tolist():
        return False
    kinds, wanted = model.geom_contype, model.geom_conaffinity
    return bool(kinds[one] & wanted[other] or kinds[other] & wanted[one])


def test_a_robot_with_a_floor_of_its_own_is_refused_by_name(tmp_path: Path) -> None:
    robot = find_robot("panda_mobile")
    text = robot.mjcf_path.read_text().replace(
        "<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>'
    )
    (tmp_path / "own.xml").write_text(text)
    with pytest.raises(ConfigError, match="floor"):
        RetrieveEnv(num_objects=1, robot=replace(robot, name="own", mjcf=str(tmp_path / "own.xml"), meshes=()))


def test_both_arms_of_a_robot_meet_each_other() -> None:
    """Their first links went 65 mm into each other: for either arm the other one is a part of the torso."""
    robot = find_robot("pr2")
    alone = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    pair = sorted(alone.geom(name).id for name in ("r_shoulder_front", "l_shoulder_front"))
    assert pair in robot_contacts(robot).pairs.tolist()
    env = RetrieveEnv(num_objects=1, robot=replace(robot, acts_with_all_arms=True))
    env.reset(seed=0)
    q = env.world.controller.state.target.copy()
    names = ActingJoints.of(env.robot).names
    q[names.index("r_shoulder_pan_joint")], q[names.index("l_shoulder_pan_joint")] = 0.7, -0.7
    for side in "rl":
        q[names.index(f"{side}_elbow_flex_joint")] = -0.2
    for _ in range(60):
        *_, info = env.step(env.joint_action(q, [0.05, 0.05]))
    ends = (env.model.geom(f"{side}_shoulder_front").id for side in "rl")
    assert mujoco.mj_geomDistance(env.model, env.data, *ends, 1.0, None) > -0.005
    assert info["self_force"] > 0.0


OVER_THE_BASE = np.array((0.32, -1.17, 1.15, 0.24, 1.1, -2.91, -1.23, 4.38))
"""Joints of Fetch's torso and arm with which its forearm is level, 12 cm above the base, and its hand beside it."""


def over_the_base(*heights: float) -> RetrieveEnv:
    """Fetch with its forearm above its base, and boxes of these heights [m] between them, one on the other, awake."""
    env = RetrieveEnv(num_objects=len(heights))
    boxes = [{"shape": "box", "depth": 0.1, "width": 0.1, "height": height, "mass": 0.1} for height in heights]
    env.reset(seed=0, options={"objects": [{**box, "position": (0.1, 0.3 * k)} for k, box in enumerate(boxes)]})
    world, data = env.world, env.data
    data.qpos[world.index.drive_qpos[3:]] = OVER_THE_BASE
    world.controller.reset(data)
    mujoco.mj_kinematics(env.model, data)
    base = data.geom("base")
    place = base.xpos + (0.112, -0.07, env.model.geom("base").size[1])
    for number, height in enumerate(heights):
        place = place + (0.0, 0.0, height / 2)
        data.qpos[world.index.object_qpos].reshape(-1, 7)[number] = [*place, 1.0, 0.0, 0.0, 0.0]
        place = place + (0.0, 0.0, height / 2)
    wake(env)
    return env


def wake(env: RetrieveEnv) -> None:
    """Wake all bodies."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(env.model, kind))
    mujoco.mj_getState(env.model, env.data, state, kind)
    mujoco.mj_setState(env.model, env.data, state, kind)


@pytest.mark.parametrize("heights", [(0.1,), (0.06, 0.05)])
def test_what_is_squeezed_between_two_parts_of_the_robot_presses_on_it(
    heights: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Boxes between forearm and base, which no gripper touches, were booked as 0 N."""
    env = over_the_base(*heights)
    q = OVER_THE_BASE.copy()
    info = drive(env, q, 1.0)
    assert info["self_force"] == 0.0, "they stand on the base, and nothing else touches them"
    q[0] -= 0.06
    forces = watch(monkeypatch, env, env.object_names, ["base"])
    info = drive(env, q, 2.0)
    assert largest_mean(forces) > 20.0
    weight = 9.81 * 0.1 * len(heights)
    assert info["self_force"] == pytest.approx(largest_mean(forces) - weight, rel=0.05)
    assert info["furniture_force"] == 0.0


def two_hands(env: RetrieveEnv, centre: np.ndarray) -> np.ndarray:
    """Motor targets (4 + n,) with which both hands of PR2 are around `centre` (3,), one 12 cm above the other."""
    model, world, data = env.model, env.world, mujoco.MjData(env.model)
    data.qpos[:] = env.data.qpos
    columns, start = world.index.drive_qpos, world.controller.state.target.copy()
    ranges = {int(adr): limits for adr, limits in zip(model.jnt_qposadr, model.jnt_range, strict=True)}
    low, high = np.array([ranges[int(column)] for column in columns[4:]]).T

    def errors(arms: np.ndarray) -> np.ndarray:
        data.qpos[columns] = [*start[:4], *arms]
        mujoco.mj_kinematics(model, data)
        found = [0.01 * (arms - start[4:])]
        for (one, other), side in zip(world.index.finger_geoms, (1, -1), strict=True):
            fingers, approach = data.geom_xpos[other] - data.geom_xpos[one], data.geom_xmat[one].reshape(3, 3)[:, 0]
            middle = (data.geom_xpos[one] + data.geom_xpos[other]) / 2
            found += [10 * (middle - centre - (0, 0, 0.06 * side)), 3 * fingers[2:] / np.linalg.norm(fingers)]
            found += [approach - (0.7, 0.7 * side, 0), 3 * approach[2:]]
        return np.concatenate(found)

    rng = np.random.default_rng(0)
    starts = np.clip(start[4:] + rng.normal(0, 0.4, (12, len(low))), low + 0.01, high - 0.01)
    best = min((least_squares(errors, one, bounds=(low, high)) for one in starts), key=lambda found: found.cost)
    assert best.cost < 1e-2
    return np.concatenate([start[:4], best.x])


@pytest.mark.slow
def test_two_hands_that_hold_one_object_press_on_each_other_only_beyond_their_grips() -> None:
    """Grips of 48 N each, at rest, were booked as 195 N of the robot on itself."""
    env = RetrieveEnv(num_objects=1, robot=replace(find_robot("pr2"), acts_with_all_arms=True))
    stick = {"shape": "box", "depth": 0.05, "width": 0.05, "height": 0.24, "position": (0.1, 0.0)}
    env.reset(seed=0, options={"objects": [stick]})
    world, data = env.world, env.data
    centre = world.controller.state.target[:3] * (1, 1, 0) + (0.65, 0.0, 1.05)
    q = two_hands(env, centre)
    data.qpos[world.index.drive_qpos], data.qpos[world.index.finger_qpos] = q, env.robot.max_finger_position
    world.controller.reset(data)
    place = np.array([*centre, np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)])
    for _ in range(30):  # it is held there, awake, while the fingers close
        data.qpos[world.index.object_qpos], data.qvel[world.index.object_dof] = place, 0.0
        wake(env)
        env.step(env.joint_action(q, [0.0, 0.0]))
    world.on_itself = Pressing()
    for _ in range(20):
        env.step(env.joint_action(q, [0.0, 0.0]))
    assert env.measurements.grip.held == (0, 0)
    assert world.on_itself.force < 10.0
    names = ActingJoints.of(env.robot).names
    q[names.index("l_shoulder_pan_joint")] += 0.4
    for _ in range(20):
        env.step(env.joint_action(q, [0.0, 0.0]))
    assert world.on_itself.force > 25.0, "one hand pulls at the other"
