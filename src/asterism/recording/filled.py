"""Which samples of a recording were filled: fills in, a step of the processing log out, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from asterism.recording.arrays import Floats
from asterism.recording.trajectories import Recording

_ACTION = "filled"
_GAPS = "gaps"


@dataclass(frozen=True)
class GapFill:
    """A gap that was filled.

    label      the marker
    begin, end s on the recording's clock, its first and last sample
    deviation  m, the largest standard deviation of a coordinate in it
    """

    label: str
    begin: float
    end: float
    deviation: float


def logged_fills(recording: Recording, fills: Sequence[GapFill], by: str, limit: float, trials: Sequence[str] = ()) -> Recording:
    """The recording with a step in its log that names the filled gaps: by marker [first s, last s, standard deviation in mm].

    Times and not frame numbers: these change where frames are left out. limit: m, that of `fill_gaps`; trials: files that told, too.
    """
    gaps: dict[str, list[list[float]]] = {}
    for fill in fills:
        gaps.setdefault(fill.label, []).append([round(fill.begin, 5), round(fill.end, 5), round(1000.0 * fill.deviation, 2)])
    told = {"trials": [PurePath(trial).name for trial in trials]} if trials else {}
    return recording.logged(_ACTION, by, limit_mm=round(1000.0 * limit, 6), gaps=gaps, **told)


def filled_samples(recording: Recording) -> Floats:
    """(T, M) m, the standard deviation of the samples that the processing log calls filled, the largest of each gap; NaN for others."""
    deviation = np.full(recording.visible.shape, np.nan)
    steps = [step.settings[_GAPS] for step in recording.log if step.action == _ACTION and isinstance(step.settings.get(_GAPS), dict)]
    if not steps:
        return deviation
    times, slack = recording.times, 0.25 / recording.rate
    for gaps in steps:
        for label in set(gaps) & set(recording.labels):
            column = recording.labels.index(label)
            for gap in gaps[label]:
                # A log is a note that anybody may have edited.
                if not (isinstance(gap, list) and len(gap) == 3 and all(isinstance(value, int | float) for value in gap)):
                    continue
                inside = (times >= gap[0] - slack) & (times <= gap[1] + slack) & recording.visible[:, column]
                deviation[inside, column] = gap[2] / 1000.0
    return deviation
