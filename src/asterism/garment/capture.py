"""Images of a worn garment, its pattern and a rig in; the dense trajectories of its circles, and what to know about them, out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.files.journal import Journal
from asterism.findings import Finding, Severity
from asterism.garment.dense import DensePoints, DenseRules, DenseTrajectories, UsedCircles, dense_trajectories
from asterism.garment.dense.points import CircleRays, circle_rays, ray_points, ray_scale
from asterism.garment.pattern import Pattern
from asterism.garment.surface import SurfaceRules, consistent_points
from asterism.progress import Progress
from asterism.recording import Ints

Image = NDArray[np.uint8]
Moment = tuple[int, Sequence[Image | None]]
Reader = Callable[[Image], UsedCircles]


@dataclass(frozen=True)
class CaptureRules:
    """How a recording of a garment becomes points, and from when on something is worth saying.

    dense, surface  of a moment's points
    scale_frames    moments from which the common factor on the centres' standard deviations is taken, by its median
    together        moments whose images are read side by side
    twice           share of a camera's identities that an image shows twice, from which on a second garment is in view: reflections of
                    single circles stay below a hundredth of that in simulation
    unfitting       share of the identities that two cameras read and whose rays do not meet, from which on the rig is in doubt
    coarse          factor on the centres' standard deviations from which on it is, too
    """

    dense: DenseRules = field(default_factory=DenseRules)
    surface: SurfaceRules = field(default_factory=SurfaceRules)
    scale_frames: int = 5
    together: int = 4
    twice: float = 0.02
    unfitting: float = 0.15
    coarse: float = 5.0


@dataclass(frozen=True)
class Capture:
    """A captured garment.

    trajectories  of its circles
    frames        (T,) number of each moment
    points        (T,) points in each
    seen          (T,) identities that two cameras or more read in each
    read          (T, C) identities read in each image
    scale         factor on the centres' standard deviations that the rays' misfit asked for
    findings      what to know before using them
    """

    trajectories: DenseTrajectories
    frames: Ints
    points: Ints
    seen: Ints
    read: Ints
    scale: float
    findings: tuple[Finding, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Plain values, for JSON and reports."""
        sigma = np.sqrt(np.nanmedian(self.trajectories.covariance[..., [0, 3, 5]].sum(axis=-1))) if self.points.sum() else float("nan")
        return {
            "frames": len(self.frames),
            "identities": len(self.trajectories.ids),
            "points_per_frame": float(np.median(self.points)) if len(self.points) else 0.0,
            "of_those_seen_by_two_cameras": float(self.points.sum() / self.seen.sum()) if self.seen.sum() else 0.0,
            "identities_read_per_image": float(self.read.mean()) if self.read.size else 0.0,
            "sigma_m": float(sigma),
            "scale": self.scale,
        }


