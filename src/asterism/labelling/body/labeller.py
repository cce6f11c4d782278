"""The whole-body look at clouds: a model laid out for the kernels and clouds in; labels and their margins, frame by frame, out."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body._kernels import AnchorArrays, BodyArrays, LookSettings, label_clouds
from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.model import BodyModel
from asterism.labelling.partial._kernels import SolverArrays
from asterism.labelling.partial.features import upright
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints


@dataclass(frozen=True)
class LookRules:
    """How the whole-body look labels a frame. Chosen on the gait subjects, each left out in turn (docs/labelling.md).

    reward      nats that a labelled point earns over "marker hidden, point a ghost": the log of how much rarer that is
    first_ghost nats that the first ghost of a frame costs: most frames have none
    odd         nats that a point earns where its marker is only oddly placed: within `odd_radius` of where it is expected
    odd_radius  m
    far         squared distance of an anchor's own points beyond which its proposal is dropped
    agree       anchors that must lead to the best labelling before the others are skipped, where markers or points are left over
    ask         anchors on missing markers that are tried where two points or a fifth of the markers are left over
    enough      anchors that end the search even where the best labelling scores less than labelled frames usually do
    budget      feature evaluations per frame, after which it is decided with what was found
    per_anchor  labellings of one anchor that are followed up
    least_found share of the markers (or points, if fewer) that a proposal must find at once to be followed up
    clear       nats by which a label must beat its rivals to be taken before the others
    contest     nats up to which a rival labelling is computed exactly
    """

    reward: float = 2.0
    first_ghost: float = 12.0
    odd: float = -2.0
    odd_radius: float = 0.15
    far: float = 70.0
    agree: int = 2
    ask: int = 5
    enough: int = 6
    budget: int = 200_000
    per_anchor: int = 3
    least_found: float = 0.5
    clear: float = 3.0
    contest: float = 10.0

    def settings(self, usual_score: float) -> LookSettings:
        """As the kernels read them; `usual_score` is what nearly every rightly labelled frame scores per label, in nats."""
        numbers = asdict(self)
        return LookSettings(good=usual_score, **numbers)


@dataclass(frozen=True)
class Prepared:
    """A model of M markers laid out for the kernels."""

    solvers: SolverArrays
    anchors: AnchorArrays
    body: BodyArrays
    settings: LookSettings

    @classmethod
    def of(cls, body: BodyModel, anchors: Anchors, settings: LookSettings) -> Prepared:
        """Lay out a body model and its anchors."""
        return cls(anchors.solvers(), anchors.arrays(body), body.arrays(), settings)

    def margins(self, clouds: Clouds, workers: int = 1, progress: Progress | None = None) -> tuple[Ints, Floats, Ints, NDArray[np.bool_]]:
        """The best labelling of each frame alone.

        Gives each marker's place in its frame (T, M), -1 for none; margins (T, M) in nats over the nearest labelling that differs there
        (for a null, how far its best free point was from being taken: negative); counters (T, 4), see `label_frame`; and (T,) whether
        points were left over. The result depends neither on the order of the points nor on `workers`.
        """
        frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
        xyz = upright(clouds.xyz, clouds.vertical)
        order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], frame_of))
        xyz = np.ascontiguousarray(xyz[order])
        place = order - clouds.offsets[frame_of]
        rows, margins, counters = self.look(xyz, clouds.offsets, workers, progress and (lambda fraction: progress(fraction, "labelling")))
        spare = (rows >= 0).sum(axis=1) < clouds.counts
        given = rows >= 0
        rows[given] = place[(clouds.offsets[:-1, None] + rows)[given]]
        return rows, margins, counters, spare

    def look(
        self, xyz: Floats, offsets: Ints, workers: int = 1, report: Callable[[float], None] | None = None, at_once: int = 500
    ) -> tuple[Ints, Floats, Ints]:
        """`margins` of frames laid out for the kernels: rows, margins (E, M), counters (E, 4).

        xyz (Q, 3) m, z up, from the highest to the lowest point of each frame; offsets (E + 1,); report: told after each `at_once` frames
        which share is done.
        """
        frames = len(offsets) - 1
        shape = (frames, self.body.mean.shape[1])
        rows, margins = np.full(shape, NULL, dtype=np.int64), np.zeros(shape)
        counters = np.zeros((frames, 4), dtype=np.int64)

        def work(span: tuple[int, int]) -> int:
            label_clouds(xyz, offsets, *span, self.solvers, self.anchors, self.body, self.settings, rows, margins, counters)
            return span[1]

        step = max(1, min(at_once, -(-frames // max(1, workers))))
        spans = [(start, min(start + step, frames)) for start in range(0, frames, step)]
        with ThreadPoolExecutor(max(1, workers)) as pool:
            for done in pool.map(work, spans) if workers > 1 else map(work, spans):
                if report:
                    report(done / frames)
        return rows, margins, counters
