"""The solver ensemble: labelled recordings in; a model that labels anonymous clouds, with calibrated confidence, out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.body.anchors import Anchors
from asterism.labelling.body.labeller import BodyLabeller, FrameLabellingSettings
from asterism.labelling.body.model import BodyModel, BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.solver import subject_of
from asterism.labelling.partial.solver_search import SearchSettings, search_partial_solvers
from asterism.labelling.training.calibration import Calibration
from asterism.labelling.training.learning import (
    TrainingConfig,
    TrainingRules,
    TrainingState,
    common_marker_set,
    learn_body,
    least_confidence,
)
from asterism.labelling.training.model_file import reading, write_arrays
from asterism.labelling.training.sample import Sample
from asterism.labelling.whole.bodies import check_for_one
from asterism.labelling.whole.certainty import STEEP, Certainty
from asterism.labelling.whole.label import BodyInRecording, label_whole, own_body_gain, subject_body
from asterism.labelling.whole.scene import TimeRules
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, MarkerSet, Recording

if TYPE_CHECKING:
    from asterism.labelling.live.stream import Stream

ANOTHER_PERSON = 0.2
"""`subject_fit` of walks of walks: 0.27 to 0.41 after the own standing trial, below 0.2 after 96 % of other people's (gait subjects)."""

