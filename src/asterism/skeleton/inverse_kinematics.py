"""A kinematic tree and labelled trajectories in; the coordinates of its joints over time, each with its standard deviation, out.

Weighted least squares on all markers in each frame (Lu and O'Connor, J Biomech 32, 1999), with bounds of the joints that give, and then
over all frames together, as smooth as the trajectories themselves say that the person moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.geometry import fit_rigid, vector_from_rotation, z_up_rotation
from asterism.progress import Progress
from asterism.recording import Floats, MarkerSet, Recording, SkeletonMotion, filled_samples
from asterism.skeleton._smooth_kernels import best_ratio, smoothed_variances, smoothing_step
from asterism.skeleton._tree_kernels import ROOT, follow, linearise, pose_frames, pose_tree, shared_variances
from asterism.skeleton.tree import KinematicTree


class Solving(NamedTuple):
    """What the kernels take of `KinematicsRules`: see there; limit_precision (Q,) per square of the coordinate's unit."""

    tails: float
    limit_precision: Floats
    ridge: float
    steps: int
    least_decrease: float
    lost: float
    lost_at_most: float


@dataclass(frozen=True)
class KinematicsRules:
    """How inverse kinematics is solved.

    noise           m, of a marker's measured position beside its spread: 1 mm is what a calibrated volume gives
    tails           degrees of freedom of Student's t, by which a marker that is far off pulls less (Lange et al. 1989 advise 4); 0: by its
                    square, as OpenSim does. At 2 a marker is let go sooner, at 8 one that is 10 cm off turns the body by half as much again
    shared          variance by which all markers of a bone move together, in units of that by which each moves by itself: what skin does as
                    one is no smaller than how it deforms (Barre et al., IEEE Trans Biomed Eng 60, 2013). It is not seen, and moves no
                    angle; at half or double of it standard deviations are 0.83 and 1.28 times as large
    limit_deg       degrees that a joint goes beyond its range at the price of one standard deviation: what goniometers repeat
    limit_m         m, the same of a joint that slides
    ridge           what nothing else says of a number, per m2 or rad2: a standard deviation of 100 rad, far beyond anything
    steps           of Levenberg and Marquardt in a frame; five are usual
    least_decrease  nats, the expected gain of a step below which a frame is done: 0.0014 standard deviations
    lost            mean square miss of the markers, in their own variances, above which a frame is tried from other starts
    lost_at_most    what one marker may add to that, so that a single wrong one does not count as lost
    smooth          whether frames are smoothed together
    usual_s         s, in which what is usual of a coordinate counts once where no marker tells it: by then a joint is elsewhere
    least_square    of what is left of a smoothing's step, for each number and frame, in units of its white noise: 0.03 standard deviations
    rounds          of smoothing at most: the equations are linear in small steps
    done            rad or m, the largest step of a number below which a smoothing is done: 0.06 degrees, 1 mm
    block, overlap  frames that are smoothed together, and by how much their neighbours take part: seconds at any usual rate
    """

    noise: float = 0.001
    tails: float = 4.0
    shared: float = 1.0
    limit_deg: float = 5.0
    limit_m: float = 0.005
    ridge: float = 1e-4
    steps: int = 60
    least_decrease: float = 1e-6
    lost: float = 9.0
    lost_at_most: float = 50.0
    smooth: bool = True
    usual_s: float = 0.5
    least_square: float = 1e-3
    rounds: int = 4
    done: float = 0.001
    block: int = 4000
    overlap: int = 200


RULES = KinematicsRules()


