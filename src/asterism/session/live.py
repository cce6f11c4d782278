"""The points of each frame of a live system in, without a model; the marker set worn, and the labels of the frames, out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.labelling.live.stream import FrameLabels, Stream, check_timing
from asterism.labelling.live.study import Studies, StudyPlace, StudyRules
from asterism.labelling.live.study_process import StudyProcess, make_studies
from asterism.labelling.marker_model import MarkerModel
from asterism.labelling.recording_labeller import WiderModel
from asterism.labelling.virtual_model import virtual_model
from asterism.recording import NULL, Clouds, Floats, MarkerSet, Recording, as_vertical
from asterism.session.labeller import findings_on_sets
from asterism.session.wider import WiderRules, wider_model
from asterism.session.worn import SetFinder, WornMarkers

_SECONDS = 1.0
"""s of frames in which the marker set is looked for: a step of a walk. With half of it all frames show one posture; with twice as much the
first labels come a second later."""
_LABELLED = 0.8
"""Share of the markers given that have a label in a usual frame, below which a wider set is looked for among many more points: a hand and a
foot may be hidden. At half, plug-in-gait beside the markers of the Oxford foot keeps the 66 % of its labels that it has alone; at double,
everybody who comes with ghosts waits for the search, which takes seconds."""


class LiveLabeller:
    """Labels live points by virtual people who wear the marker set that is given, or found in the first second that shows a body.

    As a `Stream`, with its delay and bounded memory, but for the push at which the set is found: the search takes a second or two, and the
    model of a set that was never used is made, which takes some seconds more. With `markers` all of this is done beforehand.

    rate, delay  as `MarkerModel.stream` takes them
    markers      the set worn: a shipped one's name, a TOML file, or a marker set; None where it is to be found
    vertical     what points up; None for z, unless the points are a body with another axis up
    studies      where the last seconds are labelled as a whole, see `make_studies`; a process is ended by `close`

    `worn` is the set, None while it is not known; `refusal` says why the last second showed none. Of several people, the
    one of most points is labelled. Where a second shows many more points than the set given has markers, and few labels, the set that
    explains all of them labels them, see `wider_model`, and the labels of the markers given are told: the search takes seconds, once.
    Raises AsterismError where the set given cannot be used, or the rate or the delay is none.
    """

    def __init__(
        self,
        rate: float,
        delay: int = 0,
        *,
        markers: str | Path | MarkerSet | None = None,
        vertical: ArrayLike | str | None = None,
        studies: StudyPlace | Studies = "process",
    ) -> None:
        check_timing(rate, delay)
        self.rate, self.delay = rate, delay
        self.worn: WornMarkers | None = None
        self.refusal = ""
        self._set_findings: Sequence[Finding] = ()
        self._given, self._up = vertical, as_vertical("z" if vertical is None else vertical)
        self._stream: Stream | None = None
        # It begins while the set is sought.
        self._studies = StudyProcess(rate, StudyRules()) if studies == "process" else studies
        self._waiting, self._before = list[Floats](), 0
        self._wider: WiderModel | None = None
        self._latest = deque[tuple[Floats, int]](maxlen=max(1, round(_SECONDS * rate)))
        """of the set given, the last second of frames: points, and how many of them have a label"""
        self._showing = 0
        """how many of these show most of the set"""
        self._may_be_wider, self._pushed = markers is not None, 0
        if markers is not None:
            (worn,) = SetFinder([markers]).given_sets()
            self._take(worn)

    @property
    def marker_set(self) -> MarkerSet | None:
        """Its names are the columns of the labels; None while the set is not known."""
        return None if self.worn is None else self.worn.marker_set

    def push(self, points: ArrayLike) -> FrameLabels | None:
        """Take the next frame's points (n, 3) m; give the labels of the frame `delay` pushes ago, None where there are none yet.

        Raises AsterismError as `Stream.push` does.
        """
        if self._stream is not None:
            labels = self._stream.push(points)
            self._pushed += 1
            if self._may_be_wider:
                labels = self._of_wider(np.array(points, dtype=np.float64), labels)
            return self._numbered(labels)
        # one that is wrong is refused now, and the others are kept
        frame = Clouds.from_points([points], self.rate).xyz
        self._waiting.append(frame)
        if len(self._waiting) < _SECONDS * self.rate:
            return None
        self._find()
        if self._stream is None:
            # nobody is there yet: memory and time for a second stay what they are
            self._before += len(self._waiting)
            self._waiting.clear()
            return None
        labels = [self._stream.push(earlier) for earlier in self._waiting][-1]
        self._waiting.clear()
        return self._numbered(labels)

    def flush(self) -> list[FrameLabels]:
        """The labels of the last `delay` frames, oldest first. The stream then begins anew, with the set that it knows."""
        rest = [] if self._stream is None else [self._shifted(labels) for labels in self._stream.flush()]
        self._waiting.clear()
        self._latest.clear()
        self._before = self._pushed = self._showing = 0
        return rest

    def findings(self) -> list[Finding]:
        """What a person should know of the set that was taken, and of the studies: see `Stream.findings`."""
        return [*self._set_findings, *([] if self._stream is None else self._stream.findings())]

    def studies_made(self) -> tuple[int, float]:
        """See `Stream.studies_made`."""
        return (0, math.nan) if self._stream is None else self._stream.studies_made()

    def wait_for_studies(self, seconds: float) -> None:
        """See `Stream.wait_for_studies`; at once where the set is still to be found."""
        if self._stream is not None:
            self._stream.wait_for_studies(seconds)

    def close(self) -> None:
        """End the process of the studies."""
        if not isinstance(self._studies, str):
            self._studies.close()

    def _find(self) -> None:
        """Look for the set in the frames that wait."""
        clouds = Clouds.from_points(self._waiting, self.rate, self._up)
        finder = SetFinder(vertical=self._given)
        where = Path("the stream")
        try:
            (worn,) = finder.of(where, Recording.from_clouds(clouds))
        except AsterismError as problem:
            self.refusal = str(problem)
            return
        self._up = self._up if worn.vertical is None else worn.vertical
        self._set_findings = findings_on_sets(where, [worn], finder.rules)
        self._take(worn)

    def _of_wider(self, points: Floats, labels: FrameLabels | None) -> FrameLabels | None:
        """The labels of a push, by a wider set where a second shows that the points are more than those of the set given."""
        own = 0 if labels is None else int((labels.indices != NULL).sum())
        assert self.worn is not None
        size = len(self.worn.marker_set)
        if len(self._latest) == self._latest.maxlen:
            self._showing -= len(self._latest[0][0]) >= _LABELLED * size
        self._latest.append((points, own))
        self._showing += len(points) >= _LABELLED * size
        # Counted as they come: where nobody is seen for long, no frame may cost as much as a second of them.
        if len(self._latest) < max(self._latest.maxlen or 0, self.delay + 1) or 2 * self._showing <= len(self._latest):
            return labels
        shown, labelled = np.median([(len(each), count) for each, count in self._latest], axis=0)
        # Once, as the person comes: later, frames that wait for seconds would hold a session up.
        self._may_be_wider, frames = False, [each for each, _ in self._latest]
        self._latest.clear()
        if shown < (1.0 + WiderRules().left_over) * size or labelled >= _LABELLED * size:
            return labels
        wider = wider_model(virtual_model(self.worn.marker_set), Clouds.from_points(frames, self.rate, self._up))
        if wider is None or not isinstance(wider.model, MarkerModel):
            return labels
        if isinstance(self._studies, StudyProcess):
            # It knows the set given, and learns no other.
            self._studies.close()
            self._studies = StudyProcess(self.rate, StudyRules())
        self._wider, self._before = wider, self._pushed - len(frames)
        self._stream = wider.model.stream(self.rate, self.delay, self._up, make_studies(self._studies, self.rate, wider.model))
        asked = self.worn.name
        sentence = (
            f"the stream: the points beside those of {asked} are like markers of {wider.name}; all are labelled so, and those of {asked}"
        )
        mend = f"Nothing need be done; give --markers {wider.name} to have all of them, at once."
        self._set_findings = [Finding("label-wider-set", Severity.NOTE, "the stream", f"{sentence} told.", mend)]
        return [self._stream.push(each) for each in frames][-1]

    def _take(self, worn: WornMarkers) -> None:
        model = virtual_model(worn.marker_set)
        self._stream = model.stream(self.rate, self.delay, self._up, make_studies(self._studies, self.rate, model))
        self.worn, self.refusal = worn, ""

    def _numbered(self, labels: FrameLabels | None) -> FrameLabels | None:
        return None if labels is None else self._shifted(labels)

    def _shifted(self, labels: FrameLabels) -> FrameLabels:
        """The labels of the markers that are told, under the frame's number since the first push."""
        indices, confidence = labels.indices, labels.confidence
        if self._wider is not None:
            indices, confidence = self._wider.of_asked(indices, confidence)
        return replace(labels, frame=labels.frame + self._before, indices=indices, confidence=confidence)
