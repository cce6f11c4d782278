"""A TOML file, or the name of a shipped one, in; what the events of a movement are, out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from asterism.errors import AsterismError
from asterism.files.toml import read_toml, tables_of_toml

UNITS = {"along": "m", "distance": "m", "speed": "m/s", "bend": "deg", "lean": "deg", "turn": "deg", "spin": "deg/s"}
"""What a signal can be, and its unit."""
_POINTS = {"along": 1, "distance": 2, "speed": 1, "bend": 3, "lean": 2, "turn": 2, "spin": 2}
_DIRECTIONS = ("up", "ahead")
_FINDS = ("maximum", "minimum", "rising", "falling")
_WHICH = ("every", "first", "last", "largest")


@dataclass(frozen=True)
class Amount:
    """A value in the signal's unit, or a share of its range."""

    value: float
    of_range: bool = False


@dataclass(frozen=True)
class SignalRule:
    """A curve over time.

    kind       "along": m, the place of a marker along a direction, "up", or "ahead", the way along which it moves most on the floor;
               "distance": m between two; "speed": m/s of one; "bend": deg by which three are off a straight line; "lean": deg of the line
               from one to another off the vertical; "turn": deg of it about the vertical; "spin": deg/s at which it turns in space
    markers    one to three names of the table `markers`
    relative   of "along", the marker whose place is taken off; "" for none
    side       "L" or "R", for "{side}" in names of markers where the movement as a whole has no sides
    """

    name: str
    kind: str
    markers: tuple[str, ...]
    direction: str = "up"
    relative: str = ""
    side: str = ""

    @property
    def unit(self) -> str:
        """See `UNITS`."""
        return UNITS[self.kind]


@dataclass(frozen=True)
class EventRule:
    """When something happens.

    find           "maximum" or "minimum" of the signal, or it crosses `level`, "rising" or "falling"
    prominence     of an extremum: by how much the signal comes back on both sides, at least; of several amounts the largest counts
    after, before  earlier rules: the next such moment behind each of their events, or the last one before; "" for none
    which          without these: "every", "first", "last", or the one with the "largest" prominence
    """

    name: str
    signal: str
    find: str
    level: Amount = Amount(0.0)
    prominence: tuple[Amount, ...] = (Amount(0.1, of_range=True),)
    after: str = ""
    before: str = ""
    which: str = "every"


@dataclass(frozen=True)
class PhaseRule:
    """From each event of one rule to the next of another."""

    name: str
    begin: str
    end: str


@dataclass(frozen=True)
class SequenceRule:
    """Which of some signals has its maximum first in a phase, which next."""

    name: str
    phase: str
    signals: tuple[str, ...]


