"""Blobs of cameras that come in one after the other: their clocks, their frames, and the points that they show, beside what is true."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Camera, Rig
from asterism.formats.csv_blobs import write_blobs
from asterism.live import LiveFrame, SourceEnded
from asterism.live.blobs import ReplayBlobs, RigSource
from asterism.reconstruction import ReconstructionSettings, Reconstructor, reconstruct
from asterism.recording import Blobs

RATE = 100.0


def ring(cameras: int = 6, size: tuple[int, int] = (1280, 1024)) -> Rig:
    """Cameras around the origin, each with its own lens."""
    made = []
    for n in range(cameras):
        angle = 2 * math.pi * n / cameras + 0.1
        place = np.array([4.5 * math.cos(angle), 4.5 * math.sin(angle), 2.0 + 0.3 * (n % 3)])
        forward = np.array([0.0, 0.0, 0.9]) - place
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        lens = (-0.12 - 0.01 * n, 0.03, 0.0)
        made.append(
            Camera(
                f"c{n + 1}",
                size,
                (1050.0 + 5 * n, 1052.0 + 5 * n),
                (640.0 - n, 511.0 + n),
                rotation,
                -rotation @ place,
                lens,
                (1e-3, -5e-4),
            )
        )
    return Rig(tuple(made), vertical=np.array([0.0, 0.0, 1.0]))


def seen_by(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(n, 2) px: the pinhole with Brown's distortion, written out here and not the estimator's."""
    x, y, z = (points @ camera.rotation.T + camera.translation).T
    x, y = x / z, y / z
    square = x**2 + y**2
    k1, k2, k3 = camera.radial
    p1, p2 = camera.tangential
    factor = 1 + k1 * square + k2 * square**2 + k3 * square**3
    u = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x**2)
    v = y * factor + p1 * (square + 2 * y**2) + 2 * p2 * x * y
    return np.column_stack([camera.focal[0] * u + camera.centre[0], camera.focal[1] * v + camera.centre[1]])


def walking(time: float, markers: int = 12) -> np.ndarray:
    """(markers, 3) m at a time: limbs that swing at 1 Hz, up to 3 m/s."""
    number = np.arange(markers)
    swing = np.sin(2 * np.pi * time + number)
    return np.column_stack(
        [
            0.35 * np.cos(1.7 * number) + 0.3 * swing,
            0.5 * np.sin(1.7 * number) + 0.2 * np.sin(np.pi * time),
            0.3 + 0.12 * number + 0.1 * np.cos(2 * np.pi * time + number),
        ]
    )


class Noise:
    """Pixels that drift from frame to frame, as of images that are sampled: an autoregression with 0.7 of the last, 0.2 px."""

    def __init__(self, seed: int = 0) -> None:
        self._rng, self._last = np.random.default_rng(seed), np.zeros((1, 1))

    def add(self, xy: np.ndarray) -> np.ndarray:
        if self._last.shape != xy.shape:
            self._last = self._rng.normal(0, 0.2, xy.shape)
        self._last = 0.7 * self._last + self._rng.normal(0, 0.2 * math.sqrt(1 - 0.49), xy.shape)
        return xy + self._last


def recorded(rig: Rig, frames: int, delays: np.ndarray | None = None) -> Blobs:
    """What the cameras record of the walk, each `delays` (C,) s later."""
    noise = [Noise(c) for c in range(len(rig))]
    rows, order = [], np.random.default_rng(1)
    times = np.arange(frames)[:, None] / RATE + (np.zeros(len(rig)) if delays is None else delays)
    for t in range(frames):
        for c, camera in enumerate(rig):
            xy = noise[c].add(seen_by(camera, walking(times[t, c])))
            rows += [(t, c, *place) for place in order.permutation(xy)]
    frame, camera_of, x, y = np.array(rows).T
    return Blobs.from_rows(
        frame, camera_of, np.column_stack([x, y]), rig.names, rate=RATE, frames=frames, times=None if delays is None else times
    )


def frames_of(source: RigSource) -> list[LiveFrame]:
    """All frames to the end."""
    taken = []
    try:
        while True:
            frame = source.read(1.0)
            if frame is not None:
                taken.append(frame)
    except SourceEnded:
        return taken
    finally:
        source.close()


def misses(frame: LiveFrame) -> np.ndarray:
    """m from each true marker at the frame's time to the nearest point."""
    if not len(frame.points):
        return np.full(12, np.inf)
    return np.linalg.norm(walking(frame.time)[:, None] - frame.points[None], axis=2).min(axis=1)


def test_frames_one_by_one_give_the_points_of_the_whole_recording() -> None:
    rig = ring()
    blobs = recorded(rig, 60)
    whole = reconstruct(blobs, rig)
    one = Reconstructor(rig)
    for t in range(60):
        one.push([blobs.of(t, c) for c in range(len(rig))])
    fits, findings = one.learn(RATE)
    assert fits == () and one.noise_known and one.model is not None
    # The noise of the recording and of its last frames, which are here the same.
    assert one.model.noise[0] == pytest.approx(whole.noise[0], rel=0.05)
    near = 0
    for t in range(60):
        points = one.push([blobs.of(t, c) for c in range(len(rig))]).points
        assert len(points) == len(whole.clouds[t])
        near += int(np.abs(np.sort(points, axis=0) - np.sort(whole.clouds[t], axis=0)).max() < 1e-6)
    assert near >= 58
    fits, findings = one.learn(RATE)
    assert [finding.code for finding in findings] == []
    assert max(fit.systematic for fit in fits) < 0.3


def test_the_same_model_gives_exactly_the_same_points() -> None:
    rig = ring(4)
    blobs = recorded(rig, 10)
    one = Reconstructor(rig, ReconstructionSettings(noise=0.2))
    model = None
    for t in range(10):
        one.push([blobs.of(t, c) for c in range(4)])
        model = one.model
    assert model is not None
    again = Reconstructor(rig, ReconstructionSettings(noise=0.2), model)
    first, second = (each.push([blobs.of(9, c) for c in range(4)]).points for each in (one, again))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("delays", [None, np.array([0.0, 0.0011, 0.0035, 0.002, 0.0052, 0.0008])], ids=["triggered", "rolling"])
def test_a_played_file_gives_points_where_the_markers_were(delays: np.ndarray | None, tmp_path: Path) -> None:
    """0.2 px at 4.5 m are 0.9 mm; markers move up to 25 mm between two images of a camera."""
    rig = ring()
    write_blobs(recorded(rig, 120, delays), tmp_path / "blobs.csv")
    source = RigSource(ReplayBlobs(tmp_path / "blobs.csv", rig.names, speed=math.inf), rig, waits=True)
    frames = frames_of(source)
    assert len(frames) >= (120 if delays is None else 95)
    assert [frame.number for frame in frames] == list(range(frames[0].number, frames[0].number + len(frames)))
    # The last frames of a file have no image behind them.
    apart = np.array([misses(frame) for frame in frames[5:-3]])
    assert np.quantile(apart, 0.99) < 0.003
    assert np.median([len(frame.points) for frame in frames]) == 12
    if delays is not None:
        assert 0.004 < source.delay < 0.006, "the latest camera's image after the instant of the first one"
    assert source.findings() == [] or delays is not None
