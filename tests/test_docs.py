"""README and the pages of docs/: their Python runs, their commands can be read, their tables say what the code does."""

from __future__ import annotations

import importlib.util
import json
import os
import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

import clutter_env
import irm
from assets import FETCH, RobotSpec, robot
from clutter_env.cli.main import COMMANDS, read
from clutter_env.config import EnvConfig
from clutter_env.envs.observation import OBJECT_FIELDS, OBSERVATION_LAYOUT
from clutter_env.envs.reward import EVENT_SCALES, POTENTIAL_SCALES
from clutter_env.reporting.files import read_json
from clutter_env.scene.layout import LAYOUTS, Layout
from clutter_env.scene.object_sets import SHAPE_SETS, capacity
from planners import STRATEGIES, Cause, Solution
from scripts.site_search import BOOSTS, boost_of
from tests.planners.own_scenes import deepest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = {str(path.relative_to(ROOT)): path.read_text() for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))}
USER_PAGES = {name: text for name, text in PAGES.items() if not name.startswith("docs/notes/")}
MOST_WORDS = {"docs/results.md": 800}
FOR_OTHERS = ("clutter_env.bridges.for_vla_eval",)
"""Modules that import a package which is not among our own."""
SLOW = (
    "docs/irm.md",
    "docs/guides/two_arms.md",
    "docs/planners.md",
    "docs/tutorials/planning.md",
    "docs/tutorials/reinforcement_learning.md",
    "docs/tutorials/search.md",
)
"""Pages whose Python takes more than two seconds."""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE)


WITH_PYTHON = [page for page in USER_PAGES if blocks(page, "python") and page != "docs/learning.md"]


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.slow if page in SLOW else ()) for page in WITH_PYTHON],
)
def test_the_python_of_a_page_runs_from_top_to_bottom(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And prints what the `text` block below it says, where "…" stands for anything."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    for code, said in re.findall(
        r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```)?", PAGES[page], re.DOTALL | re.MULTILINE
    ):
        exec(compile(code, page, "exec"), names)
        out = capsys.readouterr().out
        assert re.search(re.escape(said).replace("…", ".*"), out, re.DOTALL), f"{out}is printed, not\n{said}"
    if page == "README.md":
        assert (tmp_path / "episode.html").stat().st_size > 20_000
        assert names["answer"].poses.shape[1] == 3
    if page.startswith("docs/environments/") and "observation" in names:
        assert names["observation"] in names["env"].observation_space
    if page == "docs/your_own_scene.md":
        solution = names["solution"]
        assert isinstance(solution, Solution)
        assert deepest(names["model"], solution, ("pillar", "plate", "leg", "wall"))[0] <= 0.001


@pytest.mark.slow
def test_the_python_of_the_learning_page_runs_after_its_collection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one episode in place of two hundred."""
    page = "docs/learning.md"
    lines = [line for block in blocks(page, "sh") for line in block.splitlines()]
    collect, export = (next(line for line in lines if f"clutter-env {name}" in line) for name in ("collect", "export"))
    monkeypatch.chdir(tmp_path)
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); from clutter_env.cli.main import main; main()",
    ]
    for line in (collect.replace("--episodes 200", "--episodes 1"), export):
        subprocess.run([*command, *shlex.split(line)[1:]], check=True)
    script = tmp_path / "page.py"
    body = "".join(f"    {line}" for line in "\n".join(blocks(page, "python")).splitlines(keepends=True))
    script.write_text(f"import sys\nsys.path.insert(0, {str(ROOT)!r})\nif __name__ == '__main__':\n{body}")
    subprocess.run([sys.executable, script], check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *("clone", "collect", "evaluate", "run_expert", "objects_of_pieces", "demonstrations_and_rewards 0 64 5"),
        *("arm_retrieve_demonstrations 1 0 64 5", "reverse_curriculum 1 0 64 5", "clone_then_rewards 3 0 64 5"),
    ],
)
def test_the_examples_run(name: str, tmp_path: Path) -> None:
    """`clone.py` imported a name that there was no longer."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    name, *arguments = name.split()
    command = [sys.executable, ROOT / "examples" / f"{name}.py", *arguments]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    if name == "clone":
        assert float(ended.stdout.split()[-1]) >= 0.5
    if arguments:
        assert ended.stdout.splitlines()[-1].startswith("64 steps")
    if name == "objects_of_pieces":
        assert ended.stdout.count("1 planned, 1 lifted") >= 5


def commands(page: str) -> Iterator[list[str]]:
    """The package's own commands in the shell blocks of a page, without comments."""
    for block in blocks(page, "sh"):
        for line in block.replace("\\\n", " ").splitlines():
            argv = shlex.split(line, comments=True)
            if argv[:1] == ["clutter-env"]:
                yield argv[1:]


@pytest.mark.parametrize("page", [page for page in USER_PAGES if any(commands(page))])
def test_the_commands_of_a_page_can_be_read(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page.endswith("robot_from_a_file.md"):  # its first command makes a robot that the others name
        panda = robot("panda_mobile")
        named = {"base_joints": panda.base_joints, "tip": "tcp", "finger_joints": panda.finger_joints}
        monkeypatch.chdir(tmp_path)
        Path("vx300s.xml").write_text(panda.mjcf_path.read_text())
        Path("vx300s.json").write_text(json.dumps({**named, "home": panda.home}))
    for command, *argv in commands(page):
        if command in ("--help", "COMMAND"):
            continue
        assert command in COMMANDS, command
        module = importlib.import_module(f"clutter_env.cli.{command}")
        if hasattr(module, "Arguments") and "--help" not in argv:
            read(module, command, argv)


def test_the_table_of_members_names_what_there_is() -> None:
    lines = re.findall(r"^\| (`.*?) \| .* \| (.*) \|$", PAGES["docs/api/environments.md"], re.MULTILINE)
    assert len(lines) > 10
    for kind in ("Retrieve-o5", "Rearrange-o4", "Pick", "ArmReach", "Skill-o5"):
        env = gym.make(f"clutter_env/{kind}-v0").unwrapped
        env.reset(seed=0)
        for members, where in lines:
            if kind.partition("-")[0] in where.split(", ") or (where.startswith("all") and "Skill" not in kind):
                assert all(hasattr(env, name) for name in re.findall(r"`(\w+)", members)), (kind, members)
        env.close()


