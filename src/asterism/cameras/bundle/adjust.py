"""Levenberg-Marquardt over cameras and objects: cameras and sightings in, better cameras, their residuals and their covariance out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.cameras.bundle import _kernels as kernels
from asterism.cameras.bundle.sightings import PARAMETERS, Bools, Sightings
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.geometry import cross_matrix, nearest_orthogonal
from asterism.geometry.shared_kernels import rotate_by
from asterism.recording import Floats

_GROUPS = {
    "pose": slice(0, 6),
    "focal": slice(6, 7),
    "aspect": slice(7, 8),
    "centre": slice(8, 10),
    "k1": slice(10, 11),
    "k2": slice(11, 12),
    "k3": slice(12, 13),
    "tangential": slice(13, 15),
}


@dataclass(frozen=True)
class AdjustSettings:
    """How a bundle adjustment weighs residuals, and when it ends.

    loss            "huber" grows linearly beyond `scale` px, "cauchy" hardly grows: outliers are forgotten
    scale           px, where the loss begins to differ from least squares
    relative_noise  (C,) the cameras' noise, one by another: residuals count divided by it; None where it is the same for all
    tolerance       ends when a step lowers the cost by less than this share
    steps           at most
    covariance      whether the covariance of the parameters is computed
    damping         Levenberg and Marquardt's, a share of the diagonal: where it begins
    damping_up      factor after a step that fails
    damping_down    factor after a step that succeeds
    max_damping     damping at which the search ends
    """

    loss: Literal["huber", "cauchy"] = "huber"
    scale: float = 1.0
    relative_noise: ArrayLike | None = None
    tolerance: float = 1e-8
    steps: int = 60
    covariance: bool = True
    damping: float = 1e-3
    damping_up: float = 5.0
    damping_down: float = 0.15
    max_damping: float = 1e10


@dataclass(frozen=True)
class Adjustment:
    """What a bundle adjustment gives.

    cameras       (C,) adjusted, each with the RMS of its residuals as `error`
    rotations     (T, 3, 3), translations (T, 3) m: world from object, per frame
    residuals     (n, 2) px, seen minus projected, per sighting; NaN where the point came to lie behind the camera
    weights       (n,) what the robust loss left of each sighting, 1 within its scale; divided by the square of its camera's relative noise
    free          (C, 15) bool: which parameters were adjusted, in the order of PARAMETERS
    covariance    (free, free) of the free parameters, row by row of `free`, in px, m and rad, for a pixel noise of `noise`
    noise         px, standard deviation of one coordinate of a camera of relative noise 1, from the weighted residuals and the redundancy
    cost          px2, half the sum of squares where all residuals are within the scale of the loss, priors included
    steps         how many steps were tried
    converged     whether the last step no longer changed the cost
    no_scale      whether objects are single points, which leave the size of the world open
    """

    cameras: tuple[Camera, ...]
    rotations: Floats
    translations: Floats
    residuals: Floats
    weights: Floats
    free: Bools
    covariance: Floats
    noise: float
    cost: float
    steps: int
    converged: bool
    no_scale: bool = False

    @property
    def sigma(self) -> Floats:
        """(C, 15) standard deviation of each camera parameter, NaN where it was fixed."""
        sigma = np.full(self.free.shape, np.nan)
        sigma[self.free] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return sigma

    @property
    def position_sigma(self) -> Floats:
        """(C,) m, standard deviation of each camera's position, relative to all of them rather than to the one that was held.

        The covariance of the positions with what a turn and a shift of the whole world explain taken out of it (an S-transformation,
        Baarda 1973).
        """
        count = len(self.cameras)
        by_parameter = np.zeros((3 * count, self.free.size))
        rigid = np.zeros((3 * count, 6))
        for c, camera in enumerate(self.cameras):
            rows, first = slice(3 * c, 3 * c + 3), c * len(PARAMETERS)
            # A camera's place is -R^T t: how it moves with a turn of the camera, and with a shift.
            by_parameter[rows, first : first + 3] = -camera.rotation.T @ cross_matrix(camera.translation)
            by_parameter[rows, first + 3 : first + 6] = -camera.rotation.T
            rigid[rows] = np.hstack([-cross_matrix(camera.position), np.eye(3)])
        # Single points leave the size open, so that a larger world explains part of the spread, too.
        if self.no_scale:
            places = np.stack([camera.position for camera in self.cameras])
            rigid = np.column_stack([rigid, (places - places.mean(axis=0)).ravel()])
        # What the world's own turn and shift explain is nobody's uncertainty.
        left = np.eye(3 * count) - rigid @ np.linalg.pinv(rigid)
        steps = left @ by_parameter[:, self.free.ravel()]
        variance = np.einsum("ij,jk,ik->i", steps, self.covariance, steps)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0).reshape(count, 3).sum(axis=1)))

    @property
    def rms(self) -> float:
        """px, the reprojection error over all sightings: root of the mean squared distance."""
        return rms(self.residuals)


def rms(residuals: Floats) -> float:
    """The root of the mean squared length of residuals (n, 2), px; rows with NaN do not count."""
    square = np.square(residuals).sum(axis=1)
    square = square[np.isfinite(square)]
    return float(np.sqrt(square.mean())) if len(square) else float("nan")


def free_parameters(cameras: int, *groups: str) -> Bools:
    """(cameras, 15) bool: these groups freed for every camera: pose, focal, aspect, centre, k1, k2, k3, tangential."""
    free = np.zeros((cameras, len(PARAMETERS)), dtype=bool)
    for group in groups:
        free[:, _GROUPS[group]] = True
    return free


def adjust(
    cameras: Sequence[Camera],
    template: ArrayLike,
    sightings: Sightings,
    rotations: Floats,
    translations: Floats,
    *,
    free: ArrayLike | None = None,
    prior: tuple[Floats, Floats] | None = None,
    settings: AdjustSettings | None = None,
) -> Adjustment:
    """Fit cameras and the object's placement in each frame together to what was seen, by least squares of reprojection errors.

    cameras       (C,) where to begin
    template      (K, 3) m, the object's points in its own axes; in a line, or a single one, are fine
    sightings     frames are rows of `rotations`; each frame should give at least as many coordinates as its object has freedoms
    rotations     (T, 3, 3), translations (T, 3) m: world from object, where to begin
    free          (C, 15) bool in the order of PARAMETERS, by default poses and focal lengths. Where no camera's pose is fixed the first
                  one's is, since images leave open where the world begins; for a template of one point the scale is held, too
    prior         expected values and their standard deviations (C, 15), the latter in px, m, rad per px of noise; inf where nothing is
                  expected. The expected turns and shifts are those of `cameras` whatever the values say

    Analytic Jacobians, objects eliminated (Schur complement), Marquardt's damping. Cost of a step: O(n + T D^2 F + T D F^2) for F free
    camera parameters and D freedoms of the object. Raises AsterismError where a frame number is out of range or nothing was seen.
    """
    settings = settings or AdjustSettings()
    if not len(sightings):
        raise AsterismError("a bundle adjustment was given no sightings.")
    if sightings.frame[-1] >= len(rotations) or len(rotations) != len(translations):
        raise AsterismError(f"sightings name frame {int(sightings.frame[-1])}, but only {len(rotations)} placements were given.")
    # A wand has no turn about its own line: freedoms that nothing shows are taken out before the equations are set up.
    model, turn_back, axes = _principal_axes(np.asarray(template, dtype=np.float64).reshape(-1, 3))
    wanted: Bools = free_parameters(len(cameras), "pose", "focal") if free is None else np.array(free, dtype=bool)
    state = _AdjustmentState.of(cameras, rotations @ turn_back, translations)
    # Images say nothing of where the world begins, and equations with that freedom have no solution.
    _hold_the_world(wanted, state, single=len(axes) == 3)
    problem = _BundleProblem(model, sightings, wanted, axes, settings, prior)
    state, cost, done, converged = _descend(problem, state)
    residuals, weights = problem.residuals(state)[:2]
    noise = problem.noise(residuals, weights)
    spread: Floats = np.empty((0, 0))
    if settings.covariance and problem.unknowns:
        # The pseudo-inverse, since a parameter that nothing determines must not spoil those of the others.
        spread = np.asarray(noise**2 * np.linalg.pinv(problem.normal(state, residuals, weights, 0.0).matrix, hermitian=True))
    errors = [rms(residuals[sightings.camera == c]) for c in range(len(cameras))]
    return Adjustment(
        state.cameras(cameras, errors), state.turned @ turn_back.T, state.placed, residuals, weights, wanted, spread, noise, cost, done,
        converged, len(axes) == 3,
    )  # fmt: skip


@dataclass
class _AdjustmentState:
    """Cameras and objects as arrays, the adjustment's working copy."""

    lens: Floats
    rotation: Floats
    translation: Floats
    turned: Floats
    placed: Floats

    @classmethod
    def of(cls, cameras: Sequence[Camera], turned: Floats, placed: Floats) -> _AdjustmentState:
        radial = max(3, *(len(camera.radial) for camera in cameras)) if len(cameras) > 1 else max(3, len(cameras[0].radial))
        lens = np.zeros((len(cameras), 9 + radial))
        for c, camera in enumerate(cameras):
            lens[c, : len(camera.lens)] = camera.lens
        turns, shifts = (np.array([getattr(camera, name) for camera in cameras]) for name in ("rotation", "translation"))
        return cls(lens, turns, shifts, np.ascontiguousarray(turned), np.array(placed))

    def camera_arrays(self) -> kernels.BundleCameras:
        return kernels.BundleCameras(self.lens, self.rotation, self.translation)

    def objects(self, template: Floats) -> kernels.ObjectArrays:
        return kernels.ObjectArrays(self.turned, self.placed, template)

    def copy(self) -> _AdjustmentState:
        return _AdjustmentState(self.lens.copy(), self.rotation.copy(), self.translation.copy(), self.turned.copy(), self.placed.copy())

    def values(self) -> Floats:
        """(C, 15) in the order of PARAMETERS, turns and shifts 0."""
        lens = self.lens
        zero = np.zeros((len(lens), 6))
        return np.column_stack([zero, lens[:, 0], lens[:, 1] / lens[:, 0], lens[:, 2:4], lens[:, 9:12], lens[:, 4:6]])

    def move_cameras(self, step: Floats) -> None:
        for c, part in enumerate(step):
            rotate_by(self.rotation[c], part[0], part[1], part[2], False)
        self.translation += step[:, 3:6]
        # The parameters are one focal length and the ratio of the two, which a prior can keep at square pixels.
        aspect = self.lens[:, 1] / self.lens[:, 0] + step[:, 7]
        self.lens[:, 0] += step[:, 6]
        self.lens[:, 1] = aspect * self.lens[:, 0]
        self.lens[:, 2:4] += step[:, 8:10]
        self.lens[:, 9:12] += step[:, 10:13]
        self.lens[:, 4:6] += step[:, 13:15]

    def cameras(self, before: Sequence[Camera], errors: Sequence[float]) -> tuple[Camera, ...]:
        # Many small turns leave a matrix that is a rotation to rounding only.
        turned = nearest_orthogonal(self.rotation)
        return tuple(
            replace(
                camera,
                focal=(float(lens[0]), float(lens[1])),
                centre=(float(lens[2]), float(lens[3])),
                rotation=turned[c],
                translation=self.translation[c],
                radial=tuple(lens[9 : 9 + max(len(camera.radial), _last_radial(lens))]),
                tangential=(float(lens[4]), float(lens[5])),
                error=errors[c],
                posed=True,
            )
            for c, (camera, lens) in enumerate(zip(before, self.lens, strict=True))
        )