_HIDDEN = 50.0
"""Multiples of a number's usual variance above which a frame tells nothing of it. Postures in which axes nearly meet reach 20; frames
without markers of the bone, hundreds."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """The movement of a kinematic tree over T frames.

    tree         what moved
    coordinates  (T, Q) rad, or m where a joint slides
    turns        (T, 3, 3) from the root's axes to those of a room whose z is up; places (T, 3) m there
    sd           (T, D) standard deviations of the root's place (m) and turn (rad), then of the coordinates; see `solve_kinematics`
    misses       (T, M) m, how far each marker is from where the tree has it; NaN where it is not seen
    known        (T,) whether a frame shows markers enough; others hold what their neighbours say
    rate         frames per second
    vertical     (3,) up, in the recording's axes
    noise_scale  how much farther markers are off than their spreads say: a factor of standard deviations
    """

    tree: KinematicTree
    coordinates: Floats
    turns: Floats
    places: Floats
    sd: Floats
    misses: Floats
    known: np.ndarray
    rate: float
    vertical: Floats
    noise_scale: float

    def __len__(self) -> int:
        return len(self.coordinates)

    @cached_property
    def posed(self) -> tuple[Floats, Floats]:
        """(T, B, 3, 3) from the bones' axes to the recording's, and (T, B, 3) m, their joints there."""
        frames, bones = len(self), len(self.tree.bones)
        turned, joints = np.empty((frames, bones, 3, 3)), np.empty((frames, bones, 3))
        pose_frames(self.tree.arrays, self.coordinates, self.turns, self.places, turned, joints)
        back = z_up_rotation(self.vertical).T
        return np.asarray(back @ turned), np.asarray(joints @ back.T)

    @property
    def marker_positions(self) -> Floats:
        """(T, M, 3) m, where the tree has its markers, in the recording's axes."""
        turned, joints = self.posed
        arrays = self.tree.arrays
        return np.asarray(joints[:, arrays.bones] + np.einsum("tmij,mj->tmi", turned[:, arrays.bones], arrays.places))

    def motion(self) -> SkeletonMotion:
        """The movement as a skeleton that stands in the room's axes where no bone is turned; frames that show too little are NaN.

        Raises AsterismError where a joint slides: bones would change their length.
        """
        if any(motion.slide for bone in self.tree.bones for motion in bone.motions):
            raise AsterismError(f"{self.tree.title}: a joint of it slides, so its bones have no constant length; write its coordinates.")
        turned, joints = self.posed
        # The rest pose is drawn in z-up axes; the recording's may have another vertical.
        axes = z_up_rotation(self.vertical).T
        parents = self.tree.arrays.parents
        own = turned @ axes.T
        rotations = np.empty_like(own)
        for bone, parent in enumerate(parents):
            rotations[:, bone] = own[:, bone] if parent < 0 else own[:, parent].swapaxes(1, 2) @ own[:, bone]
        rotations[~self.known], root = np.nan, joints[:, 0].copy()
        root[~self.known] = np.nan
        ends = np.array([self.tree.ends.get(name, (np.nan,) * 3) for name in self.tree.bone_names], dtype=np.float64)
        return SkeletonMotion(
            self.tree.bone_names,
            tuple(int(parent) for parent in parents),
            self.tree.arrays.offsets @ axes.T,
            ends @ axes.T,
            rotations,
            root,
            self.rate,
            self.vertical,
            axes @ np.array([1.0, 0.0, 0.0]),
        )


def solve_kinematics(
    tree: KinematicTree,
    recording: Recording,
    *,
    weights: Mapping[str, float] | None = None,
    rules: KinematicsRules = RULES,
    progress: Progress | None = None,
) -> Kinematics:
    """The coordinates of a tree whose markers a recording shows.

    weights  marker -> m-2, instead of the inverse square of its spread and noise; a marker that is not named has none

    The standard deviation of a place that was filled lessens its weight. Missing markers are allowed in any frame.

    Standard deviations are those of the normal equations, times what markers are off more than they are expected to. What of a course is
    white is averaged out by its neighbours; what remains moves with the skin, and is not. Skin under all markers of a bone moves together,
    too (`KinematicsRules.shared`). They grow where a segment is not seen.
    Raises AsterismError where no frame shows three markers of the tree.
    """
    columns = MarkerSet(tree.labels).columns_of(recording.labels)
    points = np.full((len(recording.positions), len(columns), 3), np.nan)
    up = z_up_rotation(recording.vertical)
    points[:, columns >= 0] = recording.positions[:, columns[columns >= 0]] @ up.T
    scales = _weights(tree, recording, columns, weights, rules)
    return solve_points(tree, points, scales, recording.rate, vertical=recording.vertical, rules=rules, progress=progress)


