"""The pelvis' landmarks and a person's measures in; hip joint centres by published regressions out."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.clinical.measures import SIDES, SubjectMeasures
from asterism.motion.joints.anatomy import HIP_SHARES
from asterism.recording import Floats
from asterism.recording.arrays import nan_median

REGRESSIONS = {"davis": "Davis et al. (1991)", "bell": "Bell et al. (1990)", "harrington": "Harrington et al. (2007)"}


def regression_of(measures: SubjectMeasures, davis: bool = True) -> str:
    """The regression that counts: the one asked for; else Davis', where the model takes it and a leg's length is known; else Bell's."""
    known = any(measures.of(side).leg_length is not None for side in SIDES)
    return measures.hip_regression or ("davis" if davis and known else "bell")


def hip_centre(measures: SubjectMeasures, side: str, left: Floats, right: Floats, sacrum: Floats, davis: bool = True) -> Floats:
    """(3,) m: the hip joint centre of side "L" or "R" from midway between the anterior iliac spines; x ahead, y left, z up the pelvis.

    left, right, sacrum  (T, 3) m, the spines and the sacrum or the middle of the posterior spines; one size of the pelvis for the recording
    davis                whether the model takes Davis' regression by itself

    Davis et al. (1991), of 25 hips, needs a leg's length: 28.6 and 18 degrees are the angles of their regression. Bell et al. (1990) takes
    shares of the distance between the spines. Harrington et al. (2007) of 32 adults and children, their equations of one measure each: a
    share of the pelvis' depth and of the same distance. Raises AsterismError where Davis' is asked for and no leg's length is known.
    """
    between = measures.inter_asis or float(nan_median(np.linalg.norm(left - right, axis=1), axis=0))
    regression = regression_of(measures, davis)
    if regression == "davis":
        ahead, out, up = _davis(measures, side, {one: measures.of(one).leg_length for one in SIDES}, between)
    elif regression == "bell":
        ahead, out, up = HIP_SHARES[0] * between, (0.5 - HIP_SHARES[2]) * between, HIP_SHARES[1] * between
    else:
        depth = measures.pelvis_depth or float(nan_median(np.linalg.norm((left + right) / 2 - sacrum, axis=1), axis=0))
        ahead, out, up = -0.24 * depth - 0.0099, 0.33 * between + 0.0073, -0.30 * between - 0.0109
    return np.array([ahead, out if side == "L" else -out, up])


def _davis(measures: SubjectMeasures, side: str, lengths: Mapping[str, float | None], between: float) -> tuple[float, float, float]:
    known = [length for length in lengths.values() if length is not None]
    if not known:
        raise AsterismError(
            "the hip centre of Davis et al. needs the length of a leg; give --measure LLegLength=MM, or another regression."
        )
    own = measures.of(side)
    trochanter = own.asis_trochanter if own.asis_trochanter is not None else 0.1288 * (lengths[side] or known[0]) - 0.04856
    constant, theta, beta = 0.115 * sum(known) / len(known) - 0.0153, 0.5, 0.314
    back = -trochanter - measures.marker_radius
    ahead = back * math.cos(beta) + constant * math.cos(theta) * math.sin(beta)
    up = back * math.sin(beta) - constant * math.cos(theta) * math.cos(beta)
    return ahead, between / 2 - constant * math.sin(theta), up
