"""Clouds in; tracklets out: unbroken pieces of one marker's path.

If the camera system numbered its tracks, tracklets follow the numbers, and are cut at gaps and swaps. Otherwise points are linked by
motion. A missing link costs little; a wrong link spoils many labels. Ambiguous points are therefore not linked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Clouds, Floats, Ints
from asterism.tracking._cut_kernels import count_strays, find_cuts, repair_links
from asterism.tracking.chain_kernels import combine_directions, link_numbers, number_chains, sort_frames
from asterism.tracking.link_kernels import link_frames
from asterism.tracking.link_workspace_kernels import LinkLimits, Links


@dataclass(frozen=True)
class LinkRules:
    """When a point continues a track.

    The limits on motion were chosen on the gait recordings at 100 Hz, and thinned to 50 Hz: no wrong link, hardly a missing one. Those on
    cuts (`no_cut_below`, `jump`) were chosen on the movement recordings: markers that lie close together jerk at 70 Hz without a swap.

    noise                   m, the error of a prediction that is always allowed
    acceleration_change     m/s2 by which a marker's acceleration may always change from one frame to the next
    max_acceleration_change m/s2 by which it may change at most
    residual_gain           a track's prediction error may be this many times its recent ones
    ratio_test              a rival must be this many times farther from the prediction
    rival_gap               m, and farther by this much besides
    neighbour_velocity_tol  m/s by which the velocity of a point without history may differ from that of its three nearest neighbours
    rotation_tol            1/s, and more by this for each metre to the nearest neighbour
    disagreement_gain       and more by this for each m/s by which the neighbours' velocities differ
    max_speed               m/s, of a point without neighbours that have a velocity
    no_cut_below            m; a link along track numbers with a smaller prediction error is never cut
    jump                    m; a link along track numbers with a larger one may be cut without a rival
    stray_ratio             a link along track numbers is a stray if it passes by a point this many times nearer
    max_stray_share         share of strays above which the numbers are ignored: they are no tracks, but, say, places in a list
    min_linked_share        share of the points that the numbers link; below this, links are found by motion
    motion_gain             the numbers are ignored where motion links so many times more points: they change too often
    """

    noise: float = 0.002
    acceleration_change: float = 40.0
    max_acceleration_change: float = 250.0
    residual_gain: float = 2.0
    ratio_test: float = 2.5
    rival_gap: float = 0.0015
    neighbour_velocity_tol: float = 0.3
    rotation_tol: float = 8.0
    disagreement_gain: float = 1.0
    max_speed: float = 8.0
    no_cut_below: float = 0.006
    jump: float = 0.03
    stray_ratio: float = 3.0
    max_stray_share: float = 0.1
    min_linked_share: float = 0.8
    motion_gain: float = 1.1

    def limits(self, rate: float) -> LinkLimits:
        """The rules at one frame rate, in metres per frame, as the kernels read them."""
        dt = 1.0 / rate
        return LinkLimits(
            noise=self.noise,
            usual_change=self.acceleration_change * dt * dt,
            max_change=self.max_acceleration_change * dt * dt,
            residual_gain=self.residual_gain,
            ratio_test=self.ratio_test,
            rival_gap=self.rival_gap,
            neighbour_velocity_tol=self.neighbour_velocity_tol * dt,
            rotation_tol=self.rotation_tol * dt,
            disagreement_gain=self.disagreement_gain,
            max_step=self.max_speed * dt,
            no_cut_below=self.no_cut_below,
            jump=self.jump,
        )


@dataclass(frozen=True)
class Tracklets:
    """Unbroken pieces of paths, J of them.

    of_point     (P,) int: the tracklet of each point of the clouds; every point has one, perhaps alone
    first, last  (J,) int: its frames, inclusive

    A tracklet has exactly one point in each frame from its first to its last. They are numbered by their first frames.
    """

    of_point: Ints
    first: Ints
    last: Ints

    def __len__(self) -> int:
        return len(self.first)


def find_tracklets(clouds: Clouds, rules: LinkRules | None = None) -> Tracklets:
    """Link the points of clouds to tracklets that never jump from one marker to another.

    Points that carry a track number are linked along it, from each frame to the next. Such a link is cut where another point continues the
    track much better, where another track continues in the point much better, or where the track jumped. Track numbers that change with
    every frame, such as places in a list, are recognised by their links and ignored; so are numbers that change so often that motion
    links more points.

    Points without a number are linked by motion, forwards and backwards. A track continues in the point nearest to its prediction if the
    track is the nearest to that point, too, and no rival comes near. A link counts if both directions find it, or if one finds it and the
    other cannot judge because the velocity is not known there. In the end, tracks that end are joined with tracks that begin in the next
    frame where their motion agrees, across track numbers, too.

    The order of the points within their frames does not matter, except for coincident ones. O(P n) for n points a frame.
    """
    rules = rules or LinkRules()
    limits = rules.limits(clouds.rate)
    # Sorted by place, so that the order of points in a file changes nothing.
    order = np.arange(len(clouds.xyz))
    sort_frames(clouds.xyz, clouds.offsets, order, (0, 1, 2), 1.0)
    xyz = np.ascontiguousarray(clouds.xyz[order])
    frame = clouds.frame_of
    forbidden = np.full(len(xyz), -1, dtype=np.int64)
    numbers = None if clouds.tracks is None else clouds.tracks[order]
    links = None if numbers is None else _usable_links(numbers, xyz, clouds.offsets, frame, rules)
    if numbers is not None and links is not None:
        _cut_and_complete(links, xyz, clouds.offsets, frame, numbers, limits, forbidden)
    # Too few links by number: the system began a new number at every gap.
    if links is None or _linked_share(links) < rules.min_linked_share:
        by_motion = _by_motion(xyz, clouds.offsets, limits)
        # Numbers that change more often than motion breaks are worth less than motion.
        if links is None or _linked_share(by_motion) > rules.motion_gain * _linked_share(links):
            links = by_motion
            # What was cut from the numbers' links is not forbidden to those of motion.
            forbidden[:] = -1
    # Ends that belong together are joined last, across track numbers.
    repair_links(xyz, clouds.offsets, links, forbidden, limits)

    sorted_numbers = np.empty(len(xyz), dtype=np.int64)
    count = number_chains(links.previous, sorted_numbers)
    of_point = np.empty(len(xyz), dtype=np.int64)
    of_point[order] = sorted_numbers
    first, last = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    begin, end = links.previous < 0, links.following < 0
    first[sorted_numbers[begin]], last[sorted_numbers[end]] = frame[begin], frame[end]
    return Tracklets(of_point, first, last)


def _usable_links(numbers: Ints, xyz: Floats, offsets: Ints, frame: Ints, rules: LinkRules) -> Links | None:
    """The links along track numbers (P,), None where they are no tracks."""
    links = _along_numbers(numbers, frame)
    count, strays = count_strays(xyz, offsets, links.following, rules.stray_ratio, rules.jump)
    # Numbers that pass by nearer points all the time are places in a list.
    return None if strays > rules.max_stray_share * count else links


def _cut_and_complete(links: Links, xyz: Floats, offsets: Ints, frame: Ints, numbers: Ints, limits: LinkLimits, forbidden: Ints) -> None:
    """Cut links along track numbers (P,) where they are wrong, and add links by motion between points without a number.

    forbidden (P,): the previous point that each point was cut from is written.
    """
    cut = np.zeros(len(xyz), dtype=np.bool_)
    find_cuts(xyz, offsets, links, limits, cut)
    # A cut must not be undone by the repair that follows.
    forbidden[cut] = links.previous[cut]
    links.following[links.previous[cut]] = -1
    links.previous[cut] = -1
    # Points without a number are linked among themselves only: the others have theirs.
    free = np.nonzero(numbers < 0)[0]
    free_offsets = np.concatenate([[0], np.cumsum(np.bincount(frame[free], minlength=len(offsets) - 1))]).astype(np.int64)
    between_free = _by_motion(np.ascontiguousarray(xyz[free]), free_offsets, limits)
    for ends, found in zip(links, between_free, strict=True):
        ends[free] = np.where(found >= 0, free[found], -1)


def _linked_share(links: Links) -> float:
    """Share of the points that continue one of the frame before."""
    return float((links.previous >= 0).sum() / max(1, len(links.previous)))


def _along_numbers(numbers: Ints, frame: Ints) -> Links:
    """Links along track numbers (P,), from each frame to the next; -1 is no number."""
    links = Links(np.empty(len(numbers), dtype=np.int64), np.empty(len(numbers), dtype=np.int64))
    # Huge numbers would need an array of their size.
    if numbers.max(initial=0) > len(numbers):
        numbers = np.where(numbers < 0, -1, np.unique(numbers, return_inverse=True)[1])
    link_numbers(numbers, frame, np.full(int(numbers.max(initial=0)) + 1, -1, dtype=np.int64), links)
    return links


def _by_motion(xyz: Floats, offsets: Ints, limits: LinkLimits) -> Links:
    """Links by motion, in both directions."""
    forward, backward, previous, following = (np.empty(len(xyz), dtype=np.int64) for _ in range(4))
    # Both directions: what one cannot judge, the other may.
    link_frames(xyz, offsets, limits, False, forward)
    link_frames(xyz, offsets, limits, True, backward)
    combine_directions(forward, backward, previous, following)
    return Links(previous, following)
