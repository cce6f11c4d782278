"""What a person says of pieces of tracks, as requests; and what was said, as records that name points and survive another labelling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Event


@dataclass(frozen=True)
class Name:
    """The piece with this id is this marker."""

    piece: int
    marker: str


@dataclass(frozen=True)
class Ghost:
    """The piece with this id is no marker."""

    piece: int


@dataclass(frozen=True)
class Right:
    """The piece with this id has the right label; without a label, it is no marker."""

    piece: int


@dataclass(frozen=True)
class Cut:
    """The piece with this id goes over from one marker to another: `frame`, counted from 0, is the first of its later part."""

    piece: int
    frame: int


@dataclass(frozen=True)
class Swap:
    """Two pieces carry each other's labels from frame `first` to `last`, inclusive and counted from 0; by default in all their frames."""

    piece: int
    other: int
    first: int | None = None
    last: int | None = None


@dataclass(frozen=True)
class SwapMarkers:
    """All that has the label of one of two markers, from frame `first` to `last`, inclusive and counted from 0, is the other one."""

    marker: str
    other: str
    first: int
    last: int | None = None


Request = Name | Ghost | Right | Cut | Swap | SwapMarkers
KINDS: dict[str, type[Request]] = {"name": Name, "ghost": Ghost, "right": Right, "cut": Cut, "swap": Swap}


@dataclass(frozen=True)
class PointInFrame:
    """One point of a recording, by which a piece is found again after its tracks were linked anew.

    frame     counted from 0
    position  m, in the axes of the recording
    track     the number that the camera system gave its track, or its column; -1 where neither is known
    """

    frame: int
    position: tuple[float, float, float]
    track: int = -1

    def to_plain(self) -> dict[str, Any]:
        """As plain values."""
        return {"frame": self.frame, "position": list(self.position), "track": self.track}

    @classmethod
    def from_plain(cls, plain: Any) -> PointInFrame:
        """The point that `to_plain` wrote. Raises ValueError, KeyError or TypeError for anything else."""
        x, y, z = map(float, plain["position"])
        if not np.isfinite((x, y, z)).all():
            raise ValueError("a position is not finite")
        return cls(_whole(plain["frame"]), (x, y, z), _whole(plain["track"]))


@dataclass(frozen=True)
class MarkerSpan:
    """A gap of a marker: its frames, counted from 0, `first` to `last` inclusive."""

    marker: str
    first: int
    last: int


@dataclass(frozen=True)
class EventChange:
    """What a person said of the events of a recording.

    begun    all events, as they were found, where this is the first that was said of them
    removed  those that go; an event that is moved goes and comes
    added    those that come
    """

    removed: tuple[Event, ...] = ()
    added: tuple[Event, ...] = ()
    begun: tuple[Event, ...] | None = None

    def applied(self, events: Sequence[Event]) -> tuple[Event, ...]:
        """The events with this change, in the order of time."""
        left = list(events if self.begun is None else self.begun)
        for event in self.removed:
            if event in left:
                left.remove(event)
        return tuple(sorted([*left, *self.added], key=lambda event: event.time))