def _weights(
    tree: KinematicTree, recording: Recording, columns: np.ndarray, given: Mapping[str, float] | None, rules: KinematicsRules
) -> Floats:
    """(T, M) m-2."""
    if given is not None:
        return np.tile([given.get(name, 0.0) for name in tree.labels], (len(recording.positions), 1)).astype(np.float64)
    variance = np.array([marker.spread**2 + rules.noise**2 for marker in tree.markers])
    # What was filled is as much less certain.
    filled = np.zeros((len(recording.positions), len(columns)))
    filled[:, columns >= 0] = np.nan_to_num(filled_samples(recording)[:, columns[columns >= 0]])
    return np.asarray(1.0 / (variance + filled**2))


def solve_points(
    tree: KinematicTree,
    points: Floats,
    weights: Floats,
    rate: float,
    *,
    vertical: Floats | None = None,
    rules: KinematicsRules = RULES,
    progress: Progress | None = None,
) -> Kinematics:
    """As `solve_kinematics`, of positions (T, M, 3) m of the tree's markers in a room whose z is up, with weights (T, M) m-2."""
    arrays = tree.arrays
    points, weights = np.ascontiguousarray(points, dtype=np.float64), np.ascontiguousarray(weights, dtype=np.float64)
    frames, numbers = len(points), ROOT + len(tree.coordinates)
    seen = np.asarray((np.isfinite(points[:, :, 0]) & (weights > 0)).sum(axis=1))
    known = np.asarray(seen >= 3)
    if not known.any():
        raise AsterismError(f"{tree.title}: no frame shows three of its markers ({', '.join(tree.labels[:5])}, ...); label them.")
    solving = _solving(tree, rules)
    q, turns, places = np.tile(tree.start, (frames, 1)), np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3))
    sd, misses = np.empty((frames, numbers)), np.full(points.shape[:2], np.nan)
    state = (q, turns, places)
    start: tuple[Floats, Floats, Floats] | None = None
    squares = np.full(frames, np.nan)
    freedom = np.full(frames, np.nan)
    for first in range(0, frames, rules.block):
        last = min(first + rules.block, frames)
        # A block's neighbours take part in its smoothing, and are then left as they were.
        low, high = max(first - rules.overlap, 0), min(last + rules.overlap, frames)
        part = slice(low, high)
        inner, keep = slice(first - low, last - low), slice(first, last)
        own = (q[part].copy(), turns[part].copy(), places[part].copy())
        found = _block(tree, solving, (points[part], weights[part], known[part]), own, start, rate, rules)
        for whole, block in zip(state, own, strict=True):
            whole[keep] = block[inner]
        sd[keep], misses[keep] = found.sd[inner], found.misses[inner]
        squares[keep], freedom[keep] = found.squares[inner], found.freedom[inner]
        start = (q[last - 1], turns[last - 1], places[last - 1])
        if progress is not None:
            progress(last / frames, f"{last} of {frames} frames")
    shown = known & (freedom > 0)
    scale = float(np.sqrt(squares[shown].sum() / freedom[shown].sum())) if shown.any() else 1.0
    # Half the scale of the whole trial, half the frame's own: a frame alone has few markers to tell its scale from.
    own_scale = np.sqrt(np.where(shown, 0.5 * (scale**2 + squares / np.maximum(freedom, 1.0)), scale**2))
    sd *= np.maximum(own_scale, 1.0)[:, None]
    sd[:, ~arrays.moves] = 0.0
    up = np.array([0.0, 0.0, 1.0]) if vertical is None else vertical
    return Kinematics(tree, q, turns, places, sd, misses, known, rate, up, scale)


