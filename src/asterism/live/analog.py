"""Analog samples (force plates, EMG) that came with frames in; what a recording keeps of them, and a NumPy file beside it, out."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.files.atomic import write_atomically
from asterism.recording import Floats, Ints


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


def analog_as_arrays(parts: Sequence[AnalogSamples]) -> list[NDArray[Any]]:
    """Samples as arrays that `analog_of_arrays` reads: a JSON text, and all values as float32, as they came."""
    devices = {part.device.name: [part.device.rate, part.device.channels, part.device.units] for part in parts}
    rows = [[part.device.name, part.first, *part.values.shape] for part in parts]
    values = np.concatenate([part.values.ravel() for part in parts]) if parts else np.empty(0)
    text = json.dumps({"devices": devices, "parts": rows})
    return [np.frombuffer(text.encode(), dtype=np.uint8), values.astype(np.float32)]


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
