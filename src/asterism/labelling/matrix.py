"""The labelling matrix (thesis 4.5.4): clouds and partial solvers in; labels by its safe rules, votes and the work done out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism.labelling import _kernels
from asterism.labelling.features import upright
from asterism.labelling.mining import BUDGET, PartialSolvers
from asterism.labelling.solver import share_pairs
from asterism.recording import Clouds, Floats, Ints


class Votes(NamedTuple):
    """What an ensemble says of each frame.

    indices      (T, M) candidate of each marker, -1 for none
    votes        (T, M) of the solvers trusted with a marker the share that proposes the candidate (for a null, the most proposed one)
    evaluations  (T,) feature evaluations
    """

    indices: Ints
    votes: Floats
    evaluations: Ints


def label_by_matrix(clouds: Clouds, ensemble: PartialSolvers, budget: int = BUDGET) -> Votes:
    """Label each frame by the proposals of all solvers.

    A marker gets the candidate on which all proposals for it agree; none where there is no proposal, where two candidates are proposed, or
    where the candidate is proposed for another marker too. `budget` is in feature evaluations per frame and solver: a solver that exhausts it
    proposes nothing, the same on every machine.
    """
    xyz = np.ascontiguousarray(upright(clouds.xyz, clouds.vertical))
    frames, markers = len(clouds), len(ensemble.targets)
    indices, votes = np.empty((frames, markers), dtype=np.int64), np.empty((frames, markers))
    evaluations = np.empty(frames, dtype=np.int64)
    solvers, pairs = share_pairs(ensemble.solvers, markers)
    _kernels.label_by_matrix(solvers, pairs, ensemble.trusted, xyz, clouds.offsets, budget, indices, votes, evaluations)
    return Votes(indices, votes, evaluations)
