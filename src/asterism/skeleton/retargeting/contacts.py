"""A skeleton's feet over time in; where their soles are, and when heel and ball stand on something, out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from asterism.recording import Event, Floats, SkeletonMotion
from asterism.skeleton.retargeting.body_parts import SIDES, BodyParts

POINTS = ("heel", "ball")
"""Of the sole: below the ankle and a little behind it, and below the joint of the toes."""

_STILL = 0.20
"""m/s times the root of the leg's length over 0.9 m: a point of the sole that is faster hardly stands. Soles in stance are at 0.02 to
0.10 m/s by the noise of joints, in swing at 1 to 4 m/s. At half of it noisy stances break up, at double strikes begin a frame early."""
_FASTER = 0.05
"""Share of the hips' speed over what is stood on, by which a standing sole may be faster: feet are not as rigid as their bone. Balls of
sprinters' feet at 7 m/s are at 0.1 to 0.4 m/s in contact. At half of it half of their steps are lost, at double strikes begin early."""
_NEAR = 0.03
"""m for a leg of 0.9 m: height over its lowest place around, at which a point hardly stands. A ball of the foot rises by 10 mm while
the heel lifts. At half of it the roll over the toes is lost, at double the heel stays down too long."""
_AROUND = 0.25
"""s to both sides, in which the lowest place of a point is sought: half a swing, so that a foot in the air is held against the floor."""
_SHORTEST = 0.06
"""s: shorter contacts are none. A sprinter's foot is down for 0.09 s."""
_SHORTEST_ABOVE = 0.2
"""s, the same away from the floor: nobody stands on a stair for less, and feet in the air turn round within that."""
_SMOOTH = 0.015
"""s, over which velocities are smoothed: two frames at 120 Hz."""
_MOVES_ON = 0.02
"""Evidence below which a foot moves on, whatever events say: 0.4 m/s, or 60 mm above where it stood."""
_SLOW = 0.1
"""s, over which the speed of the hips is averaged: less than a step."""
_REFINED = 3
"""Times that the speed of a belt is found anew from what stands on it: the second changes it by 1 %, the third by less than 0.1 %."""
_BELT = 0.25
"""m/s, of soles on the floor, above which they stand on a belt. Treadmills walk from 0.3 m/s on; drifting soles are below 0.05 m/s."""
_SLOPE = 0.01
"""By which floors of recordings rise, as a standard deviation: a wand laid 5 mm askew over half a metre. At half of it slopes of 2 % are
halved over a few steps, at double two steps tilt the floor by their noise."""
_USUAL_SOLE = 0.045
"""Of stature, the ankle's height over the sole, where a skeleton ends at the ankles: the share of textbooks is 0.039 to 0.046."""
_USUAL_FOOT = 0.48
"""Of the shank's length, from the ankle to the tip of the toes, where a skeleton has no end of the foot."""
_BALL = 0.66
"""Of the distance from the ankle to the tip of the toes, how far ahead the ball is, where a skeleton has no joint of the toes."""
_HEEL = 0.25
"""Of the distance from the ankle to the ball, how far the heel is behind the ankle."""


@dataclass(frozen=True)
class Sole:
    """Points of a foot in the axes of its bone. heel, ball, tip (3,) m from the joints of the foot, the foot, and the toe or foot.

    toe  the bone of the toes, or -1
    """

    foot: int
    toe: int
    heel: Floats
    ball: Floats
    tip: Floats


@dataclass(frozen=True)
class FootContacts:
    """When soles stand, over T frames.

    standing  side -> (T, 2) bool of `POINTS`
    level     side -> (T, 2) m, the height over the floor on which each point stands; NaN where it does not
    belt      (3,) m/s, of what they stand on; zeros unless that is a treadmill
    floor     (3,): the height of the floor at the room's origin in m, and its rise along x and y
    source    "events" or "movement"
    """

    standing: Mapping[str, NDArray[np.bool_]]
    level: Mapping[str, Floats]
    belt: Floats
    floor: Floats
    source: str


