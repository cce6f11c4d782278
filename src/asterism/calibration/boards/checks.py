"""A calibration from views of a board in; what makes it doubtful, one sentence each, out."""

from __future__ import annotations

import numpy as np

from asterism.calibration.boards.board import Board
from asterism.calibration.boards.extrinsics import Links
from asterism.calibration.boards.intrinsics import Alone, calibrate_alone
from asterism.calibration.boards.views import BoardViews
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.recording import Floats, Ints

FOCAL_USELESS, BEND_USELESS, RMS_USELESS_PX = 0.05, 0.0025, 2.0
"""Of a focal length, of the board's longer side, and px: from there on a calibration should not be used."""
OUT_OF_STEP, LEAST_NOISE_PX = 1.25, 0.1
"""By how much more than alone cameras miss a board together that they did not see in step; and what counts as alone at least."""
_CELLS, _LITTLE_COVERED = 8, 0.25
_FOCAL_DOUBT, _BEND_DOUBT = 0.02, 0.0007
_FEW_VIEWS, _FEW_SHARED, _LEAST_TURNED = 8, 3, 3
_MOST, _SURE, _OBLONG = 2 / 3, 3.0, 0.005
_LENS_PER_BEND = 30.0
"""By which share focal lengths are off, for a bend: in simulation, of one camera and of three."""


def other_lenses(views: BoardViews, lenses: dict[int, Camera], alone: dict[int, Alone]) -> tuple[list[str], list[str]]:
    """Which known lenses are not those of these views, where these are enough to tell: gravely (5 % of the focal length), and less."""
    grave: list[str] = []
    less: list[str] = []
    for c in lenses:
        if c not in alone or alone[c].different < _FEW_VIEWS:
            continue
        known, own = alone[c], views.seen.select(views.seen.camera == c)
        free = calibrate_alone(views.cameras[c], views.sizes[c], views.board.points, own)
        if free is None:
            continue
        was, now, spread = known.camera.focal[0], free.camera.focal[0], free.repeated * free.focal_std
        apart = abs(now - was) - _SURE * spread
        if apart > _FOCAL_DOUBT * was or known.rms > OUT_OF_STEP * max(free.rms, LEAST_NOISE_PX):
            (grave if apart > FOCAL_USELESS * was else less).append(
                f"the known lens of camera {views.cameras[c]} misses the board by {known.rms:.2f} px, one made from these views by "
                f"{free.rms:.2f} px (focal length {was:.0f}, and {now:.0f} ± {spread:.0f} px): was its zoom, focus or image size changed? "
                "Leave out the known lens."
            )
    return grave, less


def out_of_step(together: float, alone: float) -> str:
    """What to say where cameras together miss the board by so much more than each alone, px."""
    return (
        f"cameras disagree about the board by {together:.2f} px where each alone fits to {alone:.2f} px, so their lenses were taken from "
        "each alone; were they in step? Hold the board still for each view, and film again."
    )


def torn_links(rig: Rig, shared: Ints, kept: Links, board: Board) -> tuple[str, ...]:
    """Why cameras cannot be believed to stand to each other as the rig has it: most of the views that they share say otherwise.

    shared  (C, C) views that two cameras share; kept: the links by those that were not left out
    """
    found = []
    for group in kept.groups[1:]:
        others = ", ".join(rig.names[c] for c in group)
        found.append(f"no view that {others} shares with {rig.names[kept.groups[0][0]]} fits both; were they in step? Film again.")
    for start, end in kept.tree:
        names, together, fit = f"cameras {rig.names[start]} and {rig.names[end]}", int(shared[start, end]), int(kept.shared[start, end])
        if fit < _MOST * together:
            found.append(
                f"{names} share {together} views of the board and only {fit} of them fit both: were they in step, is it one board, and "
                "has it as many squares as you say? Film again."
            )
        elif fit < _LEAST_TURNED and board.turns_alike:
            found.append(
                f"{names} share {fit} {'view' if fit == 1 else 'views'} of a board that looks the same upside down, too few to tell how; "
                "show both more, or use one with an odd and an even side."
            )
    return tuple(found)


def bent(bend: float, points: Floats) -> list[str]:
    """What to say of a board (K, 3) m whose points are off by this share of its longer side."""
    if bend < _BEND_DOUBT:
        return []
    off = 1000.0 * bend * float(np.ptp(points, axis=0).max())
    return [
        f"the board is not flat, or its squares are not alike: its points lie {off:.2g} mm off, which can make focal lengths "
        f"wrong by {100 * _LENS_PER_BEND * bend:.0f} %; glue it on glass and film again."
    ]


def few_shared(rig: Rig, kept: Links) -> list[str]:
    """Which cameras hang together by few views."""
    return [
        f"cameras {rig.names[start]} and {rig.names[end]} hang together by {kept.shared[start, end]} views only; show both more."
        for start, end in kept.tree
        if kept.shared[start, end] < _FEW_SHARED
    ]


def share_covered(camera: Camera, xy: Floats) -> float:
    """The share of an image's cells with one of these points (n, 2) px."""
    cells = np.clip((xy / np.array(camera.size or (1, 1)) * _CELLS).astype(np.int64), 0, _CELLS - 1)
    return len(np.unique(cells[:, 0] * _CELLS + cells[:, 1])) / _CELLS**2


def lens_doubts(rig: Rig, alone: tuple[Alone, ...], focal_std: list[float], covered: list[float]) -> list[str]:
    """What makes the lenses of this rig doubtful."""
    found = []
    for camera, one, std, share_seen in zip(rig, alone, focal_std, covered, strict=True):
        if std > 0 and share_seen < _LITTLE_COVERED:
            found.append(
                f"camera {camera.name} saw the board in {100 * share_seen:.0f} % of its image only, elsewhere its lens is a guess; show it "
                "up to the corners."
            )
        share = std / camera.focal[0]
        if not share < _FOCAL_DOUBT:
            found.append(
                f"the focal length of camera {camera.name} is only known to {100 * share:.1f} %; show it the board tilted, near and far."
            )
        oblong = abs(camera.focal[1] / camera.focal[0] - 1.0)
        if 0 < _SURE * share < oblong and oblong > _OBLONG:
            found.append(
                f"camera {camera.name} has pixels {100 * oblong:.1f} % from square by this board, as few cameras do: is the board printed "
                "to scale along both sides? Measure it."
            )
        if std > 0 and one.different < _FEW_VIEWS:
            found.append(f"camera {camera.name} has only {one.different} different views of the board; show it more.")
        if not camera.error < RMS_USELESS_PX:
            found.append(
                f"camera {camera.name} misses the board by {camera.error:.1f} px; is the board flat, its size right, the video in step?"
            )
    return found
