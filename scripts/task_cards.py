"""The task cards of the documentation: a page for each family of environments, and a table of all.

    python -m scripts.task_cards            # pages and pictures, a minute
    python -m scripts.task_cards --no-pictures

Every number is read: from the environments, their constants, the results files, and pages of measurements, whose
sentences are quoted. A sentence that is no longer there is an error. A test compares the pages with what this script
writes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clutter_env.cli.list import environment_card, names
from clutter_env.config import CONTROL_HZ
from clutter_env.data.episode import episode_columns
from clutter_env.envs import reward, skill, staged_reward, success
from clutter_env.envs.arm import ArmEnv
from clutter_env.envs.arm_retrieve import ArmRetrieveEnv
from clutter_env.envs.goal import GOAL_TOLERANCE
from clutter_env.evaluation.tables import summarise
from clutter_env.evaluation.verify import claimed
from clutter_env.rendering.framing import across, pixels_of, table_points, view_of
from clutter_env.rendering.renderer import Renderer
from clutter_env.reporting.files import read_json, write_atomically
from clutter_env.reporting.tables import markdown_table
from clutter_env.task import family
from planners import DIRECTIONS
from scripts.card_scores import SCORES

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
CARDS = DOCS / "environments" / "cards"
PICTURES = DOCS / "images" / "cards"
_SIZE = (560, 380)
"""Width and height [pixels] of a picture."""
_RING, _GOAL, _AROUND = 14, (10, 120, 30), 0.12
"""[pixels] Radius of the ring around a goal, its colour, and [m] what is shown around gripper, objects and goal."""
_COLOURS = 128
"""Of a picture's palette: no picture is larger than 100 kB."""


class Score(NamedTuple):
    """A figure, of what and of whom it is, and the page or file that it was read from."""

    figure: str
    about: str
    source: str


NOT_MEASURED = Score("not measured", "", "")
Source = Callable[[], Score]


@dataclass(frozen=True)
class Card:
    """A family of environments.

    Attributes:
        env_id: the environment whose spaces are shown.
        success: when an episode is a success.
        page: the family's page, relative to docs/.
        keywords: of the picture's scene.
        seed: of the picture's scene.
        turn: azimuth and elevation [deg] of the picture's camera; that of the layout if not given.
        random, expert, learner: where the scores of random actions, of the expert and of the best learner are.
    """

    env_id: str
    success: str
    page: str
    keywords: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    turn: tuple[float, float] | None = None
    random: Source = lambda: NOT_MEASURED
    expert: Source = lambda: NOT_MEASURED
    learner: Source = lambda: NOT_MEASURED

    @property
    def name(self) -> str:
        """The family, as in the ids: "ArmRetrieve"."""
        return self.env_id.rpartition("/")[2].partition("-")[0]

    @property
    def file(self) -> Path:
        """The card."""
        return CARDS / f"{self.name.lower()}.md"

    @property
    def picture(self) -> Path:
        """The picture."""
        return PICTURES / f"{self.name.lower()}.png"


# Where scores are.


def measured(env_id: str, policy: str) -> Source:
    """A score of results/cards.json."""

    def read() -> Score:
        one = read_json(SCORES)[env_id][policy]
        figure = f"{one['success']:.2f} [{one['low']:.2f}, {one['high']:.2f}]"
        command = f"clutter-env compare --envs {env_id} --policies {policy} --scenes {one['scenes']}"
        where = f"`{policy}`, {one['scenes']} held-out scenes of {env_id.rpartition('/')[2]}"
        return Score(figure, where, f"`{command}`")

    return read


def results_file(name: str) -> Source:
    """The score of a results file."""

    def read() -> Score:
        path = ROOT / "results" / f"{name}.json.xz"
        evaluation = claimed(path)
        row = summarise(evaluation.policy, [evaluation])
        figure = f"{row.clean.mean:.2f} [{row.clean.low:.2f}, {row.clean.high:.2f}]"
        return Score(
            figure, f"`{row.policy}`, {row.episodes} scenes of `{row.scene_set}`", f"`{path.relative_to(ROOT)}`"
        )

    return read


def quoted(page: str, pattern: str, about: str, form: str = "") -> Source:
    """A figure of a page of docs/. The pattern's groups are its parts, `form` how they are put together."""

    def read() -> Score:
        found = re.search(pattern, " ".join((DOCS / page).read_text().split()))
        if found is None:
            raise ValueError(f"docs/{page} no longer says what its card quotes: {pattern}")
        link = f"[{Path(page).stem.replace('_', ' ')}]({_from_cards(page)})"
        return Score(form.format(*found.groups()) if form else ", ".join(found.groups()), about, link)

    return read


