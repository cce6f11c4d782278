"""A body model in; the ways in which a body resembles itself turned round, mirrored, or in part, out: permutations of its markers.

A body that is labelled turned round has every marker near another one's place: left for right, heel for toe. Exchanging two markers at a
time never leads from there to the truth, as each single exchange is worse. So what is found is held against its twins as a whole:

    mirrored    left for right
    turned      by half a turn about the vertical, each marker with the one that then lies nearest; also with the pelvis left open, which
                may be turned by a third, and with the feet
    flipped     front for back, as mirrored and turned at once
    in part     both arms, both legs, both feet mirrored, and all that they leave; a rigid group such as a plate or the pelvis turned

What belongs to a limb follows from the training: its markers keep their distances, so that the tree of the steadiest distances is the
skeleton, and what is cut off by taking one of its edges away is a part.
"""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from asterism.geometry import align_about_z, fit_rigid
from asterism.labelling.body.model import BodyModel, distance_variance
from asterism.recording import NULL, Floats, Ints

MAX_TWINS = 40
"""Twins of a body at most: bounds the time of a frame. 15 markers have 13, 59 have 38. Not tuned."""

RIGID_STD = 0.015
"""m; markers belong to one rigid group where their distances vary by less, of a body as large as a person. At 0.0075 a pelvis is none, at
0.03 shank and foot are one group, whose turns are no twins."""

SAME_SHAPE = 0.5
"""A turned group is a twin where its markers come to lie within this share of its radius of one another's places. At 1 every
permutation is one, at 0.25 not even a third of a turn of a pelvis is."""

BESIDE = 3
"""Markers beside each one among which all permutations are looked at: with them a plate of four, a hand, a foot and its shank. Their number
grows with the factorial: at 2 a head of four markers cannot be turned, at 6 a marker has 5,000 permutations."""

STEPS = 36
"""Headings of the plane of symmetry that are tried: every 5 degrees."""


def twins_of(model: BodyModel, unit: float = 1.0) -> Ints:
    """The twins of a body: (W, M), for each marker the one whose point it has in the twin, -1 where the other labels tell.

    Each differs from the body in three markers or more. unit: `length_scale` of the body. O(M^3) a heading.
    """
    mean, steady = _mean_body(model), _distance_std(model)
    mirrored = mirror_twin(mean)
    turned = _matched(mean, mean * np.array([-1.0, -1.0, 1.0]))
    groups = _rigid_groups(steady, RIGID_STD * unit)
    central = np.zeros(len(mean), dtype=np.bool_)
    for group in groups:
        inside = np.isin(mirrored[group], group)
        central[group[inside]] |= inside.sum() >= 3
    # a pelvis of three markers has no half turn of its own: with the body turned it is mirrored, turned by a third, or left open
    found = [mirrored, turned, mirrored[turned], np.where(central, mirrored, turned), np.where(central, NULL, turned)]
    # where turning and mirroring do not agree, as in feet, the other labels may tell better
    found.append(np.where(central | (turned != mirrored), NULL, turned))
    for part in (*_parts(steady, mirrored), *_neighbours(steady, mirrored)):
        found.append(np.where(part, mirrored, np.arange(len(mean))))
    for group in groups:
        found += _group_turns(mean, group)
    return _different(found, len(mean))


def neighbours_of(model: BodyModel) -> Ints:
    """Each marker and the `BESIDE` whose distances to it are the steadiest, each group once: (G, BESIDE + 1), or all of fewer markers."""
    steady = _distance_std(model)
    np.fill_diagonal(steady, -1.0)
    groups = {tuple(sorted(near[: BESIDE + 1])) for near in np.argsort(steady, axis=1, kind="stable").tolist()}
    return np.array(sorted(groups), dtype=np.int64)


def mirror_twin(mean: Floats) -> Ints:
    """The counterpart of each marker of a body (M, 3) m, centred, on the other side, itself on the middle: (M,)."""
    best, found = np.inf, np.arange(len(mean))
    for angle in np.pi * np.arange(STEPS) / STEPS:
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        reflected = mean - 2.0 * (mean @ normal)[:, None] * normal
        counterpart, cost = _assigned(mean, reflected)
        if cost < best:
            best, found = cost, counterpart
    # a pair is a pair both ways; whatever is not has no counterpart
    return np.where(found[found] == np.arange(len(mean)), found, np.arange(len(mean)))


def _assigned(mean: Floats, moved: Floats) -> tuple[Ints, float]:
    """The moved marker next to each marker's place, each once, by least squares: (M,); and the sum of squares."""
    apart = ((mean[:, None] - moved[None]) ** 2).sum(axis=2)
    row, column = linear_sum_assignment(apart)
    return column.astype(np.int64), float(apart[row, column].sum())


def _matched(mean: Floats, moved: Floats) -> Ints:
    """`_assigned`, once the moved body has been shifted to where it matches."""
    for _ in range(3):
        nearest, _ = _assigned(mean, moved)
        moved = moved + (mean - moved[nearest]).mean(axis=0)
    return nearest