@dataclass(frozen=True)
class _Normal:
    """The reduced normal equations, and what takes the cameras' step back to the objects."""

    matrix: Floats
    gradient: Floats
    reduced: Floats
    factors: Floats
    shifted: Floats


class _BundleProblem:
    """What stays the same from step to step."""

    def __init__(
        self, model: Floats, seen: Sightings, wanted: Bools, axes: Any, settings: AdjustSettings, prior: tuple[Floats, Floats] | None
    ) -> None:
        self.model, self.seen, self.axes, self.settings, self.wanted = model, seen, axes, settings, wanted
        given = settings.relative_noise
        self.relative = np.ones(len(wanted)) if given is None else np.asarray(given, dtype=np.float64)
        self.unknowns = int(wanted.sum())
        self.free = [np.nonzero(own)[0] for own in wanted]
        # The column of each free parameter in the equations, -1 where it is fixed.
        self.columns = np.where(wanted, np.cumsum(wanted.ravel()).reshape(wanted.shape) - 1, -1)
        self.expected = None if prior is None else prior[0]
        self.stiffness: Floats = np.zeros(wanted.shape) if prior is None else 1.0 / np.square(prior[1])
        kind = kernels.CAUCHY if settings.loss == "cauchy" else kernels.HUBER
        self.loss = kernels.Loss(kind, float(settings.scale), self.relative)

    def sightings(self, frames: int) -> kernels.SightingArrays:
        """The sightings as the kernels take them; starts (T + 1,): whose frame's rows begin where."""
        seen = self.seen
        starts = np.searchsorted(seen.frame, np.arange(frames + 1))
        return kernels.SightingArrays(seen.frame, starts, seen.camera, seen.point, seen.xy)

    def distance_from_prior(self, state: _AdjustmentState, moved: Floats) -> Floats:
        """(C, 15) how far the cameras are from what was expected; of turns and shifts, how far they have moved."""
        distance: Floats = moved.copy()
        if self.expected is not None:
            distance[:, 6:] = state.values()[:, 6:] - self.expected[:, 6:]
        return distance

    def residuals(self, state: _AdjustmentState) -> tuple[Floats, Floats, float]:
        """Residuals (n, 2) px, weights (n,), and their cost."""
        residuals, weights = np.empty((len(self.seen), 2)), np.empty(len(self.seen))
        seen = self.sightings(len(state.placed))
        cost = kernels.residuals_and_cost(state.camera_arrays(), state.objects(self.model), seen, self.loss, residuals, weights)
        return residuals, weights, cost

    def noise(self, residuals: Floats, weights: Floats) -> float:
        """px, of one coordinate of a camera of relative noise 1, from weighted residuals and the redundancy."""
        # Two coordinates for each sighting, as far as it counts, less what was fitted to them.
        redundancy = 2.0 * (weights * self.relative[self.seen.camera] ** 2).sum() - self.wanted.sum()
        redundancy = redundancy - len(self.axes) * len(np.unique(self.seen.frame))
        return float(np.sqrt(np.nansum(weights * np.square(residuals).sum(axis=1)) / max(redundancy, 1.0)))

    def prior_cost(self, off: Floats) -> float:
        return 0.5 * float((self.stiffness * np.square(off))[self.wanted].sum())

    def normal(self, state: _AdjustmentState, residuals: Floats, weights: Floats, damping: float) -> _Normal:
        """Gauss-Newton's equations, damped; without the gradient of the priors."""
        dof, frames = len(self.axes), len(state.placed)
        out = kernels.NormalArrays(
            np.zeros((len(state.lens), len(PARAMETERS), len(PARAMETERS))), np.zeros(self.unknowns),
            np.zeros((frames, dof, self.unknowns)), np.zeros((frames, dof, dof)), np.zeros((frames, dof)),
        )  # fmt: skip
        kernels.linearise(
            state.camera_arrays(), state.objects(self.model), self.sightings(frames), residuals, weights, self.columns, self.axes,
            damping, out,
        )  # fmt: skip
        blocks, gradient, reduced, factors, shifted = out
        flat = reduced.reshape(frames * dof, self.unknowns)
        matrix = -(flat.T @ flat)
        end = 0
        for c, own in enumerate(self.free):
            at = slice(end, end := end + len(own))
            block = blocks[c][own[:, None], own]
            diagonal = np.einsum("ii->i", block)  # a view
            diagonal += self.stiffness[c, own]
            diagonal += damping * diagonal
            matrix[at, at] += block
        return _Normal(matrix, gradient - flat.T @ shifted.ravel(), reduced, factors, shifted)


