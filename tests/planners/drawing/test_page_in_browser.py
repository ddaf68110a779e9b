"""The page in a real browser, the network off: it draws, its time line moves, what is clicked is shown."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from planners.drawing.page.live import LivePage
from planners.drawing.page.page import plan_recording, write_page
from planners.expert.report import Note, Recording, Solve
from tests.browser import CHROMIUM, Browser
from tests.planners.plans import refused, solved

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine (Debian: chromium)")

TIME = "Number(document.body.dataset.time)"
STAGE = (slice(0, 540), slice(0, 520))
"""Pixels of the scene."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile"), (900, 600)) as opened:
        yield opened


@pytest.fixture(scope="module")
def recording() -> Recording:
    return plan_recording(solved())


@pytest.fixture
def page(browser: Browser, recording: Recording, tmp_path: Path) -> Browser:
    write_page(tmp_path / "page.html", recording, {"success": "yes, by the environment"}, "success")
    browser.problems.clear()
    browser.open((tmp_path / "page.html").as_uri())
    return browser


def picture(browser: Browser) -> np.ndarray:
    """What is seen after the next two frames."""
    browser.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB")).astype(int)


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the scene's pixels that differ."""
    return float((np.abs(one[STAGE] - other[STAGE]).max(axis=2) > 12).mean())


