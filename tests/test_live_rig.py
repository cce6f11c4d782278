"""Blobs of cameras that come in one after the other: their clocks, their frames, and the points that they show, beside what is true."""

from __future__ import annotations

import json
import math
import multiprocessing
import queue
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import LONG, until

from asterism import AsterismError
from asterism.cameras import Camera, Rig
from asterism.cameras.files import write_rig
from asterism.cli import main
from asterism.formats.csv_blobs import read_blobs, write_blobs
from asterism.live import Health, HostPort, LiveFrame, SourceEnded, recording_of, session_findings
from asterism.live.blobs import JsonBlobs, ReplayBlobs, RigProcess, RigSource, blobs_as_json, blobs_of_json
from asterism.live.blobs.sources import why_no_blobs
from asterism.live.camera_frames import LiveBlobs
from asterism.reconstruction import ReconstructionSettings, Reconstructor, reconstruct
from asterism.reconstruction.rays import frame_to_rays, to_rays
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
        assert 0.004 < source.image_wait < 0.006, "the latest camera's image after the instant of the first one"
    assert source.findings() == [] or delays is not None


def test_the_rays_of_a_frame_at_once_are_those_of_each_camera() -> None:
    """Lenses of different lengths, a blob beyond the lens, and one that stands twice."""
    rig = ring(3)
    rig = Rig((rig[0], replace(rig[1], radial=(-0.1,)), replace(rig[2], radial=(-0.1, 0.02, 0.0, 1e-3), denominator=(0.01, 0.0, 0.0))))
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 1000, (63, 2))
    xy[25], xy[61:] = [9e4, 9e4], [3.0, 4.0]
    blobs = Blobs.from_rows(np.zeros(63, dtype=int), np.repeat([0, 1, 2], 21), xy, rig.names)
    one = Reconstructor(rig)
    one.push([blobs.of(0, c) for c in range(3)])
    assert one._state is not None
    (each, *counts), (once, *others) = to_rays(blobs, rig), frame_to_rays(blobs, one._state[2])
    assert counts == others == [1, 1] and [one.no_ray, one.duplicates] == counts
    for name in ("normalised", "jacobian"):
        np.testing.assert_array_equal(getattr(each, name), getattr(once, name))
    np.testing.assert_array_equal(each.blobs.offsets, once.blobs.offsets)


def told(source: RigSource) -> set[str]:
    return {finding.code for finding in source.findings()}


class Played:
    """A source of the images given, as fast as they are taken."""

    damaged = 0
    name = "given"

    numbered_together = True

    def __init__(self, images: Iterable[LiveBlobs], cameras: tuple[str, ...], rate: float = 10.0) -> None:
        # A rate of a tenth, so that the cameras are judged after each hundred frames.
        self.cameras, self.rate = cameras, rate
        self._left = iter(images)

    def read(self, timeout: float) -> LiveBlobs:
        for image in self._left:
            return image
        raise SourceEnded

    def close(self) -> None:
        pass


def images(
    rig: Rig, frames: int, change: Callable[[int, int, np.ndarray], np.ndarray] | None = None, late: tuple[int, int] = (0, 0)
) -> Iterator[LiveBlobs]:
    """What the cameras see; change: of frame, camera and its blobs; late: a camera, and by how many frames its images are older."""
    noise = [Noise(c) for c in range(len(rig))]
    for t in range(frames):
        for c, camera in enumerate(rig):
            xy = noise[c].add(seen_by(camera, walking((t - (late[1] if c == late[0] else 0)) / RATE)))
            xy = xy if change is None else change(t, c, xy)
            yield LiveBlobs(camera.name, t, t / RATE, 50.0 + t / RATE, xy, np.full(len(xy), 5.0))


def judged(rig: Rig, frames: int = 300, rate: float = 10.0, **more: Any) -> RigSource:
    """A source after all its frames: judged after 24, 256, each ten seconds more, and at its end, by the last 256."""
    source = RigSource(Played(images(rig, frames, **more), rig.names, rate), rig, ReconstructionSettings(noise=0.2), waits=True)
    frames_of(source)
    return source


