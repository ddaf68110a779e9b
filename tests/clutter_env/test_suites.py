"""Suites: their files, their scenes, and what happens when a scene is another one."""

from __future__ import annotations

import contextlib
import copy
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import assets
import clutter_env
from clutter_env.errors import SuiteError
from clutter_env.evaluation.suite_making import PLANS, STEPS_PER_PICK, make_suite, qualifying, step_limit
from clutter_env.suites import GRASPS, SPLITS, Floor, content_digest, scene_digests

PLANNED = {plan.name: plan for plan in PLANS}
NAMES = tuple(sorted(PLANNED))


def _clearances(floor: Floor) -> float:
    """The count; infinite without a plan."""
    return math.inf if floor.count is None else floor.count


def test_the_suites_are_there() -> None:
    assert clutter_env.suite_names() == NAMES
    with pytest.raises(SuiteError, match=r"no suite 'side-1'; suites: all-25-v3, .*side-40-v3"):
        clutter_env.suite("side-1")
    with pytest.raises(SuiteError, match=r"no suite 'side-15-v1'; 'side-15-v3' has replaced it; suites: "):
        clutter_env.suite("side-15-v1")
    with pytest.raises(SuiteError, match="suites: all-25-v3"):
        clutter_env.suite(["side-15-v3"])  # type: ignore[arg-type]  # what a user may give


@pytest.mark.parametrize("name", NAMES)
def test_every_suite_has_its_scenes(name: str) -> None:
    suite = clutter_env.suite(name)
    assert [len(suite.split(split)) for split in SPLITS] == [100, 100]
    seeds = [scene.seed for split in SPLITS for scene in suite.split(split)]
    assert len(set(seeds)) == len(seeds)
    assert list(suite) == list(suite.test)
    if PLANNED[name].is_hidden:
        assert {scene.floor_side or scene.floor_all for split in SPLITS for scene in suite.split(split)} == {None}
        return
    for scene in (*suite.test, *suite.validation):
        assert scene.floor_side.cause or scene.floor_side.is_proved
        assert scene.floor("all").cause or scene.floor("all").is_proved
        assert _clearances(scene.floor("all")) <= _clearances(scene.floor("side")), "side grasps are among all"
        if least := PLANNED[name].clearances:
            assert scene.floor_side.is_proved
            assert (scene.floor_side.count or 0) >= least
        counts = [floor.count for floor in (scene.floor_side, scene.floor_all) if floor and floor.count is not None]
        least_limit = step_limit(max(counts, default=0))
        wanted_more, rest = divmod(scene.max_steps - least_limit, STEPS_PER_PICK)
        assert rest == 0, "all policies have the same time"
        assert wanted_more >= 0 if PLANNED[name].task else wanted_more == 0
    with pytest.raises(SuiteError, match="splits: test, validation"):
        suite.split("train")


@pytest.mark.parametrize("name", NAMES)
def test_resets_give_the_scenes_of_the_suite(name: str) -> None:
    suite = clutter_env.suite(name)
    env = suite.test[0].make()
    for scene in (*suite.test[:3], *suite.validation[:2]):
        _, info = scene.reset(env)
        assert info["target"] == scene.target
        assert scene_digests(env) == dict(scene.digests)
        if PLANNED[name].is_hidden:
            assert scene.max_steps == clutter_env.search_time_limit(len(env.unwrapped.object_names))  # type: ignore[attr-defined]  # every environment here has it
            continue
        counts = [scene.floor(grasps).count or 0 for grasps in GRASPS]
        assert scene.max_steps == step_limit(max(counts), info.get("unmet", 1))


def test_an_episode_has_the_time_limit_of_its_scene_in_an_environment_of_another() -> None:
    scenes = clutter_env.suite("deep-15-v2").test
    env = scenes[0].make()
    for limit in (3, 5, 4):
        replace(scenes[limit], max_steps=limit).reset(env)
        assert env.spec is not None
        assert env.spec.max_episode_steps == limit
        assert [env.step(env.action_space.sample())[3] for _ in range(limit)] == [False] * (limit - 1) + [True]
    with pytest.raises(SuiteError, match="no time limit"):
        scenes[0].reset(env.unwrapped)


def test_another_scene_is_an_error_that_says_which_and_what() -> None:
    scene = clutter_env.suite("side-15-v3").test[3]
    env = scene.make()
    other = replace(scene, seed=scene.seed + 1)
    with pytest.raises(
        SuiteError, match=r"scene 3 of suite 'side-15-v3' \(test, seed \d+\).*differs: half_extents, posi"
    ):
        other.reset(env)
    lighter = replace(scene, digests={**scene.digests, "masses": "0" * 12})
    with pytest.raises(SuiteError, match=r"what differs: masses$"):
        lighter.reset(env)


