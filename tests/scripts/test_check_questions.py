"""Questions about scenes: every answer beside an exhaustive check, files that say what was asked, scores of rules."""

from __future__ import annotations

import json
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from clutter_env.cli.main import main
from clutter_env.errors import LearningError
from clutter_env.evaluation import question_files
from clutter_env.evaluation.question_balance import COMMON, ON_SQUARE, Asked, balanced
from clutter_env.evaluation.question_files import QUESTIONS, SCENES, asked, read_lines, scenes
from clutter_env.evaluation.question_scores import BASELINES, COMMONEST, LEARNED, answered, scored
from clutter_env.evaluation.questions import DIRECTIONS, DRIVES, KINDS, OF_GRASPS, SIDES, Answer, Asker, Question
from scripts.check_questions import Checker
from scripts.sampled_grasps import SampledChecker

FIRST = 40_000_000


def wrong_of(objects: int, count: int) -> tuple[list[tuple[Question, object]], set[str]]:
    """The wrong answers about some scenes, and the kinds that were asked."""
    wrong, kinds = [], set[str]()
    for kind, seed in scenes(objects, count, FIRST):
        with closing(gym.make(kind.env_id, **kind.keywords)) as env:
            scene, _, questions, _ = asked(env, kind, seed, Asker())
            wrong += [*Checker(env).wrong(scene, questions)]
            kinds |= {question.kind for question in questions}
    return wrong, kinds


@pytest.mark.parametrize("objects", [3, 6])
def test_an_exhaustive_check_agrees_with_every_answer(objects: int) -> None:
    wrong, kinds = wrong_of(objects, 5)
    assert wrong == []
    assert {"taken now", "touched", "falls"} <= kinds


@pytest.mark.slow
def test_an_exhaustive_check_agrees_with_every_kind_of_answer() -> None:
    wrong, kinds = wrong_of(6, 60)
    assert wrong == []
    assert kinds == set(KINDS)


@pytest.mark.slow
def test_grasps_that_are_sampled_in_mujoco_agree_with_every_answer() -> None:
    for kind, seed in scenes(6, 4, FIRST):
        with closing(gym.make(kind.env_id, **kind.keywords)) as env:
            scene, _, questions, _ = asked(env, kind, seed, Asker())
            assert [*SampledChecker(env).wrong(scene, questions)] == []


def test_sampled_grasps_find_wrong_answers() -> None:
    (kind, seed), _ = scenes(3, 2, FIRST)
    with closing(gym.make(kind.env_id, **kind.keywords)) as env:
        scene, _, questions, _ = asked(env, kind, seed, Asker())
        free = [one for one in questions if one.kind == "taken now" and one.answer]
        turned = [replace(one, answer=False) for one in free]
        assert [found for _, found in SampledChecker(env).wrong(scene, turned)] == [True] * len(turned) != []


def test_the_colour_of_an_object_does_not_say_whether_it_can_be_taken() -> None:
    """Before questions were balanced, 64 of 70 answers followed from the target's colour."""
    about = list[Asked]()
    asker, envs = Asker(), {kind.env_id: gym.make(kind.env_id, **kind.keywords) for kind, _ in scenes(6, 5, FIRST)}
    for kind, seed in scenes(6, 60, FIRST):
        if not kind.env_id.startswith("clutter_env/Retrieve"):
            continue
        scene, target, questions, _ = asked(envs[kind.env_id], kind, seed, asker)
        about += [Asked(one, one.about == target, scene.body(one.about).position) for one in questions]
    for env in envs.values():
        env.close()
    kept = [about[index] for index in balanced(about, np.random.default_rng(0))]
    for is_target in (True, False):
        answers = [one.question.answer for one in kept if one.group == ("taken now", is_target)]
        assert answers.count(True) == answers.count(False) > 5


def test_the_commonest_answers_of_a_kind_are_equally_common() -> None:
    answers: list[Answer] = [(), (), (), (), ("a",), ("b",), ("a",), ("a", "b"), ("b", "c"), ("a", "b", "c")]
    asked_of = [Asked(Question("touched", "d", "?", answer), True, (0.0, 0.0, 0.8)) for answer in answers]
    kept = [asked_of[index] for index in balanced(asked_of, np.random.default_rng(0))]
    assert Counter(one.answer for one in kept) == {0: 2, 1: 2, 2: 2, 3: 1}
    assert balanced([one for one in asked_of if one.answer != 0 and one.answer != 3], np.random.default_rng(0)) == []
    of_others = [replace(one, is_target=False) for one in asked_of[:4]]
    assert len(balanced([*asked_of, *of_others], np.random.default_rng(0))) == len(kept)
    assert set(COMMON) == set(KINDS)


