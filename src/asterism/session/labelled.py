"""A labelled file: what was found, and what a person should know of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from asterism.findings import Finding, Severity
from asterism.labelling import MarkerModel, ReviewItem
from asterism.labelling.correction import Correction, FirstLabels
from asterism.labelling.correction.readiness import DO_NOT_USE, Readiness, readiness, to_look_at
from asterism.labelling.recording_labeller import LabelledBodies, RecordingLabeller
from asterism.recording import Clouds, Labelling, MarkerSet, Recording
from asterism.recording.verdict import Verdict
from asterism.session.sources import LabelledCopy
from asterism.session.worn import WornMarkers


@dataclass(frozen=True)
class LabelledFile:
    """A file that was labelled.

    path        the file
    labelling   (T, M) of its clouds, with the names of the file that hold
    marker_set  its names are the labelling's
    found       what was found while the file was read and labelled, without what follows for its use; `findings` has both
    standing    the trial by which the model was narrowed to the person; None where none was used
    file_names  what was done with the names that the points had: "keep", "check", "ignore"; None where they played no part
    models      one for each body, as they were given
    labeller    what labelled it: the models, perhaps narrowed to the person, and the settings
    bodies      what the models alone say; None where the recording was labelled in stretches
    seconds     that labelling took, without reading
    about       the recording as it was read. Of one that is not in memory, a frame that shows each column
    copy        the recording under its labels
    worn        of each body the marker set that was found, or given; empty where a model was given
    """

    path: Path
    labelling: Labelling
    marker_set: MarkerSet
    found: tuple[Finding, ...]
    standing: Path | None
    file_names: str | None
    models: tuple[MarkerModel, ...]
    labeller: RecordingLabeller
    bodies: LabelledBodies | None
    seconds: float
    about: Recording
    copy: LabelledCopy
    worn: tuple[WornMarkers, ...] = ()

    @property
    def verdict(self) -> Verdict | None:
        """Whether the recording shows what the model was trained on; None where it was not judged."""
        return self.labelling.verdict

    @property
    def given(self) -> int:
        """Number of labels in all frames."""
        return int((self.labelling.indices >= 0).sum())

    @property
    def clouds(self) -> Clouds:
        """The points that were labelled. Of a recording that is not in memory, as many points, which are nowhere."""
        return self.copy.clouds

    @property
    def recording(self) -> Recording:
        """The recording under its labels. One that is not in memory is read into it."""
        return self.copy.recording

    @cached_property
    def items(self) -> Sequence[ReviewItem]:
        """All pieces of tracks with doubts, by expected gain. Of a recording that is not in memory, without the points."""
        return self.copy.items()

    @property
    def to_look_at(self) -> list[ReviewItem]:
        """Those of them that a person should look at: as many as `readiness` says."""
        return to_look_at(self.items)

    @cached_property
    def readiness(self) -> Readiness:
        """Whether the labels can be used."""
        return readiness(self.labelling, self.clouds, self.items, self.found)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What a person should know before they use the labels: the same behind every door."""
        # a file without any label has its own finding, which says more
        if self.readiness.kind != DO_NOT_USE or not self.given:
            return self.found
        sentence = f"{self.path}: {100 * self.readiness.error:.0f} % of the labels are expected to be wrong or missing, do not use them."
        # a model has its own marker set
        mend = "Name the marker set that is worn with --markers, or look" if self.worn else "Look"
        mend += " at the labels with `asterism review`"
        # where no model was given, the set that was taken may be the mistake
        mend += ", or name the points once by clicking with `asterism review --serve --by-hand`." if self.worn else "."
        return (*self.found, Finding("label-do-not-use", Severity.WARNING, str(self.path), sentence, mend))

    def correction(self) -> Correction:
        """The labels, to be corrected by a person; of a recording that is in memory."""
        return Correction(self.models, self.about, first=FirstLabels(self.labeller, self.labelling, self.bodies, self.found))

    def corrected(self, correction: Correction, finish: Callable[[Recording], Recording] | None = None) -> LabelledFile:
        """The same file under the labels that a person has corrected; finish: what else is done to it before it is written."""
        # what was found and the verdict stay: they are on what the models said
        return replace(self, labelling=correction.labelling, copy=self.copy.corrected(correction, finish))

    def write(self, target: Path | str, *, program: str | None = None, drop_computed: bool = False) -> list[str]:
        """Write the labelled recording; returns what the file cannot hold.

        program: the one that reads the file next, see `formats.PROGRAMS`; it needs a recording in memory. drop_computed: whether points and
        angles that a model computed are left out. Raises AsterismError where the file cannot be written.
        """
        return self.copy.write(Path(target), program, drop_computed)
