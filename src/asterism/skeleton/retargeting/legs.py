"""Feet where they should stand, and limbs as they are, in; smooth corrections, and the limbs that reach there, out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.sparse.linalg import splu

from asterism.recording import Floats
from asterism.skeleton.retargeting.contacts import stretches

FADE = 0.12
"""s, in which four fifths of a correction come or go beside a contact: a third of a swing. At half feet jerk, at double they float."""
_HELD = 1e3
"""Weight of standing feet. At half or double of it they stand as exactly to 0.1 mm."""
_BACK = 1e-4
"""Weight of no correction, on the same scale."""
STRAIGHT = 0.998
"""Of the length of a leg, how far it reaches without being stretched to a line: 7 degrees of flexion. At half the remaining share knees
jump when they lock, at double the hips come down by what can be seen."""
_GIVES = (0.0004, 0.004)
"""Of the length of a leg, over which a foot that stands, and one in the air, is slowed before its leg is straight: 0.3 and 3 mm of a
person's. At half of the second knees of swinging legs jump, at double feet in the air are off by a centimetre."""
_PASSES = 0.05
"""Sine of the flexion, 3 degrees, over which a limb that passes through the straight keeps bending about its axis: at half of it the plane
turns at once, at double knees of walkers lose their own plane."""
_HYPER = 0.17
"""Sine of the flexion, 10 degrees, up to which a limb that bends the wrong way is taken for one that is stretched too far."""
_PROJECTIONS = 20
"""In turn on two spheres, whose common points are near: twenty leave 1e-4 of the way where legs are not at their widest."""
ROUNDS = 4
"""Times that frames in which a foot goes below the floor, or is out of reach, are asked for more; each leaves a tenth or less."""
_HINGE = 0.15
"""Sine of the flexion, 9 degrees, below which a limb bends in the plane of its rest pose: noise turns the plane of a straight knee. At a
third of it knees of straight legs that have to bend jump by 20 mm to the side, at double knees of walkers lose their own plane."""


def smooth_offsets(wanted: Floats, weight: Floats, rate: float, groups: list[tuple[int, int, int]] | None = None) -> Floats:
    """(T, n) the smooth curve that is as wanted where that has weight, and goes back to nothing elsewhere.

    wanted  (T, P, n), weight (T, P): P requests per frame, of which those without weight do not count
    groups  (request, first frame, frame behind the last): within one, the curve may be as wanted plus any constant of that group's own

    Least squares over curve and constants with first and second differences as roughness; sparse, O(T).
    """
    frames, _, columns = wanted.shape
    groups, wanted = groups or [], np.nan_to_num(wanted)
    # constants are free: near zero, their own weight does not draw them
    for p, a, b in groups:
        wanted[a:b, p] -= wanted[a:b, p].mean(axis=0)
    n = max(1.0, FADE * rate / 3.0)
    held = _HELD * weight
    diagonal = held.sum(axis=1) + _BACK
    matrix = sparse.diags([diagonal], [0], shape=(frames, frames), format="csc")
    if frames > 2:
        second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(frames - 2, frames))
        first = sparse.diags([-1.0, 1.0], [0, 1], shape=(frames - 1, frames))
        # together (1 - n^2 d^2/dt^2)^2, whose response to a step does not overshoot
        matrix = matrix + _BACK * (n**4 * (second.T @ second) + 2 * n**2 * (first.T @ first))
    right = (held[:, :, None] * wanted).sum(axis=1)
    if groups:
        coupling = np.zeros((frames, len(groups)))
        own, own_right = np.zeros(len(groups)), np.zeros((len(groups), columns))
        for k, (p, a, b) in enumerate(groups):
            coupling[a:b, k] = -held[a:b, p]
            # a constant that nothing holds stays at zero
            own[k] = held[a:b, p].sum() + _BACK
            own_right[k] = -(held[a:b, p, None] * wanted[a:b, p]).sum(axis=0)
        matrix = sparse.bmat([[matrix, sparse.csc_matrix(coupling)], [sparse.csc_matrix(coupling.T), sparse.diags([own], [0])]])
        right = np.concatenate([right, own_right])
    found: Floats = splu(sparse.csc_matrix(matrix)).solve(right)
    return found[:frames]


