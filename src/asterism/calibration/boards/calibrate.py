"""Views of a board in; a calibrated rig, what it leaves over and what to know before using it, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asterism.calibration.boards import checks
from asterism.calibration.boards.extrinsics import CameraLinks, first_boards, first_rig, links_between, numbered_alike
from asterism.calibration.boards.flatness import bend_of
from asterism.calibration.boards.intrinsics import Intrinsics, calibrate_intrinsics
from asterism.calibration.boards.views import BoardViews
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity, worst
from asterism.progress import Progress
from asterism.recording import Floats, Ints

_LENS = ("focal", "aspect", "centre", "k1", "k2", "k3", "tangential")
_EXPECTED = {"aspect": 0.02, "centre": 0.1, "k1": 0.5, "k2": 1.0, "k3": 2.0, "tangential": 0.02}
"""Standard deviations of lenses before any view (the centre's: of the image's width): weak, they hold what no view determines."""
_NOISE_PX = 0.2
"""px, of a board's points, by which these standard deviations count."""
_OUTLYING, _OUTLYING_PX, _ROUNDS = 4.0, 1.0, 3
"""A view is rejected whose error is so many times the median, and above so many px; in so many rounds."""


@dataclass(frozen=True)
class BoardCalibration:
    """A rig calibrated from views of a board.

    rig             the cameras that share views; with one camera its lens alone, without a pose
    views           what it was made from
    intrinsics      per camera of the rig its calibration by itself
    adjustment      of all together
    used            (T,) places in `views.frames` of the frames that were adjusted
    sightings       those that were adjusted, frame counting `used`
    rejected_views  (frame, camera) of views that do not fit
    excluded        names of cameras that are not in the rig; `findings` say why
    focal_std       per camera of the rig, px
    links           which cameras share views, of those that were calibrated alone
    linked_cameras  their names
    bend            how far the board's points lie from where they should be, as a share of its longer side; 0 where noise explains it
    findings        what to know before using the rig, those of the files first
    """

    rig: Rig
    views: BoardViews
    intrinsics: tuple[Intrinsics, ...]
    adjustment: Adjustment
    used: Ints
    sightings: Sightings
    rejected_views: tuple[tuple[int, str], ...]
    excluded: tuple[str, ...]
    focal_std: tuple[float, ...]
    links: CameraLinks
    linked_cameras: tuple[str, ...]
    bend: float
    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        """Whether no finding is an error."""
        return worst(self.findings) < Severity.ERROR

    @property
    def covered(self) -> tuple[float, ...]:
        """Per camera of the rig the share of its image in which points of the board were seen, by cells of an eighth of its sides."""
        return _covered(self.rig, self.sightings)

    @property
    def rms(self) -> float:
        """px, over all points of all views that were adjusted."""
        return self.adjustment.rms

    def summary(self) -> dict[str, Any]:
        """The calibration as plain values, for JSON and reports."""
        return {
            "board": str(self.views.board),
            "usable": self.usable,
            "frames": len(self.views.frames),
            "frames_used": len(self.used),
            "reprojection_rms_px": self.rms,
            "board_bend": self.bend,
            "cameras": [self._camera_summary(c) for c in range(len(self.rig))],
            "rejected_views": [{"frame": frame, "camera": name} for frame, name in self.rejected_views],
            "excluded": list(self.excluded),
        }

    def _camera_summary(self, c: int) -> dict[str, Any]:
        camera = self.rig.cameras[c]
        number = self.views.cameras.index(camera.name)
        return {
            "name": camera.name,
            "size": list(camera.size or ()),
            "images": self.views.images[number],
            "views": int((self.views.counts[:, number] > 0).sum()),
            "image_covered": self.covered[c],
            "rms_alone_px": self.intrinsics[c].camera.error,
            "rms_px": camera.error,
            "focal_px": list(camera.focal),
            "focal_std_px": self.focal_std[c],
            "centre_px": list(camera.centre),
            "distortion": camera.distortion.tolist(),
            "position_m": camera.position.tolist() if camera.posed else None,
        }


