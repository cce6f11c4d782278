"""Positions of one limb's points in; its rigid motion, the points' weights and residuals out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.motion.rigid._kernels import eigenvalue_weights, fit_frames, local_positions, point_spread
from asterism.recording import Floats

_IN_A_LINE = "the limb's points lie in a line, which leaves its rotation open; add a point beside the line."
METHODS = ("robust", "svd", "pct", "pct-half-mean", "interval-deformation")
"""robust: points weighed by how far they stray (default). svd: all points alike. pct: Andriacchi's weights. pct-half-mean: those, points
below half the mean weight left out (GaMoCap 4.1). interval-deformation: each point's own course is estimated and taken off."""


@dataclass(frozen=True)
class LimbRules:
    """How a limb's motion is estimated. Chosen on the simulated subjects 100 to 109 (seed 1), dense and sparse.

    rounds         of fitting and weighing
    tolerance_m    ends earlier where no point's residual changes by more
    flat           points whose second extent is below this share of the first lie in a line
    core           share of the points that are taken to follow the bone: their residual is the scale of the weights
    power          a point's weight falls with its squared residual to this power
    rejected       a weight below this share of the mean counts as rejected (GaMoCap 4.1: half the mean)
    pct_rounds     Gauss-Newton rounds of the eigenvalue weights
    modes          of the interval deformation, how many courses over time the skin of a limb has
    shrink         a point's own course is taken off as far as it exceeds so many times the core's residual
    """

    rounds: int = 30
    tolerance_m: float = 1e-6
    flat: float = 0.02
    core: float = 0.5
    power: float = 1.0
    rejected: float = 0.5
    pct_rounds: int = 3
    modes: int = 2
    shrink: float = 1.0


RULES = LimbRules()


@dataclass(frozen=True)
class LimbMotion:
    """How a limb moved.

    rotations     (T, 3, 3), translations (T, 3) m: world from the limb's axes, which are the world's at the reference frame; NaN where
                  fewer than three points are present or these lie in a line
    template      (N, 3) m, the points in the limb's axes, NaN for those that are never seen
    weights       (T, N) of the points, mean 1 over those present
    rejected      (T, N) bool, points whose weight is below half the mean
    residuals     (T, N) m, distance of each point from where the limb carries its template
    method        how it was estimated
    reference     the frame whose orientation the limb's axes have
    """

    rotations: Floats
    translations: Floats
    template: Floats
    weights: Floats
    rejected: NDArray[np.bool_]
    residuals: Floats
    method: str
    reference: int

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def rms(self) -> Floats:
        """(N,) m, each point's residual over the frames, NaN where it is never seen."""
        seen = np.isfinite(self.residuals)
        total = np.where(seen, self.residuals, 0.0) ** 2
        count = seen.sum(axis=0)
        return np.asarray(np.where(count > 0, np.sqrt(total.sum(axis=0) / np.maximum(count, 1)), np.nan))


def estimate_limb_motion(
    positions: ArrayLike, method: str = "robust", *, weights: ArrayLike | None = None, rules: LimbRules = RULES
) -> LimbMotion:
    """The rigid motion of one limb from the points on its skin.

    positions  (T, N, 3) m, NaN for missing
    method     one of METHODS
    weights    (N,) >= 0 that each point is worth beforehand, None for all alike

    The template is the points' mean shape in the limb's own axes, so a point may be missing in the first frame. The axes are those of the
    world in the first frame with most points, as GaMoCap's rotations are against the first frame.
    Raises AsterismError for unknown methods, other shapes, infinite positions, weights that are negative or not finite, and where fewer
    than three points not in a line are ever present together. O(rounds T N) time, O(T N) memory.

    >>> box = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.3]])
    >>> quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> motion = estimate_limb_motion([box, box @ quarter.T + [1.0, 0.0, 0.0]])
    >>> np.allclose(motion.rotations[1], quarter), np.allclose(motion.translations[1], [1.0, 0.0, 0.0])
    (True, True)
    """
    given = checked_positions(positions)
    if given.shape[1] < 3:
        raise AsterismError(f"a limb of {given.shape[1]} points has no rotation; give at least three points that are not in a line.")
    prior = _prior(weights, given.shape[1])
    if method not in METHODS:
        raise AsterismError(f"{method} is no method; choose from {', '.join(METHODS)}.")
    # The fullest frame: the limb's axes then rest on as many points as ever are seen together.
    reference = _reference_frame(given, prior, rules)
    # Weights of a point over the whole recording: skin slides the same way in each repetition.
    if method == "robust":
        fit, of_points = _fit_robustly(given, prior, reference, rules)
        weights_used = np.broadcast_to(of_points, given.shape[:2])
    elif method == "interval-deformation":
        fit, of_points = _fit_with_deformation(given, prior, reference, rules)
        weights_used = np.broadcast_to(of_points, given.shape[:2])
    else:
        # The other methods start from all points alike.
        fit = _fit_plainly(given, prior, reference, rules)
        weights_used = np.broadcast_to(prior, given.shape[:2])
        if method.startswith("pct"):
            fit, weights_used = _fit_by_clusters(given, fit, prior, rules, reject=method == "pct-half-mean")
    return _as_motion(given, fit, weights_used, method, reference, rules)


