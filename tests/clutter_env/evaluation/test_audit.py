"""The audit: what its tests call significant, and what its blind policies see."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from clutter_env.cli.main import main
from clutter_env.errors import LearningError
from clutter_env.evaluation.audit import Outcomes, Played, audit, episodes_of, expert_scenes
from clutter_env.evaluation.audit_plan import AuditPlan
from clutter_env.evaluation.blind import Demonstrations, Replay, blind, nearest, robot_only
from clutter_env.evaluation.evaluate import evaluate
from clutter_env.evaluation.paired import Discordant, fewest_won, pairs_of, smallest_shown
from clutter_env.evaluation.resampled import Spread
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.tables import results
from clutter_env.reporting.files import write_json
from clutter_env.reporting.intervals import wilson

ARM = SceneSet(env_id="clutter_env/ArmReach-v0", count=6)


@pytest.fixture(scope="module")
def known() -> Demonstrations:
    return Demonstrations.of(evaluate("armreach", ARM))


@pytest.mark.parametrize("one", range(0, 12, 3))
@pytest.mark.parametrize("other", range(0, 12, 3))
def test_the_paired_test_is_the_exact_one_of_a_fair_coin(one: int, other: int) -> None:
    expected = binomtest(one, one + other).pvalue if one + other else 1.0
    assert Discordant(one, other).p_value == pytest.approx(expected)


def test_what_so_many_scenes_can_show() -> None:
    assert (fewest_won(100), fewest_won(5)) == (6, None)
    found = smallest_shown(100, 0.95)
    assert found is not None
    rng = np.random.default_rng(0)
    won = rng.random((2, 4000, 100)) < np.array([0.95, 0.95 - found])[:, None, None]
    shown = np.mean([Discordant.of(*pair).p_value < 0.05 for pair in zip(*won, strict=True)])
    assert shown == pytest.approx(0.8, abs=0.03)
    assert smallest_shown(100, 0.03) is None, "even one that never succeeds is not told apart"
    assert smallest_shown(400, 0.95) < found  # type: ignore[operator]  # more scenes show more


def _content(policy: str, won: list[bool], suite: str = "a") -> dict[str, object]:
    episodes = [{"clean": one} for one in won]
    return {
        "policy": policy,
        "suite": suite,
        "suite_sha256": suite,
        "split": "test",
        "scenes": suite,
        "episodes": episodes,
    }


def test_pairs_are_of_two_policies_on_the_same_scenes() -> None:
    often, seldom = [True] * 20, [True] * 13 + [False] * 7
    contents = [_content("one", often), _content("two", seldom), _content("two", seldom, "b"), _content("one", often)]
    first, second = pairs_of(contents)
    assert (first.policies, first.clean, first.count) == (("one", "two"), (1.0, 0.65), 20)
    assert first.is_significant
    assert second.policies == ("two", "one")
    close = pairs_of([_content("one", often), _content("two", [True] * 18 + [False] * 2)])[0]
    assert close.is_difference
    assert not close.is_significant


def test_files_that_lack_what_is_compared_are_refused() -> None:
    whole = _content("a", [True])
    for name in ("suite_sha256", "scenes", "split"):
        lacking = {key: value for key, value in _content("b", [True]).items() if key != name}
        with pytest.raises(LearningError, match=f"lacks '{name}'"):
            pairs_of([whole, lacking])
    with pytest.raises(LearningError, match="lacks 'clean'"):
        pairs_of([whole, {**_content("b", []), "episodes": [{}]}])
    with pytest.raises(LearningError, match="no episode"):
        pairs_of([whole, _content("b", [])])


def test_a_blind_policy_acts_the_same_whatever_it_is_shown(known: Demonstrations) -> None:
    policy, rng = blind(known), np.random.default_rng(0)
    played = []
    for _ in range(2):
        policy.reset({})
        shown = {name: rng.normal(size=np.shape(part)) for name, part in known.first[0].items()}
        actions = []
        while not policy.done:
            actions.append(policy.act(shown))
        played.append(np.array(actions))
    assert (played[0] == played[1]).all()
    assert any(np.array_equal(played[0], one) for one in known.actions)


def test_a_policy_that_sees_some_entries_is_moved_by_those_alone(known: Demonstrations) -> None:
    policy = Replay(known, ("desired_goal",))
    for index, first in enumerate(known.first):
        policy.reset({})
        seen = {name: part if name == "desired_goal" else np.zeros_like(part) for name, part in first.items()}
        assert policy.act(seen) is not None
        assert (policy.act(seen) == known.actions[index][1]).all()
    assert robot_only(known)._entries == (), "a goal environment has one vector"


def test_who_sees_the_whole_scene_plays_a_known_scene_as_it_was_demonstrated(known: Demonstrations) -> None:
    found = evaluate(nearest(known), ARM)
    assert [score.clean for score in found.scores] == [True] * 6


def test_the_audit_s_own_policies_win_what_a_replay_says(known: Demonstrations) -> None:
    """They are scored as they play: half the time of `evaluate`, and no other process."""
    ticks: list[None] = []
    others = SceneSet(env_id="clutter_env/ArmReach-v0", count=6, first_seed=6)
    for scenes in (ARM, others):
        outcomes = Outcomes(scenes)
        for policy in (blind(known), nearest(known)):
            assert outcomes.wins(policy, lambda: ticks.append(None)) == evaluate(policy, scenes).num_clean
        again = len(outcomes._known)
        outcomes.wins(nearest(known))
        assert len(outcomes._known) == again, "what was played in a scene is not played again"
    assert len(ticks) == 24


def test_images_that_nobody_looks_at_are_seldom_rendered(known: Demonstrations) -> None:
    assert nearest(known).env_keywords == known.env_keywords
    hidden = replace(known, scenes=SceneSet("hidden-shelf-10-v2", count=1).scenes)
    assert nearest(hidden).env_keywords == {**known.env_keywords, "frame_every": 10}


def test_an_expert_may_play_fewer_scenes_than_the_others() -> None:
    assert [expert_scenes(AuditPlan(scenes=12, expert_scenes=count)) for count in (None, 0, 5, 20)] == [12, 0, 5, 12]
    assert episodes_of(AuditPlan(scenes=12, expert_scenes=0, demonstrations=4)) == 3 * 12 + 4


def test_a_network_learns_what_it_is_shown(known: Demonstrations, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    from clutter_env.evaluation import small_network

    monkeypatch.setattr(small_network, "STEPS", 300)
    blind_one = small_network.SmallNetwork(known, ())
    one, other = ({name: part * k for name, part in known.first[0].items()} for k in (0.0, 1.0))
    assert (blind_one.act(one) == blind_one.act(other)).all()
    seeing = small_network.SmallNetwork(known, tuple(known.first[0]))
    assert (seeing.act(one) != seeing.act(other)).any()
    for _ in range(2 * known.longest):
        seeing.act(one)
    assert seeing.done
    seeing.reset({})
    assert not seeing.done


def test_a_suite_is_named_on_which_a_blind_policy_comes_near_the_expert(monkeypatch: pytest.MonkeyPatch) -> None:
    from clutter_env.evaluation import audit as auditing

    expert, shares = wilson(10, 10), {"near": 0.3, "far": 0.29}
    for name, share in shares.items():
        played = (Played("blind", wilson(3, 10), share, True), Played("sees all", wilson(10, 10), 1.0, False))
        found = auditing.Audit(name, 10, 10, "expert", expert, played, Spread("expert", 10, (0.9, 1.0)), 6, 0.5)
        assert found.is_blind is (name == "near")
        monkeypatch.setattr(auditing, "audit", lambda *_, found=found: found)
        if name == "near":
            with pytest.raises(SystemExit) as end:
                main(["audit", name])
            assert end.value.code == 1
        else:
            main(["audit", name])


def test_the_differences_of_results_files_are_tested_in_pairs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for policy in ("armreach", "random"):
        write_json(tmp_path / f"{policy}.json", results(evaluate(policy, ARM)))
    main(["audit", "--files", *map(str, sorted(tmp_path.glob("*.json"))), "--json", str(tmp_path / "found")])
    assert "1 of 1 differences" in capsys.readouterr().out
    (pair,) = json.loads((tmp_path / "found").read_text())["pairs"]
    assert pair["p_value"] == 0.03125
    with pytest.raises(SystemExit, match="name a suite, or --files"):
        main(["audit"])


@pytest.mark.slow
@pytest.mark.parametrize("expert_scenes", [None, 0])
def test_the_audit_of_a_suite_plays_what_it_says(expert_scenes: int | None) -> None:
    plan = AuditPlan("direct-approach", 2, expert_scenes, demonstrations=10, suites=1)
    count = [0]
    found = audit("all-25-v3", plan, lambda: count.__setitem__(0, count[0] + 1))
    assert count == [episodes_of(plan)]
    assert (found.scenes, len(found.played), found.fewest_won) == (2, 3, None)
    assert found.spread is not None
    assert len(found.spread.rates) == 1
