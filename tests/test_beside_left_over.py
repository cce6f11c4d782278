"""A label beside an absent neighbour and points without a name is not sure, nor is a marker that few wear beside a doubtful one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from asterism.labelling import virtual_model
from asterism.labelling.whole.point_labels import beside_doubtful, beside_left_over
from asterism.recording import NULL, Clouds, MarkerSet

ARM = np.array([[0.0, 0.0, 1.4], [0.0, 0.0, 1.25], [0.0, 0.0, 1.1], [0.0, 0.0, 0.95], [0.0, 0.0, 0.85]])
"""m; shoulder, upper arm, elbow, forearm, wrist, at a distance of 1 m from nothing else."""


def doubtful(indices: list[int], points: np.ndarray, frames: int = 30) -> list[bool]:
    clouds = Clouds.from_points([points] * frames, rate=100.0)
    given = np.tile(np.array(indices), (frames, 1))
    return beside_left_over(ARM, given, clouds, np.ones(len(clouds.xyz), dtype=np.bool_)).tolist()


def test_an_elbow_called_upper_arm_beside_a_wrist_without_a_name() -> None:
    # the points are shoulder, elbow and wrist; the elbow's has the name of the upper arm
    assert doubtful([0, 1, NULL, NULL, NULL], ARM[[0, 2, 4]])[1]


def test_markers_that_are_not_worn_are_no_reason_where_every_point_has_a_name() -> None:
    assert not any(doubtful([0, NULL, 1, NULL, 2], ARM[[0, 2, 4]]))


def test_points_far_off_are_no_reason() -> None:
    far = np.vstack([ARM[[0, 2, 4]], [[2.0, 0.0, 1.0]]])
    assert not any(doubtful([0, NULL, 1, NULL, 2], far))


def test_a_whole_body_is_never_looked_at() -> None:
    assert not any(doubtful([0, 1, 2, 3, 4], np.vstack([ARM, [[0.0, 0.1, 1.1]]])))


ELBOW = {"sure": (1, 0.995, NULL), "below 0.99": (1, 0.98, NULL), "taken back": (NULL, 0.6, 1), "in a gap": (NULL, 0.0, NULL)}


@pytest.mark.parametrize("elbow", ELBOW)
def test_an_upper_arm_is_no_surer_than_the_elbow_beside_it(elbow: str) -> None:
    """Many laboratories leave out the former, so that it alone is doubtful; and only where the elbow has a point that may be another's."""
    marker_set = MarkerSet.load("plug-in-gait")
    labeller = virtual_model(marker_set).body_labeller
    upper, lower = (marker_set.names.index(name) for name in ("LUPA", "LELB"))
    shape = (10, len(marker_set))
    indices, confidence, candidates = np.zeros(shape, dtype=np.int64), np.full(shape, 0.995), np.full(shape, NULL, dtype=np.int64)
    indices[:, lower], confidence[:, lower], candidates[:, lower] = ELBOW[elbow]
    found = beside_doubtful(labeller, indices, confidence, candidates)
    assert found[upper] == (elbow in ("below 0.99", "taken back"))
    assert {marker_set.names[m] for m in np.nonzero(found)[0]} <= {"LUPA", "LFRM"}
    assert not beside_doubtful(replace(labeller, often_left_out=None), indices, confidence, candidates).any(), "everyone wears all of them"