def test_answers_are_equally_common_on_each_square() -> None:
    """What stands far back can be taken, here in three of four scenes, and what stands in front in one."""
    asked_of = [
        Asked(Question("taken now", "a", "?", is_free), False, (x, y, 0.8))
        for x, free in ((-0.4, 1), (0.4, 3))
        for is_free in (True,) * free + (False,) * (4 - free)
        for y in (-0.2, 0.2)
    ]
    kept = [asked_of[index] for index in balanced(asked_of, np.random.default_rng(0))]
    assert Counter((one.square, one.answer) for one in kept) == {
        (square, answer): 2 for square in ((-2, 1), (2, 1)) for answer in (True, False)
    }
    assert set(ON_SQUARE) < set(KINDS)


def test_rules_learn_from_the_other_half_of_the_scenes() -> None:
    """The red object is the one that cannot be taken; what stands at the left can."""
    objects = [
        {"name": "a", "position": (0.0, -0.4, 0.8), "half_extents": (0.03, 0.03, 0.1), "colour": (1.0, 0.0, 0.0)},
        {"name": "b", "position": (0.0, 0.4, 0.8), "half_extents": (0.03, 0.03, 0.1), "colour": (0.0, 1.0, 0.0)},
    ]
    placed = [{"scene": str(index), "objects": objects} for index in range(10)]
    asked_of = [
        {**_question(f"{scene}{name}", name == "b"), "kind": "taken now", "scene": str(scene), "about": name}
        for scene in range(10)
        for name in ("a", "b")
    ]
    for rule in LEARNED:
        assert scored(asked_of, answered(rule, asked_of, placed))["all"].mean == 1.0
        assert answered(rule, asked_of[:10], placed) == {}


def test_the_check_finds_wrong_answers() -> None:
    ((kind, seed),) = scenes(4, 1, FIRST)
    with closing(gym.make(kind.env_id, **kind.keywords)) as env:
        scene, target, questions, _ = asked(env, kind, seed, Asker())
        turned = [
            Question(one.kind, one.about, one.text, not one.answer if isinstance(one.answer, bool) else ("nothing",))
            for one in questions
        ]
        assert len([*Checker(env).wrong(scene, turned)]) == len(turned) > 0
        assert target in {question.about for question in questions}


def test_every_direction_has_one_side() -> None:
    assert len(DIRECTIONS) == 24
    assert {side: DIRECTIONS.count(side) for side in SIDES} == {"front": 7, "left": 5, "right": 5, "behind": 7}
    assert (DIRECTIONS[0], DIRECTIONS[6], DIRECTIONS[12], DIRECTIONS[18]) == ("front", "right", "behind", "left")


def test_the_text_does_not_depend_on_where_the_robot_stands_and_looks() -> None:
    """The robot looks up to 27° past the table: bars along its gaze would touch other objects in a fifth of scenes."""
    for kind, seed in scenes(6, 4, FIRST):
        with closing(gym.make(kind.env_id, **kind.keywords)) as env:
            for question in asked(env, kind, seed, Asker())[2]:
                assert "own direction" not in question.text
                assert "away from the robot" not in question.text
                assert (DRIVES in question.text) is (question.kind in OF_GRASPS)
                if question.kind in ("from where", "touched"):
                    assert "at right angles to that edge" in question.text


@pytest.mark.usefixtures("needs_gl")
def test_nothing_is_asked_about_grasps_where_an_object_is_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(question_files, "_hidden", lambda masks, _: {min(masks)})
    question_files.write_questions(tmp_path, 6, 10, FIRST, 64)
    asked_of = read_lines(tmp_path / QUESTIONS, ("kind", "about"))
    assert asked_of
    assert not {one["kind"] for one in asked_of} & set(OF_GRASPS)
    assert "object_00" not in {one["about"] for one in asked_of}


