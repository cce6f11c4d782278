"""The rows about starts and time: what a labelling takes, part by part, how far off a start may be, and what is found from nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from statistics import median

import numpy as np

from asterism.simulation.views_laboratory import ViewsSession
from asterism.views.frame import BlobLabels, FrameLabeller
from asterism.views.label import ViewsLabelling, label_views
from asterism.views.plain import PlainRules, label_stepwise, minimise_plain
from asterism.views.rules import QUICK, RULES
from asterism.views.scene import scene_of
from asterism.views.start import starts
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from benchmarks.views.rows import near_start
from benchmarks.views.sessions import chosen_frames, frame_identity, gait_sessions, motion_sessions

KINDS = (("15 markers", gait_sessions, 5.0), ("26 markers", motion_sessions, 10.0))
_RIGHT = 0.9
"""A start is right if so many of the blobs that show one marker get their label."""
_WIDE = (45.0, 0.4, 0.5)
"""Degrees, share and m along each axis by which a given start may be off."""


def _milliseconds(run: Callable[[], object], repeats: int = 9) -> float:
    run()
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        run()
        times.append(time.process_time() - begun)
    return 1e3 * median(times)


def parts(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One labelling, part by part, and tracking, on one core, in CPU time: median over frames of the median of nine."""
    for kind, sessions, most in KINDS:
        _, body, session = next(iter(sessions(benchmark)))
        labeller = FrameLabeller(scene_of(session.blobs, session.rig), body)
        taken: dict[str, list[float]] = {}
        for t in chosen_frames(session, 2 if benchmark.quick else 8):
            start = near_start(session, labeller, t, np.random.default_rng(t))
            for name, run in _parts_of(labeller, t, start).items() if start is not None else ():
                taken.setdefault(name, []).append(_milliseconds(run, 3 if "nothing" in name or "sought" in name else 9))
        asked = {"one labelling from a given start": f"< {most:g}", "one labelling with nothing known": "< 100"}
        for name, values in taken.items():
            yield Figure(f"{kind}, {name}", asked.get(name, "none"), median(values), "ms", len(values))
        truth = label_views(session.blobs, session.rig, body)
        name = f"{kind}, one labelling from a start within 45 degrees, 0.4, 0.5 m, sought without it where that is in doubt"
        yield Figure(name, "none", *_from_afar(truth, session, labeller, 2 if benchmark.quick else 8))
        yield Figure(f"{kind}, tracking, 4 cameras", "> 500", _frames_per_second(session, labeller), "frames/s", len(session.blobs))
        yield from _whole_recordings(kind, session, labeller)


def _parts_of(labeller: FrameLabeller, t: int, start: tuple[np.ndarray, np.ndarray]) -> dict[str, Callable[[], object]]:
    """The parts of labelling frame t, each ready to be timed."""
    xy, offsets = labeller.scene.frame(t)
    pose, rotation = minimise_plain(labeller, t, *start)
    return {
        "initialisation, all starts": lambda: starts(labeller.scene, labeller.body, xy, offsets, 12),
        "the paper's minimisation, 5 iterations": lambda: minimise_plain(labeller, t, *start, PlainRules(iterations=5)),
        "the paper's minimisation, 10 iterations": lambda: minimise_plain(labeller, t, *start),
        "the paper's labelling steps": lambda: label_stepwise(labeller, t, pose, rotation),
        "one labelling from a given start": lambda: labeller.from_start(t, *start),
        "one labelling from a given start, sought without it where that is in doubt": lambda: labeller.from_near(t, *start),
        "one labelling with nothing known": lambda: labeller.from_nothing(t),
    }


def _from_afar(truth: ViewsLabelling, session: ViewsSession, labeller: FrameLabeller, most: int) -> tuple[float, str, int]:
    """Milliseconds of a labelling from starts that are as far off as the row `basin` has them, the median over frames; how many."""
    taken = list[float]()
    for t in chosen_frames(session, most):
        if np.isfinite(truth.poses[t, 0]):
            start = off_start(truth, t, np.random.default_rng([t, 7]), *_WIDE)
            taken.append(_milliseconds(lambda t=t, start=start: labeller.from_near(t, *start), 3))  # type: ignore[misc]
    return median(taken), "ms", len(taken)


def _whole_recordings(kind: str, session: ViewsSession, labeller: FrameLabeller) -> Iterator[Figure]:
    """Frames of CPU time of what a user calls: the default, and one direction of time without a personal body."""
    for name, rules in (("label_views", RULES), ("label_views, --quick", QUICK)):
        taken = _milliseconds(lambda rules=rules: label_views(session.blobs, session.rig, labeller.body, rules=rules), 3)  # type: ignore[misc]
        yield Figure(f"{kind}, {name}, 4 cameras, start included", "none", 1e3 * len(session.blobs) / taken, "frames/s", len(session.blobs))


