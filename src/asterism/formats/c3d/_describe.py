"""What a C3D file holds, for `asterism info`: path in, plain values out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from asterism.formats._describe import described
from asterism.formats.c3d._file import open_c3d
from asterism.formats.c3d._reader import encoding_of, points_of


def describe_c3d(path: Path) -> dict[str, Any]:
    """What is said of every format (see `asterism.formats.describe`), and encoding, analog data, force plates, parameters, manufacturer.

    Files without points are described too. Raises AsterismError where this is not a C3D file, or its rate or units are impossible.
    """
    file = open_c3d(path)
    parameters = file.parameters
    samples = file.layout.analog // file.analog_channels if file.analog_channels else 0
    maker = [parameters.text("MANUFACTURER", name) for name in ("COMPANY", "SOFTWARE", "VERSION_LABEL")]
    return {
        **described(path, points_of(file)),
        "encoding": encoding_of(file),
        "byte_order": {"PC": "little-endian", "DEC": "little-endian, VAX floats", "SGI": "big-endian"}[file.processor.name],
        "numbers": "real" if file.layout.real else "integer",
        "analog": {
            "channels": file.analog_channels,
            "rate": samples * file.rate,
            "labels": parameters.strings("ANALOG", "LABELS")[: file.analog_channels],
        },
        "force_plates": parameters.count("FORCE_PLATFORM", "USED") or 0,
        # Company, software and version often repeat each other.
        "manufacturer": " ".join(dict.fromkeys(part for part in maker if part)),
        "parameters": {group: len(names) for group, names in parameters.groups.items()},
    }
