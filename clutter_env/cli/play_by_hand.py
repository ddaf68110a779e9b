"""A person plays: the game behind the page in the browser, and the files of what was played."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from clutter_env.data.episode import record
from clutter_env.data.episode_file import write_episode
from clutter_env.data.replay import replay_in_fresh_process
from clutter_env.evaluation.evaluate import Evaluation, evaluate
from clutter_env.evaluation.scenes import Scene, SceneSet, search_floor
from clutter_env.evaluation.score import Score, play_scene
from clutter_env.evaluation.tables import results
from clutter_env.policies.by_hand import ByHand, Human, Move, Put, Take
from clutter_env.reporting.files import write_json
from clutter_env.suites import Floor, SuiteScene
from clutter_env.task import Task

if TYPE_CHECKING:
    from planners.drawing.page.live import LivePage

_OVER = "The episode is over."


@dataclass
class Game:
    """One episode of a person. The browser's moves come from other threads than that of the simulation.

    Attributes:
        hand: the policy that carries out the moves.
        floor: the lower bound of the scene.
        target: name of the object to hold up.
        objects: names of the objects.
        has_next: whether another scene follows.
        page: the page in the browser, once it is served.
        over: how the episode ended, "" while it goes on.
        faces: of the supports: least and greatest x and y, and height [m] of each.
    """

    hand: ByHand
    floor: Floor
    target: str
    objects: tuple[str, ...]
    has_next: bool
    env: Any
    page: LivePage | None = None
    over: str = ""
    faces: list[list[float]] = field(default_factory=list)
    _moves: queue.Queue[tuple[Move | None, Future[str]]] = field(default_factory=queue.Queue)
    _asked: Future[str] | None = None
    _is_busy: threading.Event = field(default_factory=threading.Event)

    def ask(self) -> Move | None:
        """Wait for the next move. None to give up."""
        self._is_busy.clear()
        self.tell()
        move, self._asked = self._moves.get()
        self._is_busy.set()
        if move is None:
            self._asked.set_result("")
        return move

    def answer(self, _: Move, refusal: str) -> None:
        """Answer the browser that a move is made, or why it is refused."""
        assert self._asked is not None
        self._asked.set_result(refusal)
        if not refusal:
            self.tell()

    def move(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Take a move of the browser: {"take": name}, {"put": [x, y, z]} or {"stop": true}. Return any refusal."""
        match values:
            case {"take": str(name)}:
                move: Move | None = Take(name)
            case {"put": [int() | float() as x, int() | float() as y, int() | float() as z]}:
                move = Put(float(x), float(y), float(z))
            case {"stop": True}:
                move = None
            case _:
                return {"refused": "A move is to take an object, to put it at x, y, z, or to stop."}
        if self.over:
            return {"refused": _OVER}
        if self._is_busy.is_set():
            return {"refused": "The arm is moving."}
        self._is_busy.set()
        asked: Future[str] = Future()
        self._moves.put((move, asked))
        refusal = asked.result()
        return {"refused": refusal} if refusal else {"made": True}

    def state(self) -> Mapping[str, Any]:
        """The state of the game, with the objects' centres and radii [m]."""
        world, positions = self.env.world, self.env.measurements.poses[:, :3]
        half = world.scene.half_extents
        names = list(world.names)
        return {
            **self.shown(),
            "positions": {name: np.round(positions[k], 4).tolist() for k, name in enumerate(names)},
            "faces": self.faces,
            "radii": {name: round(float(np.hypot(*half[k][:2])), 4) for k, name in enumerate(names)},
            "heights": {name: round(2 * float(half[k][2]), 4) for k, name in enumerate(names)},
        }

    def shown(self) -> dict[str, Any]:
        """The page's text and figures next to the scene."""
        happened = f"{self.hand.happened}. " if self.hand.happened else ""
        busy = self._is_busy.is_set() and not self.over
        return {
            "target": self.target,
            "objects": list(self.objects),
            "held": self.hand.held,
            "moves": self.hand.moves,
            "minimum": self.floor.count if self.floor.is_proved else None,
            "happened": happened[:1].upper() + happened[1:],
            "busy": "The arm is moving." if busy else "",
            "over": self.over,
            "next": self.has_next,
        }

    def end(self) -> None:
        """Say that the episode is over, and refuse the moves that wait."""
        self.over = self.over or "The command has ended with an error."
        while not self._moves.empty():
            self._moves.get()[1].set_result(_OVER)
        self.tell()

    def tell(self) -> None:
        """Send the state to the page."""
        if self.page is not None:
            self.page.tell(self.shown())


@dataclass(frozen=True)
class Played:
    """The games that a person has played, and their files.

    Attributes:
        evaluation: scores of the replays.
        moves: for each scene, the number of other objects that were taken.
        floors: the lower bound of each scene.
        demonstrations: files of the clean successes.
    """

    evaluation: Evaluation
    moves: tuple[int, ...]
    floors: tuple[Floor, ...]
    demonstrations: tuple[Path, ...]