def _from_cards(page: str) -> str:
    """The path of a page of docs/ as seen from the cards."""
    return f"../{page.removeprefix('environments/')}" if page.startswith("environments/") else f"../../{page}"


# What success is, with the numbers of the code.

_NOTHING_ELSE = (
    f"No object has toppled, and none has travelled more than {100 * success.DISTURBED_PATH:.0f} cm other than in the "
    f"gripper, all together at most {100 * success.TOTAL_PATH:.0f} cm. The robot has not pressed hard on furniture, "
    "itself or the ground."
)
_LIFTED = (
    f"The target is lifted {success.LIFT_HEIGHT:.2f} m and held there for {success.HOLD_TIME:g} s. {_NOTHING_ELSE}"
)
_NEAR_GOAL = f"is within {GOAL_TOLERANCE:.2f} m of the goal, whatever else has moved."

CARDS_OF_FAMILIES = (
    Card(
        "clutter_env/Retrieve-o15-v0",
        _LIFTED,
        "retrieve.md",
        {"obstructed": True},
        1,
        random=quoted("results.md", r"`random`: (0\.\d\d)\.", "all suites"),
        expert=results_file("side-15-v3_lookahead"),
        learner=results_file("side-15-v3_keyframes"),
    ),
    Card(
        "clutter_env/ArmRetrieve-o3-v0",
        _LIFTED,
        "environments/arm_retrieve.md",
        {},
        7,
        (90.0, -35.0),
        random=measured("clutter_env/ArmRetrieve-o1-v0", "random"),
        expert=measured("clutter_env/ArmRetrieve-o1-v0", "armretrieve"),
        learner=quoted(
            "train_your_own.md",
            r"rewards alone: `clutter-env train sac[^|]*\| 0 \| [^|]*\| (\d\.\d\d \[[\d., ]+\]) \|",
            "SAC from rewards alone, one object, 100 held-out scenes",
        ),
    ),
    Card(
        "clutter_env/Rearrange-o4-v0",
        f"Every fact of the goal holds at the same time: objects are where it says, and at rest. {_NOTHING_ELSE}",
        "environments/rearrange.md",
        {"task": "sort"},
        1,
        (75.0, -38.0),
        expert=measured("clutter_env/Rearrange-o4-v0", "lookahead-all"),
    ),
    Card(
        "clutter_env/Open-v0",
        f"The drawer or door has been open by {success.OPENED_SHARE:.0%} of its range for {success.HOLD_TIME:g} s. "
        f"{_NOTHING_ELSE}",
        "environments/open.md",
        {"layout": "cupboard"},
        1,
        (38.0, -24.0),
        random=measured("clutter_env/Open-v0", "random"),
        expert=measured("clutter_env/Open-v0", "lookahead-all"),
    ),
    Card(
        "clutter_env/Search-o10-v0",
        f"As in Retrieve, but no camera sees the target at the start. {_LIFTED}",
        "environments/search.md",
        {},
        1,
        expert=quoted(
            "environments/search.md",
            r"`hidden-shelf-10-v2` \| `SearchExpert` \| (\d+) \[([\d%, ]+)\]",
            "`SearchExpert`, 100 scenes of `hidden-shelf-10-v2`",
            "{0} of 100 [{1}]",
        ),
    ),
    Card(
        "clutter_env/Skill-o15-v0",
        f"As in Retrieve, within a budget of skills. {_LIFTED}",
        "environments/skill.md",
        {"obstructed": True},
        5,
        random=measured("clutter_env/Skill-o5-v0", "random-skills"),
        expert=quoted(
            "environments/skill.md",
            r"There the rule `greedy` has \d\.\d\d and the expert (\d\.\d\d)\.",
            "`lookahead`, without skills, 100 scenes of `side-15-v3`",
        ),
        learner=quoted(
            "environments/skill.md",
            r"These weights have (\d\.\d\d \[[\d., ]+\]), (\d\.\d\d) and (\d\.\d\d) on `side-15-v3`",
            "MaskablePPO, three training seeds, 100 scenes of `side-15-v3`, physics of 0.2",
        ),
    ),
    Card(
        "clutter_env/Reach-v0",
        f"The tool centre point (TCP) {_NEAR_GOAL}",
        "environments/reach.md",
        random=measured("clutter_env/Reach-v0", "random"),
        expert=measured("clutter_env/Reach-v0", "reach"),
    ),
    Card(
        "clutter_env/Pick-v0",
        f"The object's centre {_NEAR_GOAL}",
        "environments/pick.md",
        random=measured("clutter_env/Pick-v0", "random"),
        expert=measured("clutter_env/Pick-v0", "pick"),
    ),
    Card(
        "clutter_env/ArmReach-v0",
        f"The tool centre point (TCP) {_NEAR_GOAL}",
        "environments/arm.md",
        turn=(90.0, -30.0),
        random=measured("clutter_env/ArmReach-v0", "random"),
        expert=measured("clutter_env/ArmReach-v0", "armreach"),
        learner=quoted(
            "environments/arm.md",
            r"on 100 held-out scenes is (\d\.\d\d), (\d\.\d\d) and (\d\.\d\d)",
            "TQC with hindsight, three training seeds, 100 held-out scenes",
        ),
    ),
    Card(
        "clutter_env/ArmPick-v0",
        f"The object's centre {_NEAR_GOAL}",
        "environments/arm.md",
        turn=(90.0, -30.0),
        random=measured("clutter_env/ArmPick-v0", "random"),
        expert=measured("clutter_env/ArmPick-v0", "armpick"),
        learner=quoted(
            "tutorials/imitation.md",
            r"`ArmPick` \| state \| ACT \| 100 \| [^|]*\| (50 of 50, \d\.\d\d \[[\d., ]+\])",
            "ACT from 100 demonstrations, held-out scenes",
        ),
    ),
)
"""Every family has a card. The most used come first."""


