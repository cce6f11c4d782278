"""Blobs of twelve cameras over a loopback socket: how soon they are angles, and how right."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from asterism.cameras import Camera
from asterism.cameras.files import read_rig
from asterism.formats import read
from asterism.live import AnalysedFrame, AngleOptions, HostPort, LiveSession, MovementAnalysis, make_labeller
from asterism.live.blobs import JsonBlobs, RigProcess
from asterism.reconstruction import Reconstructor, reconstruct
from asterism.recording import Floats, Recording
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import GAIT_BODY, folder
from benchmarks.figures import Figure
from benchmarks.recordings.walks import full_body_subjects, unseen_model, walks

RATE, CAMERAS, BLOBS = 200.0, 12, 50
NOISE, KEPT = 0.2, 0.7
"""px of each axis, and the share that a frame has of the error before: centroids err by where the marker lies among the pixels."""
HIDDEN = 0.2
"""s that a marker stays hidden."""
GHOSTS = 2
"""Lights per image that are nowhere in the next."""


def blobs(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """12 cameras of 50 blobs at 200 Hz as JSON over UDP: from the last byte of a frame to its angles. Needs a quiet machine."""
    subject = full_body_subjects()[0]
    model = unseen_model(benchmark, subject, GAIT_BODY)
    walk = next(iter(walks(subject, GAIT_BODY)))
    count = 600 if benchmark.quick else 12_000
    for name, together, offsets in (("triggered", True, 0.0), ("free-running", False, 0.6 / RATE)):
        rng = np.random.default_rng(0)
        rig, path = ring_rig(CAMERAS, radius=5.0, rng=rng), _Path(walk)
        delays = rng.uniform(0.0, offsets, CAMERAS) if offsets else np.zeros(CAMERAS)
        datagrams = [_datagrams(camera, path, delay, rng) for camera, delay in zip(rig, delays, strict=True)]
        place = HostPort("127.0.0.1", 0)
        source, sink = RigProcess(partial(JsonBlobs, place, rig.names, RATE, numbered_together=together), rig), _Sink(path)
        session = LiveSession(source, make_labeller(model, None, 0), [sink], analysis=MovementAnalysis(AngleOptions()))
        with _Sender(datagrams, delays, count, source.port, session) as sender:
            health = session.run()
        cameras = source.cameras()
        # A second has passed until the model of the noise is known and the person is found.
        spent = np.array([done - sender.sent[number] for number, done in sink.done.items() if RATE < number < count])
        row = f"live, {CAMERAS} cameras of {BLOBS} blobs at {RATE:.0f} Hz, {name}"
        yield Figure(f"{row}, last byte of a frame to its angles: p50", "none", 1000 * float(np.quantile(spent, 0.5)), "ms", len(spent))
        asked = "< 15" if together else "none"
        yield Figure(f"{row}, last byte of a frame to its angles: p99.9", asked, 1000 * float(np.quantile(spent, 0.999)), "ms", len(spent))
        left_out = health.dropped + health.lost + source.dropped
        if together:
            unsaid = count - health.labelled - left_out - health.late - health.before
            yield Figure(f"{row}: frames lost and not told", "== 0", unsaid, "frames", count)
        yield Figure(f"{row}: frames left out, and told", "none", left_out, "frames", count)
        yield Figure(f"{row}: images late or lost, and told", "none", sum(c.late + c.lost for c in cameras), "images", count * CAMERAS)
        apart = np.concatenate([np.empty(0), *sink.apart])
        yield Figure(f"{row}: labelled points, error: median", "none", 1000 * float(np.median(apart)), "mm", len(apart))
        yield Figure(f"{row}: labelled points, error: p99", "none", 1000 * float(np.quantile(apart, 0.99)), "mm", len(apart))
        yield Figure(
            f"{row}: labels right, of those that cameras saw", "none", 100 * sink.right / max(1, sink.possible), "%", sink.possible
        )
        yield Figure(f"{row}: labels wrong", "none", 100 * sink.wrong / max(1, sink.possible), "%", sink.possible)


class _Path:
    """Where the markers of a walk are at any time: to its end and back again."""

    def __init__(self, walk: Recording) -> None:
        middle = np.nanmean(walk.positions, axis=(0, 1)) * [1.0, 1.0, 0.0]
        filled = walk.positions - middle
        whole = np.isfinite(filled).all(axis=(0, 2))
        self.names = tuple(name for name, kept in zip(walk.labels, whole, strict=True) if kept)
        self._spline = CubicSpline(np.arange(len(filled)) / walk.rate, filled[:, whole])
        self.long = (len(filled) - 1) / walk.rate

    def at(self, time: float) -> Floats:
        """(markers, 3) m."""
        turn = time % (2 * self.long)
        place: Floats = self._spline(min(turn, 2 * self.long - turn))
        return place


def _projected(camera: Camera, points: Floats) -> Floats:
    """(n, 2) px by the pinhole and Brown's lens, written beside the package's own."""
    x, y, z = (points @ camera.rotation.T + camera.translation).T
    x, y = x / z, y / z
    square = x**2 + y**2
    factor = 1.0 + sum(k * square ** (n + 1) for n, k in enumerate(camera.radial))
    p1, p2 = camera.tangential
    u = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x**2)
    v = y * factor + p1 * (square + 2 * y**2) + 2 * p2 * x * y
    return np.column_stack([camera.focal[0] * u + camera.centre[0], camera.focal[1] * v + camera.centre[1]])


def _datagrams(camera: Camera, path: _Path, delay: float, rng: np.random.Generator) -> list[bytes]:
    """The blobs of one camera in each frame of the way there and back, as the end of a datagram; BLOBS of them on average."""
    assert camera.size is not None
    frames, markers = round(2 * path.long * RATE), len(path.names)
    error, hidden, ends = rng.normal(0, NOISE, (markers, 2)), np.zeros(markers), []
    share = max(0.0, 1 - (BLOBS - GHOSTS) / markers)
    for t in range(frames):
        xy = _projected(camera, path.at(t / RATE + delay))
        error = KEPT * error + rng.normal(0, NOISE * math.sqrt(1 - KEPT**2), (markers, 2))
        # So often, for so long, that the share is hidden at any time.
        begins = rng.random(markers) < share / (1 - share) / (HIDDEN * RATE)
        hidden = np.where((hidden <= 0) & begins, HIDDEN * RATE, hidden - 1)
        xy = np.concatenate([(xy + error)[hidden <= 0], rng.uniform(0, camera.size, (GHOSTS, 2))])
        inside = ((xy > -0.5) & (xy < np.array(camera.size) - 0.5)).all(axis=1)
        rows = np.round(rng.permutation(xy[inside]), 3).tolist()
        ends.append(f'"camera":"{camera.name}","blobs":{json.dumps(rows, separators=(",", ":"))}}}'.encode())
    return ends


class _Sink:
    """When frames were analysed, how far labelled points are from where the markers were, and which labels are right."""

    def __init__(self, path: _Path) -> None:
        self._path, self.done, self.apart = path, dict[int, float](), list[Floats]()
        self.right, self.wrong, self.possible = 0, 0, 0

    def send(self, frame: AnalysedFrame) -> None:
        done, labelled = time.monotonic(), frame.labelled
        number = math.floor(labelled.frame.time * RATE + 1e-3)
        self.done[number] = done
        # Looked at now and then, so that looking costs the next frame nothing.
        if number % 25 == 0 and number > RATE:
            truth, points = self._path.at(labelled.frame.time), labelled.frame.points
            seen = np.linalg.norm(truth[:, None] - points[None], axis=2).min(axis=1, initial=math.inf) < 0.01
            self.possible += int(seen.sum())
            for marker, index in zip(labelled.markers, labelled.indices.tolist(), strict=True):
                if index >= 0 and marker in self._path.names:
                    miss = float(np.linalg.norm(points[index] - truth[self._path.names.index(marker)]))
                    self.right, self.wrong = self.right + (miss < 0.02), self.wrong + (miss >= 0.02)
                    if miss < 0.02:
                        self.apart.append(np.array([miss]))

    def close(self) -> None:
        pass


_SENDER = """
import array, socket, sys, time
rate, count, port, path = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
cameras = [part.split(b"\\n") for part in open(path, "rb").read().split(b"\\n\\n")]
sent = array.array("d")
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
    begin = time.monotonic()
    for n in range(count):
        time.sleep(max(0.0, begin + n / rate - time.monotonic()))
        for k in range(len(cameras)):
            ends = cameras[(k + n) % len(cameras)]
            at = n / rate + float(sys.argv[5 + (k + n) % len(cameras)])
            out.sendto(b'{"frame":%d,"time":%.6f,' % (n, at) + ends[n % len(ends)], ("127.0.0.1", port))
        sent.append(time.monotonic())
