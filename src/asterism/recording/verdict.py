"""How well a labelled recording fits the model that labelled it, and what follows for its labels."""

from __future__ import annotations

from dataclasses import dataclass, replace

from asterism.findings import Finding, Severity

FITS, UNKNOWN, OTHER_PERSON, OTHER_MARKERS, OTHER_BODY = "fits", "unknown", "other person or movement", "other marker set", "other body"

CERTAIN = 0.9899
"""No label of what does not fit is more certain: below the 0.99 that promises one wrong label of a hundred."""

_SAID = {
    UNKNOWN: "too few markers are labelled at once to tell whether this is a body that the model knows",
    OTHER_PERSON: "the person, the places of the markers or the movement is not like what the model was trained on",
    OTHER_MARKERS: "the markers are not those of the model: some of its markers are not worn, or many others are",
    OTHER_BODY: "this is no body that the model knows; no label was given",
}
_NEW = {
    UNKNOWN: "too few markers are labelled at once to tell whether the model knows this body",
    OTHER_PERSON: "this body, or its movement, is new to the model",
    OTHER_MARKERS: "some markers of the model are not worn, or many others are",
    OTHER_BODY: "the model knows no such body",
}
_SAID_OF_LABELS = "this is no body that the model knows; the labels given are not to be used"
_MEND = {
    UNKNOWN: "Check the labels with `asterism review`; a recording that shows more of the body at once tells it.",
    OTHER_PERSON: "Check the labels with `asterism review`, and teach them to the model with `asterism learn`.",
    OTHER_MARKERS: "Train a model on recordings with these markers, or check the labels with `asterism review`.",
    OTHER_BODY: "Label with a model of such bodies, and check the unit of length and the vertical.",
}


@dataclass(frozen=True)
class Verdict:
    """Whether a recording shows what its model was trained on.

    kind          "fits", "other person or movement", "other marker set" or "other body"; "unknown" where too little of a body is labelled
                  to tell it
    scatter       how far the near-rigid distances between labelled markers are off the training's, as a share of a distance: robust
                  standard deviation of the log ratio, sizes of bodies set aside; NaN where too few can be compared
    limit         the largest scatter that fits
    size          size of the body as a multiple of the training's; NaN as above
    labelled      share of the points that could be markers to which a label was found, accepted or not, where most of the body is shown
    surplus       points of a usual one of these frames to which none was found
    exchangeable  groups of markers, each of which may carry another's label throughout
    rough         number of pieces of tracks whose labels compete in too many ways to compare all; theirs are the best that were found
    body          what it is called where the recording has several
    """

    kind: str
    scatter: float
    limit: float
    size: float
    labelled: float
    surplus: float
    exchangeable: tuple[tuple[str, ...], ...] = ()
    rough: int = 0
    body: str = ""

    @property
    def fits(self) -> bool:
        """Whether the recording shows what the model was trained on."""
        return self.kind == FITS

    @property
    def max_confidence(self) -> float:
        """What no label may be more certain than: 1 where the recording fits, below 0.99 where it does not or nothing tells it."""
        if self.fits:
            return 1.0
        return 0.5 if self.kind == OTHER_BODY else CERTAIN

    @property
    def limited_by(self) -> str | None:
        """Why no label may be more certain than `max_confidence`, in words; None where any may be."""
        return None if self.fits else _NEW[self.kind]

    def without_labels(self) -> Verdict:
        """The verdict where no label was given: nothing then says that the recording fits."""
        return replace(self, kind=UNKNOWN) if self.fits else self

    def findings(self, where: str = "the recording", *, labels: bool = True) -> list[Finding]:
        """What a person should know before they use the labels; empty where the recording fits. where: the file.

        labels: whether any label was given.
        """
        found = []
        # Without a label there is nothing that could be of an unknown body.
        if not self.fits and (labels or self.kind != UNKNOWN):
            # Where no body is known, no label was given: that is no warning.
            severity = Severity.ERROR if self.kind == OTHER_BODY else Severity.WARNING
            # Of several bodies, the labels are those of the others.
            said = _SAID_OF_LABELS if self.kind == OTHER_BODY and labels and not self.body else _SAID[self.kind]
            whose = f"{where}, body {self.body}" if self.body else where
            found.append(Finding("label-foreign-recording", severity, where, f"{whose}: {said}.", _MEND[self.kind]))
        for group in self.exchangeable:
            names = f"{', '.join(group[:-1])} and {group[-1]}"
            mend = "Compare them with the person or a picture, and correct them with `asterism review`."
            sentence = f"{where}: {names} may be exchanged throughout."
            found.append(Finding("label-exchangeable", Severity.WARNING, where, sentence, mend))
        # Without a label nothing competes.
        if self.rough and self.kind != OTHER_BODY:
            sentence = (
                f"{where}: {self.rough} pieces of tracks compete for markers in too many ways to compare all; the best labels found count."
            )
            mend = "Check them with `asterism review`; fewer gaps and ghosts leave fewer pieces."
            found.append(Finding("label-rough", Severity.WARNING, where, sentence, mend))
        return found
