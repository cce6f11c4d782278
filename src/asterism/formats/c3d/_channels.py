"""A C3D file and what is said of new analog channels in; its group ANALOG with them, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from asterism.formats.c3d._edit import MOST_STRINGS, floats_record, integers_record, strings_record, with_group, with_number
from asterism.formats.c3d._file import C3DFile, numbered
from asterism.formats.c3d._parameters import BYTE, CHARACTER, FLOAT, INTEGER, Parameters, Record, make_parameter

_PER_CHANNEL = ("LABELS", "DESCRIPTIONS", "SCALE", "OFFSET", "UNITS", "GAIN")


@dataclass(frozen=True)
class ChannelTexts:
    """What a file says of a channel: its samples times the scale are in the unit."""

    label: str
    description: str
    unit: str
    scale: float = 1.0


def with_channels(file: C3DFile, kept: Sequence[int], added: Sequence[ChannelTexts], samples: int) -> Parameters:
    """The group ANALOG with the channels that are kept, and those that are added; samples: of a channel in each frame."""
    parameters, group = with_group(file.parameters, "ANALOG")
    processor, many, general = file.processor, len(kept) + len(added), file.parameters.number("ANALOG", "GEN_SCALE")
    general = 1.0 if general is None else general
    new: dict[str, list[bytes] | list[float]] = {
        "LABELS": [each.label.encode("utf-8") for each in added],
        "DESCRIPTIONS": [each.description.encode("utf-8") for each in added],
        "UNITS": [each.unit.encode("utf-8") for each in added],
        "SCALE": [each.scale for each in added],
        "OFFSET": [0.0] * len(added),
        "GAIN": [0.0] * len(added),
    }
    changes: dict[tuple[str, str], Record | None] = {}
    for name in _PER_CHANNEL:
        keys = numbered(file.parameters, "ANALOG", name)
        first = file.parameters.find("ANALOG", name)
        # GAIN is optional, and a file without it stays so.
        if first is None and name == "GAIN":
            continue
        default: bytes | float = b"" if isinstance(new[name][0], bytes) else float(name == "SCALE")
        old = _values_of(file.parameters, keys, isinstance(default, bytes))
        listed = [old[channel] if channel < len(old) else default for channel in kept] + list(new[name])
        # Old pages go first: fewer channels need fewer of them.
        changes.update({("ANALOG", key): None for key in keys})
        # A parameter has 255 entries at most; more go on in LABELS2 and so on.
        for page, at in enumerate(range(0, many, MOST_STRINGS)):
            key = f"{name}{page + 1}" if page else name
            changes["ANALOG", key] = _record(key, group, listed[at : at + MOST_STRINGS], first, file)
    for name, value, kind in (("USED", many, int), ("RATE", file.rate * samples, float), ("GEN_SCALE", general, float)):
        if file.parameters.find("ANALOG", name) is not None:
            changes["ANALOG", name] = with_number(file.parameters, "ANALOG", name, value)
        elif kind is int:
            changes["ANALOG", name] = integers_record(name, group, [int(value)], (), processor)
        else:
            changes["ANALOG", name] = floats_record(name, group, [float(value)], (), processor)
    return parameters.replaced(changes)


def _values_of(parameters: Parameters, keys: Sequence[str], texts: bool) -> list[bytes | float]:
    if texts:
        return [text for key in keys for text in parameters.raw_strings("ANALOG", key)]
    return [float(value) for key in keys for value in parameters.values("ANALOG", key)]


def _record(name: str, group: int, values: Sequence[bytes | float], like: Record | None, file: C3DFile) -> Record:
    """A parameter of one value for each channel, in the type that the file had; whole offsets as integers, which others need."""
    texts = [value for value in values if isinstance(value, bytes)]
    if texts or (like is not None and like.kind == CHARACTER):
        width = like.dimensions[0] if like is not None and len(like.dimensions) > 1 else 4
        return strings_record(name, group, texts, width, file.processor, like)
    numbers = [float(value) for value in values if not isinstance(value, bytes)]
    # Other programs demand whole offsets as integers.
    whole = all(number == int(number) and abs(number) < 2**15 for number in numbers)
    kind = INTEGER if name.startswith(("OFFSET", "GAIN")) else FLOAT
    if like is not None and (like.kind != FLOAT or not whole):
        kind = like.kind
    if kind == FLOAT:
        return floats_record(name, group, numbers, (len(numbers),), file.processor)
    if kind == BYTE:
        data = bytes(int(number) & 0xFF for number in numbers)
        return make_parameter(name, group, BYTE, (len(numbers),), data, processor=file.processor)
    return integers_record(name, group, [int(number) for number in numbers], (len(numbers),), file.processor)


def write_analog_header(raw: bytearray, file: C3DFile, width: int, samples: int) -> None:
    """Write what the header of a new file says of its analog words in a frame, and of the samples of a channel."""
    raw[4:6] = file.processor.bytes_of_unsigned(width)
    raw[18:20] = file.processor.bytes_of_unsigned(samples)
