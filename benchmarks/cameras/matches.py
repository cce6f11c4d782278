"""Particles in a flow cell, four cameras, hundreds of identical blobs: matches of ours against those that OpenPTV left in its files.

The given orientations miss by some three pixels, which is why the peer allowed a band of 0.05 mm (four pixels). With over a thousand
blobs in each image most of what meets within such a band does so by chance. Two judges say how much: a camera's blobs
are shifted by 25 px, so that whatever still matches is chance; and a rig is fitted to the peer's own matches, robustly, and a match
whose rays miss its blobs by more than a pixel there is called a ghost, the peer's like ours.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from asterism.cameras import Rig
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters, triangulate
from asterism.cameras.files import read_rig
from asterism.reconstruction import ReconstructionSettings, reconstruct
from asterism.recording import Blobs, Floats, Ints
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.cameras.detection import CORNER
from benchmarks.data import folder
from benchmarks.figures import Figure

FRAMES, CAMERAS = 4, 4
PEERS_TOLERANCE = 2.5
"""px, standard deviation: with the gate about the peer's band."""
TIGHT = 0.5
MEETING = 1.0
"""px RMS: a match whose rays miss its blobs by more is a ghost."""
SHIFTS = ((0, 25.0), (1, -25.0), (2, 25.0), (3, -25.0))
_LENS = ("pose", "focal", "centre", "k1", "k2", "tangential")
_MENDING = ((2.5, ("pose",)), (1.5, ("pose", "focal")), (1.0, _LENS), (0.7, _LENS), (TIGHT, _LENS), (TIGHT, _LENS))


def matches(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Points matched in all four cameras over four time steps, from the peer's own blobs, and the ghosts among them, by setting.

    Asked is both at one setting, the peer's tolerance in the mended rig: at least as many points, fewer ghosts.
    """
    rig = read_rig(folder() / "cameras" / "particles-4cam")
    blobs, numbers = _targets(rig)
    peer, mended = _peers_matches(blobs, numbers), _mended(blobs, rig)
    judge = rig
    for scale in (2.0, 1.0, 0.5):
        judge = Rig(_adjusted(blobs, judge, peer, _LENS, scale).cameras)
    peers_ghosts = len(peer) - _meeting(blobs, judge, peer)
    row = "particles-4cam, matched in all four cameras"
    yield Figure(f"{row}, OpenPTV's files", "none", len(peer), "points", FRAMES)
    yield Figure(f"{row}, OpenPTV's files: ghosts", "none", peers_ghosts, "points", len(peer))
    for name, used, noise in (
        ("its tolerance, given rig", rig, PEERS_TOLERANCE),
        ("its tolerance, rig mended from the blobs", mended, PEERS_TOLERANCE),
        (f"{TIGHT} px, rig mended from the blobs", mended, TIGHT),
    ):
        own = _matches(blobs, used, noise)
        as_many, fewer = (f">= {len(peer)}", f"< {peers_ghosts}") if used is mended and noise == PEERS_TOLERANCE else ("none", "none")
        yield Figure(f"{row}, {name}", as_many, len(own), "points", FRAMES)
        yield Figure(f"{row}, {name}: ghosts", fewer, len(own) - _meeting(blobs, judge, own), "points", len(own))
        yield Figure(f"{row}, {name}: by chance", "none", _by_chance(blobs, used, noise), "points", len(SHIFTS))


def _targets(rig: Rig) -> tuple[Blobs, Ints]:
    """The peer's blobs, and the number of the point that it has put each into, -1 for none."""
    frames, cameras, rows = [], [], []
    for t in range(FRAMES):
        for c in range(CAMERAS):
            path = folder() / "cameras" / "particles-4cam" / "images" / f"cam{c + 1}.{10001 + t}_targets"
            rows.append(np.loadtxt(path, skiprows=1))
            frames.append(np.full(len(rows[-1]), t))
            cameras.append(np.full(len(rows[-1]), c))
    table = np.concatenate(rows)
    return Blobs.from_rows(np.concatenate(frames), np.concatenate(cameras), table[:, 1:3] - CORNER, rig.names), table[:, 7].astype(np.int64)


def _peers_matches(blobs: Blobs, numbers: Ints) -> Ints:
    """(n, 4) the blobs of each of the peer's points that four cameras show."""
    label = blobs.frame_of * (numbers.max() + 2) + numbers
    order = np.lexsort((blobs.camera_of, label))
    order = order[numbers[order] >= 0]
    _, first, count = np.unique(label[order], return_index=True, return_counts=True)
    return order[first[count == CAMERAS][:, None] + np.arange(CAMERAS)]


def _matches(blobs: Blobs, rig: Rig, noise: float) -> Ints:
    """(n, 4) the blobs of each of our points that four cameras show."""
    return reconstruct(blobs, rig, ReconstructionSettings(noise=noise, min_cameras=CAMERAS)).rays


def _by_chance(blobs: Blobs, rig: Rig, noise: float) -> float:
    """How many matches there are when one camera's blobs are shifted down or up, the mean over the cameras."""
    found = []
    for camera, shift in SHIFTS:
        xy = blobs.xy.copy()
        xy[blobs.camera_of == camera, 1] += shift
        found.append(len(_matches(replace(blobs, xy=xy), rig, noise)))
    return float(np.mean(found))


def _mended(blobs: Blobs, rig: Rig) -> Rig:
    """The rig after rounds of matching and robust bundle adjustment, each with a narrower gate: nothing but blobs goes in."""
    for noise, groups in _MENDING:
        rig = Rig(_adjusted(blobs, rig, _matches(blobs, rig, noise), groups, noise).cameras)
    return rig


def _adjusted(blobs: Blobs, rig: Rig, matches: Ints, groups: tuple[str, ...], scale: float) -> Adjustment:
    sightings = _sightings(blobs, matches)
    points = triangulate(rig.cameras, sightings, len(matches), 1)[:, 0]
    turned = np.tile(np.eye(3), (len(matches), 1, 1))
    free = free_parameters(CAMERAS, *groups)
    return adjust(rig.cameras, [[0.0, 0.0, 0.0]], sightings, turned, points, free=free, settings=AdjustSettings(loss="cauchy", scale=scale))


def _sightings(blobs: Blobs, matches: Ints) -> Sightings:
    number, camera = np.repeat(np.arange(len(matches)), CAMERAS), np.tile(np.arange(CAMERAS), len(matches))
    return Sightings.of(number, camera, np.zeros(len(number)), blobs.xy[matches.ravel()])


def _meeting(blobs: Blobs, rig: Rig, matches: Ints) -> int:
    """How many matches' four rays meet within a pixel, RMS over the cameras."""
    points: Floats = triangulate(rig.cameras, _sightings(blobs, matches), len(matches), 1)[:, 0]
    off = rig.project(points) - blobs.xy[matches.T]
    return int((np.sqrt((off**2).sum(axis=2).mean(axis=0)) <= MEETING).sum())
