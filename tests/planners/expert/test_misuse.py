"""The expert used wrongly says what to do; waiting times of any length end; `reset` begins afresh after anything."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import ClipAction, RescaleAction, TimeLimit

import clutter_env
from assets.robots import FETCH
from planners import STRATEGIES, Infeasible, Planner, Scene, Solution, Strategy, TampExpert
from planners.cause import Cause
from planners.expert.config import ExpertConfig, ExpertError, MonitorConfig
from planners.expert.interfaces import controlled_env
from planners.grasping.families import UnknownGraspSet
from planners.motion.tcp_following import TcpFollower
from planners.placing.surfaces import UnknownSupport
from planners.scene import UnknownObject
from planners.strategies import UnknownStrategy

assert clutter_env

ENV = "clutter_env/Retrieve-o5-v0"
SEED = 11


@pytest.fixture
def env() -> Iterator[gymnasium.Env]:
    made = gymnasium.make(ENV, max_episode_steps=9000)
    yield made
    made.close()


def play(env: gymnasium.Env, expert: TampExpert, most: int = 4000) -> bool:
    """Whether the expert ends the episode by itself within so many steps; the environment's end is ignored."""
    for _ in range(most):
        if expert.done:
            return True
        env.unwrapped.step(expert.act())
    return False


def test_limits_and_tolerances_are_checked(env: gymnasium.Env) -> None:
    """Limits may be infinite, waits may not."""
    numbers = {
        ExpertConfig: ("replans", "planning_s", "settle_s", "hold_s"),
        MonitorConfig: MonitorConfig.__annotations__,
    }
    bad: list[tuple[Any, str, Any]] = [
        (kind, name, value)
        for kind, names in numbers.items()
        for name in names
        for value in (-1, math.nan, "soon", None, True)
    ]
    infinite = [("settle_s", math.inf), ("hold_s", math.inf)]
    others = [("replans", 1.5), ("monitor", 0.1), ("with_floor", "yes"), ("hold_aside", 1)]
    bad += [(ExpertConfig, name, value) for name, value in infinite + others]
    for kind, name, value in bad:
        with pytest.raises(ExpertError, match=f"{name}="):
            kind(**{name: value})
    assert ExpertConfig(planning_s=math.inf, monitor=MonitorConfig(displacement=math.inf)).planning_s == math.inf
    with pytest.raises(ExpertError, match="ExpertConfig"):
        TampExpert(env, config={"replans": 1})  # type: ignore[arg-type] # the wrong type is what is tested


def test_before_reset_every_call_says_what_to_do(env: gymnasium.Env) -> None:
    env.reset(seed=SEED)
    expert = TampExpert(env)
    assert expert.solution is None
    with pytest.raises(ExpertError, match=r"call TampExpert.reset\(\) before act\(\)"):
        expert.act()
    for name in ("done", "report", "target", "phase"):
        with pytest.raises(ExpertError, match=rf"call TampExpert.reset\(\) before {name}"):
            getattr(expert, name)


def test_the_environment_must_be_reset_first(env: gymnasium.Env) -> None:
    expert = TampExpert(env)
    for target in (None, "object_00"):
        with pytest.raises(ExpertError, match="reset the environment before the expert"):
            expert.reset(target)


def test_an_environment_reset_during_the_episode_is_noticed(env: gymnasium.Env) -> None:
    env.reset(seed=SEED)
    expert = TampExpert(env)
    expert.reset()
    for _ in range(3):
        env.step(expert.act())
    env.reset(seed=SEED + 1)
    with pytest.raises(ExpertError, match="reset after the expert"):
        expert.act()
    expert.reset()
    env.step(expert.act())


def test_an_unknown_target_is_refused_and_the_episode_goes_on(env: gymnasium.Env) -> None:
    _, info = env.reset(seed=SEED)
    expert = TampExpert(env)
    expert.reset()
    with pytest.raises(UnknownObject, match="object_00"):
        expert.reset("object_99")
    assert expert.target == info["target"]
    env.step(expert.act())


