"""Labelled frames and a guess of where markers sit in; a person's sizes, poses and marker places out: Gauss and Newton, damped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.geometry import fit_rigid, rotation_from_vector
from asterism.recording import Floats, Place
from asterism.skeleton.joints import LENGTH_NAMES, SPREAD, TURNS, USUAL, PosedSegments, pose_segments, scales_of


@dataclass(frozen=True)
class PlaceFitRules:
    """How a skeleton is laid on frames. Round numbers; doubled or halved they move the places of the shipped sets by less than 5 mm.

    noise        m, of a marker about its place on the bone: mostly skin that slides
    outlier      multiples of `noise` from which a marker pulls no harder: a wrong name moves the skeleton little
    size         standard deviation of the logarithm of the body's size: 1.4 to 2.1 m are within one
    proportion   the same of each length beside the size
    steps, tries steps of the fit, and dampings that are tried in each
    """

    noise: float = 0.006
    outlier: float = 4.0
    size: float = 0.2
    proportion: float = 0.03
    steps: int = 25
    tries: int = 5


RULES = PlaceFitRules()

STARTS: tuple[dict[str, float], ...] = (
    {},
    {"shoulder abduction": 88.0},
    {"hip flexion": -90.0, "knee flexion": 85.0},
    {"shoulder flexion": -80.0, "elbow flexion": -60.0},
)
"""Postures from which the fit begins: standing, T-pose, sitting, arms ahead; degrees that differ from the usual ones."""


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A person laid on frames.

    sizes    (8,) logarithms: of the body against 1.70 m, then of each length beside it
    root     (T, 3, 3) the pelvis' axes; where (T, 3) m its origin
    degrees  (T, J) joint angles
    shifts   (M, 3) what each marker sits beside its guessed place, in the units of the place
    misses   (T, M) m, NaN where a marker is not seen
    cost     twice the negative log posterior, without its constant
    """

    sizes: Floats
    root: Floats
    where: Floats
    degrees: Floats
    shifts: Floats
    misses: Floats
    cost: float

    def segments(self) -> PosedSegments:
        """The posed segments."""
        return pose_segments(self.sizes, self.root, self.where, self.degrees)


