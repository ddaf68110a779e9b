"""The page of a clearance table: the tables of `clutter-env table`, what they say, and plots.

    python scripts/clearance_page.py --objects 15 20 25 30 35 40 --scenes 40 --time-limit 60 --page docs/table.md

All arguments of `clutter-env table` are known; trials that are in --out are not made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from clutter_env.cli import table_arguments
from clutter_env.cli.clearance_picture import draw
from clutter_env.cli.clearance_tables import Summary, markdown, summarise
from clutter_env.cli.clearance_trials import Trials
from clutter_env.cli.main import command_line


@dataclass(frozen=True)
class Arguments(table_arguments.Arguments):
    """Those of `clutter-env table`, and where the page is written."""

    page: Path = Path("outputs/clearance_table/page.md")
    """File of the page; its picture is written to images/ beside it."""


def main(arguments: tyro.conf.OmitArgPrefixes[Arguments]) -> None:
    """Make the trials that are missing, and write the page."""
    trials = Trials(arguments)
    trials.run()
    command = command_line("python scripts/clearance_page.py", arguments, ("workers", "out", "json", "page"))
    write_page(trials, command, summarise(trials), arguments.page)


def write_page(trials: Trials, command: str, summary: Summary, page: Path) -> None:
    """Write the Markdown page, and its picture to images/ beside it."""
    picture = page.parent / "images" / f"{page.stem}.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(summary).savefig(picture, dpi=130)
    arguments = trials.arguments
    kind = f'in physics, "{arguments.control_mode}" mode' if arguments.physics else "plans only"
    put = f" Objects may be put on: {' '.join(arguments.supports)}." if arguments.supports else ""
    which = ", whose target no level grasp reaches at once" if arguments.obstructed else ""
    page.write_text(
        f"# Clearance table ({kind})\n\n```sh\n{command}\n```\n\n"
        f"Robot {arguments.robot!r}, layout {arguments.layout!r}, grasp set {arguments.grasps!r}: plans and lower "
        f"bounds are for these grasps.{put} Each strategy is tried on the same scenes: resets of the environment, from "
        f"seed {arguments.seed} on{which}. Success rates have Wilson's 95% interval, all other means a 95% bootstrap "
        "interval over the scenes. The lower bound is the fewest objects that any plan must clear; *p* is of McNemar's "
        f"exact test that a strategy solves as many scenes as {next(iter(trials.variants))}.\n\n"
        f"![Clearance table]({picture.relative_to(page.parent)})\n\n{markdown(summary, arguments.physics)}"
    )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
