"""A recording prepared for labelling as a whole: clouds and their tracklets in; sorted points and the frames to label singly out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import rotate_z_up
from asterism.labelling.body._workspace_kernels import BodyArrays, FrameSettings
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole._kernels import FrameScores, score_frames
from asterism.labelling.whole.short import ShortTrackletRules
from asterism.recording import NULL, Clouds, Floats, Ints
from asterism.tracking.chain_kernels import sort_frames
from asterism.tracking.linking import Tracklets


@dataclass(frozen=True)
class RecordingLabellingSettings:
    """How a recording is labelled as a whole. All were chosen on the gait subjects, each left out in turn (docs/recordings.md).

    frame_interval    s between the frames that are sampled: scored, and labelled singly
    least_voting      sampled frames at least that are labelled singly, and one more for each tracklet that none of them shows. Not tuned
    voting_interval   one in so many sampled frames is labelled singly, where these are more. Not tuned
    crowded           points of long tracklets for each marker, on average, above which single frames are searched briefly
    max_rounds        relabellings after which the labels are taken as they are
    min_score         nats, the most that one frame can say against a label (negative)
    max_score         nats, the most that one frame can say for a label
    frame_correlation correlation of two frames of one tracklet: many frames are worth 1 / frame_correlation independent ones at most
    long_track        s; a longer tracklet is no ghost, unless the recording shows long ghosts
    ghosts_cost       nats for the explanation that a recording shows ghosts, and as many again for long ghosts
    max_vote          nats, the most that the labelling of a single frame can vote for a label
    adapt_margin      nats; the model is adapted to the subject by tracklets whose labels have at least this margin
    no_adapt_margin   nats; where all labels have more, the model is not adapted, as nothing could change
    max_rigid_std     m; two markers are near-rigid where their distance varies by less in this recording
    min_rigid_std     m; the standard deviation of such a distance is taken as at least this
    pose_spread       and as at least this share of its range over the key poses of the training. Chosen on six gait subjects in clutter
    max_rigid_deviation standard deviations by which a tracklet's near-rigid distances and place may differ without a loss of margin.
                        Chosen of 0.9 to 1.2 on six gait subjects with riding ghosts: the largest without avoidable wrong labels
    deviation_cost    nats of margin lost for each square of what exceeds that
    training_noise    m, standard deviation of a near-rigid distance between bodies of one size, beyond the range of the training
    max_deviation_familiar standard deviations by which a tracklet's near-rigid distances may differ from the training's
    max_deviation_unfamiliar the same where most frames of the tracklet fit worse than those of people left out did
    adapt_rounds      how often the model is adapted to the subject's own body; 0 for never
    turn_cost         nats that a sampled frame must gain to be turned upright (`upright.py`). Chosen on acrobatics (cmu41, 85)
    min_turned_share  share of the markers that must be labelled there. Not tuned
    split_gain        nats by which two markers must explain a tracklet better than one, before and after a frame, to cut it there
    max_splits        how often tracklets are cut and labelled again
    short             which tracklets are short, and how their points are labelled
    """

    frame_interval: float = 0.1
    least_voting: int = 60
    voting_interval: int = 10
    crowded: float = 1.5
    max_rounds: int = 4
    min_score: float = -4.0
    max_score: float = 15.0
    frame_correlation: float = 0.3
    long_track: float = 0.9
    ghosts_cost: float = 30.0
    max_vote: float = 10.0
    adapt_margin: float = 6.0
    no_adapt_margin: float = 15.0
    max_rigid_std: float = 0.02
    min_rigid_std: float = 0.004
    pose_spread: float = 0.3
    max_rigid_deviation: float = 1.0
    deviation_cost: float = 12.0
    training_noise: float = 0.01
    max_deviation_familiar: float = 5.0
    max_deviation_unfamiliar: float = 2.5
    adapt_rounds: int = 2
    turn_cost: float = 10.0
    min_turned_share: float = 0.3
    split_gain: float = 40.0
    max_splits: int = 2
    short: ShortTrackletRules = field(default_factory=ShortTrackletRules)


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
