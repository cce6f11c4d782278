"""Marker sets that may be worn in; which of them a model of virtual people finds in a few frames, in nats, out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from asterism.labelling import MarkerModel
from asterism.recording import Clouds
from asterism.session.worn.fit import FitRules, number_of_extras


@dataclass(frozen=True)
class CompareRules:
    """How labelled frames speak for a set. Chosen on the recordings of `movement`.

    frames     that each candidate's model labels, in one piece
    explained  log density (nats per m3) of a point that is labelled, with an own standard deviation of 3 cm
    rigid      distances within segments that are independent: each tells by its own how near it is to those of people. At half, medial
               markers that are not there are believed; at double, one marker placed elsewhere refuses the set
    """

    frames: int = 60
    explained: float = 7.0
    rigid: float = 20.0


def compare(
    clouds: Clouds, names: Iterable[str], model_of: Callable[[str], MarkerModel], rules: CompareRules | None = None
) -> dict[str, float]:
    """The evidence of each candidate: differences are log odds."""
    rules, fit = rules or CompareRules(), FitRules()
    counts = np.asarray(clouds.counts)
    # where most points are seen, a set shows most of itself
    sums = np.convolve(counts, np.ones(min(rules.frames, len(counts))), "valid")
    begin = int(sums.argmax())
    part = clouds.frames(slice(begin, begin + rules.frames))
    found = {}
    for name in names:
        model = model_of(name)
        labelling = model.label(part)
        given = labelling.indices >= 0
        labelled = float(np.nansum(np.where(given, labelling.confidence, 0.0))) / max(1, len(part))
        points, markers = float(np.mean(part.counts)), len(model.marker_set)
        extra = max(0.0, points - labelled)
        nats = rules.explained * labelled + fit.extra * extra + number_of_extras(extra) + fit.missing * (markers - labelled)
        verdict = labelling.verdict
        # a recording that is of no body of this set has distances of any length
        scatter = 1.0 if verdict is None or math.isnan(verdict.scatter) else max(verdict.scatter, _LEAST_SCATTER)
        found[name] = nats - rules.rigid * math.log(scatter)
    return found


_LEAST_SCATTER = 0.02
"""Below it people differ anyhow: 2 % of a distance."""
