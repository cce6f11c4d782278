"""What carries the labelling of a whole recording: the same clouds, labelled with ever more of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import asterism
from asterism.labelling.body.model import BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.whole.label import label_whole
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import gait
from benchmarks.figures import Figure
from benchmarks.recordings.gaps import GAPS, Tallies, summed
from benchmarks.recordings.walks import samples, standing, unseen_model
from benchmarks.score import Tally


@dataclass(frozen=True)
class Case:
    """A subject left out: the ensemble of the others, and the same after it has seen the subject's standing trial."""

    ensemble: asterism.MarkerModel
    adapted: asterism.MarkerModel


def uncalibrated(case: Case, clouds: Clouds) -> Labelling:
    """The whole recording with the model as it was trained: neither its body nor its distances are learned from the recording."""
    one = case.ensemble
    member = one.in_recording()
    return label_whole([member], clouds, RecordingLabellingSettings(adapt_rounds=0, deviation_cost=0.0), SubjectRules(), BodyRules())[0][0]


METHODS: tuple[tuple[str, Callable[[Case, Clouds], Labelling]], ...] = (
    ("frame only", lambda case, clouds: case.ensemble.label_frames(clouds)),
    ("+ tracks", lambda case, clouds: by_majority(case.ensemble.label_frames(clouds), clouds)),
    ("+ all tracks at once", uncalibrated),
    ("+ own calibration", lambda case, clouds: case.ensemble.label(clouds)),
    ("+ static trial", lambda case, clouds: case.adapted.label(clouds)),
)
"""Each does what the one above it does, and more."""


def ablation(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Right and wrong by method and condition, over every second subject of those that have a standing trial."""
    subjects = [subject for subject in gait() if standing(subject)][:: 9 if benchmark.quick else 2]
    for (condition, method), tally in summed(benchmark.each(_left_out, subjects)).items():
        yield tally.figure(f"ablation, {method}, {condition}: right", "none", tally.right_share)
        yield tally.figure(f"ablation, {method}, {condition}: wrong", "none", tally.false_assignments)


def _left_out(benchmark: BenchmarkRun, subject: str) -> Tallies:
    ensemble, tallies = unseen_model(benchmark, subject), defaultdict(Tally)
    case = Case(ensemble, ensemble.adapt(standing(subject)))
    for name, condition in GAPS.items():
        for one in samples(benchmark, subject, condition, seeds=1):
            for method, label in METHODS:
                tallies[name, method].add(label(case, one.clouds), one.truth)
    told = (f"{c}, {m} {tally.right_share:.5f}" for (c, m), tally in tallies.items())
    benchmark.report(f"{subject} left out: {'; '.join(told)}")
    return dict(tallies)


def by_majority(labelling: Labelling, clouds: Clouds) -> Labelling:
    """The frames of each track vote, by their confidence; a marker that won more than half of the track's frames gets all of them.

    Where two tracks that share a frame won the same marker, the one with more votes keeps it and the other is left without a label.
    """
    frame_of, track_of = np.repeat(np.arange(len(clouds)), clouds.counts), clouds.tracks
    assert track_of is not None
    place = np.arange(len(clouds.xyz)) - clouds.offsets[frame_of]
    lengths = np.bincount(track_of)
    votes = _votes(labelling, clouds, track_of, len(lengths))
    winner = votes.argmax(axis=1)
    indices, confidence = np.full(labelling.indices.shape, NULL, dtype=np.int64), np.zeros(labelling.confidence.shape)
    points_of = np.split(np.argsort(track_of, kind="stable"), np.cumsum(lengths)[:-1])
    for track in np.argsort(-votes.max(axis=1), kind="stable"):
        marker, points = winner[track], points_of[track]
        share = votes[track, marker] / lengths[track]
        if share > 0.5 and (indices[frame_of[points], marker] == NULL).all():
            indices[frame_of[points], marker] = place[points]
            confidence[frame_of[points], marker] = share
    return Labelling(indices, confidence, labelling.names)


def _votes(labelling: Labelling, clouds: Clouds, track_of: Ints, tracks: int) -> Floats:
    """(tracks, M) the confidence of each marker's labels on each track, summed over the frames."""
    frames, markers = np.nonzero(labelling.indices >= 0)
    points = clouds.offsets[frames] + labelling.indices[frames, markers]
    votes = np.zeros((tracks, labelling.indices.shape[1]))
    np.add.at(votes, (track_of[points], markers), labelling.confidence[frames, markers])
    return votes
