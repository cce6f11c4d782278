"""One gap of one marker in; its positions with their standard deviation out, by a Gaussian process over pose and time.

The marker is seen in the axes of markers that keep their distance to it. What is left there is a function of the pose, which the other
markers show, and of time (Rasmussen and Williams 2006, ch. 2 and 4). How many mates make the axes, and which kernel, is judged by blocks
as long as the gap that are left out; all blocks follow from one inverse (there, section 5.4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import lapack
from scipy.special import stdtrit

from asterism.motion.rigid._kernels import fit_frames, local_positions
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class Kernel:
    """A covariance of a coordinate in the mates' axes: linear and curved in the pose, Matern 5/2 in time, and noise.

    linear, curved, slow  mm, how far each of the three parts reaches
    length                s, over which the part in time changes
    noise                 mm of a measured coordinate
    width                 over which the curved part changes, in typical distances between the poses of two frames
    rough                 whether the curved part is a Matern 3/2 in place of a Gaussian
    """

    linear: float
    curved: float
    slow: float
    length: float
    noise: float
    width: float = 0.5
    rough: bool = False


@dataclass(frozen=True)
class GapRules:
    """What is tried for a gap. Chosen on recordings of `movement`; none on `gait`.

    mates     how many of the steadiest markers make the axes: each number is a candidate; without 3, errors grow by 6 %
    kernels   candidates in the mates' axes: of 60 drawn at random, the five that together err least on 960 gaps of 0.5 and 1 s, one
              after the other and exchanged. On other gaps they err 11 % less than four set by hand; three err 3 % more, six 1 % less
    times     candidates in the laboratory's axes, of time alone: smoothing splines
    brief     s, gaps up to which the next two count: at 0.3, errors at 0.25 s are 3 % more, at half nothing changes at 0.1 s
    brief_kernels, brief_times  the same, chosen on 480 gaps of 0.1 s: smoother, with less noise. On other gaps they err a quarter less
    pose      mates that make the axes in which the pose is seen; 3, 6 and 10 err 3, 6 and 10 % more at 1 s
    lengths   mates whose distances mend a candidate for gaps that are not brief: without, one marker errs 2 to 4 % more, three at once 4
              to 6 %; 6 err 1 % more
    local     power by which markers that move against the filled one count less in the pose; 1 errs 9 % more, 2 and 4 up to 8 %
    scores    principal components of the pose; 20 err 1 % more, 12 err 4 %
    frames    most frames that are learned from: time grows with the square to the cube, 200 and 160 change errors by 3 %
    dense     1/s, how many frames are learned from of a recording that has more, for gaps that are not brief: at 33 errors are the same,
              to 3 %; at 100 they are 4 to 15 % more, and at 200 Hz and more without it half as much again
    near      share of these that are next to the gap in time, the others next to it in pose; 0.4 and 0.7 change nothing
    shown     frames of each other trial that are looked at, evenly spaced; 60 err the same, 180 1 to 2 % more
    elsewhere most of these that are learned from, the nearest in pose; with 30 errors grow by 2 to 4 %
    power     candidates count by the power of their error: 4 and 8 differ by 1 %
    worst     a candidate that errs this many times as much as the best does not count
    reach     frames before and behind the gap that are looked at, so that hours cost no more than a trial
    """

    mates: tuple[int, ...] = (3, 4, 6, 10, 99)
    kernels: tuple[Kernel, ...] = (
        Kernel(20.0, 3.0, 1.0, 0.05, 0.3, 4.0),
        Kernel(20.0, 3.0, 1.0, 0.5, 0.3, 0.3),
        Kernel(50.0, 20.0, 2.0, 0.5, 0.03, 0.6),
        Kernel(20.0, 10.0, 12.0, 0.2, 0.1, 1.15, rough=True),
        Kernel(8.0, 6.0, 2.0, 0.1, 0.1, 0.3, rough=True),
    )
    times: tuple[Kernel, ...] = (Kernel(0.0, 0.0, 300.0, 0.25, 0.1),)
    brief: float = 0.2
    brief_kernels: tuple[Kernel, ...] = (
        Kernel(8.0, 10.0, 2.0, 0.1, 0.3, 2.5, rough=True),
        Kernel(50.0, 6.0, 12.0, 0.5, 0.01, 0.3),
        Kernel(50.0, 0.0, 20.0, 0.3, 0.01),
        Kernel(20.0, 10.0, 1.0, 0.5, 0.1, 2.5),
    )
    brief_times: tuple[Kernel, ...] = (Kernel(0.0, 0.0, 300.0, 0.25, 0.1), Kernel(0.0, 0.0, 300.0, 0.5, 0.03))
    pose: int = 4
    lengths: int = 4
    local: float = 3.0
    scores: int = 30
    frames: int = 180
    dense: float = 50.0
    near: float = 0.55
    shown: int = 90
    elsewhere: int = 60
    power: float = 8.0
    worst: float = 1.6
    reach: int = 1000


RULES = GapRules()
_PRESENT = 0.7
"""Share of the frames in which a marker must be seen to tell the pose: its own long gaps are bridged by straight lines."""
_BRIDGE = 0.05
"""s, the longest hole of a mate over which a spline is as good as seeing it: it errs 0.5 mm there, and 1.7 mm at twice the length."""
_EXTENT = 25.0
"""mm, second largest extent of the mates' shape: three in a line leave the turn about it open."""
_SINGLE = 15.0
"""mm by which a marker that never moves against the filled one is held to move: a third and double change errors by 3 %."""
_OFFSET = 6.0
"""mm by which a marker may sit elsewhere in another trial: 0 errs 7 % more on gaps of 1 s, 3 and 12 the same."""
_FEW_FRAMES = 20
"""Frames of a trial from which it is worth as much as others where a marker is known from other trials alone."""
_OTHER = 1e6
"""s between frames of different trials, which are independent but for the pose."""
_ALL_MOVED = 2.4
"""Mean over standard deviation of how far a mate that jumps moves axes of 3, 4, 6 and 10 mates: 1/3, 1/4, 1/6 and 1/10 of its jump."""
_STRAY, _JUMP = 8.0, 5.0
"""A sample is no part of the path where the others foretell it this many times worse than most, and by at least so many mm. In `movement`
one gap of eleven has such samples, whose loss changes errors by less than 1 %; at half, every second one, and errors grow by 1 to 3 %."""
_FEW_STRAYS = 0.15
"""Share of the frames that may be strays, neighbours that foretell badly for their sake included: more of them are movement."""
_JUDGED = 12
"""Rows of a block that judge it: 25 and 50 choose the same, to 0.1 %, and take a tenth and a fifth longer."""
_EDGE = 3
"""Frames on either side of a gap that are learned from in any case."""
_LEAST = 0.01
"""mm, the least standard deviation that is stated: coordinates in files are no finer."""