def _solving(tree: KinematicTree, rules: KinematicsRules) -> Solving:
    slides = np.array([c.slides for c in tree.coordinates], dtype=np.bool_)
    limits = np.where(slides, rules.limit_m, np.radians(rules.limit_deg)) ** -2.0
    return Solving(rules.tails, limits, rules.ridge, rules.steps, rules.least_decrease, rules.lost, rules.lost_at_most)


@dataclass(frozen=True, eq=False)
class _SolvedFrames:
    """sd (T, D), misses (T, M), squares and freedom (T,): of the misses, weighted, and what of them is not used up by the fit."""

    sd: Floats
    misses: Floats
    squares: Floats
    freedom: Floats


def _block(
    tree: KinematicTree,
    solving: Solving,
    measured: tuple[Floats, Floats, np.ndarray],
    state: tuple[Floats, Floats, Floats],
    start: tuple[Floats, Floats, Floats] | None,
    rate: float,
    rules: KinematicsRules,
) -> _SolvedFrames:
    """Solve frames that are smoothed together; the state is written in place."""
    (q, turns, places), (points, weights, known) = state, measured
    arrays, frames, numbers = tree.arrays, len(points), ROOT + len(tree.coordinates)
    costs, misses = np.zeros(frames), np.full(points.shape[:2], np.nan)
    variances, entries = np.empty((frames, numbers)), np.empty((frames, numbers + len(arrays.row_columns)))
    work = (costs, misses, variances, entries)
    # The fullest of the first frames tells the pose from nothing; from there to both ends.
    counts = np.isfinite(points[:, :, 0]).sum(axis=1)
    anchor = int(np.argmax(counts))
    _begin(tree, solving, points, weights, anchor, state, start, work)
    back = tuple(np.ascontiguousarray(part[: anchor + 1][::-1]) for part in (points, weights, *state, *work))
    _onwards(tree, solving, back, 0)
    for whole, part in zip((*state, *work), back[2:], strict=True):
        whole[: anchor + 1] = part[::-1]
    forth = tuple(part[anchor:] for part in (points, weights, *state, *work))
    _onwards(tree, solving, forth, 0)
    white, ratios = np.zeros(numbers), np.full(numbers, np.inf)
    smooth = rules.smooth and frames >= 10
    if smooth:
        white, ratios = _strengths(tree, variances, q, turns, places, known)
        # What is usual is worth a sighting in each frame that has better ones. Where these are hidden, it is one for all of half a second,
        # in units of the white share of the noise, as the smoothness is.
        sightings = np.minimum(white[ROOT:], 1.0) * arrays.precision / max(rules.usual_s * rate, 1.0)
        kept, squares = tuple(part.copy() for part in state), _squares(weights, misses).sum(axis=1)
        _bridge(tree, variances, state, ratios, sightings, known)
        linearise(arrays, solving, points, weights, q, turns, places, np.empty_like(variances), misses, entries)
        # Numbers that no marker tells cost none: where markers are farther off, they told something together with others.
        told = _squares(weights, misses).sum(axis=1) > squares + 1.0
        for whole, part in zip(state, kept, strict=True):
            whole[told] = part[told]
        hidden = np.column_stack([_hidden(variances[:, ROOT + j], known) for j in range(len(arrays.usual))])
        less = np.where(hidden, arrays.precision - sightings, 0.0)
        least = float(np.median(np.minimum(white[arrays.moves], 1.0)))
        _smoothed(tree, solving, (points, weights, less), state, (ratios, least), (misses, entries), rules)
    total = _total(variances, white, ratios, known, _unrolled(q, turns, places)) if smooth else variances
    shared = np.empty_like(variances)
    shared_variances(arrays, solving, points, weights, rules.shared * _spreads(tree), q, turns, places, shared)
    sd = np.sqrt(total + shared)
    shares = _squares(weights, misses)
    # What Student's t lets go does not say how far the others are off.
    robust = np.minimum(shares, 9.0 * solving.tails) if solving.tails > 0 else shares
    counted = 3.0 * (shares > 0).sum(axis=1)
    return _SolvedFrames(sd, misses, robust.sum(axis=1), counted - np.minimum(int(arrays.moves.sum()), counted))


