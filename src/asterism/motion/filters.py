"""Trajectories in; the same low-pass filtered without lag, and what that changed, out; samples that jump away and back are found.

Butterworth filters with residual analysis of Winter (2009, ch. 3.4); quintic splines with generalised cross-validation of Woltring (1986).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import dct
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.motion.splines import LEAST, quintic_spline_and_power, spline_cut_off
from asterism.recording import Floats, Ints, Recording, is_unnamed

NONE, BUTTERWORTH, SPLINE = "none", "butterworth", "spline"
_ACTION = "filtered"
_TWO_PASSES = (math.sqrt(2.0) - 1.0) ** 0.25
"""By which two passes of a Butterworth filter of second order lower the frequency of which 71 % is left (Winter 2009)."""
_HIGHEST = 0.4
"""Of the rate, the highest cut-off: beyond it the filter's own ends are all that changes."""


@dataclass(frozen=True)
class FilterChoice:
    """What is done to trajectories: `NONE`, `BUTTERWORTH` or `SPLINE`.

    cut_off  Hz, of which two passes of a Butterworth filter leave 71 %; None for that of each marker's residual analysis
    """

    method: str = NONE
    cut_off: float | None = None

    @classmethod
    def of(cls, text: str) -> FilterChoice:
        """From words as the command line has them. Raises AsterismError for others.

        >>> FilterChoice.of("butterworth:6")
        FilterChoice(method='butterworth', cut_off=6.0)
        """
        method, _, value = text.partition(":")
        if method in (NONE, SPLINE, BUTTERWORTH) and (not value or method == BUTTERWORTH):
            if not value:
                return cls(method)
            try:
                cut_off = float(value)
            except ValueError:
                cut_off = math.nan
            if math.isfinite(cut_off) and cut_off > 0.0:
                return cls(method, cut_off)
        raise AsterismError(f"--filter {text}: give none, spline, butterworth, or butterworth with its cut-off in Hz: butterworth:6.")

    def __str__(self) -> str:
        return self.method if self.cut_off is None else f"{self.method}:{self.cut_off:g}"


@dataclass(frozen=True)
class MarkerEffect:
    """What a filter did to one marker.

    moved    m, RMS over its samples
    cut_off  Hz of which 71 % is left, the median over its pieces between gaps; NaN where each is too short to filter
    spikes   samples that jumped away and back, and were replaced
    """

    label: str
    moved: float
    cut_off: float
    spikes: int


@dataclass(frozen=True)
class FilteredRecording:
    """A filtered recording; the choice; what it did to each marker, none where nothing was filtered; spikes, whether replaced or not."""

    recording: Recording
    choice: FilterChoice
    effects: tuple[MarkerEffect, ...]
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        """One sentence for a person.

        >>> str(FilteredRecording(Recording(np.zeros((1, 1, 3)), ("LKNE",), 100.0), FilterChoice(), (), ()))
        'not filtered'
        """
        if self.choice.method == NONE:
            return "not filtered"
        if not self.span:
            return f"not filtered, having no marker with {LEAST} frames in a row"
        how = "a smoothing spline" if self.choice.method == SPLINE else "a Butterworth filter without lag"
        moved = 1000.0 * math.sqrt(sum(effect.moved**2 for effect in self.effects) / len(self.effects))
        return f"filtered by {how}, cut-off {self.span}; markers moved by {moved:.2f} mm (RMS)"

    @property
    def span(self) -> str:
        """The least and the largest cut-off, such as "6 to 14 Hz"; empty where nothing was filtered."""
        cut_offs = [effect.cut_off for effect in self.effects if math.isfinite(effect.cut_off)]
        if not cut_offs:
            return ""
        few, many = (_hertz(cut_off) for cut_off in (min(cut_offs), max(cut_offs)))
        return f"{few} Hz" if few == many else f"{few} to {many} Hz"


def _hertz(cut_off: float) -> str:
    """In whole Hz, below 3 Hz with two digits: "0 Hz" would say that nothing is left."""
    return f"{cut_off:.2g}" if cut_off < _SLOW else f"{cut_off:.0f}"


