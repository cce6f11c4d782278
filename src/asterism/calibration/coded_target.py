"""A flat sheet of coded circles as a calibration board: circles with identities that cameras read in, a rig with its covariance out.

GaMoCap 2.3: each circle of the sheet is known by itself, so a view that shows any part of it counts. Each camera is calibrated by Zhang's
method from its partly seen targets, then cameras, targets and, unlike in the paper, lenses are adjusted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.boards.board import Board
from asterism.calibration.boards.calibrate import BoardCalibration, calibrate_board
from asterism.calibration.boards.views import LEAST_POINTS, BoardViews
from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import Sightings
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotation_from_vector
from asterism.progress import Progress
from asterism.recording import Floats, Ints

_LINE = 0.02
"""Points whose spread across is less than this share of that along lie in a line."""
_EDGE_ON = np.radians(75.0)
"""A view steeper than this says little about a lens: circles are a quarter as high as wide."""
_ROUNDS = 2
"""Calibrations, each with centres corrected by the poses of the one before; a third changed no focal length by 0.001 px in simulation."""


class IdentifiedCircles(Protocol):
    """What is used of one image: where circles are, and which."""

    @property
    def centres(self) -> Floats:
        """(n, 2) px, of the ellipses."""

    @property
    def ids(self) -> Ints:
        """(n,) identities, -1 where unknown."""


@dataclass(frozen=True, eq=False, repr=False)
class CodedTarget(Board):
    """A flat sheet of circles, each with an identity. Made by `CodedTarget.of`.

    ids       (K,) ascending
    places    (K, 3) m on the sheet: x to the right and y down as printed, z = 0
    diameter  m, of the circles
    """

    ids: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    places: Floats = field(default_factory=lambda: np.empty((0, 3)))
    diameter: float = 0.0

    def __post_init__(self) -> None:
        if len(self.ids) < LEAST_POINTS or self.places.shape != (len(self.ids), 3) or (np.diff(self.ids) <= 0).any():
            raise AsterismError(
                f"a coded target needs at least {LEAST_POINTS} circles with different identities and a place each; it has {len(self.ids)}."
            )
        if np.ptp(self.places[:, 2]) > 1e-9:
            raise AsterismError("a coded target is flat; give the places of its circles with z = 0.")
        if not 0 < self.diameter < self.spacing < 1.0:
            raise AsterismError(f"circles of {self.diameter:g} m at a pitch of {self.spacing:g} m are not possible; give metres.")

    @classmethod
    def of(cls, ids: ArrayLike, places: ArrayLike, spacing: float, diameter: float) -> CodedTarget:
        """From identities (K,) and places (K, 3) m in any order, the pitch and the circles' diameter, m.

        Raises AsterismError where an identity occurs twice, there are fewer than six, or they are not in a plane z = 0.
        """
        numbers, where = np.asarray(ids, dtype=np.int64), np.asarray(places, dtype=np.float64)
        order = np.argsort(numbers, kind="stable")
        columns, rows = (round(float(np.ptp(where[:, axis])) / spacing) + 1 if len(where) else 0 for axis in (0, 1))
        return cls("circles", columns, rows, spacing, ids=numbers[order], places=where[order], diameter=diameter)

    @property
    def turns_alike(self) -> bool:
        """Never: every circle is known by itself."""
        return False

    @property
    def points(self) -> Floats:
        """(K, 3) m, in the order of `ids`."""
        return self.places

    def __str__(self) -> str:
        return f"coded target, {len(self.ids)} circles, {1000 * self.spacing:g} mm apart"

    def view(self, circles: IdentifiedCircles) -> tuple[Ints, Floats]:
        """Which points (n,) of the target an image shows, and where (n, 2) px. What it shows twice or is not of the target is left out."""
        ids = np.asarray(circles.ids, dtype=np.int64)
        unique, first, count = np.unique(ids, return_index=True, return_counts=True)
        place = np.searchsorted(self.ids, unique)
        own = (count == 1) & (place < len(self.ids)) & (self.ids[np.minimum(place, len(self.ids) - 1)] == unique)
        centres = np.asarray(circles.centres, dtype=np.float64)[first[own]]
        there = np.isfinite(centres).all(axis=1)
        return place[own][there], centres[there]


def target_views(
    target: CodedTarget, images: Sequence[Sequence[IdentifiedCircles | None]], names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> BoardViews:
    """Where cameras saw a target.

    images  (T, C): what was read in the image of each frame and camera, None where there is no image
    names, sizes  (C,) of the cameras, and (width, height) px of their images

    Views with fewer than six circles, or with all in a line, are left out. Raises AsterismError where no view is left.
    """
    rows = []
    for t, frame in enumerate(images):
        for c, circles in enumerate(frame):
            if circles is None:
                continue
            points, centres = target.view(circles)
            if len(points) >= LEAST_POINTS and not _in_a_line(target.places[points]):
                rows.append((np.full(len(points), t), np.full(len(points), c), points, centres))
    counts = tuple(sum(frame[c] is not None for frame in images) for c in range(len(names)))
    if not rows:
        raise AsterismError(
            f"no image shows {LEAST_POINTS} circles of the {target} that are not in a line, of {sum(counts)} images; check that it is this "
            "target, that it is sharp, and that no camera sees it only edge-on."
        )
    frame_of, camera, point, xy = (np.concatenate(column) for column in zip(*rows, strict=True))
    frames, number = np.unique(frame_of, return_inverse=True)
    return BoardViews(target, tuple(names), tuple(sizes), frames.astype(np.int64), Sightings.of(number, camera, point, xy), counts)


def calibrate_target(
    views: BoardViews, *, known: Rig | None = None, origin: int | None = None, progress: Progress | None = None
) -> BoardCalibration:
    """Calibrate all cameras that share views of a coded target, with lenses; `adjustment.covariance` is that of all their parameters.

    views  from `target_views`; the rest as for `boards.calibrate_board`, which does the work

    The centre of a circle's image is not the image of its centre. By what, follows from the target's pose (`centre_offsets`), so the
    calibration is done twice: the second time with centres corrected by the poses of the first. The paper does not mention this; circles of
    38 mm at 2 m are up to 0.1 px off.

    Raises AsterismError where the views are not of a coded target, or no camera can be calibrated.
    """
    target = views.board
    if not isinstance(target, CodedTarget):
        raise AsterismError(f"the views are of a {target}, not of a coded target; calibrate with `asterism calibrate board`.")
    raw, corrected = views.seen.xy, views
    for part in range(_ROUNDS):

        def report(share: float, what: str, part: int = part) -> None:
            if progress is not None:
                progress((part + share) / _ROUNDS, what)

        made = calibrate_board(corrected, known=known, origin=origin, progress=report)
        if part < _ROUNDS - 1:
            corrected = replace(views, seen=replace(views.seen, xy=raw - _offsets(made, views, target)))
    steep = tuple(_edge_on(made, views))
    return replace(made, findings=(*made.findings, *steep)) if steep else made


def centre_offsets(camera: Camera, rotations: Floats, places: Floats, radius: float) -> Floats:
    """How far the centre of a circle's image lies from the image of its centre: (n, 2) px.

    rotations  (n, 3, 3) camera from target, places (n, 3) m of the circles' centres in the camera's axes, radius m

    A circle of radius r on a plane has the dual conic diag(r2, r2, -1); the plane's homography is [r1 r2 p], r1 and r2 the first columns
    of the rotation, p the centre. The image's dual conic D = r2 (r1 r1' + r2 r2') - p p' has its centre at D[:2, 2] / D[2, 2], on the
    normalised plane, where the conic is exact; the lens' distortion is applied to both centres.
    """
    first, second = rotations[:, :, 0], rotations[:, :, 1]
    dual = radius**2 * (first * first[:, 2:] + second * second[:, 2:]) - places * places[:, 2:]
    lens = replace(camera, rotation=np.eye(3), translation=np.zeros(3))
    offsets: Floats = lens.project(dual / dual[:, 2:]) - lens.project(places)
    return offsets


def target_poses(camera: Camera, target: CodedTarget, circles: IdentifiedCircles) -> list[tuple[Floats, Floats, float]]:
    """Where a target is in one view of a camera whose lens is known: camera from target (3, 3) and (3,) m, and the error left, px.

    Three circles suffice (GaMoCap 2.3); three alone can allow two poses or more, all of which are given, best first, without those that
    show the sheet's back. Empty where fewer are seen, or all in a line.
    """
    import cv2

    points, centres = target.view(circles)
    if len(points) < 3 or _in_a_line(target.places[points]):
        return []
    model, flat = target.places[points], camera.undistort(centres)
    if not np.isfinite(flat).all():
        return []
    given = (model, np.ascontiguousarray(flat), np.eye(3), np.zeros(4))
    if len(points) == 3:
        _, turns, shifts = cv2.solveP3P(*given, flags=cv2.SOLVEPNP_P3P)
    else:
        _, turns, shifts, *_ = cv2.solvePnPGeneric(*given, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for turn, shift in zip(turns, shifts, strict=True):
        if len(points) > 3:
            turn, shift = cv2.solvePnPRefineLM(model, flat, np.eye(3), np.zeros(4), turn.copy(), shift.copy())
        rotation, place = rotation_from_vector(turn), np.asarray(shift, dtype=np.float64).ravel()
        seen = replace(camera, rotation=rotation, translation=place).project(model)
        error = float(np.sqrt(np.mean(np.square(seen - centres).sum(axis=1))))
        # the print faces the camera where the sheet's z, which leads into it, leads away from the camera
        if np.isfinite(error) and rotation[:, 2] @ (rotation @ model.mean(axis=0) + place) > 0:
            found.append((rotation, place, error))
    return sorted(found, key=lambda pose: pose[2])


def _in_a_line(places: Floats) -> bool:
    spread = np.linalg.svd(places[:, :2] - places[:, :2].mean(axis=0), compute_uv=False)
    return bool(spread[1] <= _LINE * spread[0])


def _poses(made: BoardCalibration, views: BoardViews) -> tuple[Ints, Ints, Floats, Floats]:
    """For each of the views' sightings the place of its camera in the adjustment (-1: none), of its frame, and the target in the camera."""
    names = [camera.name for camera in made.adjustment.cameras]
    camera = np.array([names.index(name) if name in names else -1 for name in views.cameras])[views.seen.camera]
    frame = np.searchsorted(made.used, views.seen.frame)
    there = (frame < len(made.used)) & (made.used[np.minimum(frame, len(made.used) - 1)] == views.seen.frame)
    camera = np.where(there, camera, -1)
    frame = np.where(there, frame, 0)
    turns = np.array([one.rotation for one in made.adjustment.cameras])[camera] @ made.adjustment.rotations[frame]
    shifts = np.array([one.translation for one in made.adjustment.cameras])[camera]
    placed = np.einsum(
        "nij,nj->ni", np.array([one.rotation for one in made.adjustment.cameras])[camera], made.adjustment.translations[frame]
    )
    return camera, frame, turns, placed + shifts


