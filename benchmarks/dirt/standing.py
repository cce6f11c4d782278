"""Adults who stand, labelled by a model of children: whose whole body is turned round, and surely so.

Standing people look alike from the front and from behind. The real ones are the standing trials of other laboratories that have all
markers of the set; the simulated ones are adults of other proportions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Labelling, MarkerSet, Recording
from asterism.simulation import simulate_gaps_and_ghosts, simulate_standing
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder, gait, has_recordings, people_and_trials, true_names, with_columns
from benchmarks.figures import Figure
from benchmarks.recordings.walks import label_whole

WORDS = ("static", "anat_pose")
"""What the names of files say that show a standing person."""
LONGEST, SURE, SIMULATED = 200, 0.99, 60
LEAST = 12
"""Markers of the 15 that a real trial must show: some lack the knees' or the sacrum's."""


@dataclass
class Count:
    """People, those most of whose labels are wrong, labels, and labels that are sure and wrong."""

    people: int = 0
    turned: int = 0
    labels: int = 0
    wrong: int = 0
    sure_and_wrong: int = 0

    def add(self, labelling: Labelling, truth: np.ndarray) -> None:
        """Count one person's labels (T, M)."""
        given = labelling.indices >= 0
        wrong = given & (labelling.indices != truth)
        self.people += 1
        self.turned += int(2 * wrong.sum() > given.sum())
        self.labels += int((truth >= 0).sum())
        self.wrong += int(wrong.sum())
        self.sure_and_wrong += int((wrong & (labelling.confidence >= SURE)).sum())


def standing(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A model of all children labels adults who stand, every marker in view and with three hidden."""
    people, recordings = people_and_trials(gait())
    ensemble = benchmark.fit(recordings, people)
    simulated = simulate_standing(10 if benchmark.quick else SIMULATED, 60, seed=77)
    for name, trials in (("simulated adults", simulated), ("real adults", list(real_standing(ensemble.marker_set)))):
        count = Count()
        for number, trial in enumerate(trials):
            for hidden in (0, 3):
                clouds, truth = simulate_gaps_and_ghosts(trial, hidden, 0, seed=number)
                count.add(label_whole(ensemble, clouds, truth), truth)
        if count.people:
            row = f"standing, {name} by a model of children"
            yield Figure(f"{row}: mostly wrong", "<= 0", count.turned, "recordings", count.people)
            yield Figure(f"{row}: labels sure and wrong", "<= 0", count.sure_and_wrong, "labels", count.labels)
            yield Figure(f"{row}: wrong", "none", count.wrong / count.labels, "fraction", count.labels)


def real_standing(markers: MarkerSet) -> Iterator[Recording]:
    """The standing trials of other laboratories with nearly all markers of the set: frames in which all of these are seen.

    The middle of the two markers of the posterior iliac spines stands for a sacral marker that a trial lacks.
    """
    if not has_recordings():
        return
    for place in ("movement", "gait-events"):
        for path in sorted((folder() / place).rglob("*")):
            if path.suffix in (".c3d", ".trc") and any(word in path.stem.lower() for word in WORDS):
                try:
                    trial = _with_sacrum(true_names(path), markers)
                except AsterismError:
                    continue  # another set of markers, or a file that names none
                worn = trial.visible.any(axis=0)
                whole = np.nonzero(trial.visible[:, worn].all(axis=1))[0][:LONGEST]
                if len(whole) and worn.sum() >= LEAST:
                    yield trial.frames(whole)


def _with_sacrum(recording: Recording, markers: MarkerSet) -> Recording:
    spines = [recording.labels.index(name) for name in ("LPSI", "RPSI") if name in recording.labels]
    own = with_columns(recording, markers)
    if "SACR" in own.labels and len(spines) == 2 and not own.visible[:, own.labels.index("SACR")].any():
        positions = own.positions.copy()
        positions[:, own.labels.index("SACR")] = recording.positions[:, spines].mean(axis=1)
        own = replace(own, positions=positions)
    return own