def test_a_joint_in_another_place_is_noticed() -> None:
    scene = clutter_env.suite("side-15-v3").test[0]
    env = scene.make()
    scene.reset(env)
    env.unwrapped.data.qpos[0] += 1e-15  # type: ignore[attr-defined]  # every environment here has MuJoCo data
    with pytest.raises(SuiteError, match=r"what differs: joint_positions$"):
        scene.check(env)


def test_the_keywords_of_the_suite_stay() -> None:
    scene = clutter_env.suite("dense-25-v3").test[0]
    assert scene.make(control_mode="ee").unwrapped.control_mode == "ee"
    with pytest.raises(SuiteError, match="made with 'dense'"):
        scene.make(layout="paper")


@pytest.fixture
def suite_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of a suite's file that is read in place of it."""
    file = tmp_path / "suites" / "side-15-v3.json"
    file.parent.mkdir()
    shutil.copy(assets.path("suites/side-15-v3.json"), file)
    monkeypatch.setattr("assets.path", lambda relative: tmp_path / relative)
    return file


def test_a_changed_file_is_refused(suite_file: Path) -> None:
    content = json.loads(suite_file.read_text())
    content["scenes"]["test"][0]["target"] = "object_14"
    suite_file.write_text(json.dumps(content))
    with pytest.raises(SuiteError, match="has been changed"):
        clutter_env.suite("side-15-v3")
    write_sealed(suite_file, content)
    assert clutter_env.suite("side-15-v3").test[0].target == "object_14"


def write_sealed(file: Path, content: dict[str, Any]) -> None:
    """Write a suite's file with the digest that its content has."""
    content = {name: value for name, value in content.items() if name != "sha256"}
    file.write_text(json.dumps({**content, "sha256": content_digest(content)}))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", "{}", '{"sha256": 3}', "[" * 100_000, "\udcff"])
def test_a_damaged_file_is_an_error_of_the_suite(suite_file: Path, text: str) -> None:
    suite_file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(SuiteError, match="side-15-v3"):
        clutter_env.suite("side-15-v3")


@pytest.mark.parametrize("value", ["missing", None, 3, "text", [], {"a": 1}])
def test_a_sealed_file_with_a_wrong_entry_is_an_error_of_the_suite(suite_file: Path, value: object) -> None:
    """An entry that happens to fit may be accepted; no other exception than a SuiteError leaves the reader."""
    whole = json.loads(suite_file.read_text())
    for split in SPLITS:
        del whole["scenes"][split][2:]
    for holder in ((), ("scenes",), ("scenes", "test", 0), ("scenes", "test", 0, "floor_side")):
        inner = whole
        for step in holder:
            inner = inner[step]
        for name in tuple(inner):
            content = copy.deepcopy(whole)
            place = content
            for step in holder:
                place = place[step]
            if value == "missing":
                del place[name]
            else:
                place[name] = value
            write_sealed(suite_file, content)
            with contextlib.suppress(SuiteError):
                clutter_env.suite("side-15-v3")
                assert value != "missing" or name in ("sha256", "format"), f"{name} is missing"


def test_a_floor_belongs_to_a_grasp_set() -> None:
    scene = replace(clutter_env.suite("side-15-v3").test[0], floor_side=Floor(2, True), floor_all=Floor(1, False))
    assert (scene.floor("side"), scene.floor("all")) == (Floor(2, True), Floor(1, False))
    with pytest.raises(SuiteError, match="have them for: side, all"):
        scene.floor("top")
    with pytest.raises(SuiteError, match="no floors for grasps='all'"):
        replace(scene, floor_all=None).floor("all")


def is_higher(stored: dict[str, Any] | None, found: dict[str, Any] | None) -> bool:
    """Whether a lower bound is higher than the stored one: more base poses than then can only lower it."""
    return stored is not None and found is not None and _clearances(Floor(**found)) > _clearances(Floor(**stored))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_making_a_suite_again_gives_the_same_scenes_with_no_higher_bounds(name: str) -> None:
    rules = replace(PLANNED[name].rules, clearances=0)
    shipped = json.loads(assets.path(f"suites/{name}.json").read_text())
    for split in SPLITS:
        for stored in shipped["scenes"][split][:3]:
            (found,) = qualifying(rules, [stored["seed"]], 1, 1)
            assert {part: found[part] for part in ("target", "digests")} == {
                part: stored[part] for part in ("target", "digests")
            }
            assert found["max_steps"] <= stored["max_steps"]
            assert not any(is_higher(stored[floor], found[floor]) for floor in ("floor_side", "floor_all"))


@pytest.mark.slow
def test_making_a_suite_keeps_only_scenes_that_qualify_by_the_bounds_of_today() -> None:
    made = make_suite(PLANNED["deep-15-v2"], 1, 1)
    for split in SPLITS:
        (entry,) = made["scenes"][split]
        assert entry["floor_side"]["is_proved"]
        assert entry["floor_side"]["count"] >= PLANNED["deep-15-v2"].rules.clearances