def test_other_environments_are_refused_with_the_reason() -> None:
    vector = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make(ENV)] * 2)
    with pytest.raises(ExpertError, match="vector environment; make one TampExpert for each"):
        TampExpert(vector)
    vector.close()
    skill = gymnasium.make("clutter_env/Skill-o5-v0")
    with pytest.raises(ExpertError, match=r"it lacks .*; TampExpert controls clutter_env/Retrieve"):
        TampExpert(skill)
    skill.close()
    reach = gymnasium.make("clutter_env/Reach-v0")
    reach.reset(seed=0)
    with pytest.raises(ExpertError, match=r"the goal of .* is no planners\.goals\.Goal"):
        TampExpert(reach).reset()
    reach.close()
    for foreign in (None, gymnasium.make("CartPole-v1"), object()):
        with pytest.raises(ExpertError, match="lacks model, data, robot"):
            TampExpert(foreign)


def test_a_wrapper_that_changes_the_action_space_is_refused_and_others_are_welcome(env: gymnasium.Env) -> None:
    for wrapped in (RescaleAction(env, np.float32(-2.0), np.float32(2.0)), ClipAction(env)):
        with pytest.raises(ExpertError, match=r"a wrapper changes the action space.*remove that wrapper"):
            TampExpert(wrapped)
    assert controlled_env(TimeLimit(env, 100)) is controlled_env(env.unwrapped) is env.unwrapped


def test_an_unknown_control_mode_is_named(env: gymnasium.Env, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(env.unwrapped), "control_mode", "torque")
    with pytest.raises(ExpertError, match=r"'torque'.*'joint', 'ee'"):
        TampExpert(env)


class Foreign:
    """Another package's environment, with the protocol and nothing else; it counts what it is asked for."""

    def __init__(self, inner: Any) -> None:
        self.model, self.data, self.robot = inner.model, inner.data, inner.robot
        self.control_mode, self.target, self.lift_height = "joint", inner.target, 0.10
        self.object_names, self.support_name = inner.object_names, "table_top"
        self._inner = inner

    def joint_action(self, q_target: Any, gripper_width: float) -> Any:
        return self._inner.joint_action(q_target, gripper_width)

    def ee_action(self, base_target: Any, T_world_tcp: Any, gripper_width: float) -> Any:
        raise NotImplementedError

    def tcp_follower(self) -> TcpFollower:
        raise NotImplementedError


def test_the_protocol_is_all_that_the_expert_uses(env: gymnasium.Env) -> None:
    env.reset(seed=SEED)
    expert = TampExpert(Foreign(env.unwrapped))
    expert.reset()
    assert play(env, expert)
    assert expert.report.scored


@pytest.mark.parametrize("seconds", [0.0, 0.025])
def test_short_waits_end(env: gymnasium.Env, seconds: float) -> None:
    """The expert waited for ever where a wait was shorter than half a control step."""
    env.reset(seed=SEED)
    expert = TampExpert(env, config=ExpertConfig(settle_s=seconds, hold_s=seconds, with_floor=False))
    expert.reset()
    is_disturbed = False
    for _ in range(4000):
        if expert.done:
            break
        env.unwrapped.step(expert.act())
        if not is_disturbed and "transit" in expert.phase:
            is_disturbed = True
            env.unwrapped.data.joint(f"{expert.target}_joint").qpos[0] -= 0.03
    assert is_disturbed
    assert expert.done
    assert expert.report.replans >= 1
    assert expert.report.scored


