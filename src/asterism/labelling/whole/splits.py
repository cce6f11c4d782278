"""Wrong links found by the body: labelled tracklets in; those that go over from one marker to another, and where, out.

Linking looks at motion alone. At low frame rates, or where the numbers of a camera system change over, a tracklet can begin as one marker
and go on as another. Then the frames before and after fit different markers.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole._kernels import FrameScores, best_split
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, marker_offsets, score_scene
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.recording import Floats, Ints
from asterism.tracking.linking import Tracklets


def sample_scores(
    labellers: Sequence[BodyLabeller],
    scene: RecordingScene,
    label: Ints,
    rules: RecordingLabellingSettings,
    arrays: Sequence[FrameScores] = (),
) -> Floats:
    """Nats of each sampled point as each column of all bodies, (Q, L), given the labels (J,) of all tracklets.

    arrays: see `label_scene`.
    """
    offsets = marker_offsets(labellers)
    of_bodies = [
        score_scene(scene, labels_of_body(label, offsets, number), labeller.body, labeller.settings, out).scores
        for number, (labeller, out) in enumerate(zip_longest(labellers, arrays))
    ]
    scores = of_bodies[0] if len(of_bodies) == 1 else np.concatenate(of_bodies, axis=1)
    return np.clip(scores, rules.min_score, rules.max_score, out=scores)


def split_tracklets(
    tracklets: Tracklets,
    points: Ints,
    labellers: Sequence[BodyLabeller],
    scene: RecordingScene,
    label: Ints,
    rules: RecordingLabellingSettings,
    arrays: Sequence[FrameScores] = (),
) -> Tracklets | None:
    """The tracklets of clouds, those cut in two whose beginning and end fit different markers; None where there is no such one.

    points (P,): the point of the clouds that each point of the scene is; label (J,): the labels of the scene's tracklets.
    arrays: see `label_scene`. O(Q L) beyond the scores.
    """
    scores = sample_scores(labellers, scene, label, rules, arrays)
    order = np.argsort(scene.sampled_track, kind="stable")
    begins = np.searchsorted(scene.sampled_track[order], np.arange(len(label) + 1))
    of_point, first, last = tracklets.of_point.copy(), tracklets.first.tolist(), tracklets.last.tolist()
    for j in range(len(label)):
        samples = order[begins[j] : begins[j + 1]]
        gain, at = best_split(scores[samples])
        if gain < rules.split_gain:
            continue
        begin, end = scene.offsets[scene.first[j]], scene.offsets[scene.last[j] + 1]
        own = begin + np.nonzero(scene.track[begin:end] == j)[0]
        frames = scene.sampled_frames[scene.sampled_frame[samples[at - 1 : at + 1]]]
        cut = _sharpest_link(scene.xyz[own], *(frames - scene.first[j]))
        number = int(of_point[points[own[0]]])
        of_point[points[own[cut:]]] = len(first)
        first.append(int(scene.first[j]) + cut)
        last.append(last[number])
        last[number] = first[-1] - 1
    return None if len(first) == len(tracklets) else Tracklets(of_point, np.array(first), np.array(last))


def _sharpest_link(path: Floats, start: int, end: int) -> int:
    """The point of a path (n, 3), after `start` and up to `end`, to which the velocity differs most from those before and after."""
    step = np.diff(path, axis=0)
    around = 0.5 * (np.concatenate([step[:1], step[:-1]]) + np.concatenate([step[1:], step[-1:]]))
    bend = np.linalg.norm(step - around, axis=1)
    return start + 1 + int(np.argmax(bend[start:end]))