@dataclass(frozen=True)
class _AdjustmentTrial:
    """A state of the search and its cost, priors included."""

    state: _AdjustmentState
    moved: Floats
    residuals: Floats
    weights: Floats
    from_prior: Floats
    cost: float

    @classmethod
    def at(cls, problem: _BundleProblem, state: _AdjustmentState, moved: Floats) -> _AdjustmentTrial:
        residuals, weights, cost = problem.residuals(state)
        from_prior = problem.distance_from_prior(state, moved)
        return cls(state, moved, residuals, weights, from_prior, cost + problem.prior_cost(from_prior))


def _descend(problem: _BundleProblem, state: _AdjustmentState) -> tuple[_AdjustmentState, float, int, bool]:
    """Levenberg-Marquardt until a step changes nothing: the state, its cost, the steps tried, and whether it converged."""
    settings = problem.settings
    damping, tolerance = settings.damping, settings.tolerance
    best = _AdjustmentTrial.at(problem, state, np.zeros(problem.wanted.shape))
    done = 0
    while done < settings.steps and damping < settings.max_damping:
        done += 1
        trial = _step(problem, best, damping)
        if trial is None:
            damping *= settings.damping_up
            continue
        if not trial.cost <= best.cost:
            if trial.cost - best.cost <= tolerance * best.cost:
                return best.state, best.cost, done, True
            damping *= settings.damping_up
            continue
        gain, best = best.cost - trial.cost, trial
        if gain <= tolerance * best.cost:
            return best.state, best.cost, done, True
        damping = max(damping * settings.damping_down, 1e-12)
    return best.state, best.cost, done, False