def calibrate_board(
    views: BoardViews, *, known: Rig | None = None, origin: int | None = None, progress: Progress | None = None
) -> BoardCalibration:
    """Calibrate all cameras that share views of a board, also where no two see all of it and no pair sees all views.

    Each camera alone by OpenCV; relative poses along the strongest links; then lenses, poses and boards together, by least squares with a
    robust loss; views that fit four times worse than the median, and by more than 1 px, are left out. The board is taken as exact.
    Where all together miss the board by a quarter more than each alone does, the cameras were not in step: a finding says so, and the
    lenses stay those of each camera alone, which such views would spoil. A rig is not usable where the board bends much, or where a third
    of the views that link two cameras had to be left out.

    known   cameras whose lenses are known, by name: they are kept, and one view is enough for a pose; their poses are not used
    origin  the frame in which the board lay on the floor, print up: it gives the world its origin, x along the board's rows, z up. Else
            the world is the first camera's axes

    Cameras that saw too little, or share no view with the others, are named in `excluded` and not in the rig. Raises AsterismError where
    no camera can be calibrated, a known lens is of another image size, or the origin's frame has no board.
    """
    lenses = _known_lenses(views, known)
    intrinsics = _calibrate_each(views, lenses, progress)
    if progress is not None:
        progress(0.85, "adjusting all cameras together")
    start = _start(views, intrinsics)
    single_rms = float(np.sqrt(np.mean([start.intrinsics[c].rms ** 2 for c in start.group])))
    adjusted = _adjusted(start, {c: [] if c in lenses else list(_LENS) for c in start.group})
    together = adjusted.result.rms
    # Views that were not taken at one moment contradict each other, and free lenses would bend to please them.
    if len(start.group) >= 2 and not checks.in_step(together, single_rms):
        adjusted = _adjusted(start, {c: [] for c in start.group})
    return _calibration(start, adjusted, lenses, (together, single_rms), origin)


@dataclass(frozen=True)
class _Start:
    """Where the adjustment of all cameras begins.

    views       with the points of boards that look the same upside down numbered alike
    intrinsics  of each camera that could be calibrated by itself, by its number
    order       their numbers, in the order of `links`
    links       which of them share views
    group       the cameras of the rig
    cameras     each with its pose
    """

    views: BoardViews
    intrinsics: dict[int, Intrinsics]
    order: tuple[int, ...]
    links: CameraLinks
    group: tuple[int, ...]
    cameras: dict[int, Camera]


def _start(views: BoardViews, intrinsics: dict[int, Intrinsics]) -> _Start:
    """The largest group of cameras that share views, each with a first pose."""
    order = sorted(intrinsics)
    links = links_between([intrinsics[c].frames for c in order])
    group = [order[i] for i in links.groups[0]]
    points = views.board.points
    # Turned about its middle by half a turn, such a board shows the same points.
    middle = 0.5 * (points[0] + points[-1]) if views.board.turns_alike else None
    placed = first_rig({i: intrinsics[c] for i, c in enumerate(order)}, links, middle)
    cameras = {order[i]: camera for i, camera in placed.items()}
    if middle is not None:
        renumbered, seen = numbered_alike({c: intrinsics[c] for c in group}, cameras, views.seen, len(points) - 1, middle)
        intrinsics, views = {**intrinsics, **renumbered}, replace(views, seen=seen)
    return _Start(views, intrinsics, tuple(order), links, tuple(group), cameras)


def _calibration(
    start: _Start, adjusted: _Adjusted, lenses: dict[int, Camera], errors: tuple[float, float], origin: int | None
) -> BoardCalibration:
    """The rig and what to know about it; errors: px, of all cameras together with their lenses free, and of each alone."""
    views, result, sightings = start.views, adjusted.result, adjusted.sightings
    single = tuple(start.intrinsics[c] for c in start.group)
    freed = zip(result.free[:, 6], result.sigma[:, 6], single, strict=True)
    # Many views of a board at rest count as many in the covariance and teach as much as one.
    focal_std = tuple(one.repeated * float(sigma if free else one.focal_std) for free, sigma, one in freed)
    rig = _in_world(Rig(result.cameras), views, adjusted, origin)
    rejected = [(int(views.frames[t]), views.cameras[c]) for t, c in adjusted.rejected]
    # Views that a camera alone could not explain were never part of the adjustment; they are rejected all the same.
    rejected += [(int(views.frames[t]), views.cameras[c]) for c in start.group for t in start.intrinsics[c].rejected]
    bend = bend_of(views.board.points, sightings, result)
    excluded = [c for c in range(len(views.cameras)) if c not in start.group]
    found = (
        *views.findings,
        *checks.check_excluded(views, excluded, start.intrinsics, views.cameras[start.group[0]]),
        *_check_rig(start, adjusted, rig, lenses),
        *checks.check_flat(bend, views.board.points),
        *(checks.check_in_step(*errors) if len(start.group) >= 2 else ()),
        *checks.check_lenses(rig, single, focal_std, _covered(rig, sightings)),
    )
    lacks = ("the pose of every camera",) if len(rig) == 1 else ("which way is up",) if rig.vertical is None else ()
    # The rig's file carries what speaks against the rig, not what was wrong with files and cameras outside it.
    about = [str(finding) for finding in found[len(views.findings) + len(excluded) :]]
    metadata = {
        "format": "Asterism rig",
        "calibrated_from": str(views.board),
        "frames": len(adjusted.used),
        "reprojection_rms_px": result.rms,
        **({"findings": about} if about else {}),
    }
    return BoardCalibration(
        replace(rig, metadata=metadata, lacks=lacks), views, single, result, adjusted.used, sightings, tuple(sorted(rejected)),
        tuple(views.cameras[c] for c in excluded), focal_std, start.links, tuple(views.cameras[c] for c in start.order), bend, found,
    )  # fmt: skip


