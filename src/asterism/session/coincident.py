"""A recording in; how many of its points lie where another one lies, out.

A system that reconstructs a marker twice, or an export with raw and labelled points, gives each marker two points. Nothing tells which of
them is the marker, so that labels are withheld from both.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from asterism.findings import Finding, Severity
from asterism.recording import Clouds

_APART = 1e-3
"""m between points that are one marker. The smallest markers, of a face, are 3 mm wide, so that two of them are never so near. At half,
points that a system reconstructs twice pass, with its noise; at double nothing changes but where these markers touch."""

_FRAMES = 60
"""Frames that are looked at, evenly over the recording. Each costs a tenth of a millisecond; more say the same of most frames."""


def coincident_findings(where: str, clouds: Clouds) -> list[Finding]:
    """The finding that points of a usual frame lie within a millimetre of another one. where: the file. Costs O(n log n) of a frame."""
    shown = np.nonzero(np.asarray(clouds.counts) > 1)[0]
    if not len(shown):
        return []
    frames = shown[np.unique(np.linspace(0, len(shown) - 1, _FRAMES).round().astype(int))]
    points = [clouds[frame] for frame in frames]
    # each point is its own nearest neighbour
    near = int(np.median([(cKDTree(each).query(each, k=2)[0][:, 1] < _APART).sum() for each in points]))
    if not near:
        return []
    usual = int(np.median([len(each) for each in points]))
    sentence = f"{where}: {near} of the {usual} points of a usual frame lie within 1 mm of another point: markers are there twice."
    mend = "Export each marker once, either its raw or its labelled point; nothing tells which of two points is the marker."
    return [Finding("label-coincident", Severity.WARNING, where, sentence, mend)]
