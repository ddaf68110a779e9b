"""A person's game over HTTP, without a browser: moves, refusals, and the files of what was played."""

from __future__ import annotations

import http.client
import json
import threading
import time
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clutter_env.cli.play_by_hand import Played, play_by_hand
from clutter_env.data.episode_file import read_episode
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.evaluation.verify import verify

PATIENCE_S = 300.0


class Player:
    """Plays through the page's addresses, as a browser does."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, method: str, path: str, body: str = "", **headers: str) -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        connection.request(method, path, body, {"Content-Type": "application/json", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()

    def move(self, **values: Any) -> str:
        """Why a move is refused, "" once it is over."""
        status, text = self.ask("POST", "/moves", json.dumps(values))
        assert status == HTTPStatus.OK
        refused = str(json.loads(text).get("refused", ""))
        while not refused and (state := self.state()) and state["busy"]:
            time.sleep(0.05)
        return refused

    def state(self) -> dict[str, Any]:
        try:
            return dict(json.loads(self.ask("GET", "/state")[1]))
        except ConnectionError:  # the episode is over, and its server has ended
            return {}


@pytest.fixture(scope="module")
def game(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Played, Path]:
    folder = tmp_path_factory.mktemp("human")
    scenes = SceneSet("side-15-v3", count=1)
    port, seen, problems = _free_port(), dict[str, Any](), list[BaseException]()

    def person() -> None:
        player = Player(port)
        try:
            _play(player, seen)
        except BaseException as problem:
            problems.append(problem)
            player.move(stop=True)

    thread = threading.Thread(target=person)
    thread.start()
    file = folder / "human.json"
    played = play_by_hand(scenes, grasps="side", port=port, speed=100.0, json_file=file, folder=folder / "demos")
    thread.join(PATIENCE_S)
    if problems:
        raise problems[0]
    return seen, played, file


def _play(player: Player, seen: dict[str, Any]) -> None:
    """Take what is in the way, put it aside, and take the target, with wrong moves between."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            seen["page"] = player.ask("GET", "/")[1]
            break
        except ConnectionError:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    while player.state()["busy"]:
        time.sleep(0.05)
    start = player.state()
    seen["start"], target = start, start["target"]
    body = json.dumps({"take": target})
    seen["foreign"] = player.ask("POST", "/moves", body, Origin="http://attacker.example")[0]
    seen["other host"] = player.ask("POST", "/moves", body, Host="attacker.example")[0]
    seen["form"] = player.ask("POST", "/moves", body, **{"Content-Type": "text/plain"})[0]
    seen["no json"] = player.ask("POST", "/moves", "{")[0]
    seen["no move"] = player.move(shout="loud")
    seen["nobody"] = player.move(take="nobody")
    seen["empty hand"] = player.move(put=[0.0, 0.0, 0.7])
    for _ in range(8):
        refused = player.move(take=target)
        if not refused:
            return
        seen.setdefault("blocked", refused)
        named = [name for name in start["objects"] if name in refused.partition(":")[2]]
        taken = next(name for name in [*named, *start["objects"]] if name != target and not player.move(take=name))
        state = player.state()
        assert state["held"] == taken
        seen.setdefault("full hand", player.move(take=target))
        other = next(name for name in start["objects"] if name not in (target, taken))
        x, y, _ = state["positions"][other]
        seen.setdefault("occupied", player.move(put=[x, y, state["faces"][0][4]]))
        assert any(not player.move(put=place) for place in _places(state, target)), "no place was accepted"
    raise AssertionError("the target was not taken")


def _places(state: dict[str, Any], target: str) -> list[list[float]]:
    """Places of the table, those far from all objects first."""
    x0, x1, y0, y1, top = state["faces"][0]
    grid = [(x, y) for x in np.linspace(x0 + 0.08, x1 - 0.25, 4) for y in np.linspace(y0 + 0.08, y1 - 0.08, 9)]
    others = np.array([p[:2] for name, p in state["positions"].items() if name != state["held"]])
    aim = np.array(state["positions"][target][:2])

    def worth(place: tuple[float, float]) -> float:
        return min(float(np.hypot(*(others - place).T).min()), 0.12) + 0.1 * float(np.hypot(*(aim - place)))

    return [[x, y, top] for x, y in sorted(grid, key=worth, reverse=True)]


def _free_port() -> int:
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def test_the_page_plays(game: tuple[dict[str, Any], Played, Path]) -> None:
    seen, played, _ = game
    assert 'data-moves="/moves"' in seen["page"]
    assert seen["start"]["minimum"] == played.floors[0].count
    assert seen["start"]["moves"] == 0
    assert played.floors[0].count is not None
    assert played.moves[0] >= played.floors[0].count > 0


def test_refusals_say_why(game: tuple[dict[str, Any], Played, Path]) -> None:
    seen, _, _ = game
    assert "in the way" in seen["blocked"]
    assert "object_" in seen["blocked"].partition(":")[2]
    assert "put" in seen["full hand"]
    assert "too near" in seen["occupied"]
    assert "empty" in seen["empty hand"]
    assert "no object" in seen["nobody"]
    assert "A move is" in seen["no move"]


def test_only_the_own_page_moves_the_arm(game: tuple[dict[str, Any], Played, Path]) -> None:
    seen, _, _ = game
    assert {seen["foreign"], seen["other host"], seen["form"]} == {HTTPStatus.FORBIDDEN}
    assert seen["no json"] == HTTPStatus.BAD_REQUEST


def test_the_episode_is_a_results_file_and_a_demonstration(game: tuple[dict[str, Any], Played, Path]) -> None:
    _, played, file = game
    found = verify(file)
    assert found.is_confirmed, found.differences
    assert found.track == "human"
    (score,) = played.evaluation.scores
    assert score.lifted
    assert score.moved == played.moves[0]
    if score.clean:
        episode = read_episode(played.demonstrations[0])
        assert episode.succeeded
        assert len(episode) == score.steps
        assert any("PickUp" in skill for skill in episode.skills)
