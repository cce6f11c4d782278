"""Rules and labelled frames in; what the person is told at once, out: a word, a colour, a tone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.files.toml import read_toml
from asterism.live.analysis import NOTHING, FrameAnalysis
from asterism.live.chain import LabelledFrame
from asterism.live.cues import Cue, FeedbackRule
from asterism.recording import Floats, canonical

_MARKERS = {"angle": 3, "distance": 2, "height": 1}
"""What can be told, and of how many markers it is."""
_SOUNDS = ("", "beep", "tone")
_COLOURS = ("", "green", "amber", "red", "blue")
_KEYS = {"name", "angle", "distance", "height", "above", "below", "hysteresis", "text", "colour", "sound", "low", "high"}


def load_feedback(path: Path) -> tuple[FeedbackRule, ...]:
    """The rules of a TOML file, one table [[rule]] each.

    Raises AsterismError where the file is damaged or a rule is none: which file, which rule, what is wrong.
    """
    tables = read_toml(path).get("rule")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise AsterismError(f"{path} has no rule; write a table [[rule]] for each, with a name, and an angle, a distance or a height.")
    return tuple(_rule(table, f"{path}, rule {number}") for number, table in enumerate(tables, start=1))


def _rule(table: Mapping[str, Any], where: str) -> FeedbackRule:
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise AsterismError(f"{where}: {unknown[0]} is unknown; it takes {', '.join(sorted(_KEYS))}.")
    kinds = [kind for kind in _MARKERS if kind in table]
    if len(kinds) != 1:
        raise AsterismError(f"{where}: give one of angle (three markers), distance (two) and height (one).")
    kind, given = kinds[0], table[kinds[0]]
    markers = [given] if isinstance(given, str) else given
    if not isinstance(markers, list) or len(markers) != _MARKERS[kind] or not all(isinstance(name, str) and name for name in markers):
        example = ["LTHI", "LKNE", "LANK"][: _MARKERS[kind]]
        raise AsterismError(f"{where}: {kind} needs {_MARKERS[kind]} marker names, as in {kind} = {example}.")
    numbers = {key: table.get(key, 0.0 if key == "hysteresis" else math.nan) for key in ("above", "below", "hysteresis", "low", "high")}
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isinf(value):
            raise AsterismError(f"{where}: {key} is {value!r}, no number.")
    words = {key: table.get(key, "") for key in ("name", "text", "colour", "sound")}
    for key, choices in {"sound": _SOUNDS, "colour": _COLOURS}.items():
        if words[key] not in choices:
            raise AsterismError(f"{where}: {key} is {words[key]!r}; it is one of {', '.join(choices[1:])}.")
    if not all(isinstance(word, str) for word in words.values()):
        raise AsterismError(f"{where}: name and text are words in quotes.")
    if numbers["hysteresis"] < 0:
        raise AsterismError(f"{where}: hysteresis is below 0.")
    if words["sound"] == "tone" and not numbers["low"] < numbers["high"]:
        raise AsterismError(f"{where}: a tone needs low and high, the values of its lowest and highest pitch, as in low = 80.")
    if math.isnan(numbers["above"]) and math.isnan(numbers["below"]):
        raise AsterismError(f"{where}: it needs above or below, the value at which the person is told.")
    words["name"] = words["name"] or f"{kind} of {', '.join(markers)}"
    return FeedbackRule(kind=kind, markers=tuple(markers), **numbers, **words)


@dataclass
class Feedback:
    """Rules over the frames of a session.

    rules    as loaded
    up       (3,) what points up
    A marker without a label says nothing: the rule keeps silent, and begins anew when the marker is back. O(rules) a frame.
    """

    rules: Sequence[FeedbackRule]
    up: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    _on: dict[int, bool] = field(default_factory=dict)
    _columns: dict[tuple[str, ...], dict[str, int]] = field(default_factory=dict)

    def judge(self, frame: LabelledFrame, analysis: FrameAnalysis = NOTHING) -> tuple[Cue, ...]:
        """What each rule says of a frame and of what follows from it."""
        return tuple(self._cue(number, rule, self._value(rule, frame)) for number, rule in enumerate(self.rules))

    def missing(self, markers: Sequence[str]) -> list[str]:
        """Names of the rules that a marker set does not have."""
        there = {canonical(name) for name in markers}
        return sorted({name for rule in self.rules for name in rule.markers if canonical(name) not in there})

    def _value(self, rule: FeedbackRule, frame: LabelledFrame) -> float:
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

    def _cue(self, number: int, rule: FeedbackRule, value: float) -> Cue:
        was = self._on.get(number, False)
        # What is told goes on until the value is back by the hysteresis.
        give = rule.hysteresis if was else 0.0
        on = value > rule.above - give or value < rule.below + give
        self._on[number] = on
        tone = math.nan
        if rule.sound == "tone" and on:
            tone = min(1.0, max(0.0, (value - rule.low) / (rule.high - rule.low)))
        return Cue(rule, value, on, on and not was, tone)
