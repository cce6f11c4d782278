"""The analog channels of a C3D file, each with what the file says about it: out of a file, and into a new one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.c3d._assemble import assembled
from asterism.formats.c3d._channels import ChannelTexts, with_channels, write_analog_header
from asterism.formats.c3d._file import C3DFile, ranges
from asterism.formats.c3d._layout import LIMIT
from asterism.recording import Floats, Recording


@dataclass(frozen=True)
class AnalogChannel:
    """What was sampled beside the markers.

    name, unit, description  as the file has them; "" where it has none
    samples                  (S,) in that unit, the first at the recording's first frame
    rate                     samples per second
    of_plate                 whether a force plate names it as its own
    """

    name: str
    unit: str
    description: str
    samples: Floats
    rate: float
    of_plate: bool = False


def analog_channels(recording: Recording) -> tuple[AnalogChannel, ...]:
    """The channels of the C3D file that a recording was read from; none for a recording without its file. O(samples)."""
    file = recording.source
    if not isinstance(file, C3DFile) or not file.analog_channels:
        return ()
    samples, of_plates = file.analog, {int(channel) for channel in file.parameters.values("FORCE_PLATFORM", "CHANNEL")}
    rate = recording.rate * len(samples) / max(len(recording), 1)
    texts = {name: file.parameters.strings("ANALOG", name) for name in ("LABELS", "UNITS", "DESCRIPTIONS")}

    def said(name: str, channel: int) -> str:
        return texts[name][channel].strip() if channel < len(texts[name]) else ""

    return tuple(
        AnalogChannel(
            said("LABELS", channel),
            said("UNITS", channel),
            said("DESCRIPTIONS", channel),
            samples[:, channel],
            rate,
            channel + 1 in of_plates,
        )
        for channel in range(file.analog_channels)
    )


def with_analog(file: C3DFile, channels: Sequence[AnalogChannel]) -> bytearray:
    """The bytes of a file of real numbers that has no analog channels, with these.

    All channels of a file have one number of samples in each frame: samples (frames * samples,) of all are as many. O(samples).
    Raises AsterismError where a frame would hold more samples than a C3D file can, or the file has channels of its own.
    """
    if file.analog_channels or not file.layout.real:
        raise AsterismError(f"{file.path}: analog channels are written into new files alone.")
    frames, points = file.layout.frames, 4 * file.layout.points
    samples = len(channels[0].samples) // frames
    if samples * len(channels) > LIMIT:
        raise AsterismError(f"{file.path}: {len(channels)} analog channels are more than a C3D file can hold at this rate.")
    texts = [ChannelTexts(channel.name, channel.description, channel.unit) for channel in channels]
    raw, words = assembled(file, with_channels(file, [], texts, samples), points + samples * len(channels), file.layout.points, None)
    # (frames, samples, channels), as the format has them
    values = np.stack([channel.samples.reshape(frames, samples) for channel in channels], axis=2).reshape(frames, -1)
    for some in ranges(frames):
        words[some, :points] = file.words[some, :points]
        words[some, points:] = file.processor.words_of_floats(values[some])
    write_analog_header(raw, file, samples * len(channels), samples)
    return raw
