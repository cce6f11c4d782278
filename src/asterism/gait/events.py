"""Feet over time, and force plates where they are, in; strikes and offs with how certain they are, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from asterism.gait.feet import RATE, Feet, feet_of
from asterism.geometry import rotate_z_up
from asterism.motion.clinical.kinetics import PlateContact
from asterism.recording import Event, Floats, ForcePlate, Recording

STRIKE, OFF = "Foot Strike", "Foot Off"
"""As C3D files call them."""
SIDE_NAMES = {"L": "Left", "R": "Right"}


@dataclass(frozen=True)
class EventRules:
    """How events are found.

    strike_later, off_later    s, from the moment when a heel is farthest ahead of the pelvis (a toe farthest behind) to the strike (off):
                               means of 11 children and two people on treadmills. At half and double strikes are 20 and 40 ms off
    knock_within, knock_later  s behind that moment in which a heel's knock on the floor, the peak of its upward acceleration, is
                               sought, and from the peak to the strike
    knock, knock_weight        m/s2 by which a peak stands above its surroundings to count for this much beside the first estimate; less in
                               proportion. Flat feet have none; on a treadmill it is 17 ms late. Half and double of both change the
                               errors by 1 to 2 ms
    rise_earlier               s, from the fastest rise of the toe back to the off; counts as much as the first estimate
    strike_sigma, off_sigma    s, standard deviation of what is left, also of people who gave no mean
    plate_sigma                s, of events told by a plate: a sample of it, and how a threshold of 20 N reads
    least_step                 of the usual step: shorter swings ahead are no steps. At half, a foot that shifts is one; at double, first
                               and last half-steps are missed
    near                       s, within which an event of a plate and one of the markers are the same
    foot_off_line              m: a centre of pressure farther from the line between heel and toe is not under that foot alone
    """

    strike_later: float = 0.036
    off_later: float = -0.010
    knock_within: float = 0.09
    knock_later: float = 0.003
    knock: float = 2.0
    knock_weight: float = 0.75
    rise_earlier: float = 0.027
    strike_sigma: float = 0.013
    off_sigma: float = 0.012
    plate_sigma: float = 0.004
    least_step: float = 0.3
    near: float = 0.12
    foot_off_line: float = 0.09


@dataclass(frozen=True)
class GaitEvent:
    """A strike or off of a foot.

    side    "L" or "R"; label `STRIKE` or `OFF`
    time    s from the recording's first frame; sigma s, its standard deviation
    source  "markers" or "plate 2"
    filled  whether filled samples of heel, toe or pelvis tell it; sigma holds what that adds
    """

    side: str
    label: str
    time: float
    sigma: float
    source: str
    filled: bool = False


@dataclass(frozen=True)
class Walking:
    """The events of a recording in the order of time, its feet, and whether they are on a treadmill."""

    events: tuple[GaitEvent, ...]
    feet: Feet
    treadmill: bool

    def of(self, side: str, label: str) -> list[GaitEvent]:
        """Events of one foot and kind."""
        return [event for event in self.events if event.side == side and event.label == label]

    def swings(self, side: str) -> list[tuple[float, float]]:
        """From and to s, between an off and the next strike of a foot."""
        own = [event for event in self.events if event.side == side]
        return [(one.time, other.time) for one, other in pairwise(own) if (one.label, other.label) == (OFF, STRIKE)]

    def to_events(self, recording: Recording) -> tuple[Event, ...]:
        """As a recording keeps them, on its file's clock."""
        start = float(recording.times[0])
        return tuple(Event(event.label, start + event.time, SIDE_NAMES[event.side]) for event in self.events)