@dataclass(frozen=True)
class _Fit:
    """A template (N, 3) m and where it goes: rotations (T, 3, 3), translations (T, 3) m; squares (N,) m2 of what is left."""

    template: Floats
    rotations: Floats
    translations: Floats
    squares: Floats


def checked_positions(positions: ArrayLike) -> Floats:
    """(T, N, 3) m, contiguous. Raises AsterismError for other shapes and infinite positions."""
    given = np.ascontiguousarray(positions, dtype=np.float64)
    if given.ndim != 3 or given.shape[2] != 3:
        raise AsterismError(f"positions have shape {given.shape}, expected (frames, points, 3).")
    if np.isinf(given).any():
        raise AsterismError("a position is infinite; write missing samples as NaN.")
    return given


def _prior(weights: ArrayLike | None, points: int) -> Floats:
    prior = np.ones(points) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if len(prior) != points:
        raise AsterismError(f"{len(prior)} weights for {points} points; give one for each.")
    if not np.isfinite(prior).all() or (prior < 0).any():
        raise AsterismError("a weight is negative or not finite; give weights from 0 up, 0 for a point that does not count.")
    if (prior > 0).sum() < 3:
        raise AsterismError("fewer than three points have a weight above 0; a rotation needs three that are not in a line.")
    return prior


def _reference_frame(positions: Floats, prior: Floats, rules: LimbRules) -> int:
    """The first of the frames with the most points of weight whose points are not in a line."""
    counts = (np.isfinite(positions[:, :, 0]) & (prior > 0)).sum(axis=1)
    most = int(counts.max(initial=0))
    if most < 3:
        raise AsterismError(f"at most {most} of the limb's points are present in one frame; a rotation needs three.")
    # From the fullest frame on: a fuller one may have its points in a line, a later one not.
    for frame in np.argsort(-counts, kind="stable")[: (counts >= 3).sum()]:
        rotation, translation = np.empty((1, 3, 3)), np.empty((1, 3))
        here = positions[frame]
        fit_frames(here, positions[frame : frame + 1], prior[None], rules.flat, rotation, translation)
        if np.isfinite(rotation).all():
            return int(frame)
    raise AsterismError(_IN_A_LINE)


def _fit(positions: Floats, template: Floats, weights: Floats, rules: LimbRules) -> tuple[Floats, Floats]:
    """Rotations and translations of all frames. Raises AsterismError where none has any: the mean shape of points may lie in a line
    although that of the reference frame does not."""
    rotations, translations = _fit_frames(positions, template, weights, rules.flat)
    if not np.isfinite(rotations[:, 0, 0]).any():
        raise AsterismError(_IN_A_LINE)
    return rotations, translations


def _fit_frames(positions: Floats, template: Floats, weights: Floats, flat: float) -> tuple[Floats, Floats]:
    rotations, translations = np.empty((len(positions), 3, 3)), np.empty((len(positions), 3))
    fit_frames(template, positions, np.ascontiguousarray(np.atleast_2d(weights)), flat, rotations, translations)
    return rotations, translations


def _spread(positions: Floats, rotations: Floats, translations: Floats) -> tuple[Floats, Floats]:
    points = positions.shape[1]
    means, squares, counts = np.empty((points, 3)), np.empty(points), np.empty(points, dtype=np.int64)
    point_spread(positions, rotations, translations, means, squares, counts)
    return means, squares


