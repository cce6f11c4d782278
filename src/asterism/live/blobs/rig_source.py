"""Blobs of several cameras and their rig in; points of each frame, as any source of live frames gives them, out."""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras import Rig
from asterism.files.plain import as_json
from asterism.findings import Finding, Severity
from asterism.formats.kept_blobs import KeptImage
from asterism.live.blobs.budget import BlobBudget, telling
from asterism.live.blobs.camera_clock import compile_fit
from asterism.live.blobs.gathering import ByNumber, ByTime, RigFrame
from asterism.live.blobs.judging import JudgeProcess, judge
from asterism.live.blobs.recorder import BlobRecorder
from asterism.live.blobs.rig_health import RigCameraHealth, health_of, rig_camera_findings, stamp_findings
from asterism.live.camera_frames import BlobSource, LiveBlobs
from asterism.live.frames import MOST_POINTS, TURN, CameraControl, LiveFrame, OfCameras, SourceAbout, SourceEnded
from asterism.live.reporting import own_findings
from asterism.live.waiting import WaitingFrames
from asterism.reconstruction import ReconstructionSettings, Reconstructor
from asterism.reconstruction.camera_fit import CameraFit
from asterism.reconstruction.streaming import WINDOW
from asterism.recording import Floats
from asterism.recording.display import counted, listed, significant

_QUEUE = 0.1
"""s of frames that wait to be reconstructed at most, as of `LiveSession`."""
_FIRST = 24
"""Frames after which the noise is first told: as many as `reconstruct` looks at. Half of them scatter more; with twice as many the first
frames are matched with a noise that is only believed."""
_EVERY = 10.0
"""s between two judgements of how the cameras fit, at most: they take a thirtieth of one core then. Half of it takes twice as much, and
with twice as much a bumped camera is told twenty seconds later."""


