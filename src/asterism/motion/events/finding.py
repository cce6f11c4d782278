"""A recording and the rules of a movement in; events with their uncertainty, phases, extremes and the order of peaks out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from asterism.errors import AsterismError
from asterism.files.tables import NumberTable
from asterism.findings import Finding, Severity
from asterism.motion.events.rules import Amount, EventRule, MovementRules
from asterism.motion.events.signals import Key, Places, keys_of, places_of, signal_curve, way_ahead
from asterism.recording import Event, Floats, Recording

CONTEXTS = {"L": "Left", "R": "Right", "": "General"}
"""The side of an event, as C3D files name it."""
_DRAWS = 40
"""Recordings that are drawn for the uncertainty: a standard deviation of them is certain to 11 %. At half 16 %, at double 8 %."""
_SURE = 0.8
"""Of the draws, in which an event has to be found: else noise or the filter make it. At half, ripples pass; at 1, one odd draw suffices."""
_FILTERS = np.sqrt(2.0)
"""By which the cut-off is up to lower or higher in a draw: people choose 6 or 8 Hz for the same movement. At double, 6 or 12."""
_NEAR = 0.25
"""s, within which an event of a draw is the same one, or half of the way to the next, if that is less."""


@dataclass(frozen=True)
class MovementEvent:
    """An event by the name of its rule; side "L", "R" or ""; time s from the first frame; sigma s, its standard uncertainty."""

    name: str
    side: str
    time: float
    sigma: float


@dataclass(frozen=True)
class Extreme:
    """The smallest or largest value of a signal in a phase, when, and its standard uncertainty; kind "minimum" or "maximum"."""

    signal: str
    kind: str
    value: float
    sigma: float
    unit: str
    time: float


@dataclass(frozen=True)
class Phase:
    """A phase from event to event; number counts those of its name and side from 1."""

    name: str
    side: str
    number: int
    begin: MovementEvent
    end: MovementEvent
    extremes: tuple[Extreme, ...] = ()

    @property
    def duration(self) -> float:
        """s."""
        return self.end.time - self.begin.time

    @property
    def sigma(self) -> float:
        """s, standard uncertainty of the duration."""
        return float(np.hypot(self.begin.sigma, self.end.sigma))


@dataclass(frozen=True)
class SequencePeak:
    """When a signal is largest in a phase, as part of a sequence.

    place    1 for the first; same: of the draws, in which it has that place
    time     s from the first frame, sigma s
    """

    sequence: str
    side: str
    number: int
    signal: str
    place: int
    same: float
    time: float
    sigma: float
    value: float
    unit: str


@dataclass(frozen=True)
class FoundMovement:
    """What was found in a recording.

    signals   (T,) by name and side, in the rules' units, filtered; sigmas: their standard uncertainty in each frame
    """

    recording: Recording
    rules: MovementRules
    events: tuple[MovementEvent, ...]
    phases: tuple[Phase, ...]
    peaks: tuple[SequencePeak, ...]
    signals: Mapping[Key, Floats] = field(repr=False)
    sigmas: Mapping[Key, Floats] = field(repr=False)
    findings: tuple[Finding, ...] = ()

    def to_events(self) -> tuple[Event, ...]:
        """As a recording keeps them, on its file's clock."""
        start = float(self.recording.times[0])
        return tuple(Event(event.name, start + event.time, CONTEXTS[event.side]) for event in self.events)