def find_events(recording: Recording, plates: Sequence[ForcePlate] = (), rules: EventRules | None = None) -> Walking:
    """Strikes and offs of both feet, by markers, and by plates where one foot alone is on one.

    A heel is farthest ahead of the pelvis just before it strikes, a toe farthest behind about when it leaves (Zeni et al. 2008). The
    heel's knock on the floor (as Hreljac and Marshall 2000) and the toe's fastest rise (as O'Connor et al. 2007) make both more exact;
    on a treadmill, whose belt gives way, the knock is late and does not count. "Ahead" is where the feet point, so that turns and
    treadmills count as straight walks do. Events that break the order strike, off, strike are left out, the less certain first. O(T).
    Raises AsterismError where the feet's or the pelvis' markers are missing.

    >>> from asterism.simulation import simulate_walks
    >>> walking = find_events(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0])
    >>> len(walking.of("L", STRIKE)) >= 2
    True
    """
    rules = rules or EventRules()
    feet = feet_of(recording)
    if feet.backwards:
        # a heel that goes first strikes last: none of the rules holds
        return Walking((), feet, treadmill=False)
    found = [event for side in feet.sides for event in _by_markers(feet, side, rules)]
    if _on_treadmill(feet, found):
        found = [event for side in feet.sides for event in _by_markers(feet, side, replace(rules, knock_weight=0.0))]
    last = float(feet.times[-1])
    for event in _by_plates(recording, feet, plates, rules):
        same = [one for one in found if (one.side, one.label) == (event.side, event.label) and abs(one.time - event.time) < rules.near]
        # A plate knows when, the markers whether: what they do not show is another person's foot, or an object.
        if same:
            found.remove(min(same, key=lambda one: abs(one.time - event.time)))
            found.append(event)
    kept = [event for side in feet.sides for event in _in_order([one for one in found if one.side == side])]
    inside = [event for event in kept if 0.0 <= event.time <= last]
    return Walking(tuple(sorted(inside, key=lambda event: event.time)), feet, _on_treadmill(feet, inside))


def _by_markers(feet: Feet, side: str, rules: EventRules) -> list[GaitEvent]:
    found = []
    for label, curve, later, sigma in (
        (STRIKE, feet.forward(feet.heels[side]), rules.strike_later, rules.strike_sigma),
        (OFF, -feet.forward(feet.toes[side]), rules.off_later, rules.off_sigma),
    ):
        usual = float(np.percentile(curve, 95) - np.percentile(curve, 5))
        # a foot that moves by less than a twentieth of the leg stands
        peaks, _ = find_peaks(curve, prominence=max(rules.least_step * usual, 0.06 * feet.leg_length), distance=int(0.25 * RATE))
        for peak in peaks.tolist():
            first = float(feet.times[peak]) + later
            time = _with_knock(feet.heels[side], peak, first, rules) if label == STRIKE else _with_rise(feet.toes[side], peak, first, rules)
            found.append(GaitEvent(side, label, time, sigma, "markers"))
    return found


def _with_knock(heel: Floats, peak: int, first: float, rules: EventRules) -> float:
    """s: the first estimate of a strike, and the knock of the heel on the floor, as far as there is one."""
    height = heel[max(peak - 2, 0) : peak + round(RATE * rules.knock_within) + 3, 2]
    if len(height) < 5:
        return first
    upwards = np.gradient(np.gradient(height)) * RATE**2
    # the ends of the difference are rough
    upwards = upwards[2:-2]
    place = int(np.argmax(upwards))
    stands_out = float(upwards[place] - max(upwards[0], upwards[-1]))
    weight = rules.knock_weight * min(stands_out / rules.knock, 1.0)
    knock = (peak + place) / RATE + rules.knock_later if peak >= 2 else first
    return first + weight * (knock - first)


def _with_rise(toe: Floats, peak: int, first: float, rules: EventRules) -> float:
    """s: the mean of the first estimate of an off and that by the fastest rise of the toe."""
    begin, end = max(peak - round(RATE * 0.06), 0), peak + round(RATE * 0.12)
    rise = np.gradient(toe[begin : end + 1, 2])
    fastest = int(np.argmax(rise))
    # A rise that goes on behind the end is of another movement.
    if fastest in (0, len(rise) - 1):
        return first
    return 0.5 * (first + (begin + fastest) / RATE - rules.rise_earlier)


