"""PDDL conditions as text: words and lists, and the alternatives of `or`, `not`, `forall` and `exists`.

The meaning of facts is not known here. A literal is the list of words of one fact, negated or not.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias, TypeVar

from planners.regions import GoalError

_T = TypeVar("_T")
Tree: TypeAlias = "str | list[Tree]"
WORD = r'[^\s()";]+'
"""Characters of a word without quotation marks."""
_MOST = 512
"""Most alternatives of a condition, and most facts of each."""
_CONNECTIVES = ("and", "or", "not", "imply", "forall", "exists")


class Quoted(str):
    """A word in quotation marks: always a name, even if it begins like a variable."""

    __slots__ = ()


class Literal(NamedTuple):
    """A fact or a negated fact.

    Attributes:
        tree: words of the fact, and lists of numbers.
        is_negated: whether the fact is under a `not`.
    """

    tree: Tree
    is_negated: bool


@dataclass(frozen=True)
class Condition:
    """A PDDL condition.

    Attributes:
        text: text as given.
        tree: words of the text, and lists of words.
        domain: the names that a variable of each type ranges over. None if unknown.
        choices: connectives with several alternatives, in the order of the text.
    """

    text: str
    tree: Tree
    domain: Mapping[str, Collection[str]] | None = None
    choices: list[str] = field(default_factory=list)

    def alternatives(self) -> list[tuple[Literal, ...]]:
        """Expand the condition into alternative sets of literals: all literals of any one set must hold.

        A set that contains another one is left out.

        Raises:
            GoalError: a variable with an unknown range, an unknown type, or too many alternatives.
        """
        try:
            found = self._expanded(self.tree, False, {})
        except RecursionError:
            raise self.refused("nested", "deeper than can be read; write its facts in one (and …)") from None
        sets = [frozenset(one) for one in dict.fromkeys(found)]
        unlike = [one for one, own in zip(dict.fromkeys(found), sets, strict=True) if not any(s < own for s in sets)]
        return list({frozenset(one): one for one in unlike}.values())

    def refused(self, word: str, why: str) -> GoalError:
        """Error that names a word of the text and gives advice."""
        return GoalError(f"{word!r} in {self.text!r:.200}: {why}")

    def _expanded(self, tree: Tree, is_negated: bool, names: Mapping[str, str]) -> list[tuple[Literal, ...]]:
        """Alternatives of a part, with these names for its variables."""
        word = tree[0].lower() if isinstance(tree, list) and tree and isinstance(tree[0], str) else ""
        match tree:
            case [_, part] if word in (":goal", "not"):
                return self._expanded(part, is_negated ^ (word == "not"), names)
            case [_, *_] if word in ("and", "or"):
                return self._joined(word, _flat(tree, word), is_negated, names)
            case [_, one, other] if word == "imply":
                return self._joined("imply", [["not", one], other], is_negated, names)
            case [_, list() as variables, part] if word in ("forall", "exists"):
                found: list[tuple[Tree, Mapping[str, str]]] = [
                    (part, {**names, **values}) for values in self._values(word, variables)
                ]
                is_and = (word == "forall") != is_negated
                each = [self._expanded(part, is_negated, inner) for part, inner in found]
                return self._all_of(word, each) if is_and else self._any_of(word, each)
            case [_, str() as one, str() as other] if word == "=":
                is_same = _value(one, names).casefold() == _value(other, names).casefold()
                return [()] if is_same != is_negated else []
            case [_, *_] if word in _CONNECTIVES:
                raise self.refused(word, f"it is not written as PDDL has it: {shown(tree):.100}")
        return [(Literal(_with_values(tree, names), is_negated),)]

    def _joined(
        self, word: str, parts: list[Tree], is_negated: bool, names: Mapping[str, str]
    ) -> list[tuple[Literal, ...]]:
        each = [self._expanded(part, is_negated, names) for part in parts]
        return self._all_of(word, each) if (word == "and") != is_negated else self._any_of(word, each)

    def _all_of(self, word: str, each: list[list[tuple[Literal, ...]]]) -> list[tuple[Literal, ...]]:
        """Combine one alternative of each part, in all combinations."""
        found: list[tuple[Literal, ...]] = [()]
        for alternatives in each:
            pairs = itertools.product(found, alternatives)
            found = [tuple(dict.fromkeys((*one, *other))) for one, other in self._few(word, pairs)]
        return found

    def _any_of(self, word: str, each: list[list[tuple[Literal, ...]]]) -> list[tuple[Literal, ...]]:
        found = list(dict.fromkeys(self._few(word, itertools.chain.from_iterable(each))))
        if len(found) != 1:
            self.choices.append(word)
        return found

    def _few(self, word: str, found: Iterable[_T]) -> list[_T]:
        few = list(itertools.islice(found, _MOST + 1))
        if len(few) > _MOST:
            raise self.refused(word, f"more than {_MOST} alternatives; plan for each of them")
        return few

    def _values(self, word: str, variables: list[Tree]) -> Iterator[dict[str, str]]:
        """Values of the variables of a quantifier, in all combinations."""
        types: dict[str, list[str]] = {}
        waiting: list[str] = []
        rest = list(variables)
        while rest:
            match rest.pop(0):
                case "-" if rest and waiting:
                    kind = rest.pop(0)
                    kinds = kind[1:] if isinstance(kind, list) and kind[:1] == ["either"] else [kind]
                    types |= {name: [str(one).lower() for one in kinds] for name in waiting}
                    waiting = []
                case str(name) if name.startswith("?") and not isinstance(name, Quoted):
                    waiting.append(name.lower())
                case other:
                    raise self.refused(word, f"{shown(other):.100} is no variable; one is written ?x, or ?x - object")
        types |= {name: ["object"] for name in waiting}
        if self.domain is None:
            advice = "write one fact for each object" if word == "forall" else "name the object that it is to be"
            why = f"a scene says what there is; read the text with it, Goal.of(text, scene), or {advice}"
            raise self.refused(word, why)
        for kind in itertools.chain.from_iterable(types.values()):
            if kind not in self.domain:
                raise self.refused(word, f"{kind!r} is no type; valid are {', '.join(self.domain)}")
        ranges = [dict.fromkeys(name for kind in kinds for name in self.domain[kind]) for kinds in types.values()]
        for values in self._few(word, itertools.product(*ranges)):
            yield dict(zip(types, map(Quoted, values), strict=True))


def _flat(tree: Tree, word: str) -> list[Tree]:
    """Parts of a conjunction or disjunction, with nested ones of the same kind flattened."""
    found: list[Tree] = []
    left: list[Tree] = [tree]
    while left:
        part = left.pop()
        match part:
            case [str(kind), *parts] if kind.lower() == word:
                left += reversed(parts)
            case [str(kind), inner] if kind.lower() == ":goal":
                left.append(inner)
            case _:
                found.append(part)
    return found


def _value(word: str, names: Mapping[str, str]) -> str:
    return word if isinstance(word, Quoted) else names.get(word.lower(), word)


def _with_values(tree: Tree, names: Mapping[str, str]) -> Tree:
    """A fact with names in place of its variables, hashable."""
    if not isinstance(tree, list):
        return _value(tree, names)
    return _Words(_with_values(part, names) for part in tree)


class _Words(list[Tree]):
    """A list of words that can be compared and hashed."""

    def __hash__(self) -> int:  # type: ignore[override]  # it is not changed once it is made
        return hash(tuple(self))


def parse(text: str) -> Tree:
    """Expression of a text: words, and lists of words. Raises `GoalError`."""
    if not isinstance(text, str):
        raise GoalError(f"{text!r:.100} is no text")
    outer: list[Tree] = []
    open_lists = [outer]
    for word in re.findall(rf'"[^"]*"|[()"]|{WORD}', re.sub(r'("[^"]*")|;.*', r"\1", text)):
        if word == "(":
            inner: list[Tree] = []
            open_lists[-1].append(inner)
            open_lists.append(inner)
        elif word == ")" and len(open_lists) > 1:
            open_lists.pop()
        elif word in '()"':
            raise GoalError(f"{text!r:.200} is no goal: parentheses do not match")
        else:
            open_lists[-1].append(Quoted(word[1:-1]) if word[0] == '"' else word)
    match outer:
        case [[_, *_] as tree] if len(open_lists) == 1:
            return tree
    raise GoalError(f"{text!r:.200} is no goal: parentheses do not match, or it is empty")


def shown(tree: Tree) -> str:
    """The expression as text, without its deeper levels."""
    if not isinstance(tree, list):
        return str(tree)
    return f"({' '.join('(…)' if isinstance(part, list) else str(part) for part in tree)})"