@dataclass(frozen=True)
class Touch:
    """What a person said at once.

    kind      "name", "ghost", "right", "cut", "swap", "refuse", "fill", "unfill" or "event"
    cuts      the first points of the later parts of pieces that are cut
    labels    points, and the marker that the piece with the point is, None where it is no marker
    filled    gaps whose fill is accepted; unfilled: gaps whose fill is not accepted any more
    events    what changes in the events of the recording
    """

    kind: str
    cuts: tuple[PointInFrame, ...] = ()
    labels: tuple[tuple[PointInFrame, str | None], ...] = ()
    filled: tuple[MarkerSpan, ...] = ()
    unfilled: tuple[MarkerSpan, ...] = ()
    events: EventChange | None = None

    @property
    def is_of_labels(self) -> bool:
        """Whether labels follow from it; gaps and events change none."""
        return bool(self.cuts or self.labels)

    def to_plain(self) -> dict[str, Any]:
        """As plain values, for a line of a log."""
        labels = [{**point.to_plain(), "marker": marker} for point, marker in self.labels]
        plain: dict[str, Any] = {"kind": self.kind, "cuts": [point.to_plain() for point in self.cuts], "labels": labels}
        if self.filled or self.unfilled:
            plain |= {"filled": [asdict(span) for span in self.filled], "unfilled": [asdict(span) for span in self.unfilled]}
        if self.events is not None:
            plain["events"] = asdict(self.events)
        return plain

    @classmethod
    def from_plain(cls, plain: Any) -> Touch:
        """The touch that `to_plain` wrote. Raises ValueError, KeyError or TypeError for anything else."""
        labels = []
        for entry in plain["labels"]:
            if not isinstance(entry["marker"], str | None):
                raise ValueError("a marker is no text")
            labels.append((PointInFrame.from_plain(entry), entry["marker"]))
        filled, unfilled = (tuple(_span(one) for one in plain.get(name, ())) for name in ("filled", "unfilled"))
        change = plain.get("events")
        said = None if change is None else EventChange(_events(change["removed"]), _events(change["added"]), _events(change["begun"], None))
        return cls(_text(plain["kind"]), tuple(map(PointInFrame.from_plain, plain["cuts"])), tuple(labels), filled, unfilled, said)


def request_of(plain: Mapping[str, Any]) -> Request:
    """The request that plain values from outside describe: `kind` and the fields of its class.

    Raises AsterismError, saying which field is missing, unknown or of another type.
    """
    kind = plain.get("kind")
    given = {name: value for name, value in plain.items() if name != "kind"}
    if kind == "swap" and "markers" in given:
        return _markers_swapped(given)
    if not isinstance(kind, str) or kind not in KINDS:
        raise AsterismError(f"there is no kind of answer {str(kind)[:40]!r}; choose from {', '.join(KINDS)}.")
    fields = KINDS[kind].__dataclass_fields__
    for name, value in given.items():
        if name not in fields:
            raise AsterismError(f"an answer of kind {kind} has no field {name[:40]!r}; its fields are {', '.join(fields)}.")
        _check_field(kind, name, value)
    missing = [name for name in fields if name not in given and name not in ("first", "last")]
    if missing:
        raise AsterismError(f"an answer of kind {kind} needs the field {missing[0]}; its fields are {', '.join(fields)}.")
    return KINDS[kind](**given)


def _markers_swapped(given: Mapping[str, Any]) -> SwapMarkers:
    markers, first, last = given["markers"], given.get("frame", given.get("first")), given.get("last")
    if not isinstance(markers, list | tuple) or len(markers) != 2 or not all(isinstance(name, str) for name in markers):
        raise AsterismError("an answer of kind swap needs two names in the field markers.")
    if first is None:
        raise AsterismError("an answer of kind swap of two markers needs the field frame.")
    _check_field("swap", "frame", first)
    _check_field("swap", "last", last)
    return SwapMarkers(markers[0], markers[1], first, last)


def _check_field(kind: str, name: str, value: Any) -> None:
    """Raise AsterismError where a field has another type than its name says."""
    if name == "marker":
        fits = isinstance(value, str)
    else:
        fits = (value is None and name in ("first", "last")) or (isinstance(value, int) and not isinstance(value, bool))
    if not fits:
        expected = "a text" if name == "marker" else "a whole number"
        raise AsterismError(f"the field {name} of an answer of kind {kind} is {str(value)[:40]!r}; give {expected}.")


def _span(plain: Any) -> MarkerSpan:
    return MarkerSpan(_text(plain["marker"]), _whole(plain["first"]), _whole(plain["last"]))


def _events(plain: Any, missing: Any = ()) -> Any:
    """Events of a log; what stands for none, where there are none."""
    if plain is None:
        return missing
    found = tuple(Event(_text(one["label"]), float(one["time"]), _text(one["context"])) for one in plain)
    if not np.isfinite([event.time for event in found]).all():
        raise ValueError("a time is not finite")
    return found


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("not a whole number")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("not a text")
    return value
