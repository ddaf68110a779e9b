"""Pictures of plans: the overview of `Solution.plot`, and one picture for each clearance."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

from assets.robots import FETCH
from planners import Planner, Solution
from planners.drawing.choices import ClearancePicture, choices_of, last_picture
from planners.drawing.pictures import COLOURS, draw_clearance, draw_plan
from planners.placing.negative_goal_region import SweptVolume
from planners.placing.swept_volume import path_volume
from tests.planners.pieces import bowl, mug
from tests.planners.plans import solved
from tests.planners.scenes import HEIGHT, cylinder, table_scene

mpl.use("agg")


@pytest.fixture(scope="module")
def choices() -> list[ClearancePicture]:
    """The choices of a plan, whose regions take seconds to compute."""
    return choices_of(solved())


def free() -> Solution:
    """A plan without clearances."""
    found = Planner(FETCH).solve(table_scene(cylinder("object_00", -0.2, 0.1)), "object_00")
    assert isinstance(found, Solution)
    return found


def drawn(axes: Axes, what: str) -> list[Any]:
    """The lines and patches with this name."""
    return [artist for artist in (*axes.lines, *axes.patches) if artist.get_gid() == what]


def test_the_overview_joins_both_places_of_each_clearance() -> None:
    plan = solved()
    axes = Figure().subplots()
    assert plan.plot(axes) is axes
    puts = [action for action in plan.actions if action.is_put_down]
    assert len(drawn(axes, "move")) == len(plan.clearances) > 0
    for line, action in zip(drawn(axes, "move"), puts, strict=True):
        assert action.released is not None
        assert (line.get_ydata()[-1], line.get_xdata()[-1]) == tuple(action.released.position[:2])
        objects = [patch.get_zorder() for patch in axes.patches if patch.get_alpha() is not None]
        assert line.get_zorder() < min(objects), "it is no path over the objects"
    texts = [text.get_text() for text in axes.texts]
    assert {name.removeprefix("object_") for name in plan.actions[0].scene.names} <= set(texts)
    assert plan.target in axes.get_title()


def test_objects_of_pieces_are_drawn_piece_by_piece_where_they_are() -> None:
    bodies = mug("object_00", (-0.2, 0.1, HEIGHT)), bowl("bowl", (0.1, -0.1, HEIGHT))
    plan = Planner(FETCH).solve(table_scene(*bodies), "object_00")
    assert isinstance(plan, Solution)
    axes = plan.plot()
    drawn_corners = {patch.get_xy()[:-1].tobytes() for patch in axes.patches if isinstance(patch, Polygon)}
    for piece in (piece for body in bodies for piece in body.placed):
        assert np.ascontiguousarray(piece.outline[:, ::-1]).tobytes() in drawn_corners


def test_the_overview_makes_its_own_figure() -> None:
    axes = free().plot()
    assert axes.figure is not None
    assert not drawn(axes, "move")


def test_a_plan_without_actions_is_refused_with_the_reason() -> None:
    empty = dataclasses.replace(solved(), actions=(), clearances=())
    with pytest.raises(ValueError, match="without actions"):
        empty.plot()
    with pytest.raises(ValueError, match="without actions"):
        last_picture(empty)


def test_choices_are_the_clearances_in_order_where_the_plan_puts_them(choices: list[ClearancePicture]) -> None:
    plan = solved()
    puts = [action for action in plan.actions if action.is_put_down]
    assert [choice.moved for choice in choices] == list(plan.clearances)
    for choice, action in zip(choices, puts, strict=True):
        assert action.released is not None
        assert choice.chosen is not None
        np.testing.assert_array_equal(choice.chosen, action.released.position[:2])
        assert choice.obstructed == action.obstructed
    assert choices[-1].obstacles == []


def test_rank_and_outline_of_the_chosen_place_do_not_hide_each_other(choices: list[ClearancePicture]) -> None:
    """The ring of the chosen place was drawn over its rank."""
    picture = choices[0]
    axes = Figure().subplots()
    draw_clearance(axes, picture)
    (ring,) = drawn(axes, "put")
    rank = next(k for k, place in enumerate(picture.ordered, start=1) if np.allclose(place, picture.chosen))
    at = next(text.xy for text in axes.texts if text.get_text() == str(rank))
    assert np.hypot(*np.subtract(at, ring.center)) == pytest.approx(ring.radius)


def test_a_base_that_takes_and_puts_shows_both_colours(choices: list[ClearancePicture]) -> None:
    """One triangle hid the other."""
    picture = choices[0]
    for stands, colours in (
        ([[-0.9, 0.1], [-0.9, 0.1]], [(COLOURS["moved"], COLOURS["location"])]),
        ([[-0.9, 0.1], [-0.9, 0.2]], [(COLOURS["moved"],) * 2, (COLOURS["location"],) * 2]),
        ([[-0.9, 0.1]], [(COLOURS["target"],) * 2]),
    ):
        axes = Figure().subplots()
        draw_clearance(axes, dataclasses.replace(picture, stands=np.array(stands)))
        marks = [(mark.get_color(), mark.get_markerfacecoloralt()) for mark in drawn(axes, "stand")]
        assert marks == colours


def test_the_last_picture_shows_the_objects_where_the_plan_leaves_them() -> None:
    plan = solved()
    bodies = {body.name: body for body in last_picture(plan).bodies}
    for action in plan.actions:
        if action.released is not None:
            np.testing.assert_allclose(bodies[action.target].position, action.released.position, atol=1e-6)


def test_the_last_picture_shows_the_gripper_as_wide_as_it_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed fingers leave a gap; the picture left it out."""
    plan, openings = solved(), []

    def record(*arguments: Any) -> SweptVolume:
        openings.append(arguments[2])
        return path_volume(*arguments)

    monkeypatch.setattr("planners.drawing.choices.path_volume", record)
    last_picture(plan)
    trajectory = plan.actions[-1].trajectory
    approach = next(phase for phase in trajectory.phases if phase.name == "approach")
    assert max(openings) == pytest.approx(FETCH.opening(trajectory.sample(approach.start).finger_position))
    assert min(openings) == pytest.approx(FETCH.opening(0.0))


@pytest.mark.slow
def test_an_object_in_the_gripper_at_the_start_is_drawn_too(tmp_path: Path) -> None:
    plan = solved()
    index = next(i for i, action in enumerate(plan.actions) if action.name == "PickUp")
    later = dataclasses.replace(plan, actions=plan.actions[index + 1 :])
    assert [choice.moved for choice in choices_of(later)] == list(plan.clearances)
    draw_plan(later, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 10_000


def test_the_legend_leaves_room_for_the_title_of_a_single_picture(tmp_path: Path) -> None:
    """The title was cut in half where the plan has no clearances."""
    draw_plan(free(), tmp_path / "plan.png")
    pixels = np.asarray(Image.open(tmp_path / "plan.png").convert("L"))
    assert pixels[0].min() == 255
    assert pixels.min() < 100
