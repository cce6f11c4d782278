"""Long recordings are labelled in stretches as they are labelled whole; tracklets keep one name over the seams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from models import trained

from asterism import MarkerModel
from asterism.labelling.stretches import StretchRules, join_verdicts, label_long, stretches
from asterism.progress import Progress
from asterism.recording import Clouds, Labelling, Recording
from asterism.recording.verdict import FITS, OTHER_BODY, Verdict
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks

FRAMES = 1200
OVERLAP = 100
NAMES = ("A", "B", "C")
RATE = 100.0


@pytest.fixture(scope="module")
def ensemble() -> MarkerModel:
    walks = simulate_walks(4, 300, seed=5)
    return trained(walks[1:], subjects=["a", "b", "c"])


@pytest.fixture(scope="module")
def walk() -> Recording:
    (walk,) = simulate_walks(1, 300, seed=5)
    there_and_back = np.concatenate([walk.positions, walk.positions[::-1]])
    return Recording(np.tile(there_and_back, (FRAMES // 600, 1, 1)), walk.labels, RATE, walk.vertical)


def in_stretches(ensemble: MarkerModel, clouds: Clouds, frames: int) -> Labelling:
    """The labels in stretches of so many frames."""
    return by_rules(ensemble, clouds, StretchRules(1, round(frames * len(clouds.xyz) / len(clouds)), OVERLAP / RATE))


def by_rules(ensemble: MarkerModel, clouds: Clouds, rules: StretchRules, progress: Progress | None = None) -> Labelling:
    """The labels in stretches by these rules."""
    return label_long(ensemble.label_one_body, ensemble.marker_set.names, clouds, rules, progress=progress)


@pytest.mark.parametrize(
    ("frames", "length", "overlap"), [(2400, 600, 100), (601, 600, 100), (700, 300, 2), (600, 600, 50), (5000, 401, 200)]
)
def test_stretches_cover_all_frames_and_share_some(frames: int, length: int, overlap: int) -> None:
    parts = stretches(frames, length, overlap)
    assert parts[0].start == 0
    assert parts[-1].stop == frames
    assert all(part.stop - part.start <= length for part in parts)
    assert all(overlap <= before.stop - after.start <= overlap + 2 for before, after in pairwise(parts))
    assert max(part.stop - part.start for part in parts) - min(part.stop - part.start for part in parts) <= 2


@pytest.mark.parametrize(
    ("ghosts", "length"), [(0, 300), (1, 300), (0, FRAMES - 1)], ids=["gaps", "a ghost", "one frame more than a stretch"]
)
def test_stretches_give_the_labels_of_the_whole(ensemble: MarkerModel, walk: Recording, ghosts: int, length: int) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walk, 2, ghosts, seed=3)
    whole, found = ensemble.label(clouds), in_stretches(ensemble, clouds, length)
    right, right_in_stretches = ((one.indices == truth)[truth >= 0].mean() for one in (whole, found))
    assert right > 0.99
    assert right - right_in_stretches <= 0.001, f"{right:.4f} right as a whole, {right_in_stretches:.4f} in stretches"
    assert ((found.indices >= 0) & (found.indices != truth)).mean() <= ((whole.indices >= 0) & (whole.indices != truth)).mean() + 0.001
    assert found.verdict is not None
    assert found.verdict.fits
    assert found == in_stretches(ensemble, clouds, length)


def test_a_marker_hidden_at_the_seam_is_found_on_both_sides(ensemble: MarkerModel, walk: Recording) -> None:
    positions = walk.positions.copy()
    (part, after, *_) = stretches(FRAMES, 600, OVERLAP)
    seam = (after.start + part.stop) // 2
    positions[seam - 20 : seam + 20, 4] = np.nan
    recording = Recording(positions, walk.labels, RATE, walk.vertical)
    clouds = recording.clouds()
    found = in_stretches(ensemble, clouds, 600).positions(clouds)
    np.testing.assert_array_equal(found[part.start : after.stop], positions[part.start : after.stop])


def test_a_person_who_leaves_at_a_seam_takes_the_labels_along(ensemble: MarkerModel, walk: Recording) -> None:
    positions = walk.positions.copy()
    (part, after, *_) = stretches(FRAMES, 600, OVERLAP)
    seam = (after.start + part.stop) // 2
    positions[seam:] = np.nan
    clouds = Recording(positions, walk.labels, RATE, walk.vertical).clouds()
    usual = len(walk.labels)
    found = by_rules(ensemble, clouds, StretchRules(whole=1, points=round(600 * usual * seam / FRAMES), overlap=OVERLAP / RATE))
    np.testing.assert_array_equal(found.positions(clouds), positions)
    assert found.verdict is not None
    assert found.verdict.labelled == 1.0, "the stretches without a person do not count"


@dataclass
class Scripted:
    """A model that labels as a test says: a function from the clouds' first x to the labels and their confidence."""

    says: Callable[[Clouds], tuple[list[int], float]]

    def __call__(self, clouds: Clouds, progress: Progress | None = None) -> Labelling:
        """Each frame's points, which keep their order, under the names given."""
        markers, confidence = self.says(clouds)
        shape = (len(clouds), 3)
        indices, certain, blank = np.full(shape, -1), np.zeros(shape), np.full(shape, -1)
        for point, marker in enumerate(markers):
            if marker >= 0:
                indices[:, marker], certain[:, marker] = point, confidence
        return Labelling(indices, certain, NAMES, blank)


