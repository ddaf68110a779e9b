"""An independent judge of plans: it reads the PDDL texts themselves and shares no code with the planners.

Knows just the PDDL that the domain uses: and, not, forall, typed variables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import product

Tree = str | list["Tree"]
Fact = tuple[str, ...]


def parse(text: str) -> Tree:
    """The first expression of a PDDL text as nested lists."""
    tokens = re.findall(r"[()]|[^\s()]+", re.sub(r";[^\n]*", "", text))
    stack: list[list[Tree]] = [[]]
    for token in tokens:
        if token == "(":
            stack.append([])
        elif token == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    return stack[0][0]


def section(tree: Tree, key: str) -> list[Tree]:
    """The body of the part of a definition that starts with `key`."""
    return next(part[1:] for part in tree if isinstance(part, list) and part[0] == key)


def typed(items: Iterable[Tree]) -> Iterator[tuple[str, str]]:
    """(name, type) of a list such as `a b - t c - u`."""
    names: list[str] = []
    words = iter(items)
    for word in words:
        if word == "-":
            kind = next(words)
            yield from ((name, str(kind)) for name in names)
            names = []
        else:
            names.append(str(word))


class Judge:
    """The state of one problem, changed by ground actions."""

    def __init__(self, domain: str, problem: str) -> None:
        domain_tree, problem_tree = parse(domain), parse(problem)
        parents = dict(typed(section(domain_tree, ":types")))
        self.kinds: dict[str, set[str]] = {}
        for name, kind in typed(section(problem_tree, ":objects")):
            self.kinds[name] = {kind, "object"}
            while kind in parents:
                kind = parents[kind]
                self.kinds[name].add(kind)
        self.actions = {part[1]: part for part in domain_tree if isinstance(part, list) and part[0] == ":action"}
        self.facts: set[Fact] = {tuple(fact) for fact in section(problem_tree, ":init")}
        self.goal = section(problem_tree, ":goal")[0]

    def apply(self, name: str, arguments: tuple[str, ...]) -> str:
        """Apply a ground action; "" or what is wrong with it."""
        part = self.actions.get(name)
        if part is None:
            return f"no action {name}"
        body = dict(zip(part[2::2], part[3::2], strict=True))
        parameters = list(typed(body[":parameters"]))
        if len(parameters) != len(arguments):
            return f"{name} takes {len(parameters)} arguments"
        for (_, kind), argument in zip(parameters, arguments, strict=True):
            if kind not in self.kinds.get(argument, set()):
                return f"{argument} is no {kind}"
        bound = {variable: argument for (variable, _), argument in zip(parameters, arguments, strict=True)}
        if not self.holds(body[":precondition"], bound):
            return f"precondition of {name}{arguments} does not hold"
        effects = list(self.effects(body[":effect"], bound))
        self.facts -= {fact for positive, fact in effects if not positive}
        self.facts |= {fact for positive, fact in effects if positive}
        return ""

    def holds(self, condition: Tree, bound: dict[str, str]) -> bool:
        match condition:
            case ["and", *parts]:
                return all(self.holds(part, bound) for part in parts)
            case ["not", part]:
                return not self.holds(part, bound)
            case ["forall", variables, part]:
                return all(self.holds(part, bound | more) for more in self.bindings(variables))
        return tuple(bound.get(word, word) for word in condition) in self.facts

    def effects(self, effect: Tree, bound: dict[str, str]) -> Iterator[tuple[bool, Fact]]:
        match effect:
            case ["and", *parts]:
                for part in parts:
                    yield from self.effects(part, bound)
            case ["not", fact]:
                yield False, tuple(bound.get(word, word) for word in fact)
            case ["forall", variables, part]:
                for more in self.bindings(variables):
                    yield from self.effects(part, bound | more)
            case fact:
                yield True, tuple(bound.get(word, word) for word in fact)

    def bindings(self, variables: list[Tree]) -> Iterator[dict[str, str]]:
        names = list(typed(variables))
        domains = [[name for name, kinds in self.kinds.items() if kind in kinds] for _, kind in names]
        for values in product(*domains):
            yield {name: value for (name, _), value in zip(names, values, strict=True)}


def fault(domain: str, problem: str, plan: Iterable[tuple[str, tuple[str, ...]]]) -> str:
    """ "" if the plan solves the problem, otherwise what is wrong with it."""
    judge = Judge(domain, problem)
    for name, arguments in plan:
        wrong = judge.apply(name, arguments)
        if wrong:
            return wrong
    return "" if judge.holds(judge.goal, {}) else "the goal is not reached"
