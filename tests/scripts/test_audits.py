"""The small audits of the suites: of each as it is today, and on the page as the file has them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clutter_env.evaluation.audit import BLIND_SHARE
from clutter_env.suites import suite, suite_names
from scripts import audits

PAGE = Path(__file__).parents[2] / "docs" / "audit.md"


def test_the_page_has_the_table_of_the_file() -> None:
    assert audits.table(audits.audits()).strip() in PAGE.read_text()


@pytest.mark.parametrize("name", sorted(audits.audits()))
def test_an_audit_is_of_the_suite_as_it_is(name: str) -> None:
    found = audits.audits()[name]
    assert found["suite_sha256"] == suite(name).digest
    assert found["suite"] == name
    assert found["scenes"] >= audits.PLAN.scenes
    assert len(found["played"]) == 3


def test_the_page_names_the_suites_that_have_not_been_audited() -> None:
    line = next((line for line in PAGE.read_text().splitlines() if line.startswith("Not audited:")), "")
    assert set(re.findall(r"`([\w-]+-v\d)`", line)) == set(suite_names()) - set(audits.audits())


def test_a_suite_that_is_won_without_looking_is_named_on_the_page() -> None:
    page = PAGE.read_text()
    for name, found in audits.audits().items():
        if any(one["is_blind"] and one["share"] >= BLIND_SHARE for one in found["played"]):
            assert f"`{name}` is won without looking" in page
