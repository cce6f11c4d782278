"""Four webcams whose images are drawn beforehand and played at their own rates: from a complete image to the labelled frame."""

from __future__ import annotations

import math
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import asterism
from asterism.cameras import Camera
from asterism.detection import BlobSettings, RunningDetection
from asterism.live import AnalysedFrame, LiveSession, SourceEnded, make_labeller
from asterism.live.blobs import RigSource
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras import CameraAbout, LiveCamera
from asterism.live.cameras.settings import SettingValue
from asterism.live.images import CameraWorkers, WorkerSettings
from asterism.recording import Floats
from asterism.simulation.cameras import ring_rig
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

RATE = 60.0
SIZE = (640, 480)
_BUFFERS = 4
"""Images that a webcam's driver keeps."""
_LEARNING = 60
"""Frames that are not judged: in the first second clocks are compared and thresholds learnt."""
_NEAR = 0.03
"""m from a true marker within which a labelled point is that marker: two of the set are never nearer than twice that."""


def webcams(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Four webcams of 640 x 480 as MJPEG, clocks of their own, on two cores: latency, rate held, drops. Needs a quiet machine."""
    seconds = 6.0 if benchmark.quick else 60.0
    walk = treadmill(2.0 if benchmark.quick else 8.0)
    rig = ring_rig(4, radius=3.2, height=2.2, size=SIZE, rng=np.random.default_rng(5))
    with tempfile.TemporaryDirectory() as scratch:
        places = []
        for c, camera in enumerate(rig):
            clock = WebcamClock(phase=0.3 * c / RATE, drift=1e-5 * (4 * c - 6), zero=1000.0 * c, jitter=0.002)
            film(Path(scratch) / camera.name, camera, walk, clock, c)
            places.append(FilmedWebcam(camera.name, str(Path(scratch) / camera.name), clock, seconds))
        sink, up = _Labelled(walk), np.array([0.0, 0.0, 1.0])
        # Made before the cameras run, so that their seconds are all labelled.
        labeller = make_labeller(None, "helen-hayes", 0)(RATE, up)
        began = time.monotonic()
        workers = CameraWorkers(places, WorkerSettings(), workers=2)
        sink.begin(workers.begins)
        source = RigSource(workers, rig)
        session = LiveSession(source, lambda rate, vertical: labeller, [sink], vertical=up)
        benchmark.report(f"open after {time.monotonic() - began:.1f} s")
        health = session.run(seconds + 30.0)
        searches, healths = workers.searches(), {each.camera: each for each in workers.healths()}
        searching = _searching(Path(places[0].stem))
    sent = 4 * math.floor(seconds * RATE)
    searched = sum(each.searched for each in searches.values())
    told = sum(each.dropped + each.lost + each.damaged for each in healths.values())
    # A machine that is too busy labels fewer frames than are left out.
    begin = min(_LEARNING, len(sink.spent) // 2)
    spent, age = np.array(sink.spent[begin:]), np.array(sink.ages[begin:])
    row = "live, four webcams of 640 x 480 at 60 images/s"
    yield Figure(f"{row}, complete image to labels: p50", "none", 1000 * float(np.quantile(spent, 0.5)), "ms", len(spent))
    yield Figure(f"{row}, complete image to labels: p99", "< 40", 1000 * float(np.quantile(spent, 0.99)), "ms", len(spent))
    yield Figure(f"{row}, exposure to labels: p99", "none", 1000 * float(np.quantile(age, 0.99)), "ms", len(age))
    yield Figure(f"{row}: images searched", ">= 0.99", searched / sent, "fraction", sent)
    yield Figure(f"{row}: images neither searched nor told as dropped", "== 0", max(0, sent - searched - told), "images", sent)
    yield Figure(f"{row}: labelled frames of those that one camera took", ">= 0.97", health.labelled / (seconds * RATE), "fraction", sent)
    n = len(searching)
    yield Figure(f"{row}: search of one image, processor time: p50", "< 2", 1000 * float(np.median(searching)), "ms", n)
    yield Figure(f"{row}: search of one image, processor time: mean, with learning", "none", 1000 * float(searching.mean()), "ms", n)
    yield Figure(f"{row}: longest search of an image", "none", 1000 * max(each.seconds[1] for each in searches.values()), "ms", searched)
    yield Figure(f"{row}: markers labelled right", "none", sink.right / max(sink.asked, 1), "fraction", max(sink.asked, 1))
    yield Figure(f"{row}: labels wrong", "none", sink.wrong / max(sink.right + sink.wrong, 1), "fraction", max(sink.right + sink.wrong, 1))


def _searching(stem: Path) -> Floats:
    """s of one core for each of 240 images of a webcam, decoded before."""
    data, starts = np.memmap(stem.with_suffix(".mjpg"), np.uint8, "r"), np.load(stem.with_suffix(".npy"))
    images = [cv2.imdecode(data[starts[n] : starts[n + 1]], cv2.IMREAD_COLOR) for n in range(240)]
    running, spent = RunningDetection(BlobSettings()), list[float]()
    for number, image in enumerate(images):
        begin = time.thread_time()
        running.find(np.asarray(image), number / RATE)
        spent.append(time.thread_time() - begin)
    return np.array(spent)


@dataclass(frozen=True)
class Walk:
    """Where the markers of a person on a treadmill are: (T, M, 3) m at `rate`, played to and fro so that it never jumps."""

    positions: Floats
    labels: tuple[str, ...]
    rate: float

    def at(self, seconds: float) -> Floats:
        """(M, 3) m at one instant."""
        last = len(self.positions) - 1
        place = (seconds * self.rate) % (2 * last)
        place = min(place, 2 * last - place)
        low = min(int(place), last - 1)
        return self.positions[low] + (place - low) * (self.positions[low + 1] - self.positions[low])


def treadmill(seconds: float) -> Walk:
    """A simulated person who walks on the spot."""
    walk = asterism.simulation.simulate_walks(subjects=1, frames=int(240 * seconds) + 1, rate=240.0, seed=11)[0]
    middle = walk.positions[..., :2].mean(axis=1)
    time_of = np.linspace(-1.0, 1.0, len(middle))
    # The way over the floor is taken off as a smooth curve, so that steps stay as they are.
    way = np.stack([np.polyval(np.polyfit(time_of, middle[:, axis], 6), time_of) for axis in range(2)], axis=1)
    positions = walk.positions.copy()
    positions[..., :2] -= way[:, None]
    return Walk(positions, walk.labels, walk.rate)


@dataclass(frozen=True)
class WebcamClock:
    """When a webcam takes its images, and what its own clock says then.

    phase   s, of its first exposure
    drift   share by which its clock and with it its rate is fast
    zero    s that its clock shows at the beginning
    jitter  s, standard deviation of what an image takes longer on its way (half of a normal distribution)
    """

    phase: float
    drift: float
    zero: float
    jitter: float

    def taken(self, number: int) -> float:
        """s after the beginning of the middle of an exposure."""
        return self.phase + number / (RATE * (1.0 + self.drift))

    def stamp(self, number: int) -> float:
        """s on its own clock."""
        return self.zero + self.taken(number) * (1.0 + self.drift)


_ON_ITS_WAY = 0.006
"""s from the middle of an exposure to the complete image, at least: half the exposure, readout and USB."""
_EXPOSURE = 0.004
"""s."""


def film(stem: Path, camera: Camera, walk: Walk, clock: WebcamClock, seed: int) -> None:
    """Draw what a webcam sees of a walk to and fro, as JPEGs one behind the other in a file, and where each begins in another."""
    rng = np.random.default_rng(seed)
    images = math.floor(2 * (len(walk.positions) - 1) / walk.rate * RATE)
    room, grain, starts = _room(rng), _grain(rng), [0]
    with stem.with_suffix(".mjpg").open("wb") as out:
        for number in range(images):
            jpeg = _picture(camera, walk, clock.taken(number), room, grain, rng)
            out.write(jpeg)
            starts.append(starts[-1] + len(jpeg))
    np.save(stem.with_suffix(".npy"), np.array(starts))


def _room(rng: np.random.Generator) -> NDArray[np.float32]:
    """A dim room behind a Bayer mosaic, its light from one side, with furniture, a lamp that saturates and a small standby light."""
    wide, tall = SIZE
    x, y = np.meshgrid(np.arange(wide), np.arange(tall))
    colour = np.stack([8 + 14 * x / wide + 5 * y / tall, 9 + 12 * x / wide, 7 + 8 * y / tall], axis=-1).astype(np.float32)
    for _ in range(6):
        corner, side = rng.uniform((0, 0), (500, 380)), rng.uniform(30, 120, 2)
        part = colour[int(corner[1]) : int(corner[1] + side[1]), int(corner[0]) : int(corner[0] + side[0])]
        part += rng.uniform(0, 14, 3).astype(np.float32)
    lamp, light = rng.uniform((40, 15), (600, 60)), rng.uniform((30, 380), (610, 460))
    away = np.hypot(x - lamp[0], y - lamp[1])[..., None]
    colour += np.where(away < 17, 500.0, 60.0 * np.exp(-away / 12)).astype(np.float32)
    colour += (240 * np.exp(-0.5 * (np.hypot(x - light[0], y - light[1])[..., None] / 1.5) ** 2)).astype(np.float32)
    return _mosaic(colour)


def _mosaic(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    """What the pixels of a sensor behind red, green and blue filters see."""
    raw = colour[..., 1].copy()
    raw[0::2, 0::2], raw[1::2, 1::2] = colour[0::2, 0::2, 0], colour[1::2, 1::2, 2]
    return raw


def _grain(rng: np.random.Generator) -> NDArray[np.float32]:
    """Noise that is not white: of pixels that share their amplifier along a row, of clouds, and of each pixel; standard deviation 2.6."""
    tall, wide = SIZE[1] + 64, SIZE[0] + 64
    noise = rng.normal(0, 2.0, (tall, wide)) + rng.normal(0, 1.0, (tall, 1))
    clouds = cv2.GaussianBlur(rng.normal(0, 1.0, (tall, wide)), (0, 0), 2.5)
    return np.asarray(noise + 1.3 * clouds / clouds.std(), dtype=np.float32)


_LIMBS = (("THI", "KNE", 0.08), ("KNE", "TIB", 0.06), ("TIB", "ANK", 0.05), ("ANK", "TOE", 0.04))


def _limbs(points: dict[str, Floats]) -> list[tuple[Floats, Floats, float]]:
    """(begin, end, radius) m of what hides markers: legs a little within their markers, and the trunk."""
    hips = (points["RASI"] + points["LASI"] + points["SACR"]) / 3
    out = [(hips, hips + np.array([0.0, 0.0, 0.55]), 0.1)]
    for side, other in (("L", "R"), ("R", "L")):
        # Markers are worn outside: the bones lie towards the other leg.
        inwards = points[other + "KNE"] - points[side + "KNE"]
        inwards = inwards / np.linalg.norm(inwards)
        out += [(points[side + a] + (r + 0.01) * inwards, points[side + b] + (r + 0.01) * inwards, r) for a, b, r in _LIMBS]
    return out


def _is_hidden(eye: Floats, point: Floats, limbs: list[tuple[Floats, Floats, float]]) -> bool:
    """Whether a limb comes between a camera and a marker."""
    way = point - eye
    steps = eye + np.linspace(0.7, 0.985, 40)[:, None] * way
    for begin, end, radius in limbs:
        along = end - begin
        share = np.clip((steps - begin) @ along / (along @ along), 0.0, 1.0)
        if (np.linalg.norm(steps - begin - share[:, None] * along, axis=1) < 0.85 * radius).any():
            return True
    return False


def _picture(
    camera: Camera, walk: Walk, taken: float, room: NDArray[np.float32], grain: NDArray[np.float32], rng: np.random.Generator
) -> bytes:
    """One image: a person in grey clothes, markers that shine, both blurred by lens and exposure, noise, mosaic, white balance, JPEG."""
    raw, points = room.copy(), dict(zip(walk.labels, walk.at(taken), strict=True))
    body, limbs = np.zeros(raw.shape, np.float32), _limbs(points)
    for begin, end, radius in limbs:
        (a, b), depth = camera.project(np.stack([begin, end])), float(np.linalg.norm(begin - camera.position))
        if np.isfinite([a, b]).all():
            width = max(1, round(2 * radius * camera.focal[0] / depth))
            cv2.line(body, tuple(np.rint(a).astype(int).tolist()), tuple(np.rint(b).astype(int).tolist()), 1.0, width)
    body = cv2.GaussianBlur(body, (0, 0), 1.5)
    raw += body * (22.0 - raw)
    seen = np.array([point for point in points.values() if not _is_hidden(camera.position, point, limbs)]).reshape(-1, 3)
    names = [name for name, point in points.items() if not _is_hidden(camera.position, point, limbs)]
    begin, end = (walk.at(max(0.0, taken + share * _EXPOSURE)) for share in (-0.5, 0.5))
    of = {name: place for place, name in enumerate(walk.labels)}
    for name, point in zip(names, seen, strict=True):
        depth = float(np.linalg.norm(point - camera.position))
        # A ball of 20 mm: its image, the lens' blur, and the way that it moves meanwhile.
        spread = math.hypot(0.010 * camera.focal[0] / depth / 2, 0.8)
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            _dot(raw, camera.project(begin[of[name]] + share * (end[of[name]] - begin[of[name]])), spread, 75.0)
    top, left = rng.integers(0, 64, 2)
    noisy = raw + grain[top : top + SIZE[1], left : left + SIZE[0]] * np.sqrt(1.0 + np.minimum(raw, 255.0) / 60.0)
    colour = cv2.cvtColor(np.clip(noisy, 0, 255).astype(np.uint8), cv2.COLOR_BayerBG2BGR)
    balanced = cv2.convertScaleAbs(colour, alpha=1.06, beta=2.0)
    there, jpeg = cv2.imencode(".jpg", balanced, [cv2.IMWRITE_JPEG_QUALITY, 82])
    assert there
    return bytes(jpeg)


def _dot(raw: NDArray[np.float32], at: Floats, spread: float, light: float) -> None:
    """Add the light of a round spot."""
    reach = math.ceil(4 * spread)
    if not np.isfinite(at).all() or not (-reach < at[0] < SIZE[0] + reach and -reach < at[1] < SIZE[1] + reach):
        return
    x0, y0 = (max(0, math.floor(value) - reach) for value in at)
    part = raw[y0 : math.floor(at[1]) + reach + 1, x0 : math.floor(at[0]) + reach + 1]
    x, y = x0 + np.arange(part.shape[1]) - at[0], y0 + np.arange(part.shape[0]) - at[1]
    part += light * np.exp(-0.5 * (x[None] ** 2 + y[:, None] ** 2) / spread**2)


@dataclass(frozen=True)
class FilmedWebcam:
    """Where a webcam's images lie, in plain values, for `seconds`."""

    name: str
    stem: str
    clock: WebcamClock
    seconds: float

    def ready(self) -> LiveCamera:
        """The camera."""
        return _Webcam(self)


class _Webcam(LiveCamera):
    """Gives images as a driver does: when they are due, decoded where they are fetched, four of them kept."""

    own_settings = ()

    def __init__(self, place: FilmedWebcam) -> None:
        super().__init__(place.name, place.stem)
        self._place, self._rng = place, np.random.default_rng(len(place.name))
        self._data = np.memmap(Path(place.stem).with_suffix(".mjpg"), np.uint8, "r")
        self._starts = np.load(Path(place.stem).with_suffix(".npy"))
        self._count = math.floor(place.seconds * RATE)
        self._next, self._due, self._began = 0, math.nan, math.nan
        self._closed = threading.Event()

    @property
    def about(self) -> CameraAbout:
        return CameraAbout(self.name, self.address, "filmed", "", SIZE, RATE, "camera")

    def get_own(self, name: str) -> SettingValue | None:
        return None

    def set_own(self, name: str, value: SettingValue) -> None:
        raise asterism.AsterismError("it has no settings.")

    def start(self, at: float | None = None) -> None:
        self._began = time.monotonic() if at is None else at
        self._due = self._arrives()

    def stop(self) -> None:
        self._began = math.nan

    def close(self) -> None:
        self._closed.set()

    def _arrives(self) -> float:
        late = abs(self._rng.normal(0.0, self._place.clock.jitter))
        return self._began + self._place.clock.taken(self._next) + _ON_ITS_WAY + late

    def read(self, timeout: float) -> LiveImage | None:
        if self._next >= self._count:
            raise SourceEnded
        now = time.monotonic()
        if self._due > now + timeout:
            self._closed.wait(timeout)
            return None
        if self._due > now and self._closed.wait(self._due - now):
            return None
        # A driver that nobody asks gives up the oldest of its images.
        while (time.monotonic() - self._due) * RATE > _BUFFERS and self._next + 1 < self._count:
            self.dropped += 1
            self._next += 1
            self._due = self._arrives()
        number, complete = self._next, self._due
        place = number % (len(self._starts) - 1)
        image: NDArray[np.uint8] = np.asarray(
            cv2.imdecode(self._data[self._starts[place] : self._starts[place + 1]], cv2.IMREAD_COLOR), np.uint8
        )
        self._next += 1
        self._due = self._arrives()
        return LiveImage(self.name, number, self._place.clock.stamp(number), complete, image)


class _Labelled:
    """How long labels took, how old they are, and whether they are right."""

    def __init__(self, walk: Walk) -> None:
        self._walk, self._began = walk, math.nan
        self.spent, self.ages = list[float](), list[float]()
        self.right = self.wrong = self.asked = 0

    def begin(self, began: float) -> None:
        """Say when the cameras begin, s on `time.monotonic`."""
        self._began = began

    def send(self, frame: AnalysedFrame) -> None:
        labelled = frame.labelled
        self.spent.append(labelled.done - labelled.frame.arrived)
        self.ages.append(labelled.done - labelled.frame.time + _ON_ITS_WAY)
        # What the fastest image takes on its way is part of the clocks' offset.
        taken = labelled.frame.time - self._began - _ON_ITS_WAY
        if len(self.spent) <= _LEARNING or taken < 0:
            return
        truth = self._walk.at(taken)
        for marker, index in zip(labelled.markers, labelled.indices.tolist(), strict=True):
            if index < 0:
                continue
            near = np.linalg.norm(truth - labelled.frame.points[index], axis=1)
            is_right = self._walk.labels[int(near.argmin())] == marker and near.min() < _NEAR
            self.right, self.wrong = self.right + int(is_right), self.wrong + int(not is_right)
        self.asked += len(truth)

    def close(self) -> None:
        pass
