"""The house in numbers: size, complexity and words of packages, beside those of other projects.

    python scripts/house.py
    python scripts/house.py irm planners mink stable_baselines3 gymnasium
    python scripts/house.py --pages docs README.md
    python scripts/house.py --marks planners/clearing docs/goals.md

A package is a folder, or the name of an installed one. `--marks` prints the sentences behind the counts of words. These
point at what readers stumble over. A sentence without a mark is not good for that reason alone.
"""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, NamedTuple, TypeGuard

import tyro

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("assets", "irm", "planners", "clutter_env")
COMPLEXITY = (12, 15, 20)
"""Limits that functions are counted above, by ruff's count of branches (McCabe)."""
PARAMETERS = 8
LONG = 25
"""Words of a sentence from which on it counts as long."""

PATTERNS = {
    "question first": r"^(What|Where|How|Why|Who|Which|When)\b",
    "semicolon": r";",
    "anew": r"\banew\b",
    "but for": r"\bbut for\b",
    "none to": r"\bnone to\b",
    "is looked": r"\b(is|are) (looked|asked) ",
    "what of what": r"\bwhat\b[^.;:]*\bwhat\b",
    "of those": r"\bof (those|these) (that|which)\b",
    "two negations": r"\b(not|no|nothing|never|none|neither)\b[^.;:,]*\b(not|no|nothing|never|none|without|unless)\b",
}
"""What readers stumbled over; matched in sentences, without regard to case but for the first one."""

ITEM = r"^\s*(?:[-*]|\d+\.) +"
"""The mark before an item of a list."""


class Sentence(NamedTuple):
    """A sentence, and where its docstring or paragraph begins."""

    file: Path
    line: int
    text: str
    is_first: bool


@dataclass(frozen=True)
class Arguments:
    """Print the table."""

    packages: tyro.conf.Positional[tuple[str, ...]] = PACKAGES
    """Folders, files, or names of installed packages."""
    pages: Annotated[bool, tyro.conf.arg(help="Count the words of Markdown pages in place of code.")] = False
    marks: Annotated[bool, tyro.conf.arg(help="Print each sentence that a pattern finds.")] = False


def main(arguments: Arguments) -> None:
    """Print a column for each package, or the sentences behind the counts."""
    if arguments.marks:
        for name in arguments.packages:
            for sentence, pattern in marked(sentences(files_of(name))):
                print(f"{sentence.file}:{sentence.line}: {pattern}: {sentence.text}")
        return
    rows = [
        words(files_of(name)) if arguments.pages else {**size(name), **words(files_of(name))}
        for name in arguments.packages
    ]
    print("| |", " | ".join(arguments.packages), "|")
    print("|---|" + "---|" * len(rows))
    for key in rows[0]:
        print(f"| {key} |", " | ".join(f"{row[key]:,}" for row in rows), "|")


def files_of(name: str) -> list[Path]:
    """Python files, and Markdown pages, of a folder, a file or an installed package.

    Raises:
        SystemExit: neither.
    """
    path = ROOT / name
    if not path.exists():
        found = importlib.util.find_spec(name)
        if found is None or not found.submodule_search_locations:
            sys.exit(f"{name} is no folder of this project, and no package that is installed")
        path = Path(next(iter(found.submodule_search_locations)))
    if path.is_file():
        return [path]
    return sorted(file for file in path.rglob("*") if file.suffix in (".py", ".md") and "test" not in file.parts)


def size(name: str) -> dict[str, float]:
    """Lines of each kind, and what is large."""
    files = [file for file in files_of(name) if file.suffix == ".py"]
    count = Counter[str]()
    functions: list[ast.FunctionDef | ast.AsyncFunctionDef] = []
    for file in files:
        tree, text = ast.parse(file.read_text()), file.read_text()
        count["lines"] += text.count("\n")
        count["comments"] += sum(kind == tokenize.COMMENT for kind in kinds_of_tokens(file))
        docstrings = [node for node in ast.walk(tree) if is_docstring(node)]
        count["docstrings"] += sum((node.end_lineno or 0) - node.lineno + 1 for node in docstrings)
        functions += [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
        count["and, or"] += sum(isinstance(node, ast.BoolOp) for node in ast.walk(tree))
        count["comprehensions"] += sum(
            isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp) for node in ast.walk(tree)
        )
        count["tuple assignments"] += sum(
            isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple) for node in ast.walk(tree)
        )
    lengths = [(node.end_lineno or 0) - node.lineno + 1 for node in functions]
    many = [len(node.args.args) + len(node.args.kwonlyargs) > PARAMETERS for node in functions]
    thousands = count["lines"] / 1000
    complexity = complexities(files)
    return {
        "files": len(files),
        "lines": count["lines"],
        "lines of docstrings": count["docstrings"],
        "functions": len(functions),
        "lines of a function, median": median(lengths),
        "lines of the longest function": max(lengths),
        **{f"functions of more than {limit} branches": sum(one > limit for one in complexity) for limit in COMPLEXITY},
        f"functions of more than {PARAMETERS} parameters": sum(many),
        **{
            f"{kind}, per 1,000 lines": round(count[kind] / thousands, 1)
            for kind in ("comments", "comprehensions", "and, or", "tuple assignments")
        },
    }


