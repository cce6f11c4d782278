"""Clouds in, tracklets out: unbroken pieces of one marker's path, cut wherever it might be another marker's.

Where the camera system numbered its tracks, they are followed, and cut at gaps and where they swap. Where it did not, points are linked by
motion. A missing link costs little, a wrong one makes a wrong label out of many right ones: what is not clear is not linked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Clouds, Floats, Ints
from asterism.tracking._cut_kernels import count_strays, find_cuts, mend
from asterism.tracking._link_kernels import LinkLimits, agree, link_through, number_chains, sort_frames


@dataclass(frozen=True)
class LinkRules:
    """When a point goes on with a track. Chosen on the gait recordings, thinned to 50 Hz too.

    The movement recordings showed where cuts were false: jerks of markers close together, at 70 Hz.

    noise         m that a prediction may always miss
    soft          m/s2 that a marker's acceleration may always change by from one frame to the next
    hard          m/s2 that it never changes by more than
    wild          the misses of the last frames may grow so many times
    clearer       a rival must be so many times farther from the prediction
    apart         m that it must be farther, besides
    strange       m/s that a new point's velocity may differ from its three nearest neighbours'
    spin          1/s, more than that for every metre to the nearest one
    unlike        more than that for each m/s that the neighbours disagree
    fastest       m/s of a point of whose surroundings nothing is known
    quiet         m that a numbered track misses where it cannot have swapped
    jump          m that a numbered track may be offset by in one frame without being cut for that alone
    stray         a numbered track strays that passes by a point so many times nearer than its own next one
    strays        share of the links that may: of more, numbers are no tracks (the n-th point of each frame, say) and say nothing
    """

    noise: float = 0.002
    soft: float = 40.0
    hard: float = 250.0
    wild: float = 2.0
    clearer: float = 2.5
    apart: float = 0.0015
    strange: float = 0.3
    spin: float = 8.0
    unlike: float = 1.0
    fastest: float = 8.0
    quiet: float = 0.006
    jump: float = 0.03
    stray: float = 3.0
    strays: float = 0.1

    def limits(self, rate: float) -> LinkLimits:
        """The rules in metres per frame, as the kernels read them."""
        dt = 1.0 / rate
        return LinkLimits(
            noise=self.noise,
            soft=self.soft * dt * dt,
            hard=self.hard * dt * dt,
            wild=self.wild,
            clearer=self.clearer,
            apart=self.apart,
            strange=self.strange * dt,
            spin=self.spin * dt,
            unlike=self.unlike,
            fastest=self.fastest * dt,
            quiet=self.quiet,
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

    Points that carry a track number are linked along it, except where it has a gap, and where another point goes on with the track (or
    another track with the point) clearly better: there it swapped, or jumped, and is cut. Points without a number are linked by motion,
    from both ends of the recording: a track goes on where it is expected, where the two are each other's best and no rival comes near;
    a link counts that both directions find, or one of which the other cannot judge, having no velocity yet. At last ends and beginnings
    that motion joins clearly are joined, across numbers too. The order of the points within their frames plays no part, but for
    coincident ones. Numbers that are no tracks, but the places of points in an order that changes from frame to frame, are told by their
    links and not used. O(P n) for n points a frame.
    """
    rules = rules or LinkRules()
    limits = rules.limits(clouds.rate)
    order = np.arange(len(clouds.xyz))
    sort_frames(clouds.xyz, clouds.offsets, order)
    xyz = np.ascontiguousarray(clouds.xyz[order])
    frame = np.repeat(np.arange(len(clouds)), clouds.counts)
    barred = np.full(len(xyz), -1, dtype=np.int64)
    numbers = _true_numbers(clouds, xyz, frame, order, rules)
    if numbers is None:
        previous, following = _by_motion(xyz, clouds.offsets, limits)
    else:
        previous, following = _along_numbers(numbers, frame)
        cut = np.zeros(len(xyz), dtype=np.bool_)
        find_cuts(xyz, clouds.offsets, previous, following, limits, cut)
        barred[cut] = previous[cut]
        following[previous[cut]] = -1
        previous[cut] = -1
        free = np.nonzero(numbers < 0)[0]
        offsets = np.concatenate([[0], np.cumsum(np.bincount(frame[free], minlength=len(clouds)))]).astype(np.int64)
        back, forth = _by_motion(np.ascontiguousarray(xyz[free]), offsets, limits)
        previous[free] = np.where(back >= 0, free[back], -1)
        following[free] = np.where(forth >= 0, free[forth], -1)
    mend(xyz, clouds.offsets, previous, following, barred, limits)

    sorted_numbers = np.empty(len(xyz), dtype=np.int64)
    count = number_chains(previous, sorted_numbers)
    of_point = np.empty(len(xyz), dtype=np.int64)
    of_point[order] = sorted_numbers
    first, last = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    first[sorted_numbers[previous < 0]] = frame[previous < 0]
    last[sorted_numbers[following < 0]] = frame[following < 0]
    return Tracklets(of_point, first, last)


def _true_numbers(clouds: Clouds, xyz: Floats, frame: Ints, order: Ints, rules: LinkRules) -> Ints | None:
    """The track numbers (P,) in the order of the sorted points, None where there are none or they are no tracks."""
    if clouds.tracks is None:
        return None
    numbers = clouds.tracks[order]
    links, strays = count_strays(xyz, clouds.offsets, _along_numbers(numbers, frame)[1], rules.stray, rules.jump)
    return None if strays > rules.strays * links else numbers


def _along_numbers(numbers: Ints, frame: Ints) -> tuple[Ints, Ints]:
    """The point before and after each along its track number, in the frames next to it: (P,) twice, -1 for none."""
    previous, following = np.full(len(numbers), -1, dtype=np.int64), np.full(len(numbers), -1, dtype=np.int64)
    by_number = np.argsort(numbers, kind="stable")
    before, after = by_number[:-1], by_number[1:]
    linked = (numbers[before] == numbers[after]) & (numbers[before] >= 0) & (frame[after] - frame[before] == 1)
    previous[after[linked]], following[before[linked]] = before[linked], after[linked]
    return previous, following


def _by_motion(xyz: Floats, offsets: Ints, limits: LinkLimits) -> tuple[Ints, Ints]:
    """The point before and after each by motion: (P,) twice, -1 for none."""
    forward, backward, previous, following = (np.empty(len(xyz), dtype=np.int64) for _ in range(4))
    link_through(xyz, offsets, limits, False, forward)
    link_through(xyz, offsets, limits, True, backward)
    agree(forward, backward, previous, following)
    return previous, following
