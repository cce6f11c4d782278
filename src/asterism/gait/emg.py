"""Analog channels of a walk in; which of them are muscles, and their envelopes over the gait cycle, out.

Source: the linear envelope of Winter and Yack (1987), with the cut-offs that SENIAM and ISEK (Merletti 1999) ask for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.signal import butter, sosfiltfilt, sosfreqz, welch

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.formats import AnalogChannel, analog_channels
from asterism.gait.cycles import Cycle, over_cycle
from asterism.recording import Floats, Recording
from asterism.recording.display import listed

_VOLTS = {"V", "MV", "UV", "µV", "VOLT", "VOLTS", "MICROVOLTS", "MILLIVOLTS"}
_OTHER_SENSORS = re.compile(
    r"switch|sync|trig|\bacc|gyro|\bmag|imu|\bpin\b|force|moment|press|gonio|torque|temp|clock|foot\b|\bfs\b|heart|ecg|spare", re.IGNORECASE
)
"""What devices for muscles record beside them, by words in the channels' names."""
_MUSCLES = {
    "rectus femoris": ("RF", "RECT", "RECTUS", "RECFEM", "RECTUSFEMORIS", "RECTFEM"),
    "vastus lateralis": ("VL", "VLAT", "VASLAT", "VASL", "VASTUSLATERALIS", "VASTLAT"),
    "vastus medialis": ("VM", "VMO", "VMED", "VASMED", "VASM", "VASTUSMEDIALIS", "VASTMED"),
    "hamstrings": ("HAM", "HAMS", "HAMSTRING", "HAMSTRINGS", "MEDHAM", "LATHAM"),
    "semitendinosus": ("ST", "SEMIT", "SEMITEN", "SEMITENDINOSUS"),
    "semimembranosus": ("SM", "SEMIM", "SEMIMEM", "SEMIMEMBRANOSUS"),
    "biceps femoris": ("BF", "BICFEM", "BICEPSFEMORIS", "BICFEMORIS", "BFLH", "BFSH"),
    "tibialis anterior": ("TA", "TIBANT", "TIBIALISANTERIOR", "TIBIALISANT"),
    "tibialis posterior": ("TP", "TIBPOST", "TIBIALISPOSTERIOR"),
    "gastrocnemius": ("GAS", "GAST", "GASTR", "GASTRO", "GASTROCNEMIUS", "GASTROC"),
    "gastrocnemius medialis": ("GM", "MG", "GASMED", "GASM", "MEDGAST", "GASTMED", "GASTROCNEMIUSMEDIALIS", "MEDGASTROC"),
    "gastrocnemius lateralis": ("GL", "LG", "GASLAT", "GASL", "LATGAST", "GASTLAT", "GASTROCNEMIUSLATERALIS", "LATGASTROC"),
    "soleus": ("SOL", "SOLEUS"),
    "peroneus longus": ("PL", "PER", "PERLONG", "PERONEUS", "PERONEUSLONGUS", "FIBULARIS"),
    "gluteus maximus": ("GMAX", "GLUTMAX", "GLUMAX", "GLUTEUSMAXIMUS"),
    "gluteus medius": ("GMED", "GLUTMED", "GLUMED", "GLUTEUSMEDIUS"),
    "adductors": ("ADD", "ADDUCTOR", "ADDUCTORS", "ADDLONG", "ADDUCTORLONGUS"),
    "erector spinae": ("ES", "ERS", "ERSPIN", "ERECTORSPINAE"),
    "tensor fasciae latae": ("TFL",),
}
"""Muscles, and how laboratories write them, without signs and the side."""
_OF_SPELLING = {spelling: muscle for muscle, spellings in _MUSCLES.items() for spelling in spellings}


@dataclass(frozen=True)
class EmgRules:
    """How envelopes are made.

    low, high    Hz, of the band-pass: below, electrodes and cables move; above, there is noise. `high` is lower where the rate is. At half
                 of `low` envelopes of 13 walks are higher by 8 % (of the tenth with most movement by 19 %), at double lower by 14 %
    smooth       Hz, of the low-pass on the rectified signal: at half, bursts of a tenth of a second run into each other, at double each
                 burst has several peaks; how much cycles differ changes by 3 % with either
    least_rate   samples per second. Most of a muscle's power is from 50 to 150 Hz; with half as many none of it is left
    clipped      share of samples that stay at an end of the range, from which a channel is said to be cut off; a whole peak is there for
                 one sample
    loose        the same share, from which no electrode can have been on the muscle: a loose cable swings from end to end. At half, one
                 more of 330 channels of eleven children is left out, at double six fewer are
    """

    low: float = 20.0
    high: float = 450.0
    smooth: float = 6.0
    least_rate: float = 400.0
    clipped: float = 0.001
    loose: float = 0.1