@dataclass(frozen=True)
class Arguments:
    """Write the cards."""

    pictures: bool = True
    """Draw the pictures too."""


def main(arguments: Arguments) -> None:
    """Write all cards, their table, and the pictures."""
    CARDS.mkdir(parents=True, exist_ok=True)
    for path, text in pages().items():
        write_atomically(path, text.encode())
    if arguments.pictures:
        PICTURES.mkdir(parents=True, exist_ok=True)
        for card in CARDS_OF_FAMILIES:
            draw(card)


def pages() -> dict[Path, str]:
    """The text of every page by its file."""
    listed = names()["environments"]
    found = {
        card.file: page(card, [name for name in listed if family(name) == card.name.lower()])
        for card in CARDS_OF_FAMILIES
    }
    return {CARDS / "index.md": overview(), **found}


def overview() -> str:
    """The page with a row for each family."""
    rows = [
        (
            f"[{card.name}]({card.file.name})",
            card.success.split(". ")[0].rstrip(".") + ".",
            *(_short(score) for score in _scores(card)),
        )
        for card in CARDS_OF_FAMILIES
    ]
    table = markdown_table(("family", "success", "random", "expert", "best learner"), rows)
    return "\n".join(
        (
            "# Task cards",
            "",
            "A page for each family of environments: a picture, success, spaces, rewards, scores. "
            "`clutter-env list` names all ids. `clutter-env list clutter_env/Pick-v0` prints the facts of one.",
            "",
            table,
            "The scores are of different scenes, which each card names with their intervals. A dash: not measured. "
            "`python -m scripts.task_cards` writes these pages from the environments and the results files.",
            "",
        )
    )


def _short(score: Score) -> str:
    """A figure without its interval."""
    return "–" if score == NOT_MEASURED else re.sub(r" \[[^]]*\]", "", score.figure)


