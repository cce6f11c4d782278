"""Hand labels that contradict the same person's standing trial: head and hands whose markers changed names between two files."""

from __future__ import annotations

from itertools import combinations, permutations
from pathlib import Path

import numpy as np

import asterism
from asterism.recording import Recording
from benchmarks.data import file_of

GROUPS = (
    (("LWRA", "LWRB", "LFIN"), "LELB"),
    (("RWRA", "RWRB", "RFIN"), "RELB"),
    (("LFHD", "RFHD", "LBHD", "RBHD"), "C7"),
)
"""Markers that sit together on one stiff part, and a neighbour that tells their ends apart."""

CLEARLY = 0.03
"""m: so much nearer to the standing trial must other names bring the distances, all added up, and to three fifths at least."""


def contradicted(walk: Recording) -> list[str]:
    """Markers of a walk that under other names would keep the distances of the standing trial beside it, and under their own do not.

    None where there is no standing trial. No labelling and no model takes part in it.
    """
    static = file_of(walk).with_name("static.c3d")
    if not Path(static).exists():
        return []
    standing, out = asterism.read(static), []
    for names, neighbour in GROUPS:
        if not {*names, neighbour} <= {*standing.labels} & {*walk.labels}:
            continue
        wanted = _distances(standing, names, neighbour)
        misses = {order: np.abs(_distances(walk, order, neighbour) - wanted).sum() for order in permutations(names)}
        best, own = min(misses.values()), misses[names]
        if best < 0.6 * own and own - best > CLEARLY:
            out += names
    return out


def _distances(recording: Recording, names: tuple[str, ...], neighbour: str) -> np.ndarray:
    """Median distances (m) of all pairs, and of each marker to the neighbour."""
    pairs = [*combinations(names, 2), *((name, neighbour) for name in names)]
    at = {name: recording.positions[:, recording.labels.index(name)] for name in (*names, neighbour)}
    return np.array([np.nanmedian(np.linalg.norm(at[a] - at[b], axis=1)) for a, b in pairs])