def soles_of(motion: SkeletonMotion, parts: BodyParts) -> dict[str, Sole]:
    """The sole of each foot, in a room with z up, of a skeleton that stands in its rest pose."""
    places, ends = motion.rest_joints, motion.ends
    feet = {side: parts.bones[f"{side} foot"] for side in SIDES}
    tips = dict[str, Floats | None]()
    toes = dict[str, int]()
    for side, foot in feet.items():
        toe = parts.bones.get(f"{side} toe", -1)
        below = [b for b, parent in enumerate(motion.parents) if parent == foot]
        if toe < 0 and len(below) == 1 and not np.isfinite(ends[foot]).all():
            toe = below[0]
        toes[side] = toe
        last = toe if toe >= 0 else foot
        behind = [b for b, parent in enumerate(motion.parents) if parent == last]
        tips[side] = (
            places[last] + ends[last]
            if np.isfinite(ends[last]).all()
            else places[behind[0]]
            if behind
            else places[toe]
            if toe >= 0
            else None
        )
    low = [places[foot][2] for foot in feet.values()] + [places[toe][2] for toe in toes.values() if toe >= 0]
    low += [tip[2] for tip in tips.values() if tip is not None]
    body = [*parts.bones.values(), *parts.spine]
    reached = np.concatenate([places[body], (places + ends)[body]])[:, 2]
    stature = float(np.nanmax(reached) - np.nanmin(reached))
    ankles = float(np.mean([places[foot][2] for foot in feet.values()]))
    # a foot that ends no lower than its ankle says nothing of its sole
    floor = min(low) if min(low) < ankles - 0.2 * _USUAL_SOLE * stature else ankles - _USUAL_SOLE * stature
    soles = {}
    for side, foot in feet.items():
        toe, tip = toes[side], tips[side]
        shank = float(np.linalg.norm(places[foot] - places[parts.bones[f"{side} shank"]]))
        at = places[foot]
        ahead = (places[toe] if toe >= 0 else at) - at if tip is None else tip - at
        ahead = np.array([ahead[0], ahead[1], 0.0])
        length = float(np.linalg.norm(ahead))
        ahead = ahead / length if length > 0.05 * shank else np.array([1.0, 0.0, 0.0])
        length = length if length > 0.05 * shank else _USUAL_FOOT * shank
        to_toes = places[toe] - at if toe >= 0 else _BALL * length * ahead
        ball = np.array([*(at + to_toes)[:2], floor])
        to_ball = float(np.linalg.norm((ball - at)[:2]))
        heel = np.array([*(at - _HEEL * to_ball * ahead)[:2], floor])
        end = np.array([*(at + length * ahead if tip is None else tip)[:2], floor])
        soles[side] = Sole(foot, toe, heel - at, ball - at, end - (places[toe] if toe >= 0 else at))
    return soles


def sole_points(motion: SkeletonMotion, sole: Sole) -> Floats:
    """(T, 3, 3) m, heel, ball and tip in the room."""
    turned, joints = motion.turned, motion.joints
    last = sole.toe if sole.toe >= 0 else sole.foot
    foot = joints[:, sole.foot, None] + np.stack([sole.heel, sole.ball]) @ turned[:, sole.foot].swapaxes(1, 2)
    return np.concatenate([foot, (joints[:, last] + turned[:, last] @ sole.tip)[:, None]], axis=1)


