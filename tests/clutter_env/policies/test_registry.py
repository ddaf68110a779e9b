"""Policies by name, and the files of their weights."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import torch

from assets import FETCH
from clutter_env.policies.experts import GreedyPolicy
from clutter_env.policies.motion.keyframe_policy import KeyframePolicy
from clutter_env.policies.motion.network import KeyframeNetwork
from clutter_env.policies.protocol import PolicyError, PublicInfo, begin_episode
from clutter_env.policies.registry import BUILT_IN, PolicyTraits, load_policy
from clutter_env.policies.two_level import TwoLevelPolicy
from clutter_env.policies.weights import PROBLEMS, load_weights, save_weights, shipped_path, trained_in
from clutter_env.scene.layout import Layout


def test_every_built_in_policy_is_made_and_has_the_protocol() -> None:
    for name in BUILT_IN:
        policy = load_policy(name, seed=0)
        assert callable(policy.reset)
        assert callable(policy.act)
        grasps = PolicyTraits.of(policy).grasps
        assert grasps == ("all" if name.endswith("-all") else grasps)
    assert isinstance(load_policy("keyframes-shelf", 0), TwoLevelPolicy)
    assert not load_policy("keyframes", 0).is_privileged  # type: ignore[union-attr]  # a TwoLevelPolicy


def test_an_unknown_policy_is_refused_with_the_known_ones() -> None:
    with pytest.raises(PolicyError, match="direct-approach"):
        load_policy("nosuch", 0)
    for name in ("json:nosuch", "nosuch:Policy"):
        with pytest.raises(PolicyError, match="cannot be imported"):
            load_policy(name, 0)


def test_the_errors_of_a_users_module_are_not_wrapped_and_the_old_protocol_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "needs_more.py").write_text("import surely_not_there\n")
    old = "class Old:\n    def reset(self, env, info): ...\n    def act(self, observation): ...\n"
    (tmp_path / "of_old.py").write_text(old + "def broken(): raise ZeroDivisionError\n")
    own = "class Own:\n    def __init__(self{}): ...\n" + old.partition("\n")[2].replace("env, ", "")
    (tmp_path / "own.py").write_text(
        own.format(", size") + "    grasps = 'level'\nclass Level(Own):\n    __init__ = object.__init__"
    )
    with pytest.raises(ModuleNotFoundError, match="surely_not_there"):
        load_policy("needs_more:Policy", 0)
    with pytest.raises(ZeroDivisionError):
        load_policy("of_old:broken", 0)
    with pytest.raises(PolicyError, match=r"reset\(info, env\)"):
        load_policy("of_old:Old", 0)
    with pytest.raises(PolicyError, match=r"'own:Own' cannot be made.*'size'"):
        load_policy("own:Own", 0)
    with pytest.raises(PolicyError, match=r"grasps='level' are not valid.*side, all"):
        load_policy("own:Level", 0)


def test_baselines_refuse_environments_in_which_they_cannot_act(env: gym.Env[Any, Any]) -> None:
    _, info = env.reset(seed=0)
    for policy, named in ((GreedyPolicy(), "Skill"), (load_policy("direct-approach", 0), "control_mode='ee'")):
        with pytest.raises(PolicyError, match=named):
            begin_episode(policy, info, env)


def test_policies_without_networks_do_without_torch() -> None:
    code = "import sys; from clutter_env.policies.registry import load_policy; load_policy('random', 0); "
    subprocess.run([sys.executable, "-c", code + "assert not {'torch', 'numba'} & set(sys.modules)"], check=True)


@pytest.mark.parametrize("kind", ["motions", "decisions"])
def test_shipped_weights_say_what_they_are_for_and_were_trained_with(kind: str) -> None:
    for problem in PROBLEMS:
        _, info = load_weights(shipped_path(kind, problem), kind)
        assert (info.robot, info.grasps) == ("fetch", "all" if problem == "all" else "side")
        assert info.layout == ("shelf" if problem == "shelf" else "paper")
        assert info.provenance["version"]
        assert info.provenance["trained_with"]
    with pytest.raises(PolicyError, match="side, all, shelf"):
        shipped_path(kind, "cabinet")


def test_weights_refuse_another_layout() -> None:
    env = gym.make("clutter_env/Retrieve-o1-v0", layout="island")
    _, info = env.reset(seed=0)
    with pytest.raises(PolicyError, match=r"'paper'.*'island'"):
        begin_episode(load_policy("keyframes", 0), info, env)


def test_weights_for_a_users_own_robot_and_layout_are_loaded_again(tmp_path: Path) -> None:
    bench, robot = Layout("bench", depth=0.6, width=1.1), replace(FETCH, name="mine", max_loaded_yaw_rate=0.1)
    env = gym.make("clutter_env/Retrieve-o1-v0", layout=bench, robot=robot)
    network, _ = KeyframeNetwork.load(shipped_path("motions", "shelf"))
    save_weights(tmp_path / "w.npz", network, trained_in(env, "motions", "side"))
    policy = KeyframePolicy.load(tmp_path / "w.npz")
    begin_episode(policy, env.reset(seed=0)[1], env)
    for changed in ({"layout": replace(bench, width=1.2)}, {"robot": replace(robot, max_loaded_yaw_rate=0.2)}):
        other = gym.make("clutter_env/Retrieve-o1-v0", **{"layout": bench, "robot": robot, **changed})
        other.reset(seed=0)
        with pytest.raises(PolicyError, match=r"'mine \(of your own\)' and layout 'bench \(of your own\)'"):
            policy.check(PublicInfo.of(other))


def test_weights_survive_their_file_and_other_files_are_refused(tmp_path: Path) -> None:
    network, info = KeyframeNetwork.load(shipped_path("motions", "shelf"))
    save_weights(tmp_path / "new" / "w.npz", network, replace(info, grasps="all"))
    again, other = KeyframeNetwork.load(tmp_path / "new" / "w.npz")
    assert other == replace(info, grasps="all")
    assert again.is_under_shelf
    for name, value in network.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])
    with pytest.raises(PolicyError, match="holds motions, not decisions"):
        load_weights(tmp_path / "new" / "w.npz", "decisions")
    (tmp_path / "damaged.npz").write_bytes(b"nothing")
    shutil.copy(shipped_path("motions", "side"), tmp_path / "short.npz")
    (tmp_path / "short.npz").write_bytes((tmp_path / "short.npz").read_bytes()[:5000])
    for name in ("damaged.npz", "absent.npz", "short.npz"):
        with pytest.raises(PolicyError, match=name):
            load_weights(tmp_path / name, "motions")