def two_paths() -> Clouds:
    """Two markers a metre apart that move evenly; the frame's number is their x in millimetres."""
    x = np.arange(1000) * 1e-3
    positions = np.zeros((1000, 2, 3))
    positions[:, :, 0] = x[:, None]
    positions[:, 1, 1] = 1.0
    return Recording(positions, ("*1", "*2"), RATE).clouds()


@pytest.mark.parametrize(("later", "wanted"), [(0.9, 0), (0.99, 1)], ids=["the first is more certain", "the second is"])
def test_a_tracklet_over_a_seam_keeps_the_name_of_the_more_certain_stretch(later: float, wanted: int) -> None:
    def says(clouds: Clouds) -> tuple[list[int], float]:
        return ([0, 1], 0.95) if clouds.xyz[0, 0] == 0.0 else ([1, 0], later)

    clouds = two_paths()
    found = label_long(Scripted(says), NAMES, clouds, StretchRules(whole=1, points=1200, overlap=0.9))
    names = found.indices[:, 0]
    assert (names == wanted).all(), "point 0 or 1 is A throughout"
    assert (found.indices[:, 1] == 1 - wanted).all()
    assert found.confidence.max() == pytest.approx(min(0.95, later))


def test_candidates_of_all_stretches_are_kept_but_for_names_that_changed() -> None:
    def says(clouds: Clouds) -> tuple[list[int], float]:
        return ([0, -1], 0.95) if clouds.xyz[0, 0] == 0.0 else ([1, 2], 0.9)

    class WithCandidates(Scripted):
        def __call__(self, clouds: Clouds, progress: Progress | None = None) -> Labelling:
            given = super().__call__(clouds)
            return Labelling(given.indices, given.confidence, given.names, np.where(given.indices >= 0, 7, 5))

    found = label_long(WithCandidates(says), NAMES, two_paths(), StretchRules(whole=1, points=1200, overlap=0.9))
    assert found.candidates is not None
    assert (found.indices[:, 0] == 0).all()
    assert (found.indices[600:, 1] == -1).all()
    assert (found.candidates[600:, 1] == -1).all(), "B was taken back: what proposed it is no candidate"
    assert (found.candidates[600:, 2] == 7).all()
    assert (found.candidates[:500, 1] == 5).all()


def test_progress_of_the_stretches_is_that_of_the_recording(ensemble: MarkerModel, walk: Recording) -> None:
    said = list[float]()
    clouds = walk.clouds()
    rules = StretchRules(whole=1, points=800 * len(walk.labels), overlap=OVERLAP / RATE)
    by_rules(ensemble, clouds, rules, progress=lambda fraction, _: said.append(fraction))
    assert said == sorted(said), "it never goes back"
    assert 0.9 < said[-1] <= 1.0


def test_a_name_that_is_held_is_not_given_twice() -> None:
    def says(clouds: Clouds) -> tuple[list[int], float]:
        return ([0, -1], 0.95) if clouds.xyz[0, 0] == 0.0 else ([1, 0], 0.9)

    clouds = two_paths()
    found = label_long(Scripted(says), NAMES, clouds, StretchRules(whole=1, points=1200, overlap=0.9))
    parts = stretches(1000, 600, 90)
    seam = (parts[1].start + parts[0].stop) // 2
    assert (found.indices[:seam, 0] == 0).all()
    assert (found.indices[seam:, 0] == 1).all(), "the second stretch's own A stays"
    assert (found.indices[seam:, 1] == -1).all(), "what was B there is A by the first stretch, and gets no name"


def test_the_verdict_of_most_labels_counts() -> None:
    fits, other = Verdict(FITS, 0.01, 0.06, 1.0, 1.0, 0.0), Verdict(OTHER_BODY, 0.5, 0.06, 1.0, 0.1, 5.0, (("A", "B"),))
    assert join_verdicts([]) is None
    assert join_verdicts([(9000, replace(fits, rough=3)), (10, replace(fits, rough=4))]) == replace(fits, rough=7)
    assert join_verdicts([(9000, fits), (10, other)]) == Verdict(FITS, 0.01, 0.06, 1.0, 1.0, 0.0, (("A", "B"),))
    joined = join_verdicts([(10, fits), (9000, other)])
    assert joined is not None
    assert joined.kind == OTHER_BODY


def test_short_recordings_are_labelled_as_a_whole(ensemble: MarkerModel, walk: Recording) -> None:
    clouds = walk.clouds().frames(slice(0, 200))
    assert label_long(ensemble.label_one_body, ensemble.marker_set.names, clouds) == ensemble.label(clouds)