def test_the_commonest_answer_is_what_can_be_won_without_looking() -> None:
    questions = [{**_question(str(k), k > 0), "kind": "taken now"} for k in range(4)]
    assert scored(questions, answered(COMMONEST, questions, []))["all"].mean == 0.75


@pytest.mark.usefixtures("needs_gl")
def test_files_say_what_was_asked_and_simple_rules_are_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = {"scenes": 20, "image-size": 128, "out": tmp_path, "first-seed": FIRST}
    main(["questions", "make", *(f"--{name}={value}" for name, value in chosen.items())])
    questions = read_lines(tmp_path / QUESTIONS, ("id", "text"))
    placed = {line["scene"]: line for line in read_lines(tmp_path / SCENES, ("objects",))}
    assert len(placed) == 20
    for question in questions:
        names = [one["name"] for one in placed[question["scene"]]["objects"]]
        assert question["about"] in names
        assert question["about"] in question["text"]
        shown = []
        for files in question["images"].values():
            masks, colours = (np.array(Image.open(tmp_path / files[part])) for part in ("segmentation", "rgb"))
            assert (masks.shape, colours.shape) == ((128, 128), (128, 128, 3))
            shown += masks.ravel().tolist()
        answer = question["answer"] if question["kind"] in ("which", "touched", "falls") else []
        assert {question["mask_values"][name] for name in (question["about"], *answer)} <= {*shown}
    answers = [{"id": one["id"], "answer": one["answer"]} for one in questions]
    (tmp_path / "answers.jsonl").write_text("".join(f"{json.dumps(one)}\n" for one in answers))
    words = ["questions", "score", str(tmp_path), "--answers", str(tmp_path / "answers.jsonl")]
    main([*words, "--baselines", *BASELINES, "--json", str(tmp_path / "scores.json")])
    found = json.loads((tmp_path / "scores.json").read_text())
    assert found["answers.jsonl"]["all"]["mean"] == 1.0
    assert all(found[rule]["all"]["mean"] < 1.0 for rule in BASELINES)
    assert "nearest-first" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="name --answers, or --baselines"):
        main(words[:3])
    with pytest.raises(
        SystemExit, match="valid values: 'commonest', 'colour', 'place', 'random', 'nearest-first', 'shadow'"
    ):
        main([*words[:3], "--baselines", "best"])


def _question(name: str, answer: object) -> dict[str, object]:
    return {"id": name, "kind": "which", "scene": "one", "about": "a", "answer": answer, "choices": ["b", "c"]}


def test_only_the_right_answer_of_the_right_type_counts() -> None:
    questions = [_question("yes", True), _question("two", 2), _question("names", ["b", "c"]), _question("none", [])]
    right = {"yes": True, "two": 2, "names": ["c", "b"], "none": []}
    assert scored(questions, right)["all"].mean == 1.0
    for name, given in {"yes": 1, "two": 2.5, "names": ["b"], "none": None}.items():
        assert scored(questions, {**right, name: given})["which"].mean == 0.75
    assert scored(questions, {})["all"].mean == 0.0
    with pytest.raises(LearningError, match="no question 'other'"):
        scored(questions, {"other": 1})


def test_rules_answer_from_where_everything_stands() -> None:
    at = {"a": (0.0, 0.0), "b": (-0.1, 0.0), "c": (0.3, 0.0)}
    objects = [{"name": one, "position": (*xy, 0.8), "half_extents": (0.03, 0.03, 0.1)} for one, xy in at.items()]
    placed = [{"scene": "one", "objects": objects}]
    asked_of = [
        {**_question(kind, []), "kind": kind, "choices": list(SIDES)} for kind in ("from where", "fewest", "which")
    ]
    shadow, near = (answered(rule, asked_of, placed) for rule in ("shadow", "nearest-first"))
    assert shadow == {"from where": [], "fewest": 1, "which": ["b"]}
    assert near == {"from where": ["left", "right", "behind"], "fewest": 1, "which": ["b"]}


def test_a_file_that_is_none_is_told(tmp_path: Path) -> None:
    file = tmp_path / "answers.jsonl"
    file.write_text('{"id": 1}\n')
    with pytest.raises(LearningError, match="line 1 has no 'answer'"):
        read_lines(file, ("id", "answer"))
    file.write_text("no json\n")
    with pytest.raises(LearningError, match="cannot be read"):
        read_lines(file, ())
