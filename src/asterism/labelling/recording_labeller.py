"""Models and settings in; labels of recordings of one or several bodies, short or long, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.errors import NoMarkers
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.stretches import StretchRules, label_long
from asterism.labelling.together import join_labellings
from asterism.labelling.training.model_state import ModelState
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.labelling.whole.label import label_whole
from asterism.labelling.whole.point_labels import BodyInRecording
from asterism.labelling.whole.relabel import LabelledTracklets, label_tracklets
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, MarkerSet
from asterism.recording.verdict import CERTAIN

METHODS = ("whole-body", "partial-solvers", "thesis")
"""How single frames are labelled: by the whole body; by the votes of partial solvers, completed by the strong classifier of all markers; by
these votes alone."""


@dataclass(frozen=True)
class LabellingSettings:
    """How recordings are labelled. They are handed in here, once, for all that labels.

    method      how single frames are labelled, one of `METHODS`
    frame_wise  whether each frame is labelled by itself, without tracks; the methods of partial solvers know no other way
    workers     threads that share the work; the result is the same
    stretches   how a long recording is divided
    recording   how whole recordings are labelled
    subject     how the model is adapted to the person
    """

    method: str = METHODS[0]
    frame_wise: bool = False
    workers: int = 1
    stretches: StretchRules = field(default_factory=lambda: StretchRules())
    recording: RecordingLabellingSettings = field(default_factory=RecordingLabellingSettings)
    subject: SubjectRules = field(default_factory=SubjectRules)

    @property
    def in_time(self) -> bool:
        """Whether recordings are labelled as a whole, by their tracks."""
        return self.method == METHODS[0] and not self.frame_wise


class TrainedModel(Protocol):
    """What labels recordings of one body: a `MarkerModel`."""

    state: ModelState

    @property
    def marker_set(self) -> MarkerSet:
        """Names of its markers."""
        ...

    @property
    def body_labeller(self) -> BodyLabeller:
        """What labels single frames by the whole body."""
        ...

    def in_recording(self) -> BodyInRecording:
        """The model as one of the bodies of a recording."""
        ...

    def label_frames(self, recording: Clouds, *, method: str, workers: int, progress: Progress | None) -> Labelling:
        """Each frame labelled by itself."""
        ...

    def label_one_body(self, clouds: Clouds, progress: Progress | None, *, settings: LabellingSettings | None) -> Labelling:
        """Clouds labelled as those of one body."""
        ...


@dataclass(frozen=True)
class WiderModel:
    """A model of a marker set that also explains points of which the set asked for has no marker.

    name     of this set
    model    labels all of it
    columns  (M,) the marker of the model for each marker asked for, -1 where it has none
    named    (M,) whether the set calls it so; another name in the same place may be a marker that hands put elsewhere, so that it is never
             sure
    """

    name: str
    model: TrainedModel
    columns: Ints
    named: NDArray[np.bool_]

    def of_asked(self, indices: Ints, confidence: Floats) -> tuple[Ints, Floats]:
        """Of indices and confidence (..., N) of all markers of the model those of the markers asked for, (..., M)."""
        given, shape = self.columns != NULL, (*indices.shape[:-1], len(self.columns))
        own, sure = np.full(shape, NULL, dtype=np.int64), np.zeros(shape)
        own[..., given], sure[..., given] = indices[..., self.columns[given]], confidence[..., self.columns[given]]
        sure[..., ~self.named] = np.minimum(sure[..., ~self.named], CERTAIN)
        return own, sure

    def label(
        self, clouds: Clouds, progress: Progress | None, settings: LabellingSettings, names: Sequence[str]
    ) -> tuple[Labelling, Labelling]:
        """The labels of the markers asked for, which are called `names`, and those of the others.

        Raises SeveralBodies where the clouds certainly show two bodies.
        """
        whole = self.model.label_one_body(clouds, progress, settings=settings)
        given = self.columns != NULL
        rest = np.setdiff1d(np.arange(len(whole.names)), self.columns[given])
        indices, confidence = self.of_asked(whole.indices, whole.confidence)
        candidates = np.full_like(indices, NULL)
        if whole.candidates is not None:
            candidates[:, given] = whole.candidates[:, self.columns[given]]
        verdict = whole.verdict
        if verdict is not None:
            told = {whole.names[column]: names[m] for m, column in enumerate(self.columns) if column != NULL}
            pairs = tuple(tuple(told[name] for name in pair) for pair in verdict.exchangeable if set(pair) <= set(told))
            verdict = replace(verdict, exchangeable=pairs)
        asked = replace(whole, indices=indices, confidence=confidence, names=tuple(names), candidates=candidates, verdict=verdict)
        others = Labelling(whole.indices[:, rest], whole.confidence[:, rest], tuple(whole.names[column] for column in rest))
        return asked, others


@dataclass(frozen=True)
class LabelledBodies:
    """Clouds labelled at once.

    labelling  of all markers of all bodies
    bodies     of each body, in the order of the models; of two people who wear one model's markers, the one labelled, then the other; of
               one whose other points are explained, too, the labels of these at the end
    tracklets  what labelling again begins with; None where it was not asked for, or there is more than one body
    """

    labelling: Labelling
    bodies: tuple[Labelling, ...]
    tracklets: LabelledTracklets | None = None


class RecordingLabeller:
    """Labels recordings with one model, or with one for each body in the volume, by one set of settings."""

    def __init__(
        self,
        models: TrainedModel | Sequence[TrainedModel],
        settings: LabellingSettings | None = None,
        names: Sequence[str] | None = None,
        wider: WiderModel | None = None,
    ) -> None:
        """names: what each body is called where two have markers of one name; by default 1, 2, ...

        wider: labels in place of the one model.
        """
        self.models = tuple(models) if isinstance(models, Sequence) else (models,)
        self.settings = settings or LabellingSettings()
        self.names, self.wider = names, wider

    @cached_property
    def marker_set(self) -> MarkerSet:
        """The names of the markers of all bodies."""
        if len(self.models) == 1:
            return self.models[0].marker_set
        # of no frame: the names are joined as the labellings are
        empty = [Labelling(np.empty((0, len(one.marker_set)), np.int64), np.empty((0, len(one.marker_set))), ()) for one in self.models]
        return join_labellings(empty, [one.marker_set for one in self.models], self.names)[1]

    @property
    def can_divide(self) -> bool:
        """Whether a long recording may be labelled in stretches: several bodies are told apart by their tracks over all of it."""
        return len(self.models) == 1 and self.settings.in_time

    def label(self, clouds: Clouds, progress: Progress | None = None) -> Labelling:
        """Label a recording that is in memory. See `MarkerModel.label`.

        Raises NoMarkers where no frame has a point.
        """
        return self.label_with_bodies(clouds, progress, keep_tracklets=False)[0]

    def label_with_bodies(
        self, clouds: Clouds, progress: Progress | None = None, *, keep_tracklets: bool = True
    ) -> tuple[Labelling, LabelledBodies | None]:
        """`label`, and what the models alone say; None where the recording was labelled in stretches. See `label_bodies`."""
        if not len(clouds.xyz):
            raise NoMarkers("the recording has no points to label.")
        if not self.can_divide:
            bodies = self.label_bodies(clouds, progress)
            return bodies.labelling, bodies
        labelled = list[LabelledBodies]()

        def label(part: Clouds, report: Progress | None) -> Labelling:
            keep = keep_tracklets and len(part) == len(clouds)
            labelled[:] = [self.label_bodies(part, report, keep_tracklets=keep)]
            return labelled[0].labelling

        try:
            labelling = label_long(label, self.marker_set.names, clouds, self.settings.stretches, progress=progress)
        except SeveralBodies:
            bodies = self.label_two(clouds, progress)
            return bodies.labelling, bodies
        return labelling, labelled[0] if labelling.stretches == 1 else None

    def label_bodies(self, clouds: Clouds, progress: Progress | None = None, *, keep_tracklets: bool = False) -> LabelledBodies:
        """Label clouds at once, one body for each model. Raises SeveralBodies where one model is given, and they certainly show two of it.

        keep_tracklets: whether to keep what labelling again begins with.
        """
        settings = self.settings
        if not settings.in_time:
            (model,) = self.models
            framewise = model.label_frames(clouds, method=settings.method, workers=settings.workers, progress=progress)
            return LabelledBodies(framewise, (framewise,))
        if self.wider is not None:
            asked, others = self.wider.label(clouds, progress, settings, self.marker_set.names)
            return LabelledBodies(asked, (asked, others))
        if len(self.models) == 1:
            model = self.models[0]
            if keep_tracklets and len(clouds.xyz):
                kept = label_tracklets(
                    model.in_recording(), clouds, settings.recording, settings.subject, model.state.body_rules, settings.workers, progress
                )
                return LabelledBodies(kept.labelling, (kept.labelling,), kept)
            labelling = model.label_one_body(clouds, progress, settings=settings)
            return LabelledBodies(labelling, (labelling,))
        found = label_together(self.models, clouds, settings, progress)
        joined, _ = join_labellings(found, [one.marker_set for one in self.models], self.names)
        return LabelledBodies(joined, tuple(found))

    def label_two(self, clouds: Clouds, progress: Progress | None = None) -> LabelledBodies:
        """Label two bodies that wear the one model's markers, and give the labels of the one that shows more."""
        (model,) = self.models
        both = label_together([model, model], clouds, self.settings, progress)
        shown, other = sorted(both, key=lambda labelling: -int((labelling.indices >= 0).sum()))
        shown = replace(shown, bodies=2)
        return LabelledBodies(shown, (shown, other))


def label_together(
    models: Sequence[TrainedModel], clouds: Clouds, settings: LabellingSettings, progress: Progress | None = None
) -> list[Labelling]:
    """One labelling for each model, each point given to one of them at most. A model may be given twice, for two people.

    Raises SeveralBodies where one model is given, and the clouds certainly show two bodies of it.
    """
    bodies = [model.in_recording() for model in models]
    body_rules = next((model.state.body_rules for model in models if model.state.training is not None), BodyRules())
    return label_whole(bodies, clouds, settings.recording, settings.subject, body_rules, settings.workers, progress)[0]
