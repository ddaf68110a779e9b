"""Two limits on how hard a robot presses, and the contacts that they are measured from."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np
import pytest

from clutter_env.config import TIMESTEP
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import Box, Layout
from clutter_env.simulation.pressing import (
    REMEMBERED,
    SUSTAINED_FORCE,
    TOTAL_SLIDE,
    TRANSIENT_IMPULSE,
    Pressing,
    is_gentle,
    total_slide,
)
from tests.clutter_env.envs.cheats import OTHER, SCENE, Cheat, cylinder


def pressed(*forces: float) -> Pressing:
    pressing = Pressing()
    for force in forces:
        pressing.add([force])
    return pressing


def test_a_short_blow_slides_the_table_as_its_impulse_says() -> None:
    """J² / (2 m F) after it, and half of its own duration at its last speed."""
    for force in (200.0, 300.0, 500.0):
        impulse = (force - SUSTAINED_FORCE) * TIMESTEP
        after, during = impulse**2 / (2 * 10.0 * SUSTAINED_FORCE), impulse / 10.0 * TIMESTEP / 2
        assert pressed(force, *[0.0] * 100).slide == pytest.approx(after + during, rel=0.02)
    assert pressed(*[50.0] * 500).slide == 0.0


def test_a_short_touch_is_gentle_and_a_long_one_is_not() -> None:
    assert is_gentle(pressed(*[69.0] * 10, *[0.0] * 100))
    assert not is_gentle(pressed(*[69.0] * 250))
    assert is_gentle(pressed(*[50.0] * 500))
    assert not is_gentle(pressed(*[51.0] * 501)), "half a second more would not matter: the mean is above the limit"


def test_a_blow_is_judged_by_its_impulse() -> None:
    blow = pressed(300.0, 300.0, 300.0, *[0.0] * 100)
    assert blow.force == pytest.approx(900.0 / 50)
    assert blow.impulse == pytest.approx(3 * 250.0 * TIMESTEP)
    assert not is_gentle(blow)
    assert is_gentle(pressed(300.0, *[0.0] * 100))


def test_several_blows_add_up() -> None:
    """Forty taps, each within the limits, move a light table by centimetres."""
    once = [450.0, *[0.0] * 50]
    tap, taps = pressed(*once), pressed(*once * 40)
    assert is_gentle(tap)
    assert is_gentle(pressed(*once * 4))
    assert taps.impulse == tap.impulse, "the table stands in between"
    assert taps.slide == pytest.approx(40 * tap.slide)
    assert not is_gentle(taps)
    few = pressed(*once * 4)
    assert is_gentle(few, tap)
    assert total_slide(few, few) == pytest.approx(8 * tap.slide)
    assert not is_gentle(few, few), "blows on furniture and on the robot add up too"


def test_a_trembling_press_slides_the_table() -> None:
    """50 N in the mean, in jerks of 250 N: no other limit is exceeded."""
    trembling = pressed(*[250.0, 0.0, 0.0, 0.0, 0.0] * 500)
    assert trembling.force <= SUSTAINED_FORCE
    assert trembling.impulse <= TRANSIENT_IMPULSE
    assert trembling.slide > TOTAL_SLIDE
    assert not is_gentle(trembling)


def test_the_table_slides_on_after_a_hard_blow() -> None:
    """Until friction has stopped it, however long the force is past: 2 m/s stop after 0.4 s and 0.4 m."""
    blow = pressed(*[2050.0] * 5, *[0.0] * 1000)
    assert blow.slide == pytest.approx(2.0**2 / (2 * 5.0) + 0.01, rel=0.01)
    assert not blow.is_pressed
    assert blow.memory()[3:] == [0.0] * (REMEMBERED - 3)


def test_the_mean_is_over_any_window() -> None:
    rng = np.random.default_rng(0)
    forces = rng.uniform(0.0, 90.0, 400) * (rng.random(400) < 0.5)
    windows = np.convolve(np.concatenate([np.zeros(49), forces]), np.ones(50) / 50, "valid")
    assert pressed(*forces.tolist()).force == pytest.approx(windows.max())


def test_memory_continues_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    forces = (rng.uniform(0.0, 120.0, 300) * (rng.random(300) < 0.3)).tolist()
    for cut in (0, 1, 30, 120, 299):
        whole, begun = pressed(*forces), pressed(*forces[:cut])
        assert len(begun.memory()) == REMEMBERED
        rest = Pressing.recall(begun.memory())
        for force in forces[cut:]:
            rest.add([force])
        assert rest.memory() == whole.memory()
        at_once = pressed(*forces[:cut])
        at_once.add(forces[cut:])
        assert at_once.memory() == whole.memory(), "one after the other or all together"


def watch(
    monkeypatch: pytest.MonkeyPatch, env: RetrieveEnv, ones: Collection[str], others: Collection[str]
) -> list[float]:
    """The list to which each physics step adds the normal forces [N] between two sets of geoms."""
    forces, step = list[float](), mujoco.mj_step
    first, second = ({env.model.geom(name).id for name in names} for names in (ones, others))

    def watched(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        step(model, data)
        total, force = 0.0, np.empty(6)
        for number, pair in enumerate(data.contact.geom.tolist()):
            if first.intersection(pair) and second.intersection(pair):
                mujoco.mj_contactForce(model, data, number, force)
                total += force[0]
        forces.append(total)

    monkeypatch.setattr(mujoco, "mj_step", watched)
    return forces


def largest_mean(forces: list[float]) -> float:
    """[N] over 0.1 s."""
    return float(np.convolve(np.concatenate([np.zeros(49), forces]), np.ones(50) / 50, "valid").max())


def test_the_force_is_that_of_every_physics_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampled at 100 Hz, a peak of 62 N was booked as 54 N."""
    cheat = Cheat(RetrieveEnv(num_objects=4, control_mode="ee"))
    model = cheat.env.model
    robot = [model.geom(k).name for k in range(model.ngeom) if model.geom_contype[k] == 2]
    forces = watch(monkeypatch, cheat.env, robot, ["table_top"])
    cheat.before(cheat.at(OTHER) + (0, 0.15, 0))
    cheat.reach(cheat.point + (0.14, 0, -0.12))
    assert max(forces) > 20.0
    assert cheat.info["furniture_force"] == pytest.approx(largest_mean(forces), rel=1e-9)