def plate_contacts(recording: Recording, feet: Feet, plates: Sequence[ForcePlate], rules: EventRules | None = None) -> list[PlateContact]:
    """Each time that a plate is loaded for 0.2 s or more, and by which foot. O(samples)."""
    found = []
    for plate in plates:
        pressure = rotate_z_up(plate.pressure, recording.vertical)
        for begin, end in _loaded(plate):
            side = _foot_on(pressure, plate.rate, begin, end, feet, rules or EventRules())
            found.append(PlateContact(plate.number, side, begin / plate.rate, end / plate.rate))
    return found


def _by_plates(recording: Recording, feet: Feet, plates: Sequence[ForcePlate], rules: EventRules) -> list[GaitEvent]:
    found = []
    duration = {plate.number: len(plate.force) / plate.rate for plate in plates}
    for contact in plate_contacts(recording, feet, plates, rules):
        if contact.side is None:
            continue
        source = f"plate {contact.plate}"
        if contact.begins > 0:
            found.append(GaitEvent(contact.side, STRIKE, contact.begins, rules.plate_sigma, source))
        if contact.ends < duration[contact.plate]:
            found.append(GaitEvent(contact.side, OFF, contact.ends, rules.plate_sigma, source))
    return found


def _loaded(plate: ForcePlate) -> list[tuple[int, int]]:
    """First sample and the one behind the last of each time that somebody is on a plate for 0.2 s or more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], plate.loaded, [False]]).astype(int)))
    pieces: list[tuple[int, int]] = []
    for begin, end in edges.reshape(-1, 2).tolist():
        # a load that flickers about the threshold is one
        if pieces and begin - pieces[-1][1] < 0.03 * plate.rate:
            pieces[-1] = (pieces[-1][0], end)
        else:
            pieces.append((begin, end))
    return [(begin, end) for begin, end in pieces if end - begin > 0.2 * plate.rate]


def _foot_on(pressure: Floats, rate: float, begin: int, end: int, feet: Feet, rules: EventRules) -> str | None:
    """The side of the foot that is alone on a plate between two samples; None where it is not one foot."""
    samples = np.linspace(begin + 0.15 * (end - begin), begin + 0.85 * (end - begin), 9).astype(int)
    moments = np.clip((samples / rate * RATE).astype(int), 0, len(feet.times) - 1)
    apart = {}
    for side in feet.sides:
        heel, toe = feet.heels[side][moments, :2], feet.toes[side][moments, :2]
        along = toe - heel
        share = np.clip(((pressure[samples, :2] - heel) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-9), -0.1, 1.4)
        apart[side] = float(np.nanmedian(np.linalg.norm(pressure[samples, :2] - heel - share[:, None] * along, axis=1)))
    side = min(apart, key=apart.__getitem__)
    others = [value for name, value in apart.items() if name != side]
    return side if apart[side] < rules.foot_off_line and all(value > rules.foot_off_line for value in others) else None


def _in_order(events: Sequence[GaitEvent]) -> list[GaitEvent]:
    """Strikes and offs of one foot by turns: of two of a kind in a row the less certain, or else the later, goes."""
    kept: list[GaitEvent] = []
    for event in sorted(events, key=lambda one: one.time):
        if kept and kept[-1].label == event.label:
            if event.sigma < kept[-1].sigma:
                kept[-1] = event
            continue
        kept.append(event)
    return kept


def _on_treadmill(feet: Feet, events: Sequence[GaitEvent]) -> bool:
    """Whether feet that stand move backwards as fast as the pelvis is overtaken: then the floor moves."""
    slid = []
    for side in feet.sides:
        own = sorted((event for event in events if event.side == side), key=lambda event: event.time)
        for strike, off in pairwise(own):
            if strike.label == STRIKE and off.label == OFF:
                middle = [int(RATE * (strike.time + share * (off.time - strike.time))) for share in (0.3, 0.6)]
                moved = [points[middle[1]] - points[middle[0]] for points in (feet.heels[side], feet.pelvis)]
                slid.append(np.linalg.norm(moved[0][:2]) - np.linalg.norm(moved[1][:2]))
    return bool(slid) and float(np.median(slid)) > 0.0