def find_movement(recording: Recording, rules: MovementRules, markers: Mapping[str, str] | None = None, *, seed: int = 0) -> FoundMovement:
    """The events of a movement in a labelled recording.

    markers  names of the rules -> labels of the recording, where the rules do not know them

    Markers are filtered; extrema are the vertex of a parabola through three frames, crossings lie on the line between two. The uncertainty
    of times and values is that of recordings that are drawn: each marker with the noise that the filter takes off, and a cut-off that is
    up to a factor of 1.4 lower or higher. What four of five of them do not show is left out and told, and so is what falls into a gap.
    O(draws T). Raises AsterismError where none of the events has its markers.

    >>> from asterism.motion.events import MovementRules
    >>> times = np.arange(0, 3, 0.01)
    >>> foot = np.stack([np.cos(7 * times), 0 * times, np.sin(7 * times)], axis=1)
    >>> found = find_movement(Recording(foot[:, None], ("LTOE",), 100.0), MovementRules.load("pedalling"))
    >>> [(event.name, round(event.time, 2)) for event in found.events][:2]
    [('Bottom', 0.67), ('Top', 1.12)]
    """
    file = str(recording.metadata.get("file", "the recording"))
    places, sides = places_of(recording, rules, markers or {}), rules.sides or ("",)
    curves = _SignalSource.of(recording, rules, places, sides)
    missing = sorted({rule.name for rule in rules.events if not any((rule.signal, side) in curves.keys for side in sides)})
    if len(missing) == len(rules.events):
        raise AsterismError(
            f"{file} does not show what the events of {rules.title} are told by: no marker for {', '.join(places.missing)}; "
            "say which it is with --marker NAME=LABEL."
        )
    found: list[Finding] = []
    lost = sorted({signal.name for signal in rules.signals if not any((signal.name, side) in curves.keys for side in sides)})
    if lost:
        sentence = (
            f"{file} has no marker for {', '.join(places.missing)}, so that {', '.join(dict.fromkeys([*lost, *missing]))} are left out."
        )
        found.append(Finding("movement-markers", Severity.NOTE, file, sentence, "Say which labels they are with --marker NAME=LABEL."))
    signals = curves.signals(places.filtered)
    rng = np.random.default_rng(seed)
    factors = _FILTERS ** np.linspace(-1.0, 1.0, _DRAWS)
    draws = [curves.signals(places.drawn(rng, recording.rate, rules.cut_off * factor)) for factor in factors]
    sigmas = {key: np.sqrt(np.mean([(draw[key] - curve) ** 2 for draw in draws], axis=0)) for key, curve in signals.items()}
    events: list[MovementEvent] = []
    for side in sides:
        nominal, told = _found(rules, signals, side, recording.rate)
        again = [_found(rules, draw, side, recording.rate)[0] for draw in draws]
        for rule in rules.events:
            times = nominal.get(rule.name, [])
            for time in times:
                event, share = _with_sigma(rule.name, side, time, times, [draw.get(rule.name, []) for draw in again], recording.rate)
                at = f"{rule.name} at {time + float(recording.times[0]):.2f} s"
                if not _seen(curves.known[rule.signal, side], time * recording.rate):
                    found.append(
                        _left_out(file, at, "a marker that tells it is missing there", "Fill the gap first: asterism convert --fill auto.")
                    )
                elif share < _SURE:
                    why = f"noise or the filter make it: {100 * share:.0f} % of recordings like this one show it"
                    found.append(_left_out(file, at, why, "Look at the recording; another level or prominence may tell it."))
                else:
                    events.append(event)
        for rule, anchor in told:
            where = f"after {rule.after}" if rule.after else f"before {rule.before}"
            what = f"{rule.name} {where} at {anchor + float(recording.times[0]):.2f} s"
            found.append(_left_out(file, what, "the signal does not show it", "Give a longer part of the recording, if there is one."))
    events.sort(key=lambda event: event.time)
    if not events:
        sentence = f"{file} shows no event of {rules.title}."
        found.append(Finding("movement-none", Severity.WARNING, file, sentence, "Look whether it is this movement, and whole."))
    phases = _phases(rules, events, sides, curves, signals, sigmas, recording.rate)
    peaks = list(_peaks(rules, phases, signals, draws, curves, recording.rate))
    return FoundMovement(recording, rules, tuple(events), tuple(phases), tuple(peaks), signals, sigmas, tuple(found))


def _left_out(file: str, what: str, why: str, mend: str) -> Finding:
    return Finding("movement-left-out", Severity.WARNING, file, f"{file}: {what} is left out: {why}.", mend)


