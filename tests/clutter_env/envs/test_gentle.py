"""Careful ways to lift the target are clean successes; see `gentle` for the scripts."""

from __future__ import annotations

import pytest

from clutter_env.envs.retrieve import RetrieveEnv
from tests.clutter_env.envs.cheats import Cheat
from tests.clutter_env.envs.gentle import GENTLE, Gentle


@pytest.mark.parametrize("gentle", GENTLE.values(), ids=GENTLE)
def test_a_gentle_lift_is_a_clean_success(gentle: Gentle) -> None:
    info = gentle.script(Cheat(RetrieveEnv(num_objects=4, control_mode="ee"), gentle.objects))
    assert info["is_success"], {name: info[name] for name in info if "force" in name or "num" in name}
    assert info["self_force"] == 0.0