def page(card: Card, ids: Sequence[str]) -> str:
    """The card of a family, whose ids are given."""
    facts = environment_card(card.env_id)
    with closing(gym.make(card.env_id, disable_env_checker=True)) as env:
        observation, _ = env.reset(seed=card.seed)
        actions, entries = action_rows(env, observation), observation_rows(env, observation)
        rewards = reward_rows(env)
    robot, layout, control = facts["robot"], facts["layout"], facts["control"]
    scores = [
        (who, score.figure, score.about or "–", score.source or "–")
        for who, score in zip(("random actions", "expert", "best learner"), _scores(card), strict=True)
    ]
    limits = {name: gym.spec(name).max_episode_steps or 0 for name in ids}
    is_skill = card.name == "Skill"
    return (
        "\n".join(
            (
                f"# {card.name}: task card",
                "",
                f"![{card.name}](../../images/cards/{card.picture.name})",
                "",
                f"{facts['task']} [The page of this family]({_from_cards(card.page)}) has its keyword arguments.",
                "",
                "```python",
                "import gymnasium as gym",
                "import clutter_env",
                "",
                f'env = gym.make("{card.env_id}")',
                "observation, info = env.reset(seed=0)",
                "```",
                "",
                "## Success",
                "",
                f'{card.success} It is `info["is_success"]`.',
                "",
                "## Horizon",
                "",
                markdown_table(
                    ("id", "skills at most" if is_skill else "steps at most", "simulated time"),
                    [
                        (f"`{name}`", str(limit), "–" if is_skill else f"{limit / CONTROL_HZ:g} s")
                        for name, limit in limits.items()
                    ],
                ),
                f"Robot `{robot}`, layout `{layout}`, control mode `{control}`"
                + (" inside a skill." if is_skill else f", {CONTROL_HZ} steps a second."),
                "",
                "## Observation",
                "",
                f"Of `{card.env_id}`.",
                "",
                markdown_table(("entry", "shape", "type", "from, to", "holds"), entries),
                "## Action",
                "",
                markdown_table(("index", "meaning", "from, to"), actions),
                "## Reward",
                "",
                markdown_table(("`reward_mode`", "of a step", "from, to"), rewards),
                "## Scores",
                "",
                markdown_table(("who", "success", "where", "source"), scores),
            )
        ).rstrip()
        + "\n"
    )


def _scores(card: Card) -> tuple[Score, Score, Score]:
    return card.random(), card.expert(), card.learner()


# The spaces.


def observation_rows(env: gym.Env, observation: Any) -> list[tuple[str, ...]]:
    """Entry, shape, type, bounds, and what its numbers are."""
    if not isinstance(env.observation_space, gym.spaces.Dict):
        space = env.observation_space
        rows = len(skill.BODY_FIELDS) + DIRECTIONS
        about = (
            f"{rows} for each object: {', '.join(skill.BODY_FIELDS)}, and for each of {DIRECTIONS} directions whether "
            "clearing has failed; then the share of the budget that is left, and whether taking has failed"
        )
        return [("(the array)", str(space.shape), str(space.dtype), _bounds(space), about)]
    columns = episode_columns(env, observation)
    layout = env.get_wrapper_attr("observation_layout")
    return [
        (f"`{name}`", str(space.shape), str(space.dtype), _bounds(space), _holds(name, layout, columns))
        for name, space in env.observation_space.spaces.items()
    ]


def _holds(name: str, layout: Mapping[str, Any], columns: Mapping[str, Any]) -> str:
    """Names of the quantities of an entry."""
    if name in ("objects", "goals"):
        return f"{layout[name].size} for each object: {', '.join(layout[name])}"
    if name in layout:
        return ", ".join(_once(layout[name]))
    if name == "observation":
        return "`robot`, `tcp`, `gripper` and the rows of `objects` of Retrieve, one after the other"
    about = columns[f"observations/{name}"]
    return ", ".join(about.names) + f": {about.about}" if about.names else _IMAGES.get(name.rpartition("_")[2], name)


_IMAGES = {
    "rgb": "colours",
    "depth": "distances along the camera's axis, m",
    "segmentation": "number of the mask at each pixel",
    "K": "matrix of the camera, pixels",
    "camera": "pose of the camera in the base's frame",
    "target": "colour (red, green, blue), whether it is a box, half extents, m",
}
"""Entries of a camera by the end of their names, and the description of the target to search."""


def _once(quantities: Iterable[str]) -> Iterable[str]:
    """The names, those of several objects as one."""
    shown = [re.sub(r"^object_\d+$", "a row for each object", name) for name in quantities]
    return dict.fromkeys(shown)


def _bounds(space: Any) -> str:
    low, high = np.unique(space.low), np.unique(space.high)
    if len(low) == len(high) == 1:
        return f"{low[0]:g}, {high[0]:g}"
    return f"{low.min():g}, {high.max():g} at most"


def action_rows(env: gym.Env, observation: Any) -> list[tuple[str, ...]]:
    """Index, meaning and bounds of the numbers of an action."""
    space: Any = env.action_space
    if isinstance(space, gym.spaces.Discrete):
        last = int(space.n) - 1
        return [
            (f"0 – {last - 1}", f"{DIRECTIONS} i + d: clear object i of the observation from direction d", "–"),
            (str(last), "take the target by any free grasp", "–"),
        ]
    known = episode_columns(env, observation)["actions"].names
    head = ["head_pan_rate", "head_tilt_rate"]
    spoken = [name.replace("_", " ") for name in (*known, *head[: space.shape[0] - len(known)])]
    return [
        (str(index), name, f"{low:g}, {high:g}")
        for index, (name, low, high) in enumerate(zip(spoken, space.low, space.high, strict=True))
    ]