def _spreads(tree: KinematicTree) -> Floats:
    """(B,) m2, the mean variance of the markers of each bone about their places."""
    on = tree.arrays.bones
    squares = np.bincount(on, weights=[marker.spread**2 for marker in tree.markers], minlength=len(tree.bones))
    return np.asarray(squares / np.maximum(np.bincount(on, minlength=len(tree.bones)), 1))


def _onwards(tree: KinematicTree, solving: Solving, arrays: tuple[Floats, ...], first: int) -> None:
    """Follow frames in order; where the tree got lost, begin anew and go on."""
    points, weights, *rest = arrays
    state, work = (rest[0], rest[1], rest[2]), (rest[3], rest[4], rest[5], rest[6])
    frames, tries = len(points), 0
    while first < frames:
        reached = follow(tree.arrays, solving, points, weights, first, frames, *state, *work)
        if reached >= frames:
            return
        lost = reached - 1
        # Each frame that is lost is tried anew, but not for ever: a tree that fits none of them is not found by trying.
        if tries < 50:
            kept = tuple(part[lost].copy() for part in state)
            _begin(tree, solving, points, weights, lost, state, kept, work)
            tries += 1
        first = lost + 1
        if first < frames:
            for part in state:
                part[first] = part[lost]


def _begin(
    tree: KinematicTree,
    solving: Solving,
    points: Floats,
    weights: Floats,
    frame: int,
    state: tuple[Floats, Floats, Floats],
    start: tuple[Floats, ...] | None,
    work: tuple[Floats, ...],
) -> None:
    """The best state of one frame from several starts: the poses that the tree knows, each laid on the markers as one rigid thing."""
    q, turns, places = state
    guesses = [] if start is None else [start]
    seen = np.isfinite(points[frame, :, 0]) & (weights[frame] > 0)
    poses = tree.starts if tree.starts.size else tree.start[None]
    poses = np.concatenate([tree.start[None], poses])
    if tree.free and seen.sum() >= 3:
        for pose in poses:
            rest = _markers(tree, pose)[seen]
            turn, place = fit_rigid(rest, points[frame, seen], weights[frame, seen])
            guesses.append((pose, turn, place))
    elif not tree.free:
        guesses += [(pose, np.eye(3), np.zeros(3)) for pose in poses]
    found = []
    for guess in guesses or [(tree.start, np.eye(3), np.zeros(3))]:
        for whole, part in zip(state, guess, strict=True):
            whole[frame] = part
        follow(tree.arrays, solving, points, weights, frame, frame + 1, q, turns, places, *work)
        found.append((float(work[0][frame]), [part[frame].copy() for part in (*state, *work)]))
    _, best = min(found, key=lambda each: each[0])
    for whole, part in zip((*state, *work), best, strict=True):
        whole[frame] = part


def _markers(tree: KinematicTree, pose: Floats) -> Floats:
    """(M, 3) m, the markers of a pose whose root stands at the origin."""
    arrays, bones = tree.arrays, len(tree.bones)
    turned, joints, twists = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((len(arrays.numbers), 6))
    pose_tree(arrays, pose, np.eye(3), np.zeros(3), turned, joints, twists)
    return np.asarray(joints[arrays.bones] + np.einsum("mij,mj->mi", turned[arrays.bones], arrays.places))


def _unrolled(q: Floats, turns: Floats, places: Floats) -> Floats:
    """(T, D) the numbers over time: the root's turn as the sum of its rotations from frame to frame."""
    steps = vector_from_rotation(turns[1:] @ turns[:-1].swapaxes(1, 2)).reshape(-1, 3) if len(turns) > 1 else np.empty((0, 3))
    return np.concatenate([places, np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), q], axis=1)


