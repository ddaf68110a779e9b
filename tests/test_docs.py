"""The tables in docs/ against the spaces they describe."""

from __future__ import annotations

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from assets.robots import FETCH
from clutter_env.config import EnvConfig
from clutter_env.envs.observation import OBJECT_FIELDS
from clutter_env.envs.reward import DENSE_SCALES
from clutter_env.scene.layout import LAYOUTS
from clutter_env.scene.random_scene import SHAPE_SETS, capacity

DOCS = Path(__file__).resolve().parents[1] / "docs"
RETRIEVE = (DOCS / "retrieve.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table under a heading."""
    part = RETRIEVE.split(heading, 1)[1]
    table = re.search(r"(?:^\|.*\n)+", part, re.MULTILINE)
    return [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table[0].splitlines()[2:]]


def indices(cell: str) -> list[int]:
    numbers = [int(number) for number in re.findall(r"\d+", cell)]
    return list(range(numbers[0], numbers[1] + 1)) if "–" in cell else numbers


@pytest.mark.parametrize(
    ("heading", "entry"),
    [
        ("### `robot`", "robot"),
        ("### `tcp`", "tcp"),
        ("### `gripper`", "gripper"),
        ("### `goal`", "goal"),
        ("### `objects`", "objects"),
    ],
)
def test_observation_tables_have_every_index_and_its_bounds(heading: str, entry: str) -> None:
    space = gym.make("clutter_env/Retrieve-o1-v0").observation_space[entry]
    seen = []
    for cells in rows(heading):
        low, high = (float(bound) for bound in cells[-1].split(","))
        for index in indices(cells[0]):
            assert (space.low[index], space.high[index]) == (low, high), (entry, index)
            seen.append(index)
    assert seen == list(range(space.shape[0]))


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_action_tables_have_every_index(mode: str) -> None:
    size = gym.make("clutter_env/Retrieve-o1-v0", control_mode=mode).action_space.shape[0]
    seen = [index for cells in rows(f'### `control_mode="{mode}"`') for index in indices(cells[0])]
    assert seen == list(range(size))


def test_action_table_has_the_robots_limits() -> None:
    for cells, velocity, acceleration in zip(
        rows('### `control_mode="joint"`'), FETCH.max_velocity, FETCH.max_acceleration, strict=False
    ):
        assert cells[3].startswith(f"±{velocity} "), cells
        assert cells[4].startswith(f"{acceleration} "), cells


def test_reward_table_has_every_term_and_scale() -> None:
    table = {cells[0]: float(cells[-1]) for cells in rows("## Reward")}
    assert table == dict(DENSE_SCALES)


def test_keyword_and_layout_tables_are_complete() -> None:
    part = RETRIEVE.split("## Keyword arguments", 1)[1]
    names = set(re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", part.split("| layout |")[0], re.MULTILINE))
    documented = {name for cell in names for name in re.findall(r"`(\w+)`", cell)}
    assert documented == set(EnvConfig.__dataclass_fields__)
    for name, layout in LAYOUTS.items():
        line = next(line for line in part.splitlines() if line.startswith(f"| `{name}` |"))
        assert f"{layout.width} × {layout.depth} m" in line
        assert line.rstrip(" |").endswith(", ".join(str(capacity(layout, shapes)) for shapes in SHAPE_SETS))


def test_object_columns_are_counted_right() -> None:
    assert f"reshape(N, {len(OBJECT_FIELDS)})" in RETRIEVE
    limit = gym.spec("clutter_env/Retrieve-o15-v0").max_episode_steps
    assert limit == 6000 + 400 * 15
    assert "6000 + 400 N" in RETRIEVE


@pytest.mark.parametrize("page", ["retrieve", "reach", "pick"])
def test_examples_run(page: str) -> None:
    code = re.search(r"```python\n(import.*?)```", (DOCS / f"{page}.md").read_text(), re.DOTALL)[1]
    names: dict = {}
    exec(code, names)
    observation = names["observation"]
    if page != "retrieve":
        table = (DOCS / f"{page}.md").read_text()
        last = max(int(number) for number in re.findall(r"`observation` \d+(?: –|,) (\d+)", table))
        assert np.shape(observation["observation"]) == (last + 1,)
