"""Strikes, offs and angles of recordings that are played through a session, against those of the whole recordings."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

import asterism
from asterism.gait import PARAMETERS, Walking, cycles_of, find_events, parameters_of
from asterism.gait.events import OFF, STRIKE
from asterism.labelling.live.stream import FrameLabels
from asterism.live import AnalysedFrame, AngleOptions, LabelledFrame, LiveFrame, LiveSession, MovementAnalysis, SourceAbout, SourceEnded
from asterism.live.analysis import FrameAnalysis
from asterism.live.angles import name_of
from asterism.live.chain import Labeller
from asterism.motion.clinical import clinical_angles, gathered_measures
from asterism.recording import MarkerSet, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

GROUPS = {
    "children, straight": "gait/*/straight.c3d",
    "children, turns": "gait/*/turn*.c3d",
    "plates, other people": "gait-events/plates/*/*.c3d",
    "full body": "gait-events/fullbody/*.c3d",
    "treadmills": "gait-events/treadmill/*.c3d",
    "Parkinson": "gait-events/parkinson/*.c3d",
}
NEAR = 0.15
"""s: an event with none of its foot and kind so near is missed, or extra."""
BEGIN, END = 0.3, 0.1
"""s after the first frame, before which a stream has shown no step, and before the last one, after which nothing can be told in time."""
KINDS = {STRIKE: "heel strike", OFF: "toe off"}


def strikes(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """When strikes and offs are told, which are missed or told for nothing, and how far they are from those of the whole recording."""
    whole: dict[str, _Apart] = {kind: _Apart() for kind in KINDS.values()}
    for group, pattern in GROUPS.items():
        parts = {kind: _Apart() for kind in KINDS.values()}
        for path in sorted(folder().glob(pattern))[: 2 if benchmark.quick else None]:
            recording = _bare(asterism.read(path))
            walking, found = (
                find_events(recording),
                _played(recording, MovementAnalysis(AngleOptions(vertical=recording.vertical, waits=True)))[0],
            )
            for label, kind in KINDS.items():
                for part in (parts[kind], whole[kind]):
                    part.add(recording, walking, found, label, kind)
        for kind, part in parts.items():
            yield from part.figures(f"live, {kind} told, {group}", "none", "none")
    for kind, part in whole.items():
        yield from part.figures(f"live, {kind} told, all", "< 60" if kind == "heel strike" else "none", "<= 0")


def steps(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Cadence, speed and steps as they are shown after a strike, against those of the whole recording."""
    apart: dict[str, list[float]] = {"cadence": [], "walking speed": [], "step length": [], "step time": []}
    for pattern in ("gait/*/straight.c3d", "gait-events/treadmill/*.c3d"):
        for path in sorted(folder().glob(pattern))[: 2 if benchmark.quick else None]:
            recording = _bare(asterism.read(path))
            walking = find_events(recording)
            found = _played(recording, MovementAnalysis(AngleOptions(vertical=recording.vertical, waits=True)))[0]
            for one in parameters_of(walking, cycles_of(walking)):
                name = one.name if one.name in ("cadence", "walking speed") else f"{'left' if one.side == 'L' else 'right'} {one.name}"
                # After the strike has been told, and before the next one.
                shown = found[min(round((one.ends + 0.1) * recording.rate), len(found) - 1)].values.get(name, np.nan)
                if one.name in apart and np.isfinite(shown):
                    apart[one.name].append(abs(shown - one.value))
    for name, errors in apart.items():
        for words, share in (("median", 0.5), ("p95", 0.95)):
            yield Figure(
                f"live, {name}: difference from the whole recording's, {words}",
                "none",
                float(np.quantile(errors, share)),
                PARAMETERS[name],
                len(errors),
            )


