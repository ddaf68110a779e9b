"""Limits and tolerances of the expert are checked."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import pytest

import clutter_env
from planners import TampExpert
from planners.expert.config import ExpertConfig, ExpertError, MonitorConfig

assert clutter_env

BAD_NUMBERS = (-1, math.nan, "soon", None, True)


@pytest.mark.parametrize("name", ["replans", "planning_s", "settle_s", "hold_s"])
@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_values_of_the_config_are_checked(name: str, value: Any) -> None:
    with pytest.raises(ExpertError, match=f"{name}="):
        ExpertConfig(**{name: value})


@pytest.mark.parametrize("keywords", [{"settle_s": math.inf}, {"hold_s": math.inf}, {"replans": 1.5}])
def test_waits_are_finite_and_replans_whole(keywords: dict[str, float]) -> None:
    with pytest.raises(ExpertError):
        ExpertConfig(**keywords)  # type: ignore[arg-type] # the wrong type is what is tested


@pytest.mark.parametrize("name", ["displacement", "tilt", "slip", "base", "arm"])
@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_tolerances_are_checked(name: str, value: Any) -> None:
    with pytest.raises(ExpertError, match=f"{name}="):
        MonitorConfig(**{name: value})


def test_what_is_no_config_is_refused() -> None:
    env = gymnasium.make("clutter_env/Retrieve-o1-v0")
    with pytest.raises(ExpertError, match="ExpertConfig"):
        TampExpert(env, config={"replans": 1})  # type: ignore[arg-type] # the wrong type is what is tested
    env.close()
    with pytest.raises(ExpertError, match="MonitorConfig"):
        ExpertConfig(monitor=0.1)  # type: ignore[arg-type] # the wrong type is what is tested
    with pytest.raises(ExpertError, match="with_floor"):
        ExpertConfig(with_floor="yes")  # type: ignore[arg-type] # the wrong type is what is tested


def test_limits_may_be_infinite() -> None:
    config = ExpertConfig(planning_s=math.inf, monitor=MonitorConfig(displacement=math.inf))
    assert config.planning_s == math.inf
