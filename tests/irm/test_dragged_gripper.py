"""What the page of `examples/drag_gripper.py` shows for a pose of the gripper."""

from __future__ import annotations

import importlib.util
import threading
from unittest.mock import MagicMock

import numpy as np
import pytest
from numpy.typing import NDArray

from assets import FETCH
from examples.drag_gripper import View, Viewpoint, show
from irm import Status, tcp_poses
from planners.motion.arm import tcp_pose
from planners.scene import RobotState


@pytest.fixture(scope="module")
def viewpoint() -> Viewpoint:
    return Viewpoint(FETCH)


def test_the_robot_stands_at_the_best_base_and_reaches(viewpoint: Viewpoint) -> None:
    T = tcp_poses([(0.8, 0.1, 0.8)], yaw=0.3, pitch=0.0)[0]
    view = viewpoint.of(T, 10)
    assert view.placement.status is Status.YES
    assert len(view.placement) == 10
    assert not view.touching
    assert view.said.startswith("YES, 10 bases, best μ 0.1")
    assert view.q is not None
    assert np.allclose(tcp_pose(FETCH, RobotState(view.base, view.q, 0.0)), T, atol=1e-6)


def test_what_touches_is_named_where_the_robot_stands(viewpoint: Viewpoint) -> None:
    """The gripper beside its own wheels, and then out of reach."""
    T = tcp_poses([(0.25, 0.0, 0.3)], yaw=0.0, pitch=np.pi / 2)[0]
    view = viewpoint.of(T, 5, np.zeros(3))
    assert view.q is not None
    assert view.touching
    assert "touching: base_link" in view.said
    assert not viewpoint.of(T, 5).touching, "from elsewhere nothing touches"
    assert viewpoint.of(T, 5, np.array([3.0, 0.0, 0.0])).said.endswith("; out of the arm's reach")


def test_the_last_place_of_a_drag_is_answered(viewpoint: Viewpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    """What came while an answer was computed was dropped, the last place too: the page showed another one's bases."""
    viser = MagicMock()
    server = viser.ViserServer.return_value
    gripper = server.scene.add_transform_controls.return_value
    gripper.wxyz, gripper.position = (1.0, 0.0, 0.0, 0.0), (0.8, 0.0, 0.8)
    server.gui.add_checkbox.return_value.value = False
    monkeypatch.setattr("importlib.import_module", lambda _: viser)
    asked: list[float] = []

    def answer(T_world_tcp: NDArray[np.float64], count: int, _: object = None) -> View:
        asked.append(float(T_world_tcp[0, 3]))
        if asked[-1] == 0.6:
            gripper.position = (0.9, 0.0, 0.8)
            event = threading.Thread(target=moved, args=(None,))
            event.start()
            event.join()
        return Viewpoint.of(viewpoint, T_world_tcp, count)

    monkeypatch.setattr(viewpoint, "of", answer)
    show(viewpoint, 0, 5)
    (moved,) = gripper.on_update.call_args.args
    gripper.position = (0.6, 0.0, 0.8)
    moved(None)
    assert asked == [0.8, 0.6, 0.9]


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
def test_the_page_starts(viewpoint: Viewpoint) -> None:
    server = show(viewpoint, 8123, 20)
    server.stop()