@pytest.mark.parametrize("page", USER_PAGES)
def test_pages_are_short(page: str) -> None:
    assert len(PAGES[page].split()) <= MOST_WORDS.get(page, 1500)


def test_a_release_is_read_in_two_minutes() -> None:
    """And what the changelog links to exists."""
    text = (ROOT / "CHANGELOG.md").read_text()
    releases = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    assert [release.split()[0].rstrip(",") for release in releases] == ["0.3.0", "0.2.0", "0.1.0"]
    assert all(len(release.split()) <= 600 for release in releases)
    for link in re.findall(r"\]\((?!https?:)([^)#\s]+)", text):
        assert (ROOT / link).is_file(), link


def test_what_a_reader_tries_first_is_found_first() -> None:
    """The weights of the search are those of pages that exist, and the site uses them."""
    assert "hooks: [scripts/site_search.py]" in (ROOT / "mkdocs.yml").read_text()
    for start in BOOSTS:
        assert any(page.startswith(f"docs/{start}") for page in PAGES), start
    assert boost_of("tutorials/quickstart.md") > boost_of("planners.md") > boost_of("notes/planners.md")


def test_every_page_is_in_the_sites_contents() -> None:
    contents = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    assert contents == {str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md")}


@pytest.mark.parametrize("page", PAGES)
def test_every_link_resolves_in_a_clone(page: str) -> None:
    """Files and headings; README's links are relative to the repository, so that they work in every clone and fork."""
    for link in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)", PAGES[page]):
        file, _, anchor = link.partition("#")
        path = (ROOT / page).parent / file if file else ROOT / page
        assert path.is_file(), link
        headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE) if anchor else []
        assert anchor in ("", *(re.sub(r"[^\w\- ]", "", h).strip().lower().replace(" ", "-") for h in headings)), link


