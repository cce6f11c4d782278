"""The image sequences of several cameras in; their blobs in common frames, and what to know about each camera, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, CancelledError, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.detection.alignment import align_frames, camera_names, common_rate, on_common_clock
from asterism.detection.blobs import BlobSettings
from asterism.detection.camera_images import CameraImages, FoundBlobs, search_images
from asterism.detection.sources import Source, open_source
from asterism.detection.times import read_times
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.progress import Progress
from asterism.recording import Blobs, Floats
from asterism.synchronization.lags import lags, out_of_step, slips

_LEAST_LAG, _LEAST_LAG_BY_RIG = 2, 1
"""Frames that a camera must lag to be called out of step, without a rig and with one."""


@dataclass(frozen=True, eq=False)
class DetectionSettings:
    """How image sequences are searched.

    blobs        what is a blob; where it has no threshold, a camera's is the median of the automatic ones of some 24 of its images, and
                 light that lies unevenly over them is taken off
    thresholds   grey values, one for each camera, instead of `blobs.threshold`
    mask_static  leave out what is bright in nearly all of some 24 images: see `static_mask`
    times        CSV file of when each image was taken: blobs are interpolated to common instants (`to_common_clock`). Where too few can be
                 followed from frame to frame, they stay as they are, and `Blobs.times` says when they were seen
    rate         frames per second; None: by the times, else by the videos, else 100
    """

    blobs: BlobSettings = field(default_factory=BlobSettings)
    thresholds: Sequence[float] | None = None
    mask_static: bool = False
    times: str | Path | None = None
    rate: float | None = None


@dataclass(frozen=True)
class Detection:
    """The blobs of all cameras, and what is known about them.

    blobs         in common frames
    cameras       what each camera's images were like
    findings      what is wrong with the images
    rate_assumed  whether neither a clock nor a video gives the frame rate
    not_followed  share of blobs left out because they could not be followed to a common clock
    """

    blobs: Blobs
    cameras: tuple[CameraImages, ...]
    findings: tuple[Finding, ...]
    rate_assumed: bool
    not_followed: float

    def to_dict(self) -> dict[str, Any]:
        """All but the images, as plain values."""
        left_out = ("sample", "sample_blobs")
        per_frame = self.blobs.counts.mean(axis=0) if len(self.blobs) else np.zeros(len(self.cameras))
        return {
            "frames": len(self.blobs),
            "rate": self.blobs.rate,
            "rate_assumed": self.rate_assumed,
            "not_followed": self.not_followed,
            "blobs": len(self.blobs.xy),
            "cameras": [
                {key: value for key, value in vars(camera).items() if key not in left_out} | {"blobs_per_frame": float(mean)}
                for camera, mean in zip(self.cameras, per_frame, strict=True)
            ],
            "findings": [finding.to_dict() for finding in self.findings],
        }


def detect(
    paths: Sequence[str | Path],
    settings: DetectionSettings | None = None,
    *,
    rig: Rig | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Detection:
    """Blobs in the images of one or more cameras, one path each: see `open_source` for what a path may be.

    rig      cameras are matched to it by name, else by order; images must have its sizes, and it tells lags between cameras
    workers  threads that share the cameras; the result is the same

    Frames are numbered by file names or from 0. Blobs that the image's edge or the mask cuts are left out. Raises AsterismError where a
    camera has nothing to read, image sizes differ from the rig's, or times are of other images.
    """
    settings = DetectionSettings() if settings is None else settings
    if not paths:
        raise AsterismError("there is no camera to look at; give a video or a folder of images for each.")
    each = _for_each_camera(settings, len(paths))
    sources = [open_source(path) for path in paths]
    names = camera_names(sources, rig)
    stamps = None if settings.times is None else read_times(settings.times)

    def search(c: int, advance: Callable[[], None]) -> FoundBlobs:
        return search_images(sources[c], names[c], rig, each[c], settings.mask_static, stamps is not None, advance)

    found = _in_parallel(search, sources, names, workers, progress)
    findings = [finding for camera in found for finding in camera.findings]
    numbers, when, first = align_frames(sources, [camera.read for camera in found], names, stamps, findings)
    blobs = _gathered(found, names, numbers, when, first, common_rate(sources, settings.rate, when, names, findings))
    blobs, not_followed = (blobs, 0.0) if when is None else on_common_clock(blobs, findings)
    posed = rig.select(names) if rig is not None and all(camera.posed for camera in rig.select(names)) else None
    behind = lags(blobs, posed)
    slipped = slips(blobs, posed) if posed is not None else np.full(len(names), np.nan)
    findings += _out_of_step(names, behind, slipped, _LEAST_LAG if rig is None else _LEAST_LAG_BY_RIG)
    cameras = tuple(camera.summary(lag) for camera, lag in zip(found, behind.tolist(), strict=True))
    assumed = settings.rate is None and when is None and not all(np.isfinite(source.rate) for source in sources)
    return Detection(blobs, cameras, tuple(findings), assumed, not_followed)


def _for_each_camera(settings: DetectionSettings, cameras: int) -> list[BlobSettings]:
    """The settings of each camera. Raises AsterismError where there are not as many thresholds."""
    if settings.thresholds is None:
        return [settings.blobs] * cameras
    if len(settings.thresholds) != cameras:
        raise AsterismError(f"{len(settings.thresholds)} thresholds for {cameras} cameras; give one for all or one for each.")
    return [replace(settings.blobs, threshold=threshold) for threshold in settings.thresholds]


def _in_parallel(
    search: Callable[[int, Callable[[], None]], FoundBlobs],
    sources: Sequence[Source],
    names: Sequence[str],
    workers: int,
    progress: Progress | None,
) -> list[FoundBlobs]:
    """Search the images of all cameras. The first error, or an interrupt, stops the others at their next image."""
    total = max(sum(len(source) for source in sources), 1)
    done = [0] * len(sources)
    stop = Event()

    def advance(c: int) -> None:
        if stop.is_set():
            raise CancelledError
        done[c] += 1
        if progress is not None and done[c] % 10 == 0:
            progress(min(sum(done) / total, 1.0), f"detecting: {names[c]}")

    def one(c: int) -> FoundBlobs:
        return search(c, lambda: advance(c))

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(one, c) for c in range(len(sources))]
        try:
            finished = wait(futures, return_when=FIRST_EXCEPTION).done
            return [future.result() for future in futures if future in finished]
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _out_of_step(names: Sequence[str], behind: Floats, slipped: Floats, least: int) -> Iterator[Finding]:
    """Cameras that started at another time than the others (`lags`), or that came to be out of step on the way (`slips`)."""
    for name, frames, more in zip(names, behind, slipped, strict=True):
        if abs(more) >= 1:
            images = f"{abs(more):.0f} image{'s' if abs(more) > 1 else ''}"
            what = f"lost {images} on the way" if more < 0 else f"has {images} twice, or the others lost as many on the way"
            yield Finding(
                "detect-lost-images",
                Severity.WARNING,
                name,
                f"camera {name} {what} and is out of step from there on.",
                "Record again, or give the time of each image.",
            )
        elif abs(frames) >= least:
            sentence, mend = out_of_step(name, frames)
            yield Finding("detect-out-of-step", Severity.WARNING, name, sentence, mend)


def _gathered(
    found: Sequence[FoundBlobs], names: Sequence[str], numbers: Sequence[NDArray[np.int64]], when: Floats | None, first: int, rate: float
) -> Blobs:
    """The blobs of all cameras; numbers: the frame of each place of each camera's sequence; when (T, C) s; first: number of frame 0."""
    frame = np.concatenate([number[camera.place] for number, camera in zip(numbers, found, strict=True)])
    camera_of = np.repeat(np.arange(len(found)), [len(camera.place) for camera in found])
    xy, sizes = np.concatenate([camera.xy for camera in found]), np.concatenate([camera.sizes for camera in found])
    kept = frame >= 0
    last = max(int(number[camera.read].max()) for number, camera in zip(numbers, found, strict=True))
    frames = last + 1 if when is None else len(when)
    blobs = Blobs.from_rows(frame[kept], camera_of[kept], xy[kept], names, rate=rate, sizes=sizes[kept], frames=frames, times=when)
    return replace(blobs, first_frame=first)
