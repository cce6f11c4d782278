"""The arrays that the whole-body kernels share: body model, anchors, settings and working arrays.

The mathematics is in `model.py`. All kernels take the vertical as +z. Their plain twins are in `tests/twins_body.py`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.features.search_kernels import SolverArrays

LOG_2PI = math.log(2.0 * math.pi)


class BodyArrays(NamedTuple):
    """A body model as the kernels read it; K key poses, M markers, r latent directions (pose, size, then small moves of the whole body).

    mean        (K, M, 3) m, the mean body
    whiten      (K, M, 3, 3) takes a residual in m to unit variance
    load        (K, M, 3, r) whitened displacement per unit of each latent
    load_by_latent (K, r, 3 M) the same, latent by latent: the x of all markers, then y, then z
    gram        (K, M, r r) load' load, flat
    full        (K, r r) identity plus the sum of gram over all markers
    spread      (K, M, 3, 3) inverse of whiten
    log_scale   (K, M) log |det whiten|
    log_weight  (K,) log share of the training frames
    """

    mean: np.ndarray
    whiten: np.ndarray
    load: np.ndarray
    load_by_latent: np.ndarray
    gram: np.ndarray
    full: np.ndarray
    spread: np.ndarray
    log_scale: np.ndarray
    log_weight: np.ndarray


class AnchorArrays(NamedTuple):
    """What follows for the whole body once an anchor's three markers are known; A anchors.

    The nine coordinates of an anchor's three markers are the three x, then y, then z.

    markers       (A, 3)
    mean          (K, A, 9) m, the anchor's markers about their centre
    precision_factor (K, A, 9, 9) 1/m, upper triangle U, U' U = the inverse covariance of the anchor's own points
    log_peak      (K, A) log density at the anchor's mean, with the key pose's weight
    gain          (K, A, 9, 3 M) prediction of all markers per displacement of the anchor's points: x of all, then y, then z
    whiten        (K, A, M, 3, 3) takes a prediction's residual to unit variance
    log_scale     (K, A, M) log |det whiten|
    max_variance  (K, A, M) m2, trace of a prediction's covariance
    """

    markers: np.ndarray
    mean: np.ndarray
    precision_factor: np.ndarray
    log_peak: np.ndarray
    gain: np.ndarray
    whiten: np.ndarray
    log_scale: np.ndarray
    max_variance: np.ndarray


class FrameSettings(NamedTuple):
    """`labeller.FrameLabellingSettings` as the kernels read them, and the usual score of the model at hand.

    usual_score  nats per label: nearly every correctly labelled frame scores at least that
    """

    reward: float
    first_ghost_cost: float
    outlier_score: float
    outlier_radius: float
    max_anchor_distance2: float
    votes_needed: int
    max_votes_needed: int
    extra_anchors: int
    max_evaluations: int
    proposals_per_anchor: int
    min_found_share: float
    assign_margin: float
    exact_margin: float
    tail_freedom: float
    usual_score: float


class FrameModel(NamedTuple):
    """All that frames are labelled by: anchors as partial solvers and as predictors (the same ones), the body and the settings.

    twins  (W, M) what is found is held against, see `twins.twins_of`
    """

    solvers: SolverArrays
    anchors: AnchorArrays
    body: BodyArrays
    settings: FrameSettings
    twins: np.ndarray


class FrameLabelling(NamedTuple):
    """What the labelling of one frame gives.

    point_of  (M,) each marker's point, -1 for none
    margins   (M,) nats over the nearest labelling that differs there; for a null, minus the nats that its best free point lacks
    counters  (4,) feature evaluations, anchors run, labellings scored, votes of the best labelling
    fits      (M,) nats, how well each marker's point lies where all other labels predict it; 0 for a null
    """

    point_of: np.ndarray
    margins: np.ndarray
    counters: np.ndarray
    fits: np.ndarray


class BodyWorkspace(NamedTuple):
    """Working arrays of one thread for frames of n points, so that no frame allocates: see `make_body_workspace`.

    aligned      (n, 3) m, the points placed onto the mean body
    residual     (M, 3) whitened residuals of the labelled points
    information  (r, r) posterior precision of the latents, in its upper triangle, or the Cholesky factor U there, U' U = precision
    flat_information (r r,) the same memory, flat
    latent       (r,) U times the posterior mean of the latents
    solved       (r, 3 M) U'^-1 times `load_by_latent`
    centre       (3 M,) whitened displacement of the markers that the labelled points predict: x of all, then y, then z
    variance     (6, M) its covariance, as far as the latents cause it: xx, xy, xz, yy, yz, zz
    outlier      (M,) bool, labelled markers that lie too far from where the others predict them
    scores       (M, n) nats, every point as every marker
    deviation    (2,) squared Mahalanobis distance of the labelled points from the body, and the number of their coordinates
    all_markers  (M,) 0, 1, ..., M - 1
    displacement (9,) m, from an anchor's three markers in the mean body to its points: x of the three, then y, then z
    """

    aligned: np.ndarray
    residual: np.ndarray
    information: np.ndarray
    flat_information: np.ndarray
    latent: np.ndarray
    solved: np.ndarray
    centre: np.ndarray
    variance: np.ndarray
    outlier: np.ndarray
    scores: np.ndarray
    deviation: np.ndarray
    all_markers: np.ndarray
    displacement: np.ndarray


@kernel
def make_body_workspace(n, markers, latents):
    """Working arrays for frames of n points. Returns BodyWorkspace. O(M n + M r + r^2) memory."""
    # One memory with two views: sums go over the flat one, the factor over the square one.
    information = np.empty((latents, latents))
    return BodyWorkspace(
        np.empty((n, 3)),
        np.empty((markers, 3)),
        information,
        information.reshape(latents * latents),
        np.empty(latents),
        np.empty((latents, 3 * markers)),
        np.empty(3 * markers),
        np.empty((6, markers)),
        np.zeros(markers, dtype=np.bool_),
        np.empty((markers, n)),
        np.zeros(2),
        np.arange(markers),
        np.empty(9),
    )


@kernel
def count_labelled(point_of):
    """How many markers have a point. IN point_of (M,), -1 for none. O(M)."""
    labelled = 0
    for m in range(len(point_of)):
        labelled += point_of[m] >= 0
    return labelled


@kernel
def copy_labels(source, target):
    """IN source (M,). OUT target (M,). O(M). Quicker to compile than an assignment of slices, which also checks the shapes."""
    for m in range(len(source)):
        target[m] = source[m]


@kernel
def index_of(table, count, point_of):
    """Where a labelling is among those of a table. IN table (H, M), its first `count` rows; point_of (M,).

    Returns the row, -1 where it is in none. O(count M).
    """
    for h in range(count):
        # A loop that ends at the first difference, since rows differ early.
        same = True
        for m in range(len(point_of)):
            if table[h, m] != point_of[m]:
                same = False
                break
        if same:
            return h
    return -1
