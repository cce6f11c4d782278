"""The last seconds of a stream in; studies of them out, in the thread that asks."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.live.study import StreamFrames, Study, StudyPlan, StudyRules, frames_kept
from asterism.labelling.recording_labeller import RecordingLabeller, TrainedModel
from asterism.labelling.whole.label import subject_body
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, as_vertical
from asterism.recording.verdict import CERTAIN


class StudyWorker:
    """Keeps the last seconds of a stream, and labels them as a whole. Memory: the points of `StudyRules.window`."""

    def __init__(self, model: TrainedModel, rate: float, rules: StudyRules) -> None:
        self._model, self._rate, self._rules = model, rate, rules
        self._labeller = RecordingLabeller(model)
        self._frames: deque[tuple[Floats, Ints]] = deque(maxlen=frames_kept(rate, rules))
        self.restart()

    def restart(self) -> None:
        """Forget all frames."""
        self._frames.clear()
        self._next, self._empty = 0, 0
        self._labelled: tuple[Ints, Ints] = (np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))

    def look(self, xyz: Floats, serials: Ints) -> Study:
        """What one frame says, as `label` does; of a model that no real person taught, labels below `StudyRules.alone` are candidates."""
        self.restart()
        found = self.study(StreamFrames(0, xyz, np.array([len(xyz)]), serials))
        given = found.given & (found.chance >= (0.0 if self._model.state.about.get("recordings") else self._rules.alone))
        return replace(found, given=given, body=None)

    def study(self, new: StreamFrames) -> Study:
        """Take frames that follow those before, and label all that are kept."""
        if new.first != self._next:
            self.restart()
        ends = np.cumsum(new.counts)
        for begin, end in zip(ends - new.counts, ends, strict=True):
            self._empty = self._empty + 1 if end - begin < 3 else 0
            if self._empty >= self._rules.nobody * self._rate:
                self._frames.clear()
            self._frames.append((new.xyz[begin:end], new.serials[begin:end]))
        self._next = new.first + len(new.counts)
        xyz, serials = (np.concatenate(parts) for parts in zip(*self._frames, strict=True))
        offsets = np.cumsum([0, *(len(points) for points, _ in self._frames)])
        clouds = Clouds(xyz, offsets, self._rate, as_vertical("z"), np.full(len(xyz), NULL, dtype=np.int64))
        none = np.empty(0, dtype=np.int64)
        try:
            labelling, both = self._labeller.label_with_bodies(clouds, keep_tracklets=False)
        except AsterismError:
            # Without a point, or with bodies that cannot be told apart, nothing is known.
            return Study(self._next - 1, len(clouds), none, none, none.astype(np.bool_), np.empty(0), None)
        found = self._of_tracks(clouds, serials, labelling)
        if both is not None and len(both.bodies) == 2:
            # Of two people the one who was labelled before, however many points each shows now.
            people = [(body, self._of_tracks(clouds, serials, body)) for body in both.bodies]
            labelling, found = max(people, key=lambda each: self._as_before(*each[1][:3]))
        tracks, markers, given, chance = found
        self._labelled = tracks[given], markers[given]
        markers = np.where(given | (chance >= self._rules.least_doubt), markers, NULL)
        body = self._body(clouds, labelling)
        return Study(self._next - 1, len(clouds), tracks, markers, given, chance, body)

    def _of_tracks(self, clouds: Clouds, serials: Ints, labelling: Labelling) -> tuple[Ints, Ints, NDArray[np.bool_], Floats]:
        """The tracks, the marker of each at its end, whether it is given, and its probability: (J,) each."""
        columns = self._model.state.markers
        indices, confidence = labelling.indices[:, columns], labelling.confidence[:, columns]
        marker, chance = np.full(len(serials), NULL, dtype=np.int64), np.zeros(len(serials))
        given = np.zeros(len(serials), dtype=np.bool_)
        candidates = np.full_like(indices, NULL) if labelling.candidates is None else labelling.candidates[:, columns]
        for of_marker, are_given in ((np.where(indices == NULL, candidates, NULL), False), (indices, True)):
            frame, of = np.nonzero(of_marker != NULL)
            points = clouds.offsets[frame] + of_marker[frame, of]
            marker[points], chance[points], given[points] = of, confidence[frame, of], are_given
        tracks, last = np.unique(serials[::-1], return_index=True)
        last = len(serials) - 1 - last
        return tracks, marker[last], given[last], chance[last]

    def _as_before(self, tracks: Ints, markers: Ints, given: NDArray[np.bool_]) -> int:
        """How many tracks have the label that they had in the study before."""
        _, now, before = np.intersect1d(tracks[given], self._labelled[0], assume_unique=True, return_indices=True)
        return int((markers[given][now] == self._labelled[1][before]).sum())

    def _body(self, clouds: Clouds, labelling: Labelling) -> BodyArrays | None:
        """The body of the person, by the labels that are certain."""
        state = self._model.state
        if state.body.within is None:
            return None
        certain = labelling.confidence[:, state.markers] >= CERTAIN
        frames = np.where(certain[:, :, None], labelling.positions(clouds)[:, state.markers], np.nan)
        rules = SubjectRules(noise_std=self._rules.noise_std)
        try:
            return subject_body(self._model.body_labeller.settings, state.body, frames, clouds.rate, rules, state.body_rules).arrays()
        except AsterismError:
            return None


def warm_up(worker: StudyWorker, model: TrainedModel) -> None:
    """Have all kernels read or compiled, by a study of a body that stands."""
    body = model.body_labeller.body.mean[0]
    shown = np.ones((12, len(body)), dtype=np.bool_)
    # A marker that comes and goes asks for the labels of short tracks.
    shown[3:5, 0] = shown[8, 0] = False
    xyz = np.concatenate([body[of_frame] + 0.001 * number for number, of_frame in enumerate(shown)])
    worker.study(StreamFrames(0, xyz, shown.sum(axis=1), np.nonzero(shown)[1].astype(np.int64)))
    worker.restart()


class StudiesInPush:
    """Studies in the thread of the stream, taken over as late as those of a process would be, and the same each time."""

    def __init__(self, model: TrainedModel, rate: float, rules: StudyRules) -> None:
        self._rate, self.rules, self._markers = rate, rules, len(model.state.markers)
        self._worker, self._plan = StudyWorker(model, rate, rules), StudyPlan(rate, rules)
        self._looker = StudyWorker(model, rate, rules)
        self._found: Study | None = None

    def look(self, xyz: Floats, serials: Ints) -> Study | None:
        """See `Studies.look`."""
        return self._looker.look(xyz, serials)

    def restart(self) -> None:
        """See `Studies.restart`."""
        self._worker.restart()
        self._plan.restart()
        self._found = None

    def add(self, number: int, xyz: Floats, serials: Ints, *, unsure: bool) -> None:
        """See `Studies.add`."""
        self._plan.add(number, xyz, serials)
        if self._found is None and self._plan.is_due(unsure=unsure):
            self._found = self._worker.study(self._plan.frames())

    def taken(self, number: int) -> Study | None:
        """See `Studies.taken`."""
        if self._found is None:
            return None
        seconds = self._markers * (self.rules.lag + self.rules.frame_lag * self._found.frames)
        if number < self._found.last + max(1, round(seconds * self._rate)):
            return None
        found, self._found = self._found, None
        self._plan.take()
        return found

    def wait(self, seconds: float) -> bool:
        """See `Studies.wait`."""
        return True

    def made(self) -> tuple[int, float]:
        """See `Studies.made`."""
        return self._plan.made()

    def findings(self) -> list[Finding]:
        """See `Studies.findings`."""
        return []

    def close(self) -> None:
        """See `Studies.close`."""