@dataclass(frozen=True)
class MovementRules:
    """The events of a movement.

    markers  name -> labels that may be it, the first one worn counts; "A+B" is the middle of two, "{side}" stands for each side
    cut_off  Hz of the low-pass filter of markers
    sides    "L" and "R" where each side has the events for itself; empty where there are none
    """

    title: str
    markers: Mapping[str, tuple[str, ...]]
    signals: tuple[SignalRule, ...]
    events: tuple[EventRule, ...]
    phases: tuple[PhaseRule, ...] = ()
    sequences: tuple[SequenceRule, ...] = ()
    cut_off: float = 6.0
    sides: tuple[str, ...] = ()
    about: str = ""

    @classmethod
    def load(cls, source: str | Path) -> MovementRules:
        """Shipped rules by name ("squat"), or those of a TOML file. Raises AsterismError where these are none.

        >>> [event.name for event in MovementRules.load("golf-swing").events]
        ['Impact', 'Top', 'Takeaway', 'Finish']
        """
        if str(source) in shipped_movements():
            text = resources.files("asterism").joinpath("movements", f"{source}.toml").read_text(encoding="utf-8")
            return cls.from_tables(tables_of_toml(text), str(source))
        path = Path(source)
        if not path.is_file():
            raise AsterismError(
                f"{source} is neither a shipped movement nor a TOML file that exists; shipped ones are {', '.join(shipped_movements())}."
            )
        return cls.from_tables(read_toml(path), str(path))

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any], origin: str) -> MovementRules:
        """Rules from the tables of a TOML file, which `origin` names in messages. Raises AsterismError where something is no rule."""
        read = _Reader(origin)
        read.only(tables, {"title", "about", "cut_off", "sides", "markers", "signals", "events", "phases", "sequences"}, "the file")
        markers = {
            str(name): tuple(read.texts(value, f"markers.{name}")) for name, value in read.table(tables.get("markers"), "markers").items()
        }
        sides = tuple(read.texts(tables.get("sides", []), "sides"))
        if set(sides) - {"L", "R"}:
            raise read.wrong("sides", 'sides are "L" and "R"')
        signals = tuple(read.signal(name, value, markers, sides) for name, value in read.table(tables.get("signals"), "signals").items())
        events: list[EventRule] = []
        for number, value in enumerate(read.tables(tables.get("events"), "events")):
            events.append(read.event(value, f"events, number {number + 1}", signals, events))
        if not events:
            raise read.wrong("events", "a movement has one event or more")
        names = [event.name for event in events]
        phases = tuple(read.phase(value, names) for value in read.tables(tables.get("phases", []), "phases"))
        sequences = tuple(read.sequence(value, phases, signals) for value in read.tables(tables.get("sequences", []), "sequences"))
        cut_off = read.number(tables.get("cut_off", 6.0), "cut_off")
        if not cut_off > 0:
            raise read.wrong("cut_off", "it is a frequency in Hz, more than 0")
        title, about = (read.text(tables.get(name, ""), name) for name in ("title", "about"))
        return cls(title or Path(origin).stem, markers, signals, tuple(events), phases, sequences, cut_off, sides, about)