def play_by_hand(
    scenes: SceneSet, *, grasps: str, port: int, speed: float, json_file: Path, folder: Path, workers: int = 1
) -> Played:
    """Serve each scene to a browser of this machine, and write a results file and demonstrations.

    Args:
        scenes: the scenes, one after the other.
        grasps: the grasp set that the person's moves use, and by whose lower bounds they are measured.
        port: of the page on 127.0.0.1, 0 for a free one.
        speed: simulated time per time, 0 for as fast as the machine can.
        json_file: the results file.
        folder: of the demonstrations.
        workers: number of processes for the replays.
    """
    from planners import warmup

    played: list[ByHand] = []
    floors: list[Floor] = []
    scores: list[Score] = []
    for number, scene in enumerate(scenes.scenes):
        env = scene.make(control_mode="joint")
        try:
            warmup(env.unwrapped.robot)  # type: ignore[attr-defined]  # of the Retrieve environments
            # That of today: the bounds of suites were found with fewer base poses, and may be too high.
            floors.append(search_floor(env, scene.reset(env)[1], grasps))
            score, hand, port = _play(scene, env, floors[-1], grasps, port, speed, number + 1 < len(scenes.scenes))
        finally:
            env.close()
        played.append(hand)
        scores.append(score)
        print(_line(score, hand.moves, floors[-1]), flush=True)
    human = Human([hand.steps for hand in played], grasps)
    evaluation = evaluate(human, scenes, workers=workers)
    write_json(json_file, results(evaluation))
    demonstrations = tuple(_demonstrations(scenes, human, evaluation, folder))
    return Played(evaluation, tuple(hand.moves for hand in played), tuple(floors), demonstrations)


def _play(
    scene: Scene, env: gym.Env[Any, Any], floor: Floor, grasps: str, port: int, speed: float, has_next: bool
) -> tuple[Score, ByHand, int]:
    """Let a person play one scene. Return the score, what was played, and the port of the page."""
    from planners.drawing.page.live import LivePage

    inner: Any = env.unwrapped
    hand = ByHand(lambda: game.ask(), lambda move, refusal: game.answer(move, refusal), grasps)
    game = Game(hand, floor, "", (), has_next, inner)
    begun = time.perf_counter()

    def watch(*_: Any) -> None:
        """Serve the page after the episode has begun, and send the news, not faster than the wanted speed."""
        nonlocal begun
        if game.page is None:
            game.target, game.objects, game.faces = inner.target, tuple(inner.world.names), _faces(inner)
            game.page = LivePage(hand.recording, port, game)
            print(f"play at {game.page.address}", flush=True)
            return
        game.page.update(hand.recording)
        if speed > 0:
            begun = max(begun + 1 / (env.metadata["render_fps"] * speed), time.perf_counter() - 1.0)
            time.sleep(max(begun - time.perf_counter(), 0.0))

    try:
        score = play_scene(scene, env, hand, watch=watch)
        assert game.page is not None
        game.over = _line(score, hand.moves, floor)
        rows = {"result": game.over, "simulated time": f"{score.sim_s:.1f} s", "objects fallen": str(score.fallen)}
        game.end()
        game.page.finish(hand.recording, rows, "success" if score.clean else "failure")
        return score, hand, int(game.page.address.rstrip("/").rpartition(":")[2])
    finally:
        if game.page is not None:
            game.end()
            game.page.close()


def _faces(inner: Any) -> list[list[float]]:
    """Least and greatest x and y, and height [m] of each support of an environment."""
    from planners import Scene as PlannerScene

    scene = PlannerScene.from_mujoco(inner.model, inner.data, inner.robot)
    tops = map(scene.support_named, scene.supports)
    return [[float(v) for v in (one.lower[0], one.upper[0], one.lower[1], one.upper[1], one.top)] for one in tops]


def _demonstrations(scenes: SceneSet, human: Human, evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write the clean successes as demonstrations, if they replay bit for bit in a new process."""
    written = []
    for index, (scene, score) in enumerate(zip(scenes.scenes, evaluation.scores, strict=True)):
        if not score.clean:
            continue
        task, path = Task(scene.env_id, dict(scene.keywords)), folder / f"episode_{scene.seed:08d}.hdf5"
        env = scene.make(control_mode="joint")
        try:
            options = dict(scene.options) if isinstance(scene, SuiteScene) else None
            one = Human([human.episodes[index]], human.grasps)
            # A person is an expert of its own kind.
            episode = record(task, env, one, scene.seed, options)  # type: ignore[arg-type]  # see `experts.Expert`
        finally:
            env.close()
        folder.mkdir(parents=True, exist_ok=True)
        write_episode(path, episode)
        replayed = replay_in_fresh_process(path)
        if replayed.is_identical and replayed.is_success:
            written.append(path)
        else:
            path.unlink()
    return written


def _line(score: Score, moves: int, floor: Floor) -> str:
    """The result of an episode in one sentence."""
    least = f"the proved minimum is {floor.count}" if floor.is_proved else "the minimum is not proved"
    result = "Clean success" if score.clean else f"No clean success ({score.failure})"
    return f"{result} with {moves} other object{'s' * (moves != 1)} moved; {least}."
