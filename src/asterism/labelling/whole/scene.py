"""A recording prepared for labelling as a whole: clouds and their tracklets in; sorted points and the frames to label singly out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import rotate_z_up
from asterism.labelling.body._workspace_kernels import BodyArrays, FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.recording import NULL, Clouds, Floats, Ints
from asterism.tracking.chain_kernels import sort_frames
from asterism.tracking.linking import Tracklets


@dataclass(frozen=True)
class RecordingScene:
    """A recording of P points in T frames and J tracklets, prepared for the kernels; E of the frames are sampled, with Q points.

    xyz             (P, 3) m, z up, sorted within each frame
    offsets         (T + 1,) where each frame's points begin
    order           (P,) each point's number in the clouds
    track           (P,) each point's tracklet
    first, last     (J,) first and last frame of each tracklet
    rate            frames per second
    sampled_frames  (E,) the frames that are sampled
    sampled_xyz     (Q, 3) m, their points
    sampled_offsets (E + 1,) where each sampled frame's points begin
    sampled_track   (Q,) each sampled point's tracklet
    sampled_frame   (Q,) each sampled point's frame, 0..E-1
    samples         (J,) in how many sampled frames each tracklet is
    independent     (J,) how many independent frames these amount to
    """

    xyz: Floats
    offsets: Ints
    order: Ints
    track: Ints
    first: Ints
    last: Ints
    rate: float
    sampled_frames: Ints
    sampled_xyz: Floats
    sampled_offsets: Ints
    sampled_track: Ints
    sampled_frame: Ints
    samples: Ints
    independent: Floats


def prepare_scene(clouds: Clouds, tracklets: Tracklets, rules: RecordingLabellingSettings) -> RecordingScene:
    """Sort the points of every frame, number the tracklets by their first points, and choose the frames to sample.

    The result does not depend on the order of the points. O(P n) for n points a frame at worst.
    """
    frame_of = clouds.frame_of
    xyz = rotate_z_up(clouds.xyz, clouds.vertical)
    order = np.arange(len(xyz))
    sort_frames(xyz, clouds.offsets, order, (2, 0, 1), -1.0)
    xyz = np.ascontiguousarray(xyz[order])
    track = tracklets.of_point[order]
    begins = np.empty(len(tracklets), dtype=np.int64)
    begins[track[::-1]] = np.arange(len(track))[::-1]  # the first point of each is written last
    by_begin = np.argsort(begins)
    rank = np.empty(len(begins), dtype=np.int64)
    rank[by_begin] = np.arange(len(begins))
    track, first, last = rank[track], tracklets.first[by_begin], tracklets.last[by_begin]

    is_sampled = _sampled_frames(len(clouds), max(1, round(rules.frame_interval * clouds.rate)), first, last)
    frames = np.nonzero(is_sampled)[0]
    points = is_sampled[frame_of]
    sampled_track = track[points]
    samples = np.bincount(sampled_track, minlength=len(tracklets))
    return RecordingScene(
        xyz,
        clouds.offsets,
        order,
        track,
        first,
        last,
        clouds.rate,
        frames,
        np.ascontiguousarray(xyz[points]),
        np.concatenate([[0], np.cumsum(clouds.counts[frames])]).astype(np.int64),
        sampled_track,
        np.repeat(np.arange(len(frames)), clouds.counts[frames]),
        samples,
        _independent(samples, rules),
    )


def with_fewer_samples(scene: RecordingScene, most: int, rules: RecordingLabellingSettings) -> RecordingScene:
    """The scene with so many of its sampled frames at most, evenly spread. Tracklets that none of these shows stay, without a sample."""
    if len(scene.sampled_frames) <= most:
        return scene
    kept = np.linspace(0, len(scene.sampled_frames) - 1, most).round().astype(np.int64)
    number = np.full(len(scene.sampled_frames), -1)
    number[kept] = np.arange(most)
    points = number[scene.sampled_frame] >= 0
    counts = np.diff(scene.sampled_offsets)[kept]
    samples = np.bincount(scene.sampled_track[points], minlength=len(scene.first))
    return replace(
        scene,
        sampled_frames=scene.sampled_frames[kept],
        sampled_xyz=np.ascontiguousarray(scene.sampled_xyz[points]),
        sampled_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        sampled_track=scene.sampled_track[points],
        sampled_frame=number[scene.sampled_frame[points]],
        samples=samples,
        independent=_independent(samples, rules),
    )


def _independent(samples: Ints, rules: RecordingLabellingSettings) -> Floats:
    """How many independent frames so many samples of a tracklet (J,) amount to."""
    return np.asarray(samples / (1.0 + rules.frame_correlation * (samples - 1.0)))


def _sampled_frames(frames: int, step: int, first: Ints, last: Ints) -> NDArray[np.bool_]:
    """Every `step`-th frame, and as many more as every tracklet needs to have one: (T,)."""
    sampled = np.zeros(frames, dtype=np.bool_)
    sampled[step // 2 :: step] = True
    if len(sampled) and not sampled.any():
        sampled[len(sampled) // 2] = True
    before = np.concatenate([[0], np.cumsum(sampled)])
    missed = np.nonzero(before[last + 1] == before[first])[0]
    for j in missed[np.argsort(last[missed], kind="stable")]:
        if not sampled[first[j] : last[j] + 1].any():
            sampled[(first[j] + last[j]) // 2] = True
    return sampled


def score_scene(
    scene: RecordingScene, label: Ints, body: BodyArrays, settings: FrameSettings, out: FrameScores | None = None
) -> FrameScores:
    """Score every sampled point as every marker of a body, given the labels (J,) of all tracklets as its markers. See `score_frames`.

    Written over `out`, where it is given and as large.
    """
    frames = len(scene.sampled_frames)
    if out is None or len(out.scores) != len(scene.sampled_xyz) or len(out.totals) != frames:
        out = FrameScores(np.empty((len(scene.sampled_xyz), body.mean.shape[1])), np.empty(frames), np.empty(frames, dtype=np.int64))
    score_frames(scene.sampled_xyz, scene.sampled_offsets, scene.sampled_track, label, body, settings, out)
    return out


def score_again(
    scene: RecordingScene, frames: NDArray[np.bool_], label: Ints, body: BodyArrays, settings: FrameSettings, out: FrameScores
) -> None:
    """Write over `out`, see `score_scene`, what some of the sampled frames (E,) score under the labels (J,)."""
    points = np.nonzero(frames[scene.sampled_frame])[0]
    if not len(points):
        return
    counts = np.diff(scene.sampled_offsets)[frames]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    own = FrameScores(np.empty((len(points), out.scores.shape[1])), np.empty(len(counts)), np.empty(len(counts), dtype=np.int64))
    score_frames(scene.sampled_xyz[points], offsets, scene.sampled_track[points], label, body, settings, own)
    out.scores[points], out.totals[frames], out.poses[frames] = own


@dataclass
class SceneScores:
    """What a scene scores by one body, kept from labels to labels: only frames in which a label changes are scored again.

    scene, body, settings  see `score_scene`
    label                  (J,) the labels that were scored last; None before
    scored                 their scores; before, arrays to be written over, or None
    """

    scene: RecordingScene
    body: BodyArrays
    settings: FrameSettings
    label: Ints | None = None
    scored: FrameScores | None = None

    def of(self, label: Ints) -> FrameScores:
        """`score_scene` for the labels (J,); the arrays are written over by the next call."""
        if self.label is None or self.scored is None:
            self.scored = score_scene(self.scene, label, self.body, self.settings, self.scored)
        else:
            changed = (label != self.label)[self.scene.sampled_track]
            frames = np.bincount(self.scene.sampled_frame[changed], minlength=len(self.scene.sampled_frames)) > 0
            score_again(self.scene, frames, label, self.body, self.settings, self.scored)
        self.label = label.copy()
        return self.scored

    def with_frames(self, scene: RecordingScene, frames: NDArray[np.bool_]) -> SceneScores:
        """The same of a scene in which the points of these sampled frames (E,) lie elsewhere; takes over the arrays."""
        if self.label is not None and self.scored is not None:
            score_again(scene, frames, self.label, self.body, self.settings, self.scored)
        return SceneScores(scene, self.body, self.settings, self.label, self.scored)


def marker_offsets(labellers: Sequence[BodyLabeller]) -> Ints:
    """Where each body's markers begin among the columns of all bodies, and the number of columns at the end."""
    return np.concatenate([[0], np.cumsum([labeller.body.mean.shape[1] for labeller in labellers])]).astype(np.int64)


def labels_of_body(label: Ints, offsets: Ints, number: int) -> Ints:
    """Labels (J,), columns of all bodies, as markers of one body; -1 for those of others. Those given where there is one body."""
    if len(offsets) == 2:
        return label
    return np.where((label >= offsets[number]) & (label < offsets[number + 1]), label - offsets[number], NULL)


def placed_points(frame_of: Ints, marker: Ints, xyz: Floats, frames: int, markers: int) -> Floats:
    """Labelled points as frames (T, M, 3) m, NaN where missing: frame_of, marker (P,), -1 for none; xyz (P, 3) m."""
    out, given = np.full((frames, markers, 3), np.nan), marker != NULL
    out[frame_of[given], marker[given]] = xyz[given]
    return out