@pytest.mark.parametrize("page", USER_PAGES)
def test_files_and_names_of_the_pages_exist(page: str) -> None:
    for file in re.findall(
        r"(?:assets|tests|scripts|docs|examples|planners)/[\w/]+\.(?:py|xml|md|png|pddl)", PAGES[page]
    ):
        assert (ROOT / file).is_file(), file
    for name in re.findall(r"\b((?:assets|irm|planners|clutter_env)(?:\.\w+)+)\b(?<!\.md|\.py)", PAGES[page]):
        if name in FOR_OTHERS:
            assert importlib.util.find_spec(name)
        else:
            pkgutil.resolve_name(name)


def test_the_results_in_readme_are_those_of_the_results_page() -> None:
    """Every cell of both tables. README has only what a file of `results/` confirms."""
    results = PAGES["docs/results.md"]
    shown = rows("README.md", "**Headroom for learning.**")
    known = {cells[0].split("`")[1]: cells for cells in rows("docs/results.md", "## Policies on suites")}
    assert len(shown) == 2
    for cells in shown:
        suite = cells[0].split("`")[1]
        assert cells[1:] == known[suite][1:], suite
        assert known[suite][0].endswith("*"), "of this version"
        assert all(cell.startswith("**") for cell in cells[1:]), "only what a file of results/ holds"
    table = re.findall(r"^\| \d+ \| \d+ \| [\d.]+ \| .*solves.* \|$", PAGES["README.md"], re.M)
    assert len(table) == 2
    assert all(row in results for row in table)


def test_readme_says_of_the_expert_what_its_files_say() -> None:
    """Episodes won, objects moved and the bounds of today, and in how many scenes both are equal."""
    lines = [json.loads(line) for line in (ROOT / "results" / "bounds.jsonl").read_text().splitlines()]
    optimal = []
    for suite, success, moved, minimum in rows("README.md", "**An expert that knows its optimum.**"):
        name = suite.strip("`")
        episodes = read_json(ROOT / "results" / f"{name}_lookahead.json.xz")["episodes"]
        mine = [line for line in lines if (line["suite"], line["grasps"]) == (name, "side")]
        assert success == f"{sum(one['clean'] for one in episodes)} of {len(episodes)}"
        assert int(moved) == sum(one["moved"] for one in episodes)
        assert int(minimum) == sum(line["today"] for line in mine)
        assert all(line["proved"] for line in mine)
        optimal.append(sum(line["moved"] == line["today"] for line in mine))
    assert len(optimal) == 2
    assert f"In {optimal[0]} and {optimal[1]} of the scenes" in " ".join(PAGES["README.md"].split())


def test_the_figures_with_a_file_are_bold_and_no_others() -> None:
    policies = ("lookahead", "keyframes", "end-to-end", "greedy")
    files = {file.name.removesuffix(".json.xz") for file in (ROOT / "results").glob("*.xz")}
    for cells in rows("docs/results.md", "## Policies on suites"):
        suite = cells[0].split("`")[1]
        for policy, cell in zip(policies, cells[1:], strict=True):
            names = (policy, f"{policy}-all", f"{policy}-shelf")
            has_file = any(f"{suite}_{name}" in files for name in names)
            assert (cell.startswith("**") and cell.endswith("**")) == has_file, (suite, policy)


def test_readme_says_of_libero_what_its_page_says() -> None:
    text = " ".join(PAGES["README.md"].split())
    for suite in ("libero_goal", "libero_spatial", "libero_object"):
        row = re.search(rf"^\| `{suite}` \| (\d+) \|.*\| (\d+) \(\d+ steps\)", PAGES["docs/guides/libero.md"], re.M)
        assert row is not None
        episodes, within = row.groups()
        assert re.search(rf"\b{within} of {episodes}( episodes)? of `{suite}`", text), suite


def test_every_cause_and_strategy_is_on_the_planners_page() -> None:
    for cause in Cause:
        assert f"| `{cause}` |" in PAGES["docs/planners.md"]
    for name in STRATEGIES:
        assert f"| `{name}`" in PAGES["docs/planners.md"]


