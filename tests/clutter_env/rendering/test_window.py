"""The window of render_mode="human" and the view of a whole scene, without a display."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.config import CONTROL_HZ
from clutter_env.envs.base import BaseEnv
from clutter_env.rendering import cameras
from clutter_env.rendering.film import Film
from clutter_env.rendering.framing import ABOVE, across, whole_scene
from clutter_env.scene.layout import LAYOUTS

ID = "clutter_env/Retrieve-o5-v0"
EACH_LAYOUT = [pytest.param(one, marks=() if one == "shelf" else pytest.mark.slow) for one in LAYOUTS]


class Viewer:
    """What a window needs of MuJoCo's viewer; `open_for` updates, then its user closes it."""

    def __init__(self, open_for: int = 1_000_000) -> None:
        self.cam, self.updates, self.open_for = mujoco.MjvCamera(), 0, open_for

    @contextmanager
    def lock(self) -> Iterator[None]:
        yield

    def is_running(self) -> bool:
        return self.updates < self.open_for

    def sync(self) -> None:
        self.updates += 1

    def close(self) -> None:
        self.open_for = 0


class Clock:
    """A clock on which nothing but sleeping takes time."""

    def __init__(self) -> None:
        self.now, self.slept = 1000.0, []

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(cameras, "time", clock)
    return clock


def shown(monkeypatch: pytest.MonkeyPatch, viewer: Viewer, **keywords: Any) -> BaseEnv:
    """An environment that shows itself in `viewer`, after a reset."""
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setitem(sys.modules, "mujoco.viewer", SimpleNamespace(launch_passive=lambda *_, **__: viewer))
    env = gym.make(ID, render_mode="human", disable_env_checker=True, **keywords).unwrapped
    assert isinstance(env, BaseEnv)
    env.reset(seed=0)
    return env


@pytest.mark.usefixtures("clock")
def test_the_window_looks_through_the_camera_that_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for camera in ("top", "head", "gripper"):
        viewer = Viewer()
        env = shown(monkeypatch, viewer, camera=camera)
        assert int(viewer.cam.type) == int(mujoco.mjtCamera.mjCAMERA_FIXED)
        assert viewer.cam.fixedcamid == env.model.camera(camera).id
    viewer = Viewer()
    env = shown(monkeypatch, viewer, layout="shelf")
    framed = whole_scene(env.model, env.layout, env.world.scene.base, across(env.layout), 1.5)
    assert int(viewer.cam.type) == int(mujoco.mjtCamera.mjCAMERA_FREE), "the mouse can move it"
    assert viewer.cam.distance == framed.distance
    assert viewer.cam.lookat.tolist() == framed.lookat.tolist()


def test_a_step_takes_its_time_and_a_pause_is_not_made_up_for(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = Viewer()
    env = shown(monkeypatch, viewer)
    start = clock.now
    for _ in range(40):
        env.step(np.zeros(env.action_size))
    assert clock.now - start == pytest.approx(40 / CONTROL_HZ)
    clock.now += 5.0  # a planner thinks
    start = clock.now
    for _ in range(40):
        env.step(np.zeros(env.action_size))
    assert 1.85 <= clock.now - start <= 2.0
    env.reset(seed=1)
    start = clock.now
    env.step(np.zeros(env.action_size))
    assert clock.now - start == pytest.approx(1 / CONTROL_HZ)
    assert viewer.updates == 83


def test_the_window_stays_until_its_user_closes_it(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    viewer = Viewer(open_for=10)
    env = shown(monkeypatch, viewer)
    env.wait_for_window()
    assert viewer.updates == 10
    before = clock.now
    env.step(np.zeros(env.action_size))
    assert viewer.updates == 10
    assert clock.now == before, "without a window nothing waits for the clock"
    env.close()
    env.wait_for_window()


def seen(env: BaseEnv, camera: mujoco.MjvCamera, points: np.ndarray) -> np.ndarray:
    """Places (n, 2) of points in a picture, in half its height from its centre, by MuJoCo's own camera."""
    scene = mujoco.MjvScene(env.model, maxgeom=500)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(env.model, env.data, mujoco.MjvOption(), None, camera, everything, scene)
    eyes = scene.camera
    position = (eyes[0].pos + eyes[1].pos) / 2.0
    forward, up = np.array(eyes[0].forward, float), np.array(eyes[0].up, float)
    offsets = points - position
    depth = offsets @ forward
    assert (depth > 0).all()
    half_height = depth * eyes[0].frustum_top / eyes[0].frustum_near
    return np.column_stack((offsets @ np.cross(forward, up), offsets @ up)) / half_height[:, None]


@pytest.mark.parametrize("layout", EACH_LAYOUT)
def test_robot_and_objects_are_in_view_wherever_the_robot_starts(layout: str) -> None:
    env = gym.make(ID, layout=layout).unwrapped
    views = [(across(env.layout), aspect) for aspect in (4 / 3, 1.5, 0.6)] + [(ABOVE, 0.8)]
    furthest = np.zeros(len(views))
    (low_x, low_y), (high_x, high_y) = env.layout.start_region
    for seed, (x, y) in enumerate(product((low_x, high_x), (low_y, high_y))):
        env.reset(seed=seed)
        env.data.qpos[env.world.index.drive_qpos[:2]] = x, y
        mujoco.mj_kinematics(env.model, env.data)
        robot = env.model.body_rootid[env.model.geom_bodyid] == env.world.index.base_body
        objects = np.arange(env.model.ngeom)[env.world.index.object_geoms]
        points = env.data.geom_xpos[[*np.flatnonzero(robot), *objects]]
        for number, (direction, aspect) in enumerate(views):
            camera = whole_scene(env.model, env.layout, (x, y), direction, aspect)
            places = np.abs(seen(env, camera, points)) / (aspect, 1.0)
            furthest[number] = max(furthest[number], float(places.max()))
    assert ((furthest > 0.6) & (furthest < 0.97)).all(), "all in the picture, and not small in its middle"


@pytest.mark.usefixtures("needs_gl")
def test_a_film_names_target_and_speed_and_shows_the_whole_robot() -> None:
    env = gym.make(ID, layout="shelf", render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    film = Film(env)
    film.watch("")
    film.close()
    frame = film.frames[0].astype(int)
    picture, bar = frame[:480, :640], frame[480:]
    assert bar[:, :600].min() == 255, "no caption"
    assert bar[:, 760:].min() < 100, "target and speed"
    blue = (picture[..., 2] > 120) & (picture[..., 2] > 2 * picture[..., 0])
    assert blue[:, 60:-60].sum() == blue.sum() > 1500, "no blue link of the robot is cut off"
    env.close()
