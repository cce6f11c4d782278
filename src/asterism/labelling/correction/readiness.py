"""A labelling and what is left to check in it; whether the recording can be used, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.findings import Finding
from asterism.labelling.review import ReviewItem
from asterism.recording import Clouds, Labelling
from asterism.recording.shares import SURE
from asterism.recording.verdict import OTHER_BODY, OTHER_PERSON

READY, LOOK, DO_NOT_USE = "ready", "look", "do-not-use"

DOUBTS = {
    "label-mirrored": "left and right may be exchanged; look which side a picture shows",
    "label-vertical": "the file says another vertical than its points; look which way is up",
    "format-vertical-conflict": "the file says another vertical than its points; look which way is up",
    "format-units-doubtful": "the unit of length is in doubt; compare a length that you know",
    "format-units-unknown": "the unit of length is not known; compare a length that you know",
    "format-header-doubt": "parts of the file contradict each other; look at the recording",
    "label-set-unsure": "another marker set may be worn; name it with --markers",
    "label-few-markers": "fewer than half of the set's markers have a label; name the set that is worn with --markers",
    "label-other-set": "markers of the set are nowhere, and as many points have no label; name the set that is worn with --markers",
    "label-left-over": "markers of the set are nowhere, and as many points have no label; label what is missing",
    "label-coincident": "markers are there twice; export each once",
    "label-rough": "not all ways to name the pieces of tracks were compared; compare some names with the person",
    "label-names-differ": "names of the file contradict the labels; compare them with the person",
    "label-few-frames": "the posture alone gave the labels; compare them with the person, or label the whole recording",
}
"""Findings that put all labels of a recording in doubt, in the order in which one is said: why, and what to do. What `Verdict` holds is
not among them. No label need be doubtful by itself: the labels agree with each other under a wrong axis, set or side, too."""


@dataclass(frozen=True)
class ReadinessRules:
    """When a labelled recording is ready, and when it should not be used.

    least_gain     samples that a piece must gain to be worth a look
    least_error    and mean chance that a label of it is wrong or missing; a model of few people gives no confidence above 0.99
    max_error      share of wrong or missing labels to be expected from which a recording should not be used. By hand: above it, naming the
                   tracks one by one is as quick as looking for the errors
    least_sure     share of the labels that have a confidence of 99 % or more in what is ready: most. In a short recording, pieces with
                   less gain too few samples to be worth a look each. At half of it, a recording of two tracks is ready by one of them; at
                   twice, no recording with a doubtful label is ready
    """

    least_gain: float = 1.0
    least_error: float = 0.02
    max_error: float = 0.3
    least_sure: float = 0.5


_RULES = ReadinessRules()


@dataclass(frozen=True)
class Readiness:
    """Whether a labelled recording can be used.

    kind      "ready", "look" (at some pieces, or once at the whole) or "do-not-use"
    look_at   number of pieces to look at
    error     share of the markers' samples whose label is expected to be wrong or missing
    why       the reason, and what to do then; empty where the pieces are all there is to say
    """

    kind: str
    look_at: int
    error: float
    why: str = ""

    @property
    def words(self) -> str:
        """For a column of a table: "ready", "look at 3", "look once" or "do not use"."""
        if self.kind == LOOK:
            return f"look at {self.look_at}" if self.look_at else "look once"
        return "ready" if self.kind == READY else "do not use"

    @property
    def sentence(self) -> str:
        """What a person should know, in one sentence."""
        if self.kind == READY:
            return "Ready: no label needs a look."
        pieces = f" piece{'s' if self.look_at > 1 else ''} of tracks" if self.kind == LOOK and self.look_at else ""
        return f"{self.words.capitalize()}{pieces}{': ' if self.why else ''}{self.why}."


def to_look_at(items: Sequence[ReviewItem], rules: ReadinessRules = _RULES) -> list[ReviewItem]:
    """The items that are worth a look, in their order."""
    return [item for item in items if item.gain >= rules.least_gain and item.gain >= rules.least_error * item.samples]


def readiness(
    labelling: Labelling, clouds: Clouds, items: Sequence[ReviewItem], found: Sequence[Finding] = (), rules: ReadinessRules = _RULES
) -> Readiness:
    """Whether a labelling can be used.

    items: what `review` lists in it, without what a person has answered; found: what was found while the file was read and labelled.
    Where a recording does not fit its model, every point that could be a marker and has no label counts as missing.
    """
    # No frame can show more markers than the set has, nor more than its points.
    visible = int(np.minimum(clouds.counts, len(labelling.names)).sum())
    error = min(1.0, sum(item.gain for item in items) / max(visible, 1))
    look_at = len(to_look_at(items, rules))
    verdict, given = labelling.verdict, int((labelling.indices >= 0).sum())
    if verdict is not None and not verdict.fits:
        # A recording that does not fit hides its errors: points without a label count as missing.
        unanswered = sum(item.samples for item in items if item.marker is None)
        error = max(error, min(unanswered, visible - given) / max(visible, 1))

    def judged(kind: str, why: str = "") -> Readiness:
        return Readiness(kind, look_at, error, why)

    # Nothing was labelled, so that there are no labels whose errors could be counted.
    if not given:
        unknown = "this is no body that the model knows, and " if verdict is not None and verdict.kind == OTHER_BODY else ""
        return judged(DO_NOT_USE, f"{unknown}no label was given")
    if error > rules.max_error:
        return judged(DO_NOT_USE, f"{100 * error:.0f} % of the labels are expected to be wrong or missing")
    # What concerns the whole recording shows no error in any single label.
    if labelling.bodies > 1:
        return judged(LOOK, "a second person wears the model's markers and has no label; give the model once for each")
    if verdict is not None and verdict.exchangeable:
        names = "; ".join(f"{', '.join(group[:-1])} and {group[-1]}" for group in verdict.exchangeable)
        return judged(LOOK, f"{names} may be exchanged throughout")
    # What a person has confirmed is sure, whatever the model knows.
    confidence = labelling.confidence[labelling.indices >= 0]
    doubts = {finding.code for finding in found} & DOUBTS.keys()
    if doubts and (confidence < 1.0).any():
        return judged(LOOK, next(why for code, why in DOUBTS.items() if code in doubts))
    if verdict is not None and not verdict.fits and (confidence < SURE).any():
        # No piece stands out, so that one look at the whole is enough.
        agree = "" if look_at else "the labels agree with each other, but "
        teach = "; then teach them with `asterism learn`" if verdict.kind == OTHER_PERSON else ""
        whose, what = (f"of body {verdict.body}, ", "its") if verdict.body else ("", "the model's")
        limit = f"none of {what} labels is above {100 * verdict.max_confidence:.2f} %"
        return judged(LOOK, f"{whose}{agree}{verdict.limited_by}, so that {limit}{teach}")
    # What a model says that knows no more than the votes of its solvers, or was written by an earlier version.
    if verdict is None and (confidence < 1.0).any():
        return judged(LOOK, "this model does not tell whether it knows the body; compare some names with the person")
    # A name of the file that was kept has no confidence, and no doubt.
    sure = 1.0 - float((confidence < SURE).mean())
    if sure < rules.least_sure:
        few = f"{100 * sure:.0f} % of the labels have" if sure else "no label has"
        return judged(LOOK, f"{few} a confidence of 99 % or more; compare some with the person")
    return judged(LOOK if look_at else READY)
