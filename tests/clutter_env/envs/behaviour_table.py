"""What the judge says of cheats and of gentle behaviours, each followed by a lift of the target.

    python -m tests.clutter_env.envs.behaviour_table
    python -m tests.clutter_env.envs.behaviour_table --json-file behaviours.json --beside behaviours_before.json

The scripts are in `cheats.py` and `gentle.py`, beside this file.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import tyro

from clutter_env.envs.retrieve import RetrieveEnv
from clutter_env.reporting.tables import markdown_table
from tests.clutter_env.envs.cheats import CHEATS, SCENE, Cheat
from tests.clutter_env.envs.gentle import GENTLE

_SHOWN = ("furniture_force", "self_force", "total_slide", "total_path")


def main(json_file: Path | None = None, beside: Path | None = None) -> None:
    """Play all behaviours and print a table.

    Args:
        json_file: write what was found to this file too.
        beside: such a file of another version, shown beside.
    """
    found = {name: _seen(gentle.script, gentle.objects) for name, gentle in GENTLE.items()}
    for name, script in CHEATS.items():

        def then_lift(robot: Cheat, script: Any = script) -> dict[str, Any]:
            script(robot)
            return robot.take_target()

        found[name.replace("_", " ")] = _seen(then_lift, SCENE)
    if json_file is not None:
        json_file.write_text(json.dumps(found, indent=1))
    before = {} if beside is None else json.loads(beside.read_text())
    rows = [
        [
            "gentle" if number < len(GENTLE) else "cheat",
            name,
            *([_verdict(before[name])] if before else []),
            _verdict(info),
            *(f"{info[key]:.3g}" for key in _SHOWN),
        ]
        for number, (name, info) in enumerate(found.items())
    ]
    head = [
        "",
        "behaviour",
        *(["before"] if before else []),
        "clean",
        "N on furniture",
        "N on itself",
        "slide m",
        "path m",
    ]
    print(markdown_table(head, rows), end="")


def _seen(script: Any, objects: Any) -> dict[str, Any]:
    info = script(Cheat(RetrieveEnv(num_objects=4, control_mode="ee"), objects))
    return {key: value for key, value in info.items() if isinstance(value, bool | int | float)}


def _verdict(info: dict[str, Any]) -> str:
    return "yes" if info["is_success"] else "no" if info["lifted"] else "no, not lifted"


if __name__ == "__main__":
    tyro.cli(main)