def _step(problem: _BundleProblem, best: _AdjustmentTrial, damping: float) -> _AdjustmentTrial | None:
    """One damped step of cameras and objects; None where the equations are singular or the step leads to impossible cameras."""
    normal = problem.normal(best.state, best.residuals, best.weights, damping)
    move: Floats = np.zeros(0)
    if problem.unknowns:
        try:
            right = normal.gradient - (problem.stiffness * best.from_prior)[problem.wanted]
            move = np.asarray(np.linalg.solve(normal.matrix, right), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
    step = np.zeros(problem.wanted.shape)
    step[problem.wanted] = move
    state = best.state.copy()
    state.move_cameras(step)
    kernels.move_objects(state.turned, state.placed, normal.factors, normal.shifted - normal.reduced @ move, problem.axes)
    if not (np.isfinite(step).all() and (state.lens[:, :2] > 1.0).all()):
        return None
    return _AdjustmentTrial.at(problem, state, best.moved + step)


def _hold_the_world(wanted: Bools, state: _AdjustmentState, single: bool) -> None:
    """Fix what images leave open: where the world begins and how it is turned, and its size where the object is a single point."""
    if not wanted[:, :6].any(axis=1).all():
        return
    wanted[0, :6] = False
    if single and len(wanted) > 1:
        places = -np.einsum("cji,cj->ci", state.rotation, state.translation)
        baseline = np.einsum("cij,cj->ci", state.rotation, places - places[0])
        c, axis = np.unravel_index(np.argmax(np.abs(baseline)), baseline.shape)
        wanted[c, 3 + axis] = False


def _principal_axes(template: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """The template turned so that a line lies along x: its points, the rotation (3, 3) back, and which of its six parameters show."""
    spread = template - template.mean(axis=0)
    _, sizes, vt = np.linalg.svd(spread, full_matrices=True)
    if len(template) == 1 or sizes[0] < 1e-12:
        return template, np.eye(3), np.array([3, 4, 5])
    if len(template) > 2 and sizes[1] > 1e-9 * sizes[0]:
        return template, np.eye(3), np.arange(6)
    axes = vt if np.linalg.det(vt) > 0 else vt * np.array([[1.0], [1.0], [-1.0]])
    return template @ axes.T, np.ascontiguousarray(axes.T), np.array([1, 2, 3, 4, 5])


def _last_radial(lens: Floats) -> int:
    there = np.nonzero(lens[9:])[0]
    return int(there[-1]) + 1 if len(there) else 0