@dataclass(frozen=True)
class GapTrial:
    """One recording of a person.

    points  (T, N, 3) mm, gaps bridged; NaN for a marker that is never seen
    seen    (T, N) whether a sample was measured; shown: or lies so near to one that the bridge is as good
    frames  (T,) their numbers from 0; rate in frames per second
    """

    points: Floats
    seen: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    frames: Ints
    rate: float

    @classmethod
    def of(cls, positions: Floats, rate: float) -> GapTrial:
        """Of positions (T, N, 3) mm, NaN for missing: short holes are bridged by cubic splines, long ones by straight lines."""
        points, frames = positions.copy(), np.arange(len(positions))
        seen = np.isfinite(positions[:, :, 0])
        shown = seen.copy()
        for column in np.nonzero(seen.any(axis=0) & ~seen.all(axis=0))[0]:
            there, holes = np.nonzero(seen[:, column])[0], np.nonzero(~seen[:, column])[0]
            after = np.searchsorted(there, holes)
            inside = (after > 0) & (after < len(there))
            # Beyond its ends nothing holds a spline.
            short = inside & (there[np.minimum(after, len(there) - 1)] - there[np.maximum(after - 1, 0)] <= _BRIDGE * rate + 1.0)
            for axis in range(3):
                points[holes, column, axis] = np.interp(holes, there, positions[there, column, axis])
            if short.any() and len(there) >= 4:
                points[holes[short], column] = CubicSpline(there, positions[there, column])(frames[holes[short]])
                shown[holes[short], column] = True
        return cls(points, seen, shown, frames, rate)

    def some(self, which: Ints) -> GapTrial:
        """The same of some frames."""
        return replace(self, points=self.points[which], seen=self.seen[which], shown=self.shown[which], frames=self.frames[which])


