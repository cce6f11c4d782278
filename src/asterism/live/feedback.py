"""Rules and labelled frames in; what the person is told at once, out: a word, a colour, a tone."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.files.toml import read_toml
from asterism.findings import Finding, Severity
from asterism.live.analysis import EVENTS, NOTHING, FrameAnalysis
from asterism.live.chain import LabelledFrame
from asterism.live.cues import Cue, FeedbackRule
from asterism.live.measures import Change, LiveSymmetry, Repetitions
from asterism.live.walking.steps import LiveSteps
from asterism.recording import Floats, canonical
from asterism.recording.display import listed

_MARKERS = {"angle": 3, "distance": 2, "height": 1}
"""What can be told of markers, and of how many it is."""
_KINDS = (*_MARKERS, "value", "symmetry", "event")
_CHOICES = {
    "sound": ("beep", "tone"),
    "colour": ("green", "amber", "red", "blue"),
    "side": ("left", "right"),
    "each": ("highest", "lowest", "range", "tempo"),
    "change": ("start", "before"),
}
_ONLY_OF = {"side": "event", "every": "event", "last": "symmetry"}
"""Keys that only one kind of rule takes."""
_WORDS = ("name", "text", *_CHOICES)
_COUNTS = {"every": 1, "last": 5}
"""Keys with a whole number, and what it is where nobody says. Five steps: single ones vary by 2 to 3 %, so that the mean of five is known
to 1 %. Half of them shows each step's chance; twice as many tell a change 10 s late."""
_NUMBERS = ("above", "below", "hysteresis", "low", "high", "swing", "over", "after", "hold")
_NOT_BELOW_0 = ("hysteresis", "after", "hold", "swing", "over")
_KEYS = {*_KINDS, *_WORDS, *_COUNTS, *_NUMBERS}
_LONGEST_OVER = 60.0
"""s that a change looks back at most: all of its values are kept. Half of it is a walk down a corridor; twice as much only takes memory."""
_MOMENT = 1.0
"""s for which an event or a repetition is told where the rule does not say: a glance. With half of it a word is missed; with twice as much
it runs into the next repetition."""
_FORGET = 1.0
"""s without the value, or of a clock that was set, after which repetitions, steps and changes begin anew: within a hidden second a body
turns. With half of it each lost marker breaks a slow repetition; with twice as much turns are made up across gaps."""
_BLINK = 0.25
"""s without the value after which a rule that is told begins anew. A marker that loses its label for some frames does not beep twice; with
half of it, it does; with twice as much a person hears nothing of a bound that they passed again."""
_SETTLED = 5.0
"""s after the first labels at which all values are there: angles are found from one to three seconds that show the person. Half of it calls
values of a fitted skeleton unknown that are about to come; with twice as much a person waits ten seconds for a word that is misspelt."""
_WRITE_RULES = f"write a table [[rule]] for each, with what it tells of: {', '.join(_KINDS[:-1])} or {_KINDS[-1]}"


