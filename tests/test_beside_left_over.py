"""A label beside an absent neighbour and points without a name is not sure."""

from __future__ import annotations

import numpy as np

from asterism.labelling.whole.point_labels import beside_left_over
from asterism.recording import NULL, Clouds

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
