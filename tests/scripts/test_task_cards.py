"""The task cards are those of today's environments and results, and their pictures show the target."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from clutter_env.errors import ConfigError
from clutter_env.task import family
from scripts import task_cards
from scripts.task_cards import CARDS, CARDS_OF_FAMILIES, Card

IDS = sorted(name for name in gym.registry if name.startswith("clutter_env/"))
WITH_RED_TARGET = ("Retrieve", "ArmRetrieve", "Search", "Skill", "Pick", "ArmPick")


@cache
def pages() -> dict[Path, str]:
    return task_cards.pages()


def test_every_environment_is_on_the_card_of_its_family() -> None:
    cards = {card.name.lower(): card for card in CARDS_OF_FAMILIES}
    assert {family(name) for name in IDS} == set(cards)
    for name in IDS:
        limit = gym.spec(name).max_episode_steps
        assert f"| `{name}` | {limit} |" in cards[family(name)].file.read_text()


def test_the_pages_are_those_that_the_script_writes() -> None:
    assert {path.name: path.read_text() for path in CARDS.glob("*.md")} == {
        path.name: text for path, text in pages().items()
    }, "python -m scripts.task_cards"


@pytest.mark.parametrize("card", CARDS_OF_FAMILIES, ids=lambda card: card.name)
def test_a_picture_is_small_and_shows_the_target(card: Card) -> None:
    assert card.picture.stat().st_size <= 100_000
    if card.name in WITH_RED_TARGET:
        red, green, blue = np.moveaxis(np.asarray(Image.open(card.picture).convert("RGB"), int), -1, 0)
        assert ((red > 80) & (red > 1.8 * green) & (red > 1.8 * blue)).sum() >= 300


@pytest.mark.parametrize("mode", ["sparse", "dense", "staged"])
@pytest.mark.parametrize(
    "env_id", ["Retrieve-o5-v0", "Rearrange-o4-v0", "Open-v0", "ArmRetrieve-o3-v0", "Pick-v0", "ArmPick-v0"]
)
def test_rewards_are_within_the_range_of_the_card(env_id: str, mode: str) -> None:
    try:
        env = gym.make(f"clutter_env/{env_id}", disable_env_checker=True, reward_mode=mode)
    except ConfigError:
        pytest.skip("no such reward")
    ranges = [row[-1] for row in task_cards.reward_rows(env) if f'"{mode}"' in row[0]]
    low, high = (float(bound.replace("∞", "inf")) for bound in ranges[0].split(", "))
    env.reset(seed=0)
    env.action_space.seed(0)
    rewards = [float(env.step(env.action_space.sample())[1]) for _ in range(80)]
    assert low <= min(rewards) <= max(rewards) <= high
    env.close()


def test_a_sentence_that_is_no_longer_on_its_page_is_an_error() -> None:
    with pytest.raises(ValueError, match="no longer says"):
        task_cards.quoted("results.md", r"SAC has (\d\d\d) everywhere", "")()


def test_every_figure_has_a_source() -> None:
    for card in CARDS_OF_FAMILIES:
        for score in (card.random(), card.expert(), card.learner()):
            assert score == task_cards.NOT_MEASURED or re.search(r"\d", score.figure)
            assert bool(score.source) == (score != task_cards.NOT_MEASURED)
