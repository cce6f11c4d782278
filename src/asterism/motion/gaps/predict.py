"""One gap of one marker in; its positions with their standard deviation out, by a Gaussian process over pose and time.

The marker is seen in the axes of markers that keep their distance to it. What is left there is a function of the pose, which the other
markers show, and of time (Rasmussen and Williams 2006, ch. 2 and 4). How many mates make the axes, and which kernel, is judged by blocks
as long as the gap that are left out; all blocks follow from one inverse (there, section 5.4.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from asterism.motion.rigid._kernels import fit_frames, local_positions
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class Kernel:
    """A covariance of a coordinate in the mates' axes: linear and smooth in the pose, Matern 5/2 in time, and noise.

    linear, smooth, slow  mm, how far each of the three parts reaches
    length                s, over which the part in time changes
    noise                 mm of a measured coordinate
    """

    linear: float
    smooth: float
    slow: float
    length: float
    noise: float


@dataclass(frozen=True)
class GapRules:
    """What is tried for a gap. All numbers were chosen on recordings of `movement`, none on `gait`.

    mates     how many of the steadiest markers make the axes: each number is a candidate
    kernels   candidates in the mates' axes
    times     candidates in the laboratory's axes, of time alone: smoothing splines
    pose      mates that make the axes in which the pose is seen
    scores    principal components of the pose
    frames    most frames that are learned from: time grows with the cube, 160 err 2 % more
    near      share of these that are next to the gap in time; the others are next to it in pose
    power     candidates count by the power of their error: 4 and 8 differ by 1 %
    worst     a candidate that errs this many times as much as the best does not count
    reach     frames before and behind the gap that are looked at, so that hours cost no more than a trial
    """

    mates: tuple[int, ...] = (3, 4, 6, 10, 99)
    kernels: tuple[Kernel, ...] = (
        Kernel(8.0, 3.0, 1.0, 0.1, 0.1),
        Kernel(8.0, 3.0, 1.0, 0.1, 0.3),
        Kernel(8.0, 6.0, 4.0, 0.1, 0.1),
        Kernel(8.0, 6.0, 4.0, 0.1, 0.3),
        Kernel(20.0, 6.0, 4.0, 0.2, 0.2),
        Kernel(20.0, 3.0, 12.0, 0.2, 0.2),
        Kernel(8.0, 0.0, 12.0, 0.2, 0.1),
        Kernel(50.0, 10.0, 4.0, 0.1, 0.3),
    )
    times: tuple[Kernel, ...] = (Kernel(0.0, 0.0, 300.0, 0.25, 0.1), Kernel(0.0, 0.0, 300.0, 0.25, 0.3))
    pose: int = 6
    scores: int = 12
    frames: int = 240
    near: float = 0.55
    power: float = 4.0
    worst: float = 1.6
    reach: int = 1000


RULES = GapRules()
_PRESENT = 0.7
"""Share of the frames in which a marker must be seen to tell the pose: its own gaps are bridged by straight lines."""
_BRIDGE = 0.05
"""s from a measured sample up to which a bridged mate is as good as seen: a straight line errs less than 1 mm there."""
_EXTENT = 25.0
"""mm, second largest extent of the mates' shape: three in a line leave the turn about it open."""
_SINGLE = 15.0
"""mm by which a marker that never moves against the filled one is held to move: half or double changes no error by 2 %."""
_LEAST = 0.01
"""mm, the least standard deviation that is stated: coordinates in files are no finer."""
_WIDE = 1.05
"""The blocks also chose the candidates, so that their errors are a little smaller than those of a gap."""


@dataclass(frozen=True)
class Trial:
    """One recording of a person: positions (T, N, 3) mm, NaN for missing; rate in frames per second."""

    positions: Floats
    rate: float

    def around(self, gap: Ints, reach: int) -> tuple[Trial, Ints]:
        """The frames before and behind a gap, and the gap's numbers among them."""
        first = max(int(gap[0]) - reach, 0)
        return Trial(self.positions[first : int(gap[-1]) + 1 + reach], self.rate), gap - first


@dataclass(frozen=True)
class _Frames:
    """The frames of all trials, one after the other.

    points  (F, N, 3) mm, gaps bridged; seen (F, N); trial (F,), time (F,) s within it
    """

    points: Floats
    seen: NDArray[np.bool_]
    trial: Ints
    time: Floats

    @classmethod
    def of(cls, trials: Sequence[Trial]) -> _Frames:
        many = [len(trial.positions) for trial in trials]
        time = np.concatenate([np.arange(len(trial.positions)) / trial.rate for trial in trials])
        seen = np.concatenate([np.isfinite(trial.positions[:, :, 0]) for trial in trials])
        return cls(np.concatenate([_bridged(t.positions) for t in trials]), seen, np.repeat(np.arange(len(trials)), many), time)

    def shown(self, column: int) -> NDArray[np.bool_]:
        """(F,) whether a marker is measured in a frame or so near to it that the bridge is as good."""
        shown: NDArray[np.bool_] = self.seen[:, column].copy()
        for trial in np.unique(self.trial):
            here = np.nonzero(self.trial == trial)[0]
            there = here[self.seen[here, column]]
            if 0 < len(there) < len(here):
                after = np.clip(np.searchsorted(there, here), 0, len(there) - 1)
                near = np.minimum(*(np.abs(self.time[there[side]] - self.time[here]) for side in (after, np.maximum(after - 1, 0))))
                shown[here] = near <= _BRIDGE
        return shown


