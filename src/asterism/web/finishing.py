"""A corrected recording in; fills of its gaps, its gait events, and the recording with what a person said of both, out."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism import __version__, formats
from asterism.errors import AsterismError
from asterism.gait.events import OFF, SIDE_NAMES, STRIKE, GaitEvent, find_events
from asterism.gait.said import PERSON, walking_as_said, with_events_said
from asterism.geometry import rotate_z_up
from asterism.labelling.correction import Correction, CorrectionChange
from asterism.labelling.correction.touches import EventChange, MarkerSpan, Touch
from asterism.motion.gaps import Filled, fill_gaps
from asterism.recording import Event, Labelling, Recording
from asterism.session import LabelledFile, has_gaps

NORMAL_95 = 1.959964
_AROUND = 0.25
"""s that the graph of a gap shows on each side at least: a quarter of a step. A longer gap shows as much as it lasts."""
_DIGITS = 5
"""Of an event's time in s: 10 µs, less than any sample of a force plate lasts."""


@dataclass(frozen=True)
class OtherTrial:
    """A recording that may tell of another one. version: what differs when it has changed; read: gives it, or None."""

    version: Any
    read: Callable[[], Recording | None]


@dataclass
class Finishing:
    """What is proposed for a trial. Its gaps and events are found when they are asked for, and again when its labels have changed."""

    _filling: threading.Lock = field(default_factory=threading.Lock)
    _seeking: threading.Lock = field(default_factory=threading.Lock)
    _gaps: tuple[Labelling, tuple[Any, ...], Filled] | None = None
    _events: tuple[Labelling, tuple[GaitEvent, ...]] | None = None

    def gaps(self, labelled: LabelledFile, trials: Sequence[OtherTrial] = ()) -> Filled:
        """The recording, its gaps filled as far as that is certain enough, also from other trials that show the same person.

        Raises AsterismError where no marker has a name.
        """
        labelling, known = labelled.labelling, tuple(trial.version for trial in trials)
        # One at a time: two tabs would do the work of seconds twice.
        with self._filling:
            if self._gaps is None or self._gaps[0] is not labelling or self._gaps[1] != known:
                self._gaps = labelling, known, filled(labelled.recording, trials)
            return self._gaps[2]

    def events(self, labelled: LabelledFile) -> tuple[GaitEvent, ...]:
        """Strikes and offs of the recording. Raises AsterismError where feet or pelvis have no markers."""
        labelling = labelled.labelling
        with self._seeking:
            if self._events is None or self._events[0] is not labelling:
                recording = labelled.recording
                plates, _ = formats.force_plates(recording)
                found = walking_as_said(recording, find_events(recording, plates))
                self._events = labelling, tuple(replace(event, time=round(event.time, _DIGITS)) for event in found.events)
            return self._events[1]


def spans_of(fill: Filled) -> list[tuple[MarkerSpan, float]]:
    """The gaps that can be filled, and how far the 95 % interval of each reaches, in m."""
    found = []
    for column, label in enumerate(fill.recording.labels):
        edges = np.diff(np.pad(fill.filled[:, column].astype(np.int8), 1))
        for first, end in zip(np.nonzero(edges > 0)[0].tolist(), np.nonzero(edges < 0)[0].tolist(), strict=True):
            found.append((MarkerSpan(label, first, end - 1), NORMAL_95 * float(fill.deviation[first:end, column].max())))
    return found


def filled(recording: Recording, trials: Sequence[OtherTrial], wanted: NDArray[np.bool_] | None = None) -> Filled:
    """The recording with its gaps filled as `asterism convert --fill` fills them; wanted (T, M): only these samples."""
    others = [one for trial in trials if (one := trial.read()) is not None] if has_gaps(recording) else []
    return fill_gaps(recording, others=others, wanted=wanted, by=f"asterism {__version__}")


def finished(correction: Correction, recording: Recording, trials: Sequence[OtherTrial] = ()) -> Recording:
    """The recording with the fills that a person accepted, flagged as `asterism convert --fill` flags them, and with their events."""
    if correction.filled:
        wanted = np.zeros(recording.visible.shape, dtype=np.bool_)
        for span in correction.filled:
            if span.marker in recording.labels:
                wanted[span.first : span.last + 1, recording.labels.index(span.marker)] = True
        recording = filled(recording, trials, wanted).recording
    return recording if correction.events is None else with_events_said(recording, correction.events)


