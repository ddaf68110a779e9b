"""Scripted players of `clutter-env play --human`, through the same addresses as a browser: how many objects they move.

    python -m scripts.human_games --rule nearest --scenes 10

These are rules, no people. "nearest" looks at the table as one would: it tries the target, and where that is refused,
takes the object that stands nearest to the target on the robot's side, else the nearest one that can be taken.
"named" takes the objects that the refusal of the target names, and the planner's order is "expert". All of them put an
object down where most room is, away from the target.
"""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from clutter_env.cli.play_by_hand import play_by_hand
from clutter_env.evaluation.scenes import SceneSet
from clutter_env.reporting.files import write_json
from planners import Scene, Solution, solve

_MOST = 15
"""Objects that a player takes before it gives up."""
_PLACES = 12
"""Places that are tried for one object."""
_EDGE, _ROOM = 0.08, 0.12
"""[m] Distance of places from the edge, and of others beyond which more room is not better."""


class ScriptedPlayer:
    """Plays one scene after the other until the server has ended."""

    def __init__(self, port: int, rule: str, orders: Sequence[Sequence[str]]) -> None:
        self._port, self._rule, self._orders = port, rule, orders

    def play(self, scenes: int) -> None:
        """Play that many scenes."""
        for index in range(scenes):
            state = self._begin()
            try:
                self._play(state, list(self._orders[index]))
            except ConnectionError:
                continue  # the episode has ended within a move

    def _begin(self) -> dict[str, Any]:
        """The first state of the next scene, once it is served."""
        while True:
            try:
                state = self._state()
            except (ConnectionError, http.client.HTTPException):
                time.sleep(0.1)
                continue
            if not state["over"] and not state["busy"]:
                return state
            time.sleep(0.05)

    def _play(self, state: dict[str, Any], order: list[str]) -> None:
        target = state["target"]
        for _ in range(_MOST):
            refused = self._move(take=target) if not order else "not yet"
            if not refused:
                return
            names = [order.pop(0)] if order else self._candidates(state, refused)
            if not any(not self._move(take=name) for name in names):
                break
            state = self._state()
            if not state["held"]:
                continue  # it slipped
            x, y, _ = state["positions"][state["held"]]
            places = [*_places(state)[:_PLACES], [x, y, state["faces"][0][4]]]
            if not any(not self._move(put=place) for place in places):
                break
            state = self._state()
        self._move(stop=True)

    def _candidates(self, state: dict[str, Any], refused: str) -> list[str]:
        """Objects to take next, first the one that the rule prefers."""
        aim = np.array(state["positions"][state["target"]][:2])
        others = [name for name in state["objects"] if name != state["target"]]

        def worth(name: str) -> float:
            away = np.array(state["positions"][name][:2]) - aim
            return float(np.hypot(*away)) + (0.1 if away[0] > 0 else 0.0)

        ordered = sorted(others, key=worth)
        named = [name for name in others if name in refused.partition(":")[2]]
        return [*named, *(name for name in ordered if name not in named)] if self._rule == "named" else ordered

    def _state(self) -> dict[str, Any]:
        return dict(json.loads(self._ask("GET", "/state")))

    def _move(self, **values: Any) -> str:
        """Why a move is refused, "" once it is over."""
        refused = str(json.loads(self._ask("POST", "/moves", json.dumps(values))).get("refused", ""))
        while not refused and self._state()["busy"]:
            time.sleep(0.02)
        return refused

    def _ask(self, method: str, path: str, body: str = "") -> str:
        connection = http.client.HTTPConnection("127.0.0.1", self._port, timeout=600)
        connection.request(method, path, body, {"Content-Type": "application/json"})
        return connection.getresponse().read().decode()


def _places(state: dict[str, Any]) -> list[list[float]]:
    """Places of the table, those with most room and farthest from the target first."""
    x0, x1, y0, y1, top = state["faces"][0]
    xs, ys = np.linspace(x0 + _EDGE, x1 - _EDGE, 5), np.linspace(y0 + _EDGE, y1 - _EDGE, 9)
    others = np.array([p[:2] for name, p in state["positions"].items() if name != state["held"]])
    aim = np.array(state["positions"][state["target"]][:2])

    def worth(place: tuple[float, float]) -> float:
        room = min(float(np.hypot(*(others - place).T).min()), _ROOM)
        in_front = max(0.0, aim[0] - place[0]) * max(0.0, 0.2 - abs(place[1] - aim[1]))
        return room + 0.1 * float(np.hypot(*(aim - place))) - in_front

    grid = [(float(x), float(y)) for x in xs for y in ys]
    return [[x, y, top] for x, y in sorted(grid, key=worth, reverse=True)]


def main(
    rule: Literal["nearest", "named", "expert"] = "nearest",
    suite: str = "deep-15-v2",
    scenes: int = 10,
    grasps: Literal["side", "all"] = "side",
    folder: Path = Path("outputs/human"),
) -> None:
    """Play scenes of a suite by a rule, and write the results file, the demonstrations and a table.

    Args:
        rule: how the next object is chosen.
        suite: the suite.
        scenes: number of its first scenes.
        grasps: the grasp set of the moves.
        folder: of the files.
    """
    chosen = SceneSet(suite, count=scenes)
    orders = [_order(scene, grasps) if rule == "expert" else () for scene in chosen.scenes]
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = int(one.getsockname()[1])
    player = ScriptedPlayer(port, rule, orders)
    thread = threading.Thread(target=player.play, args=(scenes,), daemon=True)
    thread.start()
    file = folder / f"{suite}_{rule}.json"
    played = play_by_hand(
        chosen, grasps=grasps, port=port, speed=0.0, json_file=file, folder=folder / f"{suite}_{rule}"
    )
    rows = [
        {"seed": score.seed, "clean": score.clean, "moves": moves, "minimum": floor.count, "failure": score.failure}
        for score, moves, floor in zip(played.evaluation.scores, played.moves, played.floors, strict=True)
    ]
    write_json(folder / f"{suite}_{rule}_moves.json", {"rule": rule, "rows": rows})
    for row in rows:
        print(row)


def _order(scene: Any, grasps: str) -> tuple[str, ...]:
    """The objects that the planner puts aside, in its order."""
    env = scene.make()
    try:
        _, info = scene.reset(env)
        inner: Any = env.unwrapped
        found = solve(Scene.from_mujoco(inner.model, inner.data, inner.robot), info["target"], grasps=grasps)
    finally:
        env.close()
    return found.clearances if isinstance(found, Solution) else ()


if __name__ == "__main__":
    tyro.cli(main)
