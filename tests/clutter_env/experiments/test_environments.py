"""The experiments about the environments count right and stop where an environment breaks its promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from PIL import Image

from clutter_env.cli import benchmark
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.errors import ConfigError
from clutter_env.experiments.environments import endurance
from clutter_env.experiments.environments.batch_scaling import BatchScaling, measure_batch
from clutter_env.experiments.environments.endurance import IDS, EnduranceError, run_endurance
from clutter_env.experiments.environments.layout_images import layout_image, save_images
from clutter_env.experiments.environments.resets import ResetTimes, compare_resets
from clutter_env.experiments.environments.speed import SpeedSettings, measure_speed
from clutter_env.scene.layout import LAYOUTS


def test_endurance_steps_every_environment_and_reports_every_step() -> None:
    done = []
    result = run_endurance(60, seed=0, report=done.append)
    assert result.steps == sum(done) == result.episodes == len(result.memory_mb)
    left_out = 4  # o60 does not fit the layout "dense", nor o40, o50 and o60 the layout "cabinet"
    assert result.steps == 2 * (len(LAYOUTS) * len(IDS) - left_out)
    assert f"{result.steps} steps" in result.summary()


def test_endurance_stops_at_a_reward_that_is_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RetrieveEnv, "_advance", lambda _: (float("nan"), False))
    with pytest.raises(EnduranceError, match=r"Retrieve-o1.*reward nan at step 0"):
        run_endurance(52, seed=0)


def test_endurance_names_the_episode_of_every_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of an episode that others follow: a reset clears MuJoCo's counters."""
    step, seeds = RetrieveEnv.step, []

    def reset_then_explode(env: RetrieveEnv, action: ArrayLike) -> Any:
        if env.data.time == 0.0 and env.config.num_objects == 1:
            seeds.append(env.np_random_seed)
            env.data.qvel[0] = 1e12
        return step(env, action)

    monkeypatch.setattr(RetrieveEnv, "step", reset_then_explode)
    monkeypatch.setattr(endurance, "EPISODE_STEPS", 1)
    result = run_endurance(520, seed=0)
    expected = [f"seed {seed}, step 0" for seed in seeds]
    assert [line.split("), ")[-1] for line in result.warnings] == expected
    assert all(line.startswith("BADQVEL: EnvSpec(id='clutter_env/Retrieve-o1-v0'") for line in result.warnings)
    assert f"warnings from MuJoCo: {len(seeds)}\n  BADQVEL" in result.summary()


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="steps=0"):
        run_endurance(0, seed=0)
    with pytest.raises(ValueError, match="steps=0"):
        next(measure_speed((1,), SpeedSettings(steps=0)))
    with pytest.raises(ConfigError, match="island"):
        next(measure_speed((1,), SpeedSettings(layout="round")))


def test_resets_are_compared_with_those_of_fetch_pick_and_place() -> None:
    pytest.importorskip("gymnasium_robotics")
    times = compare_resets(rounds=1, num_objects=1)
    assert len(times.ours) == len(times.reference) == 1
    assert ResetTimes((2e-4, 6e-4), (1e-4, 2e-4)).summary().endswith("ratio 2.50 (2.00 to 3.00)")


def test_a_batch_steps_the_same_physics() -> None:
    scaling = measure_batch(num_envs=2, num_objects=3)
    assert scaling.is_same
    assert scaling.step > scaling.physics > 0
    assert BatchScaling(3.0, 2.0, (2.0, 2.0), True).share_of_linear == pytest.approx(0.75)


def test_the_benchmark_leaves_the_plotting_library_out_of_its_processes() -> None:
    assert not hasattr(benchmark, "plot_speed")


@pytest.mark.usefixtures("needs_gl")
def test_layouts_are_rendered_side_by_side(tmp_path: Path) -> None:
    images = [layout_image(layout, 3, "mixed", 1, 48) for layout in ("paper", "island")]
    assert not np.array_equal(*images)
    save_images([*images, *images, images[1]], tmp_path / "new" / "layouts.png")
    assert Image.open(tmp_path / "new" / "layouts.png").size == (4 * 48 + 3 * 8, 2 * 72 + 8)