def find_contacts(motion: SkeletonMotion, parts: BodyParts, events: Iterable[Event] = ()) -> FootContacts:
    """When heel and ball of each foot stand, by how still and low they are; within foot strike and foot off where events are given.

    motion  in a room with z up
    events  of the recording, times in s from its first frame; where they say nothing, the movement counts

    A point stands on any height, as on stairs, and moves with the belt of a treadmill.
    """
    soles, rate = soles_of(motion, parts), motion.rate
    points = {side: sole_points(motion, sole)[:, :2] for side, sole in soles.items()}
    leg = leg_length(motion, parts)
    every = np.concatenate(list(points.values()), axis=1)
    lowest = every[:, :, 2].min(axis=1)
    floor = np.array([float(np.quantile(lowest, 0.1)), 0.0, 0.0])
    speeds = {side: _velocity(one, _SMOOTH, rate) for side, one in points.items()}
    near, given = _NEAR * leg / 0.9, _phases(events, len(motion), rate)
    belt = _belt(every, np.concatenate(list(speeds.values()), axis=1), motion.root, floor[0], near, rate)
    # what stands on a belt tells its speed better than what is low; where nothing does, there is none
    for _ in range(_REFINED if belt.any() else 1):
        still = _STILL * np.sqrt(leg / 0.9) + _FASTER * np.linalg.norm(_velocity(motion.root, _SLOW, rate) - belt, axis=1)
        standing = {side: _stands(one, speeds[side] - belt, still, near, rate, given.get(side)) for side, one in points.items()}
        if belt.any():
            on_belt = np.concatenate([speeds[side][flags] for side, flags in standing.items()])
            belt = np.median(on_belt, axis=0) * (1.0, 1.0, 0.0) if len(on_belt) else np.zeros(3)
    level = dict[str, Floats]()
    if not belt.any():
        floor = _floor(points, standing, floor, near)
    for side, one in points.items():
        level[side] = _levels(standing[side], one[:, :, 2] - height_of(floor, one), near, rate)
        standing[side] &= np.isfinite(level[side])
        # heel and ball that stand together stand on one thing
        for a, b in stretches(np.asarray(standing[side].any(axis=1))):
            if standing[side][a:b].all(axis=1).any():
                level[side][a:b] = np.where(standing[side][a:b], np.nanmean(level[side][a:b]), np.nan)
    return FootContacts(standing, level, belt, floor, "events" if given else "movement")


def _velocity(points: Floats, width: float, rate: float) -> Floats:
    """m/s, of points (T, ...), smoothed over a width in s."""
    if len(points) < 2:
        return np.zeros_like(points)
    return np.asarray(np.gradient(gaussian_filter1d(points, width * rate, axis=0), 1.0 / rate, axis=0))


def _stands(
    points: Floats, velocity: Floats, still: Floats, near: float, rate: float, given: NDArray[np.int64] | None
) -> NDArray[np.bool_]:
    """(T, 2) whether heel and ball (T, 2, 3) stand, by their velocity over what they stand on and by events. still (T,) m/s, near m."""
    over = points[:, :, 2] - minimum_filter1d(points[:, :, 2], 2 * int(_AROUND * rate) + 1, axis=0, mode="nearest")
    evidence = np.exp(-((np.linalg.norm(velocity, axis=2) / still[:, None]) ** 2) - (over / near) ** 2)
    down = evidence > 0.5
    # of a still foot that stands on its toes, or lies behind a knee, only the lower end stands
    tilt = points[:, 0, 2] - points[:, 1, 2]
    down &= np.column_stack([tilt < near, tilt > -near]) | ~down.all(axis=1, keepdims=True)
    if given is not None:
        down &= (given >= 0)[:, None]
        # in a stance something stands, unless both move as feet in the air do: then events between are missing
        none = (given > 0) & ~down.any(axis=1) & (evidence.max(axis=1) > _MOVES_ON)
        down[none, evidence[none].argmax(axis=1)] = True
    return np.stack([_long(column, _SHORTEST * rate) for column in down.T], axis=1)


def height_of(floor: Floats, points: Floats) -> Floats:
    """(...) m, the height of a floor, as `FootContacts` has it, under points (..., 3)."""
    return floor[0] + points[..., :2] @ floor[1:]


def _floor(points: Mapping[str, Floats], standing: Mapping[str, NDArray[np.bool_]], floor: Floats, near: float) -> Floats:
    """The plane on which soles stand, from the contacts that are near to it: recorded floors are not quite level.

    Ridge regression: soles are off by two thirds of `near` each, with those about them, and rooms by `_SLOPE`: one step tilts no floor.
    """
    places = np.array(
        [np.median(points[side][a:b, p], axis=0) for side, flags in standing.items() for p in range(2) for a, b in stretches(flags[:, p])]
    ).reshape(-1, 3)
    if not len(places):
        return floor
    middle = places[:, :2].mean(axis=0)
    design = np.column_stack([np.ones(len(places)), places[:, :2] - middle])
    ridge = np.diag([0.0, 1.0, 1.0]) * (near / 1.5 / _SLOPE) ** 2
    found = floor.copy()
    for _ in range(3):
        # what stands on a stair is no floor
        close = np.abs(places[:, 2] - height_of(found, places)) < 2 * near
        if not close.any():
            return found
        rows = design[close]
        height, *slope = np.linalg.solve(rows.T @ rows + ridge, rows.T @ places[close, 2])
        found = np.array([height - middle @ slope, *slope])
    return found