def complexities(files: list[Path]) -> list[int]:
    """Branches of the functions that have more than the least limit, as ruff counts them."""
    rule = [
        "--isolated",
        "--ignore-noqa",
        "--select",
        "C901",
        "--config",
        f"lint.mccabe.max-complexity={min(COMPLEXITY)}",
    ]
    command = [sys.executable, "-m", "ruff", "check", *rule, "--output-format", "concise", *map(str, files)]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [int(number) for number in re.findall(r"too complex \((\d+) >", said)]


def words(files: list[Path]) -> dict[str, float]:
    """Words of docstrings or pages, and how often each pattern is found in 1,000 of them."""
    found = list(sentences(files))
    total = sum(len(sentence.text.split()) for sentence in found)
    count = Counter(pattern for _, pattern in marked(found))
    per = 1000 / max(total, 1)
    patterns = {f"{pattern}, per 1,000 words": round(count[pattern] * per, 2) for pattern in (*PATTERNS, "long")}
    return {"words": total, **patterns, "all marks, per 1,000 words": round(count.total() * per, 2)}


def marked(found: Iterator[Sentence] | list[Sentence]) -> Iterator[tuple[Sentence, str]]:
    """Sentences in which a pattern is found, with its name; one that is long is marked so."""
    for sentence in found:
        for name, pattern in PATTERNS.items():
            if name == "question first" and not sentence.is_first:
                continue
            if re.search(pattern, sentence.text, 0 if name == "question first" else re.IGNORECASE):
                yield sentence, name
        if len(sentence.text.split()) > LONG:
            yield sentence, "long"


def sentences(files: list[Path]) -> Iterator[Sentence]:
    """Sentences of docstrings in Python files, and of the prose of pages; code and tables are left out."""
    for file in files:
        texts = prose_of_page(file) if file.suffix == ".md" else docstrings_of(file)
        for line, text in texts:
            for item in re.split(ITEM, text, flags=re.MULTILINE):
                parts = re.split(r"(?<=[.!?])\s+(?=[A-Z`(])", " ".join(item.split()))
                yield from (Sentence(file, line, part, at == 0) for at, part in enumerate(parts) if part)


def docstrings_of(file: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each paragraph of the docstrings of a Python file."""
    for node in ast.walk(ast.parse(file.read_text())):
        if is_docstring(node):
            text = ast.literal_eval(node.value)
            for paragraph in re.split(r"\n\s*\n|\n\s*(?=[\w, ]+: )", text):
                yield node.lineno, paragraph


def prose_of_page(file: Path) -> Iterator[tuple[int, str]]:
    """Line and text of each paragraph of a page, without code, tables, headings and links' targets."""
    text = re.sub(r"```.*?```", lambda found: "\n" * found.group().count("\n"), file.read_text(), flags=re.DOTALL)
    line = 1
    for paragraph in re.split(r"(\n\s*\n)", text):
        if paragraph.strip() and not paragraph.lstrip().startswith(("|", "#", "<", "!")):
            yield line, re.sub(r"\]\([^)]*\)", "]", paragraph)
        line += paragraph.count("\n")


def is_docstring(node: ast.AST) -> TypeGuard[ast.Expr]:
    """Whether a node is a string that stands for itself: a docstring, or one below a constant."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def kinds_of_tokens(file: Path) -> Iterator[int]:
    """The kinds of the tokens of a file."""
    with tokenize.open(file) as stream:
        yield from (token.type for token in tokenize.generate_tokens(stream.readline))


if __name__ == "__main__":
    main(tyro.cli(Arguments))