def rows(page: str, heading: str) -> list[list[str]]:
    """Cells of the first table under a heading."""
    part = PAGES[page].split(heading, 1)[1]
    table = re.search(r"(?:^\|.*\n)+", part, re.MULTILINE)
    assert table is not None
    return [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table[0].splitlines()[2:]]


def indices(cell: str) -> list[int]:
    numbers = [int(number) for number in re.findall(r"\d+", cell)]
    return list(range(numbers[0], numbers[1] + 1)) if "–" in cell else numbers


SPACES = "docs/environments/actions_observations.md"


@pytest.mark.parametrize("entry", ["robot", "tcp", "gripper", "goal", "objects"])
def test_observation_tables_have_every_index_its_unit_and_its_bounds(entry: str) -> None:
    space = gym.make("clutter_env/Retrieve-o1-v0").observation_space[entry]
    seen = []
    for cells in rows(SPACES, f"### `{entry}`"):
        low, high = (float(bound) for bound in cells[-1].split(","))
        for index in indices(cells[0]):
            assert (space.low[index], space.high[index]) == (low, high), (entry, index)
            column = OBSERVATION_LAYOUT[entry].columns[index]
            assert cells[2] == column.unit or (not column.unit and cells[2] in ("–", "0 or 1")), (entry, index)
            seen.append(index)
    assert seen == list(range(space.shape[0]))
    assert f"reshape(N, {len(OBJECT_FIELDS)})" in PAGES[SPACES]


@pytest.mark.parametrize("mode", ["joint", "ee"])
def test_action_tables_have_every_index_and_the_robots_limits(mode: str) -> None:
    table = rows(SPACES, f'### `control_mode="{mode}"`')
    size = gym.make("clutter_env/Retrieve-o1-v0", control_mode=mode).action_space.shape[0]
    assert [index for cells in table for index in indices(cells[0])] == list(range(size))
    if mode == "joint":
        for cells, velocity, acceleration in zip(table, FETCH.max_velocity, FETCH.max_acceleration, strict=False):
            assert cells[3].startswith(f"±{velocity} "), cells
            assert cells[4].startswith(f"{acceleration} "), cells


def test_tables_of_keywords_layouts_rewards_and_robots_are_complete() -> None:
    table = {cells[0].strip("`"): float(cells[-1]) for cells in rows("docs/retrieve.md", "## Reward")}
    assert table == POTENTIAL_SCALES | EVENT_SCALES
    keywords = {name for cells in rows("docs/retrieve.md", "## Keyword") for name in re.findall(r"`(\w+)`", cells[0])}
    assert keywords == set(EnvConfig.__dataclass_fields__)
    layouts = {cells[0].strip("`"): cells for cells in rows("docs/environments/layouts.md", "# Layouts")}
    assert set(layouts) == set(LAYOUTS)
    for name, layout in LAYOUTS.items():
        assert layouts[name][1] == f"{layout.width} × {layout.depth} m"
        assert layouts[name][-1] == ", ".join(str(capacity(layout, shapes)) for shapes in SHAPE_SETS)
    own = rows("docs/environments/layouts.md", "## A layout of your own")
    assert {name for cells in own for name in re.findall(r"`(\w+)`", cells[0])} == set(Layout.__dataclass_fields__)
    robot = PAGES["docs/robot_of_the_package.md"].split("| field |", 1)[1].split("\n\n", 1)[0]
    named = {name for line in robot.splitlines()[2:] for name in re.findall(r"`(\w+)`", line.split("|")[1])}
    assert named == set(RobotSpec.__dataclass_fields__)
    limit = gym.spec("clutter_env/Retrieve-o15-v0").max_episode_steps
    assert limit == 400 + 220 * 15 == clutter_env.time_limit(15)
    assert "400 + 220 N" in PAGES["docs/retrieve.md"]


def test_the_page_of_irm_names_what_it_offers() -> None:
    """Constants aside."""
    offered = {name for name in irm.__all__ if callable(getattr(irm, name))}
    assert set(re.findall(r"^::: irm\.(\w+)$", PAGES["docs/api/irm.md"], re.MULTILINE)) == offered