@dataclass(frozen=True)
class EmgChannel:
    """A muscle's activity.

    name      of the channel in the file; muscle "" and side None where the name does not tell them
    told_by   why the channel counts as a muscle's
    unit      of its envelopes
    rectified whether the file holds the signal rectified, so that it was smoothed only
    spread    standard uncertainty of a cycle's envelope, of its height: see `envelope_spread`; None where the signal was rectified before
    cycles    "L" and "R" -> (cycles of that foot, 101), over the cycles of its own side, or of both where the side is not known
    """

    name: str
    muscle: str
    side: str | None
    told_by: str
    unit: str
    cycles: Mapping[str, Floats]
    rectified: bool = False
    spread: float | None = None


def emg_of(recording: Recording, cycles: Sequence[Cycle], rules: EmgRules | None = None) -> tuple[tuple[EmgChannel, ...], list[Finding]]:
    """The muscles that a recording holds, with their envelopes over its cycles, and what to know about them. O(samples).

    A channel is a muscle's where it is in volts, belongs to no force plate, and its name is that of a muscle, or its name or description
    says EMG. The envelope is the signal through a band-pass, rectified, through a low-pass: Butterworth filters of second order, run
    forwards and backwards. A signal that was rectified before goes through the low-pass alone, which is said.
    """
    rules = rules or EmgRules()
    told, left_out, clipped = list[tuple[AnalogChannel, str]](), dict[str, list[str]](), list[str]()
    for channel in analog_channels(recording):
        why = _why(channel)
        if why is None:
            continue
        problem = _unusable(channel.samples, channel.rate, rules)
        if problem:
            left_out.setdefault(problem, []).append(channel.name)
            continue
        if _cut_off(channel.samples) > rules.clipped:
            clipped.append(channel.name)
        told.append((channel, why))
    channels = list[EmgChannel]()
    # The channels of a file have one rate, so that all go through the filters together.
    rectified = [is_rectified(channel.samples) for channel, _ in told]
    envelopes, spread = np.zeros((len(told), len(told[0][0].samples) if told else 0)), np.full(len(told), np.nan)
    for state in set(rectified):
        own = [place for place, one in enumerate(rectified) if one == state]
        samples = np.stack([told[place][0].samples for place in own], axis=1)
        envelopes[own] = envelope(samples, told[0][0].rate, rules, rectified=state).T
        if not state:
            spread[own] = envelope_spread(samples, told[0][0].rate, rules)
    for (channel, why), values, state, share in zip(told, envelopes, rectified, spread.tolist(), strict=True):
        side, muscle = side_and_muscle(channel.name)
        over = {
            foot: np.stack(curves)
            for foot in "LR"
            if side in (None, foot) and (curves := [over_cycle(values, channel.rate, cycle) for cycle in cycles if cycle.side == foot])
        }
        if over:
            certain = None if state or not np.isfinite(share) else share
            channels.append(EmgChannel(channel.name, muscle, side, why, channel.unit, over, state, certain))
    smoothed = [channel.name for (channel, _), state in zip(told, rectified, strict=True) if state]
    return tuple(channels), _findings(str(recording.metadata.get("file", "the recording")), left_out, clipped, smoothed)


def _findings(file: str, left_out: Mapping[str, Sequence[str]], clipped: Sequence[str], rectified: Sequence[str]) -> list[Finding]:
    """One for each reason: electrodes of one amplifier fail together."""
    found = []
    for problem, names in left_out.items():
        sentence = f"{file}: EMG of {listed(names)} is left out: {problem}."
        found.append(Finding("emg-channel", Severity.NOTE, listed(names), sentence, "Look at electrodes and cables."))
    if clipped:
        sentence = f"{file}: EMG of {listed(clipped)} is cut off at the ends of its range; its peaks are too low."
        found.append(Finding("emg-clipped", Severity.WARNING, listed(clipped), sentence, "Record it with a smaller gain."))
    if rectified:
        sentence = f"{file}: EMG of {listed(rectified)} is rectified in the file, never below zero: it is smoothed, and not band-passed."
        mend = "Export raw signals, where envelopes of several recordings are compared: theirs are as that program made them."
        found.append(Finding("emg-rectified", Severity.NOTE, listed(rectified), sentence, mend))
    return found


_BELOW_ZERO = 1e-3
"""Of a signal's range, by which a rectified one may be below zero: the last bits of a converter. Of 512 raw channels of walks, that
nearest to it goes three times as far; at half, converters of 8 bits are above it."""
_ONE_SIDED = 0.5
"""How far the middle of a rectified signal lies above its low end, against how far below its high end: 0.25 for noise, less for bursts,
and 1 for a raw signal, whatever its offset. At double, raw ones with an offset count as rectified."""