@dataclass(frozen=True)
class _Frames:
    """The frames of all trials, one after the other: points, seen and shown as in `GapTrial`; trial (F,); time (F,) s within it."""

    points: Floats
    seen: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    trial: Ints
    time: Floats

    @classmethod
    def of(cls, trials: Sequence[GapTrial]) -> _Frames:
        points, seen, shown = (np.concatenate([getattr(trial, name) for trial in trials]) for name in ("points", "seen", "shown"))
        many = [len(trial.points) for trial in trials]
        time = np.concatenate([trial.frames / trial.rate for trial in trials])
        return cls(points, seen, shown, np.repeat(np.arange(len(trials)), many), time)


@dataclass(frozen=True)
class _Candidate:
    """What one choice of axes and kernel says.

    off        (blocks, some, 3) mm to these, in some rows of each; expected (blocks, some) mm2, the variance that it stated for them
    apart      how many blocks there are that share no row, also with parts of blocks
    positions  (G, 3) mm in the gap; variance (G,) mm2 of a coordinate
    lengths    (G, K) mm, what it says of the distances to mates, and lengths_off (blocks, some, K) mm to those; K is 0 in the room's axes
    """

    off: Floats
    expected: Floats
    apart: float
    positions: Floats
    variance: Floats
    lengths: Floats
    lengths_off: Floats