class RigSource:
    """The points that calibrated cameras show, one frame after the other.

    source    the blobs; closed with this
    rig       its cameras are found by the names that the source gives; cameras without a pose, or not of the source, are left out
    settings  of the reconstruction
    waits     whether the source waits until its frames are taken: a file can, a camera cannot. Then noise and cameras are judged in line,
              so that the same file gives the same points
    keep      where the blobs are kept as they come, for `asterism reconstruct`; None for nowhere
    judge_pipe  the pipe of a `JudgeProcess` that another one begins and ends; None for one of its own
    speed     times as fast as they were taken that the source plays them: frames have the rate at which they were taken, as their times
              have, since labels and speeds of the body are taken from it

    One thread takes blobs and gathers them to frames (see `gathering`), the caller's reconstructs, and a process of low priority judges
    noise and cameras every ten seconds. Where frames come faster than their points are made, the oldest that waits is dropped and counted.
    Where a frame has so many blobs that making its points would take longer than a frame, blobs are left out, those first that are far from
    where points were just now, then the smallest, and counted.

    Raises AsterismError where fewer than two cameras of the rig have a pose, or the file to keep exists.
    """

    def __init__(
        self,
        source: BlobSource,
        rig: Rig,
        settings: ReconstructionSettings | None = None,
        *,
        waits: bool = False,
        keep: Path | None = None,
        speed: float = 1.0,
        judge_pipe: Connection[Any, Any] | None = None,
    ) -> None:
        known = [camera.name for camera in rig if camera.posed and (not source.cameras or camera.name in source.cameras)]
        self._unknown = dict.fromkeys(name for name in source.cameras if name not in rig.names)
        self._all = rig.names
        self._unposed = [camera.name for camera in rig if not camera.posed]
        used = known if len(known) >= 2 else [camera.name for camera in rig if camera.posed]
        self._source, self.rig, self._waits = source, rig.select(used or rig.names), waits
        self._of = {name: c for c, name in enumerate(self.rig.names)}
        self._reconstructor = Reconstructor(self.rig, settings)
        # Compiled and loaded before the first frame, which must not wait for it.
        Reconstructor(self.rig, settings).push([np.array([[0.0, 0.0], [9.0, 9.0]])] * len(self.rig))
        compile_fit()
        self._gather: ByNumber | ByTime = (ByNumber if source.numbered_together else ByTime)(len(self.rig), source.rate)
        self.about = SourceAbout(source.name, source.rate / (speed if math.isfinite(speed) else 1.0), rig.vertical)
        self.dropped, self.cut = 0, 0
        self._queue = WaitingFrames[RigFrame](waits=waits)
        self._wanted = False
        self._failed: Exception | None = None
        self._fits: tuple[CameraFit, ...] = ()
        self._found: dict[tuple[str, str], tuple[Finding, int]] = {}
        self._next, self._frames, self._judged = _FIRST, 0, 0
        self._closing, self._closed, self._judgements = threading.Lock(), False, 0
        self._points: Floats = np.empty((0, 3))
        self.budget = BlobBudget(source.rate)
        self._judging: threading.Thread | None = None
        self._judge, self._own = judge_pipe, None if judge_pipe is not None or waits else JudgeProcess()
        self._recorder = None if keep is None else BlobRecorder(keep, self.rig.names, source.rate, source.numbered_together)
        self._thread = threading.Thread(target=self._take, name="live blobs", daemon=True)
        self._thread.start()

    @property
    def damaged(self) -> int:
        """Packets or images that could not be read."""
        return self._source.damaged

    @property
    def image_wait(self) -> float:
        """s that a frame waits for images after its instant, to which blobs are moved; 0 where cameras are triggered together."""
        return self._gather.image_wait

    def read(self, timeout: float) -> LiveFrame | None:
        """The points of the next frame; None where none came within so many seconds. Raises SourceEnded."""
        self._wanted = True
        # However slow this is, what is shown is not old. What waited for the first call is dropped, too, and nobody's.
        frame, left_out = self._queue.take_fresh(timeout, lambda each: not self._waits and time.monotonic() - each.arrived > _QUEUE)
        self.dropped += len(left_out) if self._frames else 0
        if frame is None:
            if not self._queue.is_over:
                return None
            if self._failed is not None:
                raise self._failed
            raise SourceEnded
        return self._reconstructed(frame)

    def close(self) -> None:
        """Let go of the cameras."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        self._queue.close()
        self._source.close()
        if self._own is not None:
            self._own.close()
        for thread in (self._thread, self._judging):
            if thread is not None and thread is not threading.current_thread():
                thread.join(timeout=5.0)
        if self._recorder is not None:
            self._recorder.close()
        # A short session is judged at its end, too.
        if self._frames >= self._judged + _FIRST:
            self._learn(self._usual_rate)

    def cameras(self) -> list[RigCameraHealth]:
        """How each camera does, in the rig's order."""
        fits = self._fits or [CameraFit(0, math.nan, math.nan)] * len(self.rig)
        return [health_of(name, state, fit) for name, state, fit in zip(self.rig.names, self._gather.cameras, fits, strict=True)]

    def camera_numbers(self) -> list[dict[str, Any]]:
        """The same as plain values, with what the source itself says of each; what is not known is None."""
        own = {numbers["camera"]: numbers for numbers in self._source.camera_numbers()} if isinstance(self._source, OfCameras) else {}
        rows: list[dict[str, Any]] = [as_json(dataclasses.asdict(camera)) for camera in self.cameras()]
        return [{**rig, "images": own[rig["name"]]} if rig["name"] in own else rig for rig in rows]

    @property
    def control(self) -> CameraControl | None:
        """Where the cameras are set; None where they are another program's."""
        return self._source if isinstance(self._source, CameraControl) else None

    def findings(self) -> list[Finding]:
        """What a person should know of the cameras and their rig."""
        own, cameras = own_findings([self._source]), self.cameras()
        counts = stamp_findings(cameras)
        if self._frames:
            expected = [name for name in self._all if name not in self._unposed]
            busy = getattr(self._source, "overflowed", 0) > 0
            counts += [*rig_camera_findings(cameras, expected, own, busy=busy), *self._counts()]
        # Where a session was so short that it was judged once, that is all there is.
        enough = 1 if self._closed and self._judgements == 1 else 2
        return [*own, *self._names(), *counts, *(finding for finding, times in self._found.values() if times >= enough)]

    def _take(self) -> None:
        """The thread that gathers."""
        try:
            while not self._queue.is_stopped:
                wait = min(TURN, max(0.0, self._gather.due() - time.monotonic()))
                blobs = self._source.read(max(1e-4, wait))
                if blobs is not None:
                    self._push(blobs)
                    # By when it came: others that came with it may wait in the socket, and no frame goes on without those.
                    self._put(blobs.arrived)
                elif not self._waits:
                    # A file that waits has its own time, which stands still while nothing comes.
                    self._put(time.monotonic())
        except SourceEnded:
            self._put(math.inf)
        except Exception as problem:  # the reader must not wait for ever
            self._failed = problem
        finally:
            self._queue.close()

    def _push(self, blobs: LiveBlobs) -> None:
        camera = self._of.get(blobs.camera)
        if camera is not None:
            at = self._gather.push(camera, blobs)
            if at is not None and self._recorder is not None:
                self._recorder.add(KeptImage(camera, blobs.number, at, blobs.xy, blobs.sizes))
        elif len(self._unknown) < MOST_POINTS:
            self._unknown.setdefault(blobs.camera)

    def _put(self, now: float) -> None:
        most = max(2, round(_QUEUE * self.about.rate)) if math.isfinite(self.about.rate) else 10
        for frame in self._gather.ready(now):
            left_out = self._queue.put(frame, most)
            # Frames that come before the first one is asked for are nobody's.
            self.dropped += len(left_out) if self._wanted else 0

    def _reconstructed(self, frame: RigFrame) -> LiveFrame:
        xy = self._bounded(frame)
        begin = time.perf_counter()
        points = self._reconstructor.push(xy).points
        if not self._waits:
            self.budget.spent(max(len(each) for each in xy), time.perf_counter() - begin)
        self._points = points
        self._frames += 1
        self._watch()
        return LiveFrame(frame.number, frame.time, min(frame.arrived, time.monotonic()), points[:MOST_POINTS])

    def _bounded(self, frame: RigFrame) -> Sequence[Floats]:
        """The blobs of a frame, no more of each camera than there is time for."""
        most = self.budget.most or MOST_POINTS
        if max(len(each) for each in frame.xy) <= most:
            return frame.xy
        kept = list[Floats]()
        for camera, xy, sizes in zip(self.rig, frame.xy, frame.sizes, strict=True):
            if len(xy) > most:
                self.cut += len(xy) - most
                xy = xy[telling(xy, sizes, camera.project(self._points), most)]
            kept.append(xy)
        return kept

    @property
    def _usual_rate(self) -> float:
        return self.about.rate if math.isfinite(self.about.rate) else 100.0

    def _watch(self) -> None:
        """Judge noise and cameras: after the first frames, when the window is full, and every ten seconds."""
        if self._frames < self._next:
            return
        rate, self._judged = self._usual_rate, self._frames
        self._next = WINDOW if self._frames < WINDOW else self._frames + round(_EVERY * rate)
        if self._waits:
            self._learn(rate)
        elif self._judging is None or not self._judging.is_alive():
            self._judging = threading.Thread(target=self._learn_elsewhere, args=(rate,), name="live rig", daemon=True)
            self._judging.start()

    def _learn_elsewhere(self, rate: float) -> None:
        """The thread that waits for the judgement of another process."""
        recent = self._reconstructor.recent(rate)
        if recent is None:
            return
        if self._own is not None:
            self._own.begin()
        pipe = self._judge if self._own is None else self._own.pipe
        try:
            found = None if pipe is None else judge(pipe, recent)
        except (OSError, EOFError):
            # The session ends, and is judged at its end; or the process was killed.
            self._judged = 0
            if not self._queue.is_stopped:
                self._learn(rate)
            return
        if found is not None:
            self._reconstructor.take(recent, found)
            self._believe(found.fits, found.findings)

    def _learn(self, rate: float) -> None:
        self._believe(*self._reconstructor.learn(rate))

    def _believe(self, fits: tuple[CameraFit, ...], findings: Sequence[Finding]) -> None:
        """Take what a judgement says of the cameras."""
        if not fits:
            return
        self._fits = fits
        self._judgements += 1
        now = {(finding.code, finding.where): finding for finding in findings}
        # Said when two judgements in a row found it: one may be of a moment in which few markers were seen. What is said of a camera stays
        # said; what is said of all holds while it is found, since a room may be empty for a while.
        kept = {key: found for key, found in self._found.items() if key in now or (found[0].where and found[1] > 1)}
        self._found = {key: (now.get(key, finding), times + (key in now)) for key, (finding, times) in kept.items()} | {
            key: (finding, 1) for key, finding in now.items() if key not in kept
        }

    def _names(self) -> list[Finding]:
        found = []
        # Read at once: another thread adds to it.
        others = list(self._unknown)
        if others:
            sentence = f"{self.about.name}: the rig has no camera {listed(others)}; it has {listed(self._all, 12)}."
            mend = "Call the cameras by one name in the stream and in the rig."
            found.append(Finding("live-unknown-camera", Severity.WARNING, listed(others), sentence, mend))
        if self._unposed:
            sentence = f"camera {listed(self._unposed)} has no pose in the rig and was left out."
            mend = "`asterism calibrate wand` gives it one."
            found.append(Finding("reconstruct-no-pose", Severity.WARNING, listed(self._unposed), sentence, mend))
        return found

    def _counts(self) -> list[Finding]:
        """What was counted of frames and blobs."""
        found, warning = list[Finding](), Severity.WARNING
        where = self.about.name
        if self.dropped:
            sentence = f"{where}: {counted(self.dropped, 'frame')} not reconstructed, since newer ones waited."
            found.append(Finding("live-not-reconstructed", warning, where, sentence, "Close other programs, or lower the rate."))
        if self.cut:
            sentence = f"{where}: {counted(self.cut, 'blob')} left out, since frames had more than there was time for."
            found.append(
                Finding("live-many-blobs", warning, where, sentence, "Cover reflections and lamps, or raise the cameras' threshold.")
            )
        kept = self._recorder
        if kept is not None and (kept.problem or kept.left_out):
            sentence = kept.problem or f"{kept.path}: {kept.left_out} images were not recorded, since the disk was busy."
            found.append(Finding("live-not-recorded", Severity.ERROR, where, sentence, "Make space, or record to another disk."))
        unlinked, waited = sum(camera.unlinked for camera in self._gather.cameras), round(1000 * self.image_wait, 1)
        if unlinked or waited:
            sentence = (
                f"{where}: cameras are not triggered together; each frame waits {significant(waited, 2)} ms for the images after it, and "
                f"{unlinked} blobs could not be followed to its instant."
            )
            found.append(Finding("live-not-followed", Severity.NOTE, where, sentence, "Trigger the cameras together, or raise their rate."))
        return found
