"""The page of a plan or an episode: what it holds is what happened, and it needs nothing but itself."""

from __future__ import annotations

import base64
import dataclasses
import http.client
import json
import re
import threading
import zlib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from planners import Solution, goals, solve
from planners.drawing.page.content import ArrayBlock, model_values, moving_bodies, page_text
from planners.drawing.page.live import LivePage
from planners.drawing.page.page import plan_recording, write_page
from planners.expert.report import Note, Recording, Solve
from planners.motion.mujoco_check import OBJECT, OPENING
from tests.planners.opening.furniture import drawer_world
from tests.planners.plans import refused, solved

PATIENCE_S = 20.0


class Content:
    """JSON values and arrays of a message, read as the page reads them."""

    def __init__(self, text: str) -> None:
        message = json.loads(text)
        self.values: dict[str, Any] = message["content"]
        self._bytes = zlib.decompress(base64.b64decode(message["arrays"]))

    def array(self, place: dict[str, Any]) -> NDArray[Any]:
        return np.frombuffer(self._bytes, place["type"], place["size"], place["at"])

    def poses(self) -> NDArray[np.float64]:
        """(n, k, 7)."""
        frames = self.values["frames"]
        changes = self.array(frames["poses"]).reshape(-1, frames["times"]["size"])
        numbers = np.cumsum(changes, axis=1, dtype=np.int16).T.reshape(frames["times"]["size"], -1, 7)
        return np.asarray(numbers * np.repeat((2e-4, 1 / 32767), (3, 4)))


def content_of(path: Path) -> Content:
    found = re.search(r'<script id="content" type="application/json">(.*?)</script>', path.read_text(), re.DOTALL)
    assert found is not None
    return Content(found[1])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return plan_recording(solved())