def capture(  # noqa: PLR0913 -- five are about how it runs, not about what
    rig: Rig,
    pattern: Pattern,
    moments: Iterable[Moment],
    read: Reader,
    *,
    rate: float = 10.0,
    rules: CaptureRules | None = None,
    workers: int = 1,
    journal: Journal | None = None,
    progress: Progress | None = None,
) -> Capture:
    """Read the images of each moment, and reconstruct the garment's points.

    moments  number and images (h, w, 3) uint8 of each, one per camera in the rig's order, None where there is none
    read     what one image shows; called from several threads where there are several workers
    rate     moments per second
    journal  what was read of each moment is kept there; moments that it holds are not read again
    progress is told the share that is done where `moments` has a length, else 0

    The result does not depend on the number of workers, nor on the journal. Points that the cloth contradicts are left out. An image that
    `read` fails on is left out, which is a finding. Memory: the images of `rules.together` moments, and the points of all. Raises
    AsterismError where there is no moment, or where no image shows an identity.
    """
    rules = rules or CaptureRules()
    frames: list[int] = []
    found: list[DensePoints] = []
    counts: list[list[int]] = []
    crowded = np.zeros(len(rig), dtype=np.int64)
    failures: list[Finding] = []
    # The factor on the centres' errors comes from the first moments; these wait for it, and all later ones need not.
    first: list[Future[CircleRays]] = []
    under_way: deque[Future[DensePoints]] = deque()
    scale: float | None = None
    total = len(moments) if isinstance(moments, Sized) else 0
    ahead = rules.together if workers > 1 else 0

    def finish(left: int) -> None:
        # Results are taken in order, so that the outcome does not depend on the number of workers.
        while len(under_way) > left:
            found.append(under_way.popleft().result())
            if progress is not None:
                progress(min(1.0, len(found) / total) if total else 0.0, f"frame {frames[len(found) - 1]}: {len(found[-1])} points")

    with _pool(workers) as pool:
        for number, circles in _readings(moments, read, max(1, ahead), pool, journal):
            frames.append(number)
            counts.append([int((one.ids >= 0).sum()) for one in circles])
            crowded += [one.crowded for one in circles]
            failures += [_failure(name, number, one.failed) for name, one in zip(rig.names, circles, strict=True) if one.failed]
            rays = pool.submit(_rays, rig, circles, rules)
            if scale is not None:
                under_way.append(pool.submit(_points, rig, pattern, rays, rules, scale))
                finish(ahead)
                continue
            first.append(rays)
            if len(first) == rules.scale_frames:
                scale = _common_scale(rig, first, rules, pool)
                under_way += [pool.submit(_points, rig, pattern, one, rules, scale) for one in first]
        # A recording shorter than `scale_frames` moments has its factor from those that it has.
        if scale is None and first:
            scale = _common_scale(rig, first, rules, pool)
            under_way += [pool.submit(_points, rig, pattern, one, rules, scale) for one in first]
        finish(0)
    if not frames:
        raise AsterismError("there is no image to read; name videos, or folders of images, one for each camera.")
    read_of = np.array(counts, dtype=np.int64)
    if not read_of.any():
        if failures:
            raise AsterismError(f"no circle of this garment was identified; {failures[0].sentence}")
        raise AsterismError(
            f"no circle of this garment was identified in any of {len(frames)} frames of {len(rig)} cameras; try asterism garment check on "
            "one image, which says why."
        )
    points = np.array([len(one) for one in found], dtype=np.int64)
    seen = np.array([one.seen for one in found], dtype=np.int64)
    vertical = None if rig.vertical is None else rig.vertical
    trajectories = dense_trajectories(found, rate, vertical)
    findings = (*failures, *_crowds(rig, crowded, len(frames)), *_findings(rig, found, read_of, scale or 1.0, rules))
    return Capture(trajectories, np.array(frames, dtype=np.int64), points, seen, read_of, scale or 1.0, findings)


@dataclass(frozen=True)
class _Reading:
    """What is used and kept of one image; without circles where there is no image, or where it failed."""

    centres: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2, 2)))
    ids: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    axes: NDArray[np.float64] | None = None
    crowded: bool = False
    failed: str = ""

    @classmethod
    def of(cls, reading: Future[UsedCircles] | None) -> _Reading:
        """What came of reading an image."""
        if reading is None:
            return cls()
        try:
            read = reading.result()
        # Whatever is wrong with one image must not cost the others, which took hours to film.
        except Exception as problem:
            return cls(failed=" ".join(str(problem).split()) or type(problem).__name__)
        crowded = any(finding.code == "garment-many-circles" for finding in getattr(read, "findings", ()))
        return cls(
            np.asarray(read.centres), np.asarray(read.covariance), np.asarray(read.ids), getattr(read, "axes", None), crowded
        )  # fmt: skip

    def arrays(self) -> list[NDArray[Any]]:
        """The same as arrays, for a journal."""
        failed = np.frombuffer(self.failed.encode(), dtype=np.uint8)
        axes = np.empty((0, 3)) if self.axes is None else np.asarray(self.axes)
        return [self.centres, self.covariance, self.ids, axes, np.array([self.crowded, self.axes is not None]), failed]

    @classmethod
    def from_arrays(cls, arrays: Sequence[NDArray[Any]]) -> _Reading:
        """What `arrays` gave."""
        centres, covariance, ids, axes, (crowded, with_axes), failed = arrays
        return cls(centres, covariance, ids, axes if with_axes else None, bool(crowded), failed.tobytes().decode())


_ARRAYS = 6
"""Arrays of a reading."""


def _failure(camera: str, frame: int, why: str) -> Finding:
    sentence = f"the image of camera {camera}, frame {frame}, cannot be read ({why.rstrip('.')}); it was left out."
    return Finding("garment-image-failed", Severity.WARNING, camera, sentence, "Look at it with asterism garment check.")