def filter_trajectories(recording: Recording, choice: FilterChoice, by: str = "") -> FilteredRecording:
    """Filter all named markers, each piece between gaps for itself, and find spikes.

    by  what goes into the processing log, such as the program and its version; by marker, it holds cut-off in Hz, RMS in mm and spikes

    Spikes are replaced by cubics through two samples on either side before the filter, and only said where nothing is filtered. Pieces of
    less than 12 frames stay as they are. O(T M). Raises AsterismError where a cut-off is beyond 0.4 of the rate.

    >>> from asterism.simulation import simulate_walks
    >>> [walk] = simulate_walks(subjects=1, frames=100)
    >>> [effect.cut_off for effect in filter_trajectories(walk, FilterChoice("butterworth", 6.0)).effects][:1]
    [6.0]
    """
    if choice.cut_off is not None and choice.cut_off > _HIGHEST * recording.rate:
        raise AsterismError(
            f"a cut-off of {choice.cut_off:g} Hz is too high at {recording.rate:g} Hz; give {_HIGHEST * recording.rate:g} Hz or less."
        )
    positions, effects, found = recording.positions.copy(), list[MarkerEffect](), list[tuple[str, Ints, float]]()
    samples = int(recording.visible.sum())
    for column, label in enumerate(recording.labels):
        path = positions[:, column]
        if is_unnamed(label) or not np.isfinite(path[:, 0]).any():
            continue
        spikes = find_spikes(path, recording.rate, samples)
        found += [(label, spike, float(np.linalg.norm(path[spike] - _across(path, spike), axis=1).max())) for spike in spikes]
        if choice.method == NONE:
            continue
        for spike in spikes:
            path[spike] = _across(path, spike)
        cut_offs = list[float]()
        for begin, end in _pieces(path):
            if end - begin >= LEAST:
                path[begin:end], cut_off = _filtered(path[begin:end], recording.rate, choice)
                cut_offs.append(cut_off)
        moved = float(np.sqrt(np.nanmean(((path - recording.positions[:, column]) ** 2).sum(axis=1))))
        effects.append(MarkerEffect(label, moved, float(np.median(cut_offs)) if cut_offs else math.nan, sum(map(len, spikes))))
    result = recording
    if effects:
        told = {e.label: [round(e.cut_off, 2) if math.isfinite(e.cut_off) else None, round(1000.0 * e.moved, 3), e.spikes] for e in effects}
        result = replace(recording, positions=positions).logged(_ACTION, by, filter=str(choice), markers=told)
    spiked = [_spike_finding(recording, found, choice.method != NONE)] if found else []
    return FilteredRecording(result, choice, tuple(effects), (*spiked, *_strong(recording, effects)))


_SLOW = 3.0
"""Hz below which half a Hz is a sixth of the cut-off or more."""
_STRONG = 0.010
"""m, RMS, by which a filter may move a marker: noise and soft tissue are less. 6 Hz move a runner's foot by 8, 3 Hz a walker's by 10,
1 Hz by 80. At half, 6 Hz for a runner are told; at double, 2 Hz for a walker are not."""


def _strong(recording: Recording, effects: Sequence[MarkerEffect]) -> list[Finding]:
    """Where the filter takes away movement."""
    most = max(effects, key=lambda effect: effect.moved, default=None)
    if most is None or most.moved <= _STRONG:
        return []
    file = str(recording.metadata.get("file", "the recording"))
    sentence = f"{file}: the filter moves {most.label} by {1000 * most.moved:.0f} mm (RMS), more than noise: it takes away movement."
    return [Finding("filter-strong", Severity.WARNING, file, sentence, "Give a higher cut-off, 6 Hz or more for gait.")]


def last_filter(recording: Recording) -> FilteredRecording:
    """What the processing log says of the last filter: none where nothing was filtered. Without findings."""
    for step in reversed(recording.log):
        if step.action != _ACTION:
            continue
        # A log is a note that anybody may have edited.
        try:
            effects = [
                MarkerEffect(str(label), float(moved) / 1000.0, math.nan if cut_off is None else float(cut_off), int(spikes))
                for label, (cut_off, moved, spikes) in dict(step.settings["markers"]).items()
            ]
            return FilteredRecording(recording, FilterChoice.of(str(step.settings["filter"])), tuple(effects), ())
        except (AsterismError, KeyError, TypeError, ValueError):
            continue
    return FilteredRecording(recording, FilterChoice(), (), ())


def zero_lag_butterworth(values: Floats, rate: float, cut_off: float) -> Floats:
    """Values (T, ...) without gaps through a Butterworth filter of second order, forwards and backwards; as given beyond 0.45 of the rate.

    cut_off  Hz of one pass: of its frequency half is left
    """
    if cut_off >= 0.45 * rate:
        return values
    sections = _sections(cut_off / (0.5 * rate))
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=min(len(values) - 1, int(2 * rate / cut_off))))


