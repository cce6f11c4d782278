"""The paper's own way, kept as it is printed: minimisation of eq. 7 over 9 numbers, and algorithm 1 in its three steps.

Cuevas, Rodriguez-Navarro, Susin: Auto-labeling as a minimization problem with virtual occlusions, sections 4 and 5. The baseline of the
benchmark; `label_views` does better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.geometry import nearest_point_to_lines
from asterism.recording import Floats, Ints
from asterism.skeleton.pose_kernels import HINGES
from asterism.skeleton.posing import posed_points
from asterism.views._fit_kernels import minimise, predict_visible, project_linear
from asterism.views.arrays import Observing
from asterism.views.frame import FrameLabeller


@dataclass(frozen=True)
class PlainRules:
    """Numbers that the paper does not print, chosen on simulated walks.

    reach          px, distances in eq. 7 above it do not count ("only small values are considered")
    neighbourhood  px, how far a blob may be from a marker's projection to be its
    iterations     of Levenberg-Marquardt; the paper prints 5 and 10
    """

    reach: float = 60.0
    neighbourhood: float = 40.0
    iterations: int = 10


PLAIN = PlainRules()


def minimise_plain(labeller: FrameLabeller, t: int, pose: Floats, rotation: Floats, rules: PlainRules = PLAIN) -> tuple[Floats, Floats]:
    """The pose (9 + J,) and rotation (3, 3) after the minimisation of eq. 7 from a start: scales, place and rotation, no joints.

    Squared distances, as Levenberg-Marquardt needs them; the paper sums distances. The quaternion is normalised by construction: a step is
    a rotation vector. Visibility is tested once for each iteration.
    """
    xy, offsets = labeller.scene.frame(t)
    observing: Observing = labeller.observing._replace(
        nearest=True, reach=rules.reach, occlusion_tolerance=0.0, softness=1e-9, hidden=0.0, shown=1.0
    )
    known = labeller.known
    # The paper knows neither the size nor the tilt before; a hundredth of the usual precision keeps the system solvable.
    loose = known._replace(scale_precision=np.full(2, 1e-6), tilt_precision=1e-6)
    pose, rotation = pose.copy(), rotation.copy()
    size = len(pose)
    minimise(
        *(labeller.body.arrays, labeller.scene.cameras, loose, observing, xy, offsets, np.empty(0, dtype=np.int64)),
        *(np.ones(rules.iterations), 1, np.arange(HINGES, dtype=np.int64), pose, rotation, np.empty((size, size))),
    )
    return pose, rotation


def label_stepwise(labeller: FrameLabeller, t: int, pose: Floats, rotation: Floats, rules: PlainRules = PLAIN) -> Ints:
    """The paper's algorithm 1: the marker of each blob of frame t, (N,) int, -1 for a false marker.

    Step 1: each blob goes to the nearest projection of a marker that is predicted visible: exclusive, or conflictive where several blobs
    go to one marker. Step 2: a conflict is solved by the exclusive blobs of the same marker in other cameras (two or more: the blob
    nearest to the reprojected triangulation; one: the blob that triangulates nearest to the model's marker; none: the blob nearest to the
    projection). Step 3: blobs left over go to the nearest markers left over, without the test of occlusion; the nearest blob wins.
    """
    xy, offsets = labeller.scene.frame(t)
    points = posed_points(labeller.body, pose, rotation)[0]
    count, markers = len(labeller.scene.rig), len(points)
    shares, uv = np.empty((count, markers)), np.empty((count, markers, 2))
    # The paper's test is sharp: a marker is hidden or it is not.
    observing = labeller.observing._replace(occlusion_tolerance=0.0, softness=1e-9, hidden=0.0, shown=1.0)
    predict_visible(labeller.body.arrays, labeller.scene.cameras, observing, pose, rotation, shares)
    project_linear(labeller.scene.cameras, points, uv, np.empty((count, markers, 2, 3)))
    labels = np.full(len(xy), -1, dtype=np.int64)
    exclusive = np.full((count, markers), -1, dtype=np.int64)
    conflicts = list[tuple[int, int, Ints]]()
    for c in range(count):
        near = _nearest_visible(xy[offsets[c] : offsets[c + 1]], uv[c], shares[c] > 0.5, rules.neighbourhood)
        # Several blobs at one projection are decided after all cameras have their exclusive ones, which help to decide.
        for m in np.unique(near[near >= 0]):
            rivals = offsets[c] + np.nonzero(near == m)[0]
            if len(rivals) == 1:
                exclusive[c, m] = rivals[0]
                labels[rivals[0]] = m
            else:
                conflicts.append((c, int(m), rivals))
    for c, m, rivals in conflicts:
        labels[_solved(labeller, xy, exclusive, points, uv, c, m, rivals)] = m
    _remaining(xy, offsets, uv, labels, rules.neighbourhood)
    return labels


def _nearest_visible(blobs: Floats, uv: Floats, visible: np.ndarray, reach: float) -> Ints:
    """(K,) the visible marker nearest to each blob, -1 where none is within reach."""
    if not len(blobs) or not visible.any():
        return np.full(len(blobs), -1, dtype=np.int64)
    apart = np.where(visible, np.linalg.norm(blobs[:, None] - uv[None], axis=2), np.inf)
    nearest = apart.argmin(axis=1)
    return np.where(apart[np.arange(len(blobs)), nearest] <= reach, nearest, -1)


def _ray(labeller: FrameLabeller, c: int, xy: Floats) -> tuple[Floats, Floats]:
    cameras = labeller.scene.cameras
    along = np.append(xy / cameras.focals[c], 1.0) @ cameras.rotations[c]
    return cameras.eyes[c], along / np.linalg.norm(along)


def _triangulated(labeller: FrameLabeller, sights: list[tuple[int, Floats]]) -> Floats:
    rays = [_ray(labeller, c, xy) for c, xy in sights]
    return np.asarray(nearest_point_to_lines(np.array([eye for eye, _ in rays]), np.array([along for _, along in rays])))


def _solved(labeller: FrameLabeller, xy: Floats, exclusive: Ints, points: Floats, uv: Floats, c: int, m: int, rivals: Ints) -> int:
    """The blob that gets marker m in camera c: step 2."""
    helpers = [(o, xy[exclusive[o, m]]) for o in range(len(exclusive)) if o != c and exclusive[o, m] >= 0]
    if len(helpers) > 1:
        place = _triangulated(labeller, helpers)
        seen = np.empty((len(exclusive), 1, 2))
        project_linear(labeller.scene.cameras, place[None], seen, np.empty((len(exclusive), 1, 2, 3)))
        return int(rivals[np.argmin(np.linalg.norm(xy[rivals] - seen[c, 0], axis=1))])
    if len(helpers) == 1:
        places = np.array([_triangulated(labeller, [helpers[0], (c, xy[k])]) for k in rivals])
        return int(rivals[np.argmin(np.linalg.norm(places - points[m], axis=1))])
    return int(rivals[np.argmin(np.linalg.norm(xy[rivals] - uv[c, m], axis=1))])


def _remaining(xy: Floats, offsets: Ints, uv: Floats, labels: Ints, reach: float) -> None:
    """Step 3, in place: blobs without a label to the nearest markers without a blob in this camera."""
    for c in range(len(uv)):
        here = np.arange(offsets[c], offsets[c + 1])
        free_blobs = here[labels[here] < 0]
        free_markers = np.setdiff1d(np.arange(uv.shape[1]), labels[here])
        if not len(free_blobs) or not len(free_markers):
            continue
        apart = np.linalg.norm(xy[free_blobs][:, None] - uv[c][free_markers][None], axis=2)
        nearest = np.nan_to_num(apart, nan=np.inf).argmin(axis=1)
        for place in np.unique(nearest):
            rivals = np.nonzero(nearest == place)[0]
            best = rivals[np.argmin(apart[rivals, place])]
            if apart[best, place] <= reach:
                labels[free_blobs[best]] = free_markers[place]
