"""Short tracklets: a recording in; its long tracklets, which are labelled together, and then the labels of the other points, out.

Most ghosts are there for a frame or two, and each such point begins a tracklet. What a single frame says of one of them cannot be weighed
against what a long tracklet shows: enough ghosts beside a marker would take its label, one frame at a time. So the long tracklets are
labelled without them. Then each point of a short tracklet is a candidate for the markers that no long one holds in its frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.labeller import MOST_EVALUATIONS, BodyLabeller
from asterism.labelling.whole._short_kernels import Expected, ShortLabels, ShortLimits, label_short
from asterism.recording import NULL, Clouds, Floats, Ints
from asterism.tracking.linking import Tracklets

ALONE_EVALUATIONS = 20_000_000
"""Feature evaluations of all frames together that are labelled by themselves, where each takes more than by the labeller's settings: half a
second. In a third of the frames of 59 markers on children no body is found with the settings' 200,000, and a recording or a study of few
frames then has no label at all. Of 10 frames each may take `MOST_EVALUATIONS`, of 100 or more none takes more than usual; at half and at
double it is 5 and 20, and 50 and 200."""


@dataclass(frozen=True)
class ShortTrackletRules:
    """Which tracklets are short, and how their points are labelled. Chosen on six gait subjects in clutter (docs/recordings.md).

    frames          tracklets of so many frames are short
    seconds         those that last no longer, too
    crowd_seconds   where there is a crowd, the longest of the tracklets that may be taken as short
    crowded         points of long tracklets in a frame, for each marker, from which there is a crowd
    min_shown       points of long tracklets for each marker that must remain in a frame
    min_long_frames share of the frames that must show enough long tracklets; else those of several bodies are labelled with the short ones
    min_labelled    share of the markers that a frame must show labelled, to label its other points
    min_score       nats, the most that the body can say against a label (negative)
    max_score       nats, the most that it can say for a label
    usual_spread    m, standard deviation of a place that the body predicts
    motion_spread   m; where motion predicts a place at least so closely, it decides more than the body
    acceleration    m/s2, standard deviation of a marker's acceleration
    noise           m, standard deviation of a point
    max_spread      m; a place that motion predicts less closely is not used
    min_marker_share share of the candidates that score as a marker that must be the marker, to label any of them
    prior_frames    frames that the average over all markers counts for, of how often ghosts score as one
    """

    frames: int = 3
    seconds: float = 0.05
    crowd_seconds: float = 0.25
    crowded: float = 1.5
    min_shown: float = 0.6
    min_long_frames: float = 0.5
    min_labelled: float = 0.3
    min_score: float = -4.0
    max_score: float = 15.0
    usual_spread: float = 0.03
    motion_spread: float = 0.01
    acceleration: float = 25.0
    noise: float = 0.002
    max_spread: float = 0.15
    min_marker_share: float = 0.9
    prior_frames: float = 100.0


@dataclass(frozen=True)
class ShortPointLabels:
    """Labels of the candidates among P points.

    label   (P,) marker of each, -1 for none
    margin  (P,) nats
    alone   (P,) whether the label is one of a frame that was labelled by itself
    """

    label: Ints
    margin: Floats
    alone: NDArray[np.bool_]


def long_points(clouds: Clouds, tracklets: Tracklets, markers: int, rules: ShortTrackletRules) -> NDArray[np.bool_]:
    """The points (P,) of long tracklets.

    Where the tracklets that are not short show many more points than the bodies have markers, longer ones are short, too, up to a limit;
    but only if that leaves about as many points as there are markers.
    """
    duration = (tracklets.last - tracklets.first + 1)[tracklets.of_point]
    longest = max(float(rules.frames), rules.seconds * clouds.rate)
    lengths = np.arange(np.ceil(longest), np.floor(rules.crowd_seconds * clouds.rate) + 1)
    for length in (longest, *lengths[lengths > longest]):
        shown = float((duration > length).sum()) / max(1, int((clouds.counts > 0).sum()))
        if shown <= rules.crowded * markers:
            longest = length if shown >= rules.min_shown * markers else longest
            break
    return duration > longest


def frames_with_bodies(clouds: Clouds, long: NDArray[np.bool_], markers: int, rules: ShortTrackletRules) -> float:
    """Share of the frames in which long tracklets show enough of bodies with so many markers: 0 to 1."""
    shown = np.bincount(clouds.frame_of[long], minlength=len(clouds))
    return float((shown >= max(3.0, rules.min_labelled * markers)).sum() / max(1, (clouds.counts > 0).sum()))


def tracklets_of(tracklets: Tracklets, kept: NDArray[np.bool_]) -> Tracklets:
    """The tracklets all of whose points (P,) are kept, numbered anew."""
    shown = np.zeros(len(tracklets), dtype=np.bool_)
    shown[tracklets.of_point[kept]] = True
    number = np.cumsum(shown) - 1
    return Tracklets(number[tracklets.of_point[kept]], tracklets.first[shown], tracklets.last[shown])


def label_short_points(
    labeller: BodyLabeller,
    body: BodyArrays,
    clouds: Clouds,
    xyz: Floats,
    candidate: NDArray[np.bool_],
    label: Ints,
    rules: ShortTrackletRules,
) -> ShortPointLabels:
    """Label the candidates among the points (P,).

    body: adapted to the subject; xyz (P, 3) m, z up; label (P,): what the long tracklets are of this body, -1 for none. A frame that shows
    too few of them is labelled by itself. O(P), and O(K M r^2 + M n) in each of the W frames with a candidate, as `label_short`; memory for
    the points and markers of these.
    """
    markers, frame_of = body.mean.shape[1], clouds.frame_of
    found, margin, alone = label.copy(), np.zeros(len(label)), np.zeros(len(label), dtype=np.bool_)
    wanted = np.zeros(len(clouds), dtype=np.bool_)
    wanted[frame_of[candidate & (label == NULL)]] = True
    frames, points = np.nonzero(wanted)[0], np.nonzero(wanted[frame_of])[0]
    if not len(points):
        return ShortPointLabels(np.where(candidate, found, NULL), margin, alone)
    of_frames = candidate[points]
    out = ShortLabels(
        label[points],
        np.zeros(len(points)),
        np.zeros(len(points), dtype=np.bool_),
        np.zeros(len(frames), dtype=np.bool_),
        np.zeros((markers, 4), dtype=np.int64),
        np.zeros((markers, 4), dtype=np.int64),
    )
    least = max(3, round(rules.min_labelled * markers))
    limits = ShortLimits(least, rules.min_score, rules.max_score, rules.usual_spread, rules.motion_spread)
    expected = expect_by_motion(xyz, frame_of, label, (len(clouds), markers), clouds.rate, rules, frames)
    offsets = np.concatenate([[0], np.cumsum(clouds.counts[frames])]).astype(np.int64)
    label_short(xyz[points], offsets, of_frames, body, labeller.settings, limits, expected, out)
    by_body, by_motion = (marker_shares(counts, rules) for counts in (out.body_hits, out.near_hits))
    share = np.where(out.by_motion, by_motion[out.label], by_body[out.label])
    out.label[of_frames & (share < rules.min_marker_share)] = NULL
    found[points], margin[points] = out.label, out.margin
    if out.alone.any():
        alone[_label_alone(labeller, clouds, frames[out.alone], candidate, found, margin)] = True
    return ShortPointLabels(np.where(candidate, found, NULL), margin, alone)


def marker_shares(counts: Ints, rules: ShortTrackletRules) -> Floats:
    """Which share of the candidates that score as a marker is the marker, not a ghost: (M,), 0 to 1.

    counts (M, 4): see `count_body_hits`. Ghosts score as a free marker as often as they do while another point is it; where that was seen
    in few frames, at least as often as for the markers on average. One hit more than seen is assumed.
    """
    free, hits, held, held_hits = counts.astype(np.float64).T
    usual = (held_hits.sum() + 0.5) / (held.sum() + 1.0)
    shrunk = (held_hits + 1.0 + rules.prior_frames * usual) / (held + rules.prior_frames)
    share_hit = np.maximum(shrunk, held_hits / np.maximum(held, 1.0))
    return np.asarray(np.clip(1.0 - free * share_hit / np.maximum(hits, 1e-12), 0.0, 1.0))


def _label_alone(labeller: BodyLabeller, clouds: Clouds, frames: Ints, candidate: NDArray[np.bool_], found: Ints, margin: Floats) -> Ints:
    """Label frames by themselves, and take from that what is a candidate for a marker that is not there yet: the points so labelled."""
    settings = labeller.settings
    evaluations = max(settings.max_evaluations, min(MOST_EVALUATIONS, ALONE_EVALUATIONS // len(frames)))
    patient = replace(labeller, settings=settings._replace(max_evaluations=evaluations))
    alone_labels = patient.label(clouds.frames(frames))
    point_of, margins = alone_labels.point_of, alone_labels.margins
    row, marker = np.nonzero(point_of != NULL)
    frame = frames[row]
    point = clouds.offsets[frame] + point_of[row, marker]
    held = np.zeros((len(clouds), point_of.shape[1]), dtype=np.bool_)
    labelled = np.nonzero(found != NULL)[0]
    held[clouds.frame_of[labelled], found[labelled]] = True
    taken = candidate[point] & ~held[frame, marker]
    found[point[taken]], margin[point[taken]] = marker[taken], margins[row[taken], marker[taken]]
    return point[taken]


def expect_by_motion(
    xyz: Floats,
    frame_of: Ints,
    label: Ints,
    shape: tuple[int, int],
    rate: float,
    rules: ShortTrackletRules,
    wanted: Ints | None = None,
) -> Expected:
    """Where each marker should be where it has no point: on the line between its last point before and its next one after.

    xyz (P, 3) m; frame_of, label (P,); shape (T, M); wanted (W,): the frames to tell it for, increasing, None for all. A marker that
    accelerates by a leaves that line by a (t - t0) (t1 - t) / 2. O(P + W M log T); memory O(P + W M).
    """
    frames, markers = shape
    wanted = np.arange(frames) if wanted is None else wanted
    out = Expected(np.zeros((len(wanted), markers, 3)), np.full((len(wanted), markers), np.inf))
    points = np.nonzero(label != NULL)[0]
    points = points[np.argsort(frame_of[points], kind="stable")]  # O(P) for sorted clouds
    points = points[np.argsort(label[points].astype(np.int16), kind="stable")]  # of 16 bits, a radix sort: O(P)
    begins = np.searchsorted(label[points], np.arange(markers + 1))
    for marker in range(markers):
        own = points[begins[marker] : begins[marker + 1]]
        frame = frame_of[own]
        after = np.searchsorted(frame, wanted)
        row = np.nonzero((after > 0) & (after < len(own)))[0]
        row = row[frame[after[row]] != wanted[row]]
        after = after[row]
        since, until = wanted[row] - frame[after - 1], frame[after] - wanted[row]
        std = np.hypot(rules.noise, 0.5 * rules.acceleration * since * until / rate**2)
        near = std <= rules.max_spread
        row, after, since, until = row[near], after[near], since[near, None], until[near, None]
        out.place[row, marker] = (xyz[own[after - 1]] * until + xyz[own[after]] * since) / (since + until)
        out.spread[row, marker] = std[near]
    return out
