"""Wrong labels: the recording, its frames and markers, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from asterism.findings import Finding, Severity

EXCHANGED = "exchanged"
ALWAYS = "consistently exchanged against the others"
JUMP = "jump"
MISPLACED = "misplaced"
DIFFERENT = "named differently in another recording"
NAMED_OTHERWISE = "named otherwise than virtual people"


@dataclass(frozen=True)
class LabelError:
    """Wrong labels of a recording.

    recording    its place among those given
    file         its file, or "recording 3" where it came from none
    subject      who moves in it
    first_frame  first frame concerned, counted from 0
    last_frame   last frame concerned
    markers      markers concerned
    kind         "exchanged": their points carry each other's names in these frames, as their paths show, the body, or both;
                 "consistently exchanged against the others": in all recordings of this person, as other people's bodies show;
                 "jump": the label leaves its marker's path and comes back;
                 "misplaced": the markers are throughout where nobody else wears them. A hint: they may have been worn so
                 "named differently in another recording": laid on the same person's other recording, a stiff part fits under other names
                 only. A hint: one of the two is wrong, and nothing says which
                 "named otherwise than virtual people": exchanged in the whole recording, by where the marker set says that markers sit.
                 A hint: they may have been worn so
    gain         nats by which the corrected labels explain the frames better
    description  a sentence for people
    """

    recording: int
    file: str
    subject: str
    first_frame: int
    last_frame: int
    markers: tuple[str, ...]
    kind: str
    gain: float
    description: str

    @property
    def damage(self) -> bool:
        """Whether training should leave out these samples; it keeps those of a hint."""
        return self.kind not in (MISPLACED, DIFFERENT, NAMED_OTHERWISE)

    @property
    def finding(self) -> Finding:
        """The error as a finding."""
        where = f"{self.file}, frames {self.first_frame} to {self.last_frame}"
        sentence = f"{where}: {self.description}."
        if self.kind == EXCHANGED:
            return Finding("audit-exchanged", Severity.WARNING, where, sentence, "Exchange the labels back in these frames.")
        if self.kind == ALWAYS:
            return Finding("audit-always-exchanged", Severity.WARNING, where, sentence, "Exchange the labels in all trials of the person.")
        if self.kind == JUMP:
            return Finding("audit-jump", Severity.WARNING, where, sentence, "Remove the label in these frames.")
        if self.kind == DIFFERENT:
            return Finding(
                "audit-different",
                Severity.WARNING,
                where,
                sentence,
                "Look which of the recordings is right, and exchange the labels in the other.",
            )
        if self.kind == NAMED_OTHERWISE:
            mend = "Look at them, and exchange the labels; or name the set that is worn with --markers."
            return Finding("audit-names-differ", Severity.WARNING, where, sentence, mend)
        return Finding("audit-misplaced", Severity.NOTE, where, sentence, "Check where the marker was worn.")


@dataclass(frozen=True)
class ErrorRun:
    """Frames first..last in which markers' points carry each other's names, or one label is off its marker; gain in nats."""

    first: int
    last: int
    markers: tuple[int, ...]
    kind: str
    gain: float


def joined(runs: Sequence[ErrorRun]) -> list[ErrorRun]:
    """Join exchanges of the same frames that share a marker into one exchange among more markers."""
    out: list[ErrorRun] = []
    for run in sorted(runs, key=lambda run: (run.first, run.last, run.markers)):
        for i, known in enumerate(out):
            # Two runs of equal frames are one event: three markers in a circle are found as pairs.
            if run.kind == known.kind == EXCHANGED and (run.first, run.last) == (known.first, known.last):
                # The same pair twice would be an exchange and its undoing; both are told.
                if set(run.markers) == set(known.markers):
                    continue
                if set(run.markers) & set(known.markers):
                    out[i] = replace(known, markers=tuple(sorted({*known.markers, *run.markers})), gain=known.gain + run.gain)
                    break
        else:
            out.append(run)
    return out


def sentence(kind: str, names: Sequence[str], seconds: float, frames: int, whole: bool, subject: str) -> str:
    """The description of an error, in words."""
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    among = "exchanged" if len(names) == 2 else "exchanged among themselves"
    duration = "in the whole recording" if whole else f"for {frames} frame{'s' if frames > 1 else ''} ({seconds:.2f} s)"
    if kind == EXCHANGED:
        return f"{listed} {among} {duration}"
    if kind == ALWAYS:
        return f"{listed} {among} against all other people, in every recording of {subject}"
    if kind == JUMP:
        return f"{listed} leaves its path {duration}"
    if kind == DIFFERENT:
        return f"{listed} carry each other's names here or in another recording of {subject}"
    return (
        f"{listed} is {duration} where nobody else wears it" if len(names) == 1 else f"{listed} are {duration} where nobody else wears them"
    )
