"""Boards on real images against OpenCV and the peer's own residuals."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from asterism.calibration.boards import Board, BoardCalibration, calibrate_board, find_board, footage_of
from asterism.cameras.bundle import AdjustSettings, Sightings, adjust, triangulate
from asterism.cameras.bundle.adjust import rms
from asterism.cameras.files import read_rig
from asterism.cameras.rig import Rig
from asterism.geometry import place_objects
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

PEER_ALONE = {"left": "<= 0.195", "right": "<= 0.207"}
PEER_PAIR = "<= 0.217"


def stereo(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """13 stereo pairs of a chessboard: each camera alone, the pair, and OpenCV's pair of the very same points."""
    views = find_board(footage_of([folder() / "cameras" / "chessboard-stereo"]), Board("chessboard", 9, 6, 0.025))
    made = calibrate_board(views)
    for one in made.intrinsics:
        name = one.camera.name
        yield Figure(f"chessboard-stereo, {name} alone, RMS", PEER_ALONE[name], one.camera.error, "px", len(one.frames))
    yield Figure("chessboard-stereo, the pair, RMS", PEER_PAIR, made.rms, "px", len(made.used))
    yield Figure("chessboard-stereo, the pair by OpenCV from the same points, RMS", "none", _opencv_pair(made), "px", len(made.used))


def _opencv_pair(made: BoardCalibration) -> float:
    """stereoCalibrate with the lenses of each camera alone held, on the same points."""
    seen, board = made.sightings, made.views.board.points.astype(np.float32)
    images = [
        [seen.xy[(seen.frame == t) & (seen.camera == c)].astype(np.float32) for t in range(len(made.used))] for c in range(len(made.rig))
    ]
    lenses = [part for one in made.intrinsics for part in (one.camera.matrix, one.camera.distortion)]
    error, *_ = cv2.stereoCalibrate([board] * len(made.used), *images, *lenses, made.rig.cameras[0].size, flags=cv2.CALIB_FIX_INTRINSIC)
    return float(error)


def charuco(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Four web cameras and a hand-held ChArUco board: each alone against the error in the peer's file, all against its rig."""
    place = folder() / "cameras" / "charuco-4cam"
    peer = read_rig(place / "camera_array.toml")
    made = calibrate_board(find_board(footage_of([place]), Board.from_toml(place / "charuco.toml")))
    for one in made.intrinsics:
        name = one.camera.name
        yield Figure(f"charuco-4cam, {name} alone, RMS", f"<= {peer[name].error:g}", one.camera.error, "px", len(one.frames))
    theirs, ours = _left_by(peer.select(list(made.rig.names)), made), _left_by(made.rig, made)
    yield Figure("charuco-4cam, all four together, RMS", f"<= {theirs:.4g}", ours, "px", len(made.sightings))
    yield Figure("charuco-4cam, all four by the peer's rig, same points, RMS", "none", theirs, "px", len(made.sightings))


def _left_by(rig: Rig, made: BoardCalibration) -> float:
    """What a rig leaves of the points of a calibration when only the boards may move."""
    seen: Sightings = made.sightings
    points = made.views.board.points
    placed = place_objects(points, triangulate(rig.cameras, seen, len(made.used), len(points)))
    both = np.isfinite(placed[1]).all(axis=1)
    kept, frames = seen.select(both[seen.frame]).compact()
    held = np.zeros((len(rig), 15), dtype=bool)
    left = adjust(
        rig.cameras, points, kept, placed[0][frames], placed[1][frames], free=held, settings=AdjustSettings(covariance=False, steps=200)
    )
    return rms(left.residuals)
