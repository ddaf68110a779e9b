"""A robot that is put into configurations in models of its own."""

import numpy as np
import pytest

from assets.robots import FETCH, PR2, RobotSpec
from clutter_env.experiments.maps.bases.base_quality import CollisionModel
from clutter_env.experiments.maps.map_renderer import MapRenderer, View
from clutter_env.scene.layout import LAYOUTS


@pytest.mark.parametrize("robot", [FETCH, PR2], ids=lambda robot: robot.name)
def test_a_robot_is_free_beside_the_table_and_not_within_it(robot: RobotSpec) -> None:
    model = CollisionModel(robot, LAYOUTS["paper"])
    assert model.is_free(np.array([-2.0, 0.0, 0.0]), np.array(robot.home))
    assert not model.is_free(np.zeros(3), np.array(robot.home))


@pytest.mark.usefixtures("needs_gl")
def test_a_picture_shows_the_robot_where_it_is_put() -> None:
    renderer = MapRenderer(FETCH, (60, 60))
    view = View(target=(0.0, 0.0, 0.5), distance=4.0, azimuth=90.0, elevation=-20.0)
    try:
        pictures = [
            renderer.picture(np.array([x, 0.0, 0.0]), np.array(FETCH.home), view, show_floor=False) for x in (0, 0.5)
        ]
    finally:
        renderer.close()
    middles = [np.argwhere(picture[..., 3] > 0).mean(axis=0)[1] for picture in pictures]
    assert abs(middles[0] - middles[1]) > 3
