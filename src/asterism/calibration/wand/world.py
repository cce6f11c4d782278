"""Where the world of a rig begins and what is up: from the cameras themselves, an L-frame, a wand on the floor, or three points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand.frames import widest_image
from asterism.calibration.wand.identify import identify, wand_of
from asterism.calibration.wand.poses import locate_wand
from asterism.cameras.bundle import Sightings, locate
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.geometry import fit_rigid
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class WorldRules:
    """What still markers and a wand on the floor must fulfil to give a world.

    gate            widths of the image: how far blobs may be from where a still marker should be
    steady          widths of the image, added to `steady_px` px: blobs within three times this of one another are of one still marker
    steady_px       see `steady`
    shown           share of the frames with blobs in which a camera must show a still marker
    ray_miss        share of the distances to two cameras by which their rays of one marker may miss each other
    at_rest         m: a wand whose ends stay this near to where they were lies still
    shortest_rest   share of the longest rest: shorter ones are moments on the way
    longest_miss    share of its size by which a measured L-frame may differ from what was given
    alike           share of its size: a second way to lay the L-frame that misses by less than this, or by less than twice the best
                    one's miss, looks alike
    in_line         second singular value of the places where the wand lay, as a share of the first: below it, they lie in one line
    off_plane       m, median, and `uneven`, third singular value as a share of the second: above one of them, the floor is no plane
    uneven          see `off_plane`
    deepest         m below the floor where no camera stands
    upside_down     upward part of an image's down (share of one) that no camera has by hanging askew
    level           length of the mean of the cameras' up directions: below it, the first camera's counts

    Checked on the simulated L-frames and floors of tests/test_wand.py.
    """

    gate: float = 0.004
    steady: float = 0.001
    steady_px: float = 0.5
    shown: float = 0.5
    ray_miss: float = 0.02
    at_rest: float = 0.01
    shortest_rest: float = 0.1
    longest_miss: float = 0.02
    alike: float = 0.003
    in_line: float = 0.1
    off_plane: float = 0.01
    uneven: float = 0.15
    deepest: float = 0.1
    upside_down: float = 0.3
    level: float = 0.2


RULES = WorldRules()
_UP = np.array([0.0, 0.0, 1.0])

Similarity = tuple[Floats, Floats, float]
"""rotation (3, 3), translation (3,) m and scale: X in the new world = scale rotation X + translation."""


def default_world(rig: Rig, positions: Floats) -> tuple[Floats, Floats]:
    """A world frame where no floor was given: z against the images' down on average, x to the first camera's right.

    positions (..., 3) m, of the wand: the origin is below its middle. Returns rotation (3, 3) and translation (3,) m
    into it. A guess of what is up, good to a few degrees where
    cameras are hung level.
    """
    # An image's y axis points down, and tilts of cameras round a room cancel in the sum.
    up = -np.sum([camera.rotation[1] for camera in rig], axis=0)
    if np.linalg.norm(up) < RULES.level * len(rig):
        # Cameras hung on their sides or heads in equal numbers leave no common up.
        up = -rig[0].rotation[1]
    z = up / np.linalg.norm(up)
    x = rig[0].rotation[0] - (rig[0].rotation[0] @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z])
    points = positions.reshape(-1, 3) @ rotation.T
    points = points[np.isfinite(points).all(axis=1)]
    origin = np.append(np.median(points[:, :2], axis=0), points[:, 2].min()) if len(points) else np.zeros(3)
    return rotation, -origin


def world_from_points(origin: ArrayLike, x: ArrayLike, y: ArrayLike) -> Similarity:
    """The world whose origin and x axis are two points, and whose xy plane holds the third on the side of +y; all (3,) m.

    Raises AsterismError where they lie in a line.

    >>> rotation, translation, scale = world_from_points(origin=[1, 0, 0], x=[1, 2, 0], y=[0, 0, 0])
    >>> (scale * rotation @ [1, 2, 0] + translation).round(6).tolist()  # the second point: two metres along the new x
    [2.0, 0.0, 0.0]
    """
    o, a, b = (np.asarray(point, dtype=np.float64) for point in (origin, x, y))
    along, normal = a - o, np.cross(a - o, b - o)
    # The cross product is twice the triangle's area: small against its sides, the direction of z is noise.
    if np.linalg.norm(normal) < 1e-3 * max(np.linalg.norm(along), np.linalg.norm(b - o)) ** 2:
        raise AsterismError("the three points of the world frame lie in a line (or two are one); choose three that span the floor.")
    z = normal / np.linalg.norm(normal)
    first = along / np.linalg.norm(along)
    rotation = np.array([first, np.cross(z, first), z])
    return rotation, -rotation @ o, 1.0


def world_from_l_frame(rig: Rig, still: Blobs, markers: ArrayLike, *, scaled: bool = True) -> Similarity:
    """The world in which markers that lie still are where an L-frame has them.

    still    a recording of the L-frame, strays that move or stay among it
    markers  (M, 3) m, three or more, in the wanted world: such as (0,0,0), (0.2,0,0), (0.6,0,0), (0,0.4,0)
    scaled   whether the rig has metres already; else the L-frame gives the scale, too

    Markers are distinguished by their distances. Raises AsterismError where they are not found, look alike from two sides, or lead to a
    world that hangs upside down.
    """
    wanted = np.asarray(markers, dtype=np.float64).reshape(-1, 3)
    if len(wanted) < 3 or np.linalg.matrix_rank(wanted - wanted.mean(axis=0), tol=1e-6) < 2:
        raise AsterismError("an L-frame needs three markers or more that are not in a line; give where each is, in metres.")
    points = still_points(rig, still)
    if len(points) < len(wanted):
        raise AsterismError(
            f"only {len(points)} still markers are seen by two cameras, the L-frame has {len(wanted)}; show it to more cameras."
        )
    gaps = np.linalg.norm(wanted[:, None] - wanted[None], axis=2)
    seen = np.linalg.norm(points[:, None] - points[None], axis=2)
    ranked = _matches(gaps, seen, scaled)
    if not ranked:
        raise AsterismError(
            "no still markers lie as the L-frame's should; check its distances, "
            f"those seen are {', '.join(f'{gap:.3f}' for gap in np.sort(seen[np.triu_indices(len(points), 1)])[:12])} m."
        )
    miss, chosen = ranked[0]
    # Better no world than one that may be turned by a quarter.
    if len(ranked) > 1 and ranked[1][0] < max(2.0 * miss, RULES.alike * gaps.max()):
        raise AsterismError("the L-frame looks alike from two sides; give it arms of different lengths.")
    found = points[list(chosen)]
    scale = 1.0 if scaled else float(gaps.sum() / seen[np.ix_(chosen, chosen)].sum())
    rotation, translation = fit_rigid(scale * found, wanted)
    _check_up(rig.moved(rotation, translation, scale), "the L-frame's arms are swapped")
    return rotation, translation, scale


def world_from_floor_wand(rig: Rig, lying: Blobs, lengths: ArrayLike) -> Similarity:
    """The world whose floor is where a wand lay, in two directions or more.

    x is along the wand as it lay first, the origin at its first marker. Frames in which it is carried from one place to the next do not
    count. Raises AsterismError where it lay in one line only, or did not lie in a plane, or on one that is no floor for the cameras.
    """
    wand = wand_of(lengths)
    if len(wand) < 2:
        raise AsterismError("one marker on the floor tells no direction; lay a wand of two or three markers there.")
    width = widest_image(rig)
    cameras = [rig[name] if name in rig.names else None for name in lying.cameras]
    poses = locate_wand(lying, identify(lying, wand), wand, cameras, RULES.gate * width)
    there = np.isfinite(poses.starts[:, 0])
    if not there.any():
        raise AsterismError("no two cameras of the rig see the wand on the floor; lay it where they do.")
    rests = _rests(poses.starts[there], poses.starts[there] + wand.lengths[-1] * poses.directions[there], wand.symmetric)
    points = np.concatenate(rests).reshape(-1, 3)
    middle = np.median(points, axis=0)
    _, sizes, vt = np.linalg.svd(points - middle, full_matrices=False)
    if sizes[1] < RULES.in_line * sizes[0]:
        raise AsterismError("the wand lay in one line only, which leaves open what is up; lay it down in two directions.")
    off = np.median(np.abs((points - middle) @ vt[2]))
    if off > RULES.off_plane or sizes[2] > RULES.uneven * sizes[1]:
        raise AsterismError(f"the wand did not lie in one plane (off by {1000 * off:.0f} mm and more); lay it still, on a flat floor.")
    # A plane has two sides, and cameras hang above the floor.
    z = vt[2] if np.median([(camera.position - middle) @ vt[2] for camera in rig]) > 0.0 else -vt[2]
    _check_floor(rig, middle, z)
    origin, end = np.median(rests[0], axis=0)
    return world_from_points(origin, end, origin + np.cross(z, end - origin))


def _rests(starts: Floats, ends: Floats, symmetric: bool) -> list[Floats]:
    """Where the wand lay still, one after the other: (n, 2, 3) m, its two ends in each frame.

    starts, ends  (T, 3) m; symmetric: they may be exchanged from frame to frame, and are not within a rest
    Stretches much shorter than the longest, which are moments on the way from one place to the next, are left out.
    """
    rests: list[list[Floats]] = []
    for now in np.stack([starts, ends], axis=1):
        # Compared with the rest's first frame, not with the last one: a slow slide must not pass for lying still.
        for way in [now, now[::-1]] if symmetric else [now]:
            if rests and np.linalg.norm(way - rests[-1][0], axis=1).max() < RULES.at_rest:
                rests[-1].append(way)
                break
        else:
            rests.append([now])
    longest = max(len(rest) for rest in rests)
    return [np.array(rest) for rest in rests if len(rest) > RULES.shortest_rest * longest]


def still_points(rig: Rig, blobs: Blobs) -> Floats:
    """What stays at one place in a recording and is seen by two cameras or more: (n, 3) m, those that most cameras see first."""
    width = widest_image(rig)
    places = {name: _still(blobs, c, RULES.steady * width + RULES.steady_px) for c, name in enumerate(blobs.cameras) if name in rig.names}
    rays = {name: rig[name].rays(xy) for name, xy in places.items() if len(xy)}
    proposals = []
    for a, b in combinations(rays, 2):
        points = _crossings(rig[a].position, rays[a], rig[b].position, rays[b])
        votes, miss = np.zeros(len(points)), np.zeros(len(points))
        for name, xy in places.items():
            if len(xy):
                projected = rig[name].project(points)
                off = np.linalg.norm(projected[:, None] - xy[None], axis=2)
                near = np.where(np.isfinite(off), off, np.inf).min(axis=1)
                good = near < RULES.gate * width
                votes += good
                miss += np.where(good, near, 0.0)
        # Two cameras always agree about a crossing of rays; what a third one confirms comes first.
        proposals += [(int(vote), float(sum_), point) for vote, sum_, point in zip(votes, miss, points, strict=True) if vote >= 2]
    kept: list[Floats] = []
    taken = {name: np.zeros(len(xy), dtype=bool) for name, xy in places.items()}
    # Most confirmed first, and each image of a marker once: what is left of ghosts finds its images taken.
    for _, _, point in sorted(proposals, key=lambda proposal: (-proposal[0], proposal[1])):
        own = {}
        for name, xy in places.items():
            if len(xy):
                off = np.linalg.norm(xy - rig[name].project(point), axis=1)
                at = int(np.argmin(np.where(np.isfinite(off), off, np.inf)))
                if off[at] < RULES.gate * width and not taken[name][at]:
                    own[name] = at
        if len(own) >= 2:
            for name, at in own.items():
                taken[name][at] = True
            kept.append(_precise(rig, {name: places[name][at] for name, at in own.items()}))
    return np.array(kept).reshape(-1, 3)


def _precise(rig: Rig, seen: dict[str, Floats]) -> Floats:
    """One point from its images, by least squares of reprojection errors."""
    names = list(seen)
    sightings = Sightings.of(np.zeros(len(names), int), np.arange(len(names)), np.zeros(len(names), int), [seen[name] for name in names])
    return locate([rig[name] for name in names], sightings, 1, 1)[0, 0]


def _still(blobs: Blobs, camera: int, radius: float) -> Floats:
    """Places (n, 2) px at which this camera sees a blob in most frames: the median of each heap."""
    own = blobs.camera_of == camera
    xy, frames = blobs.xy[own], blobs.frame_of[own]
    shown = len(np.unique(frames))
    places: list[Floats] = []
    left = np.ones(len(xy), dtype=bool)
    while left.any():
        # Any blob may begin a heap: what never moves makes one heap from any of its own.
        seed = xy[np.argmax(left)]
        heap = left & (np.linalg.norm(xy - seed, axis=1) < 3.0 * radius)
        left &= ~heap
        if len(np.unique(frames[heap])) > RULES.shown * shown:
            places.append(np.median(xy[heap], axis=0))
    return np.array(places).reshape(-1, 2)


def _crossings(a: Floats, rays_a: Floats, b: Floats, rays_b: Floats) -> Floats:
    """(n m, 3) m, the middles of the shortest lines between all rays of two cameras that come near each other before both."""
    one, other = (part.reshape(-1, 3) for part in np.broadcast_arrays(rays_a[:, None], rays_b[None]))
    between = b - a
    across = (one * other).sum(axis=1)
    along_a, along_b = one @ between, other @ between
    # Parallel rays have no nearest point; the floor keeps them finite, and the gate below drops them.
    under = np.maximum(1.0 - across**2, 1e-9)
    s, t = (along_a - across * along_b) / under, (across * along_a - along_b) / under
    first, second = a + s[:, None] * one, b + t[:, None] * other
    near = (np.linalg.norm(first - second, axis=1) < RULES.ray_miss * (s + t)) & (s > 0.0) & (t > 0.0) & np.isfinite(s)
    return np.asarray(0.5 * (first + second)[near], dtype=np.float64)


def _matches(wanted: Floats, seen: Floats, scaled: bool) -> list[tuple[float, tuple[int, ...]]]:
    """Ordered choices of points whose distances (m) are as wanted, best first: the largest miss in m, and the choice."""
    size = float(wanted.max())
    found: list[tuple[float, tuple[int, ...]]] = []

    def extend(chosen: tuple[int, ...]) -> None:
        k = len(chosen)
        if k >= 2:
            own, target = seen[np.ix_(chosen, chosen)], wanted[:k, :k]
            factor = 1.0 if scaled else target.sum() / max(own.sum(), 1e-12)
            miss = float(np.abs(factor * own - target).max())
            # A choice that fails with few markers fails with all: leave the branch.
            if miss > RULES.longest_miss * size:
                return
            if k == len(wanted):
                found.append((miss, chosen))
                return
        for point in range(len(seen)):
            if point not in chosen:
                extend((*chosen, point))

    extend(())
    return sorted(found)


def _check_floor(rig: Rig, middle: Floats, z: Floats) -> None:
    """Raise AsterismError where a camera is below the floor that a wand lay on, or all see it upside down: as where y runs upwards.

    A plane has two sides, and the one with the cameras is taken for up: a mirrored world would pass but for that.
    """
    heights = {camera.name: float((camera.position - middle) @ z) for camera in rig}
    lowest = min(heights, key=lambda name: heights[name])
    if heights[lowest] < -RULES.deepest:
        raise AsterismError(
            f"camera {lowest} would stand {-heights[lowest]:.2f} m below the floor; lay the wand flat on the floor, in both directions."
        )
    if all(float(camera.rotation[1] @ z) > RULES.upside_down for camera in rig):
        raise AsterismError(
            "all cameras would hang upside down above this floor: y is counted from the bottom in the images, which mirrors the world; "
            "if they do hang so, give an L-frame or three points."
        )


def _check_up(rig: Rig, cause: str) -> None:
    """Raise AsterismError where most cameras hang below the floor z = 0 of the new world."""
    below = [camera.name for camera in rig if camera.position @ _UP < 0.0]
    if 2 * len(below) > len(rig):
        raise AsterismError(
            f"the world would hang upside down, with {len(below)} of {len(rig)} cameras below the floor: {cause}, "
            "or the images are mirrored (y counted from the bottom)."
        )


def in_world(rig: Rig, world: Similarity, source: str) -> Rig:
    """The rig in a world frame with z up; `source` says what gave it, for the rig's metadata.

    Raises AsterismError where most cameras hang below it.
    """
    rotation, translation, scale = world
    moved = rig.moved(rotation, translation, scale)
    _check_up(moved, "x and y are swapped")
    return replace(moved, vertical=_UP, metadata={**rig.metadata, "world": source})