def test_what_is_held_presses_for_the_robot() -> None:
    cheat = Cheat(RetrieveEnv(num_objects=4, control_mode="ee"))
    cheat.grasp(OTHER)
    assert cheat.info["furniture_force"] < 10.0, "its own weight is not counted"
    cheat.reach(cheat.point - (0, 0, 0.08))
    assert cheat.info["furniture_force"] > SUSTAINED_FORCE


def test_the_weight_of_what_is_held_hides_no_force_on_a_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gripper bears it: 2 kg pressed on a wall had 20 N for nothing."""
    post = Box("post", (0.26, 0.0, 0.6), (0.05, 0.5, 0.5))
    bench = Layout("bench", depth=0.4, width=1.0, is_front_only=False, boxes=(post,))
    objects = (cylinder(-0.1, -0.12), {**cylinder(-0.05, 0.2), "mass": 2.0})
    cheat = Cheat(RetrieveEnv(num_objects=2, control_mode="ee", layout=bench), objects)
    cheat.grasp(OTHER)
    cheat.reach(cheat.point + (0, 0, 0.12))
    before, forces = cheat.info["furniture_force"], watch(monkeypatch, cheat.env, cheat.env.object_names, ["post"])
    while not any(forces):
        cheat.point = cheat.point + (0.002, 0, 0)
        cheat.step()
    cheat.reach(cheat.point + (0.004, 0, 0), speed=0.02)
    cheat.wait(0.5)
    assert largest_mean(forces) > before
    assert cheat.info["furniture_force"] == pytest.approx(largest_mean(forces), abs=0.5)


def test_the_weight_of_what_lies_on_the_robot_hides_no_force_of_what_it_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    """5 kg on the base had 49 N for nothing, as had 5 kg in PR2's other hand."""
    load = {"shape": "box", "depth": 0.08, "width": 0.08, "height": 0.06, "mass": 5.0, "position": (0.2, -0.3)}
    cheat = Cheat(RetrieveEnv(num_objects=3, control_mode="ee"), (*SCENE[:2], load))
    env, held = cheat.env, cheat.env.object_names[OTHER]
    cheat.grasp(OTHER)
    base = env.data.geom("base")
    place = env.data.qpos[env.world.index.object_qpos].reshape(-1, 7)[2]
    place[:3] = base.xpos + (0.1, 0.0, env.model.geom("base").size[1] + 0.031)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(env.model, kind))
    mujoco.mj_getState(env.model, env.data, state, kind)
    mujoco.mj_setState(env.model, env.data, state, kind)  # which wakes it
    cheat.wait(0.5)
    assert 2 in env.measurements.moved
    forces = watch(monkeypatch, env, [held], ["table_top"])
    cheat.reach(cheat.point - (0, 0, 0.03))
    cheat.wait(0.5)
    weight = 9.81 * float(env.world.scene.masses[OTHER])
    assert largest_mean(forces) > 20.0
    assert cheat.info["furniture_force"] == pytest.approx(largest_mean(forces) - weight, abs=0.5)


@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_what_has_no_friction_is_not_lifted(friction: float) -> None:
    cheat = Cheat(RetrieveEnv(num_objects=4, control_mode="ee"))
    env = cheat.env
    env.model.geom_friction[env.world.index.object_geoms, 0] = friction
    info = cheat.take_target()
    assert not info["lifted"]
    assert env.world.lowest_point(env.measurements, 0) < 0.76, "it stays on the table"


@pytest.mark.parametrize("robot", ["fetch", "pr2", "panda_mobile"])
def test_friction_in_the_hand_is_the_objects(robot: str) -> None:
    env = RetrieveEnv(num_objects=2, robot=robot)
    env.reset(seed=0)
    pads = [pad for pair in env.world.index.finger_geoms for pad in pair]
    others = [k for k in range(env.model.ngeom) if k not in pads and env.model.geom_contype[k] in (1, 2)]
    slot = env.world.index.object_geoms.start
    assert env.model.geom_priority[slot] == 1
    assert (env.model.geom_priority[pads] == 1).all()
    assert (env.model.geom_friction[pads, 0] < 1e-4).all()
    furniture = [k for k in others if env.model.geom_contype[k] == 1 and env.model.geom(k).name != "floor"]
    furniture = [k for k in furniture if k < slot]
    assert (env.model.geom_friction[furniture, 0] <= 0.2).all()
