"""Whole-body labelling of single frames: a body model with its anchors and clouds in; labels and their margins out."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body._frame_kernels import label_clouds
from asterism.labelling.body._search_kernels import MAX_LABELLINGS
from asterism.labelling.body._workspace_kernels import AnchorArrays, BodyArrays, FrameLabelling, FrameModel, FrameSettings
from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.exchanges import ExchangeModel
from asterism.labelling.body.model import BodyModel, distance_variance
from asterism.labelling.body.twins import neighbours_of, twins_of
from asterism.labelling.features.search_kernels import SolverArrays
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints

EARLIER_NAMES = {
    "first_ghost": "first_ghost_cost",
    "odd": "outlier_score",
    "odd_radius": "outlier_radius",
    "far": "max_anchor_distance2",
    "agree": "votes_needed",
    "ask": "extra_anchors",
    "enough": "max_votes_needed",
    "budget": "max_evaluations",
    "per_anchor": "proposals_per_anchor",
    "least_found": "min_found_share",
    "clear": "assign_margin",
    "contest": "exact_margin",
}
"""Fields of `FrameLabellingSettings` as model files of earlier versions spell them."""

MOST_EVALUATIONS = 2_000_000
"""Feature evaluations of a frame at most where all labels begin with few frames, ten times those of a frame by itself. Chosen on 39 markers
of virtual people among 78 points: with a quarter of them no anchor comes to an end, twice as many change nothing. With a tenth, 73 markers
without a ghost are not found either, nor are 59 markers on a child in a third of the frames. Most frames need a hundredth."""

LEFT_OUT = 0.01
"""Share of laboratories that leave a marker out; half of them, where the set calls it optional. Of 711 markers of 17 sets and people of
`movement` one was, beside four optional ones. At half and at double exchanges with markers that are not worn differ by 0.7 nats."""

PEOPLE_WIDEN = 1.0
"""Standard deviations among people by which a distance may be beyond those of the key poses before it counts as off. At none, knees beside
wands that sit high are taken back; at double, hardly any distance ever is off."""


@dataclass(frozen=True)
class FrameLabellingSettings:
    """How a single frame is labelled. All were chosen on the gait subjects, each left out in turn (docs/labelling.md).

    reward               nats that a labelled point earns over "marker hidden, point a ghost": the log of how much rarer that is
    first_ghost_cost     nats that the first ghost of a frame costs: most frames have none
    outlier_score        nats that a point earns as an outlier: its marker, but badly placed; within `outlier_radius` of the prediction
    outlier_radius       m
    max_anchor_distance2 squared Mahalanobis distance of an anchor's own three points above which its proposal is dropped
    votes_needed         anchors that must lead to the best labelling before the search ends, where markers or points are left over
    max_votes_needed     the same where the best labelling scores less than correctly labelled frames usually do
    extra_anchors        anchors on missing markers that are tried where two points or a fifth of the markers are left over
    max_evaluations      feature evaluations per frame, after which the best labelling found so far is taken
    proposals_per_anchor labellings of one anchor that are refined
    min_found_share      share of the markers (of the points, if fewer) that a proposal must label to be refined
    assign_margin        nats by which a label must beat its rivals to be taken in the first rounds of the refinement
    exact_margin         nats: the score of a rival labelling is computed exactly if the estimate comes this close
    tail_freedom         degrees of freedom of the tail by which a whole body may deviate from the training's postures, see `log_tail`
    """

    reward: float = 2.0
    first_ghost_cost: float = 12.0
    outlier_score: float = -2.0
    outlier_radius: float = 0.15
    max_anchor_distance2: float = 70.0
    votes_needed: int = 2
    max_votes_needed: int = 6
    extra_anchors: int = 5
    max_evaluations: int = 200_000
    proposals_per_anchor: int = 3
    min_found_share: float = 0.5
    assign_margin: float = 3.0
    exact_margin: float = 10.0
    tail_freedom: float = 8.0

    def __post_init__(self) -> None:
        # A frame keeps so many labellings, and an anchor is not run unless all that it may propose has room: above, none ever would.
        if not 1 <= self.proposals_per_anchor <= MAX_LABELLINGS:
            raise AsterismError(f"proposals_per_anchor is {self.proposals_per_anchor}; give 1 to {MAX_LABELLINGS}.")

    def with_usual_score(self, usual_score: float) -> FrameSettings:
        """As the kernels read them; `usual_score`: nats per label that nearly every correctly labelled frame reaches."""
        return FrameSettings(usual_score=usual_score, **asdict(self))

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> FrameLabellingSettings:
        """The inverse of `dataclasses.asdict`; takes the field names of earlier versions, too."""
        return cls(**{EARLIER_NAMES.get(name, name): value for name, value in fields.items()})


@dataclass(frozen=True)
class LabelledFrames:
    """The best labelling of each of T frames alone, for M markers.

    point_of     (T, M) each marker's point in its frame, -1 for none
    margins      (T, M) nats over the nearest labelling that differs there; for a null, minus the nats that its best free point lacks
    counters     (T, 4), see `label_frame`
    fits         (T, M) nats, how well each marker's point lies where all other labels predict it; 0 for a null
    points_left  (T,) whether points were left over
    """

    point_of: Ints
    margins: Floats
    counters: Ints
    fits: Floats
    points_left: NDArray[np.bool_]


@dataclass(frozen=True)
class BodyLabeller:
    """Labels single frames by a body model of M markers.

    model             the body model
    solvers, anchors  its anchors as partial solvers, and what each predicts of the whole body
    body              the body model as the kernels read it
    settings          how a frame is labelled
    twins             (W, M) what a labelling is held against, see `twins_of`
    many_people       whether so many people taught the model that it knows how much they differ
    often_left_out    (M,) whether many laboratories leave a marker out; none where not given
    """

    model: BodyModel
    solvers: SolverArrays
    anchors: AnchorArrays
    body: BodyArrays
    settings: FrameSettings
    twins: Ints
    many_people: bool = False
    often_left_out: NDArray[np.bool_] | None = None

    @classmethod
    def from_model(
        cls,
        model: BodyModel,
        anchors: Anchors,
        settings: FrameSettings,
        *,
        many_people: bool = False,
        often_left_out: NDArray[np.bool_] | None = None,
    ) -> BodyLabeller:
        """Bring a body model and its anchors into the arrays that the kernels read."""
        arrays = anchors.solvers(), anchors.arrays(model), model.arrays()
        return cls(model, *arrays, settings, twins_of(model), many_people, often_left_out)

    @cached_property
    def exchanges(self) -> ExchangeModel:
        """What exchanges of near markers are judged by."""
        return ExchangeModel.of_body(self.model, neighbours_of(self.model))

    @cached_property
    def optional(self) -> NDArray[np.bool_]:
        """(M,) the markers that many laboratories leave out."""
        return np.zeros(self.body.mean.shape[1], dtype=np.bool_) if self.often_left_out is None else self.often_left_out

    @cached_property
    def worn_odds(self) -> Floats:
        """The log odds that a laboratory puts each marker on: (M,)."""
        return np.where(self.optional, 0.0, logit(1.0 - LEFT_OUT))

    @cached_property
    def distance_range(self) -> tuple[Floats, Floats]:
        """The least and the largest distance of each two markers in the training, (M, M) m each: of the key poses, and of many people."""
        between = np.linalg.norm(self.model.mean[:, :, None] - self.model.mean[:, None], axis=3)
        apart = np.zeros(between.shape[1:])
        if self.many_people and self.model.between is not None:
            apart = PEOPLE_WIDEN * np.sqrt(distance_variance(self.model.mean, self.model.between).mean(axis=0))
        return between.min(axis=0) - apart, between.max(axis=0) + apart

    def label(self, clouds: Clouds, workers: int = 1, progress: Progress | None = None) -> LabelledFrames:
        """The best labelling of each frame alone. The result depends neither on the order of the points nor on `workers`."""
        frame_of = clouds.frame_of
        xyz = rotate_z_up(clouds.xyz, clouds.vertical)
        order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], frame_of))
        xyz = np.ascontiguousarray(xyz[order])
        place = order - clouds.offsets[frame_of]
        found = self._label_sorted(xyz, clouds.offsets, workers, progress)
        labelled = found.point_of >= 0
        points_left = labelled.sum(axis=1) < clouds.counts
        found.point_of[labelled] = place[(clouds.offsets[:-1, None] + found.point_of)[labelled]]
        return LabelledFrames(found.point_of, found.margins, found.counters, found.fits, points_left)

    def label_frames(
        self, xyz: Floats, offsets: Ints, workers: int = 1, progress: Progress | None = None, at_once: int = 500
    ) -> tuple[Ints, Floats, Ints]:
        """`label` for frames whose points are sorted already: point of each marker, margins (E, M), counters (E, 4).

        xyz (Q, 3) m, z up, from the highest to the lowest point of each frame; offsets (E + 1,); progress is called after each `at_once`
        frames.
        """
        found = self._label_sorted(xyz, offsets, workers, progress, at_once)
        return found.point_of, found.margins, found.counters

    def _label_sorted(self, xyz: Floats, offsets: Ints, workers: int, progress: Progress | None, at_once: int = 500) -> FrameLabelling:
        """`label_frames`, with all that the kernel gives."""
        frames = len(offsets) - 1
        shape = (frames, self.body.mean.shape[1])
        out = FrameLabelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), np.zeros((frames, 4), dtype=np.int64), np.zeros(shape))
        model = FrameModel(self.solvers, self.anchors, self.body, self.settings, self.twins)

        def label_span(span: tuple[int, int]) -> int:
            label_clouds(model, xyz, offsets, *span, out)
            return span[1]

        step = max(1, min(at_once, -(-frames // max(1, workers))))
        spans = [(start, min(start + step, frames)) for start in range(0, frames, step)]
        with ThreadPoolExecutor(max(1, workers)) as pool:
            for done in pool.map(label_span, spans) if workers > 1 else map(label_span, spans):
                if progress:
                    progress(done / frames, "labelling")
        return out


def usual_fits(found: LabelledFrames, clouds: Clouds, usual_score: float) -> Floats:
    """Fits (T, M) less what the labels of right frames usually score; 0 is usual, also where ghosts make every label less probable."""
    surplus = np.log1p(np.maximum(clouds.counts - found.fits.shape[1], 0))
    return found.fits - (usual_score - surplus)[:, None]
