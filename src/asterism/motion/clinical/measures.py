"""A recording in; the measures of a subject's legs, which its file may hold, out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from asterism.recording import Recording

_WIDTHS = (0.02, 0.25)
"""m: what a width of a knee or an ankle can be; another value in a file is not believed."""
_TURN = 1.0
"""rad: no offset of a wand or of a foot is larger; another value in a file, perhaps in degrees, is not believed."""


@dataclass(frozen=True)
class LegMeasures:
    """Measures of one leg, as Plug-in-Gait has them.

    knee_width, ankle_width         m, between the condyles and between the malleoli. The defaults are an adult's
    thigh_rotation, shank_rotation  rad, by which the wand of thigh and shank is turned outwards about the limb
    foot_flexion                    rad, between the line from ankle to toe and the sole in the standing trial
    from_file                       which of these the recording's file holds
    """

    knee_width: float = 0.10
    ankle_width: float = 0.07
    thigh_rotation: float = 0.0
    shank_rotation: float = 0.0
    foot_flexion: float = 0.0
    from_file: tuple[str, ...] = ()


_NAMES = {
    "knee_width": "KNEEWIDTH",
    "ankle_width": "ANKLEWIDTH",
    "thigh_rotation": "THIGHROTATION",
    "shank_rotation": "SHANKROTATION",
    "foot_flexion": "STATICPLANTFLEX",
}


def leg_measures(recording: Recording, side: str) -> LegMeasures:
    """The measures of the leg of this side ("L" or "R") in the PROCESSING group of the recording's C3D file; usual ones where it has none.

    Plug-in-Gait writes widths in the unit of the points and turns in radians. A measure that no leg can have counts as absent.
    """
    parameters: Any = getattr(recording.source, "parameters", None)
    number = getattr(parameters, "number", None)
    if number is None:
        return LegMeasures()
    measures: dict[str, float] = {}
    # Widths are in the unit of the points, which may be mm or m.
    metres = float(recording.metadata.get("metres_per_unit", 0.001) or 0.001)
    for name, parameter in _NAMES.items():
        value = number("PROCESSING", f"{side}{parameter}")
        if value is None or not np.isfinite(value):
            continue
        # A value that no leg has may be in another unit; guessing which would bend all angles.
        if name.endswith("width") and _WIDTHS[0] <= value * metres <= _WIDTHS[1]:
            measures[name] = float(value * metres)
        elif not name.endswith("width") and 0 < abs(value) <= _TURN:
            measures[name] = float(value)
    return LegMeasures(**measures, from_file=tuple(measures))
