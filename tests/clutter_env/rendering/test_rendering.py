"""Pictures, and clear words where there can be none."""

from __future__ import annotations

import os
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import clutter_env  # noqa: F401 - registers the environments
from clutter_env.scene.layout import LAYOUTS

ID = "clutter_env/Retrieve-o5-v0"
SHOWN = [name for name, layout in LAYOUTS.items() if layout.opens is None]
"""The other layouts are shut at the start."""
EACH_LAYOUT = [pytest.param(one, marks=() if one == "shelf" else pytest.mark.slow) for one in SHOWN]


def run_without(code: str, **environment: str) -> subprocess.CompletedProcess:
    """Run Python code with other environment variables, in a clean directory of imports."""
    variables = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=variables | environment)


@pytest.mark.usefixtures("needs_gl")
@pytest.mark.parametrize("layout", EACH_LAYOUT)
@pytest.mark.parametrize("camera", ["scene", "top"])
def test_the_red_target_is_in_the_picture(layout: str, camera: str) -> None:
    env = gym.make(ID, layout=layout, camera=camera, render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    assert picture.shape == (480, 480, 3)
    assert picture.dtype == np.uint8
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    assert ((red > 100) & (red > 2.2 * green) & (red > 2.2 * blue)).sum() > 15
    assert picture.mean() > 120, "a light background"
    env.close()


@pytest.mark.usefixtures("needs_gl")
def test_depth_is_metric() -> None:
    env = gym.make(ID, camera="top", render_mode="depth_array").unwrapped
    env.reset(seed=1)
    depth = env.render()
    assert depth.shape == (480, 480)
    assert depth.dtype == np.float32
    camera_height = env.model.camera("top").pos[2]
    _, counts = np.unique(np.round(camera_height - depth, 2), return_counts=True)
    heights = np.unique(np.round(camera_height - depth, 2))
    assert {0.0, 0.75} <= set(heights[counts > 2000].tolist())
    env.close()


@pytest.mark.usefixtures("needs_gl")
def test_closed_environments_draw_again() -> None:
    env = gym.make(ID, render_mode="rgb_array", width=64, height=48).unwrapped
    env.reset(seed=1)
    first = env.render()
    env.close()
    env.close()
    assert np.array_equal(env.render(), first)
    assert first.shape == (48, 64, 3)
    env.reset(seed=1, options={"objects": [{"radius": 0.03, "height": 0.1, "position": (0, 0)}]})
    assert env.render().shape == (48, 64, 3)
    env.close()


@pytest.mark.usefixtures("needs_gl")
def test_cameras_see_depth_and_colour() -> None:
    env = gym.make(ID, obs_mode="rgbd", image_size=48)
    observation, _ = env.reset(seed=0)
    assert observation["head_rgb"].std() > 5
    assert 0.3 < np.median(observation["gripper_depth"]) < 3
    assert "objects" not in observation
    env.close()


@pytest.mark.usefixtures("needs_gl")
def test_videos_are_recorded(tmp_path) -> None:
    pytest.importorskip("moviepy")
    env = RecordVideo(gym.make(ID, render_mode="rgb_array", width=64, height=64), str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(5):
        env.step(env.action_space.sample())
    env.close()
    assert list(tmp_path.glob("*.mp4"))


HEADLESS = f"""
import gymnasium as gym, clutter_env
env = gym.make({ID!r}, render_mode={{mode!r}})
env.reset(seed=0) if {{mode!r}} != 'human' else None
env.step(env.action_space.sample()) if {{mode!r}} != 'human' else None
try:
    env.reset(seed=0); env.render()
except RuntimeError as error:
    print(type(error).__name__, error)
"""


def test_switched_off_rendering_says_so_and_the_variable_is_read_but_never_written() -> None:
    code = "import os\n" + HEADLESS.format(mode="rgb_array") + "\nprint(os.environ.get('MUJOCO_GL'))"
    result = run_without(code, MUJOCO_GL="disable")
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip().endswith("disable")
    assert "RenderingUnavailable rendering is switched off by MUJOCO_GL=disable" in result.stdout


def test_missing_libraries_name_the_packages(tmp_path) -> None:
    """PyOpenGL finds no library when the loader's search finds none."""
    (tmp_path / "sitecustomize.py").write_text(
        "import ctypes, ctypes.util\n"
        "load = ctypes.CDLL.__init__\n"
        "def refuse(self, name, *args, **keywords):\n"
        "    if name and any(part in str(name) for part in ('EGL', 'OSMesa', 'libGL', 'OpenGL')):\n"
        "        raise OSError(f'{name}: cannot open shared object file')\n"
        "    load(self, name, *args, **keywords)\n"
        "ctypes.CDLL.__init__ = refuse\n"
        "find = ctypes.util.find_library\n"
        "ctypes.util.find_library = lambda name: None if name in ('EGL', 'OSMesa', 'GL', 'OpenGL') else find(name)\n"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", ""), os.getcwd()])
    result = run_without(HEADLESS.format(mode="rgb_array"), PYTHONPATH=path)
    assert result.returncode == 0, result.stderr
    for package in ("libegl1", "libegl-mesa0", "libgl1-mesa-dri", "libosmesa6"):
        assert package in result.stdout, result.stdout + result.stderr


def test_windows_need_a_display() -> None:
    result = run_without(HEADLESS.format(mode="human"))
    assert "needs a display" in result.stdout, result.stdout + result.stderr