def predict_gap(trials: Sequence[GapTrial], column: int, gap: Ints, rules: GapRules = RULES) -> tuple[Floats, Floats] | None:
    """The positions of a marker in a gap (G, 3) mm and the standard deviation of a coordinate (G,) mm; None where too little is seen.

    trials  of one person, the one with the gap first, all with the same columns. A marker that the first one never shows is predicted from
            the others, by the pose alone
    gap     (G,) consecutive frames of the first trial in which the marker is missing
    O(kernels x frames^3).
    """
    near = np.arange(max(gap[0] - rules.frames, 0), min(gap[-1] + rules.frames + 1, len(trials[0].seen)))
    around = np.arange(max(gap[0] - rules.reach, 0), min(gap[-1] + rules.reach + 1, len(trials[0].seen)))
    # What is far in time is asked for its pose, which changes little from frame to frame.
    around = np.union1d(near, around[:: max(len(around) // rules.frames, 1)])
    first, gap = trials[0].some(around), np.searchsorted(around, gap)
    # A trial in which the marker is hardly seen says nothing about it.
    others = [t for t in trials[1:] if len(t.seen) and t.seen[:, column].mean() > _PRESENT]
    frames = _Frames.of([first, *(t.some(t.frames[:: max(len(t.seen) // rules.shown, 1)]) for t in others)])
    usable: NDArray[np.bool_] = np.asarray(frames.shown[gap].all(axis=0))
    for trial in range(1 + len(others)):
        usable &= frames.seen[frames.trial == trial].mean(axis=0) > _PRESENT
    usable[column] = False
    observed = np.nonzero(frames.seen[:, column])[0]
    own = (frames.trial[observed] == 0).sum()
    # Two samples make a line, of which nothing can be left out.
    if 0 < own < 4 or len(observed) < 4:
        return None
    mates = _by_steadiness(frames, column, np.nonzero(usable)[0], observed)
    for mate in mates[: rules.pose]:
        fewer = observed[frames.shown[observed, mate]]
        # Frames whose nearest mates are guesses teach guesses; where few others are left they have to do.
        observed = fewer if (frames.trial[fewer] == 0).sum() >= 30 or (own == 0 and len(fewer) >= 30) else observed
    found = _candidates(frames, column, gap, mates, observed, rules)
    # One other trial cannot show how much trials differ: of that, the prior is all that is known.
    least = 1.0 if own == 0 and len(np.unique(frames.trial[observed])) == 1 else 0.0
    return _blended(found, rules, least) if found else None


def _candidates(
    frames: _Frames, column: int, gap: Ints, mates: Ints, observed: Ints, rules: GapRules, again: bool = False
) -> list[_Candidate]:
    """All candidates for a gap; mates: columns, the steadiest first; observed: frames in which the marker is seen.

    again: whether frames are left out already that are no part of the path
    """
    some = observed[:: max(len(observed) // 200, 1)]
    shape = frames.points[np.ix_(some, mates)].mean(axis=0)
    pose = _pose(frames, column, mates, shape, some, rules) if len(mates) >= 3 else None
    absent = not (frames.trial[observed] == 0).any()
    if absent and pose is None:
        return []
    rows = _elsewhere(frames, gap, observed, pose, rules) if absent and pose is not None else _rows(frames, gap, observed, pose, rules)
    learned, every = len(rows), np.concatenate([rows, gap])
    blocks = _whole_trials(frames, rows) if absent else _blocks(frames, rows, max(len(gap) // _step(frames, gap, rules), 1))
    apart = np.abs(frames.time[every][:, None] - frames.time[rows][None])
    apart[frames.trial[every][:, None] != frames.trial[rows][None]] = _OTHER
    points = frames.points[every, column]
    brief = frames.time[gap[-1]] - frames.time[gap[0]] <= rules.brief
    nearest = mates[: 0 if brief or pose is None else rules.lengths]
    process = _Process(
        apart, blocks, learned, points, None if pose is None else pose[every], frames.points[every][:, nearest].swapaxes(1, 2)
    )
    found = []
    for kernel in () if absent else rules.brief_times if brief else rules.times:
        found += process.candidates(kernel, points[None], None)
    if pose is None:
        return found
    axes = [
        _axes(frames.points[every], columns, np.arange(0, learned, max(learned // 100, 1))) for columns in _choices(mates, shape, rules)
    ]
    axes = [(rotations, places) for rotations, places in axes if np.isfinite(rotations).all()]
    if axes:
        rotations, places = np.array([r for r, _ in axes]), np.array([t for _, t in axes])
        local = np.matmul((points - places)[:, :, None], rotations)[:, :, 0]
        for kernel in rules.brief_kernels if brief else rules.kernels:
            found += process.candidates(kernel, local, (rotations, places))
    # Next to a gap a sample that jumped away pulls the fill after it.
    if not again and process.strays is not None and 0 < process.strays.sum() <= _FEW_STRAYS * learned:
        return _candidates(frames, column, gap, mates, np.setdiff1d(observed, rows[process.strays]), rules, again=True)
    return found + process.mended(found, rules)


@dataclass
class _Process:
    """Gaussian processes over the same frames: those that are learned from, then those of the gap.

    apart  (R, learned) s; blocks (blocks, length) consecutive rows that are left out together; learned: rows before those of the gap
    points (R, 3) mm, the marker; pose (R, scores); mates (R, 3, K) mm, the steadiest, for their distances
    strays (learned,) which rows the first kernel in mates' axes finds to be no part of the path; None before it was asked. That kernel's
           noise must be some 0.3 mm: with less, one stray makes its neighbours strays, too
    """

    apart: Floats
    blocks: Ints
    learned: int
    points: Floats
    pose: Floats | None
    mates: Floats

    def __post_init__(self) -> None:
        self.strays: NDArray[np.bool_] | None = None
        length = self.blocks.shape[1]
        # Errors change little from frame to frame: of a long block every so many frames say what all do.
        self._judged = np.arange(0, length, max(length // _JUDGED, 1))
        self._told = np.arange(self.learned, len(self.apart), max(length // _JUDGED, 1))
        self._rows = self.blocks[:, self._judged]
        self._lengths = np.linalg.norm(self.points[:, :, None] - self.mates, axis=1)
        self._slow: dict[float, Floats] = {}
        if self.pose is None:
            return
        self._linear = self.pose @ self.pose[: self.learned].T
        self._same = np.where(self.apart < _OTHER, _OFFSET**2, 0.0)
        self._squares = (self.pose**2).sum(axis=1)
        distances = np.maximum(self._squares[:, None] + self._squares[None, : self.learned] - 2.0 * self._linear, 0.0)
        # Every third row tells the median as well.
        typical = np.median(distances[: self.learned : 3, : self.learned : 3]) + 1e-9
        # Squared, in typical distances.
        self._apart = distances / typical
        self._distances = np.sqrt(self._apart)

    def covariance(self, kernel: Kernel) -> tuple[Floats, Floats]:
        """(R, learned) mm2 of all rows with those that are learned from, and (R,) variances; both without noise."""
        if kernel.length not in self._slow:
            self._slow[kernel.length] = _matern(np.sqrt(5.0) / kernel.length * self.apart, 1.0 / 3.0)
        # The constant stands for a mean that is not known: 5 mm in the mates' axes, 1 m in the laboratory's.
        constant = 25.0 if kernel.linear else 1e6
        total = kernel.slow**2 * self._slow[kernel.length]
        total += constant
        variances = np.full(len(total), kernel.slow**2 + kernel.curved**2 + constant)
        if kernel.linear:
            total += kernel.linear**2 * self._linear
            total += self._same
            variances += kernel.linear**2 * self._squares + _OFFSET**2
        if kernel.curved and kernel.rough:
            total += kernel.curved**2 * _matern(np.sqrt(3.0) / kernel.width * self._distances, 0.0)
        elif kernel.curved:
            curved = np.exp(self._apart / (-2.0 * kernel.width**2))
            curved *= kernel.curved**2
            total += curved
        return total, variances

    def candidates(self, kernel: Kernel, values: Floats, axes: tuple[Floats, Floats] | None) -> list[_Candidate]:
        """One for each of the axes: values (axes, R, 3) mm in them; their rotations (axes, R, 3, 3) and places, None for the room."""
        many, (covariance, own) = self.learned, self.covariance(kernel)
        noisy = covariance[:many].copy()
        noisy.flat[:: many + 1] += kernel.noise**2
        inverse = _inverse(noisy)
        means = np.concatenate([values[:, :many].mean(axis=1).ravel(), self._lengths[:many].mean(axis=0)])
        learned = np.concatenate([*values[:, :many], self._lengths[:many]], axis=1) - means
        weights = inverse @ learned
        if axes is not None and self.strays is None:
            # What all other frames say of each one (Rasmussen and Williams 2006, section 5.4.2).
            off = (weights[:, : 3 * len(values)] / inverse.diagonal()[:, None]).reshape(many, -1, 3)
            far = np.sqrt((off**2).sum(axis=2)).min(axis=1)
            self.strays = (far > _STRAY * np.median(far)) & (far > _JUMP)
        # What a block's own rows add is taken out by the inverse of their part of the inverse.
        taken = np.array(
            [_inverse_rows(inverse[block[0] : block[-1] + 1, block[0] : block[-1] + 1], self._judged) for block in self.blocks]
        )
        off, expected = taken @ weights[self.blocks], taken[:, np.arange(len(self._judged)), self._judged]
        across = covariance[many:]
        filled = across @ weights + means
        some = self._told - many
        variance = np.maximum(own[self._told] - ((across[some] @ inverse) * across[some]).sum(axis=1), 0.0) + kernel.noise**2
        variance = np.interp(np.arange(len(across)), some, variance)
        sides = 3 * len(values)
        errors = np.moveaxis(off[:, :, :sides].reshape(*off.shape[:2], -1, 3), 2, 0)
        positions = np.moveaxis(filled[:, :sides].reshape(len(filled), -1, 3), 1, 0)
        if axes is not None:
            rotations, places = axes
            errors = np.matmul(rotations[:, self._rows], errors[..., None])[..., 0]
            positions = np.matmul(rotations[:, many:], positions[..., None])[..., 0] + places[:, many:]
        # In the room's axes nothing of the pose is known, on which the distances depend.
        sides = sides if axes is not None else filled.shape[1]
        shared = variance, filled[:, sides:], off[:, :, sides:]
        apart = many / self.blocks.shape[1]
        return [_Candidate(error, expected, apart, position, *shared) for error, position in zip(errors, positions, strict=True)]

    def mended(self, found: Sequence[_Candidate], rules: GapRules) -> list[_Candidate]:
        """Those of the candidates that count, each moved along the lines to the mates.

        Where a place is not as far from a mate as predicted, one of both is wrong: by how much of it the place moves is learned from the
        blocks, one share for each mate, which is held to be 0 +- 1 beforehand. A block errs as a whole, and so counts as one sample.
        """
        far = _block_errors(found).mean(axis=1)
        chosen = [one for one, mean in zip(found, far, strict=True) if one.lengths.shape[1] and mean <= rules.worst * far.min()]
        if not chosen:
            return []
        errors, positions, lengths, lengths_off = (
            np.array([getattr(one, name) for one in chosen]) for name in ("off", "positions", "lengths", "lengths_off")
        )
        rows, sets = self._rows, len(chosen)
        steps = _steps(self.points[rows] - errors, self.mates[rows], self._lengths[rows] - lengths_off)
        there = _steps(positions, self.mates[self.learned :], lengths)
        # As for the choice: each half of the blocks is judged by what the other one says.
        half = len(rows) // 2
        parts = [
            (steps[:, part].reshape(sets, -1, steps.shape[-1]), errors[:, part].reshape(sets, -1, 1))
            for part in (slice(0, half), slice(half, None))
        ]
        squares = [np.matmul(step.swapaxes(1, 2), step) for step, _ in parts]
        products = [np.matmul(step.swapaxes(1, 2), error) for step, error in parts]
        held = np.eye(steps.shape[-1]) * ((errors**2).mean(axis=(1, 2, 3)) + 1e-9)[:, None, None] * len(self._judged)
        moved = [
            error - np.matmul(step, np.linalg.solve(squares[other] + held, products[other]))
            for (step, error), other in zip(parts, (1, 0), strict=True)
        ]
        shares = np.linalg.solve(squares[0] + squares[1] + held, products[0] + products[1])
        errors = np.concatenate(moved, axis=1).reshape(errors.shape)
        positions = positions + np.matmul(there, shares[:, None])[..., 0]
        return [replace(one, off=off, positions=place) for one, off, place in zip(chosen, errors, positions, strict=True)]


def _matern(scaled: Floats, square: float) -> Floats:
    """(1 + x + square x2) exp(-x): Matern 3/2 with 0 and 5/2 with a third, of scaled distances."""
    grown = square * scaled
    grown += 1.0
    grown *= scaled
    grown += 1.0
    grown *= np.exp(-scaled)
    return np.asarray(grown)


def _steps(places: Floats, mates: Floats, lengths: Floats) -> Floats:
    """(..., 3, K) mm, from places (..., 3) along the lines to mates (..., 3, K) to where these are as far away as lengths (..., K) say."""
    lines = places[..., None] - mates
    squares = lines[..., 0, :] ** 2 + lines[..., 1, :] ** 2 + lines[..., 2, :] ** 2
    return np.asarray(lines * (lengths / np.sqrt(squares + 1e-9) - 1.0)[..., None, :])


def _inverse_rows(matrix: Floats, rows: Ints) -> Floats:
    """(rows, size) those rows of the inverse of a symmetric positive definite matrix (size, size)."""
    wanted = np.zeros((len(matrix), len(rows)))
    wanted[rows, np.arange(len(rows))] = 1.0
    _, solved, problem = lapack.dposv(matrix, wanted, lower=1, overwrite_b=1)
    return np.asarray((np.linalg.pinv(matrix, hermitian=True)[:, rows] if problem else solved).T)


def _blended(found: Sequence[_Candidate], rules: GapRules, least: float = 0.0) -> tuple[Floats, Floats]:
    """The mean of the candidates, weighted by how they do on the blocks, and its deviation, scaled so that it holds the blocks' errors.

    least: of the scale
    """
    each = _block_errors(found)
    weights = _weights(each, rules)
    positions: Floats = sum(weight * one.positions for weight, one in zip(weights, found, strict=True) if weight > 0.0)
    variance: Floats = sum(weight * one.variance for weight, one in zip(weights, found, strict=True) if weight > 0.0)
    # Candidates look better on the blocks that chose them: each half of the blocks is judged by what the other one chooses.
    half = each.shape[1] // 2
    halves = [slice(0, half), slice(half, None)] if half else [slice(None)]
    judged = []
    for judge, own in zip(halves[::-1], halves, strict=True):
        chosen = [(weight, one) for weight, one in zip(_weights(each[:, judge], rules), found, strict=True) if weight > 0.0]
        judged.append((sum(weight * one.off[own] for weight, one in chosen), sum(weight * one.expected[own] for weight, one in chosen)))
    off, expected = (np.concatenate([part[which] for part in judged]) for which in (0, 1))
    ratios = np.abs(off) / np.sqrt(expected)[:, :, None]
    # By their mean square and by what holds 95 % of them: a few large errors speak as well as many small ones.
    scale = max(least, float(np.sqrt((off**2).mean() / expected.mean())), float(np.quantile(ratios, 0.95)) / 1.96)
    # Few blocks tell the scale badly: as in Student's t, with three coordinates for each block that shares no frame with another.
    freedom = 3.0 * max(found[0].apart, 1.0)
    deviation = np.sqrt(variance) * scale * float(stdtrit(freedom, 0.975)) / 1.96
    # A mate that takes another point's label in the gap moves all axes, those of few mates the most: the blocks do not know of it.
    apart = sum(
        weight * ((one.positions - positions) ** 2).mean(axis=1) for weight, one in zip(weights, found, strict=True) if weight > 0.0
    )
    spread = np.sqrt(apart)
    return positions, np.maximum(np.where(spread > deviation, _ALL_MOVED * spread, deviation), _LEAST)


def _block_errors(found: Sequence[_Candidate]) -> Floats:
    """(C, blocks) mm, how far each candidate is off in each block, on average."""
    off = np.array([one.off for one in found])
    return np.asarray(np.sqrt(off[..., 0] ** 2 + off[..., 1] ** 2 + off[..., 2] ** 2).mean(axis=2))


def _weights(errors: Floats, rules: GapRules) -> Floats:
    """(C,) by mean errors (C, blocks) mm: the better ones count more, bad ones nothing."""
    mean = errors.mean(axis=1) + 1e-9
    weights = (mean.min() / mean) ** rules.power * (mean <= rules.worst * mean.min())
    return np.asarray(weights / weights.sum())


def _by_steadiness(frames: _Frames, column: int, usable: Ints, observed: Ints) -> Ints:
    """The usable columns by how little their distance to a marker varies; of two equal ones the nearer first."""
    some = observed[:: max(len(observed) // 200, 1)]
    distances = np.linalg.norm(frames.points[some][:, usable] - frames.points[some, column][:, None], axis=2)
    both = frames.seen[some][:, usable]
    many = np.maximum(both.sum(axis=0), 1)
    mean = (distances * both).sum(axis=0) / many
    spread = np.sqrt(((distances - mean) ** 2 * both).sum(axis=0) / many)
    return usable[np.argsort(spread + 0.01 * mean, kind="stable")]


def _choices(mates: Ints, shape: Floats, rules: GapRules) -> list[Ints]:
    """The different sets of mates that make axes; shape (mates, 3) mm, where they are on average."""
    return [mates[:size] for size in sorted({_enough(shape, size) for size in rules.mates})]


def _enough(shape: Floats, size: int) -> int:
    """`size`, and more where the first `size` mates of a shape (mates, 3) mm lie in a line; at most all."""
    for many in range(min(size, len(shape)), len(shape)):
        if np.linalg.svd(shape[:many] - shape[:many].mean(axis=0), compute_uv=False)[1] > _EXTENT:
            return many
    return len(shape)


def _axes(points: Floats, mates: Ints, some: Ints) -> tuple[Floats, Floats]:
    """Rotations (F, 3, 3) and places (F, 3) of the mates' axes in frames (F, N, 3); some: frames whose mean shape the axes are laid on."""
    cluster, weights = np.ascontiguousarray(points[:, mates]), np.ones((1, len(mates)))
    rotations, places = np.empty((len(points), 3, 3)), np.empty((len(points), 3))
    few = np.ascontiguousarray(cluster[some[:: max(len(some) // 40, 1)]])
    shape = few[len(few) // 2] - few[len(few) // 2].mean(axis=0)
    # The first round turns all frames alike, the second one takes their mean shape.
    for _ in range(2):
        fit_frames(shape, few, weights, 0.02, rotations, places)
        local = np.empty_like(few)
        local_positions(few, rotations, places, local)
        shape = local.mean(axis=0)
    fit_frames(shape, cluster, weights, 0.02, rotations, places)
    return rotations, places


def _pose(frames: _Frames, column: int, mates: Ints, shape: Floats, some: Ints, rules: GapRules) -> Floats | None:
    """(F, scores) principal components of all mates in the axes of the steadiest; those that move little against the marker weigh more."""
    rotations, places = _axes(frames.points, mates[: _enough(shape, rules.pose)], some)
    if not np.isfinite(rotations).all():
        return None
    local = np.matmul(frames.points[:, mates] - places[:, None], rotations)
    marker = np.matmul((frames.points[some, column] - places[some])[:, None], rotations[some])
    weights = (_SINGLE + np.linalg.norm(local[some] - marker, axis=2).std(axis=0)) ** -rules.local
    flat = ((local - local[some].mean(axis=0)) * weights[:, None]).reshape(len(local), -1)
    scores = flat @ _leading(flat[some], rules.scores)
    return np.asarray(scores / max(float(scores[some].std(axis=0).max()), 1e-9))


def _leading(flat: Floats, many: int) -> Floats:
    """(columns, many) leading right singular vectors, by subspace iteration (Halko et al. 2011) from the columns that vary most."""
    begin = np.argsort(-(flat**2).sum(axis=0), kind="stable")[: many + 6]
    basis = np.zeros((flat.shape[1], len(begin)))
    basis[begin, np.arange(len(begin))] = 1.0
    for _ in range(4):
        basis = np.linalg.qr(flat.T @ (flat @ basis))[0]
    small = flat @ basis
    return np.asarray(basis @ np.linalg.eigh(small.T @ small)[1][:, ::-1][:, :many])


def _rows(frames: _Frames, gap: Ints, observed: Ints, pose: Floats | None, rules: GapRules) -> Ints:
    """The frames that are learned from: the nearest in time, and the nearest in pose among the others and of other trials."""
    own = frames.trial[observed] == 0
    here, elsewhere = observed[own], observed[~own]
    # Frames of a fast recording say what those beside them do; what is next to the gap pins the fill.
    here = here[(here % _step(frames, gap, rules) == 0) | (np.minimum(np.abs(here - gap[0]), np.abs(here - gap[-1])) <= _EDGE)]
    nearest = np.argsort(np.abs(here - (gap[0] + gap[-1]) / 2.0), kind="stable")
    near = here[nearest[: int(rules.frames * (1.0 if pose is None else rules.near))]]
    if pose is None:
        return np.sort(near)
    wanted = pose[gap[:: max(len(gap) // 10, 1)]]

    def likest(rows: Ints, many: int) -> Ints:
        distances = ((pose[rows][:, None] - wanted[None]) ** 2).sum(axis=2).min(axis=1)
        return rows[np.argsort(distances, kind="stable")[:many]]

    far = likest(np.setdiff1d(here, near), rules.frames - len(near))
    return np.sort(np.concatenate([near, far, likest(elsewhere, rules.elsewhere)]))


def _step(frames: _Frames, gap: Ints, rules: GapRules) -> int:
    """Every so many frames are learned from: for brief gaps every one."""
    lasts = frames.time[gap[-1]] - frames.time[gap[0]]
    return 1 if lasts <= rules.brief else max(round((len(gap) - 1) / lasts / rules.dense), 1)


def _elsewhere(frames: _Frames, gap: Ints, observed: Ints, pose: Floats, rules: GapRules) -> Ints:
    """For a marker that the first trial never shows: as many frames of each other trial, those nearest in pose."""
    trials = [observed[frames.trial[observed] == trial] for trial in np.unique(frames.trial[observed])]
    # A trial of a few frames would leave as few of the others.
    trials = [rows for rows in trials if len(rows) >= _FEW_FRAMES] or trials
    many = min(*(len(rows) for rows in trials), max(rules.frames // len(trials), 1))
    wanted = pose[gap[:: max(len(gap) // 40, 1)]]
    chosen = []
    for rows in trials:
        distances = ((pose[rows][:, None] - wanted[None]) ** 2).sum(axis=2).min(axis=1)
        chosen.append(np.sort(rows[np.argsort(distances, kind="stable")[:many]]))
    return np.concatenate(chosen)


def _whole_trials(frames: _Frames, rows: Ints) -> Ints:
    """Blocks of one trial each, as `_elsewhere` gives them; of a single trial, its thirds."""
    trials = len(np.unique(frames.trial[rows]))
    parts = trials if trials > 1 else min(3, len(rows))
    return np.arange(len(rows) // parts * parts).reshape(parts, -1)


def _blocks(frames: _Frames, rows: Ints, length: int) -> Ints:
    """(blocks, length) rows of the length of the gap that are left out together, of one trial each."""
    length = min(length, max((frames.trial[rows] == 0).sum() // 3, 1))
    begins = np.arange(len(rows) - length + 1)
    last = begins + length - 1
    # Frames that were chosen by pose leave holes: a block spans at most half as many frames again.
    together = frames.trial[rows[begins]] == frames.trial[rows[last]]
    spans = frames.time[rows[last]] - frames.time[rows[begins]]
    shortest = spans[together].min(initial=np.inf)
    whole = begins[together & (spans <= 1.5 * shortest)]
    # Blocks of a long gap overlap: eight of them say what sixteen do, and cost half.
    many = int(np.clip(1000 // length, 8, 60))
    return whole[np.unique(np.linspace(0, len(whole) - 1, many).astype(int))][:, None] + np.arange(length)


def _inverse(matrix: Floats) -> Floats:
    """The inverse of a symmetric positive definite matrix."""
    # Transposed, it lies as LAPACK wants it, and need not be copied.
    factor, problem = lapack.dpotrf(matrix.T, lower=1)
    if problem:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)
    # The upper triangle is clean.
    lower = lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
    inverse = lower + lower.T
    inverse.flat[:: len(inverse) + 1] *= 0.5
    return np.asarray(inverse)
