"""A recording in; what four small cameras around it would see, with the truth, out: the laboratory of the virtual-occlusions paper."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import interp1d

from asterism.cameras import Rig
from asterism.recording import Blobs, Floats, Ints, Recording
from asterism.simulation.cameras import Capsules, ImagingSettings, _kernels, ring_rig, simulate_blobs, walker_capsules

RATE = 60.0
"""Frames per second of the paper's cameras."""
SIZE = (656, 491)
"""px, the images of the paper's cameras."""
VOLUME = (2.0, 1.8, 2.0)
"""m, along the walk, across it, and high."""
THICKER = 1.1
"""The bodies that hide markers are thicker by this than `walker_capsules` has them."""
_MARKER_RADIUS = 0.007
"""m, as `ImagingSettings` has it."""
RADIUS, HEIGHT = 3.4, 1.9
"""m, how far from the middle of the volume the cameras hang, and how high."""


@dataclass(frozen=True, eq=False)
class ViewsSession:
    """A person in the paper's laboratory.

    rig        the cameras
    recording  the truth, at the cameras' rate, markers of the body only
    blobs      what the cameras saw
    identity   (P,) the marker of each blob, -1 for a stray, -2 for several markers in one
    hiding     the capsules that hide markers
    """

    rig: Rig
    recording: Recording
    blobs: Blobs
    identity: Ints
    hiding: Capsules

    @property
    def in_view(self) -> np.ndarray:
        """(T, C, M) whether a marker is in a camera's image and nothing hides it; its blob may still run into another."""
        points = self.recording.positions
        out = np.zeros((len(points), len(self.rig), points.shape[1]), dtype=np.bool_)
        hidden = np.empty(points.shape[:2], dtype=np.bool_)
        for c, camera in enumerate(self.rig):
            _kernels.hidden(camera.position, points, self.hiding.starts, self.hiding.ends, self.hiding.radii, _MARKER_RADIUS, hidden)
            xy = camera.project(points)
            inside = ((xy > -0.5) & (xy < np.array(camera.size) - 0.5)).all(axis=2)
            out[:, c] = inside & ~hidden
        return out

    @property
    def shown(self) -> np.ndarray:
        """(T, C, M) whether a camera has a blob of its own of each marker."""
        out = np.zeros((len(self.blobs), len(self.rig), len(self.recording.labels)), dtype=np.bool_)
        alone = self.identity >= 0
        out[self.blobs.frame_of[alone], self.blobs.camera_of[alone], self.identity[alone]] = True
        return out


def paper_rig(cameras: int = 4, *, rng: np.random.Generator | None = None) -> Rig:
    """Cameras of 656 x 491 px around a volume of 2 x 1.8 x 2 m: four in its corners; of fewer cameras those beside each other.

    rng hangs each camera a little elsewhere, see `ring_rig`.
    """
    # Always the ring of four at least: fewer cameras are some of the same ones.
    ring = ring_rig(max(cameras, 4), RADIUS, HEIGHT, SIZE, rng=rng)
    corner = np.pi / 4
    turn = np.array([[np.cos(corner), -np.sin(corner), 0.0], [np.sin(corner), np.cos(corner), 0.0], [0.0, 0.0, 1.0]])
    turned = ring.moved(turn, np.zeros(3))
    return turned.select(turned.names[:cameras])


def simulate_views(
    recording: Recording,
    markers: tuple[str, ...],
    *,
    rng: np.random.Generator,
    cameras: int = 4,
    body: Capsules | None = None,
) -> ViewsSession:
    """What the paper's cameras would see of a person who walks through the middle of their volume.

    recording  z up; it needs the pelvis' markers, and may have more markers than `markers`: the body that hides is made of all
    markers    which of them shine
    body       the capsules that hide them, in the recording's frames, before they are made 10 % thicker; by default `walker_capsules`

    The walk is turned so that its long way is along x, and shifted so that the middle of its path is the origin. Frames are at 60 Hz; those
    in which the pelvis is outside the volume are left out. Blobs have 0.5 px of noise, images two passing lights on average.
    """
    hiding = walker_capsules(recording) if body is None else body
    # Markers and body together, so that both are sampled and turned alike.
    points = np.concatenate([recording.positions, hiding.starts, hiding.ends], axis=1)
    points = _at_rate(points, recording.rate, RATE)
    hips = [recording.labels.index(name) for name in recording.labels if name in ("LASI", "RASI", "SACR")]
    # The pelvis says where the person is.
    middle = np.nanmean(points[:, hips], axis=1)
    points = (points - _middle_of(middle)) @ _along_x(middle).T
    middle = np.nanmean(points[:, hips], axis=1)
    points = points[(np.abs(middle[:, 0]) <= VOLUME[0] / 2) & (np.abs(middle[:, 1]) <= VOLUME[1] / 2)]
    count, parts = len(recording.labels), len(hiding.radii)
    # Thicker than the body that hides in the labelling: a model of a body is never exact.
    starts, ends = (np.ascontiguousarray(points[:, at : at + parts]) for at in (count, count + parts))
    thick = Capsules(starts, ends, THICKER * hiding.radii, hiding.names)
    columns = [recording.labels.index(name) for name in markers]
    shown = np.ascontiguousarray(points[:, columns])
    truth = replace(recording, positions=shown, labels=markers, rate=RATE, events=(), source=None, origin=None, taken=())
    rig = paper_rig(cameras)
    blobs, identity = simulate_blobs(rig, truth.positions, ImagingSettings(noise=0.5, strays=2.0), rng=rng, body=thick, rate=RATE)
    return ViewsSession(rig, truth, blobs, identity, thick)


def _at_rate(points: Floats, rate: float, wanted: float) -> Floats:
    """Points (T, N, 3) at another rate, between frames on a line; NaN beside missing ones."""
    if len(points) < 2 or rate == wanted:
        return points
    times = np.arange(0.0, (len(points) - 1) / rate + 1e-9, 1.0 / wanted)
    there: Floats = interp1d(np.arange(len(points)) / rate, points, axis=0, bounds_error=False, fill_value="extrapolate")(times)
    return there


def _middle_of(path: Floats) -> Floats:
    """The middle of a path (T, 3) on the floor."""
    some = path[np.isfinite(path[:, 0])]
    middle = 0.5 * (some.min(axis=0) + some.max(axis=0))
    return np.array([middle[0], middle[1], 0.0])


def _along_x(path: Floats) -> Floats:
    """The turn about z (3, 3) that lays the longest way of a path (T, 3) along x."""
    some = path[np.isfinite(path[:, 0]), :2]
    # The direction of most spread is that of the walk.
    way = np.linalg.svd(some - some.mean(axis=0), full_matrices=False)[2][0]
    return np.array([[way[0], way[1], 0.0], [-way[1], way[0], 0.0], [0.0, 0.0, 1.0]])
