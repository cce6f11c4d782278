"""The solver ensemble: labelled recordings in; a model that labels anonymous clouds, with calibrated confidence, out."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.hiding import hide_and_haunt
from asterism.labelling._kernels import SolverArrays
from asterism.labelling.body._kernels import AnchorArrays, BodyArrays, LookSettings, best_pose, label_clouds, make_room
from asterism.labelling.body.anchors import AnchorRules, Anchors, choose_anchors, with_intervals
from asterism.labelling.body.model import BodyModel, BodyRules, fit_body, names_of, subsample
from asterism.labelling.calibration import Calibration
from asterism.labelling.features import upright
from asterism.labelling.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.mining import mine
from asterism.labelling.solver import person
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, MarkerSet, Recording

Progress = Callable[[float, str], None]
FORMAT = "asterism-model"
FORMAT_VERSION = 1
RULES = ("whole-body", "partial-solvers", "thesis")


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
class TrainingRules:
    """How an ensemble is learned.

    frames_per_person  training frames of one person at most, evenly spread
    folds              groups of people left out in turn to calibrate the confidence
    trial_frames       frames on which each left-out person is tried
    usually_hidden     share of the markers hidden when the usual score is taken
    usual              share of the rightly labelled frames that score less than the "usual" score
    solver_widen       intervals of the partial solvers move out by this many standard deviations over the people
    trials             (occlusions, ghosts) of the trials, occlusions as a share of the markers
    """

    frames_per_person: int = 1500
    folds: int = 5
    trial_frames: int = 300
    usually_hidden: float = 0.25
    usual: float = 0.05
    solver_widen: float = 1.5
    trials: tuple[tuple[float, int], ...] = ((0.0, 0), (0.07, 0), (0.14, 0), (0.2, 0), (0.27, 0), (0.34, 0), (0.0, 3), (0.2, 3))


@dataclass(frozen=True)
class Prepared:
    """A model laid out for the kernels."""

    solvers: SolverArrays
    anchors: AnchorArrays
    body: BodyArrays
    settings: LookSettings


class SolverEnsemble:
    """Labels clouds of a marker set that it has learned.

    `fit` learns it from labelled recordings, `label` labels, `save` and `load` keep it. An ensemble never changes once it is made.
    """

    def __init__(
        self,
        marker_set: MarkerSet,
        markers: Ints,
        body: BodyModel,
        anchors: Anchors,
        usual_score: float,
        calibrations: tuple[Calibration, Calibration],
        least_confidence: float,
        look: LookRules,
        partial: PartialSolvers | None,
        about: dict[str, Any],
    ) -> None:
        self.marker_set = marker_set
        self.about = about
        self.least_confidence = least_confidence
        self._markers = markers
        self._body = body
        self._anchors = anchors
        self._usual_score = usual_score
        self._calibrations = calibrations
        self._look = look
        self._partial = partial
        self._prepared: Prepared | None = None

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        target_hit_rate: float = 0.999,
        miner: str | None = "bottom-up",
        subjects: Sequence[str] | None = None,
        marker_set: MarkerSet | None = None,
        body_rules: BodyRules | None = None,
        look: LookRules | None = None,
        training: TrainingRules | None = None,
        progress: Progress | None = None,
    ) -> SolverEnsemble:
        """Learn from labelled recordings that share their labels (read with `markers=`).

        subjects: whose recording each is; by default what the recordings' metadata says, else their folder. Confidence is
        calibrated on people left out in turn, so more people make it honest. `miner` finds the partial
        solvers of the thesis' rules ("bottom-up", "top-down", "genetic"; None leaves them out and saves most of the time).
        The same recordings and seed give the same model, bit for bit.
        Raises AsterismError where there is nothing to learn from, or the recordings' labels differ.
        """
        body_rules, look, training = body_rules or BodyRules(), look or LookRules(), training or TrainingRules()
        report = progress or (lambda fraction, what: None)
        if not 0.5 <= target_hit_rate < 1.0:
            raise AsterismError(f"a target hit rate of {target_hit_rate} makes no sense; give one from 0.5 to below 1, such as 0.999.")
        marker_set = marker_set or _common_marker_set(recordings)
        names, people = names_of(subjects if subjects is not None else [person(r) for r in recordings])
        if len(people) != len(recordings):
            raise AsterismError(f"{len(people)} subjects for {len(recordings)} recordings; give one name per recording.")
        frames = np.concatenate([upright(r.positions, r.vertical) for r in recordings])
        people = np.repeat(people, [len(r) for r in recordings])
        shown = ~np.isnan(frames[:, :, 0])
        markers = np.nonzero(shown.any(axis=0))[0]
        frames, shown = frames[:, markers], shown[:, markers]
        usable = shown.sum(axis=1) >= max(3, 0.5 * len(markers))
        if len(markers) < 4 or usable.sum() < 10:
            raise AsterismError(
                f"{len(markers)} markers are ever seen and {int(usable.sum())} frames show at least half of them; "
                "training needs 4 markers and 10 such frames: check the marker set against the files' labels."
            )
        frames, people = frames[usable], people[usable]
        rows = subsample(people, training.frames_per_person)
        frames, people = np.ascontiguousarray(frames[rows]), people[rows]

        report(0.0, "learning the body")
        body = fit_body(frames, people, body_rules, seed)
        anchors = choose_anchors(frames, people, body, AnchorRules(), np.random.default_rng(seed))
        draft = cls(marker_set, markers, body, anchors, 0.0, (Calibration.fit([], []),) * 2, 0.0, look, None, {})
        outcomes, usual = [], []
        folds = _folds(people, training.folds)
        for i, out in enumerate(folds):
            report(0.1 + 0.4 * i / len(folds), "trying it on people left out")
            others, whose = frames[~out], _renumbered(people[~out])
            own = fit_body(others, whose, body_rules, seed)
            scores = _scores_of_truth(own, frames[out], look, training, np.random.default_rng([seed, i]))
            usual.append(np.quantile(scores, training.usual))
            own_anchors = with_intervals(anchors.triples, others, whose, AnchorRules().widen)
            tried = replace_parts(draft, body=own, anchors=own_anchors, usual_score=float(usual[-1]))
            outcomes.append(_trial(tried, frames[out], people[out], training, seed + i))
        margin, right, spare = (np.concatenate(parts) for parts in zip(*outcomes, strict=True))
        calibrations = (Calibration.fit(margin[~spare], right[~spare]), Calibration.fit(margin[spare], right[spare]))
        partial = None
        if miner is not None:
            partial = mine(
                frames,
                people,
                targets=target_hit_rate,
                miner=miner,
                widen=training.solver_widen,
                seed=seed,
                progress=lambda f, what: report(0.5 + 0.5 * f, what),
            )
        report(1.0, "done")
        return replace_parts(
            draft,
            usual_score=float(np.median(usual)),
            calibrations=calibrations,
            least_confidence=least_confidence(target_hit_rate),
            partial=partial,
            about={
                "seed": seed,
                "target_hit_rate": target_hit_rate,
                "miner": miner,
                "subjects": list(names),
                "recordings": len(recordings),
                "frames": len(frames),
            },
        )

    def label(
        self,
        clouds: Clouds,
        *,
        rules: str = "whole-body",
        workers: int = 1,
        progress: Progress | None = None,
    ) -> Labelling:
        """Say of every frame which candidate is which marker.

        clouds: T frames. Gives indices (T, M), -1 where it does not know, and confidence (T, M). Each frame stands alone. The result does
        not depend on the order of the points, nor on `workers`. O(T); a frame of n points costs O(n M) beyond the search, which has
        a budget.
        """
        return self.label_counted(clouds, rules=rules, workers=workers, progress=progress)[0]

    def label_counted(
        self, clouds: Clouds, *, rules: str = "whole-body", workers: int = 1, progress: Progress | None = None
    ) -> tuple[Labelling, Ints]:
        """`label`, and how many features were evaluated for each frame: (T,)."""
        if rules not in RULES:
            raise AsterismError(f"there are no rules {rules!r}; choose from {', '.join(RULES)}.")
        if rules != "whole-body":
            return self._vote(clouds, rules)
        rows, confidence, counters = self._look_at(clouds, workers, progress)
        indices = np.where(confidence >= self.least_confidence, rows, NULL)
        return Labelling(indices, confidence, self.marker_set.names), counters[:, 0]

    def _vote(self, clouds: Clouds, rules: str) -> tuple[Labelling, Ints]:
        """Label by the partial solvers' proposals: the matrix of section 4.5.4 ("thesis"), or completed by the whole model."""
        if self._partial is None:
            raise AsterismError(f"this model holds no partial solvers for the rules {rules!r}; train it with a miner.")
        votes = label_by_matrix(clouds, self._partial, complete=rules == "partial-solvers")
        indices = np.full((len(clouds), len(self.marker_set)), NULL, dtype=np.int64)
        confidence = np.zeros(indices.shape)
        # a solver is trusted where its hit rate reached the target: that is what its label promises
        promised = np.where(votes.indices >= 0, self._partial.targets, 0.5 * votes.votes)
        indices[:, self._markers], confidence[:, self._markers] = votes.indices, promised
        return Labelling(indices, confidence, self.marker_set.names), votes.evaluations

    def _look_at(self, clouds: Clouds, workers: int = 1, progress: Progress | None = None) -> tuple[Ints, Floats, Ints]:
        """The best labelling of each frame before doubtful labels are taken back: indices, confidence (T, M), counters (T, 4)."""
        rows, margins, counters, spare = self._margins(clouds, workers, progress)
        own = np.where(spare[:, None], self._calibrations[1].confidence(margins), self._calibrations[0].confidence(margins))
        # a null has no margin of its own: the best free point's chance of being the marker, never above one half
        own = np.where(rows >= 0, own, 0.5 * np.exp(np.minimum(margins, 0.0)))
        indices = np.full((len(clouds), len(self.marker_set)), NULL, dtype=np.int64)
        confidence = np.zeros(indices.shape)
        indices[:, self._markers], confidence[:, self._markers] = rows, own
        return indices, confidence, counters

    def _margins(self, clouds: Clouds, workers: int = 1, progress: Progress | None = None) -> tuple[Ints, Floats, Ints, Any]:
        frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
        xyz = upright(clouds.xyz, clouds.vertical)
        order = np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], frame_of))
        xyz = np.ascontiguousarray(xyz[order])
        place = order - clouds.offsets[frame_of]
        shape = (len(clouds), len(self._markers))
        rows, margins = np.full(shape, NULL, dtype=np.int64), np.zeros(shape)
        counters = np.zeros((len(clouds), 4), dtype=np.int64)
        parts = self._parts()

        def work(span: tuple[int, int]) -> int:
            label_clouds(xyz, clouds.offsets, *span, parts.solvers, parts.anchors, parts.body, parts.settings, rows, margins, counters)
            return span[1]

        step = max(1, min(500, -(-len(clouds) // max(1, workers))))
        spans = [(start, min(start + step, len(clouds))) for start in range(0, len(clouds), step)]
        with ThreadPoolExecutor(max(1, workers)) as pool:
            for done in pool.map(work, spans) if workers > 1 else map(work, spans):
                if progress:
                    progress(done / len(clouds), "labelling")
        spare = (rows >= 0).sum(axis=1) < clouds.counts
        given = rows >= 0
        rows[given] = place[(clouds.offsets[:-1, None] + rows)[given]]
        return rows, margins, counters, spare

    def _parts(self) -> Prepared:
        if self._prepared is None:
            settings = self._look.settings(self._usual_score)
            self._prepared = Prepared(self._anchors.solvers(), self._anchors.arrays(self._body), self._body.arrays(), settings)
        return self._prepared

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model: one NPZ file of plain arrays and a JSON text, no pickle. Written under a temporary name, then renamed."""
        path = Path(path)
        head = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "marker_set": {
                "names": self.marker_set.names,
                "title": self.marker_set.title,
                "aliases": dict(self.marker_set.aliases),
                "pairs": self.marker_set.pairs,
                "segments": dict(self.marker_set.segments),
            },
            "usual_score": self._usual_score,
            "least_confidence": self.least_confidence,
            "look": asdict(self._look),
            "about": self.about,
        }
        arrays: dict[str, Any] = {
            "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8),
            "markers": self._markers,
            "body_mean": self._body.mean,
            "body_load": self._body.load,
            "body_noise": self._body.noise,
            "body_log_weight": self._body.log_weight,
            "anchor_triples": self._anchors.triples,
            "anchor_low": self._anchors.low,
            "anchor_high": self._anchors.high,
        }
        if self._partial is not None:
            arrays |= {f"partial_{name}": array for name, array in self._partial.to_arrays().items()}
        for i, calibration in enumerate(self._calibrations):
            arrays[f"calibration_{i}"] = np.stack([calibration.margin, calibration.right])
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            with temporary.open("wb") as file:
                np.savez_compressed(file, **arrays)
            os.replace(temporary, path)
        except OSError as problem:
            raise AsterismError(f"{path} cannot be written ({problem.strerror}); choose another place.") from problem
        finally:
            temporary.unlink(missing_ok=True)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SolverEnsemble:
        """Read a model. Raises AsterismError where the file is missing, damaged, no model, or of a later version."""
        path = Path(path)
        if not path.is_file():
            raise AsterismError(f"{path} does not exist; train a model first (asterism train), or check the path.")
        try:
            with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            head = json.loads(arrays["head"].tobytes().decode())
            if head["format"] != FORMAT:
                raise AsterismError(f"{path} is no Asterism model; train one with asterism train.")
            if head["version"] > FORMAT_VERSION:
                raise AsterismError(f"{path} was written by a later Asterism (model format {head['version']}); update Asterism.")
            given = head["marker_set"]
            marker_set = MarkerSet(
                tuple(given["names"]),
                given["title"],
                {name: tuple(others) for name, others in given["aliases"].items()},
                tuple((left, right) for left, right in given["pairs"]),
                {name: tuple(members) for name, members in given["segments"].items()},
            )
            body = BodyModel(*(_finite(arrays[f"body_{part}"]) for part in ("mean", "load", "noise", "log_weight")))
            anchors = Anchors(arrays["anchor_triples"], arrays["anchor_low"], arrays["anchor_high"])
            _check_shapes(len(marker_set), arrays["markers"], body, anchors)
            calibrations = tuple(Calibration(*_finite(arrays[f"calibration_{i}"])) for i in range(2))
            partial = {name.removeprefix("partial_"): array for name, array in arrays.items() if name.startswith("partial_")}
            return cls(
                marker_set,
                arrays["markers"],
                body,
                anchors,
                float(head["usual_score"]),
                (calibrations[0], calibrations[1]),
                float(head["least_confidence"]),
                LookRules(**head["look"]),
                PartialSolvers.from_arrays(partial) if partial else None,
                dict(head["about"]),
            )
        except (OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, MemoryError) as problem:
            raise AsterismError(f"{path} is damaged or no Asterism model ({type(problem).__name__}); train it again.") from problem


def replace_parts(ensemble: SolverEnsemble, **parts: Any) -> SolverEnsemble:
    """A copy of an ensemble with some of its parts changed."""
    own = {
        "marker_set": ensemble.marker_set,
        "markers": ensemble._markers,
        "body": ensemble._body,
        "anchors": ensemble._anchors,
        "usual_score": ensemble._usual_score,
        "calibrations": ensemble._calibrations,
        "least_confidence": ensemble.least_confidence,
        "look": ensemble._look,
        "partial": ensemble._partial,
        "about": ensemble.about,
    }
    return SolverEnsemble(**{**own, **parts})


def least_confidence(target_hit_rate: float) -> float:
    """The confidence below which a label is taken back, so that about `target_hit_rate` of the labels given are right: most are far surer.

    A power law through what was measured on left-out people (docs/labelling.md): 0.80, 0.91, 0.96, 0.98 for 0.99 to 0.99999.
    """
    return 1.0 - (1.0 - target_hit_rate) ** 0.35


def _common_marker_set(recordings: Sequence[Recording]) -> MarkerSet:
    if not recordings:
        raise AsterismError("there is no recording to learn from; give at least one labelled file.")
    labels = recordings[0].labels
    for recording in recordings[1:]:
        if recording.labels != labels:
            raise AsterismError(
                f"{recording.metadata.get('file', 'a recording')} has other markers than "
                f"{recordings[0].metadata.get('file', 'the first one')}; read all of them with the same `markers`."
            )
    return MarkerSet(labels, title="the recordings' own labels")


def _renumbered(people: Ints) -> Ints:
    return np.unique(people, return_inverse=True)[1].astype(np.int64)


def _folds(people: Ints, folds: int) -> list[Any]:
    """Masks of the frames left out: by person, in at most `folds` groups; by blocks of ten frames where there is one person only."""
    count = int(people.max()) + 1
    if count > 1:
        return [people % folds == i for i in range(min(folds, count))]
    block = np.arange(len(people)) // 10
    return [block % 2 == i for i in range(2)]


def _scores_of_truth(body: BodyModel, frames: Floats, look: LookRules, rules: TrainingRules, rng: np.random.Generator) -> Floats:
    """Score per label, in nats, of rightly labelled frames of people left out, some of their markers hidden."""
    arrays, settings = body.arrays(), look.settings(0.0)
    scores = []
    for frame in frames[rng.choice(len(frames), min(300, len(frames)), replace=False)]:
        shown = ~np.isnan(frame[:, 0]) & (rng.random(len(frame)) >= rules.usually_hidden)
        if shown.sum() >= 3:
            rows = np.where(shown, np.cumsum(shown) - 1, NULL)
            room = make_room(int(shown.sum()), len(rows), arrays.load.shape[3])
            scores.append(best_pose(arrays, np.ascontiguousarray(frame[shown]), rows, settings, room)[1] / shown.sum())
    return np.array(scores)


def _trial(ensemble: SolverEnsemble, frames: Floats, people: Ints, rules: TrainingRules, seed: int) -> tuple[Floats, Any, Any]:
    """Hide and haunt left-out frames and label them: margins, rightness and whether points were left over, of all labels given."""
    rng = np.random.default_rng(seed)
    margins, rights, spares = [], [], []
    rows_of = subsample(people, rules.trial_frames)
    labels = tuple(str(m) for m in range(frames.shape[1]))
    for share, ghosts in rules.trials:
        recording = Recording(frames[rows_of], labels, 100.0)
        clouds, truth = hide_and_haunt(recording, round(share * len(labels)), ghosts, rng)
        rows, margin, _, spare = ensemble._margins(clouds)
        given = rows >= 0
        margins.append(margin[given])
        rights.append((rows == truth)[given])
        spares.append(np.repeat(spare, given.sum(axis=1)))
    return np.concatenate(margins), np.concatenate(rights), np.concatenate(spares)


def _finite(array: Floats) -> Floats:
    if not np.isfinite(array).all():
        raise ValueError("not finite")
    return array


def _check_shapes(names: int, markers: Ints, body: BodyModel, anchors: Anchors) -> None:
    poses, count, axes, latents = body.load.shape
    good = (
        body.mean.shape == (poses, count, 3)
        and body.noise.shape == (poses, count, 3, 3)
        and body.log_weight.shape == (poses,)
        and markers.shape == (count,)
        and axes == 3
        and latents > 0
        and anchors.triples.ndim == 2
        and anchors.triples.shape[1] == 3
        and anchors.low.shape == anchors.high.shape == (len(anchors.triples), 6)
        and markers.min() >= 0
        and markers.max() < names
        and anchors.triples.min() >= 0
        and anchors.triples.max() < count
    )
    if not good:
        raise ValueError("shapes disagree")