@pytest.fixture(scope="module")
def bare(recording: Recording) -> Recording:
    """The same without the plan, whose regions take seconds to compute."""
    return dataclasses.replace(recording, solves=())


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a plan."""
    path = tmp_path_factory.mktemp("page") / "plan.html"
    solved().to_html(path)
    return path


def test_the_page_holds_the_poses_of_all_bodies(recording: Recording, page: Path) -> None:
    content, bodies = content_of(page), moving_bodies(recording.model)
    poses, times = content.poses(), content.array(content.values["frames"]["times"])
    assert len(poses) == len(recording.frames)
    np.testing.assert_allclose(times, [frame.time for frame in recording.frames], rtol=1e-6)
    data = mujoco.MjData(recording.model)
    for index in (0, len(poses) // 3, len(poses) - 1):
        data.qpos[:] = recording.frames[index].qpos
        mujoco.mj_kinematics(recording.model, data)
        np.testing.assert_allclose(poses[index, :, :3], data.xpos[bodies], atol=1.1e-4)
        turns = np.abs((poses[index, :, 3:] * data.xquat[bodies]).sum(axis=1))
        np.testing.assert_allclose(turns, 1.0, atol=1e-4)


def test_the_page_of_a_plan_leaves_objects_where_the_plan_puts_them(page: Path) -> None:
    plan, content = solved(), content_of(page)
    assert content.values["result"] == "plan"
    last = content.poses()[-1]
    bodies = {entry["name"]: entry["body"] for entry in content.values["objects"]}
    for action in plan.actions:
        if action.released is not None:
            np.testing.assert_allclose(last[bodies[action.target], :3], action.released.position, atol=1e-3)
    (solve,) = content.values["solves"]
    assert [action["object"] for action in solve["actions"]] == [action.target for action in plan.actions]
    assert [choice["object"] for choice in solve["choices"]] == list(plan.clearances)


def test_the_layers_are_those_of_the_plan(page: Path) -> None:
    plan, content = solved(), content_of(page)
    put = next(action for action in plan.actions if action.surfaces)
    choice = content.values["solves"][0]["choices"][0]
    cells = content.array(choice["surfaces"][0]["cells"]).reshape(choice["surfaces"][0]["shape"])
    np.testing.assert_array_equal(cells & 1 > 0, put.surfaces[0].region.ngr1)
    np.testing.assert_array_equal(cells & 2 > 0, put.surfaces[0].region.ngr2)
    for action, entry in zip(plan.actions, content.values["solves"][0]["actions"], strict=True):
        if entry["bases"] is not None:
            bases = content.array(entry["bases"]).reshape(-1, 3)
            contact = next(phase for phase in action.trajectory.phases if phase.name in ("close", "open"))
            np.testing.assert_allclose(bases[0], action.trajectory.sample(contact.start).base, atol=1e-5)
            assert len(bases) > 3


def test_the_page_is_small_and_needs_no_network(page: Path) -> None:
    text = page.read_text()
    assert page.stat().st_size < 1_000_000
    assert "default-src 'none'" in text
    assert "connect-src 'none'" in text
    assert not re.search(r"https?://|src=|@import|url\(", text.partition('<script id="content"')[0])


def test_names_cannot_end_the_script(bare: Recording, tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    write_page(tmp_path / "page.html", bare, {"deviation": evil}, "failure", title=evil)
    text = (tmp_path / "page.html").read_text()
    assert "alert(1)</script>" not in text
    assert dict(content_of(tmp_path / "page.html").values["rows"]) == {"deviation": evil}


def test_a_failure_and_deviations_are_told(recording: Recording) -> None:
    solves = (Solve(3.0, refused()),)
    story = dataclasses.replace(recording, solves=solves, notes=(Note(2.5, "object_03: toppled"),))
    content = Content(page_text(story, "title", {}, "failure"))
    assert content.values["solves"][0]["actions"] == []
    assert content.values["solves"][0]["summary"] == refused().summary()
    assert content.values["notes"] == [{"time": 2.5, "text": "object_03: toppled"}]


def test_a_plan_without_actions_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="without actions"):
        dataclasses.replace(solved(), actions=(), clearances=()).to_html(tmp_path / "plan.html")


def test_meshes_keep_their_shape() -> None:
    spec = mujoco.MjSpec()
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]])
    spec.add_mesh(name="tip", uservert=corners.ravel())
    body = spec.worldbody.add_body(name="object_00")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="tip")
    model = spec.compile()
    arrays = ArrayBlock()
    values = model_values(model, moving_bodies(model), arrays)
    content = Content(arrays.text(values))
    (mesh,) = content.values["meshes"]
    vertices = content.array(mesh["vertices"]).reshape(-1, 3) * mesh["step"]
    np.testing.assert_allclose(vertices, model.mesh_vert, atol=1e-5)
    np.testing.assert_array_equal(content.array(mesh["triangles"]).reshape(-1, 3), model.mesh_face)


def ask(page: LivePage, path: str, host: str = "", answered: threading.Event | None = None) -> tuple[int, str]:
    place = page.address.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(place, timeout=PATIENCE_S)
    connection.request("GET", path, headers={"Host": host or place})
    answer = connection.getresponse()
    if answered is not None:
        answered.set()
    return answer.status, answer.read().decode()


def test_a_running_episode_is_served_to_this_machine_alone(bare: Recording) -> None:
    page = LivePage(dataclasses.replace(bare, frames=bare.frames[:1]))
    try:
        assert page.address.startswith("http://127.0.0.1:")
        status, text = ask(page, "/")
        assert status == http.HTTPStatus.OK
        assert "connect-src 'self'" in text
        assert ask(page, "/etc/passwd")[0] == http.HTTPStatus.NOT_FOUND
        assert ask(page, "/", "attacker.example")[0] == http.HTTPStatus.FORBIDDEN
        assert ask(page, "/events", "attacker.example")[0] == http.HTTPStatus.FORBIDDEN
    finally:
        page.close()


def test_a_browser_that_comes_late_gets_the_whole_episode(recording: Recording) -> None:
    begin = dataclasses.replace(recording, frames=recording.frames[:1], solves=())
    page, answers, is_there, has_come = LivePage(begin), list[str](), threading.Event(), threading.Event()
    early = threading.Thread(target=lambda: answers.append(ask(page, "/events", answered=is_there)[1]))
    early.start()
    for count in range(2, len(recording.frames) + 1):
        page.update(dataclasses.replace(recording, frames=recording.frames[:count]))
    late = threading.Thread(target=lambda: answers.append(ask(page, "/events", answered=has_come)[1]))
    late.start()
    assert is_there.wait(PATIENCE_S)
    assert has_come.wait(PATIENCE_S)
    page.finish(recording, {"success": "yes"}, "success")
    page.close()
    early.join(PATIENCE_S)
    late.join(PATIENCE_S)
    assert len(answers) == 2
    assert answers[0] == answers[1]
    messages = [Content(line.removeprefix("data: ")) for line in answers[0].splitlines() if line.startswith("data: ")]
    frames = sum(message.values["frames"]["times"]["size"] for message in messages)
    assert frames == len(recording.frames) - 1
    assert sum(len(message.values["solves"]) for message in messages) == 1
    assert messages[-1].values["result"] == "success"


def test_an_episode_ends_without_new_frames(recording: Recording) -> None:
    """As where the last of them have just been sent."""
    page = LivePage(recording)
    try:
        page.finish(recording, {}, "success")
    finally:
        page.close()


def test_the_objects_of_a_plan_have_their_own_names(bare: Recording) -> None:
    assert all(name.startswith(OBJECT) for name in bare.objects)
    content = Content(page_text(bare, "title", {}, "plan"))
    assert {entry["name"] for entry in content.values["objects"]} == set(solved().actions[0].scene.names)


@pytest.mark.parametrize("is_open", [False, True])
def test_what_opens_moves_on_the_page(is_open: bool) -> None:
    world = drawer_world(share=0.9 if is_open else 0.0)
    goal = goals.on("red", "side_table") & goals.closed("drawer") if is_open else "red"
    plan = solve(world.scene(), goal, time_limit=60)
    assert isinstance(plan, Solution)
    recording = plan_recording(plan)
    assert all("handle" not in name for name in recording.objects)
    drawer = recording.model.joint(f"{OPENING}drawer").qposadr[0]
    blue = recording.model.joint(f"{OBJECT}blue").qposadr[0]
    places = np.array([frame.qpos[[drawer, blue]] for frame in recording.frames], np.float64)
    assert plan.end is not None
    np.testing.assert_allclose(places[0, 0], world.scene().opening("drawer").position, atol=1e-6)
    np.testing.assert_allclose(places[-1, 0], plan.end.opening("drawer").position, atol=2e-3)
    assert np.abs(np.diff(places[:, 0])).max() < 0.05, "it moves, it does not jump"
    np.testing.assert_allclose(np.diff(places[:, 1]), -np.diff(places[:, 0]), atol=2e-3, err_msg="blue stands in it")