def _offsets(made: BoardCalibration, views: BoardViews, target: CodedTarget) -> Floats:
    """(n, 2) px by which each sighting's centre is off; 0 where its pose is not known."""
    camera, _, turns, placed = _poses(made, views)
    places = np.einsum("nij,nj->ni", turns, target.places[views.seen.point]) + placed
    out = np.zeros((len(camera), 2))
    for c, one in enumerate(made.adjustment.cameras):
        own = camera == c
        out[own] = centre_offsets(one, turns[own], places[own], 0.5 * target.diameter)
    return np.where(np.isfinite(out), out, 0.0)


def _edge_on(made: BoardCalibration, views: BoardViews) -> list[Finding]:
    """Cameras most of whose views show the target edge-on."""
    camera, frame, turns, placed = _poses(made, views)
    cosine = np.abs(np.einsum("ni,ni->n", turns[:, :, 2], placed)) / np.linalg.norm(placed, axis=1)
    findings = []
    for c, one in enumerate(made.adjustment.cameras):
        own = np.unique(frame[camera == c], return_index=True)[1]
        tilt = np.arccos(np.clip(cosine[camera == c][own], 0.0, 1.0))
        if len(tilt) and np.mean(tilt > _EDGE_ON) > 0.5:
            findings.append(
                Finding(
                    "target-edge-on",
                    Severity.WARNING,
                    one.name,
                    f"camera {one.name} saw the target within {90 - np.degrees(_EDGE_ON):.0f} degrees of edge-on in most of its views.",
                    "Turn the target towards it.",
                )
            )
    return findings