def leg_length(motion: SkeletonMotion, parts: BodyParts) -> float:
    """m, from hip to sole, along the bones and down from the ankle, the mean of both sides."""
    places, soles = motion.rest_joints, soles_of(motion, parts)
    lengths = []
    for side in SIDES:
        hip, knee, ankle = (places[parts.bones[f"{side} {part}"]] for part in ("thigh", "shank", "foot"))
        lengths.append(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee) - soles[side].heel[2])
    return float(np.mean(lengths))


def stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First frame, and the one behind the last, of each stretch of frames that are flagged."""
    edges = np.nonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))[0]
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _long(flags: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
    """Without stretches that are shorter than `least` frames, after breaks that are as short were closed."""
    out = flags.copy()
    for a, b in stretches(~out):
        if a > 0 and b < len(out) and b - a < 0.5 * least:
            out[a:b] = True
    for a, b in stretches(out):
        # at the ends of the recording a contact may go on outside
        if b - a < least and a > 0 and b < len(out):
            out[a:b] = False
    return out


def _levels(standing: NDArray[np.bool_], height: Floats, near: float, rate: float) -> Floats:
    """(T, 2) m, what each point stands on: the median of its height over a contact; the floor where that is near; NaN for nothing."""
    level = np.full(standing.shape, np.nan)
    for p in range(standing.shape[1]):
        for a, b in stretches(standing[:, p]):
            middle = float(np.median(height[a:b, p]))
            if abs(middle) < 1.5 * near:
                level[a:b, p] = 0.0
            elif b - a >= _SHORTEST_ABOVE * rate:
                level[a:b, p] = middle
    return level


def _belt(points: Floats, speeds: Floats, root: Floats, floor: float, near: float, rate: float) -> Floats:
    """(3,) m/s, the velocity of what soles stand on; zero unless the low points of all frames move alike and the body stays."""
    lowest = points[:, :, 2].argmin(axis=1)[:, None]
    height = np.take_along_axis(points[:, :, 2], lowest, axis=1)[:, 0]
    low = np.take_along_axis(speeds, lowest[:, :, None], axis=1)[height < floor + near, 0]
    if len(low) < 0.5 * rate:
        return np.zeros(3)
    velocity = np.median(low, axis=0) * (1.0, 1.0, 0.0)
    speed = float(np.linalg.norm(velocity))
    spread = np.median(np.linalg.norm((low - velocity)[:, :2], axis=1))
    travelled = float(np.linalg.norm((root[-1] - root[0])[:2])) / (len(root) / rate)
    # who slides over the floor goes with the feet; on a belt the body stays
    return velocity if speed > _BELT and spread < 0.6 * speed and travelled < 0.5 * speed else np.zeros(3)


def _phases(events: Iterable[Event], frames: int, rate: float) -> dict[str, NDArray[np.int64]]:
    """side -> (T,) 1 from a foot strike to the off behind it, -1 from an off to the strike behind it, 0 where events do not say.

    Files hold events of some steps only, so that nothing is known before the first one, behind the last, and between two of a kind.
    """
    found = dict[str, NDArray[np.int64]]()
    for side in SIDES:
        own = sorted((event.time, "strike" in event.label.casefold()) for event in events if _is_foot(event, side))
        phase = np.zeros(frames, dtype=np.int64)
        for (begin, strike), (end, other) in pairwise(own):
            if strike != other:
                phase[max(0, round(begin * rate)) : max(0, round(end * rate))] = 1 if strike else -1
        if phase.any():
            found[side] = phase
    return found


def _is_foot(event: Event, side: str) -> bool:
    label = event.label.casefold()
    return event.context.casefold()[:1] == side[0] and ("strike" in label or "off" in label)