def plain_gaps(correction: Correction, fill: Filled) -> dict[str, Any]:
    """What `/api/trials/ID/gaps` answers: gaps that can be filled, sentences on the others, and what was accepted and is no gap now."""
    spans, accepted = spans_of(fill), set(correction.filled)
    return {
        "revision": correction.revision,
        "gaps": [_plain_span(span) | {"reach": round(1000.0 * reach, 2), "accepted": span in accepted} for span, reach in spans],
        "left": [finding.sentence.removeprefix(f"{fill.recording.metadata.get('file')}: ") for finding in fill.findings],
        "gone": [_plain_span(span) for span in correction.filled if span not in {one for one, _ in spans}],
    }


def plain_graph(fill: Filled, span: MarkerSpan) -> dict[str, Any]:
    """What `/api/trials/ID/gap` answers: the path around a gap with its fill, in mm with z up, and the half width of its 95 % interval.

    Raises AsterismError where the gap is none of these.
    """
    if span not in {one for one, _ in spans_of(fill)}:
        raise AsterismError("this is no gap any more; look at the list again.")
    recording, column = fill.recording, fill.recording.labels.index(span.marker)
    around = max(span.last - span.first + 1, round(_AROUND * recording.rate))
    frames = slice(max(0, span.first - around), min(len(recording), span.last + 1 + around))
    path = 1000.0 * rotate_z_up(recording.positions[frames, column], recording.vertical)
    return {
        "first": frames.start,
        "path": [None if np.isnan(place[0]) else [round(float(value), 2) for value in place] for place in path],
        "reach": [None if np.isnan(one) else round(1000.0 * NORMAL_95 * float(one), 3) for one in fill.deviation[frames, column]],
    }


def plain_events(correction: Correction, found: tuple[GaitEvent, ...]) -> dict[str, Any]:
    """What `/api/trials/ID/events` answers: the events as a person set them, else as they were found; s from the first frame."""
    of = {_event_of(event): event for event in found}
    rows = []
    for event in correction.events if correction.events is not None else tuple(of):
        known = of.get(event)
        source, sigma = (PERSON, None) if known is None else (known.source, round(1000.0 * known.sigma, 1))
        rows.append({"label": event.label, "context": event.context, "time": event.time, "source": source, "sigma": sigma})
    return {"revision": correction.revision, "said": correction.events is not None, "events": rows}


def change_events(correction: Correction, found: tuple[GaitEvent, ...], removed: list[Any], added: list[Any]) -> CorrectionChange:
    """Take what a person says of events: those that go and those that come, each with label, context and time.

    Raises AsterismError where one that goes is not there, or one that comes is no strike or off, or outside the recording.
    """
    said = correction.events
    begun = tuple(map(_event_of, found)) if said is None else None
    present = list(begun or said or ())
    going, coming = (tuple(_read_event(one, correction) for one in rows) for rows in (removed, added))
    if not going and not coming:
        raise AsterismError("no event was named; say which goes, or which comes.")
    for event in going:
        if event not in present:
            raise AsterismError("this event is not there any more; look at the list again.")
        present.remove(event)
    return correction.touch(Touch("event", events=EventChange(going, coming, begun)))


def _read_event(plain: Any, correction: Correction) -> Event:
    known = isinstance(plain, dict) and plain.get("label") in (STRIKE, OFF) and plain.get("context") in SIDE_NAMES.values()
    time = plain.get("time") if known else None
    if isinstance(time, bool) or not isinstance(time, int | float):
        raise AsterismError(f"an event needs a label ({STRIKE} or {OFF}), a context (Left or Right) and a time in seconds.")
    if not 0.0 <= time <= (len(correction.clouds) - 1) / correction.recording.rate + 10.0**-_DIGITS:
        raise AsterismError("the event is outside the recording; put it into it.")
    return Event(plain["label"], round(float(time), _DIGITS), plain["context"])


def _event_of(event: GaitEvent) -> Event:
    return Event(event.label, event.time, SIDE_NAMES[event.side])


def _plain_span(span: MarkerSpan) -> dict[str, Any]:
    return {"marker": span.marker, "first": span.first, "last": span.last}
