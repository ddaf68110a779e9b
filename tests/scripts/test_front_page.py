"""The film of the first page is that of a results file, and README says what it shows."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

from clutter_env.evaluation.verify import claimed, read_results
from scripts import front_page

ROOT = Path(__file__).resolve().parents[2]
README = " ".join((ROOT / "README.md").read_text().split())


def test_the_film_is_that_of_the_results_file() -> None:
    with Image.open(front_page.FILM) as film:
        made_from = json.loads(film.info["comment"])
    digest = read_results(front_page.RESULTS)["digest"]
    assert made_from == {front_page.RESULTS.name: digest}, "python scripts/front_page.py"


def test_readme_says_what_the_film_shows() -> None:
    evaluation = claimed(front_page.RESULTS)
    score, bound = evaluation.scores[front_page.EPISODE], evaluation.floors[front_page.EPISODE]
    assert score.clean
    assert bound.is_proved
    assert bound.count is not None
    assert front_page.answer(score.moved, bound.count) in README
