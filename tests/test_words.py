"""Docstrings and pages get no harder to read, by the counts of `scripts/house.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.house import PATTERNS, Sentence, files_of, marked, sentences, words

ROOT = Path(__file__).resolve().parents[1]
MOST_MARKS = {
    "assets": 2.0,
    "irm": 2.5,
    "planners": 4.0,
    "clutter_env": 3.0,
    "scripts": 20.5,
    "README.md": 6.5,
    "docs/*.md": 2.5,
    "docs/tutorials": 3.0,
    "docs/environments": 2.0,
    "docs/guides": 4.0,
}
"""Marks per 1,000 words. Lower a limit when the words of a folder have become plainer; never raise one."""


@pytest.mark.parametrize("folder", MOST_MARKS)
def test_words_get_no_harder_to_read(folder: str) -> None:
    files = sorted(ROOT.glob(folder)) if "*" in folder else files_of(folder)
    assert words(files)["all marks, per 1,000 words"] <= MOST_MARKS[folder], (
        f"python scripts/house.py --marks {folder} prints the sentences"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("What is in the way.", ["question first"]),
        ("Objects in the way; the target.", ["semicolon"]),
        ("Nothing but for the hand.", ["but for"]),
        ("It is looked whether that is free.", ["is looked"]),
        ("Lower bound of the picks.", []),
        (" ".join(["word"] * 26), ["long"]),
    ],
)
def test_each_pattern_marks_what_it_is_for(text: str, expected: list[str]) -> None:
    found = marked([Sentence(Path("file.py"), 1, text, is_first=True)])
    assert [name for _, name in found] == expected


def test_sentences_of_pages_leave_out_code_and_tables(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Title; no\n\nFirst one. Second one.\n\n```sh\nls; ls\n```\n\n| a; b |\n|---|\n")
    assert [sentence.text for sentence in sentences([page])] == ["First one.", "Second one."]
    assert "long" not in PATTERNS


def test_every_item_of_a_list_is_a_sentence_of_its_own(tmp_path: Path) -> None:
    """Short items were joined and counted as one long sentence. Items that begin with a question were not marked."""
    page = tmp_path / "page.md"
    page.write_text("The steps:\n\n- One of\n  two lines.\n- What follows. `b` ends.\n1. Last\n")
    assert [(sentence.text, sentence.is_first) for sentence in sentences([page])] == [
        ("The steps:", True),
        ("One of two lines.", True),
        ("What follows.", True),
        ("`b` ends.", False),
        ("Last", True),
    ]
