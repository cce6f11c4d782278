"""Events and parameters of a walk in; whether its times can be right, by gravity and the length of the legs, out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from asterism.findings import Finding, Severity
from asterism.gait.events import Walking
from asterism.gait.feet import PELVIS_CUT_OFF, RATE
from asterism.gait.parameters import Parameter, summarise
from asterism.motion.clinical.kinetics import GRAVITY
from asterism.recording.display import significant

_FACTORS = np.array([1 / 4, 1 / 3, 1 / 2.4, 1 / 2, 1.0, 2.0, 2.4, 3.0, 4.0])
"""By which a file's times may be too short: rates of cameras (50, 60, 100, 120, 200, 240 Hz) taken for each other, frames left out."""
_WRONG = 1 / 200
"""How often a rate is wrong before anything is seen, all factors together; a guess. Of 62 recordings of walks and runs none is doubted at
ten times of it either, and 58 of 61 doubled rates are told, 51 with this, 30 with a tenth."""
_SWING, _SWING_SPREAD = 1.34, 0.12
"""Of a swing, in sqrt(leg / g): a leg is a pendulum, and swings alike in walks and runs. 1.23 to 1.66 in walking, slow walking, jogging
and a sprint of 7 m/s of 13 people in `movement` (the logarithm's standard deviation is 0.08). The spread is of the logarithm, with room
for patients; at half, seven more of 61 doubled rates are told, at double, 12 in all."""
_SPEED, _STEP, _GROWTH, _SPEED_SPREAD = 0.40, 0.7, 1.35, 0.25
"""Speed in sqrt(g leg) at a step of 0.7 legs, and the power with which it grows with the step, of the same people; spread of its logarithm.
At half, short quick steps are doubted; at double, 33 of 61 doubled rates are told."""
_FALL, _FALL_SPREAD = 1.15, 0.25
"""g with which a pelvis falls at most (the lowest twentieth) where the feet stand for less than half of the time: who is in the air falls
with gravity. 1.07 to 1.24 in four runs; spread of the logarithm. At half and at double one verdict of 185 changes."""
_GOES = 0.15
"""Of the leg, a median step that is one. At half, squats with feet in place are walks; at double, shuffling steps are none."""
_TAILS = 8.0
"""Degrees of freedom of Student's distribution of each: one odd value alone proves little. At half, 38 of 61 doubled rates are told, at
double 53."""


def rate_finding(file: str, rate: float, walking: Walking, parameters: Sequence[Parameter]) -> Finding | None:
    """A warning where another rate of the recording is likelier than its own; None else, and where nobody goes.

    Three signs count together, by how rare they are: how long a leg of this length swings, how fast somebody goes with steps so long, and
    how fast one falls who runs. Of two legs that swing unlike, the nearer to the usual counts: one may be lame.
    """
    feet, means = walking.feet, dict[str, list[float]]()
    for one in summarise(parameters):
        means.setdefault(one.name, []).append(one.mean)
    swings = [np.median([end - begin for begin, end in own]) for side in feet.sides if (own := walking.swings(side))]
    leg, gravity = feet.leg_length, -float(GRAVITY[2])
    if not swings or "stride length" not in means or leg <= 0:
        return None
    step, speed, stance, cadence = (float(np.mean(means[name])) for name in ("stride length", "walking speed", "stance", "cadence"))
    if step / 2 < _GOES * leg:
        return None
    scaled = np.log(np.array(swings) * np.sqrt(gravity / leg) / _SWING)
    apart = [scaled[:, None] + np.log(_FACTORS)]
    signs = [apart[0][np.abs(apart[0]).argmin(axis=0), np.arange(len(_FACTORS))] / _SWING_SPREAD]
    usual = np.log(_SPEED) + _GROWTH * np.log(step / 2 / leg / _STEP)
    signs.append((np.log(max(speed, 1e-3) / np.sqrt(gravity * leg) / _FACTORS) - usual) / _SPEED_SPREAD)
    if stance < 50.0:
        falls = -np.percentile(np.gradient(np.gradient(feet.pelvis[:, 2])) * RATE**2, 5) / gravity
        # what the filter of the pelvis leaves of a movement with the steps
        falls *= 1.0 + (cadence / 60 / PELVIS_CUT_OFF) ** 4
        signs.append(np.log(max(falls, 1e-3) / _FACTORS**2 / _FALL) / _FALL_SPREAD)
    evidence = sum(-0.5 * (_TAILS + 1) * np.log1p(sign**2 / _TAILS) for sign in signs)
    evidence += np.log(np.where(_FACTORS == 1.0, 1 - _WRONG, _WRONG / (len(_FACTORS) - 1)))
    likely = np.exp(evidence - evidence.max())
    likely /= likely.sum()
    if likely[_FACTORS == 1.0] >= 0.5:
        return None
    factor = float(_FACTORS[np.argmax(np.where(_FACTORS == 1.0, 0.0, likely))])
    swing = min(swings, key=lambda one: abs(np.log(one * np.sqrt(gravity / leg) / _SWING)))
    usual_swing = _SWING * np.sqrt(leg / gravity)
    sentence = (
        f"{file}: by its rate of {significant(rate, 4)} Hz a foot swings for {significant(swing, 2)} s, at {cadence:.0f} steps/min and "
        f"{significant(speed, 2)} m/s; legs of {significant(leg, 2)} m swing for about {significant(usual_swing, 2)} s, walking and "
        f"running alike. The times are likely to be about {significant(max(factor, 1 / factor), 2)} times too "
        f"{'short' if factor > 1 else 'long'}, and speeds, moments and powers wrong with them."
    )
    mend = f"Compare the rate with the cameras' (about {significant(rate / factor, 2)} Hz would be usual), and export the file again."
    return Finding("gait-rate-doubtful", Severity.WARNING, file, sentence, mend)