def test_the_page_draws_without_a_complaint(page: Browser) -> None:
    page.wait(f"{TIME} === 0")
    colours = picture(page)[STAGE].reshape(-1, 3)
    assert len(np.unique(colours // 16, axis=0)) > 40
    is_red = (colours[:, 0] > 120) & (colours[:, 1] < 70) & (colours[:, 2] < 70)
    assert is_red.sum() > 30, "the target is seen"
    assert page.value("document.getElementById('problem').hidden")
    assert page.value("document.getElementById('result').textContent") == "Success"
    assert page.problems == []


def test_on_a_telephone_nothing_covers_the_phase_and_nothing_is_wider_than_the_screen(page: Browser) -> None:
    page.resize(390, 844)
    try:
        page.value("document.getElementById('phase').textContent = 'PutDownForClearance object_04: lower'")
        box = "document.getElementById('{}').getBoundingClientRect()".format
        assert page.value(f"{box('phase')}.bottom <= {box('views')}.top")
        assert page.value("document.documentElement.scrollWidth") == 390
    finally:
        page.resize(900, 600)


def test_on_a_telephone_the_scene_stays_in_view_as_the_episode_goes_on(page: Browser) -> None:
    page.resize(390, 500)
    try:
        x, y = page.value(
            "(() => { const b = document.querySelector('[data-part=bar]').getBoundingClientRect(); "
            "return [b.x + 0.97 * b.width, b.y + b.height / 2]; })()"
        )
        page.mouse("mousePressed", x, y)
        page.mouse("mouseReleased", x, y)
        page.wait("[...document.querySelectorAll('ol.actions > li')].at(-1).matches('.now, :has(.now)')")
        assert page.value("window.scrollY") == 0
    finally:
        page.resize(900, 600)


def test_play_moves_time_and_the_robot(page: Browser, recording: Recording) -> None:
    before = picture(page)
    page.click("[data-part=play]")
    page.wait(f"{TIME} > 2")
    page.click("[data-part=play]")
    stopped = page.value(TIME)
    assert 2 < stopped < recording.frames[-1].time
    assert changed(before, picture(page)) > 0.01
    assert page.problems == []


def test_the_bar_and_the_actions_go_to_their_times(page: Browser, recording: Recording) -> None:
    box = page.value(
        "(() => { const b = document.querySelector('[data-part=bar]').getBoundingClientRect(); "
        "return [b.x, b.y + b.height / 2, b.width]; })()"
    )
    page.mouse("mousePressed", box[0] + 0.5 * box[2], box[1])
    page.mouse("mouseReleased", box[0] + 0.5 * box[2], box[1])
    page.wait(f"Math.abs({TIME} - {recording.frames[-1].time / 2}) < 0.5")
    last = len(solved().actions) - 1
    page.click(f"li:nth-child({last + 1}) .action")
    start = next(frame.time for frame in recording.frames if frame.action == last)
    page.wait(f"Math.abs({TIME} - {start}) < 0.06")
    assert solved().target in page.value("document.querySelector('.action.now .what').textContent")
    assert page.problems == []


@pytest.mark.slow
def test_each_layer_can_be_switched(page: Browser) -> None:
    page.value("document.querySelector('[data-view=top]').click()")
    before = picture(page)
    for layer in ("regions", "candidates", "bases", "paths", "names", "solid"):
        page.value(f"document.querySelector('[data-layer={layer}]').click()")
        now = picture(page)
        assert changed(before, now) > 1e-4, layer
        before = now
    assert page.problems == []


@pytest.mark.slow
def test_dragging_turns_the_camera(page: Browser) -> None:
    before = picture(page)
    page.mouse("mousePressed", 250, 300)
    page.mouse("mouseMoved", 390, 330)
    page.mouse("mouseReleased", 390, 330)
    assert changed(before, picture(page)) > 0.2
    assert page.problems == []


@pytest.mark.slow
def test_deviations_and_a_failure_are_shown(browser: Browser, recording: Recording, tmp_path: Path) -> None:
    end = recording.frames[-1].time
    solves = (*recording.solves, Solve(end, refused()))
    story = dataclasses.replace(recording, solves=solves, notes=(Note(end - 1, "object_03: toppled"),))
    write_page(tmp_path / "page.html", story, {"success": "no"}, "failure")
    browser.problems.clear()
    browser.open((tmp_path / "page.html").as_uri() + "#t=3&view=table")
    browser.wait(f"{TIME} === 3")
    assert "No plan takes" in browser.value("document.querySelector('#plans .failure').textContent")
    assert browser.value("document.querySelector('.note').title") == "object_03: toppled"
    assert browser.problems == []


def test_a_running_episode_is_followed(browser: Browser, recording: Recording) -> None:
    begin = dataclasses.replace(recording, frames=recording.frames[:1])
    served = LivePage(begin)
    browser.problems.clear()
    browser.open(served.address)
    half = dataclasses.replace(recording, frames=recording.frames[: len(recording.frames) // 2])
    served.update(half)
    browser.wait(f"Math.abs({TIME} - {half.frames[-1].time}) < 0.02")
    assert browser.value("document.getElementById('result').textContent") == "Running"
    served.finish(recording, {"success": "yes"}, "success")
    browser.wait("document.getElementById('result').textContent === 'Success'")
    served.close()
    browser.wait(f"Math.abs({TIME} - {recording.frames[-1].time}) < 0.02")
    assert browser.problems == []


def press(page: Browser, label: str) -> None:
    """Click the object with this number in the scene."""
    x, y = page.value(
        f"(() => {{ const s = [...document.querySelectorAll('#labels span')].find((e) => e.textContent === '{label}'); "
        "const b = s.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height + 5]; })()"
    )
    page.mouse("mousePressed", x, y)
    page.mouse("mouseReleased", x, y)


def test_a_click_on_an_object_or_a_place_says_why(page: Browser) -> None:
    page.value("document.querySelector('[data-view=top]').click()")
    before = picture(page)
    target = solved().target
    press(page, target.removeprefix("object_"))
    page.wait("document.querySelector('#why h3')")
    text = page.value("document.querySelector('#why [data-part=answer]').textContent")
    assert target in text
    assert "takes it" in text
    assert f"taken, {len(solved().clearances)} to move" in text
    assert changed(before, picture(page)) > 1e-4, "arrows of the grasps, and the blockers"
    page.click("#why .way:not(.now)")
    page.wait("document.querySelectorAll('#why .way.now').length === 1")
    x, y = page.value(
        "(() => { const b = document.getElementById('scene').getBoundingClientRect(); "
        "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    # A drag turns the camera and asks nothing.
    page.mouse("mousePressed", x, y)
    page.mouse("mouseMoved", x + 60, y)
    page.mouse("mouseReleased", x + 60, y)
    assert target in page.value("document.querySelector('#why h3').textContent")
    page.value("document.querySelector('#why select').value = ''")
    page.value("document.querySelector('#why select').onchange({target: {value: ''}})")
    page.wait("!document.querySelector('#why h3')")
    assert page.problems == []


def test_places_say_why_they_are_refused(page: Browser) -> None:
    page.value("document.querySelector('[data-view=top]').click()")
    picture(page)
    box = page.value(
        "(() => { const b = document.getElementById('scene').getBoundingClientRect(); "
        "return [b.x, b.y, b.width, b.height]; })()"
    )
    words = set()
    for across in (0.3, 0.4, 0.5, 0.6, 0.7):
        for down in (0.3, 0.4, 0.45, 0.5):
            x, y = box[0] + across * box[2], box[1] + down * box[3]
            page.mouse("mousePressed", x, y)
            page.mouse("mouseReleased", x, y)
            picture(page)
            words.add(str(page.value("document.querySelector('#why [data-part=answer]').textContent")))
    assert any("is allowed" in text for text in words), words
    assert any("is refused" in text for text in words), words
    assert page.problems == []


class Listener:
    """A person's game that refuses every move."""

    def __init__(self) -> None:
        self.moves: list[Mapping[str, Any]] = []

    def move(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        self.moves.append(values)
        return {"refused": "Too heavy."}

    def state(self) -> Mapping[str, Any]:
        return {}


def test_clicks_are_moves_where_a_person_plays(browser: Browser, recording: Recording) -> None:
    player, target = Listener(), solved().target
    served = LivePage(dataclasses.replace(recording, frames=recording.frames[:1], solves=()), player=player)
    state = {"target": target, "objects": [target], "held": "", "moves": 1, "minimum": 2, "happened": "", "busy": ""}
    try:
        browser.problems.clear()
        browser.open(served.address + "#view=top")
        served.tell({**state, "over": "", "next": False})
        browser.wait("document.querySelector('[data-part=count]').textContent === '1 moved · proved minimum 2'")
        picture(browser)
        press(browser, target.removeprefix("object_"))
        browser.wait("document.querySelector('[data-part=refused]').textContent === 'Too heavy.'")
        assert player.moves == [{"take": target}]
        served.tell({**state, "held": target, "over": "", "next": False})
        browser.wait("/Click a place/.test(document.querySelector('[data-part=now]').textContent)")
        x, y = browser.value(
            "(() => { const b = document.getElementById('scene').getBoundingClientRect(); "
            "return [b.x + 0.5 * b.width, b.y + 0.4 * b.height]; })()"
        )
        browser.mouse("mousePressed", x, y)
        browser.mouse("mouseReleased", x, y)
        browser.wait("document.querySelector('[data-part=refused]').textContent === 'Too heavy.'")
        assert [*player.moves[-1]] == ["put"]
        served.tell({**state, "over": "Clean success.", "next": False})
        browser.wait("document.querySelector('[data-part=now]').textContent === 'Clean success.'")
        assert browser.problems == []
    finally:
        served.close()
