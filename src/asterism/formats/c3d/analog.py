"""A C3D file in; its analog channels out, each with what the file says about it."""

from __future__ import annotations

from dataclasses import dataclass

from asterism.formats.c3d._file import C3DFile
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
