"""Shared by all readers: the points of a file, under the names in the file, in; a `Recording` out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError, NoMarkers
from asterism.files.text import some_of
from asterism.findings import Finding
from asterism.formats._findings import (
    events_outside,
    located,
    missing_samples,
    nothing_seen,
    repeated_name,
    vertical_assumed,
    vertical_conflict,
)
from asterism.formats._physical import COMPUTED, MARKER, UNNAMED, kinds_by_name
from asterism.formats._units import METRES_PER_UNIT, body_size, metres_per_unit, size_findings
from asterism.formats._vertical import AXES, LIKELIER, VerticalEvidence, axis_of, chances_of, vertical_evidence, vertical_from_positions
from asterism.recording import Event, Floats, MarkerSet, ProcessingStep, Recording, as_vertical, axis_name, canonical, plain_name
from asterism.recording.arrays import missing_codes

__all__ = [
    "METRES_PER_UNIT",
    "Points",
    "body_size",
    "is_unnamed",
    "metres_per_unit",
    "recording_of",
    "settle_vertical",
    "vertical_from_positions",
    "without_common_subject",
]

_FURTHEST = 1e6
_MISDECLARED = 0.05
"""How often a file declares a wrong vertical: 6 of some 100 files of our tests do. At half of it a walk cut to a second is not seen to
contradict its header; at double three points more than enough do, as of a wand."""
_CUSTOM = 0.5
"""How often a format's custom is right where a file says nothing: it decides only where the points show nothing. C3D files are z up in nine
of ten, TRC files y up in two of three; at 0.9, people who crawl in a TRC file are taken as lying on their side."""
_DOUBT = 0.05
"""Probability of another axis from which doubt is told. At half of it one right file in fifty is doubted, at double every sixth wrong
declaration that stands goes unsaid (recordings cut to 0.3 to 3 s, without names)."""
_LONGEST_LABEL = 1000


@dataclass(frozen=True)
class Points:
    """Every point of a file, in metres, under the labels of the file.

    positions  (T, P, 3) m, NaN missing
    labels     (P,) as in the file, repeats and subject prefixes included
    rate       frames per second
    format     "TRC", "CSV", ...
    units      the file's unit of length, in which it is written again
    kinds      (P,) "marker", "computed" or "unnamed"; None: by name
    declared   the vertical that the file or its format defines, or None
    fallback   the vertical where nothing else determines it, or None
    findings   what a person should know about the file; their sentences name no file (`located` adds it)
    log        what was done to the recording before it was written
    frames     number of frames of the file; None: as many as `positions` has, which may be a sample of them
    """

    positions: Floats
    labels: tuple[str, ...]
    rate: float
    format: str
    units: str = "m"
    kinds: tuple[str, ...] | None = None
    declared: Floats | None = None
    fallback: Floats | None = None
    first_frame: int = 1
    first_time: float | None = None
    events: tuple[Event, ...] = ()
    subject: str = ""
    findings: tuple[Finding, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    log: tuple[ProcessingStep, ...] = ()
    frames: int | None = None

    def __post_init__(self) -> None:
        longest = max(map(len, self.labels), default=0)
        # A damaged file can make one name of megabytes, which every message would repeat.
        if longest > _LONGEST_LABEL:
            number = next(i for i, label in enumerate(self.labels) if len(label) == longest) + 1
            raise AsterismError(f"point {number} has a name of {longest:,} characters; give it one of at most {_LONGEST_LABEL:,}.")

    @property
    def found(self) -> tuple[Finding, ...]:
        """The findings, with those about names, the size of a person and events that lie outside the recording."""
        captured = [column for column, kind in enumerate(self.kind_of_points) if kind != COMPUTED]
        found = [*self.findings, *size_findings(self.positions, self.labels, captured, self.units), *self._repeated_names()]
        # A sample of a long recording does not show that nothing is seen.
        if (
            captured
            and self.frames in (None, len(self.positions))
            and len(self.positions)
            and np.isnan(self.positions[:, captured, 0]).all()
        ):
            found.append(nothing_seen(f"none of its {len(captured)} points is seen in any frame"))
        begin = (self.first_frame - 1) / self.rate if self.first_time is None else self.first_time
        end = begin + (len(self.positions) if self.frames is None else self.frames) / self.rate
        # A frame more on either side: some programs count frames from 0, others from 1.
        margin = 1.001 / self.rate
        outside = [event for event in self.events if not begin - margin <= event.time <= end + margin]
        if not outside:
            return tuple(found)
        times = f"{min(event.time for event in outside):.2f} to {max(event.time for event in outside):.2f} s"
        few = f"{len(outside)} of {len(self.events)} events lie outside the recording, which is from {begin:.2f} to {end:.2f} s ({times})"
        return (*found, events_outside(few))

    def _repeated_names(self) -> list[Finding]:
        """A finding where markers have the same name."""
        names = Counter(label for label, kind in zip(self.labels, self.kind_of_points, strict=True) if kind == MARKER)
        several = sorted(name for name, number in names.items() if number > 1)
        if not several:
            return []
        some = some_of([f"{name} ({names[name]})" for name in several])
        return [repeated_name(f"several markers have one name: {some}")]

    @property
    def kind_of_points(self) -> tuple[str, ...]:
        """(P,) what each point is."""
        return self.kinds if self.kinds is not None else tuple(kinds_by_name(self.labels))


def recording_of(
    path: Path, points: Points, markers: Any = None, vertical: ArrayLike | str | None = None, *, source: Any = None
) -> Recording:
    """The recording that `asterism.read` gives for the points of a file.

    markers   None: all points but the computed ones; else what `MarkerSet.load` takes: exactly its columns, NaN where absent
    vertical  None: determined by `settle_vertical`; else a vector or an axis name
    source    what the recording keeps for its writer; by default the points

    Raises AsterismError, naming the file, where it has no marker of the set, has one twice, or does not determine the vertical.
    """
    # The subject's name is the same before each label, so that it says nothing about the points.
    labels, subject = without_common_subject(points.labels)
    kinds = np.array(points.kind_of_points, dtype=object)
    physical = np.nonzero(kinds != COMPUTED)[0]
    if markers is None and labels and not len(physical):
        raise NoMarkers(
            f"{path} holds no markers, only {len(labels)} points that a model computed, such as joint centres, angles or forces "
            f"({some_of(labels)}); choose a recording with markers, or name those that are markers with --markers."
        )
    if markers is None:
        columns, names = physical, tuple(labels[c] for c in physical)
    else:
        columns, names = wanted_columns(path, labels, MarkerSet.load(markers))
    present = columns >= 0
    positions = points.positions  # as it is where all columns stay in their places: long recordings are large
    # Only where columns move is the array copied.
    if not np.array_equal(columns, np.arange(len(labels))):
        positions = np.full((len(points.positions), len(names), 3), np.nan)
        positions[:, present] = points.positions[:, columns[present]]
    # What a model computed stands anywhere and would mislead the search for the vertical.
    bodily = points.positions if len(physical) == len(labels) else points.positions[:, physical]
    up, how, found = settle_vertical(
        path, bodily, [labels[c] for c in physical], vertical, declared=points.declared, fallback=points.fallback
    )
    findings = (*points.found, *found)
    # The writer must find each sample again in its own file.
    origin = np.where(np.isnan(positions[:, :, 0]), -1, columns[None, :])
    metadata: dict[str, Any] = {
        "file": str(path),
        "format": points.format,
        "units": points.units,
        "subject": points.subject or subject,
        "vertical_from": how,
        **({} if points.first_time is None else {"first_time": points.first_time}),
        **({"findings": located(path, findings)} if findings else {}),
        **points.extra,
    }
    return Recording(
        positions=positions,
        labels=names,
        rate=points.rate,
        vertical=up,
        events=points.events,
        metadata=metadata,
        source=points if source is None else source,
        origin=origin.astype(np.int64, copy=False),
        # Columns that were not asked for stay in the file when it is written again.
        taken=tuple(int(c) for c in (physical if markers is None else columns[present])),
        first_frame=points.first_frame,
        log=points.log,
    )


def wanted_columns(path: Path, labels: Sequence[str], wanted: MarkerSet) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """The column of each marker of the set, -1 where absent, and the set's names.

    A column with the name in the set takes precedence over one with an alias.
    Raises AsterismError where no marker of the set is present, or two columns carry one marker's name.
    """
    # A set's own name wins over an alias: a file may have both a heel and its other name.
    exact = {plain_name(label) for label in labels} & {canonical(name) for name in wanted.names}
    spelled = [
        "" if (name := wanted.name_of(label)) and canonical(name) in exact and plain_name(label) != canonical(name) else label
        for label in labels
    ]
    try:
        columns = wanted.columns_of(spelled)
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from problem
    if (columns < 0).all():
        raise AsterismError(
            f"{path} has no marker of {wanted.title or 'the marker set'} ({some_of(wanted.names)}); "
            f"its points are {some_of(labels, 8)}; choose another marker set or add these names as aliases."
        )
    return columns, wanted.names


def settle_vertical(
    path: Path,
    positions: Floats,
    labels: Sequence[str],
    given: ArrayLike | str | None = None,
    *,
    declared: Floats | None = None,
    fallback: Floats | None = None,
) -> tuple[Floats, str, list[Finding]]:
    """The vertical of a file, where it comes from ("given", "file", "data", "data against file" or "convention"), and what is to be said.

    positions (T, P, 3) and labels (P,) of the physical points. What the caller gives is taken. Else the evidence of the points (names, and
    gravity in what moves) is held against what is usual: a declaration is right in 19 of 20 files, and without one the custom of the format
    in every second. What then is likeliest is taken.

    Raises AsterismError where no axis is.
    """
    if given is not None:
        return as_vertical(given), "given", []
    evidence = vertical_evidence(positions, labels)
    if declared is not None:
        return _declared_vertical(as_vertical(declared), evidence)
    custom = None if fallback is None else as_vertical(fallback)
    chances = chances_of(evidence.total, _before(custom, 1.0 - _CUSTOM))
    best = int(chances.argmax())
    # Of several that may be meant, custom says which.
    if chances[best] < LIKELIER and custom is not None:
        best = axis_of(custom)
    elif chances[best] < LIKELIER:
        raise AsterismError(
            f"{path} does not say which way is up and its points do not show it; say it with --vertical z, or vertical='z' in Python."
        )
    shown = chances_of(evidence.total)
    how = "data" if shown.argmax() == best and shown[best] >= LIKELIER else "convention"
    if np.sort(chances)[-2] < _DOUBT:
        return AXES[best].copy(), how, []
    sentence = f"the file does not say which way is up, and its points do not show it clearly; {axis_name(AXES[best])} was taken"
    return AXES[best].copy(), how, [vertical_assumed(sentence)]


def _declared_vertical(declared: Floats, evidence: VerticalEvidence) -> tuple[Floats, str, list[Finding]]:
    """A declared vertical, or the one that points contradict it with; where the vertical comes from; and what is to be said."""
    before = _before(declared, _MISDECLARED)
    chances = chances_of(evidence.total, before)
    best, name = int(chances.argmax()), axis_name(declared)
    if best != axis_of(declared) and chances[best] >= LIKELIER:
        sentence = f"the file declares {name} as up, its points are a body with {axis_name(AXES[best])} up, which was taken"
        return AXES[best].copy(), "data against file", [vertical_conflict(sentence)]
    # Names may contradict it alone: somebody lies, or the file is wrong.
    others = np.maximum(chances, chances_of(evidence.named, before))
    others[axis_of(declared)] = 0.0
    if others.max() < _DOUBT:
        return declared, "file", []
    other = axis_name(AXES[others.argmax()])
    sentence = f"the file declares {name} as up, which was taken, but its points may be a body with {other} up"
    return declared, "file", [vertical_conflict(sentence)]


def _before(vertical: Floats | None, wrong: float) -> Floats:
    """(6,) the probability of each axis before the points are seen: of a vertical that is said, and wrong so often; of none, all alike."""
    if vertical is None:
        return np.full(6, 1.0 / 6.0)
    before = np.full(6, wrong / 5.0)
    before[axis_of(vertical)] = 1.0 - wrong
    return before


def without_common_subject(labels: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """The labels without the subject's name that all of them carry before a colon, and that name, "" for no name.

    Unnamed points need not carry it. Names that would be left as Marker1, Marker2, ... keep their prefix.
    """
    # Points without a name often lack the prefix that all others carry.
    named = [label for label, kind in zip(labels, kinds_by_name(labels), strict=True) if kind != UNNAMED]
    subjects = {label.rpartition(":")[0] for label in named}
    if len(subjects) != 1 or "" in subjects:
        return tuple(labels), ""
    subject = subjects.pop()
    rests = [label.rpartition(":")[2] for label in named]
    # "Marker1" to "Marker9" mean nothing without the body that they belong to.
    if all(re.fullmatch(r"(?i)marker\s*\d+", rest) or not rest for rest in rests):
        return tuple(labels), ""
    return tuple(label.rpartition(":")[2] if label.startswith(subject + ":") else label for label in labels), subject


def is_unnamed(label: str) -> bool:
    """Whether a label only numbers an unnamed point: *12, Unlabeled:108, U3, x56."""
    return kinds_by_name([label])[0] == UNNAMED


def coded_samples(coded: Floats) -> list[Finding]:
    """A finding about samples (n, 3), in the file's unit, that are a number for "missing"; none where there are none."""
    if not len(coded):
        return []
    worst = coded[0][np.abs(coded[0]).argmax()]
    return [missing_samples(f"{len(coded)} samples are {worst:.10g}, a number for missing ones; taken as missing")]