def _strengths(
    tree: KinematicTree, variances: Floats, q: Floats, turns: Floats, places: Floats, known: np.ndarray
) -> tuple[Floats, Floats]:
    """Of each number: the factor of its variances that is white noise, and the ratio of its second differences to it. By likelihood."""
    course = _unrolled(q, turns, places)
    white, ratios = np.zeros(course.shape[1]), np.full(course.shape[1], np.inf)
    for d in np.nonzero(tree.arrays.moves)[0]:
        noise = np.where(_hidden(variances[:, d], known), np.inf, variances[:, d])
        ratios[d], white[d] = best_ratio(np.ascontiguousarray(course[:, d]), noise)
    return white, ratios


def _bridge(
    tree: KinematicTree, variances: Floats, state: tuple[Floats, Floats, Floats], ratios: Floats, sightings: Floats, known: np.ndarray
) -> None:
    """Numbers that frames do not tell, from the frames around, number by number: where the smoothing begins. Writes the state.

    sightings (Q,): the weight that what is usual of a coordinate has in each of these frames.
    """
    q, turns, places = state
    usual = np.concatenate([np.zeros(ROOT), sightings])
    course = _unrolled(q, turns, places)
    steps = np.zeros_like(course)
    for d in np.nonzero(np.isfinite(ratios))[0]:
        hidden = _hidden(variances[:, d], known)
        if not hidden.any() or hidden.all():
            continue
        bands = np.zeros((3, len(course)))
        for shift, factor in ((0, 1.0), (1, 4.0), (2, 1.0)):
            bands[2, shift : len(course) - 2 + shift] += factor / ratios[d]
        bands[1, 1:-1] -= 2.0 / ratios[d]
        bands[1, 2:] -= 2.0 / ratios[d]
        bands[0, 2:] = 1.0 / ratios[d]
        weights, values = np.where(hidden, 0.0, 1.0 / variances[:, d]), course[:, d].copy()
        # A millionth of a sighting where there is none keeps the root from running off at the ends of a trial.
        weights[hidden] = max(1e-6 * weights.max(), usual[d])
        if d >= ROOT:
            values[hidden] = tree.arrays.usual[d - ROOT]
        bands[2] += weights
        steps[hidden, d] = (solveh_banded(bands, weights * values) - course[:, d])[hidden]
    q += steps[:, ROOT:]
    places += steps[:, :3]
    turns[:] = Rotation.from_rotvec(steps[:, 3:6]).as_matrix() @ turns


def _squares(weights: Floats, misses: Floats) -> Floats:
    """(T, M) squares of misses in units of their variance; 0 where a marker is not seen."""
    return np.where(np.isfinite(misses), weights * misses**2, 0.0)


def _hidden(variances: Floats, known: np.ndarray) -> np.ndarray:
    """(T,) whether a frame tells nothing of a number whose variances (T,) these are."""
    return np.asarray(~known | (variances > _HIDDEN * np.median(variances[known])))


def _total(variances: Floats, white: Floats, ratios: Floats, known: np.ndarray, course: Floats) -> Floats:
    """(T, D) the variances of smoothed numbers (T, D): what is left of the white share, and the rest as it was."""
    total = np.empty_like(variances)
    usual = np.median(variances[known], axis=0)
    for d in range(variances.shape[1]):
        if not np.isfinite(ratios[d]):
            total[:, d] = variances[:, d]
            continue
        smoothed = np.empty(len(variances))
        smoothed_variances(np.minimum(variances[:, d], 1e3 * usual[d]), ratios[d], smoothed)
        share = min(float(white[d]), 1.0)
        # Where a frame itself says nothing, its neighbours' own error is the least that remains.
        rest = (1.0 - share) * np.minimum(variances[:, d], usual[d])
        swing = _swing(course[:, d], _hidden(variances[:, d], known), white[d] * ratios[d])
        total[:, d] = np.minimum(white[d] * swing * smoothed + rest, np.maximum(variances[:, d], usual[d]))
    return total


