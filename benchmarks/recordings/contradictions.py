"""Hand labels that contradict the same person's standing trial or the body: head and hands whose markers have each other's names."""

from __future__ import annotations

from itertools import combinations, permutations
from pathlib import Path

import numpy as np

from asterism.recording import Ints, Labelling, Recording
from benchmarks.data import file_of, true_names

GROUPS = (
    (("LWRA", "LWRB", "LFIN"), "LELB"),
    (("RWRA", "RWRB", "RFIN"), "RELB"),
    (("LFHD", "RFHD", "LBHD", "RBHD"), "C7"),
)
"""Markers that sit together on one stiff part, and a neighbour that tells their ends apart."""

CLEARLY = 0.03
"""m: so much nearer to the standing trial must other names bring the distances, all added up, and to three fifths at least."""


HEAD = GROUPS[2][0]


BODY = ("LASI", "RASI", "LTOE", "LHEE")
"""Markers that tell the body's left, and where it walks."""


def contradicted(walk: Recording) -> list[str]:
    """Markers of a walk whose names cannot be: by the standing trial beside it, where there is one, and by the body.

    Under other names the markers of a group would keep the distances of the standing trial, and under their own do not; or the head's left
    points to the body's right, or its front to the heels. No labelling and no model takes part in it.
    """
    static = file_of(walk).with_name("static.c3d")
    out = list(HEAD) if _head_turned(walk) else []
    if not Path(static).exists():
        return out
    standing = true_names(static)
    for names, neighbour in GROUPS:
        if not {*names, neighbour} <= {*standing.labels} & {*walk.labels}:
            continue
        wanted = _distances(standing, names, neighbour)
        misses = {order: np.abs(_distances(walk, order, neighbour) - wanted).sum() for order in permutations(names)}
        best, own = min(misses.values()), misses[names]
        if best < 0.6 * own and own - best > CLEARLY:
            out += [name for name in names if name not in out]
    return out


def believable(labelling: Labelling, truth: Ints, walk: Recording) -> tuple[Labelling, Ints]:
    """A labelling and the truth (T, M), of the markers whose hand labels are not `contradicted` alone."""
    kept = np.nonzero(~np.isin(labelling.names, contradicted(walk)))[0]
    names = tuple(np.array(labelling.names)[kept])
    return Labelling(labelling.indices[:, kept], labelling.confidence[:, kept], names), truth[:, kept]


def _head_turned(walk: Recording) -> bool:
    """Whether the head's names have it look backwards, or have its left on the body's right, most of the time."""
    if not {*HEAD, *BODY} <= {*walk.labels}:
        return False
    at = {name: walk.positions[:, walk.labels.index(name)] for name in (*HEAD, *BODY)}
    left, ahead = at["LASI"] - at["RASI"], at["LTOE"] - at["LHEE"]
    head_left = at["LFHD"] + at["LBHD"] - at["RFHD"] - at["RBHD"]
    head_front = at["LFHD"] + at["RFHD"] - at["LBHD"] - at["RBHD"]
    along = (np.einsum("ti,ti->t", one, other) for one, other in ((head_left, left), (head_front, ahead)))
    return any(np.nanmedian(share) < 0 for share in along)


def _distances(recording: Recording, names: tuple[str, ...], neighbour: str) -> np.ndarray:
    """Median distances (m) of all pairs, and of each marker to the neighbour."""
    pairs = [*combinations(names, 2), *((name, neighbour) for name in names)]
    at = {name: recording.positions[:, recording.labels.index(name)] for name in (*names, neighbour)}
    return np.array([np.nanmedian(np.linalg.norm(at[a] - at[b], axis=1)) for a, b in pairs])