def test_reset_begins_afresh_after_anything(env: gymnasium.Env) -> None:
    _, info = env.reset(seed=SEED)
    fresh = TampExpert(env)
    fresh.reset()
    first = fresh.act()

    env.reset(seed=SEED + 1)
    used = TampExpert(env)
    used.reset()
    assert play(env, used)
    assert used.report.scored
    env.reset(seed=SEED)
    used.reset(info["target"])
    assert not used.done
    assert used.target == info["target"]
    assert replace(used.report, planning_s=0.0, sim_s=0.0) == replace(fresh.report, planning_s=0.0, sim_s=0.0)
    np.testing.assert_array_equal(used.act(), first)
    assert [str(action) for action in actions(used)] == [str(action) for action in actions(fresh)]


def test_an_episode_may_begin_with_the_target_in_the_gripper(env: gymnasium.Env) -> None:
    """The plan is empty then; its execution raised IndexError."""
    env.reset(seed=SEED)
    expert = TampExpert(env)
    expert.reset()
    while "retreat" not in expert.phase:
        env.unwrapped.step(expert.act())
    expert.reset()
    assert actions(expert) == ()
    assert play(env, expert)
    assert expert.report.scored


def actions(expert: TampExpert) -> Any:
    assert isinstance(expert.solution, Solution)
    return expert.solution.actions


def test_a_planner_and_a_strategy_of_the_users_own(env: gymnasium.Env) -> None:
    calls = []

    class Own:
        def solve(self, scene: Scene, target: str, strategy: Strategy, *others: Any) -> Solution | Infeasible:
            calls.append((target, strategy))
            return Planner(scene.robot).solve(scene, target, strategy, *others)

    env.reset(seed=SEED)
    strategy = Strategy("mine", grasps="greedy", region="none", locations="random")
    expert = TampExpert(env, strategy, planner=Own())
    expert.reset()
    assert calls == [(expert.target, strategy)]
    assert actions(expert)[-1].target == expert.target
    assert expert.report.floor is not None


def test_a_planner_object_is_used_and_gets_the_follower() -> None:
    ee = gymnasium.make(ENV, control_mode="ee")
    ee.reset(seed=SEED)
    expert = TampExpert(ee, "dogar", planner=Planner(FETCH))
    expert.reset()
    assert isinstance(expert.solution, Solution)
    assert expert.solution.strategy == STRATEGIES["dogar"]
    for _ in range(20):
        ee.step(expert.act())
    ee.close()


def test_what_a_planner_returns_is_the_cause_or_is_refused(env: gymnasium.Env) -> None:
    class Answers:
        def __init__(self, answer: Any) -> None:
            self.answer = answer

        def solve(self, *_: Any) -> Any:
            return self.answer

    env.reset(seed=SEED)
    expert = TampExpert(env, planner=Answers(Infeasible(Cause.UNREACHABLE, "nothing is within reach")))
    expert.reset()
    assert expert.done
    assert expert.report.failure == "unreachable: nothing is within reach"
    with pytest.raises(ExpertError, match="returned None; it must return a Solution or an Infeasible"):
        TampExpert(env, planner=Answers(None)).reset()


def test_what_is_no_planner_or_not_for_it_is_refused(env: gymnasium.Env) -> None:
    class Own:
        """Another planner."""

        solve = Planner.solve

    wrong: tuple[Any, ...] = ("lookahead", object(), Planner)
    for planner in wrong:
        with pytest.raises(ExpertError, match="method solve"):
            TampExpert(env, planner=planner)
    with pytest.raises(ExpertError, match="supports='all' is for a Planner, not for Own"):
        TampExpert(env, planner=Own(), supports="all")
    with pytest.raises(ExpertError, match="canonical=True is for a Planner, not for Own"):
        TampExpert(env, planner=Own(), canonical=True)
    with pytest.raises(UnknownStrategy, match="lookahead"):
        TampExpert(env, strategy="magic")
    with pytest.raises(UnknownGraspSet, match="side, tilted, top, all"):
        TampExpert(env, grasps="back")
    expert = TampExpert(env, planner=Planner(FETCH), supports=("desk",))
    env.reset(seed=0)
    with pytest.raises(UnknownSupport, match="table_top, counter_left, counter_right"):
        expert.reset()
