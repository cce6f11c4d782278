"""A recording and its labels piece by piece in; what `review` lists in all of it, out.

A tracklet that goes on in the next piece is one item, not two: a name that only one of its parts bears is a doubt about the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.labelling.review import ReviewItem, ReviewRules, review
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling
from asterism.tracking.linking import Tracklets, find_tracklets

LEAST_GAIN = 0.1
"""Samples that an item gains at least; as in `review`."""

FRAMES_AT_SEAM = 50
"""Frames on each side of a seam by which tracklets are linked over it."""


@dataclass(frozen=True)
class _TrackletPart:
    """What one piece shows of a tracklet that begins before it, or goes on after it.

    first, last  frames
    votes        (M,) the confidence of its labels, summed by marker
    without      points without a label
    missing      (M,) those of them in whose frame the marker has no point
    item         what a person should check of it; None where there is nothing
    """

    first: int
    last: int
    votes: Floats
    without: int
    missing: Ints
    item: ReviewItem | None

    @property
    def samples(self) -> int:
        return self.last - self.first + 1


class ReviewInPieces:
    """The review of a recording of which one piece after the other is added, each beginning where the last one ended.

    The frames on both sides of a seam tell which tracklet goes on as which. Memory for one piece and the items.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._items: list[ReviewItem] = []
        self._open: dict[int, list[_TrackletPart]] = {}  # by the place of its point in the last frame
        self._end: Clouds | None = None
        self._frames = 0

    def add(self, labelling: Labelling, clouds: Clouds) -> None:
        """Take in the next piece. Raises as `review`."""
        tracklets, begin = find_tracklets(clouds), self._frames
        items = {int(item.points[0]): _moved(item, begin) for item in review(labelling, clouds, least_gain=0.0, tracklets=tracklets)}
        before = {} if self._end is None else _continued(self._end, clouds.frames(slice(0, FRAMES_AT_SEAM)))
        still_open = dict[int, list[_TrackletPart]]()
        for points in _at_edges(clouds, tracklets):
            part = _part(labelling, clouds, points, begin, items.pop(int(points[0]), None))
            parts = [part]
            if part.first == begin and int(points[0]) in before:
                parts = [*self._open.pop(before[int(points[0])]), part]
            if part.last == begin + len(clouds) - 1:
                still_open[int(points[-1] - clouds.offsets[-2])] = parts
            else:
                self._close(parts)
        self._items += [item for item in items.values() if item.gain >= LEAST_GAIN]
        for parts in self._open.values():
            self._close(parts)
        self._open, self._end, self._frames = still_open, clouds.frames(slice(-FRAMES_AT_SEAM, None)), begin + len(clouds)

    def items(self) -> list[ReviewItem]:
        """What a person should check first, by expected gain; without the points."""
        open_ = [_joined(parts, self._names) for parts in self._open.values()]
        found = self._items + [item for item in open_ if item is not None and item.gain >= LEAST_GAIN]
        return sorted(found, key=lambda item: -item.gain)

    def _close(self, parts: list[_TrackletPart]) -> None:
        item = _joined(parts, self._names)
        if item is not None and item.gain >= LEAST_GAIN:
            self._items.append(item)


def _moved(item: ReviewItem, begin: int) -> ReviewItem:
    """The item in a recording of which its piece begins in this frame."""
    first, last, frame = item.first_frame + begin, item.last_frame + begin, item.frame + begin
    return replace(item, first_frame=first, last_frame=last, frame=frame, points=np.empty(0, dtype=np.int64))


def _continued(end: Clouds, start: Clouds) -> dict[int, int]:
    """For points of the first frame of `start`, by their places, the place of the point of the last frame of `end` that each continues."""
    counts = np.concatenate([[0], end.counts, start.counts])
    tracks = None if end.tracks is None or start.tracks is None else np.concatenate([end.tracks, start.tracks])
    xyz, columns = np.concatenate([end.xyz, start.xyz]), np.concatenate([end.columns, start.columns])
    both = replace(end, xyz=xyz, offsets=np.cumsum(counts), columns=columns, tracks=tracks)
    before, after = (both.offsets[len(end) + k] + np.arange(counts[len(end) + k + 1]) for k in (-1, 0))
    of_point = find_tracklets(both).of_point
    place_of = {int(track): place for place, track in enumerate(of_point[before])}
    return {place: place_of[int(track)] for place, track in enumerate(of_point[after]) if int(track) in place_of}


def _at_edges(clouds: Clouds, tracklets: Tracklets) -> list[Ints]:
    """The points of each tracklet that shows in the first or last frame."""
    wanted = (tracklets.first == 0) | (tracklets.last == len(clouds) - 1)
    points = np.nonzero(wanted[tracklets.of_point])[0]
    points = points[np.argsort(tracklets.of_point[points], kind="stable")]
    return np.split(points, np.nonzero(np.diff(tracklets.of_point[points]))[0] + 1) if len(points) else []


def _part(labelling: Labelling, clouds: Clouds, points: Ints, begin: int, item: ReviewItem | None) -> _TrackletPart:
    frames = np.searchsorted(clouds.offsets, points, side="right") - 1
    here = replace(labelling, indices=labelling.indices[frames], confidence=labelling.confidence[frames])
    frame, marker = np.nonzero(here.indices == (points - clouds.offsets[frames])[:, None])
    votes = np.zeros(len(labelling.names))
    np.add.at(votes, marker, here.confidence[frame, marker])
    nameless = np.ones(len(points), dtype=np.bool_)
    nameless[frame] = False
    missing = (here.indices[nameless] == NULL).sum(axis=0)
    return _TrackletPart(begin + int(frames[0]), begin + int(frames[-1]), votes, int(nameless.sum()), missing, item)


def _joined(parts: list[_TrackletPart], names: tuple[str, ...]) -> ReviewItem | None:
    """The item of a tracklet of which pieces show these parts; None where there is nothing to check."""
    known = [part.item for part in parts if part.item is not None]
    if len(parts) == 1 or not known:
        return known[0] if known else None
    rules, samples = ReviewRules(), sum(part.samples for part in parts)
    without, votes = sum(part.without for part in parts), np.sum([part.votes for part in parts], axis=0)
    share = votes / max(float(votes.sum()) + rules.unlabelled_weight * without, 1e-300)
    marker = int(share.argmax())
    gains = [0.0 if part.item is None else part.item.gain for part in parts]
    for number, part in enumerate(parts):
        if part.without == part.samples:  # it bears no name, but other parts do
            gains[number] = max(gains[number], float(part.missing[marker] * share[marker]))
    worst = max(range(len(parts)), key=lambda number: gains[number] / parts[number].samples)
    look = parts[worst].item
    named = 2 * without < samples
    chances = dict[str, float]()
    for item in known:
        for name, chance in item.alternatives:
            chances[name] = chances.get(name, 0.0) + chance * item.samples / samples
    if not named and share[marker] > 0:
        chances[names[marker]] = max(chances.get(names[marker], 0.0), float(share[marker]))
    own = names[marker] if named else None
    others = sorted(((n, c) for n, c in chances.items() if n != own and c >= rules.min_chance), key=lambda each: -each[1])
    return ReviewItem(
        first_frame=parts[0].first,
        last_frame=parts[-1].last,
        frame=parts[worst].first if look is None else look.frame,
        track=known[0].track,
        marker=own,
        confidence=float(votes[marker]) / (samples - without) if named else 1.0 - min(1.0, sum(gains) / samples),
        alternatives=tuple(others[: rules.alternatives]),
        samples=samples,
        gain=sum(gains),
        points=np.empty(0, dtype=np.int64),
    )