def test_a_camera_that_was_bumped_while_it_runs_is_named() -> None:
    """3 px are 0.16 degrees. It is said when two judgements agree, so that one moment with few markers says nothing."""
    source = judged(ring(5), 780, 26.0, change=lambda t, c, xy: xy + 3.0 * (c == 2 and t > 260))
    found = [finding for finding in source.findings() if finding.code == "reconstruct-camera-misfit"]
    assert [finding.where for finding in found] == ["c3"]
    assert source.cameras()[2].seen < 0.1 and min(camera.seen for camera in source.cameras() if camera.name != "c3") > 0.9


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ({"late": (1, 2)}, "reconstruct-out-of-step"),
        ({"change": lambda t, c, xy: xy * [-1.0, 1.0] + [1280.0 * (c == 1), 0.0] if c == 1 else xy}, "reconstruct-camera-misfit"),
    ],
    ids=["two frames late", "mirrored"],
)
def test_a_camera_that_does_not_fit_is_named(more: dict[str, Any], code: str) -> None:
    source = judged(ring(5), **more)
    assert [finding.where for finding in source.findings() if finding.code == code] == ["c2"], source.findings()


def test_a_rig_of_another_day_is_told_of_a_short_session() -> None:
    rig = ring(4)
    other = Rig(tuple(replace(camera, rotation=rig[n - 1].rotation) for n, camera in enumerate(rig)))
    source = RigSource(Played(images(rig, 60), rig.names), other, waits=True)
    frames_of(source)
    assert told(source) & {"reconstruct-no-fit", "reconstruct-no-points", "reconstruct-rig-changed", "reconstruct-rig-misfit"}


def test_cameras_that_the_rig_does_not_know_are_named() -> None:
    rig = ring(4)
    others = ("c1", "c2", "c3", "left")
    renamed = (replace(image, camera=others[int(image.camera[1]) - 1]) for image in images(rig, 30))
    source = RigSource(Played(renamed, others), rig, waits=True)
    frames = frames_of(source)
    assert len(frames) == 30 and len(frames[-1].points) == 12, "three cameras are enough"
    found = {finding.code: finding.sentence for finding in source.findings()}
    assert "left" in found["live-unknown-camera"] and "c4" in found["live-unknown-camera"]


def test_two_cameras_are_enough_and_one_is_none() -> None:
    rig = ring(6).select(("c1", "c3"))
    frames = frames_of(RigSource(Played(images(rig, 40), rig.names), rig, waits=True))
    assert np.median([np.median(misses(frame)) for frame in frames]) < 0.003
    with pytest.raises(AsterismError, match="two calibrated cameras"):
        RigSource(Played(images(rig, 1), rig.names), rig.select(("c1",)))


def test_a_flood_of_blobs_leaves_the_markers_and_is_told() -> None:
    rig, rng = ring(4), np.random.default_rng(0)

    def flooded(t: int, c: int, xy: np.ndarray) -> np.ndarray:
        return np.concatenate([rng.uniform(0, 1000, (1500, 2)), xy]) if t >= 20 and c < 2 else xy

    source = RigSource(Played(images(rig, 30, change=flooded), rig.names), rig, ReconstructionSettings(noise=0.2), waits=True)
    # As on a machine where 150 blobs of an image fill a frame.
    for _ in range(100):
        source.budget.spent(150, 0.8 / source.about.rate)
    frames = frames_of(source)
    assert len(frames) == 30
    # A quarter of the flood's blobs are as large, and markers are where they were a frame before.
    assert max(np.quantile(misses(frame), 0.75) for frame in frames[2:]) < 0.005
    assert told(source) >= {"live-many-blobs"} and source.cut == 10 * 2 * (1512 - 150)


class Fed:
    """A camera system that sends what it is given, when it is given."""

    damaged = 0
    name = "fed"
    rate = 10.0
    numbered_together = True

    def __init__(self, cameras: tuple[str, ...]) -> None:
        self.cameras, self.images = cameras, queue.Queue[LiveBlobs]()

    def read(self, timeout: float) -> LiveBlobs | None:
        try:
            return self.images.get(timeout=timeout)
        except queue.Empty:
            return None

    def close(self) -> None:
        pass


def test_noise_and_cameras_are_judged_by_another_process_and_here_where_that_was_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, learn = ring(3), Reconstructor.learn
    monkeypatch.setattr(Reconstructor, "learn", lambda *_: pytest.fail("frames waited for a judgement"))
    fed = Fed(rig.names)
    source = RigSource(fed, rig)
    for image in images(rig, 48):
        fed.images.put(replace(image, arrived=time.monotonic()))
        if image.camera == "c3":
            assert source.read(30.0) is not None
        if source._frames == 24 and image.camera == "c3":
            assert source._judging is not None
            source._judging.join(LONG)
            assert source._reconstructor.noise_known
            assert source._reconstructor.model is not None and 0.1 < source._reconstructor.model.noise[0] < 0.3
    judges = multiprocessing.active_children()
    assert [process.name for process in judges] == ["live judge"]
    source._learn_elsewhere(RATE)
    assert min(camera.seen for camera in source.cameras()) > 0.9
    judges[0].kill()
    judges[0].join(LONG)
    source._fits = ()
    monkeypatch.setattr(Reconstructor, "learn", learn)
    source._learn_elsewhere(RATE)
    assert min(camera.seen for camera in source.cameras()) > 0.9
    source.close()
    assert not multiprocessing.active_children()


