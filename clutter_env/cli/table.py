"""Table 1 of Lee & Kim 2019 and more: strategies on scenes whose target is obstructed, planned or in physics.

    clutter-env table --objects 15 40 --strategies lookahead ngr --scenes 100
    clutter-env table --layout shelf --objects 10 --strategies lookahead --grasps all --no-obstructed

The scenes are resets of the environment from --seed on. Every trial is written to a file as soon as it ends: run the
same command again after an interruption. JSON and Markdown tables and a picture are written to the output directory.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from clutter_env.cli.main import command_line
from clutter_env.cli.table_arguments import Arguments

if TYPE_CHECKING:
    from clutter_env.cli.clearance_trials import Variant

WHEN_INTERRUPTED = "run the same command again to go on"


def run(arguments: Arguments, more: Mapping[str, Variant] | None = None, name: str = "clutter-env table") -> None:
    """Find the scenes, try the strategies and `more` rows, and report. `name` is the command shown on the page."""
    from clutter_env.cli.clearance_picture import draw
    from clutter_env.cli.clearance_tables import markdown, summarise
    from clutter_env.cli.clearance_trials import Trials
    from clutter_env.reporting.files import write_json

    trials = Trials(arguments, more)
    trials.run()
    summary = summarise(trials)
    tables = markdown(summary, arguments.physics)
    print(f"\n{tables}")
    for path in filter(None, (arguments.out / "table.json", arguments.json)):
        write_json(path, {"settings": trials.settings, **summary})
    command = command_line(name, arguments, ("workers", "out", "json"))
    (arguments.out / "table.md").write_text(f"```sh\n{command}\n```\n\n{tables}")
    draw(summary).savefig(arguments.out / "table.png", dpi=130)
    print(f"tables and figures: {arguments.out}")
    if crashed := sum(entry["crashed"] for entry in (*summary["rows"], *summary["scenes"])):
        print(f"{crashed} trials CRASHED; their tracebacks are in {arguments.out / 'trials.jsonl'}")