def as_metres(raw: Floats, scale: float, zero_is_missing: bool = True) -> tuple[Floats, list[Finding]]:
    """Positions in metres, NaN for what cannot be a place (not finite, beyond 1000 km, zero in all three); and findings."""
    with np.errstate(over="ignore", invalid="ignore"):
        # A huge number may overflow here, and is taken as missing below.
        positions = raw * scale
        impossible = np.any(np.isinf(raw) | (np.abs(positions) > _FURTHEST), axis=2)
    # Many programs write a missing sample as three zeros.
    zero = np.all(raw == 0, axis=2) & zero_is_missing
    coded = missing_codes(raw)
    impossible &= ~coded
    blank = np.isnan(positions)
    part = blank.any(axis=2) & ~blank.all(axis=2) & ~impossible & ~coded
    positions[impossible | zero | coded | part] = np.nan
    findings = coded_samples(raw[coded])
    if part.any():
        findings.append(missing_samples(f"{int(part.sum())} samples have one or two of their three coordinates; taken as missing"))
    if impossible.any():
        findings.append(missing_samples(f"{int(impossible.sum())} samples are infinite or beyond 1000 km; taken as missing"))
    if zero.any():
        findings.append(missing_samples(f"{int(zero.sum())} samples are zero in all three coordinates; taken as missing"))
    return positions, findings
