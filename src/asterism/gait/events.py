"""Feet over time, and force plates where they are, in; strikes and offs with how certain they are, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from asterism.gait.feet import RATE, Feet, feet_of
from asterism.geometry import rotate_z_up, z_up_rotation
from asterism.motion.clinical.kinetics import PlateContact
from asterism.recording import Event, Floats, ForcePlate, Recording
from asterism.recording.plate_feet import foot_on

STRIKE, OFF = "Foot Strike", "Foot Off"
"""As C3D files call them."""
SIDE_NAMES = {"L": "Left", "R": "Right"}


@dataclass(frozen=True)
class EventRules:
    """How events are found.

    Times are means over half of the people whom the benchmark knows, every second by name, against what their files say: plates, and
    strikes set by hand, which come 10 to 30 ms before those of plates. So strikes are 5 ms early against plates alone. The weights are
    those that were best on that half; at half and at double of each the errors of strikes change by 1 ms or less, but those of
    turns by 6 with twice `knock_within`, and those of shuffling feet by 8 and 10 with `fallen`.

    strike_later, off_later    s, from the moment when a heel is farthest ahead of the pelvis (a toe farthest behind) to the strike (off)
    knock_within, knock_later  s behind that moment in which a heel's knock on the floor, the peak of its upward acceleration, is
                               sought, and from the peak to the strike
    knock                      m/s2 by which a peak stands above its surroundings to be a knock; less counts in proportion
    noise                      standard deviations of the markers' noise (`Feet.noise`) that count beside `knock` and `slap`: what noise
                               makes stand out is neither. Of clean recordings nothing changes. With 1 mm of noise strikes of people who
                               shuffle are 14 ms off, 19 where this is 0; 15 at half and 14 at double
    slap_later, slap           s, from the fastest fall of the toe against the heel to the strike, and rad/s by which it stands out
    down                       m that a heel may still fall behind a slap: a foot turns about its heel only when the heel is on the floor,
                               and heels give way by a millimetre. A slap counts less the more is left. In turns, whose slaps before that
                               are 10 to 50 ms early, errors are the same at half and at double
    knock_weight, slap_weight  of a clear knock and slap, beside 1 for the moment when the heel is farthest ahead
    fallen, fallen_later       m above where it stands, and s from the moment when a heel has fallen so low to the strike: what tells flat
                               feet, which neither knock nor slap; in place of the heel farthest ahead, whose time differs by 23 ms between
                               two people who shuffle, this one's by 11
    flat_halt_later            s, from the peak of the jerk with which the heel halts to the strike, of flat feet; counts as `fallen` does
    belt_later, halt_later     s, on a treadmill: from the heel farthest ahead, and from the peak of that jerk, to the strike; they count
                               alike
    apart                      s by which what tells an event may differ from the rest until it counts half (Cauchy's weights). At half and
                               at double errors change by less than 1 ms
    rise_earlier               s, from the fastest rise of the toe back to the off; counts as much as the first estimate
    strike_sigma, off_sigma    s, standard deviation of strikes and offs on which all that tells them agrees: most of it is how laboratories
                               set them. What they differ by is added
    ankle_sigma                s, what an ankle's marker in place of the heel's adds to strikes; those of `movement` are 19 ms off by it, 11
                               by the heel
    plate_sigma                s, of events told by a plate: a sample of it, and how a threshold of 20 N reads
    least_step                 of the usual step: shorter swings ahead are no steps. At double, the last steps before a halt are missed; at
                               half, `least_swing` decides alone
    least_swing                of the leg: a foot that moves less against the pelvis stands. At half, a sway of a foot that stands is a
                               step; at double, shuffling steps of 8 cm are missed
    near                       s, within which an event of a plate and one of the markers are the same
    leaves, leaves_in          m that heel and toe both move at least from where they stood, between an off and the next strike, and s in
                               which they do so; in less time less is asked in proportion. Feet that stand through squats, blows and
                               swings of a golf club move by 0 to 4 cm (one that turns about its toe), those of the smallest steps of
                               `movement` by 11 cm. At half, blows are steps; at double, shuffling steps of 8 cm are missed
    in_the_air                 of the leg, above where it then stands, at which heel and toe of a foot that strikes still swing, as in a
                               kick. At half, strikes on stairs are moved; at double, feet that march low on the spot strike in the air
    lands                      m above where it then stands, at which such a foot strikes; at half and double that is 10 ms later and sooner
    stays, still               s behind an off in which a foot moves by so many m at least; one that does not leaves so much before it has
                               gone so far as `leaves` says. Feet of `movement` that step go 3 cm in 0.05 s. At half of `stays` and at
                               double of `still` feet on the slowest belts, which carry them along by 2 cm, are held for standing
    moved_sigma                s, standard deviation of events that are told by these
    level                      m by which a foot rises at most in the middle of a stance on a belt. Those who walk and run on belts rise
                               by 0.1 to 1.3 cm, those on pedals by 3 to 8, those who jump on the spot by 4. At half, who jogs has no
                               events; at double, who jumps has
    beside                     m, by which a marker of heel or toe may stand over the edge of a plate that the sole's end is still on. At
                               half, one of 173 events of plates at hand is told by markers instead; at double no other is
    """

    strike_later: float = 0.045
    off_later: float = -0.010
    knock_within: float = 0.09
    knock_later: float = -0.006
    knock: float = 2.0
    noise: float = 6.0
    knock_weight: float = 2.0
    slap_later: float = -0.011
    slap: float = 1.5
    down: float = 0.002
    slap_weight: float = 4.0
    fallen: float = 0.04
    fallen_later: float = 0.158
    flat_halt_later: float = -0.016
    belt_later: float = 0.040
    halt_later: float = 0.006
    apart: float = 0.025
    rise_earlier: float = 0.027
    strike_sigma: float = 0.011
    off_sigma: float = 0.012
    ankle_sigma: float = 0.018
    plate_sigma: float = 0.004
    least_step: float = 0.12
    least_swing: float = 0.05
    near: float = 0.12
    leaves: float = 0.04
    leaves_in: float = 0.3
    in_the_air: float = 0.08
    lands: float = 0.02
    stays: float = 0.1
    still: float = 0.01
    moved_sigma: float = 0.05
    level: float = 0.025
    beside: float = 0.03


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
    """The events of a recording in the order of time, its feet, and whether they are on a treadmill.

    backwards  whether the person goes where the heels point, so that no events are told
    """

    events: tuple[GaitEvent, ...]
    feet: Feet
    treadmill: bool
    backwards: bool = False

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

    A heel is farthest ahead of the pelvis just before it strikes, a toe farthest behind about when it leaves (Zeni et al. 2008). Others
    make both more exact, each as far as it stands out: the heel's knock on the floor (as Hreljac and Marshall 2000), the toe's slap
    behind it, the height of the heel (as Desailly et al. 2009 compare), the toe's fastest rise (as O'Connor et al. 2007). On a treadmill,
    whose belt gives way, knock and slap are late, and the jerk with which the heel halts counts instead. What these differ by is part of
    an event's uncertainty. "Ahead" is where the feet point,
    so that turns and treadmills count as straight walks do. Events that break the order strike, off, strike are left out, the less
    certain first; so are those between which a foot stays where it stood, while the pelvis moves. O(T). Raises AsterismError where the
    feet's or the pelvis' markers are missing.

    >>> from asterism.simulation import simulate_walks
    >>> walking = find_events(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0])
    >>> len(walking.of("L", STRIKE)) >= 2
    True
    """
    rules = rules or EventRules()
    feet = feet_of(recording)
    if feet.backwards:
        # a heel that goes first strikes last: none of the rules holds
        return Walking((), feet, treadmill=False, backwards=True)
    found = [event for side in feet.sides for event in events_by_markers(feet, side, rules, belt=False)]
    if _on_treadmill(feet, found, rules):
        found = [event for side in feet.sides for event in events_by_markers(feet, side, rules, belt=True)]
    last = float(feet.times[-1])
    # Of a foot on two plates the first load is its strike, and the last its off: each that comes later here replaces one before.
    for event in sorted(_by_plates(recording, feet, plates, rules), key=lambda one: -one.time if one.label == STRIKE else one.time):
        same = [one for one in found if (one.side, one.label) == (event.side, event.label) and abs(one.time - event.time) < rules.near]
        # A plate knows when, the markers whether: what they do not show is another person's foot, or an object.
        if same:
            found.remove(min(same, key=lambda one: abs(one.time - event.time)))
            found.append(event)
    of_sides = {side: _in_order([one for one in found if one.side == side]) for side in feet.sides}
    kept = [event for side, own in of_sides.items() for event in _as_it_goes(feet, side, _of_swings(feet, side, own, rules), rules)]
    inside = [event for event in kept if 0.0 <= event.time <= last]
    walking = Walking(tuple(sorted(inside, key=lambda event: event.time)), feet, _on_treadmill(feet, inside, rules))
    # where the pelvis stays in its place, only the feet tell
    if walking.treadmill and _stands_in_the_air(walking):
        return Walking((), feet, treadmill=True, backwards=True)
    return Walking((), feet, treadmill=False) if walking.treadmill and _goes_round(walking, rules) else walking


def events_by_markers(feet: Feet, side: str, rules: EventRules, belt: bool) -> list[GaitEvent]:
    """All strikes, and then all offs, that the curves of one foot tell; belt: whether the floor moves. O(T)."""
    ahead = feet.forward(feet.heels[side])
    strikes, offs = (_turning_points(curve, feet, rules) for curve in (ahead, -feet.forward(feet.toes[side])))
    told = _told_on_belt(ahead, strikes, rules) if belt else _told_on_floor(feet, side, ahead, strikes, rules)
    found = [_agreed(side, STRIKE, one, rules) for one in told]
    if side in feet.ankles:
        found = [replace(one, sigma=float(np.hypot(one.sigma, rules.ankle_sigma))) for one in found]
    for peak in offs:
        first, rise = float(feet.times[peak]) + rules.off_later, _rise(feet.toes[side], peak)
        found.append(_agreed(side, OFF, [(first, 1.0), *([] if rise is None else [(rise - rules.rise_earlier, 1.0)])], rules))
    return found


def _agreed(side: str, label: str, told: Sequence[tuple[float, float]], rules: EventRules) -> GaitEvent:
    """An event from times (s) that tell it and their weights: their mean, in which those far from the rest count less.

    Its uncertainty is what they differ by, beside what is left where they agree.
    """
    times, weights = np.array(told).T
    counts = weights
    for _ in range(5):
        time = float(times @ counts / counts.sum())
        counts = weights / (1.0 + ((times - time) / rules.apart) ** 2)
    spread = np.sqrt(counts @ (times - time) ** 2 / counts.sum())
    sigma = rules.strike_sigma if label == STRIKE else rules.off_sigma
    return GaitEvent(side, label, time, float(np.hypot(sigma, spread)), "markers")


_DROP = 0.001
"""m: a curve that falls less to an end of the recording may turn there by the filter alone. At double, strikes 20 ms from an end go."""


def _turning_points(curve: Floats, feet: Feet, rules: EventRules) -> list[int]:
    """Samples at which a foot turns back; near an end of the recording what it has gone on the other side decides."""
    usual = float(np.percentile(curve, 95) - np.percentile(curve, 5))
    # a foot that moves by less than a twentieth of the leg stands
    least = max(rules.least_step * usual, rules.least_swing * feet.leg_length)
    beyond = [curve.min() - 2 * least]
    peaks, _ = find_peaks(np.concatenate([beyond, curve, beyond]), prominence=least, distance=int(0.25 * RATE))
    # the lowest that came before, and that comes after: with a look at all samples for each step, memory goes with the square of a walk
    before, after = np.minimum.accumulate(curve), np.minimum.accumulate(curve[::-1])[::-1]
    tops = [(peak, curve[peak], before[max(peak - 1, 0)], after[min(peak + 1, len(curve) - 1)]) for peak in (peaks - 1).tolist()]
    drops = [(peak, max(top - earlier, 0.0), max(top - later, 0.0)) for peak, top, earlier, later in tops]
    # The highest point of all is only a peak where the curve itself, not what was put beyond its ends, falls.
    return [peak for peak, before, after in drops if min(before, after) > _DROP and max(before, after) >= least]


def _told_on_belt(ahead: Floats, peaks: Sequence[int], rules: EventRules) -> list[list[tuple[float, float]]]:
    """Times and weights that tell the strike at each sample at which a heel is farthest ahead (T,), on a treadmill."""
    jerk = np.gradient(np.gradient(np.gradient(ahead)))
    halts = [_stands_out(jerk, peak, -0.02, 0.10)[0] for peak in peaks]
    return [
        [(peak / RATE + rules.belt_later, 1.0), *([] if halt is None else [(halt + rules.halt_later, 1.0)])]
        for peak, halt in zip(peaks, halts, strict=True)
    ]


def _told_on_floor(feet: Feet, side: str, ahead: Floats, peaks: Sequence[int], rules: EventRules) -> list[list[tuple[float, float]]]:
    """Times and weights that tell the strike at each sample at which a heel is farthest ahead (T,): each as far as it stands out."""
    heel, foot = feet.heels[side], feet.toes[side] - feet.heels[side]
    upwards = np.gradient(np.gradient(heel[:, 2])) * RATE**2
    falls = -np.gradient(np.arctan2(foot[:, 2], np.linalg.norm(foot[:, :2], axis=1))) * RATE
    floor = float(np.percentile(heel[:, 2], 5))
    # of the speed over the floor
    jerk = np.gradient(np.gradient(np.linalg.norm(np.gradient(heel[:, :2], axis=0), axis=1)))
    least = [float(np.hypot(usual, rules.noise * noise)) for usual, noise in zip((rules.knock, rules.slap), feet.noise[side], strict=True)]
    found = []
    for peak in peaks:
        knock, knocks = _stands_out(upwards, peak, 0.0, rules.knock_within)
        slap, slaps = _stands_out(falls, peak, -0.01, 0.13)
        left = 0.0 if slap is None else _fall_left(heel[:, 2], slap)
        clear = [min(knocks / least[0], 1.0), min(slaps / least[1], 1.0) * max(1.0 - left / rules.down, 0.0)]
        told = [
            (knock, rules.knock_later, rules.knock_weight * clear[0]),
            (slap, rules.slap_later, rules.slap_weight * clear[1]),
            (peak / RATE, rules.strike_later, max(clear)),
            (_fallen(heel[:, 2], peak, rules.fallen, floor), rules.fallen_later, 1.0 - max(clear)),
            (_stands_out(jerk, peak, -0.02, 0.14)[0], rules.flat_halt_later, 1.0 - max(clear)),
        ]
        known = [(time + later, weight) for time, later, weight in told if time is not None and weight > 0]
        found.append(known or [(peak / RATE + rules.strike_later, 1.0)])
    return found


def _fall_left(height: Floats, time: float) -> float:
    """m that a heel still falls within 0.12 s, half a stance of quick steps, from a time on."""
    begin = min(round(time * RATE), len(height) - 1)
    return float(height[begin] - height[begin : begin + round(0.12 * RATE)].min())


def _stands_out(curve: Floats, peak: int, begins: float, ends: float) -> tuple[float | None, float]:
    """s of the highest point from `begins` to `ends` (s) behind a sample, and by how much it stands above both ends; None, 0 at an end."""
    begin = max(peak + round(begins * RATE), 0)
    part = curve[begin : peak + round(ends * RATE) + 1]
    place = int(np.argmax(part)) if len(part) else 0
    if not 0 < place < len(part) - 1:
        return None, 0.0
    before, top, after = part[place - 1 : place + 2]
    bend = before - 2 * top + after
    between = 0.5 * (before - after) / bend if bend else 0.0
    return (begin + place + between) / RATE, float(top - max(part[0], part[-1]))


def _fallen(heights: Floats, peak: int, above: float, floor: float) -> float | None:
    """s when a heel falls for the last time to a height `above` m, from 0.3 s before a sample; None where it does not.

    Above where it stands in the stance that follows, or the floor where the recording ends before. One that is higher when it is farthest
    ahead comes down behind the toe.
    """
    stands = heights[peak + round(0.1 * RATE) : peak + round(0.35 * RATE)]
    if len(stands) > round(0.05 * RATE):
        floor = float(np.percentile(stands, 20))
    begin = max(peak - round(0.3 * RATE), 0)
    part = heights[begin : peak + 1] - floor - above
    falls = np.flatnonzero((part[:-1] > 0) & (part[1:] <= 0))
    if not len(falls):
        return None
    place = int(falls[-1])
    return float(begin + place + part[place] / (part[place] - part[place + 1])) / RATE


def _rise(toe: Floats, peak: int) -> float | None:
    """s of the fastest rise of a toe that is farthest behind at a sample; None where it goes on behind the end, of another movement."""
    begin, end = max(peak - round(RATE * 0.06), 0), peak + round(RATE * 0.12)
    rise = np.gradient(toe[begin : end + 1, 2])
    fastest = int(np.argmax(rise))
    return None if fastest in (0, len(rise) - 1) else (begin + fastest) / RATE


def plate_contacts(recording: Recording, feet: Feet, plates: Sequence[ForcePlate]) -> list[PlateContact]:
    """Each time that somebody stands on a plate, and by which foot; None where it is not one foot. O(samples)."""
    # back to the axes of the recording and its plates
    axes = z_up_rotation(recording.vertical)
    markers = {side: np.stack([feet.heels[side], feet.toes[side]], axis=1) @ axes for side in feet.sides}
    found = []
    for plate in plates:
        for contact in plate.contacts:
            side = foot_on(plate, contact, markers, RATE)
            found.append(
                PlateContact(plate.number, side if side in markers else None, contact.start / plate.rate, contact.stop / plate.rate)
            )
    return found


def _by_plates(recording: Recording, feet: Feet, plates: Sequence[ForcePlate], rules: EventRules) -> list[GaitEvent]:
    found = []
    by_number = {plate.number: plate for plate in plates}
    duration = {plate.number: len(plate.force) / plate.rate for plate in plates}
    for contact in plate_contacts(recording, feet, plates):
        if contact.side is None:
            continue
        source, corners = f"plate {contact.plate}", rotate_z_up(by_number[contact.plate].corners, recording.vertical)[:, :2]
        # A heel that strikes beside a plate loads it only when the sole follows; so does a toe that leaves beside it.
        if contact.begins > 0 and _within(corners, feet.heels[contact.side], contact.begins, rules):
            found.append(GaitEvent(contact.side, STRIKE, contact.begins, rules.plate_sigma, source))
        if contact.ends < duration[contact.plate] and _within(corners, feet.toes[contact.side], contact.ends, rules):
            found.append(GaitEvent(contact.side, OFF, contact.ends, rules.plate_sigma, source))
    return found


def _within(corners: Floats, points: Floats, time: float, rules: EventRules) -> bool:
    """Whether a curve (T, 3) is over a plate (4, 2), or nearly, at a time."""
    arm = points[min(round(RATE * time), len(points) - 1), :2] - corners.mean(axis=0)
    edges = (corners[0] - corners[1], corners[0] - corners[3])
    return all(abs(arm @ edge) <= np.linalg.norm(edge) * (0.5 * np.linalg.norm(edge) + rules.beside) for edge in edges)


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


def _of_swings(feet: Feet, side: str, events: Sequence[GaitEvent], rules: EventRules) -> list[GaitEvent]:
    """Those of one foot's events, which come by turns, between which it leaves its place: what is ahead of a moving pelvis may stand."""
    ends = [None, *events, None] if events and events[0].label == STRIKE else [*events, None]
    swings = zip(ends[::2], ends[1::2], strict=False)
    return [one for swing in swings if _leaves(feet, side, *swing, rules) for one in swing if one is not None]


def _leaves(feet: Feet, side: str, off: GaitEvent | None, strike: GaitEvent | None, rules: EventRules) -> bool:
    """Whether a foot moves as a whole from where it stood; None for what lies beyond an end of the recording."""
    last = len(feet.times) - 1
    begin = 0 if off is None else min(max(round(RATE * off.time), 0), last)
    end = last if strike is None else min(max(round(RATE * strike.time), 0), last)
    stood = end if off is None else begin
    ways = [np.linalg.norm(points[begin : end + 1] - points[stood], axis=1) for points in (feet.heels[side], feet.toes[side])]
    # one end alone turns about the other, which stands
    return bool(np.minimum(*ways).max(initial=0.0) >= rules.leaves * min((end - begin) / (RATE * rules.leaves_in), 1.0)) and end > begin


def _as_it_goes(feet: Feet, side: str, events: Sequence[GaitEvent], rules: EventRules) -> list[GaitEvent]:
    """One foot's events by turns, those moved that the foot itself contradicts.

    Who kicks, or marches on the spot, swings a foot back before it comes down, and leaves it where it is before it goes up.
    """
    found, last = list(events), len(feet.times) - 1
    parts = feet.heels[side], feet.toes[side]
    for number, event in enumerate(events):
        begin = min(max(round(RATE * event.time), 0), last)
        end = min(max(round(RATE * events[number + 1].time), begin), last) if number + 1 < len(events) else last
        if event.source != "markers":
            continue
        if event.label == STRIKE:
            above = np.minimum(*(part[begin : end + 1, 2] - part[begin : end + 1, 2].min() for part in parts))
            moved = int(np.argmax(above <= rules.lands)) if above[0] > rules.in_the_air * feet.leg_length else 0
        else:
            gone = np.minimum(*(np.linalg.norm(part[begin : end + 1] - part[begin], axis=1) for part in parts))
            stays = round(RATE * rules.stays)
            # a belt carries a foot along that stands
            still = len(gone) > stays and gone[: stays + 1].max() < rules.still
            moved = max(int(np.argmax(gone > rules.leaves)) - stays, 0) if still else 0
        if moved > 0:
            found[number] = replace(event, time=(begin + moved) / RATE, sigma=rules.moved_sigma)
    return found


def _goes_round(walking: Walking, rules: EventRules) -> bool:
    """Whether feet that seem to be carried along are not level: those on pedals go round, and those of who jumps on the spot go up."""
    stances, swings = list[float](), list[float]()
    for side in walking.feet.sides:
        heights = np.stack([walking.feet.heels[side][:, 2], walking.feet.toes[side][:, 2]], axis=1)
        for one, other in pairwise(event for event in walking.events if event.side == side):
            begin, end = (int(RATE * (one.time + share * (other.time - one.time))) for share in LEVEL_IN)
            (stances if one.label == STRIKE else swings).append(rise_of_foot(heights[begin : end + 1]))
    return is_no_stance(stances, swings, rules)


LEVEL_IN = (0.2, 0.8)
"""Of a stance, between which a foot is level, and of a swing, between which it rises: before, the toe comes down; behind, the heel is up
and the off may be told late. Half as far from the ends as here, sprints are not level; twice as far, short cranks are."""
_LEVEL = 0.3
"""Of the rise of a swing, by which a foot that stands is level: 0.1 to 0.2 in runs, 0.27 where their events are told live, 0.3 to 0.4 on
pedals, 0.9 in jumps on the spot. At half, runs are not level live; at double, pedals are."""


def rise_of_foot(heights: Floats) -> float:
    """m, from the lowest to the highest of heel or toe (T, 2), whichever is less; 0 where nothing is known."""
    known = heights[np.isfinite(heights).all(axis=1)]
    return float(np.ptp(known, axis=0).min()) if len(known) else 0.0


def is_no_stance(stances: Sequence[float], swings: Sequence[float], rules: EventRules) -> bool:
    """Whether stances rise by too much for a floor or a belt, beside swings; both m, as `rise_of_foot` tells."""
    least = max(rules.level, _LEVEL * float(np.median(swings))) if len(swings) else rules.level
    return len(stances) > 0 and float(np.median(stances)) > least


def _stands_in_the_air(walking: Walking) -> bool:
    """Whether feet are higher between strike and off than between off and strike: somebody who walks backwards swings them there."""
    feet, higher = walking.feet, []
    for side in feet.sides:
        heights = 0.5 * (feet.heels[side] + feet.toes[side])[:, 2]
        own = [event for event in walking.events if event.side == side]
        means = [float(heights[int(RATE * one.time) : int(RATE * other.time) + 1].mean()) for one, other in pairwise(own)]
        higher += [
            (mean - following) * (1.0 if one.label == STRIKE else -1.0) for one, mean, following in zip(own, means, means[1:], strict=False)
        ]
    return bool(higher) and float(np.median(higher)) > 0.0


def _on_treadmill(feet: Feet, events: Sequence[GaitEvent], rules: EventRules) -> bool:
    """Whether feet that stand move along where they point by more than the pelvis moves: then the floor moves."""
    slid = []
    for side in feet.sides:
        own = sorted((event for event in events if event.side == side), key=lambda event: event.time)
        for strike, off in pairwise(own):
            if strike.label == STRIKE and off.label == OFF:
                middle = [int(RATE * (strike.time + share * (off.time - strike.time))) for share in (0.3, 0.6)]
                foot, pelvis = ((points[middle[1]] - points[middle[0]])[:2] for points in (feet.heels[side], feet.pelvis))
                slid.append(slides(foot, pelvis, feet.ahead[middle[0]]))
    return bool(slid) and float(np.median(slid)) > rules.still


def slides(foot: Floats, pelvis: Floats, ahead: Floats) -> float:
    """m by which the way (2,) of a foot that stands, along where feet point (2,), is longer than that of the pelvis: a belt carries it.

    Who walks backwards on a belt slides ahead; feet that jump apart and together go across.
    """
    return abs(float(foot @ ahead)) - float(np.linalg.norm(pelvis))