def _check_rig(start: _Start, adjusted: _Adjusted, rig: Rig, lenses: dict[int, Camera]) -> list[Finding]:
    """What speaks against known lenses and links of cameras. Few shared views are only named where the links are consistent."""
    views, sightings = start.views, adjusted.sightings
    kept = links_between([np.unique(sightings.frame[sightings.camera == c]) for c in range(len(start.group))])
    own = start.links.groups[0]
    known = list(checks.check_known_lenses(views, lenses, start.intrinsics))
    links = list(checks.check_links(rig, start.links.shared[np.ix_(own, own)], kept, views.board))
    return [*known, *(links or checks.check_few_shared(rig, kept))]


def _covered(rig: Rig, sightings: Sightings) -> tuple[float, ...]:
    return tuple(checks.share_covered(camera, sightings.xy[sightings.camera == c]) for c, camera in enumerate(rig))


def _known_lenses(views: BoardViews, known: Rig | None) -> dict[int, Camera]:
    """The cameras of a rig that are among the views, by place. Raises AsterismError where there are none, or sizes differ."""
    lenses = {c: known[name] for c, name in enumerate(views.cameras) if known is not None and name in known.names}
    if known is not None and not lenses:
        raise AsterismError(
            f"the rig with known lenses has {', '.join(known.names)}, and the views are of {', '.join(views.cameras)}; name them alike."
        )
    for c, camera in lenses.items():
        if camera.size is not None and views.sizes[c] not in ((0, 0), camera.size):
            raise AsterismError(
                f"camera {camera.name}: its images are {views.sizes[c][0]} x {views.sizes[c][1]}, its lens was calibrated for "
                f"{camera.size[0]} x {camera.size[1]}; film in that size, or calibrate the lens again."
            )
    return {c: replace(camera, size=views.sizes[c]) for c, camera in lenses.items() if views.sizes[c] != (0, 0)}


def _calibrate_each(views: BoardViews, lenses: dict[int, Camera], progress: Progress | None) -> dict[int, Intrinsics]:
    """Every camera calibrated by itself, by its number. Raises AsterismError where none can be."""
    intrinsics: dict[int, Intrinsics] = {}
    for c, name in enumerate(views.cameras):
        if progress is not None:
            progress(0.8 * c / len(views.cameras), f"calibrating camera {name}")
        if not (views.counts[:, c] > 0).any():
            continue
        own = views.seen.select(views.seen.camera == c)
        one = calibrate_intrinsics(name, views.sizes[c], views.board.points, own, lenses.get(c))
        if one is not None:
            intrinsics[c] = one
    if not intrinsics:
        why = checks.check_excluded(views, range(len(views.cameras)), {}, "")
        raise AsterismError(f"no camera can be calibrated: {' '.join(str(finding) for finding in why)}")
    return intrinsics


@dataclass(frozen=True)
class _Adjusted:
    """A bundle adjustment: its sightings, frames counted without holes; the frames (T,) used; the views (frame, camera) rejected."""

    result: Adjustment
    sightings: Sightings
    used: Ints
    rejected: list[tuple[int, int]]