@lru_cache(maxsize=64)
def _sections(share: float) -> Floats:
    """Of a Butterworth filter of second order whose cut-off is this share of half the rate: all curves of a recording share it."""
    return np.asarray(butter(2, share, output="sos"))


def _of_one_pass(cut_off: float, rate: float) -> float:
    """Hz, the cut-off of one pass that makes that of two; a digital filter's frequencies are those of the bilinear transform."""
    return rate / math.pi * math.atan(math.tan(math.pi * cut_off / rate) / _TWO_PASSES)


def residual_cut_off(path: Floats, rate: float) -> float:
    """Hz: where what a filter takes off is as much as the noise that a line through the highest cut-offs foretells (Winter 2009).

    path  (T, 3) without gaps
    """
    highest, count = min(_HIGHEST * rate, _WINTER), len(path)
    tried = np.linspace(highest / 40.0, highest, 40)
    # The cosine transform is that of a path that goes on as its own mirror image: without a slope at its ends it has no kink there.
    first, last = path[_END] - path[0], path[-1] - path[-1 - _END]
    frames = np.arange(count)[:, None]
    level = path - (first * frames + (last - first) * frames**2 / (2.0 * (count - 1))) / _END
    power = (dct(level, axis=0, norm="ortho") ** 2).sum(axis=1)[1:] / count
    hertz = 0.5 * rate * np.arange(1, count) / count
    # What two passes take off of each frequency.
    off = 1.0 - 1.0 / (1.0 + (hertz[None] / (tried[:, None] / _TWO_PASSES)) ** 4)
    taken = np.sqrt((off**2) @ power)
    # The upper half holds noise alone, of which a filter takes off the more, the lower its cut-off: a straight line.
    noise = np.polyfit(tried[20:], taken[20:], 1)[1]
    enough = np.flatnonzero(taken <= noise)
    return float(tried[enough[0]]) if len(enough) else float(highest)


_END = 4
"""Frames that tell the slope of a path at its ends."""
_WINTER = 20.0
"""Hz, the highest cut-off of the residual analysis: walking and running hold less than a hundredth above 10 Hz. At half, runs lose heel
strikes; at double, cut-offs of noise that is not white grow by a third."""


def _filtered(path: Floats, rate: float, choice: FilterChoice) -> tuple[Floats, float]:
    """A piece (n, 3) without gaps, filtered, and the cut-off in Hz."""
    if choice.method == SPLINE:
        spline, power = quintic_spline_and_power(path)
        return np.asarray(spline(np.arange(float(len(path))))), spline_cut_off(power, rate)
    cut_off = residual_cut_off(path, rate) if choice.cut_off is None else choice.cut_off
    return zero_lag_butterworth(path, rate, _of_one_pass(cut_off, rate)), cut_off


def _pieces(path: Floats) -> Iterator[tuple[int, int]]:
    """First frame and the one behind the last of each run without gaps."""
    seen = np.concatenate([[False], np.isfinite(path[:, 0]), [False]])
    for begin, end in np.flatnonzero(np.diff(seen.astype(int))).reshape(-1, 2):
        yield int(begin), int(end)


_WIDEST = 3
"""Frames of the longest spike: what stays away for longer is another marker's path, and a matter for labelling."""
_LIKELY = 0.01
"""Spikes that are found in a recording without any, if its noise is normal: a tenth or ten times as many moves the bound by a tenth."""
_AROUND = 15
"""Frames on either side that tell how rough a path is there."""
_LEAST = 5.0
"""m/s2 that a motion's acceleration is held to change by within a frame: heels stray by 2 mm from cubics at 100 Hz. At half, fast
feet have spikes; at double, two thirds of those of 10 mm are missed."""
_NOISE = 5e-4
"""m of noise that a path is held to have at least, so that no spike is smaller than some 3 mm. At half, half of the walks at 150 Hz have
some of 2 mm; at double, spikes of 6 mm are missed."""
_MATTERS = 0.010
"""m from which a spike is a warning: skin moves markers by less; at half and double, smaller and larger ones are."""
_MEDIAN = 1.538
"""The median length of a vector of three normal coordinates, in their standard deviation."""
_CUBIC = np.array([-1.0, 4.0, 4.0, -1.0]) / 6.0
"""Weights of the samples two and one before, one and two behind, of the cubic through them."""


