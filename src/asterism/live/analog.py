"""Analog samples (force plates, EMG) that came with frames in; what a recording keeps of them, its channels, and a file beside it, out."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from asterism.files.atomic import write_atomically
from asterism.recording import Floats, Ints
from asterism.recording.display import counted

if TYPE_CHECKING:
    from asterism.formats import AnalogChannel

_LONGEST = 100
"""Letters of a label in C3D, of at most 127 bytes, some letters having two. Half and double do as well, up to that."""


@dataclass(frozen=True)
class AnalogDevice:
    """A device that measures along with the cameras.

    name      as the camera system calls it
    rate      samples per second; NaN where that is not known
    channels  (c,) names
    units     (c,) such as "V"
    """

    name: str
    rate: float
    channels: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class AnalogSamples:
    """What a device measured since the frame before.

    first   number of the first sample, counted at the device's rate from the begin of the measurement
    values  (k, c)
    """

    device: AnalogDevice
    first: int
    values: Floats


@dataclass(frozen=True, eq=False)
class KeptAnalog:
    """All samples of a device in a recording: samples (n,) their numbers, which lack what was lost; values (n, c)."""

    device: AnalogDevice
    samples: Ints
    values: Floats


def analog_as_arrays(parts: Sequence[AnalogSamples]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Samples as arrays that `analog_of_arrays` reads: a JSON text, and all values as float32, as they came."""
    devices = {part.device.name: [part.device.rate, part.device.channels, part.device.units] for part in parts}
    rows = [[part.device.name, part.first, *part.values.shape] for part in parts]
    values = np.concatenate([part.values.ravel() for part in parts]) if parts else np.empty(0)
    text = json.dumps({"devices": devices, "parts": rows})
    return np.frombuffer(text.encode(), dtype=np.uint8), values.astype(np.float32)


def analog_of_arrays(chunks: Sequence[Sequence[NDArray[Any]]]) -> tuple[KeptAnalog, ...]:
    """The samples of each device, of what `analog_as_arrays` gave one after the other. A device that changed its channels is begun anew."""
    devices, samples, values = dict[str, AnalogDevice](), dict[str, list[Ints]](), dict[str, list[Floats]]()
    for text, flat in chunks:
        content, at = json.loads(bytes(text)), 0
        for name, (rate, channels, units) in content["devices"].items():
            device = AnalogDevice(name, rate, tuple(channels), tuple(units))
            if name not in devices or devices[name].channels != device.channels:
                samples[name], values[name] = [], []
            devices[name] = device
        for name, first, count, width in content["parts"]:
            samples[name].append(np.arange(first, first + count))
            values[name].append(flat[at : at + count * width].reshape(count, width).astype(np.float64))
            at += count * width
    whole = {name: (np.concatenate(samples[name]), np.concatenate(values[name])) for name in devices if samples[name]}
    return tuple(KeptAnalog(devices[name], *arrays) for name, arrays in whole.items())


@dataclass(frozen=True)
class ChannelsOfFrames:
    """Analog channels as C3D holds them: a whole number of samples in each frame, the same for all.

    channels  those that fit
    beside    of each device that does not fit as a whole, why: a sentence
    """

    channels: tuple[AnalogChannel, ...]
    beside: tuple[str, ...]


def channels_of_frames(kept: Sequence[KeptAnalog], frame_times: Floats, rate: float) -> ChannelsOfFrames:
    """The channels of devices whose rates are whole multiples of the frames'.

    frame_times: (T,) s on the clock by which samples are numbered, NaN for lost frames. A slower device has its samples several times, as
    often as the fastest one asks for. Lost samples are 0, as C3D knows none that are missing, and their device is among `beside`, too.
    O(samples).
    """
    # Processes that read cameras need no formats, and start sooner without them.
    from asterism.formats import AnalogChannel

    fitting, beside = list[tuple[KeptAnalog, int, Floats]](), list[str]()
    for device in kept:
        placed = _placed(device, frame_times, rate)
        if isinstance(placed, str):
            beside.append(f"{device.device.name}: {placed}")
        else:
            fitting.append((device, len(placed) // len(frame_times), placed))
    most = max((times for _, times, _ in fitting), default=1)
    channels, names = list[AnalogChannel](), set[str]()
    for device, times, values in fitting:
        about = device.device
        if most % times:
            beside.append(f"{about.name}: its {about.rate:g} Hz are no whole part of the fastest device's {most * rate:g} Hz")
            continue
        lost = int(np.isnan(values).all(axis=1).sum())
        if lost:
            beside.append(f"{about.name}: {counted(lost, 'sample')} of {len(values):,} were lost and are 0 there")
        held = np.repeat(np.nan_to_num(values), most // times, axis=0)
        said = f"{about.name}, {about.rate:g} Hz" + (f", each sample {most // times} times" if most > times else "")
        for column in range(values.shape[1]):
            name = about.channels[column] if column < len(about.channels) and about.channels[column] else f"{about.name} {column + 1}"
            # Two devices may call their channels alike.
            name = name if name not in names else f"{about.name} {name}"
            names.add(name)
            unit = about.units[column] if column < len(about.units) else ""
            channels.append(AnalogChannel(name[:_LONGEST], unit, said[:_LONGEST], held[:, column], most * rate))
    return ChannelsOfFrames(tuple(channels), tuple(beside))


def _placed(kept: KeptAnalog, frame_times: Floats, rate: float) -> Floats | str:
    """(T * k, c) samples of a device in their frames, NaN for lost ones; or why they are in none."""
    frames, samples_per_s = len(frame_times), kept.device.rate
    if not np.isfinite(samples_per_s):
        return "its rate is not known"
    ratio = samples_per_s / rate
    times = round(ratio)
    # Up to the end the samples must stay within a frame of their own.
    if times < 1 or abs(ratio - times) * frames > times:
        return f"its {samples_per_s:g} Hz are no whole multiple of {rate:g} Hz"
    known = np.flatnonzero(np.isfinite(frame_times))
    ahead = frame_times[known] * samples_per_s - known * times
    first = float(np.median(ahead)) if len(known) else np.nan
    if not len(known) or np.abs(ahead - first).max() > times:
        return "the frames do not follow each other evenly on its clock"
    place = kept.samples - round(first)
    inside = (place >= 0) & (place < frames * times)
    if 2 * inside.sum() < len(place):
        return "its samples are not numbered by the clock of the frames"
    values = np.full((frames * times, kept.values.shape[1]), np.nan)
    values[place[inside]] = kept.values[inside]
    return values


def write_analog(path: Path, kept: Sequence[KeptAnalog], frame_times: Floats) -> None:
    """Write a NumPy file: for each device NAME.values, NAME.samples, NAME.rate, NAME.channels and NAME.units.

    frame_times: (T,) s on the camera system's clock of each frame, NaN for lost ones; a sample's is its number by the rate of its device.
    """
    arrays: Mapping[str, Any] = {
        f"{each.device.name}.{key}": value
        for each in kept
        for key, value in (
            ("values", each.values),
            ("samples", each.samples),
            ("rate", np.float64(each.device.rate)),
            ("channels", np.array(each.device.channels, dtype=str)),
            ("units", np.array(each.device.units, dtype=str)),
        )
    }
    content = io.BytesIO()
    np.savez_compressed(content, frame_times=frame_times, **arrays)
    write_atomically(path, content.getvalue())