def _swing(course: Floats, hidden: np.ndarray, change: float) -> Floats:
    """(T,) by what factor a course swings farther across its hidden frames than velocities would that change by white noise; 1 elsewhere.

    A joint keeps its acceleration for a while. How much that matters over a gap is told by the second differences of the course where it is
    seen, over half as many frames as are hidden; change: the variance of those over one frame.
    """
    factor = np.ones(len(course))
    edges = np.nonzero(np.diff(np.concatenate([[0], hidden.astype(np.int8), [0]])))[0].reshape(-1, 2)
    seen = np.where(hidden, np.nan, course)
    for first, last in edges:
        half = (int(last) - int(first) + 1) // 2
        bends = seen[2 * half :] - 2.0 * seen[half : len(seen) - half] + seen[: len(seen) - 2 * half]
        bends = bends[np.isfinite(bends)]
        # Fewer than ten say little of how far it swings.
        if len(bends) >= 10:
            expected = change * half * (2 * half**2 + 1) / 3.0
            factor[first:last] = max(1.0, float(np.mean(bends**2)) / max(expected, 1e-300))
    return factor


def _smoothed(
    tree: KinematicTree,
    solving: Solving,
    measured: tuple[Floats, Floats, Floats],
    state: tuple[Floats, Floats, Floats],
    strengths: tuple[Floats, float],
    out: tuple[Floats, Floats],
    rules: KinematicsRules,
) -> None:
    """Gauss and Newton over all frames together: their costs, and the squares of second differences by `ratios`. Writes the state.

    measured: points, weights, and (T, Q) by how much less than its precision what is usual of a coordinate counts; strengths: the ratios,
    and a usual share of white noise.
    """
    q, turns, places = state
    points, weights, less, misses, entries = *measured, *out
    ratios, white = strengths
    numbers = slice(ROOT, ROOT + q.shape[1])
    # Numbers that are held have no step, whatever their penalty.
    penalties = np.where(np.isfinite(ratios), 1.0 / ratios, 1.0)
    gradients, steps = np.empty((len(q), ROOT + q.shape[1])), np.empty((len(q), ROOT + q.shape[1]))

    def cost() -> tuple[float, Floats]:
        data = linearise(tree.arrays, solving, points, weights, q, turns, places, gradients, misses, entries)
        away = q - tree.arrays.usual
        data -= 0.5 * float((less * away**2).sum())
        gradients[:, numbers] += less * away
        entries[:, numbers] -= less
        bends = np.diff(_unrolled(q, turns, places), n=2, axis=0)
        return data + 0.5 * float((penalties * bends**2).sum()), bends

    now, bends = cost()
    for _ in range(rules.rounds):
        right = gradients.copy()
        for shift, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
            right[shift : shift + len(bends)] -= factor * penalties * bends
        smoothing_step(
            tree.arrays, entries, penalties, *_basis(tree, entries, penalties), right, rules.least_square * white * steps.size, steps
        )
        before, kept = now, (q.copy(), turns.copy(), places.copy())
        length = 1.0
        while True:
            q[:] = kept[0] + length * steps[:, ROOT:]
            places[:] = kept[2] + length * steps[:, :3]
            turns[:] = Rotation.from_rotvec(length * steps[:, 3:6]).as_matrix() @ kept[1]
            now, bends = cost()
            if now <= before or length < 0.1:
                break
            length *= 0.5
        if now > before:
            q[:], turns[:], places[:] = kept
            cost()
            return
        # By cost alone a bridge over a gap would weigh nothing.
        if np.abs(steps).max() < rules.done:
            return