def shipped_movements() -> tuple[str, ...]:
    """Names of the movements whose rules come with Asterism.

    >>> shipped_movements()
    ('golf-swing', 'lifting', 'pedalling', 'squat')
    """
    folder = resources.files("asterism").joinpath("movements")
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@dataclass(frozen=True)
class _Reader:
    """Reads tables of a file, and says what in them is no rule."""

    origin: str

    def wrong(self, where: str, what: str) -> AsterismError:
        return AsterismError(f"{self.origin}, {where}: {what}; see docs/motion.md, or the shipped rules.")

    def only(self, table: Mapping[str, Any], known: set[str], where: str) -> None:
        # A word that is misspelt would be passed over, and the rule would be another one.
        for name in table:
            if name not in known:
                raise self.wrong(where, f"{name} is no key here; keys are {', '.join(sorted(known))}")

    def table(self, value: Any, where: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping) or not value:
            raise self.wrong(where, "a table with one entry or more is needed")
        return value

    def tables(self, value: Any, where: str) -> Sequence[Mapping[str, Any]]:
        if not isinstance(value, list) or not all(isinstance(one, Mapping) for one in value):
            raise self.wrong(where, f"a list of tables, each headed [[{where}]], is needed")
        return value

    def text(self, value: Any, where: str) -> str:
        if not isinstance(value, str):
            raise self.wrong(where, "a text is needed")
        return value

    def texts(self, value: Any, where: str) -> list[str]:
        if not isinstance(value, list) or not all(isinstance(one, str) and one.strip() for one in value):
            raise self.wrong(where, "a list of names is needed")
        return value

    def number(self, value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong(where, "a number is needed")
        return float(value)

    def amount(self, value: Any, where: str) -> Amount:
        if isinstance(value, str) and (match := re.fullmatch(r"\s*(-?\d+(?:\.\d+)?)\s*%\s*", value)):
            return Amount(float(match[1]) / 100.0, of_range=True)
        if isinstance(value, str):
            raise self.wrong(where, f'{value!r} is neither a number nor a share of the range, such as "40 %"')
        return Amount(self.number(value, where))

    def one_of(self, value: Any, choices: Sequence[str], where: str) -> str:
        if value not in choices:
            raise self.wrong(where, f"{value!r} is not one of {', '.join(choices) or 'those before it, of which there are none'}")
        return str(value)

    def signal(self, name: str, value: Any, markers: Mapping[str, Any], sides: Sequence[str]) -> SignalRule:
        where = f"signals.{name}"
        table = self.table(value, where)
        kind = next((one for one in UNITS if one in table), None)
        if kind is None:
            raise self.wrong(where, f"one of {', '.join(UNITS)} says what the signal is")
        self.only(table, {kind, "side", *(("of", "relative") if kind == "along" else ())}, where)
        given = table.get("of") if kind == "along" else table[kind]
        names = (given,) if isinstance(given, str) else tuple(self.texts(given, where))
        if len(names) != _POINTS[kind]:
            raise self.wrong(where, f"{kind} is of {_POINTS[kind]} markers, and {len(names)} are given")
        direction = self.one_of(table[kind], _DIRECTIONS, where) if kind == "along" else "up"
        relative = self.text(table.get("relative", ""), where)
        every = (*names, relative) if relative else names
        for one in every:
            self.one_of(one, list(markers), where)
        side = self.text(table.get("side", ""), where)
        # "{side}" must stand for something.
        if side not in ("", "L", "R") or (side and sides):
            raise self.wrong(where, 'side is "L" or "R", in movements that have no sides themselves')
        if not side and not sides and any("{side}" in label for one in every for label in markers[one]):
            raise self.wrong(where, "its markers have a {side}, and neither the signal nor the movement says which")
        return SignalRule(name, kind, names, direction, relative, side)

    def event(self, table: Mapping[str, Any], where: str, signals: Sequence[SignalRule], before: Sequence[EventRule]) -> EventRule:
        self.only(table, {"name", "signal", "find", "level", "prominence", "after", "before", "which"}, where)
        name, earlier = self.text(table.get("name", ""), where), [event.name for event in before]
        if not name or name in earlier:
            raise self.wrong(where, f"{name!r} is no name of its own")
        signal = self.one_of(table.get("signal"), [one.name for one in signals], f"{where}, signal")
        find = self.one_of(table.get("find"), _FINDS, f"{where}, find")
        crossing = find in ("rising", "falling")
        if crossing != ("level" in table) or (crossing and "prominence" in table):
            raise self.wrong(where, "rising and falling cross a level, and have one; maximum and minimum have a prominence")
        level = self.amount(table.get("level", 0.0), f"{where}, level")
        given = table.get("prominence", "10 %")
        prominence = tuple(self.amount(one, f"{where}, prominence") for one in (given if isinstance(given, list) else [given]))
        anchors = {key: self.one_of(table[key], earlier, f"{where}, {key}") for key in ("after", "before") if key in table}
        which = self.one_of(table.get("which", "every"), _WHICH, f"{where}, which")
        if anchors and which not in ("every", "largest"):
            raise self.wrong(where, "with after or before it is the nearest one, or the largest")
        return EventRule(name, signal, find, level, prominence, anchors.get("after", ""), anchors.get("before", ""), which)

    def phase(self, table: Mapping[str, Any], events: Sequence[str]) -> PhaseRule:
        self.only(table, {"name", "from", "to"}, "phases")
        name = self.text(table.get("name", ""), "phases")
        begin, end = (self.one_of(table.get(key), events, f"phases, {name or 'one without a name'}, {key}") for key in ("from", "to"))
        return PhaseRule(name or f"{begin} to {end}", begin, end)

    def sequence(self, table: Mapping[str, Any], phases: Sequence[PhaseRule], signals: Sequence[SignalRule]) -> SequenceRule:
        self.only(table, {"name", "phase", "signals"}, "sequences")
        name = self.text(table.get("name", "sequence"), "sequences")
        phase = self.one_of(table.get("phase"), [one.name for one in phases], f"sequences, {name}, phase")
        names = self.texts(table.get("signals"), f"sequences, {name}, signals")
        return SequenceRule(name, phase, tuple(self.one_of(one, [own.name for own in signals], f"sequences, {name}") for one in names))