def fit_places(positions: Floats, places: Sequence[Place], doubt: Floats, rules: PlaceFitRules = RULES) -> PlacedBody:
    """Lay the skeleton on frames of one person.

    positions (T, M, 3) m with z up, NaN where a marker is not seen; places: guesses of the M markers; doubt (M, 3): standard deviation of
    each coordinate of a place. Each frame needs three markers at least. Deterministic. O(steps (T J + 3 M)^3).
    """
    problem = _Problem(positions, places, doubt, rules)
    # Short fits from each posture; the best one goes on.
    begun = [problem.solve(problem.start(posture), rules.steps // 3) for posture in STARTS]
    return problem.solve(min(begun, key=lambda body: body.cost), rules.steps)


def size_against_standing(positions: Floats, places: Sequence[Place]) -> float:
    """How much farther markers (T, M, 3) lie from their middle than on a body of 1.70 m that stands; of the frame that shows most."""
    frame = positions[int(np.argmax(np.isfinite(positions[:, :, 0]).sum(axis=1)))]
    seen = np.isfinite(frame[:, 0])
    sizes, still = np.zeros(1 + len(LENGTH_NAMES)), np.zeros((1, 3))
    posed = pose_segments(sizes, np.eye(3)[None], still, USUAL[None])
    standing = [
        posed.rotations[p.segment][0] @ (np.array(p.at) * scales_of(sizes, p.segment)) + posed.origins[p.segment][0] for p in places
    ]
    return _radius(frame[seen]) / _radius(np.array(standing)[seen])


class _Problem:
    """The measured frames with all that is known beforehand."""

    def __init__(self, positions: Floats, places: Sequence[Place], doubt: Floats, rules: PlaceFitRules) -> None:
        self.seen = np.isfinite(positions[:, :, 0])
        self.points = np.where(self.seen[:, :, None], positions, 0.0)
        self.segments = tuple(place.segment for place in places)
        self.at = np.array([place.at for place in places], dtype=np.float64)
        self.doubt, self.rules = doubt, rules
        self.size_doubt = np.array([rules.size] + [rules.proportion] * len(LENGTH_NAMES))
        self.frames, self.markers = self.seen.shape
        self.own = 6 + len(TURNS)

    def start(self, posture: dict[str, float]) -> PlacedBody:
        """The skeleton in a posture, laid on each frame as one rigid thing."""
        usual = np.array([posture.get(turn.name.partition(" ")[2], 0.0) for turn in TURNS])
        # Right arms are raised as left ones, mirrored.
        signs = np.array([-1.0 if turn.name.startswith("right ") and turn.axis != 1 else 1.0 for turn in TURNS])
        degrees = np.tile(np.where(usual == 0.0, USUAL, usual * signs), (self.frames, 1))
        body = PlacedBody(
            np.zeros(1 + len(LENGTH_NAMES)),
            np.tile(np.eye(3), (self.frames, 1, 1)),
            np.zeros((self.frames, 3)),
            degrees,
            np.zeros_like(self.at),
            np.full(self.seen.shape, np.nan),
            np.inf,
        )
        guess, _ = self.predict(body)
        sizes = body.sizes.copy()
        first = self.seen[int(np.argmax(self.seen.sum(axis=1)))]
        frame = int(np.argmax(self.seen.sum(axis=1)))
        # Half of what the spread of the points says of the size: the posture is not known yet.
        sizes[0] = 0.5 * np.log(_radius(self.points[frame, first]) / _radius(guess[frame, first]))
        root, where = body.root.copy(), body.where.copy()
        for t in range(self.frames):
            root[t], where[t] = fit_rigid(guess[t, self.seen[t]], self.points[t, self.seen[t]])
        return self.judged(replace(body, sizes=sizes, root=root, where=where))

    def predict(self, body: PlacedBody) -> tuple[Floats, Floats]:
        """Where the markers are (T, M, 3), and how they move with their places (T, M, 3, 3)."""
        posed = body.segments()
        at = self.at + body.shifts
        frames = len(body.where)
        out, moves = np.empty((frames, self.markers, 3)), np.empty((frames, self.markers, 3, 3))
        for segment in dict.fromkeys(self.segments):
            on = [m for m, each in enumerate(self.segments) if each == segment]
            turned = posed.rotations[segment] * scales_of(body.sizes, segment)
            out[:, on] = at[on] @ turned.swapaxes(1, 2) + posed.origins[segment][:, None]
            moves[:, on] = turned[:, None]
        return out, moves

    def judged(self, body: PlacedBody) -> PlacedBody:
        """The body with its cost and misses."""
        guess, _ = self.predict(body)
        apart = np.linalg.norm(guess - self.points, axis=2)
        far = apart / self.rules.noise
        limit = self.rules.outlier
        # Huber's loss: quadratic up to the limit, then straight.
        loss = np.where(far > limit, 2 * limit * far - limit**2, far**2) * self.seen
        known = [body.sizes / self.size_doubt, (body.degrees - USUAL) / SPREAD, body.shifts / self.doubt]
        cost = float(loss.sum() + sum((part**2).sum() for part in known))
        return replace(body, cost=cost, misses=np.where(self.seen, apart, np.nan))

    def solve(self, body: PlacedBody, steps: int) -> PlacedBody:
        """So many damped steps, fewer where the cost falls by less than a thousandth."""
        damping = 1e-2
        for _ in range(steps):
            normal, gradient = self.equations(body)
            best = body
            for _ in range(self.rules.tries):
                damped = normal.copy()
                diagonal = np.arange(len(gradient))
                damped[diagonal, diagonal] *= 1.0 + damping
                better = self.judged(self.moved(body, np.asarray(-np.linalg.solve(damped, gradient), dtype=np.float64)))
                if better.cost < body.cost:
                    best, damping = better, max(damping / 5.0, 1e-5)
                    break
                damping *= 6.0
            done = body.cost - best.cost < 1e-3 * body.cost
            body = best
            if done:
                break
        return body

    def moved(self, body: PlacedBody, step: Floats) -> PlacedBody:
        """The body after a step of all unknowns: sizes, then each frame's root, place and angles, then the markers' shifts."""
        first, last = len(body.sizes), len(body.sizes) + self.frames * self.own
        own = step[first:last].reshape(self.frames, self.own)
        root = np.array([rotation_from_vector(own[t, :3]) @ body.root[t] for t in range(self.frames)])
        # A joint turns by 40 degrees in a step at most: beyond that the equations say little.
        degrees = body.degrees + np.clip(own[:, 6:], -40.0, 40.0)
        return replace(
            body,
            sizes=body.sizes + step[:first],
            root=root,
            where=body.where + own[:, 3:6],
            degrees=degrees,
            shifts=body.shifts + step[last:].reshape(-1, 3),
        )

    def equations(self, body: PlacedBody) -> tuple[Floats, Floats]:
        """The normal equations (N, N) and the gradient (N,) of half the cost."""
        guess, moves = self.predict(body)
        error = (guess - self.points) / self.rules.noise
        far = np.linalg.norm(error, axis=2)
        weight = np.where(far > self.rules.outlier, np.sqrt(self.rules.outlier / np.maximum(far, 1e-9)), 1.0) * self.seen
        by_size, by_pose = self.derivatives(body, guess)
        scale = (weight / self.rules.noise)[:, :, None, None]
        by_size, by_pose, by_place = by_size * scale, by_pose * scale, moves * scale
        error = error * weight[:, :, None]
        first, last = len(body.sizes), len(body.sizes) + self.frames * self.own
        total = last + 3 * self.markers
        normal, gradient, known = np.zeros((total, total)), np.zeros(total), np.zeros(total)
        normal[:first, :first] = np.einsum("tmxa,tmxb->ab", by_size, by_size)
        gradient[:first] = np.einsum("tmxa,tmx->a", by_size, error)
        # Frames meet in the sizes and the places alone, so the rest of the matrix is blocks.
        for t in range(self.frames):
            block = slice(first + t * self.own, first + (t + 1) * self.own)
            pose, size = by_pose[t].reshape(-1, self.own), by_size[t].reshape(-1, first)
            normal[block, block] = pose.T @ pose
            gradient[block] = pose.T @ error[t].ravel()
            normal[:first, block] = size.T @ pose
            normal[block, :first] = normal[:first, block].T
            crossed = np.einsum("mxf,mxy->fmy", by_pose[t], by_place[t]).reshape(self.own, -1)
            normal[block, last:], normal[last:, block] = crossed, crossed.T
            known[block] = np.concatenate([np.full(6, 1e-9), SPREAD**-2.0])
            gradient[block.start + 6 : block.stop] += (body.degrees[t] - USUAL) / SPREAD**2
        crossed = np.einsum("tmxs,tmxy->smy", by_size, by_place).reshape(first, -1)
        normal[:first, last:], normal[last:, :first] = crossed, crossed.T
        own = np.einsum("tmxy,tmxz->myz", by_place, by_place)
        for m in range(self.markers):
            normal[last + 3 * m : last + 3 * m + 3, last + 3 * m : last + 3 * m + 3] = own[m]
        gradient[last:] = np.einsum("tmxy,tmx->my", by_place, error).ravel() + (body.shifts / self.doubt**2).ravel()
        gradient[:first] += body.sizes / self.size_doubt**2
        known[:first], known[last:] = self.size_doubt**-2.0, (self.doubt**-2.0).ravel()
        normal[np.arange(total), np.arange(total)] += known
        return normal, gradient

    def derivatives(self, body: PlacedBody, guess: Floats) -> tuple[Floats, Floats]:
        """Of the markers by the sizes (T, M, 3, 8) and by each frame's own unknowns (T, M, 3, 6 + J); angles and sizes by differences."""
        by_size = np.empty((self.frames, self.markers, 3, len(body.sizes)))
        for i in range(len(body.sizes)):
            sizes = body.sizes.copy()
            sizes[i] += 1e-4
            by_size[..., i] = (self.predict(replace(body, sizes=sizes))[0] - guess) / 1e-4
        by_pose = np.zeros((self.frames, self.markers, 3, self.own))
        from_root = guess - body.where[:, None]
        for axis in range(3):
            by_pose[..., axis] = np.cross(np.eye(3)[axis], from_root)
            by_pose[:, :, axis, 3 + axis] = 1.0
        # The frames with each angle turned a little, one set of them after the other, are posed in one call.
        turned = np.repeat(body.degrees[None], len(TURNS), axis=0)
        turned[np.arange(len(TURNS)), :, np.arange(len(TURNS))] += 0.1
        root, where = np.tile(body.root, (len(TURNS), 1, 1)), np.tile(body.where, (len(TURNS), 1))
        after, _ = self.predict(replace(body, root=root, where=where, degrees=turned.reshape(-1, len(TURNS))))
        by_pose[..., 6:] = np.moveaxis((after.reshape(len(TURNS), *guess.shape) - guess) / 0.1, 0, -1)
        return by_size, by_pose


def _radius(points: Floats) -> float:
    """m, root mean square distance from the middle."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