def _adjusted(start: _Start, lens: dict[int, list[str]]) -> _Adjusted:
    """The bundle adjustment of poses and these parts of each lens, again without the views that do not fit, until all do."""
    views, group = start.views, start.group
    place = {c: i for i, c in enumerate(group)}
    good = np.zeros((len(views.frames), len(views.cameras)), dtype=bool)
    for c in group:
        # Begin from the views that fit each camera alone.
        good[start.intrinsics[c].frames, c] = True
    cameras = [start.cameras[c] for c in group]
    free = np.concatenate([free_parameters(1, "pose", *lens[c]) for c in group])
    rejected: list[tuple[int, int]] = []
    # An outlying view draws the others off, so what is outlying is asked again once it is gone.
    for _ in range(_ROUNDS):
        kept = views.seen.select(good[views.seen.frame, views.seen.camera])
        local = Sightings(kept.frame, np.array([place[c] for c in kept.camera], dtype=np.int64), kept.point, kept.xy)
        compact, frames = local.compact()
        turned, placed = first_boards(start.intrinsics, {c: cameras[place[c]] for c in group}, frames)
        settings = AdjustSettings(tolerance=1e-9, steps=100)
        result = adjust(cameras, views.board.points, compact, turned, placed, free=free, prior=_expected(cameras), settings=settings)
        cameras = list(result.cameras)
        outlying = _outlying(result, compact, len(frames), len(cameras))
        if not len(outlying):
            break
        for at in outlying.tolist():
            t, c = int(frames[at // len(cameras)]), group[at % len(cameras)]
            still = good.copy()
            still[t, c] = False
            # A camera keeps its last view, be it bad: without any it would have no pose to be judged by.
            if still[:, c].any():
                good = still
                rejected.append((t, c))
    return _Adjusted(result, compact, frames, rejected)


def _outlying(result: Adjustment, sightings: Sightings, frames: int, cameras: int) -> Ints:
    """The views, frame * cameras + camera, whose error is far above the median."""
    cell = sightings.frame * cameras + sightings.camera
    # A point behind a camera has no residual; a thousand pixels make its view outlying for certain.
    square = np.where(np.isfinite(result.residuals[:, 0]), np.square(result.residuals).sum(axis=1), 1e6)
    number = np.bincount(cell, minlength=frames * cameras)
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.sqrt(np.bincount(cell, square, minlength=len(number)) / number)
    return np.nonzero(errors > max(_OUTLYING * float(np.nanmedian(errors)), _OUTLYING_PX))[0]


def _expected(cameras: list[Camera]) -> tuple[Floats, Floats]:
    """Values and standard deviations (C, 15) before any view, see _EXPECTED; the latter in px of noise."""
    values, spread = np.zeros((len(cameras), 15)), np.full((len(cameras), 15), np.inf)
    for c, camera in enumerate(cameras):
        width, height = camera.size or (1, 1)
        values[c, 7:10] = 1.0, (width - 1) / 2, (height - 1) / 2
        spread[c, 7] = _EXPECTED["aspect"]
        spread[c, 8:10] = _EXPECTED["centre"] * width
        spread[c, 10:13] = _EXPECTED["k1"], _EXPECTED["k2"], _EXPECTED["k3"]
        spread[c, 13:15] = _EXPECTED["tangential"]
    return values, spread / _NOISE_PX


def _in_world(rig: Rig, views: BoardViews, adjusted: _Adjusted, origin: int | None) -> Rig:
    """The rig in the axes of its first camera, or of the board in a frame: x along its rows, z up from its print. One has no pose."""
    if len(rig) == 1:
        if origin is not None:
            raise AsterismError(f"camera {rig.names[0]} is alone, a rig of one camera has no world; leave out the origin.")
        return Rig((replace(rig.cameras[0], rotation=np.eye(3), translation=np.zeros(3), posed=False),))
    if origin is None:
        # Without a floor the first camera's axes are as good a world as any, and everyone can find them again.
        first = rig.cameras[0]
        return rig.moved(first.rotation, first.translation)
    at = np.nonzero(views.frames[adjusted.used] == origin)[0]
    if not len(at):
        raise AsterismError(f"no camera saw the board at frame {origin}, which is to be the origin; name one of those where it was seen.")
    turned, placed = adjusted.result.rotations[at[0]], adjusted.result.translations[at[0]]
    # A board's z points into the paper, its y down the columns: half a turn about x brings the print up.
    world_from_board = np.diag([1.0, -1.0, -1.0])
    rig = rig.moved(world_from_board @ turned.T, -world_from_board @ turned.T @ placed)
    return replace(rig, vertical=np.array([0.0, 0.0, 1.0]))