def _fit_plainly(positions: Floats, weights: Floats, reference: int, rules: LimbRules) -> _Fit:
    """The mean shape and its motion, alternately, until the shape stays (generalised Procrustes without scale; Gower 1975)."""
    template = positions[reference]
    # Template and motion hold each other: each is the least squares solution for the other.
    for _ in range(rules.rounds):
        rotations, translations = _fit(positions, template, weights, rules)
        means, squares = _spread(positions, rotations, translations)
        change = np.nanmax(np.abs(means - template)) if np.isfinite(template).any() else np.inf
        # A point that has just entered the template changes the fit though the others stay.
        done = bool(change < 10 * rules.tolerance_m) and bool((np.isfinite(means) == np.isfinite(template)).all())
        template = means
        if done:
            break
    return _Fit(template, rotations, translations, squares)


def _core_scale(squares: Floats, prior: Floats, rules: LimbRules) -> float:
    """m, the residual of the points that follow the bone best: the quantile `core`, of four points at least."""
    known = np.sqrt(squares[np.isfinite(squares) & (prior > 0)])
    # Of a handful of markers half are too few to give a scale: four at least.
    share = max(rules.core, min(4 / len(known), 1.0))
    return max(float(np.quantile(known, share)), 1e-9)


def _robust_weights(squares: Floats, prior: Floats, scale: float, rules: LimbRules) -> Floats:
    with np.errstate(invalid="ignore"):
        weights = prior / (1.0 + squares / scale**2) ** rules.power
    return np.where(np.isfinite(weights), weights, 0.0)


def _fit_robustly(positions: Floats, prior: Floats, reference: int, rules: LimbRules) -> tuple[_Fit, Floats]:
    """Iteratively reweighted: a point's weight falls with its own residual over the whole recording.

    The scale begins at the largest residual and falls to that of the core by half a step at a time (graduated non-convexity), so that
    points which move alike on the skin do not take the limb over from the bone.
    """
    # All points alike give a start that no wrong weight has touched.
    fit = _fit_plainly(positions, prior, reference, rules)
    scale = float(np.sqrt(np.nanmax(fit.squares)))
    weights = prior
    for _ in range(rules.rounds):
        core = _core_scale(fit.squares, prior, rules)
        # Slowly down to the core's own scale: at once, the points that slide together could win.
        scale = max(0.6 * scale, core)
        weights = _robust_weights(fit.squares, prior, scale, rules)
        rotations, translations = _fit(positions, fit.template, weights, rules)
        means, squares = _spread(positions, rotations, translations)
        change = float(np.nanmax(np.abs(np.sqrt(squares) - np.sqrt(fit.squares))))
        fit = _Fit(means, rotations, translations, squares)
        # Only once the scale has arrived: before that the residuals may pause by chance.
        if scale <= core and change < rules.tolerance_m:
            break
    return fit, weights


def _fit_by_clusters(positions: Floats, fit: _Fit, prior: Floats, rules: LimbRules, *, reject: bool) -> tuple[_Fit, Floats]:
    """Weights that keep the eigenvalues of the inertia tensor (Andriacchi et al. 1998); with `reject`, those under half the mean are 0.

    GaMoCap, section 3.2, rejects weights "over" half the mean. That would drop the points that move as the bone does; under is meant.
    """
    # The weights compare each frame with the template, so the motion must be taken off first.
    local = np.empty_like(positions)
    local_positions(positions, fit.rotations, fit.translations, local)
    weights = np.zeros(positions.shape[:2])
    eigenvalue_weights(local, fit.template, rules.pct_rounds, weights)
    weights *= prior
    # A rejected point has no weight at all, unless too few would be left to turn the limb.
    if reject:
        present = np.maximum((weights > 0).sum(axis=1), 1)[:, None]
        kept = weights >= rules.rejected * weights.sum(axis=1, keepdims=True) / present
        enough = (kept & (weights > 0)).sum(axis=1) >= 3
        weights = np.where(kept | ~enough[:, None], np.where(enough[:, None], 1.0 * (weights > 0) * prior, weights), 0.0)
    rotations, translations = _fit_frames(positions, fit.template, weights, rules.flat)
    # Weights that leave a frame no rotation tell nothing of it: there the plain fit stands, with the weights that it had.
    lost = ~np.isfinite(rotations).all(axis=(1, 2))
    rotations[lost], translations[lost], weights[lost] = fit.rotations[lost], fit.translations[lost], prior
    return _Fit(fit.template, rotations, translations, fit.squares), weights