def _basis(tree: KinematicTree, entries: Floats, penalties: Floats) -> tuple[Floats, Floats]:
    """What takes the mean normal equations and the penalties apart, see `smoothing_step`: (D, D) and (D,)."""
    arrays, size = tree.arrays, len(penalties)
    mean, whole = entries.mean(axis=0), np.zeros((size, size))
    rows = np.repeat(np.arange(size), np.diff(arrays.row_starts))
    whole[rows, arrays.row_columns] = mean[size:]
    # Numbers differ by many powers of ten in how much they are smoothed. The factor's singular values are right where the eigenvalues of
    # the matrix, their squares, would be lost in the rounding of the largest.
    scale = 1.0 / np.sqrt(penalties)
    left, singular, _ = np.linalg.svd(scale[:, None] * np.linalg.cholesky(whole + whole.T + np.diag(mean[:size])))
    # Below a billionth a number is a straight line, and its band of equations would have no factor.
    return np.ascontiguousarray(scale[:, None] * left), np.maximum(singular**2, 1e-9)


class FollowedTree:
    """A tree that follows markers frame by frame, while they come: what `solve_points` finds without smoothing.

    tree   of a person
    rules  as `solve_kinematics` takes them

    Each frame begins from the one before it. A tree that got lost is laid anew, from the poses that it knows, at most once in `again`
    frames, so that a frame takes no longer on average. O(M + D depth) a frame, of M markers and D numbers.
    """

    again = 20

    def __init__(self, tree: KinematicTree, rules: KinematicsRules = RULES) -> None:
        self.tree, self._solving = tree, _solving(tree, rules)
        markers, numbers = len(tree.markers), ROOT + len(tree.coordinates)
        self._weights = np.array([[1.0 / (marker.spread**2 + rules.noise**2) for marker in tree.markers]])
        self._state = (tree.start[None].copy(), np.eye(3)[None], np.zeros((1, 3)))
        misses, entries = np.full((1, markers), np.nan), np.empty((1, numbers + len(tree.arrays.row_columns)))
        self._work = (np.zeros(1), misses, np.empty((1, numbers)), entries)
        self._usual = np.full(numbers, np.inf)
        self._found, self._wait = False, 0

    def learn(self, points: Floats) -> None:
        """How certain each number usually is, by some frames (T, M, 3) m, z up."""
        seen = []
        for frame in points:
            if np.isfinite(self.push(frame)).any():
                seen.append(self._work[2][0].copy())
        if seen:
            self._usual = np.asarray(np.median(seen, axis=0))

    def push(self, points: Floats) -> Floats:
        """The coordinates (Q,) rad or m by the markers (M, 3) m of a frame, z up; NaN where it tells them not."""
        given, solving, tree = np.ascontiguousarray(points, dtype=np.float64)[None], self._solving, self.tree
        if np.isfinite(given[0, :, 0]).sum() < 3:
            self._found = False
            return np.full(len(tree.coordinates), np.nan)
        self._wait = max(self._wait - 1, 0)
        if self._found:
            follow(tree.arrays, solving, given, self._weights, 0, 1, *self._state, *self._work)
            self._found = not self._is_lost()
        if not self._found and self._wait == 0:
            _begin(tree, solving, given, self._weights, 0, self._state, None, self._work)
            self._found, self._wait = not self._is_lost(), self.again
        told = self._work[2][0, ROOT:] <= _HIDDEN * self._usual[ROOT:]
        # A pose that leaves its markers far off tells no angle.
        return np.where(told & self._found, self._state[0][0], np.nan)

    def _is_lost(self) -> bool:
        squares = _squares(self._weights, self._work[1])[0]
        seen = int(np.isfinite(self._work[1][0]).sum())
        return float(np.minimum(squares, self._solving.lost_at_most).sum()) > 3.0 * self._solving.lost * max(seen, 1)


def with_spreads(tree: KinematicTree, spreads: Mapping[str, float]) -> KinematicTree:
    """The tree with other spreads of its markers (m)."""
    return replace(tree, markers=tuple(replace(marker, spread=spreads.get(marker.name, marker.spread)) for marker in tree.markers))