def reward_rows(env: gym.Env) -> list[tuple[str, ...]]:
    """Mode, meaning and range of the rewards of a step. The default mode comes first."""
    inner: Any = env.unwrapped
    if isinstance(inner, skill.SkillEnv):
        cost = skill.SKILL_COST
        return [("–", f"1 at success, less {cost:g} for every skill", f"{-cost:g}, {1 - cost:g}")]
    config = inner.config
    is_goal = hasattr(inner, "compute_reward")
    rows = [(mode, *_reward(mode, is_goal, config.num_objects)) for mode in config.reward_modes]
    rows.sort(key=lambda row: row[0] != config.reward_mode)
    return [(f'`"{mode}"`' + (" (default)" if mode == config.reward_mode else ""), *rest) for mode, *rest in rows]


def _reward(mode: str, is_goal: bool, num_objects: int) -> tuple[str, str]:
    """What a step earns, and the least and the most of it."""
    if is_goal and mode == "staged":
        return f"progress of the task; 1 if the object is held within {GOAL_TOLERANCE:.2f} m of the goal", "0, 1"
    if is_goal:
        near = f"0 within {GOAL_TOLERANCE:.2f} m of the goal, else -1"
        return (near, "-1, 0") if mode == "sparse" else ("minus the distance to the goal, m", "-∞, 0")
    if mode == "sparse":
        return "1 at success, else 0", "0, 1"
    if mode == "staged":
        return f"progress of the task; {staged_reward.SUCCESS:g} at success", f"0, {staged_reward.SUCCESS:g}"
    scales = reward.EVENT_SCALES
    events = ", ".join(f"{scale:g} for {_EVENTS[name]}" for name, scale in scales.items())
    # The potential is 0 after the end: success earns no more than its event.
    least = scales["failure"] + num_objects * scales["disturbed"] - reward.MOST
    return f"change of a potential, and {events}", f"{least:g}, {scales['success']:g}"


_EVENTS = {"success": "success", "disturbed": "each object disturbed or fallen", "failure": "an end without success"}
"""Events of a step in words."""


# The pictures.


def draw(card: Card) -> None:
    """Draw the first state of a scene."""
    with closing(gym.make(card.env_id, render_mode="rgb_array", disable_env_checker=True, **card.keywords)) as env:
        env.reset(seed=card.seed)
        write_picture(card.picture, picture(env, card))


def picture(env: gym.Env, card: Card) -> NDArray[np.uint8]:
    """The first state, with the goal's marks, or a ring around a goal that is a point."""
    world: Any = getattr(env.unwrapped, "physics_env", env.unwrapped)
    goal: Any = world.goal if hasattr(world, "compute_reward") else None
    if isinstance(world, ArmEnv):  # goals are relative to where the gripper starts
        goal = goal + world.origin
    renderer = Renderer(world.model, *_SIZE)
    renderer.marks = world.world.marks
    camera = view_of(world.model, _in_view(world, goal), card.turn or across(world.layout), _SIZE[0] / _SIZE[1])
    image = Image.fromarray(renderer.colour(world.data, camera))
    renderer.close()
    if goal is not None:
        (x, y), draw = pixels_of(world.model, camera, goal[None], _SIZE)[0], ImageDraw.Draw(image)
        for radius, colour in ((_RING, "white"), (_RING - 2, _GOAL)):
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=4)
        draw.text((x + _RING + 6, y), "goal", fill=_GOAL, font=ImageFont.load_default(20), anchor="lm")
    return np.asarray(image)


def _in_view(world: Any, goal: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Corners (n, 3) of what the picture shows: the table, or where a small task takes place."""
    gripper = world.data.site_xpos[world.world.index.tcp_site]
    if goal is None and not isinstance(world, ArmRetrieveEnv):
        return np.vstack((table_points(world.layout), gripper))
    here = np.vstack((gripper, world.measurements.poses[:, :3], *([] if goal is None else [goal])))
    low, high = here.min(axis=0) - _AROUND, here.max(axis=0) + _AROUND
    return np.array(list(product(*zip(low, high, strict=True))))


def write_picture(path: Path, image: NDArray[np.uint8]) -> None:
    """Write with a palette, so that it is small."""
    Image.fromarray(image).quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