def _fit_with_deformation(positions: Floats, prior: Floats, reference: int, rules: LimbRules) -> tuple[_Fit, Floats]:
    """Each point strays along courses over time that the limb's skin shares; as few points as possible stray (soft threshold).

    After the interval deformation technique (Alexander and Andriacchi 2001), whose courses are given functions of an activity. Here they
    are the principal courses of the residuals. What a course takes off a point is cut by `shrink` core residuals, so that a rigid motion
    is not taken for a deformation of all points.
    """
    fit, weights = _fit_robustly(positions, prior, reference, rules)
    # What is taken off a point must not fill its gaps.
    present = np.isfinite(positions[:, :, 0])
    # Courses, motion and weights change one another: a few rounds.
    for _ in range(3):
        local = np.empty_like(positions)
        local_positions(positions, fit.rotations, fit.translations, local)
        stray = np.where(np.isfinite(local), local - fit.template, 0.0)
        square = np.einsum("tnc,snc,n->ts", stray, stray, prior)
        # The courses over time that explain most of the straying, whichever points show it.
        courses = np.linalg.eigh(square)[1][:, -rules.modes :]
        amplitudes = np.einsum("tk,tnc->knc", courses, stray)
        size = np.linalg.norm(amplitudes, axis=2, keepdims=True)
        limit = rules.shrink * _core_scale(fit.squares, prior, rules) * np.sqrt(len(positions))
        # Soft threshold: a point that strays no more than the core keeps its place, others keep what exceeds it.
        amplitudes *= np.maximum(1.0 - limit / np.maximum(size, 1e-12), 0.0)
        bent = np.einsum("tk,knc->tnc", courses, amplitudes)
        taken_off = positions - np.einsum("tij,tnj->tni", fit.rotations, bent)
        taken_off[~present] = np.nan
        rotations, translations = _fit(taken_off, fit.template, weights, rules)
        means, squares = _spread(taken_off, rotations, translations)
        fit = _Fit(means, rotations, translations, squares)
        weights = _robust_weights(squares, prior, _core_scale(squares, prior, rules), rules)
    return fit, weights


def _as_motion(positions: Floats, fit: _Fit, weights: Floats, method: str, reference: int, rules: LimbRules) -> LimbMotion:
    """The motion with the limb's axes turned to those of the world at the reference frame."""
    if np.isnan(fit.rotations[reference, 0, 0]):  # its points lie in a line once the mean shape is known: the fullest frame that is left
        known = np.isfinite(fit.rotations[:, 0, 0])
        reference = int(np.argmax(np.where(known, np.isfinite(positions[:, :, 0]).sum(axis=1), -1)))
    turn, shift = fit.rotations[reference], fit.translations[reference]
    # The same motion about other axes: those of the world in the reference frame, as GaMoCap counts.
    rotations = fit.rotations @ turn.T
    translations = fit.translations - rotations @ shift
    template = fit.template @ turn.T + shift
    local = np.empty_like(positions)
    local_positions(positions, rotations, translations, local)
    residuals = np.linalg.norm(local - template, axis=2)
    present = np.isfinite(residuals)
    shown = np.where(present, weights, 0.0)
    # Mean 1 over the points present: weights of frames with gaps compare with those without.
    mean = shown.sum(axis=1, keepdims=True) / np.maximum(present.sum(axis=1, keepdims=True), 1)
    shown = shown / np.where(mean > 0, mean, 1.0)
    return LimbMotion(rotations, translations, template, shown, present & (shown < rules.rejected), residuals, method, reference)


def refit_limb_motion(positions: Floats, motion: LimbMotion) -> tuple[Floats, Floats]:
    """Rotations (T, 3, 3) and translations (T, 3) m of a limb whose points have moved a little since `motion` was estimated.

    positions (T, N, 3) m of the same points. Template and weights begin where they were, so that a trial of a Monte Carlo costs two
    passes over the points. Robust weights are estimated anew in between; those of the other methods stay. NaN where `motion` is, and
    where fewer than three points are left. O(T N).
    """
    robust = motion.method in ("robust", "interval-deformation")
    given = np.ascontiguousarray(positions)
    weights: Floats = np.ascontiguousarray(motion.weights)
    template = motion.template
    # `motion` says which frames have a rotation: noise on points that lie nearly in a line must not decide it again (flat 0).
    rotations, translations = _fit_frames(given, template, weights, 0.0)
    if np.isfinite(rotations[:, 0, 0]).any():
        template, squares = _spread(given, rotations, translations)
        if robust:
            weights = _robust_weights(squares, np.ones(len(squares)), _core_scale(squares, np.ones(len(squares)), RULES), RULES)
        rotations, translations = _fit_frames(given, template, weights, 0.0)
    unknown = np.isnan(motion.rotations[:, 0, 0])
    rotations[unknown], translations[unknown] = np.nan, np.nan
    return rotations, translations
