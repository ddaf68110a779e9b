"""The attacks of the verification page: those that are said to hold do, and those that are said not to hold work."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from scripts import attacks

PAGE = Path(__file__).parents[2] / "docs" / "verification.md"


@pytest.mark.slow
def test_the_page_says_of_every_attack_whether_it_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    Path("attacking.py").write_text(attacks.POLICIES.replace("GUESSES", "1000"))
    table = PAGE.read_text().split("### Ten attacks\n", 1)[1].split("\n## ", 1)[0]
    said = dict(re.findall(r"^\| (.*?) \| \**(yes|no)\** \|", table, re.MULTILINE))
    found = {one.attack: one.holds.strip("*") for one in attacks._attempts()}
    assert len(found) == 10
    assert found == said