def _frames_per_second(session: ViewsSession, labeller: FrameLabeller) -> float:
    """Frames that follow others, of CPU time, after the first; the body is found and the person known."""
    result = label_views(session.blobs, session.rig, labeller.body)
    tracked = FrameLabeller(labeller.scene, result.person)
    there = np.nonzero(np.isfinite(result.poses[:, 0]))[0]
    first = tracked.follow(int(there[0]), result.poses[there[0]], result.rotations[there[0]])

    def run() -> None:
        last, found = int(there[0]), first
        for t in there[1:].tolist():
            found = tracked.follow(t, found.pose, found.rotation, (last, found))
            last = t

    return 1e3 * (len(there) - 1) / _milliseconds(run, 3)


def basin(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Starts that are off by up to a bound in heading, size and place at once: the share that ends at the right labels."""
    for kind, sessions, _ in KINDS:
        for name, turn, size, place, asked in (
            ("20 degrees, 0.25, 0.2 m (the paper's)", 20.0, 0.25, 0.2, "none"),
            ("45 degrees, 0.4, 0.5 m", *_WIDE, ">= 0.99"),
        ):
            ours = quick = plain = total = 0
            for _, body, session in sessions(benchmark):
                labeller = FrameLabeller(scene_of(session.blobs, session.rig), body)
                truth = label_views(session.blobs, session.rig, body)
                for t in chosen_frames(session, 3 if benchmark.quick else 10):
                    if not np.isfinite(truth.poses[t, 0]):
                        continue
                    start = off_start(truth, t, np.random.default_rng([t, 7]), turn, size, place)
                    total += 1
                    ours += _is_right(session, t, labeller.from_near(t, *start))
                    quick += _is_right(session, t, labeller.from_start(t, *start))
                    labels = label_stepwise(labeller, t, *minimise_plain(labeller, t, *start))
                    plain += _share(session, t, labels) >= _RIGHT
            yield Figure(f"{kind}, start within {name}: right", asked, ours / max(total, 1), "fraction", total)
            yield Figure(f"{kind}, start within {name}, one labelling alone: right", "none", quick / max(total, 1), "fraction", total)
            yield Figure(f"{kind}, start within {name}, the paper's algorithm: right", "none", plain / max(total, 1), "fraction", total)


def off_start(
    truth: ViewsLabelling, t: int, rng: np.random.Generator, turn: float, size: float, place: float
) -> tuple[np.ndarray, np.ndarray]:
    """A start in the body's usual pose whose heading, size and place are off by up to these (degrees, share, m along each axis)."""
    angle = np.radians(rng.uniform(-turn, turn))
    about = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    heading = truth.rotations[t][:, 0]
    upright = np.arctan2(heading[1], heading[0])
    standing = np.array([[np.cos(upright), -np.sin(upright), 0.0], [np.sin(upright), np.cos(upright), 0.0], [0.0, 0.0, 1.0]])
    pose = truth.poses[t].copy()
    grown = truth.person.height / truth.body.height
    pose[:3] = grown * (1.0 + rng.uniform(-size, size))
    pose[3:6] += rng.uniform(-place, place, 3)
    pose[9:] = truth.body.arrays.usual
    return pose, about @ standing


def nothing_known(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Frames by themselves, any heading, height and place: the share that ends at the right labels."""
    for kind, sessions, _ in KINDS:
        for cameras in (4, 3, 2):
            right = total = 0
            for _, body, session in sessions(benchmark, cameras):
                labeller = FrameLabeller(scene_of(session.blobs, session.rig), body)
                for t in chosen_frames(session, 3 if benchmark.quick else 10):
                    found = labeller.from_nothing(t)
                    total += 1
                    right += _is_right(session, t, found)
            asked = ">= 0.99" if cameras == 4 else "none"
            yield Figure(f"{kind}, nothing known, {cameras} cameras: right", asked, right / max(total, 1), "fraction", total)


def _share(session: ViewsSession, t: int, labels: np.ndarray) -> float:
    identity = frame_identity(session, t)
    marker = identity >= 0
    return float((labels[marker] == identity[marker]).mean()) if marker.any() else 0.0


def _is_right(session: ViewsSession, t: int, found: BlobLabels) -> bool:
    return _share(session, t, found.labels) >= _RIGHT