RULES = ("whole-body", "partial-solvers", "thesis")


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
        look: FrameLabellingSettings,
        partial: PartialSolvers | None,
        about: dict[str, Any],
        memory: TrainingState | None = None,
        in_time: Certainty | None = None,
        general: BodyModel | None = None,
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
        self._memory = memory
        self._in_time = in_time or Certainty(calibrations, least_confidence)
        self._general = general
        self._prepared: BodyLabeller | None = None

    @classmethod
    def fit(
        cls,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        target_hit_rate: float = 0.999,
        miner: str | None = None,
        features: Sequence[str] | None = None,
        subjects: Sequence[str] | None = None,
        marker_set: MarkerSet | None = None,
        body_rules: BodyRules | None = None,
        look: FrameLabellingSettings | None = None,
        training: TrainingRules | None = None,
        progress: Progress | None = None,
    ) -> SolverEnsemble:
        """Learn from labelled recordings that share their labels (read with `markers=`).

        subjects: whose recording each is; by default what the recordings' metadata says, else their folder. Confidence is
        calibrated on people left out in turn, so more people make it honest. `miner` ("bottom-up", "top-down" or "genetic")
        also searches the partial solvers that the rules "partial-solvers" and "thesis" need; that takes most of the training's time.
        `features` names what they read (`features.FEATURES`, those of motion among them; by default `solver_search.FEATURES`, of single
        frames), and asks for them: the miner is then "bottom-up" where it is None.
        The same recordings and seed give the same model, bit for bit.
        Raises AsterismError where there is nothing to learn from, or the recordings' labels differ.
        """
        named = None if features is None else tuple(features)
        miner = "bottom-up" if miner is None and named is not None else miner
        recipe = TrainingConfig(
            seed, target_hit_rate, miner, body_rules or BodyRules(), look or FrameLabellingSettings(), training or TrainingRules(), named
        )
        marker_set = marker_set or common_marker_set(recordings)
        memory = TrainingState(Sample(), recipe).with_recordings(recordings, subjects, marker_set)
        return cls._from_training(marker_set, memory, progress or _silent)

    def learn(
        self,
        recordings: Sequence[Recording],
        *,
        subjects: Sequence[str] | None = None,
        search_again: bool = False,
        progress: Progress | None = None,
    ) -> SolverEnsemble:
        """A new ensemble that has learned these labelled recordings, too; this one stays as it is.

        The model carries a sample of what it was trained on, so the old files are not needed: learning is training on all that was ever
        given, and the order in which it came does not matter, bit for bit. A recording given twice counts once. Recordings may lack
        markers, and be of new people or of known ones (`subjects`, one name each; by default as for `fit`). The confidence is calibrated
        anew on people left out, so a model of one person becomes honest as people come in. Partial solvers stay as they were found,
        unless `search_again`, which takes as long as it did in `fit`.
        Raises AsterismError where there is nothing to learn from, a recording has none of the markers, the model was written by an
        Asterism that kept no sample, or `search_again` is given and the model was trained without partial solvers.
        """
        if self._memory is None:
            raise AsterismError("this model was written by an earlier Asterism and keeps nothing to learn on from; train it again.")
        if search_again and self._memory.recipe.miner is None:
            raise AsterismError("this model was trained without partial solvers; train it again with --miner bottom-up to add them.")
        memory = self._memory.with_recordings(recordings, subjects, self.marker_set)
        searched_before = None if search_again else self
        return self._from_training(self.marker_set, memory, progress or _silent, searched_before)

    @classmethod
    def _from_training(
        cls, marker_set: MarkerSet, memory: TrainingState, progress: Progress, searched_before: SolverEnsemble | None = None
    ) -> SolverEnsemble:
        """All that follows from a memory; partial solvers are taken over from `searched_before`, where given."""
        recipe = memory.recipe
        markers, mined, people, stretches = memory.training_frames()
        frames = np.ascontiguousarray(mined[..., :3])
        mining = recipe.miner is not None and searched_before is None
        share = 0.5 if mining else 1.0
        learned = learn_body(frames, people, stretches, recipe, lambda fraction, what: progress(share * fraction, what))
        about = {
            "seed": recipe.seed,
            "target_hit_rate": recipe.target_hit_rate,
            "miner": recipe.miner,
            "features": None if recipe.features is None else list(recipe.features),
            "subjects": list(memory.sample.subjects),
            "recordings": len(memory.sample.recordings),
            "frames": len(frames),
        }
        partial = None
        if mining:
            partial = search_partial_solvers(
                mined,
                people,
                features=recipe.features,
                targets=recipe.target_hit_rate,
                miner=str(recipe.miner),
                settings=SearchSettings(widen=recipe.training.solver_widen),
                seed=recipe.seed,
                progress=lambda fraction, what: progress(0.5 + 0.5 * fraction, what),
            )
            about["mined_from"] = about["recordings"]
        elif searched_before is not None and searched_before._partial is not None:
            # they know the markers by their place among those seen before
            partial = searched_before._partial if np.array_equal(markers, searched_before._markers) else None
            about["mined_from"] = searched_before.about.get("mined_from", 0) if partial is not None else 0
        progress(1.0, "done")
        return cls(
            marker_set,
            markers,
            learned.body,
            learned.anchors,
            learned.usual_score,
            learned.calibrations,
            least_confidence(recipe.target_hit_rate),
            recipe.look,
            partial,
            about,
            memory,
            learned.in_time,
        )

    def adapt(self, static: Recording) -> SolverEnsemble:
        """A new ensemble for one subject: its body model narrowed to this person's by one recording, usually of the person standing.

        static: labelled with at least half of the model's markers, else it is labelled first, as a whole recording. Markers may be
        missing. Raises AsterismError where too little is seen or the labels fit no body that the model knows.
        """
        columns = self.marker_set.columns_of(static.labels)[self._markers]
        if (columns >= 0).sum() >= 0.5 * len(columns):
            frames = np.where(columns[:, None] >= 0, static.positions[:, columns], np.nan)
        else:
            clouds = static.clouds()
            frames = self.label(clouds, time=True).positions(clouds)[:, self._markers]
        frames = rotate_z_up(frames, static.vertical)
        body_rules = BodyRules() if self._memory is None else self._memory.recipe.body
        settings = self._parts().settings
        body = subject_body(settings, self._body, frames, static.rate, SubjectRules(), body_rules)
        gain = own_body_gain(settings, body, self._body, frames, static.rate, SubjectRules())
        return replace_parts(
            self, body=body, general=self._body, about={**self.about, "adapted_to": subject_of(static), "adapted_gain": gain}
        )

    def subject_fit(self, clouds: Clouds, labelling: Labelling) -> float:
        """How far these labels speak for the subject that this ensemble was adapted to.

        1 if the subject's body explains them as much better than people at large do as it explains the recording that it was adapted
        by; below `ANOTHER_PERSON` it is someone else, or the markers were placed anew. NaN where the ensemble is not adapted, or no
        frame shows enough labelled markers.
        """
        if self._general is None:
            return float("nan")
        frames = rotate_z_up(labelling.positions(clouds)[:, self._markers], clouds.vertical)
        gain = own_body_gain(self._parts().settings, self._body, self._general, frames, clouds.rate, SubjectRules())
        return gain / max(float(self.about["adapted_gain"]), 1.0)

    def label(
        self,
        clouds: Clouds,
        *,
        time: bool = False,
        rules: str = "whole-body",
        workers: int = 1,
        progress: Progress | None = None,
    ) -> Labelling:
        """Say of every frame which candidate is which marker.

        clouds: T frames. Gives indices (T, M), -1 where it does not know, and confidence (T, M). Without `time` each frame stands alone.
        With it the recording is labelled as a whole: its points are linked to tracklets (`clouds.tracks` help, and are cut where they
        swap), the tracklets are labelled together, and the surely labelled ones adapt the model to the body at hand
        (`labelling/tracks`). The result does not depend on the order of the points, nor on `workers`. O(T); a frame of n points costs
        O(n M) beyond the search, which has a budget. Raises AsterismError where `time` is asked of other rules than "whole-body", and its
        kind SeveralBodies where whole recordings surely show two people with these markers: see `label_together`.
        """
        if time:
            if rules != "whole-body":
                raise AsterismError(f"whole recordings are labelled by the rules whole-body, not {rules}; leave out time or the rules.")
            check_for_one(self._parts(), clouds)
            return label_together([self], clouds, workers=workers, progress=progress)[0]
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
            raise AsterismError(
                f"this model has no partial solvers, which the rules {rules!r} need; train it again with --miner bottom-up."
            )
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
        return self._parts().label(clouds, workers, progress)

    def _parts(self) -> BodyLabeller:
        if self._prepared is None:
            self._prepared = BodyLabeller.from_model(self._body, self._anchors, self._look.with_usual_score(self._usual_score))
        return self._prepared

    def stream(self, rate: float, delay: int = 0, vertical: ArrayLike | str = "z") -> Stream:
        """A labeller for live points: `stream.push(points)` gives the labels of the frame `delay` pushes ago.

        rate: frames per second; delay: frames to wait for, which make the labels surer; vertical: the axis that points up.
        Raises AsterismError where one of them makes no sense.
        """
        from asterism.labelling.live.body import LiveBody, LiveRules
        from asterism.labelling.live.stream import Stream

        body_rules = BodyRules() if self._memory is None else self._memory.recipe.body
        live = None if self._body.within is None else LiveBody(self._body, body_rules, rate, LiveRules())
        model = (self._parts(), live, self._markers, len(self.marker_set))
        return Stream(*model, self._calibrations, self.least_confidence, rate, delay, vertical)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model: one NPZ file of plain arrays and a JSON text, no pickle. Written under a temporary name, then renamed."""
        head: dict[str, Any] = {
            "marker_set": {
                "names": self.marker_set.names,
                "title": self.marker_set.title,
                "aliases": dict(self.marker_set.aliases),
                "pairs": self.marker_set.pairs,
                "segments": dict(self.marker_set.segments),
            },
            "usual_score": self._usual_score,
            "least_confidence": self.least_confidence,
            "least_confidence_in_time": self._in_time.least_confidence,
            "steep_in_time": self._in_time.steep,
            "look": asdict(self._look),
            "about": self.about,
            "recipe": None if self._memory is None else self._memory.recipe.to_dict(),
        }
        arrays: dict[str, Any] = {
            "markers": self._markers,
            **{f"body_{name}": array for name, array in self._body.to_arrays().items()},
            "anchor_triples": self._anchors.triples,
            "anchor_low": self._anchors.low,
            "anchor_high": self._anchors.high,
        }
        if self._partial is not None:
            arrays |= {f"partial_{name}": array for name, array in self._partial.to_arrays().items()}
        for i, calibration in enumerate(self._calibrations):
            arrays[f"calibration_{i}"] = np.stack([calibration.margin, calibration.right])
        for i, calibration in enumerate(self._in_time.calibrations):
            arrays[f"time_calibration_{i}"] = np.stack([calibration.margin, calibration.right])
        if self._general is not None:
            arrays |= {f"general_{name}": array for name, array in self._general.to_arrays().items()}
        if self._memory is not None:
            arrays |= {f"sample_{name}": array for name, array in self._memory.sample.to_arrays().items()}
        write_arrays(path, head, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SolverEnsemble:
        """Read a model. Raises AsterismError where the file is missing, damaged, no model, or of a later version."""
        with reading(path) as (head, arrays):
            given = head["marker_set"]
            marker_set = MarkerSet(
                tuple(given["names"]),
                given["title"],
                {name: tuple(others) for name, others in given["aliases"].items()},
                tuple((left, right) for left, right in given["pairs"]),
                {name: tuple(members) for name, members in given["segments"].items()},
            )
            body = _body(arrays, "body_")
            anchors = Anchors(arrays["anchor_triples"], arrays["anchor_low"], arrays["anchor_high"])
            _check_shapes(len(marker_set), arrays["markers"], body, anchors)
            calibrations = _two_curves(arrays, "calibration")
            in_time = None
            if "time_calibration_0" in arrays:
                least, steep = float(head["least_confidence_in_time"]), float(head.get("steep_in_time", STEEP))
                in_time = Certainty(_two_curves(arrays, "time_calibration"), least, steep)
            partial, sample = (
                {name.removeprefix(part): array for name, array in arrays.items() if name.startswith(part)}
                for part in ("partial_", "sample_")
            )
            memory = (
                TrainingState(Sample.from_arrays(sample, len(marker_set)), TrainingConfig.from_dict(head["recipe"])) if sample else None
            )
            return cls(
                marker_set,
                arrays["markers"],
                body,
                anchors,
                float(head["usual_score"]),
                calibrations,
                float(head["least_confidence"]),
                FrameLabellingSettings.from_dict(head["look"]),
                PartialSolvers.from_arrays(partial) if partial else None,
                dict(head["about"]),
                memory,
                in_time,
                _body(arrays, "general_") if "general_mean" in arrays else None,
            )


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
        "memory": ensemble._memory,
        "in_time": ensemble._in_time,
        "general": ensemble._general,
    }
    return SolverEnsemble(**{**own, **parts})


def label_together(
    ensembles: Sequence[SolverEnsemble], clouds: Clouds, *, workers: int = 1, progress: Progress | None = None
) -> list[Labelling]:
    """Label a recording with several bodies in it: one labelling per ensemble, each point given to one of them at most.

    clouds: T frames. An ensemble may be given twice, for two people who wear the same markers. Whole recordings only: see
    `SolverEnsemble.label` with `time`.
    """
    members = [BodyInRecording(e._parts(), e.marker_set.names, e._markers, e._in_time) for e in ensembles]
    body_rules = next((e._memory.recipe.body for e in ensembles if e._memory is not None), BodyRules())
    return label_whole(members, clouds, TimeRules(), SubjectRules(), body_rules, workers, progress)[0]


def _body(arrays: dict[str, Any], prefix: str) -> BodyModel:
    parts = {name.removeprefix(prefix): _finite(array) for name, array in arrays.items() if name.startswith(prefix)}
    return BodyModel(**parts)


def _two_curves(arrays: dict[str, Any], name: str) -> tuple[Calibration, Calibration]:
    return Calibration(*_finite(arrays[f"{name}_0"])), Calibration(*_finite(arrays[f"{name}_1"]))


def _silent(fraction: float, what: str) -> None:
    pass


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
        and (body.within is None or body.within.shape == (poses, 3 * count, 3 * count))
        and (body.between is None or body.between.shape == (poses, 3 * count, 3 * count))
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