def _mean_body(model: BodyModel) -> Floats:
    """The mean of all key poses (M, 3) m, centred: a pose of half a stride is no body's mirror image, but their mean nearly is."""
    weight = np.exp(model.log_weight)
    placed = align_about_z(model.mean, model.mean[int(np.argmax(weight))])
    mean = np.einsum("k,kma->ma", weight / weight.sum(), placed)
    return np.asarray(mean - mean.mean(axis=0))


def _distance_std(model: BodyModel) -> Floats:
    """(M, M) m, how much the distance of each two markers varies as a person moves: in a key pose, and from one to the other."""
    weight = np.exp(model.log_weight) / np.exp(model.log_weight).sum()
    covariance = np.stack([model.covariance(k) for k in range(len(model.mean))]) if model.within is None else model.within
    distances = np.linalg.norm(model.mean[:, :, None] - model.mean[:, None], axis=3)
    variance = np.einsum("k,kij->ij", weight, distance_variance(model.mean, covariance))
    # what even the steadiest distance has is what was added for people and movements that the training lacks
    variance -= variance[np.triu_indices(len(variance), 1)].min()
    middle = np.einsum("k,kij->ij", weight, distances)
    return np.sqrt(np.maximum(variance + np.einsum("k,kij->ij", weight, (distances - middle) ** 2), 0.0))


def _parts(steady: Floats, mirrored: Ints) -> list[np.ndarray]:
    """Parts of the body (M,) that have both sides, two pairs of markers or more: what each edge of the skeleton cuts off, on both sides."""
    markers, found = len(steady), []
    tree = minimum_spanning_tree(steady + 1e-6).toarray() > 0.0
    tree |= tree.T
    for one, other in zip(*np.nonzero(np.triu(tree)), strict=True):
        cut = tree.copy()
        cut[one, other] = cut[other, one] = False
        for root in (one, other):
            beyond = np.zeros(markers, dtype=np.bool_)
            beyond[breadth_first_order(cut, root, directed=False, return_predecessors=False)] = True
            part = beyond | beyond[mirrored]
            if (mirrored[part] != np.nonzero(part)[0]).sum() >= 4 and not part.all():
                found.append(part)
    return found


def _neighbours(steady: Floats, mirrored: Ints) -> list[np.ndarray]:
    """Each marker that has a counterpart, with the steadiest one beside it that has one, too, on both sides: heels and toes. (M,) each."""
    sided, found = mirrored != np.arange(len(mirrored)), []
    for marker in np.nonzero(sided)[0]:
        beside = np.where(sided, steady[marker], np.inf)
        beside[[marker, mirrored[marker]]] = np.inf
        if np.isfinite(beside).any():
            part = np.zeros(len(mirrored), dtype=np.bool_)
            part[[marker, mirrored[marker], beside.argmin(), mirrored[beside.argmin()]]] = True
            found.append(part)
    return found


def _rigid_groups(steady: Floats, most: float) -> list[Ints]:
    """Groups of three or four markers whose distances are all steady, each marker in one, the steadiest first."""
    free, groups = np.ones(len(steady), dtype=np.bool_), []
    triples = sorted((float(max(steady[a, b], steady[a, c], steady[b, c])), (a, b, c)) for a, b, c in combinations(range(len(steady)), 3))
    for std, triple in triples:
        if std >= most:
            break
        members = list(triple)
        if not free[members].all():
            continue
        fourth = np.where(free, steady[members].max(axis=0), np.inf)
        fourth[members] = np.inf
        if fourth.min() < most:
            members.append(int(fourth.argmin()))
        free[members] = False
        groups.append(np.array(members))
    return groups


def _group_turns(mean: Floats, group: Ints) -> list[Ints]:
    """The turns of a rigid group onto itself, as permutations of all markers (M,); the two likeliest of those that move three or more."""
    own = mean[group]
    radius = np.sqrt(((own - own.mean(axis=0)) ** 2).sum(axis=1).mean())
    turns = []
    for order in permutations(range(len(group))):
        if sum(place != i for i, place in enumerate(order)) >= 3:
            rotation, shift = fit_rigid(own[list(order)], own)
            left = np.sqrt(((own[list(order)] @ rotation.T + shift - own) ** 2).sum(axis=1).mean())
            if left < SAME_SHAPE * radius:
                turns.append((float(left), order))
    found = []
    for _, order in sorted(turns)[:2]:
        permutation = np.arange(len(mean))
        permutation[group] = group[list(order)]
        found.append(permutation)
    return found


def _once_each(twin: Ints) -> Ints:
    """The twin (M,), in which no marker's point is given twice: what two markers claim is left open for both."""
    claims = np.bincount(twin[twin != NULL], minlength=len(twin))
    return np.where((twin != NULL) & (claims[twin] > 1), NULL, twin)


def _different(found: list[Ints], markers: int) -> Ints:
    """The first of each twin, those that move three markers or more, `MAX_TWINS` at most: (W, M)."""
    kept = {twin.tobytes(): twin for twin in map(_once_each, found) if (twin != np.arange(markers)).sum() >= 3}
    return np.array(list(kept.values())[:MAX_TWINS], dtype=np.int64).reshape(-1, markers)
