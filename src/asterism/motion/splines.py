"""Noisy curves at even times in; smooth ones and their derivatives out."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.optimize import minimize_scalar

from asterism.recording import Floats

_DEGREE = 5
_VALUES, _SECONDS = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120, np.array([1.0, 2.0, -6.0, 2.0, 1.0]) / 6
"""What the five pieces of the basis that meet at a sample have there, and their second derivatives."""
LEAST = 12
"""Samples: a shorter curve tells too little of its noise."""


def quintic_spline(curve: Floats) -> BSpline:
    """The natural quintic spline through a curve (T, D), smoothed as much as generalised cross-validation says (Woltring 1986).

    One smoothness counts for all D columns. Its argument is the sample, from 0; derivatives are per sample. O(T).
    Raises ValueError for fewer than `LEAST` samples, and for samples that are not finite.

    >>> times = np.linspace(0, 2, 200)
    >>> noisy = np.sin(3 * times) + np.random.default_rng(0).normal(0, 0.01, 200)
    >>> again = quintic_spline(noisy[:, None]).derivative(2)(np.arange(200.0))[:, 0] / (times[1] ** 2)
    >>> bool(np.median(np.abs(again + 9 * np.sin(3 * times))[20:-20]) < 2.0)  # of up to 9
    True
    """
    return quintic_spline_and_power(curve)[0]


def quintic_spline_and_power(curve: Floats) -> tuple[BSpline, float]:
    """`quintic_spline`, and the smoothness that was chosen: 10 ** power weighs the square of the third derivative per sample."""
    count = len(curve)
    if count < LEAST or not np.isfinite(curve).all():
        raise ValueError(f"a spline needs {LEAST} finite samples or more")
    # The basis, transposed, times the curve.
    target = np.zeros((count + _DEGREE - 1, curve.shape[1]))
    for shift, weight in enumerate(_VALUES):
        target[shift : shift + count] += weight * curve
    # What is left of a wave of each frequency; the trace of the smoothing is their sum.
    waves = np.pi * np.arange(count) / count
    passed, stopped = _passed(waves)

    def solve(power: float) -> Floats:
        # Whole powers are tried for every curve of a recording. LAPACK as `solveh_banded`, whose checks take longer than its work.
        factor = _factor_of_whole(count, power) if power == round(power) else _factor(count, power)
        return np.asarray(dpbtrs(factor, target, lower=1)[0])

    @cache
    def criterion(power: float) -> float:
        free = 1.0 - float((passed / (passed + 10.0**power * stopped)).sum()) / count
        # A curve without noise is met by each spline: the smallest number keeps the logarithm.
        return float(np.log(((curve - _at_samples(solve(power), _VALUES)) ** 2).sum() + 1e-300) - 2 * np.log(free))

    # From no smoothing worth the name to waves of 60 samples: 10 ** power halves what is shorter than 2 pi 10 ** (power / 6) samples.
    best = float(min(np.arange(-5.0, 6.1, 2.0), key=criterion))
    # The criterion has one valley as a rule; a step beside the best of these is tried, too.
    best = float(min((best - 1.0, best, best + 1.0), key=criterion))
    if criterion(best) < min(criterion(best - 1.0), criterion(best + 1.0)):
        # Three points that enclose the valley are known already: to a hundredth, mostly after three more.
        options = {"xtol": 0.01 / max(abs(best), 1.0), "maxiter": 20}
        found = float(minimize_scalar(criterion, bracket=(best - 1.0, best, best + 1.0), method="brent", options=options).x)
    else:
        # At an end of what is tried, where nothing is smoothed, or all but a parabola, there is nothing to tell apart.
        found = float(min((best - 1.0, best, best + 1.0), key=criterion))
    return BSpline(_knots(count), solve(found), _DEGREE), found


def _at_samples(solution: Floats, weights: Floats) -> Floats:
    """(T, D) of a spline of coefficients (T + 4, D): its values or derivatives at the samples."""
    count = len(solution) - _DEGREE + 1
    end, beside, middle, *_ = weights.tolist()
    ends, besides = solution[:count] + solution[4:], solution[1 : count + 1] + solution[3 : count + 3]
    return np.asarray(end * ends + beside * besides + middle * solution[2 : count + 2])


def spline_cut_off(power: float, rate: float) -> float:
    """Hz of which 71 % is left (-3 dB) by a spline of this smoothness, away from its ends; half the rate where it keeps all."""
    waves = np.linspace(1e-3, np.pi, 2000)
    passed, stopped = _passed(waves)
    left = passed / (passed + 10.0**power * stopped)
    below = np.flatnonzero(left < np.sqrt(0.5))
    return float(rate * waves[below[0]] / (2.0 * np.pi)) if len(below) else 0.5 * rate


def _passed(waves: Floats) -> tuple[Floats, Floats]:
    """For waves of each frequency, rad per sample: what the fit and what the roughness makes of them."""
    return (66 + 52 * np.cos(waves) + 2 * np.cos(2 * waves)) / 120, (2 - 2 * np.cos(waves)) ** 3


def second_derivative(curve: Floats, rate: float) -> Floats:
    """(T, D) per s^2 of a curve (T, D) at `rate` per second, by `quintic_spline` over each run without gaps; NaN in and near gaps."""
    out = np.full(curve.shape, np.nan)
    seen = np.concatenate([[False], np.isfinite(curve).all(axis=1), [False]])
    for begin, end in np.flatnonzero(np.diff(seen.astype(int))).reshape(-1, 2):
        if end - begin >= LEAST:
            out[begin:end] = _at_samples(quintic_spline(curve[begin:end]).c, _SECONDS) * rate**2
    return out


def _knots(count: int) -> Floats:
    return np.arange(-_DEGREE, count + _DEGREE, dtype=np.float64)


def _factor(count: int, power: float) -> Floats:
    """The factor of what is solved for the coefficients, by its lower bands."""
    fit, rough = _products(count)
    return np.asarray(dpbtrf(fit + 10.0**power * rough, lower=1)[0])


# A dozen powers for the curves of one recording.
_factor_of_whole = lru_cache(maxsize=16)(_factor)


@lru_cache(maxsize=8)
def _products(count: int) -> tuple[Floats, Floats]:
    """The lower bands of products of the basis at the samples, and of `_roughness`: all curves of a recording share them."""
    basis = BSpline.design_matrix(np.arange(count, dtype=np.float64), _knots(count), _DEGREE)
    return _bands(basis.T @ basis), _bands(_roughness(count))


def _roughness(count: int) -> sparse.csc_matrix:
    """(count + 4, count + 4): the integral of products of third derivatives of the basis, from the first sample to the last."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    places = (np.arange(count - 1)[:, None] + (nodes + 1) / 2).ravel()
    squares = BSpline.design_matrix(places, np.arange(-2.0, count + 2.0), 2)
    # The third derivative of a quintic spline is the quadratic one of the third differences of its coefficients.
    size = count + 4
    differences = sparse.diags([-1.0, 3.0, -3.0, 1.0], [0, 1, 2, 3], shape=(size - 3, size))
    third = squares @ differences
    return sparse.csc_matrix(third.T @ sparse.diags(np.tile(weights / 2, count - 1)) @ third)


def _bands(matrix: sparse.spmatrix) -> Floats:
    """The lower bands of a symmetric matrix, as `solveh_banded` takes them."""
    size = matrix.shape[0]
    out = np.zeros((_DEGREE + 1, size))
    for offset in range(_DEGREE + 1):
        out[offset, : size - offset] = matrix.diagonal(-offset)
    return out