def is_rectified(samples: Floats) -> bool:
    """Whether a muscle's signal (S,) was rectified, or is an envelope: never below zero, and crowded at its low end.

    >>> raw = np.random.default_rng(0).normal(size=1000)
    >>> is_rectified(raw), is_rectified(raw + 5.0), is_rectified(np.abs(raw))
    (False, False, True)
    """
    if samples.min() < -_BELOW_ZERO * np.ptp(samples):
        return False
    low, middle, high = np.quantile(samples, [0.001, 0.5, 0.999])
    return bool(middle - low < _ONE_SIDED * (high - middle))


@lru_cache(maxsize=8)
def _filters(rate: float, low: float, high: float, smooth: float) -> tuple[Floats, Floats]:
    """Band-pass and low-pass, which all channels of a recording share."""
    band = butter(2, [low, min(high, 0.45 * rate)], "bandpass", fs=rate, output="sos")
    return band, butter(2, smooth, "lowpass", fs=rate, output="sos")


def envelope(samples: Floats, rate: float, rules: EmgRules | None = None, *, rectified: bool = False) -> Floats:
    """The linear envelope of samples (S,), or (S, C) of several channels, in their unit and at their rate; never below zero. O(S C).

    rectified  whether they are already (`is_rectified`): a band-pass would take away what the envelope is

    >>> times = np.arange(2000) / 1000.0
    >>> burst = np.sin(2 * np.pi * 100 * times) * (times > 1.0)
    >>> found = envelope(burst, 1000.0)
    >>> bool(abs(found[1500] - 2 / np.pi) < 0.03), bool(found[500] < 0.01)  # the band-pass takes 3 % at 100 Hz
    (True, True)
    """
    rules = rules or EmgRules()
    band, smooth = _filters(rate, rules.low, rules.high, rules.smooth)
    # An offset would ring through the band-pass at both ends.
    size = samples if rectified else np.abs(sosfiltfilt(band, samples - samples.mean(axis=0), axis=0))
    return np.asarray(np.maximum(sosfiltfilt(smooth, size, axis=0), 0.0))


_RECTIFIED = 0.57
"""pi / 2 - 1: variance of the size of normal noise, of the square of its mean."""
_KEPT = 0.833
"""Bandwidth of noise that a Butterworth filter of second order lets through forwards and backwards, of its cut-off: 3 pi / (8 sqrt(2))."""
_SEGMENT = 256
"""Samples, at most, of the pieces from which a spectrum is the mean: a muscle's has no line that is narrower than 4 Hz."""


def envelope_spread(samples: Floats, rate: float, rules: EmgRules | None = None) -> Floats:
    """Standard uncertainty of an envelope, of its height, for samples (S,), or (S, C) of several channels that are not rectified. O(S C).

    A muscle's signal is noise, whose size is known the better the more of it the low-pass takes together: the variance is that of the size
    of normal noise, times the bandwidths of low-pass over signal (Hogan and Mann 1980). With usual filters it is a sixth.

    >>> noise = np.random.default_rng(0).normal(size=40000)
    >>> found = envelope(noise, 1000.0)[1000:-1000]
    >>> bool(abs(envelope_spread(noise, 1000.0) / (found.std() / found.mean()) - 1) < 0.15)
    True
    """
    rules = rules or EmgRules()
    band, _ = _filters(rate, rules.low, rules.high, rules.smooth)
    frequencies, power = welch(samples, rate, nperseg=min(_SEGMENT, len(samples)), axis=0)
    passed = np.abs(sosfreqz(band, frequencies, fs=rate)[1]) ** 4
    power = power.T * passed
    with np.errstate(invalid="ignore"):  # a signal that is silent has no bandwidth
        bandwidth = power.sum(axis=-1) ** 2 / (power**2).sum(axis=-1) * frequencies[1]
        return np.asarray(np.sqrt(_RECTIFIED * _KEPT * rules.smooth / bandwidth))


