"""A posed body and the blobs of one frame in; other poses of its arms, which explain the blobs better, out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from asterism.recording import Floats, Ints
from asterism.skeleton.arrays import ArticulatedBodyArrays, PosePrior
from asterism.skeleton.body import ArticulatedBody
from asterism.skeleton.pose_kernels import HINGES, PLACE
from asterism.skeleton.posing import posed_bones
from asterism.views._limb_kernels import fit_limb, screen_limb
from asterism.views.arrays import Observing, PinholeArrays

_NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class LimbSearchRules:
    """How limbs are sought. Chosen on simulated motion (`simulate_motion`) with seeds that no row uses.

    loose   rad, a limb is sought where the standard deviations of its hinges are more than this in all (root of the sum of squares)
    reach   standard deviations about the usual angles within which angles are tried, as far as the hinge goes
    early   angles of a limb that are tried between the coarse stages of a start
    tried   angles that are tried afterwards
    blur    px, at which blobs are compared then
    first   how many of them are fitted alone to the blobs that no other part has; own_steps: tries of Levenberg-Marquardt in each stage
    kept    how many of these are fitted with the whole body
    apart  rad, the least difference of their angles
    fit     px, the blurs of both fits
    starts, steps  starts of a limb, and tries of Levenberg-Marquardt from each, when its markers are named in another order
    """

    loose: float = 1.0
    reach: float = 2.5
    early: int = 32
    tried: int = 256
    blur: float = 12.0
    first: int = 12
    own_steps: int = 4
    kept: int = 3
    apart: float = 0.3
    fit: tuple[float, ...] = (10.0, 5.0, 2.5)
    starts: int = 32
    steps: int = 12


RULES = LimbSearchRules()


@dataclass(frozen=True, eq=False)
class Limb:
    """A chain of bones that ends in the open.

    first    its first bone in the body
    hinges   (L,) its hinges in the body
    markers  (M,) its markers in the body; rest: the other ones
    arrays   the chain as a body of its own
    tried    (N, L) rad, angles evenly spread over the ranges of its hinges; those of its last bone, which moves few markers, are as usual
    """

    first: int
    hinges: Ints
    markers: Ints
    rest: Ints
    arrays: ArticulatedBodyArrays
    tried: Floats

    @property
    def pairs(self) -> tuple[tuple[Ints, Ints], ...]:
        """Two markers that are the only ones of a bone, as on both sides of a wrist, and a single one of the next bone, or none.

        By their numbers in the body.
        """
        of_bone = [self.markers[self.arrays.bones == b] for b in range(len(self.arrays.parents) + 1)]
        return tuple((pair, beyond if len(beyond) == 1 else beyond[:0]) for pair, beyond in pairwise(of_bone) if len(pair) == 2)


def limbs_of(body: ArticulatedBody, rules: LimbSearchRules = RULES) -> tuple[Limb, ...]:
    """The limbs that are sought: chains of two bones or more without a branch, below the root or a bone with branches. O(bones^2)."""
    arrays = body.arrays
    children = [np.nonzero(arrays.parents == b)[0].tolist() for b in range(len(arrays.parents))]
    limbs = []
    for b in range(1, len(children)):
        chain = [b]
        # A chain follows single children; where a bone branches, the limb ends.
        while len(children[chain[-1]]) == 1:
            chain += children[chain[-1]]
        # A limb begins at the trunk, which is the root or has several children.
        begins = arrays.parents[b] == 0 or len(children[arrays.parents[b]]) > 1
        if begins and len(chain) >= 2 and not children[chain[-1]]:
            limb = _limb(arrays, np.array(chain, dtype=np.int64), rules)
            # Limbs that can hardly move are found by the fit of the whole body.
            if float(np.sqrt((1.0 / limb.arrays.precision).sum())) > rules.loose:
                limbs.append(limb)
    return tuple(limbs)


def _limb(body: ArticulatedBodyArrays, chain: Ints, rules: LimbSearchRules) -> Limb:
    of_bone = [np.arange(body.hinge_starts[b], body.hinge_starts[b + 1]) for b in chain]
    hinges = np.concatenate(of_bone)
    starts = np.concatenate([[0], np.cumsum([len(each) for each in of_bone])]).astype(np.int64)
    on_limb = np.isin(body.bones, chain)
    arrays = ArticulatedBodyArrays(
        np.arange(-1, len(chain) - 1),
        body.pivots[chain],
        starts,
        body.axes[hinges],
        np.ascontiguousarray(body.moves[chain][:, hinges]),
        body.low[hinges],
        body.high[hinges],
        body.usual[hinges],
        body.precision[hinges],
        np.searchsorted(chain, body.bones[on_limb]),
        body.places[on_limb],
        body.spreads[on_limb],
        np.empty(0, dtype=np.int64),
        np.empty((0, 3)),
        np.empty((0, 2)),
    )
    return Limb(int(chain[0]), hinges, np.nonzero(on_limb)[0], np.nonzero(~on_limb)[0], arrays, _tried(arrays, int(starts[-2]), rules))


def _tried(limb: ArticulatedBodyArrays, sought: int, rules: LimbSearchRules) -> Floats:
    """(N, L) rad, the angles that are tried: the first hinges vary."""
    spread = rules.reach * limb.precision**-0.5
    # Angles are tried within what anatomy allows and what is usual, whichever is narrower.
    low, high = np.maximum(limb.low, limb.usual - spread), np.minimum(limb.high, limb.usual + spread)
    angles = np.repeat(limb.usual[None], rules.tried, axis=0)
    angles[:, :sought] = low[:sought] + evenly(rules.tried, sought) * (high - low)[:sought]
    return angles


@dataclass(frozen=True, eq=False)
class LimbScreen:
    """Tries angles of limbs on the blobs of one frame: xy (P, 2) px, offsets (C + 1,) where each camera's begin."""

    body: ArticulatedBody
    cameras: PinholeArrays
    observing: Observing
    xy: Floats
    offsets: Ints

    def poses(self, limb: Limb, pose: Floats, rotation: Floats, *, tried: int, blur: float, kept: int = 1, apart: float = 0.0) -> Floats:
        """Poses (N, 9 + J), best first: the one given and `tried` others that differ from it in one limb; N at most `kept`.

        The blobs are compared with a blur (px); of angles nearer than `apart` (rad) the best is kept. O(tried (bones + blobs)).
        """
        angles, costs = self._screened(limb, limb.rest, pose, rotation, tried, blur)
        return self._with_angles(limb, pose, _apart(angles, costs, kept, apart))

    def alone(self, limb: Limb, pose: Floats, rotation: Floats, known: PosePrior, rules: LimbSearchRules, kept: int) -> Floats:
        """Poses (N, 9 + J), best first, N at most `kept`, with a limb sought and then fitted as if all blobs were its own.

        O(tried (bones + blobs) + first steps blobs).
        """
        # The limb is sought as if all blobs were its own: blobs of other parts only make its own stand out less.
        angles, costs = self._screened(limb, _NONE, pose, rotation, rules.tried, rules.blur)
        chosen = _apart(angles, costs, rules.first, rules.apart)
        fitted, costs = self._fitted(limb, chosen, _NONE, np.array(rules.fit), rules.own_steps, pose, rotation, known)
        return self._with_angles(limb, pose, _apart(fitted, costs, kept, rules.apart))

    def _screened(self, limb: Limb, rest: Ints, pose: Floats, rotation: Floats, tried: int, blur: float) -> tuple[Floats, Floats]:
        """The angles of a limb as given and `tried` others (N, L), with their costs (N,); rest: the other markers that have blobs."""
        # The angles as they are take part, so that a search never makes a pose worse.
        angles = np.concatenate([pose[None, HINGES + limb.hinges], limb.tried[:tried]])
        costs = np.empty(len(angles))
        screen_limb(
            *(self.body.arrays, limb.arrays, limb.first, self.cameras, self.observing, self.xy, self.offsets, blur),
            *(rest, angles, pose, rotation, costs),
        )
        return angles, costs

    @staticmethod
    def _with_angles(limb: Limb, pose: Floats, angles: Floats) -> Floats:
        out = np.repeat(pose[None], len(angles), axis=0)
        out[:, HINGES + limb.hinges] = angles
        return out

    def labelled(self, limb: Limb, labels: Ints, pose: Floats, rotation: Floats, known: PosePrior, *, tried: int, steps: int) -> Floats:
        """The pose (9 + J,) with the angles of one limb that fit labels (P,) best, from `tried` starts. O(tried steps)."""
        angles = np.concatenate([pose[None, HINGES + limb.hinges], limb.tried[:tried]])
        number = np.full(len(self.body.markers) + 1, -1, dtype=np.int64)
        # Labels of other parts become -1, which the kernel does not use.
        number[limb.markers] = np.arange(len(limb.markers))
        # Four times the noise: a start may be that far off before the fit.
        noise = np.array([4.0 * self.observing.noise])
        angles, costs = self._fitted(limb, angles, number[labels], noise, steps, pose, rotation, known)
        out = pose.copy()
        out[HINGES + limb.hinges] = angles[int(np.argmin(costs))]
        return out

    def _fitted(
        self, limb: Limb, angles: Floats, labels: Ints, sigmas: Floats, steps: int, pose: Floats, rotation: Floats, known: PosePrior
    ) -> tuple[Floats, Floats]:
        """Angles (N, L) of a limb after a fit from each, and their costs (N,); see `fit_limb`."""
        turned, moved = posed_bones(self.body, pose, rotation)
        # The limb hangs on the bone above it, whose pose stays as it is.
        above = int(self.body.arrays.parents[limb.first])
        starts = np.empty((len(angles), HINGES + angles.shape[1]))
        starts[:, :HINGES] = np.concatenate([pose[:PLACE], moved[above], np.zeros(3)])
        starts[:, HINGES:] = angles
        costs = np.empty(len(starts))
        fit_limb(
            *(limb.arrays, self.cameras, known, self.observing, self.xy, self.offsets, labels, sigmas, steps),
            *(turned[above], starts, costs),
        )
        return starts[:, HINGES:], costs


def _apart(angles: Floats, costs: Floats, most: int, apart: float) -> Floats:
    """The cheapest angles (N, L), at most so many, no two nearer than `apart` (rad)."""
    chosen = list[int]()
    # The cheapest first, so that of two near ones the better is kept.
    for n in np.argsort(costs, kind="stable") if most > 1 else [int(np.argmin(costs))]:
        if all(np.abs(angles[n] - angles[k]).max() > apart for k in chosen):
            chosen.append(int(n))
        if len(chosen) == most:
            break
    return angles[chosen]


@cache
def evenly(count: int, dimensions: int) -> Floats:
    """(count, dimensions) numbers in 0 to 1, evenly spread: multiples of the powers of the generalised golden ratio (Roberts 2018)."""
    ratio = 2.0
    for _ in range(60):
        # The root of x^(d+1) = x + 1 by iteration; sixty rounds are enough for all digits.
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    spread: Floats = (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0
    spread.setflags(write=False)
    return spread
