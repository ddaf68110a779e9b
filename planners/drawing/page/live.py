"""A running episode in a browser: a server for this machine only sends states and plans as they come.

It can also take moves from the browser, for a person who plays.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from planners.drawing.page.content import ArrayBlock, frame_values, moving_bodies, note_values, page_text, solve_values
from planners.drawing.page.page import episode_title, page_html
from planners.expert.report import Recording

_HOST = "127.0.0.1"
"""Local address: other machines cannot connect."""
_EVENTS, _MOVES, _STATE = "/events", "/moves", "/state"
_LONGEST = 4096
"""Most bytes of a move."""
_FRAMES = 3
"""New frames that are sent together: 0.15 s of the episode."""
_PATIENCE_S = 5.0
"""Time [s] that a browser may take to accept data. After it, the connection is closed."""


class Player(Protocol):
    """Takes the moves of a person, from other threads than that of the episode."""

    def move(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Take a move, JSON values, and return the answer once it is known whether it is made."""

    def state(self) -> Mapping[str, Any]:
        """The present state of the game, JSON values."""


class LivePage:
    """Server of one episode. A browser that connects late, or again, gets everything that it missed.

    Example:
        page = LivePage(expert.recording)
        print(page.address)
        while not expert.done:
            env.step(expert.act())
            page.update(expert.recording)
        page.finish(expert.recording, expert.report.rows(), "success")
        page.close()

    Attributes:
        address: address of the page, on 127.0.0.1.
    """

    def __init__(self, recording: Recording, port: int = 0, player: Player | None = None) -> None:
        """Start to serve the beginning of an episode at a port, 0 for a free one.

        With a `player`, the page takes moves: it sends them to "/moves", and "/state" has the state of the game.

        Raises:
            OSError: the port is taken.
        """
        title = episode_title(recording)
        self._bodies = moving_bodies(recording.model)
        self._sent = recording
        page = page_html(title, page_text(recording, title, {}, "running"), _EVENTS, _MOVES if player else "")
        self._server = _Server(port, page, player)
        self.address = f"http://{_HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, name="live page", daemon=True)
        self._thread.start()

    def update(self, recording: Recording) -> None:
        """Send the news, once a plan, a deviation or some frames are new."""
        sent = self._sent
        is_news = len(recording.solves) > len(sent.solves) or len(recording.notes) > len(sent.notes)
        if is_news or len(recording.frames) >= len(sent.frames) + _FRAMES:
            self._send(recording)

    def tell(self, play: Mapping[str, Any]) -> None:
        """Send the state of a person's game."""
        self._server.add(ArrayBlock().text({"play": play}))

    def finish(self, recording: Recording, rows: Mapping[str, str], result: str) -> None:
        """Send the rest and the report. Browsers continue to show the episode without this server."""
        self._send(recording, rows=list(rows.items()), result=result)

    def close(self) -> None:
        """Stop the server, after browsers have received everything."""
        self._server.end()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _send(self, recording: Recording, **content: Any) -> None:
        arrays, sent, self._sent = ArrayBlock(), self._sent, recording
        content["frames"] = frame_values(recording.model, recording.frames[len(sent.frames) :], self._bodies, arrays)
        content["solves"] = [solve_values(solve, arrays) for solve in recording.solves[len(sent.solves) :]]
        content["notes"] = note_values(recording.notes[len(sent.notes) :])
        self._server.add(arrays.text(content))


class _Server(ThreadingHTTPServer):
    """Sends the page and all messages, in order, to every browser. `server_close` waits until they are sent."""

    daemon_threads = False

    def __init__(self, port: int, page: str, player: Player | None) -> None:
        super().__init__((_HOST, port), _Handler)
        self.page, self.player = page.encode(), player
        self._messages: list[str] = []
        self._has_ended = False
        self._changed = threading.Condition()

    def add(self, message: str) -> None:
        with self._changed:
            self._messages.append(message)
            self._changed.notify_all()

    def end(self) -> None:
        """Mark the end of the messages."""
        with self._changed:
            self._has_ended = True
            self._changed.notify_all()

    def message(self, number: int) -> str | None:
        """Message of that number, once available. None after the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._has_ended or number < len(self._messages))
            return self._messages[number] if number < len(self._messages) else None


class _Handler(BaseHTTPRequestHandler):
    """One request. Only this machine's own host names are accepted, so that no foreign page can read along."""

    server: _Server
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        """Answer with the page or with the messages."""
        if not self._is_own():
            self.send_error(HTTPStatus.FORBIDDEN)
        elif self.path == _STATE and self.server.player is not None:
            self._answer(self.server.player.state())
        elif self.path == "/":
            self._start("text/html; charset=utf-8")
            self.wfile.write(self.server.page)
        elif self.path == _EVENTS:
            self._start("text/event-stream")
            self._send_messages()
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Take a move. A page of another origin can send no JSON here without asking, which is not answered."""
        length = self.headers.get("Content-Length", "")
        origin = self.headers.get("Origin")
        is_own = self._is_own() and origin in (None, f"http://{self.headers.get('Host')}")
        if not is_own or self.headers.get("Content-Type") != "application/json":
            self.send_error(HTTPStatus.FORBIDDEN)
        elif self.path != _MOVES or self.server.player is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        elif not length.isdigit() or int(length) > _LONGEST:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        else:
            try:
                values = json.loads(self.rfile.read(int(length)))
            except ValueError:
                values = None
            if isinstance(values, dict):
                self._answer(self.server.player.move(values))
            else:
                self.send_error(HTTPStatus.BAD_REQUEST)

    def _is_own(self) -> bool:
        """Whether the request names this machine."""
        port = self.server.server_port
        return self.headers.get("Host") in (f"{_HOST}:{port}", f"localhost:{port}")

    def _answer(self, values: Mapping[str, Any]) -> None:
        self._start("application/json")
        self.wfile.write(json.dumps(values).encode())

    def log_message(self, format: str, *args: object) -> None:
        """Suppress the log of requests."""

    def _start(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _send_messages(self) -> None:
        """Send the messages after the last one of this browser, until the episode ends or the browser leaves."""
        last = self.headers.get("Last-Event-ID", "")
        number = int(last) + 1 if last.isdigit() else 0
        try:
            while (text := self.server.message(number)) is not None:
                self.wfile.write(f"id: {number}\ndata: {text}\n\n".encode())
                number += 1
        except OSError:  # the browser has closed the page
            return
