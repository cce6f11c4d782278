"""Points in, a plain description of them out, for people and for JSON."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats._columns import Points, settle_vertical, without_common_subject
from asterism.formats._findings import located
from asterism.formats._physical import COMPUTED, MARKER, UNNAMED
from asterism.recording import Floats, worn_marker_sets


def described(path: Path, points: Points) -> dict[str, Any]:
    """Format, frames, rate, duration (s), units, vertical and where it comes from, points by kind, marker sets, missing, gaps, events,
    log, findings.

    Marker sets are the shipped ones whose markers the file has, the best first (`asterism.recording.worn_marker_sets`). Missing and gaps
    count the physical named points; a gap is a run of missing frames between two seen ones.
    """
    labels, subject = without_common_subject(points.labels)
    kinds = np.array(points.kind_of_points, dtype=object)
    # Gaps are counted of named markers: pieces without a name begin and end everywhere.
    physical = np.nonzero(kinds == MARKER)[0]
    captured = np.nonzero(kinds != COMPUTED)[0]
    seen = ~np.isnan(points.positions[:, physical, 0])
    # A file whose vertical is open is described all the same: that is what a person looks for here.
    said = list[Finding]()
    try:
        vertical, how, said = settle_vertical(
            path,
            points.positions if len(captured) == len(kinds) else points.positions[:, captured],  # no copy of an hour
            [labels[c] for c in captured],
            declared=points.declared,
            fallback=points.fallback,
        )
        up: list[float] | None = [float(v) for v in vertical]
    except AsterismError:
        up, how = None, "not determined"
    return {
        "file": str(path),
        "format": points.format,
        "frames": len(points.positions),
        "rate": points.rate,
        "duration": len(points.positions) / points.rate,
        "first_frame": points.first_frame,
        "units": points.units,
        "vertical": up,
        "vertical_from": how,
        "subject": points.subject or subject,
        "points": {
            "physical": [labels[c] for c in physical],
            "computed": [labels[c] for c in np.nonzero(kinds == COMPUTED)[0]],
            "unnamed": [labels[c] for c in np.nonzero(kinds == UNNAMED)[0]],
        },
        "marker_sets": [asdict(worn) for worn in worn_marker_sets([labels[c] for c in physical])],
        "missing": float(1 - seen.mean()) if seen.size else 0.0,
        "gaps": gaps(seen),
        "events": [{"label": e.label, "context": e.context, "time": e.time} for e in points.events],
        "log": [str(step) for step in points.log],
        "findings": located(path, [*points.found, *said]),
    }


def gaps(seen: Floats) -> int:
    """The number of runs of missing frames between two seen ones, over all columns of seen (T, P)."""
    count = 0
    for column in np.asarray(seen, dtype=bool).T:
        frames = np.nonzero(column)[0]
        # Only a run between two seen frames is a gap: before the first a marker was not there yet.
        count += int((np.diff(frames) > 1).sum())
    return count
