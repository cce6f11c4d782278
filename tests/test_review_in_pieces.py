"""What should be checked in a recording that is reviewed piece by piece is what should be checked in all of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import trained

from asterism.labelling import review
from asterism.labelling.correction.readiness import readiness, to_look_at
from asterism.labelling.review_in_pieces import ReviewInPieces
from asterism.recording import NULL, Clouds, Labelling
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from asterism.tracking.linking import find_tracklets


@cache
def labelled() -> tuple[Clouds, Labelling]:
    walks = simulate_walks(4, 300, seed=5)
    clouds, _ = simulate_gaps_and_ghosts(walks[0], 2, 1, seed=3)
    return clouds, trained(walks[1:], subjects=["a", "b", "c"]).label(clouds)


def in_pieces(labelling: Labelling, clouds: Clouds, seams: list[int]) -> ReviewInPieces:
    found, ends = ReviewInPieces(labelling.names), [0, *sorted(seams), len(clouds)]
    for begin, end in itertools.pairwise(ends):
        some = slice(begin, end)
        candidates = None if labelling.candidates is None else labelling.candidates[some]
        part = replace(labelling, indices=labelling.indices[some], confidence=labelling.confidence[some], candidates=candidates)
        found.add(part, clouds.frames(some))
    return found


def without_names(labelling: Labelling, clouds: Clouds, seam: int, rng: np.random.Generator, share: float) -> Labelling:
    """Some of the tracklets that cross a seam lose their names before it."""
    indices, confidence = labelling.indices.copy(), labelling.confidence.copy()
    of_point = find_tracklets(clouds).of_point
    here = of_point[clouds.offsets[seam] : clouds.offsets[seam + 1]]
    lost = np.isin(of_point, here[rng.random(len(here)) < share])
    frame, marker = np.nonzero(indices[:seam] >= 0)
    gone = lost[clouds.offsets[frame] + indices[frame, marker]]
    indices[frame[gone], marker[gone]], confidence[frame[gone], marker[gone]] = NULL, 0.0
    return replace(labelling, indices=indices, confidence=confidence, candidates=None)


@settings(max_examples=20)
@given(st.integers(20, 280), st.integers(0, 2**31), st.sampled_from([0.0, 0.3, 1.0]))
def test_a_seam_does_not_change_what_should_be_checked(seam: int, seed: int, share: float) -> None:
    clouds, labelling = labelled()
    labelling = without_names(labelling, clouds, seam, np.random.default_rng(seed), share)
    whole, found = review(labelling, clouds), in_pieces(labelling, clouds, [seam]).items()
    assert readiness(labelling, clouds, found).words == readiness(labelling, clouds, whole).words
    pieces = {(item.first_frame, item.last_frame, item.marker): item.gain for item in found}
    for item in to_look_at(whole):
        assert pieces[item.first_frame, item.last_frame, item.marker] == pytest.approx(item.gain, rel=0.1)


@pytest.mark.parametrize("seams", [[100, 101, 102], [10, 100, 250], [299]], ids=["pieces of one frame", "four pieces", "one last frame"])
def test_an_item_goes_on_over_several_seams(seams: list[int]) -> None:
    clouds, labelling = labelled()
    labelling = without_names(labelling, clouds, seams[0], np.random.default_rng(0), 1.0)
    whole, found = review(labelling, clouds), in_pieces(labelling, clouds, seams).items()
    worth = [item for item in to_look_at(whole) if item.gain >= 3.0]
    assert len(worth) >= 3
    frames = {(item.first_frame, item.last_frame) for item in found}
    assert {(item.first_frame, item.last_frame) for item in worth} <= frames
    assert sum(item.gain for item in found) == pytest.approx(sum(item.gain for item in whole), rel=0.05)
    assert [item.gain for item in found] == sorted((item.gain for item in found), reverse=True)


def test_frames_without_a_point_at_a_seam_end_what_was_there() -> None:
    clouds, labelling = labelled()
    empty = np.ones(len(clouds), dtype=np.bool_)
    empty[120:180] = False
    gone = clouds.select(empty[clouds.frame_of])
    indices = np.where(empty[:, None], labelling.indices, NULL)
    labelling = replace(labelling, indices=indices, confidence=0.9 * labelling.confidence, candidates=None)
    whole, found = review(labelling, gone), in_pieces(labelling, gone, [120, 170]).items()
    assert {(i.first_frame, i.last_frame, i.marker) for i in found} == {(i.first_frame, i.last_frame, i.marker) for i in whole}


def test_nothing_added_is_nothing_to_check() -> None:
    assert ReviewInPieces(("A", "B")).items() == []


def test_a_recording_without_any_label_is_not_ready() -> None:
    clouds, labelling = labelled()
    nothing = replace(labelling, indices=np.full_like(labelling.indices, NULL), confidence=np.zeros_like(labelling.confidence))
    # no item to look at, and a verdict that nothing contradicts
    assert readiness(nothing, clouds, []).kind == "do-not-use"
    assert readiness(labelling, clouds, []).kind == "ready"