def test_images_that_waited_to_be_read_make_whole_frames() -> None:
    """They are as old as they are: nothing that came with them, and is read after them, is given up."""
    rig = ring(3)
    fed, begun = Fed(rig.names), time.monotonic() - 100.0
    for image in images(rig, 40):
        fed.images.put(replace(image, arrived=begun + image.time))
    source = RigSource(fed, rig)
    try:
        until = time.monotonic() + LONG
        while min(state.count.received for state in source._gather.cameras) < 40:
            assert time.monotonic() < until
        assert [state.without for state in source._gather.cameras] == [0, 0, 0]
    finally:
        source.close()


PORTS = HostPort("127.0.0.1", 0)


def test_datagrams_become_points_in_a_process_of_their_own_and_are_kept(tmp_path: Path) -> None:
    rig = ring(4)
    source = RigProcess(partial(JsonBlobs, PORTS, rig.names, RATE, numbered_together=True), rig, keep=tmp_path / "walk.blobs")
    frames = list[LiveFrame]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sent = list(images(rig, 60))
        # A process that is busy loses none: each frame is waited for before the next is sent.
        for t in range(60):
            for image in sent[4 * t : 4 * t + 4]:
                sender.sendto(blobs_as_json(image), ("127.0.0.1", source.port))
            sender.sendto(b"nonsense", ("127.0.0.1", source.port))
            until = time.monotonic() + LONG
            while len(frames) <= t and time.monotonic() < until:
                frame = source.read(1.0)
                frames += [] if frame is None else [frame]
    source.close()
    assert [frame.number for frame in frames] == list(range(60))
    assert np.median([np.median(misses(frame)) for frame in frames]) < 0.002
    assert source.damaged == 60 and [camera.received for camera in source.cameras()] == [60] * 4
    assert not multiprocessing.active_children()
    with pytest.raises(SourceEnded):
        source.read(0.1)
    # What was kept gives the same points off line, but for thousandths of a pixel of the datagrams and the noise that is told anew.
    again = reconstruct(read_blobs(tmp_path / "walk.blobs", rig.names), rig)
    assert len(again.clouds) == 60 and len(again.clouds[59]) == len(frames[59].points)
    np.testing.assert_allclose(np.sort(again.clouds[59], axis=0), np.sort(frames[59].points, axis=0), atol=1e-5)
    with pytest.raises(AsterismError, match="no live recording"):
        recording_of(tmp_path / "walk.blobs")
    assert len(read_blobs(tmp_path / "walk.blobs")) == 60, "asking whether it is something else clears nothing"


def refused(*_: object) -> JsonBlobs:
    raise AsterismError("the camera is in use.")


def test_a_source_that_cannot_be_opened_says_why_and_leaves_no_process() -> None:
    with pytest.raises(AsterismError, match="the camera is in use"):
        RigProcess(refused, ring(3))
    assert not multiprocessing.active_children()


GOOD = b'{"camera":"c1","frame":3,"time":0.5,"blobs":[[10.5,20.25,6],[1,2],[NaN,3],[1e300,4],[5,6,-1]]}'


def test_blobs_go_through_a_datagram() -> None:
    read = blobs_of_json(GOOD, 2.0)
    assert read is not None and (read.camera, read.number, read.time, read.arrived) == ("c1", 3, 0.5, 2.0)
    assert read.xy.tolist() == [[10.5, 20.25], [1.0, 2.0], [5.0, 6.0]]
    np.testing.assert_array_equal(read.sizes, [6.0, np.nan, np.nan])
    again = blobs_of_json(blobs_as_json(read), 2.0)
    assert again is None or again.xy.tolist() == read.xy.tolist()
    bare = replace(read, sizes=np.full(3, np.nan), xy=read.xy)
    assert blobs_of_json(blobs_as_json(bare), 2.0) is not None