@dataclass(frozen=True)
class _Candidate:
    """What one choice of axes and kernel says.

    error      mm, the mean distance to the blocks that were left out
    off        (blocks, length, 3) mm to these; expected (blocks, length) mm2, the variance that it stated for them
    positions  (G, 3) mm in the gap; variance (G,) mm2 of a coordinate
    """

    error: float
    off: Floats
    expected: Floats
    positions: Floats
    variance: Floats


def predict_gap(trials: Sequence[Trial], column: int, gap: Ints, rules: GapRules = RULES) -> tuple[Floats, Floats] | None:
    """The positions of a marker in a gap (G, 3) mm and the standard deviation of a coordinate (G,) mm; None where too little is seen.

    trials  of one person, the one with the gap first, all with the same columns
    gap     (G,) consecutive frames of the first trial in which the marker is missing
    O(kernels x frames^3).
    """
    first, gap = trials[0].around(gap, rules.reach)
    # A trial in which the marker is hardly seen says nothing about it.
    others = [t for t in trials[1:] if np.isfinite(t.positions[:, column, 0]).mean() > _PRESENT]
    frames = _Frames.of([first, *(t.around(np.array([len(t.positions) // 2]), rules.reach)[0] for t in others)])
    usable = frames.seen[gap].all(axis=0)
    for trial in range(1 + len(others)):
        usable &= frames.seen[frames.trial == trial].mean(axis=0) > _PRESENT
    usable[column] = False
    observed = np.nonzero(frames.seen[:, column])[0]
    # Two samples make a line, of which nothing can be left out.
    if (frames.trial[observed] == 0).sum() < 4:
        return None
    mates = _by_steadiness(frames, column, np.nonzero(usable)[0], observed)
    for mate in mates[: rules.pose]:
        fewer = observed[frames.shown(mate)[observed]]
        # Frames whose nearest mates are guesses teach guesses; where few others are left they have to do.
        observed = fewer if (frames.trial[fewer] == 0).sum() >= 30 else observed
    return _blended(_candidates(frames, column, gap, mates, observed, rules), rules)


def _candidates(frames: _Frames, column: int, gap: Ints, mates: Ints, observed: Ints, rules: GapRules) -> list[_Candidate]:
    """All candidates for a gap; mates: columns, the steadiest first; observed: frames in which the marker is seen."""
    some = observed[:: max(len(observed) // 200, 1)]
    pose = _pose(frames, column, mates, some, rules) if len(mates) >= 3 else None
    rows = _rows(frames, gap, observed, pose, rules)
    learned, every = len(rows), np.concatenate([rows, gap])
    blocks = _blocks(frames, rows, len(gap))
    apart = np.abs(frames.time[every][:, None] - frames.time[every][None])
    # Trials are independent but for the pose.
    apart[frames.trial[every][:, None] != frames.trial[every][None]] = 1e6
    points = frames.points[every, column]
    process = _Process(apart, blocks, learned, pose=None if pose is None else pose[every])
    found = []
    for kernel in rules.times:
        found += process.candidates(kernel, points[None], None)
    if pose is None:
        return found
    axes = [
        _axes(frames.points[every], columns, np.arange(0, learned, max(learned // 100, 1)))
        for columns in _choices(frames, mates, some, rules)
    ]
    axes = [(rotations, places) for rotations, places in axes if np.isfinite(rotations).all()]
    if axes:
        rotations, places = np.array([r for r, _ in axes]), np.array([t for _, t in axes])
        local = np.matmul((points - places)[:, :, None], rotations)[:, :, 0]
        for kernel in rules.kernels:
            found += process.candidates(kernel, local, (rotations, places))
    return found


@dataclass
class _Process:
    """Gaussian processes over the same frames: those that are learned from, then those of the gap.

    apart (R, R) s; blocks (blocks, length) rows that are left out together; learned: rows before those of the gap; pose (R, scores)
    """

    apart: Floats
    blocks: Ints
    learned: int
    pose: Floats | None

    def __post_init__(self) -> None:
        self._slow: dict[float, Floats] = {}
        if self.pose is None:
            return
        self._linear = self.pose @ self.pose.T
        squares = np.diag(self._linear)
        distances = np.maximum(squares[:, None] + squares[None] - 2.0 * self._linear, 0.0)
        # Every third row tells the median as well.
        typical = np.median(distances[: self.learned : 3, : self.learned : 3]) + 1e-9
        self._smooth = np.exp(distances * (-2.0 / typical))

    def covariance(self, kernel: Kernel) -> Floats:
        """(R, R) mm2 without noise."""
        if kernel.length not in self._slow:
            scaled = np.sqrt(5.0) / kernel.length * self.apart
            self._slow[kernel.length] = (1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled)
        # The constant stands for a mean that is not known: 5 mm in the mates' axes, 1 m in the laboratory's.
        total = kernel.slow**2 * self._slow[kernel.length] + (25.0 if kernel.linear else 1e6)
        if kernel.linear:
            total += kernel.linear**2 * self._linear
        if kernel.smooth:
            total += kernel.smooth**2 * self._smooth
        return total

    def candidates(self, kernel: Kernel, values: Floats, axes: tuple[Floats, Floats] | None) -> list[_Candidate]:
        """One for each of the axes: values (axes, R, 3) mm in them; their rotations (axes, R, 3, 3) and places, None for the room."""
        many, covariance = self.learned, self.covariance(kernel)
        noisy = covariance[:many, :many].copy()
        noisy.flat[:: many + 1] += kernel.noise**2
        inverse = _inverse(noisy)
        means = values[:, :many].mean(axis=1)
        weights = inverse @ np.concatenate(list(values[:, :many] - means[:, None]), axis=1)
        # What a block's own rows add is taken out by the inverse of their part of the inverse.
        variances = np.linalg.inv(inverse[self.blocks[:, :, None], self.blocks[:, None]])
        off, expected = variances @ weights[self.blocks], np.einsum("bll->bl", variances)
        across = covariance[many:, :many]
        filled = across @ weights
        variance = np.maximum(np.diag(covariance)[many:] - ((across @ inverse) * across).sum(axis=1), 0.0) + kernel.noise**2
        found = []
        for at, mean in enumerate(means):
            three = slice(3 * at, 3 * at + 3)
            errors, positions = off[:, :, three], filled[:, three] + mean
            if axes is not None:
                rotations, places = axes[0][at], axes[1][at]
                errors = np.einsum("blij,blj->bli", rotations[self.blocks], errors)
                positions = np.einsum("gij,gj->gi", rotations[many:], positions) + places[many:]
            found.append(_Candidate(float(np.linalg.norm(errors, axis=2).mean()), errors, expected, positions, variance))
        return found


def _blended(found: Sequence[_Candidate], rules: GapRules) -> tuple[Floats, Floats]:
    """The mean of the candidates, weighted by how they do on the blocks, and its deviation, scaled so that it holds the blocks' errors."""
    errors = np.array([one.error for one in found]) + 1e-9
    weights = (errors.min() / errors) ** rules.power * (errors <= rules.worst * errors.min())
    weights /= weights.sum()
    chosen = [(weight, one) for weight, one in zip(weights, found, strict=True) if weight > 0.0]
    positions: Floats = sum(weight * one.positions for weight, one in chosen)  # type: ignore[assignment]
    variance: Floats = sum(weight * one.variance for weight, one in chosen)
    off: Floats = sum(weight * one.off for weight, one in chosen)
    expected: Floats = sum(weight * one.expected for weight, one in chosen)
    ratios = np.abs(off) / np.sqrt(expected)[:, :, None]
    # By their mean square and by what holds 95 % of them: a few large errors speak as well as many small ones.
    scale = max(float(np.sqrt((off**2).mean() / expected.mean())), float(np.quantile(ratios, 0.95)) / 1.96)
    return positions, np.maximum(np.sqrt(variance) * scale * _WIDE, _LEAST)


def _by_steadiness(frames: _Frames, column: int, usable: Ints, observed: Ints) -> Ints:
    """The usable columns by how little their distance to a marker varies; of two equal ones the nearer first."""
    some = observed[:: max(len(observed) // 200, 1)]
    distances = np.linalg.norm(frames.points[some][:, usable] - frames.points[some, column][:, None], axis=2)
    both = frames.seen[some][:, usable]
    many = np.maximum(both.sum(axis=0), 1)
    mean = (distances * both).sum(axis=0) / many
    spread = np.sqrt(((distances - mean) ** 2 * both).sum(axis=0) / many)
    return usable[np.argsort(spread + 0.01 * mean, kind="stable")]


def _choices(frames: _Frames, mates: Ints, some: Ints, rules: GapRules) -> list[Ints]:
    """The different sets of mates that make axes."""
    sizes = {len(_enough(frames, mates, some, size)) for size in rules.mates}
    return [mates[:size] for size in sorted(sizes)]


def _enough(frames: _Frames, mates: Ints, some: Ints, size: int) -> Ints:
    """The first `size` mates, and more where these lie in a line."""
    for many in range(min(size, len(mates)), len(mates)):
        shape = (frames.points[some][:, mates[:many]] - frames.points[some][:, mates[:many]].mean(axis=1, keepdims=True)).mean(axis=0)
        if np.linalg.svd(shape, compute_uv=False)[1] > _EXTENT:
            return mates[:many]
    return mates


def _axes(points: Floats, mates: Ints, some: Ints) -> tuple[Floats, Floats]:
    """Rotations (F, 3, 3) and places (F, 3) of the mates' axes in frames (F, N, 3); some: frames whose mean shape the axes are laid on."""
    cluster, weights = np.ascontiguousarray(points[:, mates]), np.ones((1, len(mates)))
    rotations, places, local = np.empty((len(points), 3, 3)), np.empty((len(points), 3)), np.empty_like(cluster)
    shape = cluster[some[len(some) // 2]] - cluster[some[len(some) // 2]].mean(axis=0)
    # The first round turns all frames alike, the second one takes their mean shape.
    for _ in range(2):
        fit_frames(shape, cluster, weights, 0.02, rotations, places)
        local_positions(cluster, rotations, places, local)
        shape = local[some].mean(axis=0)
    fit_frames(shape, cluster, weights, 0.02, rotations, places)
    return rotations, places


def _pose(frames: _Frames, column: int, mates: Ints, some: Ints, rules: GapRules) -> Floats | None:
    """(F, scores) principal components of all mates in the axes of the steadiest; those that move little against the marker weigh more."""
    rotations, places = _axes(frames.points, _enough(frames, mates, some, rules.pose), some)
    if not np.isfinite(rotations).all():
        return None
    local = np.matmul(frames.points[:, mates] - places[:, None], rotations)
    marker = np.matmul((frames.points[some, column] - places[some])[:, None], rotations[some])
    weights = 1.0 / (_SINGLE + np.linalg.norm(local[some] - marker, axis=2).std(axis=0))
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
    """The frames that are learned from: the nearest in time, and the nearest in pose among the others of all trials."""
    here = observed[frames.trial[observed] == 0]
    nearest = np.argsort(np.abs(here - (gap[0] + gap[-1]) / 2.0), kind="stable")
    near = here[nearest[: int(rules.frames * (1.0 if pose is None else rules.near))]]
    far = np.setdiff1d(observed, near)
    if pose is None:
        return np.sort(near)
    if len(far) > rules.frames - len(near):
        wanted = pose[gap[:: max(len(gap) // 10, 1)]]
        distances = ((pose[far][:, None] - wanted[None]) ** 2).sum(axis=2).min(axis=1)
        far = far[np.argsort(distances, kind="stable")[: rules.frames - len(near)]]
    return np.sort(np.concatenate([near, far]))


def _blocks(frames: _Frames, rows: Ints, length: int) -> Ints:
    """(blocks, length) rows of the length of the gap that are left out together, of one trial each."""
    length = min(length, max((frames.trial[rows] == 0).sum() // 3, 1))
    begins = np.arange(len(rows) - length + 1)
    last = begins + length - 1
    # Frames that were chosen by pose leave holes: a block spans at most half as many frames again.
    whole = begins[(frames.trial[rows[begins]] == frames.trial[rows[last]]) & (rows[last] - rows[begins] <= 1.5 * length)]
    whole = whole if len(whole) else begins[frames.trial[rows[begins]] == frames.trial[rows[last]]]
    # So many that a long gap has 16 of them and the work stays that of a few hundred rows.
    many = int(np.clip(1500 // length, 16, 60))
    return whole[np.unique(np.linspace(0, len(whole) - 1, many).astype(int))][:, None] + np.arange(length)


def _inverse(matrix: Floats) -> Floats:
    """The inverse of a symmetric positive definite matrix, which is overwritten."""
    factor, problem = lapack.dpotrf(matrix, lower=1, overwrite_a=1)
    if problem:
        return np.asarray(np.linalg.pinv(matrix, hermitian=True), dtype=np.float64)
    lower = np.tril(lapack.dpotri(factor, lower=1, overwrite_c=1)[0])
    return np.asarray(lower + np.tril(lower, -1).T)


def _bridged(positions: Floats) -> Floats:
    """The positions with straight lines through gaps; a marker that is never seen stays NaN."""
    bridged, frames = positions.copy(), np.arange(len(positions))
    for column in np.nonzero(np.isnan(positions[:, :, 0]).any(axis=0))[0]:
        seen = np.isfinite(positions[:, column, 0])
        if seen.any():
            for axis in range(3):
                bridged[~seen, column, axis] = np.interp(frames[~seen], frames[seen], positions[seen, column, axis])
    return bridged
