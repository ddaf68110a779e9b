"""Names that the package knows: environments, suites, layouts, robots and policies.

    clutter-env list
    clutter-env list suites
    clutter-env list clutter_env/Retrieve-o15-v0
    clutter-env list --json names.json

With the id of an environment it prints the facts that a learner needs: observation, action, step limit, rewards, and
its experts.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro


@dataclass(frozen=True)
class Arguments:
    """List the names."""

    what: Annotated[str, tyro.conf.Positional] = ""
    """environments, suites, layouts, robots or policies, or the id of an environment. All kinds if not given."""
    json: Path | None = None
    """Write the same to this file."""


def run(arguments: Arguments) -> None:
    """Print names with a sentence each, or one environment.

    Raises:
        UsageError: neither a kind nor an environment.
    """
    from clutter_env.errors import UsageError
    from clutter_env.reporting.files import write_json

    if "/" in arguments.what:
        card = environment_card(arguments.what)
        print(card_text(arguments.what, card))
        found: Mapping[str, Any] = {arguments.what: card}
    else:
        known = names()
        if arguments.what and arguments.what not in known:
            raise UsageError(f"no kind {arguments.what!r}; known ones: {', '.join(known)}, or the id of an environment")
        found = {kind: known[kind] for kind in ([arguments.what] if arguments.what else known)}
        print("\n\n".join(table(kind, rows) for kind, rows in found.items()))
    if arguments.json is not None:
        write_json(arguments.json, found)


def names() -> dict[str, dict[str, str]]:
    """Names of each kind, with their meaning."""
    import gymnasium as gym

    import clutter_env
    from assets import robot, robot_names
    from clutter_env.policies.registry import BUILT_IN
    from clutter_env.scene.layout import LAYOUTS

    ids = [name for name in gym.registry if name.startswith("clutter_env/")]
    suites = {name: clutter_env.suite(name) for name in clutter_env.suite_names()}
    return {
        "environments": {name: f"at most {_spec(name).max_episode_steps} steps; {_actors(name)}" for name in ids},
        "suites": {name: f"{len(one.test)} test scenes; {one.about}" for name, one in suites.items()},
        "layouts": {name: _layout_in_words(layout) for name, layout in LAYOUTS.items()},
        "robots": {name: _robot_in_words(robot(name)) for name in robot_names()},
        "policies": dict.fromkeys(BUILT_IN, "the script of its environment") | _POLICIES | _with_all_grasps(),
    }


_POLICIES = {
    "lookahead": "the expert: a task and motion planner that plans all moves ahead",
    "ngr": "Lee & Kim 2019: clearance outside the Negative Goal Region",
    "dogar": "Dogar & Srinivasa 2011: clearance, one object at a time",
    "srivastava": "Srivastava et al. 2014: clearance to random places",
    "canonical": "the expert, with plans that depend on the present scene alone, for imitation",
    "keyframes": "learned in two levels, with the weights of the package",
    "keyframes-all": "the same, from all grasps",
    "keyframes-shelf": "the same, in the shelf",
    "end-to-end": "learned by one network that points at objects and gives whole-body keyframes",
    "greedy": "skills: the target, or the nearest object while that fails",
    "direct-approach": "drives at the target and closes the gripper",
    "random": "uniform actions",
    "random-skills": "uniform skills",
}
"""Descriptions of policies by name. Policies without one are the scripts of single environments."""


def _with_all_grasps() -> dict[str, str]:
    from clutter_env.policies.experts import PLANNERS

    return {name: f"{name.removesuffix('-all')}, from all grasps" for name in PLANNERS if name.endswith("-all")}


def environment_card(env_id: str) -> dict[str, Any]:
    """Facts about an environment that a learner needs.

    Raises:
        UnknownTask: no such environment. The message lists the known environments.
    """
    import gymnasium as gym

    from clutter_env.config import CONTROL_HZ
    from clutter_env.policies.experts import expert_names
    from clutter_env.task import Task

    with closing(Task(env_id).make()) as env:
        inner: Any = env.unwrapped
        space, config = env.observation_space, getattr(inner, "physics_env", inner).config
        parts = space.spaces if isinstance(space, gym.spaces.Dict) else {"observation": space}
        return {
            "task": " ".join((type(inner).__doc__ or "").split("\n\n")[0].split()),
            "step limit": _spec(env_id).max_episode_steps,
            "steps per second": CONTROL_HZ,
            "action": _space_in_words(env.action_space),
            "observation": {name: _space_in_words(part) for name, part in parts.items()},
            "control": config.control_mode,
            "reward": config.reward_mode,
            "robot": getattr(config.robot, "name", config.robot),
            "layout": getattr(config.layout, "name", config.layout),
            "objects": config.num_objects,
            "experts": list(expert_names(env_id)),
        }


def card_text(env_id: str, card: Mapping[str, Any]) -> str:
    """The same for a terminal."""
    lines = [env_id, ""]
    for key, value in card.items():
        if isinstance(value, Mapping):
            lines += [f"{key}:", *(f"  {name:24} {space}" for name, space in value.items())]
        else:
            lines.append(f"{key}: {', '.join(value) if isinstance(value, list) else value}")
    return "\n".join(lines)


def table(kind: str, rows: Mapping[str, str]) -> str:
    """A heading, and a line for each name."""
    width = max(map(len, rows), default=0) + 2
    return "\n".join((f"{kind}:", *(f"  {name:{width}}{about}".rstrip() for name, about in rows.items())))


def _spec(env_id: str) -> Any:
    import gymnasium as gym

    return gym.spec(env_id)


def _actors(env_id: str) -> str:
    """Experts that solve it without training."""
    from clutter_env.policies.experts import expert_names

    found = expert_names(env_id)
    return f"expert {found[0]}" if found else "acted in by skills"


def _space_in_words(space: Any) -> str:
    """Shape, kind and limits. The limits are given only if all numbers share them."""
    import gymnasium as gym

    if not isinstance(space, gym.spaces.Box):
        return str(space)
    low, high = float(space.low.min()), float(space.high.max())
    is_uniform = bool((space.low == low).all() and (space.high == high).all())
    return f"{space.shape} {space.dtype}" + (f", from {low:g} to {high:g}" if is_uniform else "")


def _layout_in_words(layout: Any) -> str:
    shelves = sum(h is not None for h in (layout.board_height, layout.second_board_height, layout.third_board_height))
    size = f"table {layout.depth:g} m deep, {layout.width:g} m wide"
    above = [f"{shelves} {'shelves' if shelves > 1 else 'shelf'} above it"] if shelves else []
    return ", ".join((size, *above, *([f"opens: {layout.opens}"] if layout.opens else [])))


def _robot_in_words(spec: Any) -> str:
    return f"{spec.base_drive} base, {1 + len(spec.idle_arms)} arm{'s' if spec.idle_arms else ''}"