def side_and_muscle(name: str) -> tuple[str | None, str]:
    """The side, "L" or "R", and the muscle that a channel's name tells; None and "" where it does not.

    >>> side_and_muscle("L Tib Ant"), side_and_muscle("Voltage.RGAS"), side_and_muscle("EMG12.v")
    (('L', 'tibialis anterior'), ('R', 'gastrocnemius'), (None, ''))
    """
    words = [word.upper() for word in re.split(r"[^A-Za-z]+", name)]
    words = [word for word in words if word not in ("", "V", "MV", "UV", "VOLTAGE", "EMG", "ANALOG", "IM", "RAW", "SIGNAL", "MUSCLE")]
    spelled = {"LEFT": "L", "RIGHT": "R"}
    for at in (0, len(words) - 1):
        if words and (side := spelled.get(words[at], words[at])) in ("L", "R"):
            rest = "".join(words[:at] + words[at + 1 :])
            return side, _OF_SPELLING.get(rest, "")
    whole = "".join(words)
    for prefix, side in (("LEFT", "L"), ("RIGHT", "R"), ("L", "L"), ("R", "R")):
        # "LG" could be a muscle of no side; a side and a muscle are likelier than a muscle alone
        for rest in (whole.removeprefix(prefix), whole.removesuffix(prefix)):
            if rest != whole and rest in _OF_SPELLING:
                return side, _OF_SPELLING[rest]
    return None, _OF_SPELLING.get(whole, "")


def muscles_by_channel(words: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Channel -> side and muscle, from words such as "EMG1=LRF" and "EMG2=right soleus".

    Raises AsterismError where a word is no channel with a muscle and its side.

    >>> muscles_by_channel(["EMG1=LRF", "EMG2=right soleus"])
    {'EMG1': ('L', 'rectus femoris'), 'EMG2': ('R', 'soleus')}
    """
    found = {}
    for word in words:
        name, _, said = word.partition("=")
        side, muscle = side_and_muscle(said)
        if not name.strip() or not muscle or side is None:
            raise AsterismError(
                f"{word} is no channel with a muscle and its side; write for example EMG1=LRF or EMG1='left rectus femoris'."
            )
        found[name.strip()] = (side, muscle)
    return found


def named_channels(channels: Sequence[EmgChannel], muscles: Mapping[str, tuple[str, str]]) -> tuple[EmgChannel, ...]:
    """The channels with the sides and muscles that a person gives them (`muscles_by_channel`); an ending such as ".v" may be left out.

    Raises AsterismError where a channel's own name says the other side.
    """
    found = []
    for channel in channels:
        side, muscle = muscles.get(channel.name) or muscles.get(channel.name.rsplit(".", 1)[0]) or (channel.side, channel.muscle)
        if side is not None and channel.side not in (None, side):
            raise AsterismError(f"EMG channel {channel.name} says by its name that it is of the other side; give it the side that it has.")
        cycles = {foot: curves for foot, curves in channel.cycles.items() if side in (None, foot)}
        found.append(replace(channel, side=side, muscle=muscle, cycles=cycles))
    return tuple(found)


def peak(channels: Sequence[EmgChannel]) -> float:
    """The highest point of the mean envelope over the cycles of one muscle's channel in several walks: what its amplitude is shown against.

    Of a channel whose side is not known, the higher of its means over left and over right cycles. Amplitudes in volts depend on skin and
    electrodes, so that they tell nothing from muscle to muscle or from day to day. NaN where no cycle is known.
    """
    highest = float("nan")
    for side in "LR":
        curves = [curve for channel in channels for curve in channel.cycles.get(side, ()) if np.isfinite(curve).all()]
        highest = np.fmax(highest, np.mean(curves, axis=0).max()) if curves else highest
    return float(highest)


def _why(channel: AnalogChannel) -> str | None:
    """What tells that a channel is a muscle's; None where nothing does."""
    if channel.of_plate or channel.unit.upper() not in _VOLTS or _OTHER_SENSORS.search(channel.name):
        return None
    if re.search(r"emg", channel.name, re.IGNORECASE):
        return "EMG in the name"
    if side_and_muscle(channel.name)[1]:
        return "a muscle in the name"
    return "EMG in the description" if re.search(r"\bemg", channel.description, re.IGNORECASE) else None


def _unusable(samples: Floats, rate: float, rules: EmgRules) -> str:
    if rate < rules.least_rate:
        return f"{rate:g} samples per second are too few for a muscle, which needs {rules.least_rate:g}"
    if not np.isfinite(samples).all():
        return "some samples are no numbers"
    # filters need some samples before and behind each
    if len(samples) < rate:
        return "it is shorter than a second"
    if np.ptp(samples) == 0:
        return "all samples of a channel are equal"
    return "it swings from end to end of its range, as a loose cable does" if _cut_off(samples) > rules.loose else ""


def _cut_off(samples: Floats) -> float:
    """Share of the samples that stay at the lowest or the highest value that occurs: a peak that is whole is there for one sample."""
    at_end = samples == samples.max()
    # Of a rectified signal the low end is rest.
    if not is_rectified(samples):
        at_end |= samples == samples.min()
    return float((at_end[1:] & (samples[1:] == samples[:-1])).mean())
