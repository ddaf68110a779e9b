"""Goals as English sentences, by a grammar and no model: "Put the red can into the basket and close the drawer."

A sentence is made of clauses, joined by commas, "and" or "then", which say nothing of the order. A clause has a verb,
objects, and where they go. A name is said with blanks in place of underscores, or in quotation marks as it is. "it" and
"them" are what the clause before moved: "pick up the can and put it on the tray" is about where the can ends. What is
opened or closed is the last place that was named: "put the mug into the microwave and close it".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from planners.facts import (
    OPEN_SHARE,
    TOLERANCE,
    YAW_TOLERANCE,
    At,
    Before,
    Clear,
    Closed,
    Fact,
    Holding,
    Inside,
    On,
    Open,
    Turned,
)
from planners.regions import GoalError

_PUT = ("put", "place", "set", "move", "bring", "lay", "stack", "transfer", "drop")
_TAKE = ("pick up", "pick", "take", "grab", "grasp", "lift", "hold", "fetch", "get", "retrieve")
_ON = ("on top of", "onto", "on", "upon", "to")
_IN = ("inside of", "inside", "into", "in")
_SHUT = ("close", "shut")
_EMPTY = ("clear", "empty")
_TURN = ("turn", "rotate")
_VERBS = (*_PUT, *_TAKE, *_SHUT, *_EMPTY, *_TURN, "open")
_FILLERS = ("please", "first", "next", "finally", "also", "now")
"""Words before a clause that say nothing."""
_ARTICLES = ("the", "a", "an", "both")
_RESERVED = frozenset(
    re.findall(
        r"\w+",
        "the a an both on onto upon to into in inside and then from out of off at by before after within turned it "
        "them up down back not or but except unless without next between behind",
    )
)
"""Words of the grammar, and others that change what a clause says: a name with one is said in quotation marks."""
_PLAIN = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
_NUMBER = r"-?\d+(?:\.\d*)?(?:e-?\d+)?"
_BETWEEN = r"[\s,;]+"
"""Between the numbers of a point."""
_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_ANGLES = {"rad": 1.0, "radians": 1.0, "degrees": math.pi / 180, "°": math.pi / 180}
_UNITS = {**_LENGTHS, **_ANGLES}
VALID = (
    '"put the A on the B", "put the A into the B", "put the A at (x, y) m", "pick up the A", "clear the B", '
    '"open the D", "open the D by 50%", "close the D", "turn the K to 1.2 rad", "move the A before the B"'
)
"""The clauses, for messages."""


def sentence_of(facts: Sequence[Fact]) -> str:
    """The sentence that says some facts; `facts_of` reads it again, to the last digit.

    Example:
        >>> sentence_of([On("red_can", "tray"), Closed("drawer")])
        'Put the red can on the tray and close the drawer.'
    """
    clauses = [_clause(fact) for fact in facts]
    text = " and ".join((", ".join(clauses[:-1]), clauses[-1])) if len(clauses) > 1 else clauses[0]
    return f"{text[0].upper()}{text[1:]}."


def facts_of(sentence: str, names: Iterable[str] = ()) -> tuple[Fact, ...]:
    """The facts that a sentence says.

    Args:
        sentence: in English; see the module's text.
        names: of objects, supports, regions and what opens. With them a phrase is the name that it fits, without regard
            to capitals, articles, blanks and underscores; without them its words joined by underscores.

    Raises:
        GoalError: a clause that is none, or a phrase that fits no name, or several; the message lists what is valid.
    """
    reader = _Reader(_by_phrase(names))
    for clause in reader.clauses(sentence):
        reader.read(clause)
    return tuple(dict.fromkeys(reader.facts))


def _clause(fact: Fact) -> str:
    """A fact in words."""
    match fact:
        case Holding(name, None):
            return f"pick up {_said(name)}"
        case Holding(name, point, tolerance):
            within = "" if tolerance == TOLERANCE else f" within {tolerance!r} m"
            return f"hold {_said(name)} at {_tuple(point or ())} m{within}"
        case On(name, place):
            return f"put {_said(name)} on {_said(place)}"
        case Inside(name, region):
            return f"put {_said(name)} into {_said(region)}"
        case At():
            return _place(fact)
        case Clear(region):
            return f"clear {_said(region)}"
        case Before(first, second):
            return f"move {_said(first)} before {_said(second)}"
        case Open(name, share, None):
            return f"open {_said(name)}" + ("" if share == OPEN_SHARE else f" by {share!r} of its range")
        case Open(name, _, amount):
            return f"open {_said(name)} by {amount!r}"
        case Closed(name):
            return f"close {_said(name)}"
        case Turned(name, angle, tolerance):
            within = "" if tolerance == YAW_TOLERANCE else f" within {tolerance!r} rad"
            return f"turn {_said(name)} to {angle!r} rad{within}"
    raise GoalError(f"{fact!r:.100} has no sentence")


def _place(fact: At) -> str:
    point = (fact.x, fact.y) if fact.z is None else (fact.x, fact.y, fact.z)
    turn = "" if fact.yaw is None else f" turned to {fact.yaw!r} rad"
    within = "" if fact.tolerance == TOLERANCE else f" within {fact.tolerance!r} m"
    yaw_within = "" if fact.yaw_tolerance == YAW_TOLERANCE else f" within {fact.yaw_tolerance!r} rad"
    return f"put {_said(fact.object)} at {_tuple(point)} m{turn}{within}{yaw_within}"


def _tuple(numbers: Iterable[float]) -> str:
    return f"({', '.join(repr(one) for one in numbers)})"


def _said(name: str) -> str:
    """A name as words, or in quotation marks where the words would not be the name again."""
    if _PLAIN.fullmatch(name) and not _RESERVED & {*name.split("_")}:
        return f"the {name.replace('_', ' ')}"
    return f'"{name}"'


def _by_phrase(names: Iterable[str]) -> Mapping[str, list[str]]:
    """The names that each phrase fits."""
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        found.setdefault(_phrase(name), []).append(name)
    return found


def _phrase(text: str) -> str:
    words = re.sub(r"[_\s-]+", " ", text.lower()).split()
    while words and words[0] in _ARTICLES:
        words = words[1:]
    return " ".join(words)


@dataclass
class _Reader:
    """Reads clauses one after the other, and remembers what "it" is.

    Attributes:
        known: names, by the phrases that they fit.
        facts: that were read.
        last: what was moved last.
        places: what was named last as a place, or was opened or closed.
        opened: what was opened last, if no other place was named since.
    """

    known: Mapping[str, list[str]]
    facts: list[Fact] = field(default_factory=list)
    last: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    opened: list[str] = field(default_factory=list)
    _quoted: list[str] = field(default_factory=list)

    def clauses(self, sentence: str) -> list[str]:
        """The clauses; what follows a comma or "and" is one if it begins with a verb. Quoted names become `‹0›`."""
        if not isinstance(sentence, str):
            raise GoalError(f"{sentence!r:.100} is no sentence; valid are {VALID}")

        def hide(found: re.Match[str]) -> str:
            self._quoted.append(found[1])
            return f"‹{len(self._quoted) - 1}›"

        if "‹" in sentence:
            raise GoalError(f'{sentence!r:.100}: names in other quotation marks than "A" are not read')
        text = re.sub(r'"([^"]+)"', hide, sentence).strip().rstrip(".!")
        text = re.sub(r"\(([^)]*)\)", lambda found: f"({' '.join(re.split(_BETWEEN, found[1].strip()))})", text)
        parts = re.split(r"\s*(?:[,;]|\band\b|\bthen\b|\.\s)\s*", text)
        found: list[str] = []
        for part in filter(None, parts):
            if self._starts_clause(part) or not found:
                found.append(part)
            else:
                found[-1] += f" & {part}"
        if not found:
            raise GoalError(f"{sentence!r:.100} says nothing; valid are {VALID}")
        return found

    def _starts_clause(self, part: str) -> bool:
        words = [word for word in part.lower().split() if word not in _FILLERS]
        return bool(words) and any(" ".join(words).startswith(f"{verb} ") for verb in _VERBS)

    def read(self, clause: str) -> None:
        """Add the facts of a clause."""
        text = re.sub(rf"^(?:{_any(_FILLERS)}\s+)+", "", clause.strip(), flags=re.IGNORECASE)
        for pattern, made in _FORMS:
            if found := re.fullmatch(pattern, text, re.IGNORECASE):
                made(self, found)
                return
        raise GoalError(f"{self._shown(clause)!r:.150} is no clause of a goal; valid are {VALID}")

    def names(self, phrase: str) -> list[str]:
        """The names in a phrase, joined by "&"; what was moved last for "it"."""
        return self._or_it(phrase, self.last)

    def _or_it(self, phrase: str, meant: list[str]) -> list[str]:
        """The names in a phrase, joined by "&"; those that are meant for "it"."""
        if _phrase(phrase) in ("it", "them"):
            if not meant:
                raise GoalError(f"{phrase!r}: nothing was named before it that it could be")
            return meant
        return [self.name(part) for part in phrase.split("&")]

    def name(self, phrase: str) -> str:
        """The name that a phrase fits."""
        if quoted := re.fullmatch(r"\s*(?:the\s+)?‹(\d+)›\s*", phrase):
            return self._quoted[int(quoted[1])]
        said = _phrase(phrase)
        if not self.known:
            if not said or "‹" in said:
                raise GoalError(f"{self._shown(phrase)!r:.100} is no name")
            if words := [word for word in said.split() if word in _RESERVED or word == "&"]:
                known = f"has {' and '.join(dict.fromkeys(words))} in it"
                raise GoalError(f"{self._shown(said)!r:.100} {known}: a name with that is written in quotation marks")
            return said.replace(" ", "_")
        fits = self.known.get(said, [])
        if len(fits) != 1:
            every = ", ".join(name for names in self.known.values() for name in names)
            how = f"fits {' and '.join(fits)}: write the name in quotation marks" if fits else f"is none of {every}"
            raise GoalError(f"{said!r:.100} {how:.2000}")
        return fits[0]

    def _shown(self, text: str) -> str:
        for index, name in enumerate(self._quoted):
            text = text.replace(f"‹{index}›", f'"{name}"')
        return text.replace(" & ", " and ")

    def put(self, found: re.Match[str], make: Callable[[str, str], Fact]) -> None:
        """Add where objects go, in place of what was said of taking them."""
        is_it = _phrase(found["place"]) in ("it", "them")
        if is_it and len(self.opened) != 1:
            raise GoalError(f"{found['place']!r} is no place here, as nothing was just opened: name the place")
        place = self.opened[0] if is_it else self.name(found["place"])
        self._moved([make(name, place) for name in self.names(found["objects"])])
        if not is_it:
            self.places, self.opened = [place], []

    def _moved(self, facts: Sequence[On | Inside | At | Holding | Fact]) -> None:
        moved = [str(getattr(fact, "object", "")) for fact in facts]
        self.facts = [
            fact for fact in self.facts if not (type(fact) is Holding and fact.point is None and fact.object in moved)
        ]
        self.facts += facts
        self.last = moved

    def take(self, found: re.Match[str]) -> None:
        """Add that objects are held; where they are taken from must be a name."""
        if found["source"]:
            self.places, self.opened = [self.name(found["source"])], []
        self._moved([Holding(name) for name in self.names(found["objects"])])

    def place(self, found: re.Match[str]) -> None:
        """Add the pose of an object, or the point at which it is held."""
        numbers = found["point"].split()
        if wrong := [one for one in numbers if not re.fullmatch(_NUMBER, one)]:
            raise GoalError(f"{wrong[0]!r:.100} is no number; a place is (x, y) m or (x, y, z) m")
        point = [_length(one, found["unit"]) for one in numbers]
        (name,), within = self.names(found["objects"])[:1], _amounts(found["within"] or "")
        turn = _angle(found["turn"], found["turn_unit"]) if found["turn"] else None
        tolerance = within.get("m", TOLERANCE)
        if found["verb"].lower() == "hold":
            if len(point) != 3 or turn is not None:
                raise GoalError("what is held is at a point (x, y, z) m, without a turn")
            self._moved([Holding(name, (point[0], point[1], point[2]), tolerance)])
            return
        if len(point) not in (2, 3):
            raise GoalError(f"a place has two or three numbers, not {len(point)}: (x, y) m or (x, y, z) m")
        height = point[2] if len(point) == 3 else None
        self._moved([At(name, point[0], point[1], turn, height, tolerance, within.get("rad", YAW_TOLERANCE))])

    def order(self, found: re.Match[str]) -> None:
        """Add which of two objects is moved first."""
        self.facts.append(Before(self.name(found["first"]), self.name(found["second"])))

    def clear(self, found: re.Match[str]) -> None:
        """Add that nothing stands in some places."""
        self.places, self.opened = self._or_it(found["objects"], self.places), []
        self.facts += [Clear(name) for name in self.places]

    def shut(self, found: re.Match[str]) -> None:
        """Add that things are shut."""
        self.places, self.opened = self._or_it(found["objects"], self.places), []
        self.facts += [Closed(name) for name in self.places]

    def open(self, found: re.Match[str]) -> None:
        """Add that things are open, by a share or an amount."""
        self.places = self.opened = self._or_it(found["objects"], self.places)
        if not found["amount"]:
            self.facts += [Open(name) for name in self.places]
        elif found["unit"] in ("%", "of its range"):
            share = float(found["amount"]) / (100 if found["unit"] == "%" else 1)
            self.facts += [Open(name, share) for name in self.places]
        else:
            amount = float(found["amount"]) * _unit(found["unit"])
            self.facts += [Open(name, amount=amount) for name in self.places]

    def turn(self, found: re.Match[str]) -> None:
        """Add the angle of a knob."""
        within = _amounts(found["within"] or "")
        angle = _angle(found["amount"], found["unit"])
        self.facts.append(Turned(self.name(found["objects"]), angle, within.get("rad", YAW_TOLERANCE)))


def _unit(name: str | None) -> float:
    return _UNITS[name.lower()] if name else 1.0


def _length(number: str, unit: str | None) -> float:
    """A length [m]; without a unit it is in metres."""
    if unit and unit.lower() not in _LENGTHS:
        raise GoalError(f"{number} {unit} is no length; units: {', '.join(_LENGTHS)}")
    return float(number) * _unit(unit)


def _angle(number: str, unit: str | None) -> float:
    """An angle [rad]; its unit must be said, since a bare 90 would be fourteen turns."""
    if not unit or unit.lower() not in _ANGLES:
        raise GoalError(f"{number} {unit or ''}".strip() + f" is no angle; units: {', '.join(_ANGLES)}")
    return float(number) * _unit(unit)


def _amounts(text: str) -> dict[str, float]:
    """The tolerances of a text such as " within 0.01 m within 0.2 rad", by "m" and "rad"."""
    found: dict[str, float] = {}
    for number, unit in re.findall(rf"within ({_NUMBER}) ?({'|'.join(_UNITS)})", text, re.IGNORECASE):
        kind = "m" if unit.lower() in ("m", "cm", "mm") else "rad"
        found[kind] = float(number) * _unit(unit)
    return found


def _any(words: Iterable[str]) -> str:
    return "(?:" + "|".join(re.escape(word).replace(r"\ ", r"\s+") for word in words) + ")"


_UNIT = rf"\s*(?P<unit>{'|'.join(_UNITS)})?"
_WITHIN = rf"(?P<within>(?:\s+within\s+{_NUMBER}\s*(?:{'|'.join(_UNITS)}))*)"
_TURNED = rf"(?:\s+turned\s+(?:to|by)\s+(?P<turn>{_NUMBER})\s*(?P<turn_unit>{'|'.join(_UNITS)})?)?"
_FORMS: tuple[tuple[str, Callable[[_Reader, re.Match[str]], None]], ...] = (
    (rf"{_any(_PUT)}\s+(?P<first>.+?)\s+before\s+(?P<second>.+)", _Reader.order),
    (
        rf"(?P<verb>{_any((*_PUT, 'hold'))})\s+(?P<objects>[^&]+?)\s+(?:at|to)\s+\((?P<point>[^)]*)\)"
        rf"{_UNIT}{_TURNED}{_WITHIN}",
        _Reader.place,
    ),
    (
        rf"{_any(_PUT)}\s+(?P<objects>.+?)\s+{_any(_ON)}\s+(?P<place>[^&]+)",
        lambda reader, found: reader.put(found, On),
    ),
    (
        rf"{_any(_PUT)}\s+(?P<objects>.+?)\s+{_any(_IN)}\s+(?P<place>[^&]+)",
        lambda reader, found: reader.put(found, Inside),
    ),
    (rf"{_any(_TAKE)}\s+(?P<objects>.+?)(?:\s+(?:from|out\s+of)\s+(?P<source>[^&]+))?", _Reader.take),
    (rf"{_any(_SHUT)}\s+(?P<objects>.+)", _Reader.shut),
    (rf"{_any(_EMPTY)}\s+(?P<objects>.+)", _Reader.clear),
    (
        rf"open\s+(?P<objects>.+?)(?:\s+by\s+(?P<amount>{_NUMBER})\s*(?P<unit>%|of its range|{'|'.join(_UNITS)})?)?",
        _Reader.open,
    ),
    (rf"{_any(_TURN)}\s+(?P<objects>.+?)\s+to\s+(?P<amount>{_NUMBER}){_UNIT}{_WITHIN}", _Reader.turn),
)
"""The clauses, the first that fits counts, and what each adds."""