def groups_of(standing: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """The contacts (point, first frame, frame behind the last) of flags (T, P)."""
    return [(p, a, b) for p in range(standing.shape[1]) for a, b in stretches(standing[:, p])]


def smooth_hull(values: Floats, rate: float) -> Floats:
    """(T,) a smooth curve that is nowhere below values (T,), and no higher than the highest of them within `FADE` of it."""
    if not values.any():
        return values
    half = max(1, round(0.5 * FADE * rate))
    # the highest around, averaged over less than that: the average has seen the highest only
    hull = gaussian_filter1d(maximum_filter1d(values, 2 * half + 1, mode="nearest"), half / 3.0, mode="nearest", truncate=3.0)
    return np.maximum(hull, values)


def bend(root: Floats, middle: Floats, end: Floats, target: Floats, hinge: Floats) -> tuple[Floats, Floats]:
    """The rotations (T, 3, 3), in the room, of the upper and the lower bone of a limb that take its end to the target.

    root, middle, end, target (T, 3) m; hinge (T, 3): about which the lower bone flexes, where the limb is straight

    The plane of the limb turns no more than its end does. A target out of reach is approached along a straight limb. Closed form by the
    law of cosines.
    """
    upper, lower, line = middle - root, end - middle, end - root
    a, b = (np.maximum(np.linalg.norm(bone, axis=1), 1e-9) for bone in (upper, lower))
    goal = target - root
    distance = np.linalg.norm(goal, axis=1)
    before, after = _unit(line, upper), _unit(goal, line)
    reach = np.clip(distance, np.abs(a - b) + 1e-6 * (a + b), (a + b) * (1 - 1e-9))
    swing = shortest(before, after)
    cross = np.cross(upper, lower) / (a * b)[:, None]
    flexed = np.linalg.norm(cross, axis=1, keepdims=True)
    # a knee that passes through the straight bends on about the same axis
    about = (cross * hinge).sum(axis=1, keepdims=True)
    sign = np.where((about > 0) | (flexed < _HYPER), about / np.hypot(about, _PASSES), 1.0)
    axis = sign * cross + _HINGE * np.exp(-((flexed / _HINGE) ** 2)) * hinge
    axis -= (axis * before).sum(axis=1, keepdims=True) * before
    axis = _unit(axis, hinge)
    turned = np.einsum("tij,tj->ti", swing, axis)
    cosine = np.clip((a**2 + reach**2 - b**2) / (2 * a * reach), -1.0, 1.0)
    sine = np.sqrt(1 - cosine**2)
    # the upper bone leads the line to the end by the angle at the root
    new_upper = cosine[:, None] * after - sine[:, None] * np.cross(turned, after)
    new_lower = reach[:, None] * after - a[:, None] * new_upper
    return _between(upper, axis, new_upper, turned), _between(lower, axis, new_lower, turned)


def within_reach(roots: Floats, targets: Floats, length: float, stands: NDArray[np.bool_], rate: float) -> Floats:
    """(T, 3) m, the targets, drawn towards the roots (T, 3) of a limb of this length so that it bends and straightens smoothly.

    A limb that comes straight at once makes its middle joint jump: it moves by ten times of what the end does. Ends that stand (T,) keep
    their place to 0.3 mm, those in the air may give way by more.
    """
    away = targets - roots
    distance = np.linalg.norm(away, axis=1)
    firm = smooth_hull(stands.astype(np.float64), rate)
    soft = length * (_GIVES[1] + (_GIVES[0] - _GIVES[1]) * firm)
    limit = STRAIGHT * length
    nearer = limit - soft * np.logaddexp(0.0, (limit - distance) / soft)
    return roots + away * (nearer / np.maximum(distance, 1e-9))[:, None]


def shift_to_reach(hips: Floats, ankles: Floats, reach: Floats, stands: NDArray[np.bool_], rate: float) -> Floats:
    """(T, 3) m, a smooth curve by which the body moves so that the legs that stand reach their feet.

    hips, ankles (T, 2, 3) m; reach (2,) m; stands (T, 2) bool

    The shortest way there is along the legs, found by projecting on the spheres of both feet in turn. Feet further apart than two legs
    reach stay out of reach.
    """

    def needed(shift: Floats) -> Floats:
        start = shift
        for _ in range(_PROJECTIONS):
            for leg in range(2):
                away = hips[:, leg] + shift - ankles[:, leg]
                distance = np.linalg.norm(away, axis=1)
                over = np.where(stands[:, leg], np.maximum(distance - reach[leg], 0.0), 0.0)
                shift = shift - (over / np.maximum(distance, 1e-9))[:, None] * away
        return shift - start

    shift = needed(np.zeros((len(hips), 3)))
    # each direction by itself, so that the curve is nowhere further than the way that is needed near by
    curve = np.stack([smooth_hull(np.maximum(one, 0.0), rate) - smooth_hull(np.maximum(-one, 0.0), rate) for one in shift.T], axis=1)
    return curve + needed(curve)


def shortest(before: Floats, after: Floats) -> Floats:
    """(..., 3, 3) the smallest rotations that take unit vectors (..., 3) to others; of opposite ones, half a turn about any axis across."""
    axis = np.cross(before, after)
    cosine = (before * after).sum(axis=-1)[..., None, None]
    outer = np.einsum("...i,...j->...ij", axis, axis)
    k = np.zeros((*axis.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    k -= k.swapaxes(-1, -2)
    near = np.eye(3) * cosine + k + outer / np.maximum(1 + cosine, 1e-12)
    # across: whichever axis of the room is least along
    other = np.eye(3)[np.abs(before).argmin(axis=-1)]
    other = other - (other * before).sum(axis=-1, keepdims=True) * before
    other /= np.linalg.norm(other, axis=-1, keepdims=True)
    half = 2 * np.einsum("...i,...j->...ij", other, other) - np.eye(3)
    found: Floats = np.where(cosine < -1 + 1e-9, half, near)
    return found


def _unit(vectors: Floats, otherwise: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    usual = otherwise / np.maximum(np.linalg.norm(otherwise, axis=1, keepdims=True), 1e-12)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-12), usual)


def _between(bone: Floats, axis: Floats, new_bone: Floats, new_axis: Floats) -> Floats:
    """(T, 3, 3) the rotation that takes a bone and the axis about which it bends to the new ones."""
    frames = []
    for along, about in ((bone, axis), (new_bone, new_axis)):
        first = _unit(along, about)
        other = np.eye(3)[np.abs(first).argmin(axis=1)]
        # an axis along the bone says nothing of how the limb bends: any axis across will do
        about = np.where(np.linalg.norm(np.cross(about, first), axis=1, keepdims=True) > 1e-6, about, other)
        second = _unit(about - (about * first).sum(axis=1, keepdims=True) * first, other)
        frames.append(np.stack([first, second, np.cross(first, second)], axis=2))
    found: Floats = frames[1] @ frames[0].swapaxes(1, 2)
    return found