def find_spikes(path: Floats, rate: float, samples: int | None = None) -> list[Ints]:
    """Runs of up to three frames in which a path (T, 3) jumps away, and which explain all that is odd around: (frames,) each. O(T).

    samples  of the whole recording, by default of the path: the more there are, the farther one must jump

    A sample is odd that strays from the cubic through its neighbours by more than one recording in a hundred would show without spikes, its
    noise being normal and as large as the path's, whole or around. Those frames are a spike whose replacement leaves nothing odd there.

    >>> path = np.arange(100.0)[:, None] * np.array([0.01, 0.0, 0.0])
    >>> path[40:42] += 0.03
    >>> find_spikes(path, 100.0)
    [array([40, 41])]
    """
    if len(path) < _WIDEST + 4:
        return []
    away = _away(path)
    far, least = _farthest(samples or len(path)), max(_LEAST / rate**2, _NOISE)
    # Nearly all paths end here, before the costly medians.
    if not (away > far * least).any():
        return []
    bound = far * np.maximum(_rough(away) / _MEDIAN, least)
    odd = np.flatnonzero(away > bound)
    found = list[Ints]()
    for cluster in np.split(odd, np.flatnonzero(np.diff(odd) > 2) + 1) if len(odd) else []:
        choices = []
        for width in range(1, _WIDEST + 1):
            for begin in range(max(cluster[0], 2), min(cluster[-1], len(path) - 3) - width + 2):
                frames = np.arange(begin, begin + width)
                around = slice(max(cluster[0] - 4, 0), cluster[-1] + 5)
                mended = path[around].copy()
                mended[frames - around.start] = _across(path, frames)
                left = _away(mended) / bound[around]
                if np.isfinite(mended[frames - around.start]).all() and np.nanmax(left, initial=0.0) < 1.0:
                    choices.append((width, float(np.nanmax(left, initial=0.0)), frames))
        if choices:
            found.append(min(choices, key=lambda choice: choice[:2])[2])
    return found


@lru_cache(maxsize=64)
def _farthest(samples: int) -> float:
    """Standard deviations that one in a hundred of so many normal vectors of three coordinates reaches."""
    return float(chi.isf(_LIKELY / samples, 3))


def _away(path: Floats) -> Floats:
    """(T,) m, how far each sample is from the cubic through two samples on either side; NaN where one of them is missing."""
    out = np.full(len(path), np.nan)
    farther, nearer = _CUBIC[0] * (path[:-4] + path[4:]), _CUBIC[1] * (path[1:-3] + path[3:-1])
    off = path[2:-2] - (farther + nearer)
    out[2:-2] = np.sqrt((off * off).sum(axis=1))
    return out


def _rough(values: Floats) -> Floats:
    """(n,) the larger of the median of all values and that of those around each, NaN left out."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.full(len(values), np.inf)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, _AROUND, constant_values=np.nan), 2 * _AROUND + 1)
    local = np.full(len(values), -np.inf)
    there = np.isfinite(around).any(axis=1)
    local[there] = np.nanmedian(around[there], axis=1)
    return np.maximum(local, float(np.median(known)))


def _across(path: Floats, frames: Ints) -> Floats:
    """(frames, 3) of the cubic through two samples on either side, by Lagrange."""
    nodes = np.array([frames[0] - 2, frames[0] - 1, frames[-1] + 1, frames[-1] + 2])
    weights = [np.prod([(frames - other) / (node - other) for other in nodes if other != node], axis=0) for node in nodes]
    return np.asarray(np.stack(weights, axis=1) @ path[nodes])


def _spike_finding(recording: Recording, spikes: list[tuple[str, Ints, float]], replaced: bool) -> Finding:
    """One for a recording: of each spike its marker, its frames, and m by which it jumps."""
    where, largest = str(recording.metadata.get("file", "the recording")), max(size for _, _, size in spikes)
    few = sorted(spikes, key=lambda spike: -spike[2])[:_FEW]
    named = ", ".join(f"{label} in frame {recording.first_frame + int(frames[0])}" for label, frames, _ in few)
    what = "1 spike was" if len(spikes) == 1 else f"{len(spikes)} spikes were"
    how = "replaced by what is around" if replaced else "left, because nothing is filtered"
    return Finding(
        "filter-spike",
        Severity.WARNING if largest > _MATTERS else Severity.NOTE,
        where,
        f"{where}: markers jump away and back within {_WIDEST} frames, by up to {1000.0 * largest:.0f} mm; {what} {how}: {named}"
        f"{', ...' if len(spikes) > _FEW else ''}.",
        "Look whether another point took their label there.",
    )


_FEW = 6
"""Spikes that a sentence names."""