@dataclass(frozen=True)
class _SignalSource:
    """Which signals can be computed, of which sides, and in which frames their markers are seen."""

    recording: Recording
    rules: MovementRules
    keys: Mapping[Key, list[Key]]
    known: Mapping[Key, NDArray[np.bool_]]
    ahead: Mapping[Key, Floats]

    @classmethod
    def of(cls, recording: Recording, rules: MovementRules, places: Places, sides: tuple[str, ...]) -> _SignalSource:
        keys, known, ahead = {}, {}, {}
        for signal in rules.signals:
            for side in sides:
                own = keys_of(signal, rules, side)
                if all(key in places.filtered for key in own):
                    keys[signal.name, side] = own
                    known[signal.name, side] = np.logical_and.reduce([places.seen[key] for key in own])
                    if signal.direction == "ahead":
                        # The same way in each draw, or its own turns would count as noise.
                        ahead[signal.name, side] = way_ahead(places.filtered[own[0]])
        return cls(recording, rules, keys, known, ahead)

    def signals(self, paths: Mapping[Key, Floats]) -> dict[Key, Floats]:
        """All signals of markers (T, 3)."""
        by_name = {signal.name: signal for signal in self.rules.signals}
        return {
            key: signal_curve(by_name[key[0]], [paths[one] for one in own], self.recording.rate, self.ahead.get(key))
            for key, own in self.keys.items()
        }


def _found(
    rules: MovementRules, signals: Mapping[Key, Floats], side: str, rate: float
) -> tuple[dict[str, list[float]], list[tuple[EventRule, float]]]:
    """Times by rule; and the rules whose anchors, at these times, have no such moment."""
    found: dict[str, list[float]] = {}
    without = []
    for rule in rules.events:
        if (rule.signal, side) not in signals:
            continue
        moments = _moments(rule, signals[rule.signal, side], rate)
        if not (rule.after or rule.before):
            found[rule.name] = _chosen(rule.which, moments)
            continue
        found[rule.name] = times = []
        anchors = sorted(found.get(rule.after or rule.before, []))
        for number, anchor in enumerate(anchors):
            low, high = -np.inf, np.inf
            if rule.after:
                low, high = anchor, anchors[number + 1] if number + 1 < len(anchors) else np.inf
                # Between two earlier events: the next one of the second kind ends it.
                high = min([high, *(time for time in found.get(rule.before, []) if time > anchor)]) if rule.before else high
            else:
                low, high = anchors[number - 1] if number else -np.inf, anchor
            inside = [moment for moment in moments if low < moment[0] < high]
            if not inside:
                without.append((rule, anchor))
            elif rule.which == "largest":
                times.append(max(inside, key=lambda moment: moment[1])[0])
            else:
                times.append(inside[0 if rule.after else -1][0])
    return found, without


def _chosen(which: str, moments: list[tuple[float, float]]) -> list[float]:
    if not moments or which == "every":
        return [time for time, _ in moments]
    if which == "largest":
        return [max(moments, key=lambda moment: moment[1])[0]]
    return [moments[0 if which == "first" else -1][0]]


def _moments(rule: EventRule, signal: Floats, rate: float) -> list[tuple[float, float]]:
    """Times, s, at which the signal does what the rule asks for, and how prominent that is."""
    low, high = float(signal.min()), float(signal.max())

    def value(amount: Amount, zero: float) -> float:
        return zero + amount.value * (high - low) if amount.of_range else amount.value

    if rule.find in ("maximum", "minimum"):
        upwards = signal if rule.find == "maximum" else -signal
        least = max(value(one, 0.0) for one in rule.prominence)
        peaks, more = find_peaks(upwards, prominence=max(least, 1e-12))
        return [((peak + _vertex(upwards, peak)) / rate, float(more["prominences"][n])) for n, peak in enumerate(peaks.tolist())]
    above = signal - value(rule.level, low)
    above = above if rule.find == "rising" else -above
    before = np.flatnonzero((above[:-1] < 0) & (above[1:] >= 0))
    return [((at + above[at] / (above[at] - above[at + 1])) / rate, high - low) for at in before.tolist()]