def example_names() -> list[str]:
    """The examples of rules that come with Asterism."""
    folder = resources.files("asterism").joinpath("live", "examples")
    return sorted(file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml"))


def load_feedback(given: str | Path) -> tuple[FeedbackRule, ...]:
    """The rules of a TOML file, one table [[rule]] each; or of an example that comes with Asterism, by its name.

    Raises AsterismError where there is no such file or example, it is damaged or a rule is none: which file, which rule, what is wrong.
    """
    path = Path(given)
    if not path.exists() and path.suffix != ".toml":
        if str(given) not in example_names():
            raise AsterismError(f"{given} is no file and no example; give a TOML file, or one of {', '.join(example_names())}.")
        with resources.as_file(resources.files("asterism").joinpath("live", "examples", f"{given}.toml")) as shipped:
            return load_feedback(shipped)
    if path.is_file() and not path.stat().st_size:
        raise AsterismError(f"{path} is empty; {_WRITE_RULES}.")
    tables = read_toml(path).get("rule")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise AsterismError(f"{path} has no rule; {_WRITE_RULES}.")
    rules = tuple(_rule(table, f"{path}, rule {number}") for number, table in enumerate(tables, start=1))
    names = [rule.name for rule in rules]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise AsterismError(f'{path}: two rules are called "{twice}"; give each its own name.')
    return rules


def _rule(table: Mapping[str, Any], where: str) -> FeedbackRule:
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise AsterismError(f"{where}: {unknown[0]} is unknown; it takes {', '.join(sorted(_KEYS))}.")
    kinds = [kind for kind in _KINDS if kind in table]
    if len(kinds) != 1:
        raise AsterismError(f"{where}: give one of {', '.join(_KINDS)}.")
    kind = kinds[0]
    for key, only in _ONLY_OF.items():
        if key in table and kind != only:
            raise AsterismError(f"{where}: {key} goes with {only}, not with {kind}.")
    content = {"kind": kind, **_subject(kind, table[kind], where), **_words(table, where), **_numbers(table, where)}
    content["name"] = content["name"] or f"{kind} of {', '.join(content['markers']) or content['of']}"
    rule = FeedbackRule(**content)
    _check(rule, where)
    # An instant is shown for a while.
    return rule if rule.hold or not rule.is_moment else replace(rule, hold=_MOMENT)


def _subject(kind: str, given: Any, where: str) -> dict[str, Any]:
    """What a rule is about: the markers, or the name of a value or an event."""
    if kind in _MARKERS:
        markers = [given] if isinstance(given, str) else given
        if not isinstance(markers, list) or len(markers) != _MARKERS[kind] or not all(isinstance(name, str) and name for name in markers):
            example = ["LTHI", "LKNE", "LANK"][: _MARKERS[kind]]
            raise AsterismError(f"{where}: {kind} needs {_MARKERS[kind]} marker names, as in {kind} = {example}.")
        if len(set(map(canonical, markers))) < len(markers):
            raise AsterismError(f"{where}: {kind} is of {_MARKERS[kind]} different markers, and {listed(markers)} names one of them twice.")
        return {"markers": tuple(markers), "of": ""}
    examples = {"value": "left knee flexion", "symmetry": "step time", "event": "heel strike"}
    if not isinstance(given, str) or not given.strip():
        raise AsterismError(f'{where}: {kind} needs a name, as in {kind} = "{examples[kind]}".')
    name = " ".join(given.lower().split())
    if kind == "event" and name not in EVENTS:
        raise AsterismError(f"{where}: the event is {given!r}; it is one of {', '.join(EVENTS)}.")
    if kind == "symmetry" and name.split()[0] in ("left", "right"):
        raise AsterismError(
            f"{where}: a symmetry is of both sides; leave out {name.split()[0]}, as in symmetry = {name.split(' ', 1)[-1]!r}."
        )
    return {"markers": (), "of": name}


def _words(table: Mapping[str, Any], where: str) -> dict[str, str]:
    words = {key: table.get(key, "") for key in _WORDS}
    for key, choices in _CHOICES.items():
        if words[key] not in ("", *choices):
            raise AsterismError(f"{where}: {key} is {words[key]!r}; it is one of {', '.join(choices)}.")
    if not all(isinstance(word, str) for word in words.values()):
        raise AsterismError(f"{where}: name and text are words in quotes.")
    unknown = re.search(r"\{.*?\}", words["text"].replace("{value}", ""))
    if unknown:
        raise AsterismError(f'{where}: text has {unknown[0]}; it takes {{value}} alone, as in text = "knee at {{value}}".')
    return words


def _numbers(table: Mapping[str, Any], where: str) -> dict[str, float]:
    nothing = {"hysteresis": 0.0, "after": 0.0, "hold": 0.0}
    numbers = {key: table.get(key, nothing.get(key, math.nan)) for key in _NUMBERS}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or (key in table and not math.isfinite(value)):
            raise AsterismError(f"{where}: {key} is {value!r}, no number.")
        if key in _NOT_BELOW_0 and value < 0:
            raise AsterismError(f"{where}: {key} is below 0.")
    for key, usual in _COUNTS.items():
        numbers[key] = table.get(key, usual)
        if isinstance(numbers[key], bool) or not isinstance(numbers[key], int) or not 1 <= numbers[key] <= 1000:
            raise AsterismError(f"{where}: {key} is {numbers[key]!r}; it is a whole number from 1 to 1000.")
    return numbers


def _check(rule: FeedbackRule, where: str) -> None:
    """What goes together. Raises AsterismError where it does not."""
    if rule.each and (rule.kind == "event" or (rule.kind == "symmetry" and rule.each == "tempo")):
        raise AsterismError(f"{where}: {rule.kind} goes with no {rule.each} of repetitions; leave out each.")
    if rule.each and not rule.swing > 0:
        raise AsterismError(
            f"{where}: {rule.each} of each repetition needs swing, how far the value goes from turn to turn, as in swing = 20."
        )
    if rule.change and not 0 < rule.over <= _LONGEST_OVER:
        raise AsterismError(f"{where}: a change needs over, the seconds it is compared with, up to {_LONGEST_OVER:g}, as in over = 5.0.")
    for key, needs in {"swing": "each", "over": "change"}.items():
        if not math.isnan(getattr(rule, key)) and not getattr(rule, needs):
            raise AsterismError(f"{where}: {key} goes with {needs}; give that, too, or leave it out.")
    if rule.sound == "tone" and not rule.low < rule.high:
        raise AsterismError(
            f"{where}: a tone needs low and high, the values of its lowest and highest pitch, low below high, as in low = 80."
        )
    given = [key for key in ("low", "high") if not math.isnan(getattr(rule, key))]
    if given and rule.sound != "tone":
        raise AsterismError(f'{where}: {given[0]} is of a tone; add sound = "tone", or leave it out.')
    lasting = "after" if rule.after else "hysteresis" if rule.hysteresis else ""
    if lasting and rule.is_moment:
        raise AsterismError(f"{where}: an event or a repetition does not last; leave out {lasting}.")
    if math.isnan(rule.above) and math.isnan(rule.below) and not rule.is_moment and rule.sound != "tone":
        raise AsterismError(f"{where}: it needs above or below, the value at which the person is told.")
    if rule.hysteresis and math.isnan(rule.above) and math.isnan(rule.below):
        raise AsterismError(f"{where}: hysteresis is how far a value goes back behind above or below; give one of them, or leave it out.")


class _RuleState:
    """What a rule remembers from frame to frame.

    frame, known  s, when the last frame was, and the last value
    since, until  s, from when on its condition holds, and until when it is told
    value         of the last event or repetition
    on            whether it is told
    count, event  events so far, and s, when the last one was
    """

    def __init__(self, rule: FeedbackRule) -> None:
        self.rule, self.frame, self.count = rule, math.nan, 0
        self.change = Change(rule.change, rule.over) if rule.change else None
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what was seen."""
        rule = self.rule
        self.known = self.since = self.value = self.event = math.nan
        self.until, self.on = -math.inf, False
        self.repetitions = {side: Repetitions(rule.each, rule.swing) for side in ("", "left", "right")} if rule.each else {}
        self.symmetry = LiveSymmetry(rule.last)
        # What a value was at the start stays true while a marker is hidden.
        if self.change is not None and not self.change.has_start:
            self.change = Change(rule.change, rule.over)


@dataclass
class Feedback:
    """Rules over the frames of a session.

    rules     as loaded
    up        (3,) what points up
    say       told a sentence for each rule that can never speak, since the session lacks a name of it, as soon as that is known
    problems  these sentences

    A marker without a label says nothing: the rule keeps silent, and begins anew when the marker is back. O(rules) a frame.
    """

    rules: Sequence[FeedbackRule]
    up: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    say: Callable[[str], None] = lambda sentence: None
    problems: list[str] = field(default_factory=list)
    _states: list[_RuleState] = field(init=False)
    _columns: dict[tuple[str, ...], dict[str, int]] = field(default_factory=dict)
    _names: tuple[tuple[str, ...], int] = ((), -1)
    _begin: float = math.nan

    def __post_init__(self) -> None:
        self._states = [_RuleState(rule) for rule in self.rules]

    def judge(self, frame: LabelledFrame, analysis: FrameAnalysis = NOTHING) -> tuple[Cue, ...]:
        """What each rule says of a frame and of what follows from it."""
        if frame.markers:
            self._look_once(frame, analysis)
        return tuple(self._cue(state, frame, analysis) for state in self._states)

    def missing(self, markers: Sequence[str]) -> list[str]:
        """Names of the rules that a marker set does not have."""
        there = {canonical(name) for name in markers}
        return sorted({name for rule in self.rules for name in rule.markers if canonical(name) not in there})

    def _look_once(self, frame: LabelledFrame, analysis: FrameAnalysis) -> None:
        """Look at the names when they are known, and again when there are others."""
        now = frame.frame.time
        if not self._begin <= now:
            self._begin = now
        # Where nobody analyses, no value comes any more.
        are_settled = analysis is NOTHING or now - self._begin > _SETTLED
        names = (frame.markers, len(analysis.values) if are_settled else -1)
        if names != self._names:
            self._names = names
            self.look_at(frame.markers, list(analysis.values) if are_settled else None)

    def look_at(self, markers: Sequence[str], values: Sequence[str] | None = None) -> None:
        """Find the rules that can never speak with these names, and say so. values: None while they are not known."""
        before, self.problems = self.problems, self._unknown(markers, values)
        for sentence in self.problems:
            if sentence not in before:
                self.say(sentence)

    def findings(self) -> list[Finding]:
        """A finding for each rule that could not speak."""
        mend = "Correct the name in the rules, or wear and choose a marker set that has it."
        # Each stands for itself: of findings that are of one place the last is told.
        return [
            Finding("live-rule-silent", Severity.WARNING, sentence.partition(" silent: ")[0], sentence, mend) for sentence in self.problems
        ]

    def _unknown(self, markers: Sequence[str], values: Sequence[str] | None) -> list[str]:
        lacking, rules = set(self.missing(markers)), dict[str, list[str]]()
        for rule in self.rules:
            absent = [name for name in rule.markers if name in lacking]
            known, what = list(markers), "the marker set has no"
            if values is not None and rule.kind in ("value", "symmetry"):
                wanted = [rule.of] if rule.kind == "value" else [f"{side} {rule.of}" for side in ("left", "right")]
                absent, known, what = [name for name in wanted if name not in values], list(values), "there is no value"
            if absent:
                near = difflib.get_close_matches(absent[0], known, n=3, cutoff=0.5)
                advice = f"; near are {', '.join(near)}" if near else ""
                if known and absent[0] in LiveSteps.units:
                    # No other name helps: all of them are there, or none.
                    advice = "; steps are found where the marker set has heels, toes and a pelvis"
                elif not rule.markers and all(name in LiveSteps.units for name in known):
                    advice = "; angles are not found in this session"
                rules.setdefault(f"{what} {' and no '.join(absent)}{advice}", []).append(f'"{rule.name}"')
        return [
            f"The rule{'s'[: len(names) > 1]} {listed(names)} {'are' if len(names) > 1 else 'is'} silent: {why}."
            for why, names in rules.items()
        ]

    def _cue(self, state: _RuleState, frame: LabelledFrame, analysis: FrameAnalysis) -> Cue:
        rule, now = state.rule, frame.frame.time
        # A clock that was set, or a long gap, makes all that was seen before worthless.
        if now < state.frame or now - state.known > _FORGET:
            state.begin_anew()
        state.frame = now
        value, is_new = self._value(state, frame, analysis)
        unit = rule.unit or ("" if rule.each == "tempo" else analysis.units.get(rule.of, ""))
        if state.change is not None and is_new:
            value = state.change.push(now, value)
        # Sides that cancel out have no symmetry, and JSON no infinity.
        value = value if math.isfinite(value) else math.nan
        if rule.is_moment:
            return self._moment(state, value, is_new, unit)
        # Back after a while, it is something new.
        if not now - state.known <= _BLINK:
            state.on, state.since = False, math.nan
        if math.isnan(value):
            return Cue(rule, value, False, False, math.nan, unit)
        state.known = now
        was = state.on
        # What is told goes on until the value is back by the hysteresis.
        if _passes(rule, value, rule.hysteresis if was else 0.0):
            state.since = now if math.isnan(state.since) else state.since
            state.on = was or now - state.since >= rule.after
        else:
            state.since = math.nan
            state.on = was and now < state.until
        began = state.on and not was
        if began:
            state.until = now + rule.hold
        return Cue(rule, value, state.on, began, _pitch(rule, value) if state.on else math.nan, unit)

    def _moment(self, state: _RuleState, value: float, is_new: bool, unit: str) -> Cue:
        """An event or a repetition: told anew each time, for a while."""
        rule, now = state.rule, state.frame
        began = is_new and _passes(rule, value, 0.0)
        if is_new:
            state.value, state.on = value, began
            state.until = now + rule.hold
        state.on = state.on and now < state.until
        return Cue(rule, state.value, state.on, began, _pitch(rule, state.value) if state.on else math.nan, unit)

    def _value(self, state: _RuleState, frame: LabelledFrame, analysis: FrameAnalysis) -> tuple[float, bool]:
        """The value of a rule with this frame, and whether it is another one than before."""
        rule = state.rule
        if rule.kind == "event":
            return self._event(state, analysis)
        if rule.kind == "symmetry":
            return self._symmetry(state, analysis)
        value = self._of_markers(rule, frame) if rule.markers else analysis.values.get(rule.of, math.nan)
        if not rule.each:
            return value, not math.isnan(value)
        return _repetition(state, "", value)

    def _event(self, state: _RuleState, analysis: FrameAnalysis) -> tuple[float, bool]:
        rule, value, is_new = state.rule, math.nan, False
        state.known = state.frame
        for event in analysis.events:
            if event.kind == rule.of and rule.side in ("", event.side):
                value, state.event = event.time - state.event, event.time
                is_new = is_new or state.count % rule.every == 0
                state.count += 1
        return value, is_new

    def _symmetry(self, state: _RuleState, analysis: FrameAnalysis) -> tuple[float, bool]:
        for side in ("left", "right"):
            value = analysis.values.get(f"{side} {state.rule.of}", math.nan)
            if not math.isnan(value):
                state.known = state.frame
            each = state.rule.each != ""
            state.symmetry.take(side, _repetition(state, side, value)[0] if each else value, is_held=not each)
        return state.symmetry.value, not math.isnan(state.symmetry.value)

    def _of_markers(self, rule: FeedbackRule, frame: LabelledFrame) -> float:
        columns = self._columns.get(frame.markers)
        if columns is None:
            columns = {canonical(name): column for column, name in enumerate(frame.markers)}
            self._columns = {frame.markers: columns}
        found = [columns.get(canonical(name), -1) for name in rule.markers]
        if min(found) < 0 or (frame.indices[found] < 0).any():
            return math.nan
        points = frame.frame.points[frame.indices[found]]
        if rule.kind == "height":
            return float(points[0] @ self.up)
        if rule.kind == "distance":
            return float(np.linalg.norm(points[0] - points[1]))
        one, other = points[0] - points[1], points[2] - points[1]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def _repetition(state: _RuleState, side: str, value: float) -> tuple[float, bool]:
    """What the repetition that ends with this value comes to, and whether one ends."""
    if math.isnan(value):
        return math.nan, False
    state.known = state.frame
    found = state.repetitions[side].push(state.frame, value)
    return found, not math.isnan(found)


def _passes(rule: FeedbackRule, value: float, give: float) -> bool:
    """Whether a value is told. give: by how much it may be back, in its unit."""
    above, below = value > rule.above - give, value < rule.below + give
    if math.isnan(rule.above) and math.isnan(rule.below):
        return rule.is_moment or not math.isnan(value)
    return above and below if rule.above < rule.below else above or below


def _pitch(rule: FeedbackRule, value: float) -> float:
    """In [0, 1], NaN where the rule has no tone."""
    return min(1.0, max(0.0, (value - rule.low) / (rule.high - rule.low))) if rule.sound == "tone" and not math.isnan(value) else math.nan