@settings(max_examples=300)
@given(st.data())
def test_damaged_blobs_give_an_image_or_none(data: st.DataObject) -> None:
    damaged = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, max(0, len(damaged) - 1)))
        damaged[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    read = blobs_of_json(bytes(damaged), 0.0)
    assert read is None or (
        np.isfinite(read.xy).all() and math.isfinite(read.time) and len(read.sizes) == len(read.xy) and read.xy.shape[1] == 2
    )


@pytest.mark.parametrize(
    "data",
    [b"", b"[]", b"[" * 50_000, b'{"camera":"c","frame":1,"time":0}', b'{"camera":["c"],"frame":1,"time":0,"blobs":[]}',
     b'{"camera":"c","frame":true,"time":0,"blobs":[]}', b'{"camera":"c","frame":1,"time":1e999,"blobs":[]}',
     b'{"camera":"c","frame":1,"time":0,"blobs":[[1]]}', b'{"camera":"c","frame":1,"time":0,"blobs":[[1,2,3,4]]}',
     b'{"camera":"c","frame":1,"time":0,"blobs":{"a":1}}', b'{"camera":"c","frame":1,"time":0,"blobs":["ab"]}',
     b'{"camera":"c","frame":1,"time":0,"blobs":[[[1],[2]]]}',
     b'{"camera":"c","frame":1,"time":0,"blobs":[' + b",".join([b"[1,2]"] * 2001) + b"]}"],
)  # fmt: skip
def test_what_are_no_blobs_is_none_and_said(data: bytes) -> None:
    assert blobs_of_json(data, 0.0) is None and why_no_blobs(data)


def test_who_sends_something_else_than_blobs_is_told_what_is_wrong() -> None:
    source = JsonBlobs(PORTS, ["c1"])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(b'{"camera":"c1","frame":1,"time":0,"points":[[1,2]]}', ("127.0.0.1", source.port))
        until(lambda: source.read(0.02) is None and source.damaged == 1)
    (finding,) = source.findings()
    assert finding.code == "live-format"
    assert '1 packet could not be read; of the first, it has no "blobs", but "camera", "frame", "time", "points".' in finding.sentence
    source.close()


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (lambda n: (0, n / RATE), "the number of an earlier one"),
        (lambda n: (n, 1000 * n / RATE), "do not go as a clock does"),
        (lambda n: (n, 0.0), "do not go as a clock does"),
    ],
    ids=["numbers stand still", "ms", "no times"],
)
def test_cameras_with_stamps_that_are_none_are_told_where_no_frame_is_made_of_them(stamps: Callable, said: str) -> None:
    """Of cameras that run freely: all of them, and one of three."""
    for wrong in (3, 1):
        came = [
            LiveBlobs(f"c{c}", *(stamps(n) if c <= wrong else (n, n / RATE)), 50.0 + n / RATE, np.ones((1, 2)), np.ones(1))
            for n in range(60)
            for c in (1, 2, 3)
        ]
        free = Played(came, ("c1", "c2", "c3"))
        free.numbered_together = False
        source = RigSource(free, ring(3), waits=True)
        frames = frames_of(source)
        assert bool(frames) == (wrong == 1)
        (finding,) = [each for each in source.findings() if each.code == "live-camera-stamps"]
        assert said in finding.sentence and finding.where == ("c1, c2, c3" if wrong == 3 else "c1")
        assert not {"live-camera-late", "live-camera-clock"} & told(source)
        assert "live-silent" not in {each.code for each in session_findings(Health(), "x", parts=[source])}


def test_what_is_played_faster_keeps_its_rate(tmp_path: Path) -> None:
    """Labels and speeds are taken from the rate: at twice of it a body that walks seems to run."""
    rig = ring(3)
    write_blobs(recorded(rig, 10), tmp_path / "blobs.csv")
    source = RigSource(ReplayBlobs(tmp_path / "blobs.csv", rig.names, speed=50.0), rig, waits=True, speed=50.0)
    times = [frame.time for frame in frames_of(source)]
    assert source.about.rate == pytest.approx(1.0 / float(np.median(np.diff(times))))


def test_blobs_and_a_rig_are_labelled_in_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = ring(3)
    write_rig(rig, tmp_path / "rig.toml")
    write_blobs(recorded(rig, 30), tmp_path / "blobs.csv")
    words = [
        "live",
        "--replay",
        str(tmp_path / "blobs.csv"),
        "--speed",
        "1e5",
        "--rig",
        str(tmp_path / "rig.toml"),
        "--markers",
        "helen-hayes",
    ]
    assert main([*words, "--no-analysis", "--json", "-", "-o", str(tmp_path / "out.c3d")]) in (0, 1)
    content = json.loads(capsys.readouterr().out)
    assert content["labelled"] == 30 and [camera["received"] for camera in content["cameras"]] == [30] * 3
    assert main([*words, str(tmp_path / "blobs.csv")]) == 2
