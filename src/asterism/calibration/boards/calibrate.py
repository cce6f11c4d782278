"""Views of a board in; a calibrated rig, what it leaves over and what to doubt, out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from asterism.calibration.boards.checks import (
    BEND_USELESS,
    FOCAL_USELESS,
    LEAST_NOISE_PX,
    OUT_OF_STEP,
    RMS_USELESS_PX,
    bent,
    few_shared,
    lens_doubts,
    other_lenses,
    out_of_step,
    share_covered,
    torn_links,
)
from asterism.calibration.boards.extrinsics import Links, first_boards, first_rig, links_between, numbered_alike
from asterism.calibration.boards.flatness import bend_of
from asterism.calibration.boards.intrinsics import Alone, calibrate_alone
from asterism.calibration.boards.views import BoardViews
from asterism.cameras.bundle import Adjustment, AdjustSettings, Sightings, adjust, free_parameters
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Floats

_LENS = ("focal", "aspect", "centre", "k1", "k2", "k3", "tangential")
_EXPECTED = {"aspect": 0.02, "centre": 0.1, "k1": 0.5, "k2": 1.0, "k3": 2.0, "tangential": 0.02}
"""Standard deviations of lenses before anyone has seen them (the centre's: of the image's width): weak, they hold what no view tells."""
_NOISE_PX = 0.2
_OUTLYING, _OUTLYING_PX, _ROUNDS = 4.0, 1.0, 3


@dataclass(frozen=True)
class BoardCalibration:
    """A rig calibrated from views of a board.

    rig          the cameras that hang together; with one camera its lens alone, without a pose
    views        what it was made from
    alone        per camera of the rig its calibration by itself
    adjustment   of all together
    frames       (T,) places in `views.moments` of the boards that were adjusted
    sightings    those that were adjusted, frame counting `frames`
    left_out     (moment, camera) of views that do not fit
    apart        cameras that are not in the rig, and why, one sentence each
    focal_std    per camera of the rig, px
    doubts       what makes the rig doubtful, one sentence each
    links        which cameras share views, of those that were calibrated alone
    linked       their names
    grave        those of `doubts` for which the rig should not be used: most views that link cameras speak against it, or a known lens is
                 another one
    bend         how far the board's points lie from where they should be, as a share of its longer side; 0 where noise explains it
    """

    rig: Rig
    views: BoardViews
    alone: tuple[Alone, ...]
    adjustment: Adjustment
    frames: Any
    sightings: Sightings
    left_out: tuple[tuple[int, str], ...]
    apart: tuple[str, ...]
    focal_std: tuple[float, ...]
    doubts: tuple[str, ...]
    links: Links
    linked: tuple[str, ...]
    grave: tuple[str, ...]
    bend: float

    @property
    def usable(self) -> bool:
        """Whether the rig may be used: each camera fits within 2 px, knows its focal length to 5 %, is linked, and the board is flat."""
        known = all(std < FOCAL_USELESS * camera.focal[0] for camera, std in zip(self.rig, self.focal_std, strict=True))
        return not self.grave and self.bend < BEND_USELESS and known and all(camera.error < RMS_USELESS_PX for camera in self.rig)

    @property
    def covered(self) -> tuple[float, ...]:
        """Per camera of the rig the share of its image in which points of the board were seen, by cells of an eighth of its sides."""
        return tuple(share_covered(camera, self.sightings.xy[self.sightings.camera == c]) for c, camera in enumerate(self.rig))

    @property
    def rms(self) -> float:
        """px, over all points of all views that were adjusted."""
        return self.adjustment.rms

    def summary(self) -> dict[str, Any]:
        """The calibration as plain values, for JSON and reports."""
        counts = self.views.counts
        names = self.views.cameras
        return {
            "board": str(self.views.board),
            "usable": self.usable,
            "frames": len(self.views.moments),
            "frames_used": len(self.frames),
            "reprojection_rms_px": self.rms,
            "board_bend": self.bend,
            "cameras": [
                {
                    "name": camera.name,
                    "size": list(camera.size or ()),
                    "images": self.views.looked[names.index(camera.name)],
                    "views": int((counts[:, names.index(camera.name)] > 0).sum()),
                    "image_covered": covered,
                    "rms_alone_px": alone.camera.error,
                    "rms_px": camera.error,
                    "focal_px": list(camera.focal),
                    "focal_std_px": std,
                    "centre_px": list(camera.centre),
                    "distortion": camera.distortion.tolist(),
                    "position_m": camera.position.tolist() if camera.posed else None,
                }
                for camera, alone, std, covered in zip(self.rig, self.alone, self.focal_std, self.covered, strict=True)
            ],
            "left_out": [{"frame": moment, "camera": name} for moment, name in self.left_out],
            "not_calibrated": list(self.apart),
            "doubts": list(self.doubts),
            "notes": list(self.views.notes),
        }


def calibrate_board(
    views: BoardViews, *, known: Rig | None = None, origin: int | None = None, progress: Progress | None = None
) -> BoardCalibration:
    """Calibrate all cameras that share views of a board, also where no two see all of it and no pair sees all views.

    Each camera alone by OpenCV; relative poses along the strongest links; then lenses, poses and boards together, by least squares with a
    robust loss; views that fit four times worse than the median, and by more than 1 px, are left out. The board's points are believed.
    Where all together miss the board by a quarter more than each alone does, the cameras were not in step: a doubt says so, and the lenses
    stay those of each camera alone, which such views would spoil. A doubt is also a board that bends; a rig is not usable where it bends
    much, or where a third of the views that link two cameras had to be left out.

    known   cameras whose lenses are known, by name: they are kept, and one view is enough for a pose; their poses are not used
    origin  the moment at which the board lay on the floor, print up: it gives the world its origin, x along the board's rows, z up. Else
            the world is the first camera's axes

    Cameras that saw too little, or share no view with the others, are named in `apart` and not in the rig. Raises AsterismError where no
    camera can be calibrated, a known lens is of another image size, or the origin's moment has no board.
    """
    points = views.board.points
    lenses = _known_lenses(views, known)
    alone, apart = _each_alone(views, lenses, progress)
    order = sorted(alone)
    links = links_between([alone[c].frames for c in order])
    chosen = [order[i] for i in links.groups[0]]
    apart += [
        f"camera {views.cameras[order[i]]} shares no view of the board with {views.cameras[chosen[0]]} and its group; show both the board."
        for group in links.groups[1:]
        for i in group
    ]
    if progress is not None:
        progress(0.85, "adjusting all cameras together")
    middle = 0.5 * (points[0] + points[-1]) if views.board.turns_alike else None
    placed = first_rig({i: alone[c] for i, c in enumerate(order)}, links, middle)
    started = {order[i]: camera for i, camera in placed.items()}
    if middle is not None:
        renumbered, seen = numbered_alike({c: alone[c] for c in chosen}, started, views.seen, len(points) - 1, middle)
        alone, views = {**alone, **renumbered}, replace(views, seen=seen)
    adjusted = _adjusted(views, points, alone, started, chosen, {c: [] if c in lenses else list(_LENS) for c in chosen})
    own_rms = float(np.sqrt(np.mean([alone[c].rms ** 2 for c in chosen])))
    in_step = len(chosen) < 2 or adjusted[0].rms <= OUT_OF_STEP * max(own_rms, LEAST_NOISE_PX)
    if not in_step:
        adjusted = _adjusted(views, points, alone, started, chosen, {c: [] for c in chosen})
    adjustment, sightings, frames, dropped = adjusted
    left_out = [(int(views.moments[t]), views.cameras[c]) for t, c in dropped]
    left_out += [(int(views.moments[t]), views.cameras[c]) for c in chosen for t in alone[c].left_out]
    single = tuple(alone[c] for c in chosen)
    freed = zip(adjustment.free[:, 6], adjustment.sigma[:, 6], single, strict=True)
    focal_std = [one.repeated * float(sigma if free else one.focal_std) for free, sigma, one in freed]
    rig = _in_world(Rig(adjustment.cameras), views, adjustment, frames, origin)
    covered = [share_covered(camera, sightings.xy[sightings.camera == c]) for c, camera in enumerate(rig)]
    kept = links_between([np.unique(sightings.frame[sightings.camera == c]) for c in range(len(chosen))])
    others, odd = other_lenses(views, lenses, alone)
    torn = torn_links(rig, links.shared[np.ix_(links.groups[0], links.groups[0])], kept, views.board)
    bend = bend_of(points, sightings, adjustment)
    doubts = (
        *others,
        *torn,
        *odd,
        *bent(bend, points),
        *([] if in_step else [out_of_step(adjustment.rms, own_rms)]),
        *lens_doubts(rig, single, focal_std, covered),
        *([] if torn else few_shared(rig, kept)),
    )
    lacks = ("the pose of every camera",) if len(rig) == 1 else ("which way is up",) if rig.vertical is None else ()
    metadata = {
        "format": "Asterism rig",
        "calibrated_from": str(views.board),
        "frames": len(frames),
        "reprojection_rms_px": adjustment.rms,
        **({"doubts": list(doubts)} if doubts else {}),
    }
    rig = replace(rig, metadata=metadata, lacks=lacks)
    return BoardCalibration(
        rig,
        views,
        single,
        adjustment,
        frames,
        sightings,
        tuple(sorted(left_out)),
        tuple(apart),
        tuple(focal_std),
        doubts,
        links,
        tuple(views.cameras[c] for c in order),
        (*others, *torn),
        bend,
    )


def _known_lenses(views: BoardViews, known: Rig | None) -> dict[int, Camera]:
    """The cameras of a rig that are among the views, by place. Raises AsterismError where there is none, or image sizes differ."""
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


def _each_alone(views: BoardViews, lenses: dict[int, Camera], progress: Progress | None) -> tuple[dict[int, Alone], list[str]]:
    """Every camera calibrated by itself, by its place; and a sentence for each that cannot be."""
    alone: dict[int, Alone] = {}
    apart: list[str] = []
    for c, name in enumerate(views.cameras):
        if progress is not None:
            progress(0.8 * c / len(views.cameras), f"calibrating camera {name}")
        seen = int((views.counts[:, c] > 0).sum())
        own = views.seen.select(views.seen.camera == c)
        one = calibrate_alone(name, views.sizes[c], views.board.points, own, lenses.get(c)) if seen else None
        if one is not None:
            alone[c] = one
            continue
        apart.append(
            f"camera {name} saw the board in {seen} of {views.looked[c]} images, too few different ones that agree on a lens; show it "
            "the board tilted, near and far."
        )
    if not alone:
        raise AsterismError(f"no camera can be calibrated: {' '.join(apart)}")
    return alone, apart


def _adjusted(
    views: BoardViews, points: Floats, alone: dict[int, Alone], started: dict[int, Camera], chosen: list[int], lens: dict[int, list[str]]
) -> tuple[Adjustment, Sightings, Any, list[tuple[int, int]]]:
    """The bundle adjustment of poses and these parts of each lens, again without the views that do not fit, until all do."""
    place = {c: i for i, c in enumerate(chosen)}
    good = np.zeros((len(views.moments), len(views.cameras)), dtype=bool)
    for c in chosen:
        good[alone[c].frames, c] = True
    cameras = [started[c] for c in chosen]
    dropped: list[tuple[int, int]] = []
    for _ in range(_ROUNDS):
        kept = views.seen.select(good[views.seen.frame, views.seen.camera])
        local = Sightings(kept.frame, np.array([place[c] for c in kept.camera], dtype=np.int64), kept.point, kept.xy)
        compact, frames = local.compact()
        turned, placed = first_boards(alone, {c: cameras[place[c]] for c in chosen}, frames)
        prior = _expected(cameras)
        free = np.concatenate([free_parameters(1, "pose", *lens[c]) for c in chosen])
        result = adjust(
            cameras, points, compact, turned, placed, free=free, prior=prior, settings=AdjustSettings(tolerance=1e-9, steps=100)
        )
        cell = compact.frame * len(cameras) + compact.camera
        square = np.where(np.isfinite(result.residuals[:, 0]), np.square(result.residuals).sum(axis=1), 1e6)
        number = np.bincount(cell, minlength=len(frames) * len(cameras))
        with np.errstate(invalid="ignore", divide="ignore"):
            errors = np.sqrt(np.bincount(cell, square, minlength=len(number)) / number)
        outlying = np.nonzero(errors > max(_OUTLYING * float(np.nanmedian(errors)), _OUTLYING_PX))[0]
        cameras = list(result.cameras)
        if not len(outlying):
            break
        for at in outlying.tolist():
            t, c = int(frames[at // len(cameras)]), chosen[at % len(cameras)]
            still = good.copy()
            still[t, c] = False
            if still[:, c].any():
                good = still
                dropped.append((t, c))
    return result, compact, frames, dropped


def _expected(cameras: list[Camera]) -> tuple[Floats, Floats]:
    """Values and standard deviations (C, 15) before anyone has seen anything, see _EXPECTED; the latter in px of noise."""
    values, spread = np.zeros((len(cameras), 15)), np.full((len(cameras), 15), np.inf)
    for c, camera in enumerate(cameras):
        width, height = camera.size or (1, 1)
        values[c, 7:10] = 1.0, (width - 1) / 2, (height - 1) / 2
        spread[c, 7] = _EXPECTED["aspect"]
        spread[c, 8:10] = _EXPECTED["centre"] * width
        spread[c, 10:13] = _EXPECTED["k1"], _EXPECTED["k2"], _EXPECTED["k3"]
        spread[c, 13:15] = _EXPECTED["tangential"]
    return values, spread / _NOISE_PX


def _in_world(rig: Rig, views: BoardViews, adjustment: Adjustment, frames: Any, origin: int | None) -> Rig:
    """The rig in the axes of its first camera, or of the board at a moment: x along its rows, z up from its print. One has no pose."""
    if len(rig) == 1:
        if origin is not None:
            raise AsterismError(f"camera {rig.names[0]} is alone, a rig of one camera has no world; leave out the origin.")
        return Rig((replace(rig.cameras[0], rotation=np.eye(3), translation=np.zeros(3), posed=False),))
    if origin is None:
        first = rig.cameras[0]
        return rig.moved(first.rotation, first.translation)
    at = np.nonzero(views.moments[frames] == origin)[0]
    if not len(at):
        raise AsterismError(f"no camera saw the board at frame {origin}, which is to be the origin; name one of those where it was seen.")
    turned, placed = adjustment.rotations[at[0]], adjustment.translations[at[0]]
    world_from_board = np.diag([1.0, -1.0, -1.0])
    rig = rig.moved(world_from_board @ turned.T, -world_from_board @ turned.T @ placed)
    return replace(rig, vertical=np.array([0.0, 0.0, 1.0]))
