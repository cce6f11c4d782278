"""A recording with names of left and right in; pairs whose left marker is on the right of the body, out."""

from __future__ import annotations

import numpy as np

from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.recording import Floats, Recording, plain_name

_HIND = ("HEE", "HEEL", "CAL", "LCA", "ANK", "LM")
_FORE = ("TOE", "MT2", "D2M", "MT1", "D1M", "MT5", "5TH", "D5M")
"""Ends of a foot by the names after the side, best first."""

_JUDGED = {*_HIND, *_FORE, "ASI", "PSI", "ASIS", "PSIS", "THI", "KNE", "TIB"}
"""What events, parameters and angles are made of. Markers on the inner side of a foot or knee come past each other in a narrow walk."""

_SHOWN = 4
"""Pairs that a finding lists; the others are counted."""


def exchanged_pairs(recording: Recording) -> list[str]:
    """The names after the side ("KNE") of pairs whose left marker is on the right of the right one in most frames.

    Both feet together show where the body is ahead, whichever of them is called left: an exchange of names does not turn it. Without a
    hind and a fore marker on both feet nothing is told. O(T).
    """
    names = [plain_name(label).upper() for label in recording.labels]
    # of a name that occurs twice nobody knows which is meant
    columns = {name: at for at, name in enumerate(names) if names.count(name) == 1}
    pairs = [name[1:] for name in columns if name[:1] == "L" and name[1:] in _JUDGED and "R" + name[1:] in columns]
    hind, fore = (next((stem for stem in stems if stem in pairs), None) for stems in (_HIND, _FORE))
    if hind is None or fore is None:
        return []
    positions = rotate_z_up(recording.positions, recording.vertical)

    def both(stem: str) -> tuple[Floats, Floats]:
        return positions[:, columns["L" + stem], :2], positions[:, columns["R" + stem], :2]

    ahead = np.asarray(sum(both(fore))) - np.asarray(sum(both(hind)))
    found = []
    for stem in pairs:
        left, right = both(stem)
        aside = ahead[:, 0] * (left - right)[:, 1] - ahead[:, 1] * (left - right)[:, 0]
        seen = aside[np.isfinite(aside)]
        if len(seen) and float(np.median(seen)) < 0.0:
            found.append(stem)
    return found


def exchanged_finding(recording: Recording) -> list[Finding]:
    """The finding that names of left and right contradict where the feet point."""
    pairs = exchanged_pairs(recording)
    if not pairs:
        return []
    file = str(recording.metadata.get("file", "the recording"))
    listed = ", ".join(f"L{stem}" for stem in pairs[:_SHOWN]) + (f" and {len(pairs) - _SHOWN} more" if len(pairs) > _SHOWN else "")
    be, twin = ("are", "their right twins") if len(pairs) > 1 else ("is", f"R{pairs[0]}")
    sentence = f"{file}: {listed} {be} on the right of {twin} in most frames, as the feet point: names of left and right are exchanged, "
    sentence += "the recording is a mirror image, or the legs cross. What is given of a side may be the other side's."
    mend = "Look which side a picture shows; `asterism label` and `asterism review` put names right."
    return [Finding("clinical-sides-exchanged", Severity.WARNING, file, sentence, mend)]