def angles(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The largest difference from the angles of the whole recording with the same standing trial, and the time of a frame."""
    worst, axes, spent, count = 0.0, 0.0, list[float](), 0
    for path in sorted(folder().glob("gait/*/straight.c3d"))[: 3 if benchmark.quick else None]:
        still = path.with_name("static.c3d")
        static = asterism.read(still) if still.exists() else None
        recording = _bare(asterism.read(path))
        measures = gathered_measures(recording, static)[0] if static is not None else None
        outputs = clinical_angles(recording, measures=measures, static=static).outputs
        found, seconds = _played(
            recording, MovementAnalysis(AngleOptions(static, None, lambda _, m=measures: (m, ()), recording.vertical, waits=True))
        )
        spent += seconds
        for name, curve in outputs.items():
            for column in range(3):
                live = np.array([one.values.get(name_of(name, column), np.nan) for one in found])
                apart = np.abs((live - np.degrees(curve[:, column]) + 180.0) % 360.0 - 180.0)
                most = float(np.nanmax(apart)) if np.isfinite(apart).any() else 0.0
                count += int(np.isfinite(apart).sum())
                if name[1:4] in ("Hip", "Kne", "Ank", "Spi", "Nec", "Sho", "Elb", "Wri"):
                    worst = max(worst, most)
                else:
                    axes = max(axes, most)
    yield Figure("live, angles: worst difference from the whole recording's, joints", "< 0.1", worst, "degrees", count)
    yield Figure("live, angles: worst difference, in the room's axes", "none", axes, "degrees", count)
    yield Figure("live, angles and steps of 59 markers: time of a frame, median", "< 1", 1000 * float(np.median(spent)), "ms", len(spent))
    yield Figure(
        "live, angles and steps: p99, the making of the model included", "none", 1000 * float(np.quantile(spent, 0.99)), "ms", len(spent)
    )


class _Apart:
    """Of one kind of event: delays and errors in s, and what is missed and extra."""

    def __init__(self) -> None:
        self.delays, self.errors, self.shares = list[float](), list[float](), list[float]()
        self.missed = self.extra = self.count = 0

    def add(self, recording: Recording, walking: Walking, found: list[FrameAnalysis], label: str, kind: str) -> None:
        """Compare a session with its recording."""
        until = (len(recording) - 1) / recording.rate - END
        told = [event for one in found for event in one.events if event.kind == kind]
        for event in (one for one in walking.events if one.label == label):
            own = [one for one in told if one.side[0].upper() == event.side and abs(one.time - event.time) < NEAR]
            counts = BEGIN < event.time < until
            self.count += counts
            if not own:
                self.missed += counts
                continue
            nearest = min(own, key=lambda one: abs(one.time - event.time))
            told.remove(nearest)
            if counts:
                self.errors.append(nearest.time - event.time)
                self.delays.append(nearest.time + nearest.told_after - event.time)
                self.shares.append(abs(nearest.time - event.time) / nearest.sd)
        self.extra += sum(BEGIN < one.time < until for one in told)

    def figures(self, row: str, late: str, missed: str) -> Iterator[Figure]:
        """ms, from the event of the whole recording."""
        if not self.count:
            return
        if self.delays:
            delays, errors = 1000 * np.array(self.delays), 1000 * np.abs(self.errors)
            for name, share, asked in (("median", 0.5, "none"), ("p95", 0.95, "none"), ("p99", 0.99, late)):
                yield Figure(f"{row}: delay, {name}", asked, float(np.quantile(delays, share)), "ms", len(delays))
            for name, share in (("median", 0.5), ("p95", 0.95)):
                yield Figure(f"{row}: error of the time, {name}", "none", float(np.quantile(errors, share)), "ms", len(errors))
            held = float((np.array(self.shares) < 1.96).mean())
            yield Figure(f"{row}: within the stated 95 %", "none", held, "fraction", len(errors))
        yield Figure(f"{row}: missed", missed, self.missed, "events", self.count)
        yield Figure(f"{row}: extra", missed, self.extra, "events", self.count)


def _bare(recording: Recording) -> Recording:
    """What a stream has of a file: points, names, rate and vertical."""
    return Recording(recording.positions, recording.labels, recording.rate, vertical=recording.vertical)


def _played(recording: Recording, analysis: MovementAnalysis) -> tuple[list[FrameAnalysis], list[float]]:
    """What a session that gets the labels of the file finds in each frame, and s that its analysis took."""
    sink, timed = _Sink(), _Timed(analysis)
    given = _GivenLabels(recording)
    LiveSession(given, lambda rate, up: given, [sink], waits=True, analysis=timed, vertical=recording.vertical).run()
    return sink.found, timed.seconds


class _GivenLabels(Labeller):
    """A source that plays a recording, and a labeller that knows its names."""

    marker_set: MarkerSet | None = None
    damaged = 0

    def __init__(self, recording: Recording) -> None:
        self.about = SourceAbout("recording", recording.rate, recording.vertical)
        self.marker_set = MarkerSet(
            tuple(f"{n} {name}" if recording.labels.count(name) > 1 else name for n, name in enumerate(recording.labels))
        )
        self._recording, self._read, self._pushed = recording, 0, 0

    def read(self, timeout: float) -> LiveFrame:
        """The next frame."""
        if self._read >= len(self._recording):
            raise SourceEnded
        n, self._read = self._read, self._read + 1
        points = self._recording.positions[n]
        return LiveFrame(n, n / self._recording.rate, time.monotonic(), points[np.isfinite(points[:, 0])])

    def push(self, points: object) -> FrameLabels:
        """The labels of the next frame."""
        seen = np.isfinite(self._recording.positions[self._pushed, :, 0])
        self._pushed += 1
        return FrameLabels(self._pushed - 1, np.where(seen, np.cumsum(seen) - 1, -1), seen.astype(float))

    def flush(self) -> list[FrameLabels]:
        """Each frame had its labels at once."""
        return []

    def close(self) -> None:
        """Nothing is open."""


class _Timed:
    def __init__(self, analysis: MovementAnalysis) -> None:
        self._analysis, self.seconds = analysis, list[float]()

    def push(self, frame: LabelledFrame) -> FrameAnalysis:
        begin = time.perf_counter()
        found = self._analysis.push(frame)
        self.seconds.append(time.perf_counter() - begin)
        return found


class _Sink:
    def __init__(self) -> None:
        self.found = list[FrameAnalysis]()

    def send(self, frame: AnalysedFrame) -> None:
        self.found.append(frame.analysis)

    def close(self) -> None:
        pass
