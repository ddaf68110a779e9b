"""The tables in docs/ against the spaces they describe."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import clutter_env  # noqa: F401 - registers the environments
from assets.robots import FETCH, RobotSpec
from clutter_env.config import EnvConfig
from clutter_env.envs.observation import OBJECT_FIELDS, OBSERVATION_LAYOUT
from clutter_env.envs.reward import DENSE_SCALES
from clutter_env.scene.layout import LAYOUTS, Layout
from clutter_env.scene.object_sets import SHAPE_SETS, capacity

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
    assert limit == 400 + 220 * 15
    assert "400 + 220 N" in RETRIEVE


EXAMPLES = [
    (page, code)
    for page in ("retrieve", "environments/reach", "environments/pick", "environments/skill", "add_a_robot")
    for code in re.findall(
        r"^```python\n((?:import|from) .*?)^```", (DOCS / f"{page}.md").read_text(), re.DOTALL | re.M
    )
]


def test_every_page_has_an_example() -> None:
    pages = [page.removeprefix("environments/") for page, _ in EXAMPLES]
    assert pages == ["retrieve", "retrieve", "reach", "pick", "skill", "add_a_robot", "add_a_robot"]


@pytest.mark.parametrize(("page", "code"), EXAMPLES, ids=[page for page, _ in EXAMPLES])
def test_examples_run(page: str, code: str) -> None:
    names: dict = {}
    exec(code, names)
    observation = names["observation"]
    assert observation in names["env"].observation_space
    if page in ("environments/reach", "environments/pick"):
        table = (DOCS / f"{page}.md").read_text()
        last = max(int(number) for number in re.findall(r"`observation` \d+(?: –|,) (\d+)", table))
        assert np.shape(observation["observation"]) == (last + 1,)


EXTENSIONS = re.findall(r"^```python\n(.*?)^```", (DOCS / "extend.md").read_text(), re.DOTALL | re.M)


@pytest.mark.parametrize("code", EXTENSIONS, ids=["strategy", "task planner", "layout"])
def test_extensions_run(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(code, {})
    assert capsys.readouterr().out


def test_named_columns_are_where_the_page_says() -> None:
    assert OBSERVATION_LAYOUT["robot"]["base_velocity"] == slice(12, 15)
    for heading, entry in (("### `robot`", "robot"), ("### `objects`", "objects"), ("### `goal`", "goal")):
        units = {index: cells[2] for cells in rows(heading) for index in indices(cells[0])}
        for index, column in enumerate(OBSERVATION_LAYOUT[entry].columns):
            assert units[index] == (column.unit or units[index]), (entry, column)
            assert bool(column.unit) == (units[index] not in ("–", "0 or 1")), (entry, column)


def test_layout_and_robot_fields_are_documented() -> None:
    documented = {name for cells in rows("### A layout of your own") for name in re.findall(r"`(\w+)`", cells[0])}
    assert documented == set(Layout.__dataclass_fields__)
    table = re.search(r"\| field \|.*?\n\n", (DOCS / "add_a_robot.md").read_text(), re.DOTALL)[0]
    named = {name for line in table.strip().splitlines() for name in re.findall(r"`(\w+)`", line.split("|")[1])}
    assert named == set(RobotSpec.__dataclass_fields__)


@pytest.mark.parametrize("page", sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")))
def test_files_and_modules_named_in_the_pages_exist(page: str) -> None:
    text = (DOCS / page).read_text()
    for file in re.findall(r"(?:assets|tests|scripts|docs)/[\w/]+\.(?:py|xml|md|png)", text):
        assert (DOCS.parent / file).is_file(), file
    for module in re.findall(r"from ([\w.]+) import", text):
        importlib.import_module(module)
