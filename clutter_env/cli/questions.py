"""Questions about rendered scenes, with proved answers, for models that see images and answer in words.

    clutter-env questions make --scenes 100 --out outputs/questions
    clutter-env questions score outputs/questions --answers answers.jsonl
    clutter-env questions score outputs/questions --baselines commonest colour place random nearest-first shadow

`make` writes questions.jsonl, with images and segmentation masks, and scenes.jsonl, which says where everything stands.
An answer is a line {"id": ..., "answer": ...}: true or false, a number, or a list of names. See
docs/guides/questions.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro


@dataclass(frozen=True)
class Make:
    """Draw scenes, and ask about them."""

    scenes: int = 100
    """Number of scenes."""
    objects: int = 6
    """Objects in a scene."""
    image_size: int = 256
    """Pixels along each side of an image, 0 for no images."""
    first_seed: int = 20_000_000
    """Seed of the first scene."""
    out: Path = Path("outputs/questions")
    """Directory of the files."""


@dataclass(frozen=True)
class Score:
    """Score answers, or simple rules."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The directory that `make` wrote."""
    answers: Path | None = None
    """Answers, one a line."""
    baselines: tuple[str, ...] = ()
    """Rules: commonest, colour, place, random, nearest-first, shadow."""
    seed: int = 0
    """Random seed of the random rule."""
    json: Path | None = None
    """Write the scores to this file."""


Arguments: TypeAlias = Make | Score


def run(arguments: Arguments) -> None:
    """Run the chosen subcommand."""
    if isinstance(arguments, Make):
        _make(arguments)
    else:
        _score(arguments)


def _make(arguments: Make) -> None:
    from clutter_env.errors import check_integer
    from clutter_env.evaluation.question_files import write_questions
    from clutter_env.reporting.progress import progress_bar

    check_integer("scenes", arguments.scenes, 1)
    check_integer("objects", arguments.objects, 2)
    with progress_bar(total=arguments.scenes, unit="scene") as bar:
        count = write_questions(
            arguments.out,
            arguments.objects,
            arguments.scenes,
            arguments.first_seed,
            arguments.image_size,
            bar.update,
        )
    print(f"{count} questions about {arguments.scenes} scenes: {arguments.out}")


def _score(arguments: Score) -> None:
    from clutter_env.errors import UsageError, check_choice
    from clutter_env.evaluation.question_files import QUESTIONS, SCENES, read_lines
    from clutter_env.evaluation.question_scores import BASELINES, answered, scored
    from clutter_env.reporting.files import write_json
    from clutter_env.reporting.tables import NOTHING, markdown_table

    if arguments.answers is None and not arguments.baselines:
        raise UsageError("name --answers, or --baselines")
    for rule in arguments.baselines:
        check_choice("baselines", rule, BASELINES, UsageError)
    questions = read_lines(arguments.folder / QUESTIONS, ("id", "kind", "about", "scene", "answer", "choices"))
    found = {}
    if arguments.answers is not None:
        given = {line["id"]: line["answer"] for line in read_lines(arguments.answers, ("id", "answer"))}
        found[arguments.answers.name] = scored(questions, given)
    if arguments.baselines:
        scenes = read_lines(arguments.folder / SCENES, ("scene", "objects"))
        for rule in arguments.baselines:
            found[rule] = scored(questions, answered(rule, questions, scenes, arguments.seed))
    kinds = list(dict.fromkeys(kind for one in found.values() for kind in one))
    rows = [[name, *(str(one[kind]) if kind in one else NOTHING for kind in kinds)] for name, one in found.items()]
    print(markdown_table(["answers", *kinds], rows))
    if arguments.json is not None:
        write_json(arguments.json, found)