sys.stdout.buffer.write(sent.tobytes())
"""


class _Sender:
    """Sends frames at their rate from another process, and stops the session when all are sent.

    sent (count,) s on this machine's clock, when the last datagram of each frame was
    """

    def __init__(self, datagrams: list[list[bytes]], delays: Floats, count: int, port: int, session: LiveSession) -> None:
        self.sent: Floats = np.zeros(0)
        self._session, self._folder = session, tempfile.TemporaryDirectory()
        path = Path(self._folder.name) / "datagrams"
        path.write_bytes(b"\n\n".join(b"\n".join(camera) for camera in datagrams))
        self._words = [str(RATE), str(count), str(port), str(path), *map(str, delays)]
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        time.sleep(3.0)  # labels begin when the model is ready
        done = subprocess.run([sys.executable, "-c", _SENDER, *self._words], stdout=subprocess.PIPE, check=True)
        self.sent = np.frombuffer(done.stdout)
        time.sleep(1.0)
        self._session.stop()

    def __enter__(self) -> _Sender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.join()
        self._folder.cleanup()


def agreement(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Twelve Vicon cameras and a real walk, frame by frame against the whole recording at once: which points differ, and which are
    right."""
    place = folder() / "cameras" / "vicon-rig-walk"
    rig, recording = read_rig(place / "walking_1.xcp"), read(place / "walking_1.c3d")
    recording = recording.frames(slice(0, 150)) if benchmark.quick else recording
    imaging, body = ImagingSettings(noise=0.3, strays=0.3), walker_capsules(recording)
    seen, shows = simulate_blobs(rig, recording.positions, imaging, body=body, rng=np.random.default_rng(0), rate=recording.rate)
    whole = reconstruct(seen, rig)
    one, frames = Reconstructor(rig.select(seen.cameras)), list[Floats]()
    for t in range(len(seen)):
        frames.append(one.push([seen.of(t, c) for c in range(len(seen.cameras))]).points)
        if t in (24, 256) or (t > 256 and t % 1000 == 0):
            one.learn(recording.rate)
    row = "live, vicon-rig-walk frame by frame"
    both = [(live, off) for live, off in zip(frames[24:], list(whole.clouds)[24:], strict=True) if len(off)]
    apart = np.concatenate([np.linalg.norm(off[:, None] - live[None], axis=2).min(axis=1, initial=1.0) for live, off in both])
    yield Figure(
        f"{row}: points of the recording at once, there within 0.1 mm", ">= 99", 100 * float((apart < 1e-4).mean()), "%", len(apart)
    )
    more = sum(len(live) - len(off) for live, off in both)
    yield Figure(f"{row}: points more", "none", 1000 * more / len(apart), "per 1,000 points", len(apart))
    for name, clouds in (("frame by frame", frames), ("at once", list(whole.clouds))):
        two, near = 0, 0
        for t, points in list(enumerate(clouds))[24:]:
            here = shows[seen.offsets[t * len(seen.cameras)] : seen.offsets[(t + 1) * len(seen.cameras)]]
            markers = np.flatnonzero(np.bincount(here[here >= 0], minlength=recording.positions.shape[1]) >= 2)
            truth = recording.positions[t, markers]
            two, near = (
                two + len(markers),
                near + int((np.linalg.norm(truth[:, None] - points[None], axis=2).min(axis=1, initial=1.0) < 1e-3).sum()),
            )
        yield Figure(f"live, vicon-rig-walk {name}: markers that two cameras see, found within 1 mm", "none", 100 * near / two, "%", two)
