"""How well a labelled recording fits the model that labelled it, and what follows for its labels."""

from __future__ import annotations

from dataclasses import dataclass

from asterism.findings import Finding, Severity

FITS, OTHER_PERSON, OTHER_MARKERS, OTHER_BODY = "fits", "other person or movement", "other marker set", "other body"

_SAID = {
    OTHER_PERSON: "the person, the places of the markers or the movement is not like what the model was trained on",
    OTHER_MARKERS: "the markers are not those of the model: some of its markers are not worn, or many others are",
    OTHER_BODY: "this is no body that the model knows; no label was given",
}
_MEND = {
    OTHER_PERSON: "Check the labels with `asterism review`, and teach them to the model with `asterism learn`.",
    OTHER_MARKERS: "Train a model on recordings with these markers, or check the labels with `asterism review`.",
    OTHER_BODY: "Label with a model of such bodies, and check the unit of length and the vertical.",
}


@dataclass(frozen=True)
class Verdict:
    """Whether a recording shows what its model was trained on.

    kind          "fits", "other person or movement", "other marker set" or "other body"
    scatter       how far the near-rigid distances between labelled markers are off the training's, as a share of a distance: robust
                  standard deviation of the log ratio, sizes of bodies set aside; NaN where too few can be compared
    limit         the largest scatter that fits
    size          size of the body as a multiple of the training's; NaN as above
    labelled      share of the points that could be markers to which a label was found, accepted or not
    surplus       points of a usual frame to which none was found
    exchangeable  groups of markers, each of which may carry another's label throughout
    rough         number of pieces of tracks whose labels compete in too many ways to compare all; theirs are the best that were found
    """

    kind: str
    scatter: float
    limit: float
    size: float
    labelled: float
    surplus: float
    exchangeable: tuple[tuple[str, ...], ...] = ()
    rough: int = 0

    @property
    def fits(self) -> bool:
        """Whether the recording shows what the model was trained on."""
        return self.kind == FITS

    def findings(self, where: str = "the recording") -> list[Finding]:
        """What a person should know before they use the labels; empty where the recording fits. where: the file."""
        found = []
        if not self.fits:
            # Where no body is known, no label was given: that is no warning.
            severity = Severity.ERROR if self.kind == OTHER_BODY else Severity.WARNING
            found.append(Finding("label-foreign-recording", severity, where, f"{where}: {_SAID[self.kind]}.", _MEND[self.kind]))
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