class _Here(Executor):
    """Does what it is given at once, in the caller's thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as problem:
            done.set_exception(problem)
        return done


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    pool: Executor = ThreadPoolExecutor(workers) if workers > 1 else _Here()
    try:
        yield pool
    finally:
        # After an interruption nobody waits for images that have not begun.
        pool.shutdown(wait=True, cancel_futures=True)


def _readings(
    moments: Iterable[Moment], read: Reader, together: int, pool: Executor, journal: Journal | None
) -> Iterator[tuple[int, list[_Reading]]]:
    """What was read of each moment, in order; the images of a few moments are with the workers at a time, so that none has to wait."""
    coming, kept, begun = iter(moments), 0 if journal is None else journal.kept, 0
    under_way: deque[tuple[int, list[Future[UsedCircles] | None]]] = deque()
    while True:
        for number, group in islice(coming, together - len(under_way)):
            begun += 1
            # One image per task, so that the cameras of a moment are read side by side. What is kept is not read again.
            under_way.append((number, [None if image is None or begun <= kept else pool.submit(read, image) for image in group]))
        if not under_way:
            return
        number, reads = under_way.popleft()
        yield number, _kept(reads, journal)


def _kept(reads: Sequence[Future[UsedCircles] | None], journal: Journal | None) -> list[_Reading]:
    """The readings of a moment's images, from the journal where it has them."""
    if journal is None:
        return [_Reading.of(one) for one in reads]
    arrays = journal.step(lambda: [array for one in reads for array in _Reading.of(one).arrays()])
    return [_Reading.from_arrays(arrays[i : i + _ARRAYS]) for i in range(0, len(arrays), _ARRAYS)]


def _rays(rig: Rig, circles: Sequence[_Reading], rules: CaptureRules) -> CircleRays:
    return circle_rays(rig, circles, rules.dense)


def _points(rig: Rig, pattern: Pattern, rays: Future[CircleRays], rules: CaptureRules, scale: float) -> DensePoints:
    """The rays are with a worker before: none waits for one that has not begun."""
    return consistent_points(ray_points(rig, rays.result(), rules.dense, scale), pattern, rules.surface)


def _common_scale(rig: Rig, moments: Sequence[Future[CircleRays]], rules: CaptureRules, pool: Executor) -> float:
    """The median over moments of the factor on the centres' standard deviations."""
    scales = [pool.submit(ray_scale, rig, rays.result(), rules.dense) for rays in moments]
    return float(np.median([scale.result() for scale in scales]))


def _crowds(rig: Rig, crowded: Ints, frames: int) -> Iterator[Finding]:
    """The cameras in whose images there was more than is read."""
    for name, count in zip(rig.names, crowded.tolist(), strict=True):
        if count:
            sentence = f"camera {name} has more coloured spots in {count} of {frames} frames than are read; those below were left out."
            mend = "Light the cloth alone or come nearer; in Python, raise `ReadRules.most_circles`."
            yield Finding("garment-many-circles", Severity.WARNING, name, sentence, mend)


def _findings(rig: Rig, found: Sequence[DensePoints], read: Ints, scale: float, rules: CaptureRules) -> Iterator[Finding]:
    """What speaks against a capture."""
    names = rig.names
    used = np.zeros(len(rig), dtype=np.int64)
    twice = np.zeros(len(rig), dtype=np.int64)
    for one in found:
        # One garment shows each identity once in an image; a second sight is a second garment or a mirror.
        twice += np.bincount(one.duplicates[:, 0], minlength=len(rig))
        used += one.by_camera
    for c, name in enumerate(names):
        total = int(read[:, c].sum())
        if total == 0:
            sentence, mend = (
                f"camera {name} identified no circle in {len(found)} frames.",
                "Look at one of its images with asterism garment check.",
            )
            yield Finding("garment-camera-blind", Severity.WARNING, name, sentence, mend)
        elif used[c] == 0:
            sentence = f"camera {name} identified {total} circles, none of which another camera saw and agreed on."
            yield Finding(
                "garment-no-shared-circles", Severity.WARNING, name, sentence, "Place cameras so that neighbours see the same cloth."
            )
        if twice[c] > rules.twice * max(total, 1):
            sentence = f"camera {name} saw {100 * twice[c] / max(total, 1):.0f} % of its identities twice in one image."
            mend = "Have one garment of this print in view, and no mirror."
            yield Finding("garment-seen-twice", Severity.ERROR, name, sentence, mend)
    seen, kept = sum(one.seen for one in found), sum(len(one) for one in found)
    # Rays that miss each other by much more than their noise speak of moved cameras, or of images that are not of one moment.
    if seen and (seen - kept > rules.unfitting * seen or scale > rules.coarse):
        sentence = (
            f"rays of {100 * (seen - kept) / seen:.0f} % of the circles do not meet, and the others miss by {scale:.1f} times their noise."
        )
        mend = "Check that the images were taken at one moment, and that no camera has moved since the calibration."
        yield Finding("garment-rig-misfit", Severity.ERROR, "", sentence, mend)
    if seen == 0:
        mend = "Place cameras so that neighbours see the same cloth, at most 60 degrees apart."
        yield Finding("garment-no-points", Severity.ERROR, "", "no two cameras saw the same circle, so there is no point.", mend)
