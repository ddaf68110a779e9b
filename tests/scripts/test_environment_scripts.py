"""The scripts about the environments count right and stop where an environment breaks its promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from PIL import Image

from clutter_env.envs.rearrange_tasks import TASKS
from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.scene.layout import LAYOUTS
from scripts import soak, step_cost
from scripts.layout_pictures import save_images, scene_image
from scripts.soak import ARM_IDS, TASK_IDS, EnduranceError, run_endurance


def test_endurance_names_the_episode_of_every_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of an episode that others follow: a reset clears MuJoCo's counters."""
    step, seeds, done = RetrieveEnv.step, [], []

    def reset_then_explode(env: RetrieveEnv, action: ArrayLike) -> Any:
        if env.data.time == 0.0 and env.config.num_objects == 1:
            seeds.append(env.np_random_seed)
            env.data.qvel[0] = 1e12
        return step(env, action)

    monkeypatch.setattr(RetrieveEnv, "step", reset_then_explode)
    monkeypatch.setattr(soak, "EPISODE_STEPS", 1)
    monkeypatch.setattr(soak, "SKILL_IDS", ())
    monkeypatch.setattr(soak, "IDS", ("clutter_env/Retrieve-o1-v0", "clutter_env/Retrieve-o60-v0"))
    monkeypatch.setattr(soak, "TASK_IDS", TASK_IDS[:1])
    result = run_endurance(1, seed=0, report=done.append)
    left_out = 2 + 5  # o60 fits neither the layout "dense" nor "cabinet", nor any that opens
    kinds = 2 * (len(LAYOUTS) * 2 - left_out + len(TASKS) + 1) + len(ARM_IDS)  # 1: Search
    assert result.steps == sum(done) == kinds
    assert [line.split("), ")[-1] for line in result.warnings] == [f"seed {seed}, step 0" for seed in seeds]
    named = [f"BADQVEL: EnvSpec(id='clutter_env/{name}-o1-v0'" for name in ("Retrieve", "ArmRetrieve")]
    assert all(line.startswith(tuple(named)) for line in result.warnings)
    assert f"warnings from MuJoCo: {len(seeds)}\n  BADQVEL" in result.summary()


def test_endurance_stops_at_a_reward_that_is_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RetrieveEnv, "_advance", lambda _: (float("nan"), False))
    with pytest.raises(EnduranceError, match=r"Retrieve-o1.*reward nan at step 0"):
        run_endurance(52, seed=0)


@pytest.mark.usefixtures("needs_gl")
def test_layouts_are_rendered_side_by_side(tmp_path: Path) -> None:
    images = [
        scene_image(RetrieveEnv(num_objects=3, layout=layout, render_mode="rgb_array"), layout, 1, 48)
        for layout in ("paper", "island")
    ]
    assert not np.array_equal(*images)
    save_images([*images, *images, images[1]], tmp_path / "new" / "layouts.png")
    assert Image.open(tmp_path / "new" / "layouts.png").size == (4 * 48 + 3 * 8, 2 * 60 + 8)


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_steps_of_a_checkout_are_timed_in_a_process_of_its_own(mode: str) -> None:
    checkout = step_cost.Checkout(Path(__file__).parents[2], mode, objects=1, steps=3)
    sampled, at_rest = checkout.play("sampled", 0), checkout.play("at rest", 0)
    checkout.close()
    assert sampled.shape == at_rest.shape == (3,)
    assert min(sampled.min(), at_rest.min()) > 0.0