def _vertex(values: Floats, at: int) -> float:
    """Frames from a sample to the vertex of the parabola through it and its neighbours; 0 at an end."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, behind = values[at - 1 : at + 2]
    bent = before - 2 * here + behind
    return float(np.clip(0.5 * (before - behind) / bent, -0.5, 0.5)) if bent else 0.0


def _with_sigma(
    name: str, side: str, time: float, times: list[float], draws: list[list[float]], rate: float
) -> tuple[MovementEvent, float]:
    """The event with its uncertainty, and the share of draws that show it."""
    others = [abs(time - other) / 2 for other in times if other != time]
    near = min([_NEAR, *others])
    apart = [min(abs(one - time) for one in draw) for draw in draws if draw]
    same = np.array([one for one in apart if one <= near])
    # What lies between two frames nobody saw.
    sigma = float(np.sqrt((np.mean(same**2) if len(same) else 0.0) + 1.0 / (12.0 * rate**2)))
    return MovementEvent(name, side, float(time), sigma), len(same) / len(draws)


def _seen(known: NDArray[np.bool_], place: float) -> bool:
    below = int(np.clip(np.floor(place), 0, len(known) - 1))
    return bool(known[below] and known[min(below + 1, len(known) - 1)])


def _phases(
    rules: MovementRules,
    events: list[MovementEvent],
    sides: tuple[str, ...],
    curves: _SignalSource,
    signals: Mapping[Key, Floats],
    sigmas: Mapping[Key, Floats],
    rate: float,
) -> list[Phase]:
    found = []
    for rule in rules.phases:
        for side in sides:
            begins = [event for event in events if (event.name, event.side) == (rule.begin, side)]
            ends = [event for event in events if (event.name, event.side) == (rule.end, side)]
            number = 0
            for at, begin in enumerate(begins):
                limit = begins[at + 1].time if at + 1 < len(begins) else np.inf
                end = next((one for one in ends if begin.time < one.time <= limit), None)
                if end is not None:
                    number += 1
                    extremes = tuple(_extremes(rules, side, begin.time, end.time, curves, signals, sigmas, rate))
                    found.append(Phase(rule.name, side, number, begin, end, extremes))
    return sorted(found, key=lambda phase: phase.begin.time)


def _inside(known: NDArray[np.bool_], begin: float, end: float, rate: float) -> slice | None:
    """The frames of a phase; None where one of them is not known, or there is none."""
    frames = slice(int(np.ceil(begin * rate - 1e-6)), int(np.floor(end * rate + 1e-6)) + 1)
    return frames if known[frames].size and known[frames].all() else None


def _extremes(
    rules: MovementRules,
    side: str,
    begin: float,
    end: float,
    curves: _SignalSource,
    signals: Mapping[Key, Floats],
    sigmas: Mapping[Key, Floats],
    rate: float,
) -> Iterator[Extreme]:
    for signal in rules.signals:
        key = (signal.name, side)
        if key not in signals or (frames := _inside(curves.known[key], begin, end, rate)) is None:
            continue
        values = signals[key][frames]
        for kind, place in (("minimum", int(values.argmin())), ("maximum", int(values.argmax()))):
            at = frames.start + place
            yield Extreme(signal.name, kind, float(values[place]), float(sigmas[key][at]), signal.unit, at / rate)


def _peaks(
    rules: MovementRules,
    phases: list[Phase],
    signals: Mapping[Key, Floats],
    draws: list[dict[Key, Floats]],
    curves: _SignalSource,
    rate: float,
) -> Iterator[SequencePeak]:
    units = {signal.name: signal.unit for signal in rules.signals}
    for rule in rules.sequences:
        for phase in (one for one in phases if one.name == rule.phase):
            windows = {
                (name, phase.side): frames
                for name in rule.signals
                if (name, phase.side) in signals
                and (frames := _inside(curves.known[name, phase.side], phase.begin.time, phase.end.time, rate)) is not None
            }
            if len(windows) < 2:
                continue
            times = {key: _peak_at(signals[key], frames) / rate for key, frames in windows.items()}
            again = [{key: _peak_at(draw[key], frames) / rate for key, frames in windows.items()} for draw in draws]
            order = sorted(times, key=times.__getitem__)
            orders = [sorted(drawn, key=drawn.__getitem__) for drawn in again]
            for place, key in enumerate(order):
                apart = np.array([drawn[key] - times[key] for drawn in again])
                sigma = float(np.sqrt(np.mean(apart**2) + 1.0 / (12.0 * rate**2)))
                same = sum(one[place] == key for one in orders) / len(orders)
                value = float(signals[key][windows[key]].max())
                yield SequencePeak(rule.name, phase.side, phase.number, key[0], place + 1, same, times[key], sigma, value, units[key[0]])


def _peak_at(values: Floats, frames: slice) -> float:
    """Frames from the first to the largest value in a part, between frames where it lies inside."""
    place = frames.start + int(values[frames].argmax())
    return place + (_vertex(values, place) if frames.start < place < frames.stop - 1 else 0.0)


COLUMNS: Mapping[str, type] = {
    "file": str, "kind": str, "name": str, "side": str, "phase": str, "number": int, "value": float, "uncertainty": float, "unit": str,
    "begins_s": float, "ends_s": float, "first_frame": int, "last_frame": int,
}  # fmt: skip
"""Of the table. Kinds are "event", "duration" of a phase, "minimum", "maximum" and "range" of a signal in a phase, "peak" of a sequence."""


def movement_table(movements: Mapping[str, FoundMovement]) -> NumberTable:
    """All numbers of movements, by the names of their files, each with its standard uncertainty, times (s) and frames."""
    return NumberTable(COLUMNS, tuple(row for name, movement in movements.items() for row in _rows(name, movement)))


def _rows(file: str, movement: FoundMovement) -> Iterator[tuple[object, ...]]:
    rate, first = movement.recording.rate, movement.recording.first_frame

    def row(kind: str, name: str, value: float, sigma: float, unit: str, span: tuple[float, float], **more: object) -> tuple[object, ...]:
        # A time that is a frame's, but for the last digit, is of this frame alone.
        frames = np.round([span[0] * rate, span[1] * rate], 6)
        cells = {"file": file, "kind": kind, "name": name, "value": float(value), "uncertainty": float(sigma), "unit": unit, "phase": None}
        cells |= {"begins_s": float(span[0]), "ends_s": float(span[1])} | more
        cells |= {"first_frame": first + int(np.floor(frames[0])), "last_frame": first + int(np.ceil(frames[1]))}
        return tuple(cells[column] or None if column == "side" else cells[column] for column in COLUMNS)

    counts: dict[Key, int] = {}
    for event in movement.events:
        counts[event.name, event.side] = number = counts.get((event.name, event.side), 0) + 1
        yield row("event", event.name, event.time, event.sigma, "s", (event.time, event.time), side=event.side, number=number)
    for phase in movement.phases:
        which = {"side": phase.side, "phase": phase.name, "number": phase.number}
        span = (phase.begin.time, phase.end.time)
        yield row("duration", phase.name, phase.duration, phase.sigma, "s", span, **which)
        for low, high in zip(phase.extremes[::2], phase.extremes[1::2], strict=True):
            for one in (low, high):
                yield row(one.kind, one.signal, one.value, one.sigma, one.unit, (one.time, one.time), **which)
            yield row("range", low.signal, high.value - low.value, np.hypot(low.sigma, high.sigma), low.unit, span, **which)
    phases = {sequence.name: sequence.phase for sequence in movement.rules.sequences}
    for peak in movement.peaks:
        which = {"side": peak.side, "phase": phases[peak.sequence], "number": peak.number}
        yield row("peak", peak.signal, peak.time, peak.sigma, "s", (peak.time, peak.time), **which)
