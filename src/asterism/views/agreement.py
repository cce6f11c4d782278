"""Labels in images and a trained model of point clouds in; the labels, less certain where the model names the 3D points otherwise, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Finding, Severity
from asterism.labelling import MarkerModel
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints
from asterism.views.result import ViewsLabelling

_MANY = 0.05
"""Share of the compared points on which both disagree, from which a person is told."""
_AROUND = 0.5
"""s, on both sides, within which both must agree as a whole."""
_DOUBT = 0.001
"""The least probability that either side is wrong, whatever it says itself."""


def check_by_model(
    result: ViewsLabelling, model: MarkerModel, *, least_confidence: float = 0.9, progress: Progress | None = None
) -> ViewsLabelling:
    """The labelling, held against what a solver model says of the points that two cameras or more show.

    The model gets these points without names and labels them as a recording, without a look at the images. Where it names a point as the
    images do, or does not know, the confidence stays. Where it gives another name with the probability q, a label of the probability p is
    right with p (1 - q) / (p (1 - q) + (1 - p) q): either is wrong, not both. That holds if labels err one by one. A wrong body errs as a
    whole, which p does not know; so such a label is not more probable either than the share of the points within half a second that both
    name alike, or one half. Where they agree on fewer than half of them, no label of the frame is more probable than one half. Labels
    that are then less probable than `least_confidence` are withdrawn, with their places; a finding says so where more than a twentieth of
    the points are named otherwise.

    least_confidence: the same as of `label_views`. Markers that only one of both knows are not compared. O(the model's labelling).
    """
    columns = model.marker_set.columns_of(result.body.labels)
    frame, marker = np.nonzero(result.views >= 2)
    # One camera gives a ray and no point, so only markers that two cameras show can be compared.
    named = model.label(_points_of(result, frame, marker), progress=progress) if len(frame) else None
    if named is None or not (columns >= 0).any():
        return result
    other = np.full(result.views.shape, NULL, dtype=np.int64)
    certain = np.zeros(result.views.shape)
    # The place of each point within its own frame, which is how a labelling counts candidates.
    place = np.concatenate([np.arange(n) for n in np.bincount(frame, minlength=len(result.views))] or [np.empty(0)]).astype(np.int64)
    for m in np.nonzero(columns >= 0)[0]:
        hit = (named.indices[frame, m] == place) & (named.indices[frame, m] >= 0)
        other[frame[hit], marker[hit]] = columns[m]
        certain[frame[hit], marker[hit]] = np.nan_to_num(named.confidence[frame[hit], m])
    # Markers that only the body or only the model knows can neither agree nor disagree.
    known = np.isin(np.arange(len(result.body.labels)), columns)
    differs = (other >= 0) & (other != np.arange(result.views.shape[1])) & known
    compared = (other >= 0) & known
    return _lowered(result, differs, certain, compared, least_confidence)


def _points_of(result: ViewsLabelling, frame: Ints, marker: Ints) -> Clouds:
    """The markers that several cameras show as points without names, in the order of the markers of each frame."""
    offsets = np.concatenate([[0], np.cumsum(np.bincount(frame, minlength=len(result.views)))]).astype(np.int64)
    vertical = np.array([0.0, 0.0, 1.0]) if result.rig.vertical is None else result.rig.vertical
    points = np.ascontiguousarray(result.positions[frame, marker])
    return Clouds(points, offsets, result.blobs.rate, vertical, np.full(len(points), -1, dtype=np.int64))


def _lowered(
    result: ViewsLabelling, differs: NDArray[np.bool_], certain: Floats, compared: NDArray[np.bool_], least_confidence: float
) -> ViewsLabelling:
    """The labelling with the confidence that disagreement leaves. differs, compared (T, M); certain (T, M): of the model's other name."""
    given = np.nonzero(result.labels >= 0)[0]
    at = (result.frame_of[given], result.labels[given])
    # Nothing is quite certain: an odds ratio of certainties would else be zero divided by zero.
    p = np.clip(result.confidence[given], 0.0, 1.0 - _DOUBT)
    q = np.clip(certain[at], 0.0, 1.0 - _DOUBT)
    alike = _alike(differs, compared, result.blobs.rate)[at[0]]
    left = np.minimum(p * (1.0 - q) / (p * (1.0 - q) + (1.0 - p) * q), np.maximum(alike, 0.5))
    # Agreement leaves a label as it was, unless the body around it is disputed as a whole.
    most = np.where(differs[at], left, np.where(alike < 0.5, 0.5, 1.0))
    confidence, labels = result.confidence.copy(), result.labels.copy()
    confidence[given] = np.minimum(most, result.confidence[given])
    labels[given[confidence[given] < least_confidence]] = NULL
    # A withdrawn label takes its sighting with it; a marker without sightings has no place any more.
    views = np.zeros_like(result.views)
    some = labels >= 0
    np.add.at(views, (result.frame_of[some], labels[some]), 1)
    gone = (views == 0) & (result.views > 0)
    positions = np.where(gone[:, :, None], np.nan, result.positions)
    covariances = np.where(gone[:, :, None, None], np.nan, result.covariances)
    found = result.findings
    if differs.sum() > _MANY * compared.sum():
        sentence = f"the model names {differs.sum()} of {compared.sum()} points of several cameras otherwise than the images do."
        mend = "Look at the report; check that body and model have the markers that were worn, with the same names left and right."
        found = (*found, Finding("views-model-disagrees", Severity.WARNING, "", sentence, mend))
    return replace(result, labels=labels, confidence=confidence, views=views, positions=positions, covariances=covariances, findings=found)


def _alike(differs: NDArray[np.bool_], compared: NDArray[np.bool_], rate: float) -> Floats:
    """(T,) the share of the points within `_AROUND` that both name alike; 1 where none is compared."""
    reach = int(_AROUND * rate)
    around = np.ones(2 * reach + 1)
    # The same window over both, so that the share is one of points and not a mean of shares of frames.
    inside = slice(reach, reach + len(differs))
    wrong, of = (np.convolve(each.sum(axis=1), around)[inside] for each in (differs, compared))
    share: Floats = 1.0 - wrong / np.maximum(of, 1.0)
    return share
