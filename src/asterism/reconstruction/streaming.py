"""Blobs of one frame after the other in; its points at once, and what the last frames say about the cameras, out."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.reconstruction._frame_kernels import PointArrays
from asterism.reconstruction._input_kernels import RigArrays
from asterism.reconstruction.camera_fit import CameraFit, fit_of_cameras
from asterism.reconstruction.observation_model import RULES, estimate_observation_model, first_model
from asterism.reconstruction.problem import ObservationModel, ReconstructionProblem, common_view, image_bounds
from asterism.reconstruction.rays import BlobRays, frame_to_rays
from asterism.reconstruction.reconstruct import FramesPart, assemble, noise_unknown_finding, points_and_residuals, run_global
from asterism.reconstruction.settings import ReconstructionSettings
from asterism.reconstruction.summary import rig_findings
from asterism.recording import Blobs, Floats, Ints

WINDOW = 256
"""Latest frames that tell the noise and how the cameras fit: at 100 Hz 2.5 s, in which a walking person is in many places. Half of them
leave a camera that sees 5 markers with few places to be judged by; twice as many cost twice the memory and tell a moved camera later."""
_WORK = 300_000
"""Looks at a rival that the choice among a frame's hypotheses may take, see `pack`: about a millisecond. Of 12 cameras of 50 blobs 2
frames in 100 reach it. Half of it leaves more of these unproved; with twice as much they come a millisecond later."""
_FIRST_NOISE = 0.2
"""px that are assumed until the noise is known. Twice as much makes the points of a crowd of blobs take ten times as long, and with half
of it more of the first points are lost where the noise is larger."""
_SAME_NOISE = 0.1
"""By how much of it the noise may differ without being taken anew: the share at which the estimate itself ends its rounds."""


@dataclass(frozen=True, eq=False)
class RecentFrames:
    """Frames with the points that were made of them, as another process can take them.

    frames          the latest last
    problem, model  with which their points were made
    noise_known     whether the model's noise was estimated; is_given  whether it was given, and stays
    rate            frames per second
    """

    frames: tuple[tuple[BlobRays, FramesPart], ...]
    rig: Rig
    settings: ReconstructionSettings
    problem: ReconstructionProblem
    model: ObservationModel
    noise_known: bool
    is_given: bool
    rate: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """What frames say of the noise and of the cameras.

    problem, model  for the frames that follow; noise_known  whether the noise could be told
    fits, findings  of the cameras; none where the noise is known for the first time
    """

    problem: ReconstructionProblem
    model: ObservationModel
    noise_known: bool
    fits: tuple[CameraFit, ...]
    findings: list[Finding]


class Reconstructor:
    """Makes the points of frames while they come, each frame by itself: with the same observation model those of `reconstruct`.

    rig       the cameras, all with a pose, in the order in which their blobs are given
    settings  of `reconstruct`; the method is the global one, and static lights are not masked, since both need the whole recording
    model     the observation model; None for one that `learn` estimates from the last frames. Until then little noise is assumed

    `push` and `learn` may run in different threads: `push` never waits for `learn`. Memory is bounded by the last 256 frames.
    Raises AsterismError where fewer than two cameras have a pose, or a setting is out of range.

    >>> from asterism.cameras import Camera
    >>> left = Camera("left", (640, 480), (500.0, 500.0), (319.5, 239.5))
    >>> right = Camera("right", (640, 480), (500.0, 500.0), (319.5, 239.5), translation=[-0.5, 0.0, 0.0])
    >>> rig = Rig((left, right))
    >>> Reconstructor(rig).push(rig.project([[0.2, 0.1, 2.0]])).points.round(6)
    array([[0.2, 0.1, 2. ]])
    """

    def __init__(self, rig: Rig, settings: ReconstructionSettings | None = None, model: ObservationModel | None = None) -> None:
        self.settings = ReconstructionSettings() if settings is None else settings
        if len(rig) < 2 or not all(camera.posed for camera in rig):
            unposed = ", ".join(camera.name for camera in rig if not camera.posed)
            raise AsterismError(
                f"points need two calibrated cameras or more; {unposed or 'all but ' + rig.names[0]} has no pose. Calibrate them."
            )
        self.settings.check(len(rig))
        if self.settings.method != "global" or self.settings.mask_static:
            raise AsterismError(
                "frames that come one after the other are reconstructed by the global method, without masking; leave these settings out."
            )
        self.rig = rig
        self.no_ray, self.duplicates = 0, 0
        self.noise_known = model is not None
        self._is_given = model is not None
        self._state: tuple[ReconstructionProblem, ObservationModel, RigArrays] | None = None
        self._first = model
        self._guard = threading.Lock()
        self._frames: deque[tuple[BlobRays, FramesPart]] = deque(maxlen=WINDOW)

    @property
    def model(self) -> ObservationModel | None:
        """The observation model in use; None before the first frame with blobs."""
        return self._first if self._state is None else self._state[1]

    def push(self, blobs: Sequence[ArrayLike]) -> PointArrays:
        """The points of one frame. blobs: for each camera (n, 2) px; those of a camera that shows nothing, or did not deliver, are empty.

        `rays` are the places of the blobs among all that have a ray, one camera after the other. O(blobs) and the search of `reconstruct`.
        """
        xy = [np.asarray(each, dtype=np.float64).reshape(-1, 2) for each in blobs]
        if len(xy) != len(self.rig):
            raise AsterismError(f"blobs of {len(xy)} cameras were given, and the rig has {len(self.rig)}; give one array for each.")
        counts = np.array([len(each) for each in xy])
        flat = np.ascontiguousarray(np.concatenate(xy))
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        frame = Blobs(flat, offsets, self.rig.names, 1.0, np.full(len(flat), np.nan))
        state = self._state
        if state is None:
            problem = self._stated(frame)
            model = self._first or first_model(problem, frame.counts, self.settings.noise or _FIRST_NOISE)[0]
            self._state = state = problem, model, problem.arrays(model, _WORK)
        rays, no_ray, duplicates = frame_to_rays(frame, state[2])
        self.no_ray, self.duplicates = self.no_ray + no_ray, self.duplicates + duplicates
        part = run_global(state[2], rays, 0, 1)
        if np.count_nonzero(counts) >= 2:
            with self._guard:
                # A frame that was made with another model is judged by nobody.
                if self._state is state:
                    self._frames.append((rays, part))
        return part.points

    def learn(self, rate: float) -> tuple[tuple[CameraFit, ...], list[Finding]]:
        """Estimate the observation model by the last frames, and judge how each camera fits the others.

        rate: frames per second, for what the findings say. Returns how each camera fits, in the rig's order, and what makes the rig
        suspect, as of `asterism.reconstruction.summary`; nothing where the frames are too few or the noise is known for the first time.
        Takes some tenths of a second for 12 cameras of 50 blobs, half of it in kernels that hold no other thread up. Where frames must not
        wait for it, another process does it: `recent`, there `judged`, and here `take`.
        """
        recent = self.recent(rate)
        found = None if recent is None else judged(recent)
        if recent is None or found is None:
            return (), []
        self.take(recent, found)
        return found.fits, found.findings

    def recent(self, rate: float) -> RecentFrames | None:
        """What `judged` takes, by the last frames; None before the first one."""
        with self._guard:
            frames, state = tuple(self._frames), self._state
        return None if state is None else RecentFrames(frames, self.rig, self.settings, *state[:2], self.noise_known, self._is_given, rate)

    def take(self, recent: RecentFrames, found: Judgement) -> None:
        """Use the observation model that was found, where it is another one."""
        first = found.noise_known and not recent.noise_known
        if not found.noise_known or not (first or not _agree(recent.model, found.model)):
            return
        with self._guard:
            self._state, self.noise_known = (found.problem, found.model, found.problem.arrays(found.model, _WORK)), True
            if not np.array_equal(found.model.noise, recent.model.noise):
                # Residuals are judged by the noise with which their points were made.
                self._frames.clear()

    def _stated(self, blobs: Blobs) -> ReconstructionProblem:
        return _stated(self.rig, self.settings, blobs)


def judged(recent: RecentFrames) -> Judgement | None:
    """The observation model by some frames, and how each camera fits the others; None where the frames are too few. See `learn`."""
    frames, model = recent.frames, recent.model
    if len(frames) < RULES.min_frames:
        return None
    rays = _joined([rays for rays, _ in frames], recent.rate)
    problem = _stated(recent.rig, recent.settings, rays.blobs)
    newer, known, looked_at = model, recent.noise_known, 0
    if not recent.is_given:
        run = partial(points_and_residuals, rays)
        # From the noise that is known already, one round is enough where nothing changed.
        rules = replace(RULES, start_noise=float(model.noise[0]))
        newer, known, looked_at = estimate_observation_model(problem, rays.blobs.counts, run, recent.settings.noise, rules)
    if known and not recent.noise_known:
        return Judgement(problem, newer, known, (), [])
    cameras = len(recent.rig)
    begins = rays.blobs.offsets[::cameras]
    moved = [_later(part, int(begin)) for (_, part), begin in zip(frames, begins, strict=False)]
    lag = np.zeros(cameras, dtype=np.int64)
    result = assemble(moved, rays.blobs, recent.problem, model, "global", lag, (), recent.noise_known)
    fits = fit_of_cameras(result, recent.rig)
    findings = [*([] if known else [noise_unknown_finding(looked_at)]), *rig_findings(result, recent.rig, fits)]
    return Judgement(problem, newer, known, fits, findings)


def _stated(rig: Rig, settings: ReconstructionSettings, blobs: Blobs) -> ReconstructionProblem:
    bounds, corners = image_bounds(blobs, rig), settings.corners
    space = common_view(rig, bounds, corners)
    return ReconstructionProblem(rig, bounds, corners, space, settings.min_cameras, settings.gate)


def _joined(frames: Sequence[BlobRays], rate: float) -> BlobRays:
    """The rays of frames, each of which is a recording of one frame."""
    first = frames[0].blobs
    counts: Ints = np.concatenate([each.blobs.counts[0] for each in frames])
    xy = np.concatenate([each.blobs.xy for each in frames])
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    blobs = Blobs(xy, offsets, first.cameras, rate, np.full(len(xy), np.nan))
    return BlobRays(blobs, np.concatenate([each.normalised for each in frames]), np.concatenate([each.jacobian for each in frames]))


def _later(part: FramesPart, begin: int) -> FramesPart:
    """The points of a frame whose first blob is number `begin` of the recording."""
    rays: Ints = np.where(part.points.rays >= 0, part.points.rays + begin, -1)
    return replace(part, points=part.points._replace(rays=rays))


def _agree(one: ObservationModel, other: ObservationModel) -> bool:
    """Whether two models have nearly the same noise and rates, so that points of one may be judged by the other."""
    noise: Floats = np.abs(one.noise - other.noise) / other.noise
    return bool((noise <= _SAME_NOISE).all() and (np.abs(one.detection_rate - other.detection_rate) <= _SAME_NOISE).all())
