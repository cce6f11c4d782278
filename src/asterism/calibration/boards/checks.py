"""A calibration from views of a board in; what to know before using it, out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from asterism.calibration.boards.board import Board
from asterism.calibration.boards.extrinsics import CameraLinks
from asterism.calibration.boards.intrinsics import Intrinsics, calibrate_intrinsics
from asterism.calibration.boards.views import BoardViews
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.findings import Finding, Severity
from asterism.recording import Floats, Ints
from asterism.recording.display import significant


@dataclass(frozen=True)
class BoardCheckRules:
    """What to say of a board's calibration; each pair: warn from, refuse from.

    focal           standard deviation of a focal length, as a share of it
    bend            how far the board's points lie from where they should be, as a share of its longer side
    rms             px, a camera's error
    out_of_step     by how much more than alone cameras miss a board together that they did not see in step
    least_noise     px, what counts as the error alone at least
    covered         share of the image in which the board was seen, by cells of 1 / `cells` of its sides
    different_views of a camera, at least
    shared_views    that link two cameras, at least
    turned_views    that link two cameras by a board that looks the same upside down, at least
    agreeing        share of the views of two cameras that must fit both
    certain         standard deviations of a difference that is one
    oblong          of pixels, from square
    lens_per_bend   share by which focal lengths are off, per bend: in simulation, of one camera and of three

    Checked on the simulated boards of tests/test_boards.py and the real ones of benchmarks/cameras/boards.py.
    """

    focal: tuple[float, float] = (0.02, 0.05)
    bend: tuple[float, float] = (0.0007, 0.0025)
    rms: float = 2.0
    out_of_step: float = 1.25
    least_noise: float = 0.1
    cells: int = 8
    covered: float = 0.25
    different_views: int = 8
    shared_views: int = 3
    turned_views: int = 3
    agreeing: float = 2 / 3
    certain: float = 3.0
    oblong: float = 0.005
    lens_per_bend: float = 30.0


RULES = BoardCheckRules()


def _grade(severe: bool | np.bool_) -> Severity:
    return Severity.ERROR if severe else Severity.WARNING


def check_excluded(views: BoardViews, excluded: Sequence[int], calibrated: dict[int, Intrinsics], group: str) -> Iterator[Finding]:
    """Which cameras are not in the rig, and why; group: the name of a camera that is."""
    for c in excluded:
        name = views.cameras[c]
        if c in calibrated:
            yield Finding(
                "board-camera-unlinked",
                Severity.WARNING,
                name,
                f"camera {name} shares no view of the board with {group} and its group.",
                "Show the board to both at once.",
            )
        else:
            seen = int((views.counts[:, c] > 0).sum())
            yield Finding(
                "board-camera-excluded",
                Severity.WARNING,
                name,
                f"camera {name} saw the board in {seen} of {views.images[c]} images, too few different ones that agree on a lens.",
                "Show it the board tilted, near and far.",
            )


def check_known_lenses(views: BoardViews, lenses: dict[int, Camera], calibrated: dict[int, Intrinsics]) -> Iterator[Finding]:
    """Which known lenses are not those of these views, where these are enough to tell."""
    for c in lenses:
        if c not in calibrated or calibrated[c].different < RULES.different_views:
            continue
        name, known = views.cameras[c], calibrated[c]
        # What these views themselves say of the lens is the only witness that the old lens has.
        free = calibrate_intrinsics(name, views.sizes[c], views.board.points, views.seen.select(views.seen.camera == c))
        if free is None:
            continue
        was, now, spread = known.camera.focal[0], free.camera.focal[0], free.repeated * free.focal_std
        # Only what goes beyond the uncertainty of the new one speaks against the old one.
        difference = abs(now - was) - RULES.certain * spread
        if difference > RULES.focal[0] * was or known.rms > RULES.out_of_step * max(free.rms, RULES.least_noise):
            yield Finding(
                "board-known-lens",
                _grade(difference > RULES.focal[1] * was),
                name,
                f"the known lens of camera {name} misses the board by {known.rms:.2f} px, one made from these views by {free.rms:.2f} px "
                f"(focal length {was:.0f}, and {now:.0f} ± {spread:.0f} px).",
                "Check whether its zoom, focus or image size was changed. If so, leave out the known lens.",
            )


def in_step(together: float, single: float) -> bool:
    """Whether cameras together miss the board by hardly more than each alone, px."""
    return together <= RULES.out_of_step * max(single, RULES.least_noise)


def check_in_step(together: float, single: float) -> Iterator[Finding]:
    """Where cameras together miss the board by more than each alone, px."""
    if not in_step(together, single):
        yield Finding(
            "board-out-of-step",
            Severity.WARNING,
            "",
            f"cameras disagree about the board by {together:.2f} px where each alone fits to {single:.2f} px, so their lenses were taken "
            "from each alone; they were probably not in step.",
            "Hold the board still for each view, and film again.",
        )


def check_links(rig: Rig, shared: Ints, kept: CameraLinks, board: Board) -> Iterator[Finding]:
    """Why cameras cannot be trusted to stand to each other as the rig has it: most of the views that they share contradict it.

    shared  (C, C) views that two cameras share; kept: the links by those that were not left out
    """
    first = rig.names[kept.groups[0][0]]
    for group in kept.groups[1:]:
        others = ", ".join(rig.names[c] for c in group)
        yield Finding(
            "board-link-inconsistent",
            Severity.ERROR,
            others,
            f"no view that {others} shares with {first} fits both.",
            "Check that they were in step, and film again.",
        )
    for start, end in kept.tree:
        names, together, fit = f"cameras {rig.names[start]} and {rig.names[end]}", int(shared[start, end]), int(kept.shared[start, end])
        where = f"{rig.names[start]}, {rig.names[end]}"
        # The views that were kept agree by construction; it is those that had to go that tell of a wrong link.
        if fit < RULES.agreeing * together:
            yield Finding(
                "board-link-inconsistent",
                Severity.ERROR,
                where,
                f"{names} share {together} views of the board and only {fit} of them fit both.",
                "Check that they were in step, that it is one board, and that it has as many squares as you say; film again.",
            )
        elif fit < RULES.turned_views and board.turns_alike:
            yield Finding(
                "board-link-ambiguous",
                Severity.ERROR,
                where,
                f"{names} share {fit} {'view' if fit == 1 else 'views'} of a board that looks the same upside down, too few to tell how.",
                "Show both more views, or use a board with an odd and an even side.",
            )


def check_few_shared(rig: Rig, kept: CameraLinks) -> Iterator[Finding]:
    """Which cameras are linked by few views."""
    for start, end in kept.tree:
        if kept.shared[start, end] < RULES.shared_views:
            yield Finding(
                "board-few-shared-views",
                Severity.WARNING,
                f"{rig.names[start]}, {rig.names[end]}",
                f"cameras {rig.names[start]} and {rig.names[end]} hang together by {kept.shared[start, end]} views only.",
                "Show both more views.",
            )


def check_flat(bend: float, points: Floats) -> Iterator[Finding]:
    """A board (K, 3) m whose points are off by this share of its longer side."""
    if bend >= RULES.bend[0]:
        off = 1000.0 * bend * float(np.ptp(points, axis=0).max())
        yield Finding(
            "board-not-flat",
            _grade(not bend < RULES.bend[1]),
            "",
            f"the board is not flat, or its squares are not alike: its points lie {significant(off, 2)} mm off, "
            f"which can make focal lengths wrong by {100 * RULES.lens_per_bend * bend:.0f} %.",
            "Glue it on glass and film again.",
        )


def share_covered(camera: Camera, xy: Floats) -> float:
    """The share of an image's cells with one of these points (n, 2) px."""
    cells = np.clip((xy / np.array(camera.size or (1, 1)) * RULES.cells).astype(np.int64), 0, RULES.cells - 1)
    return len(np.unique(cells[:, 0] * RULES.cells + cells[:, 1])) / RULES.cells**2


def check_lenses(rig: Rig, intrinsics: Sequence[Intrinsics], focal_std: Sequence[float], covered: Sequence[float]) -> Iterator[Finding]:
    """What makes the lenses of this rig uncertain."""
    for camera, one, std, share_seen in zip(rig, intrinsics, focal_std, covered, strict=True):
        name = camera.name
        # A known lens has no standard deviation, and needs no coverage.
        if std > 0 and share_seen < RULES.covered:
            yield Finding(
                "board-image-uncovered",
                Severity.WARNING,
                name,
                f"camera {name} saw the board in {100 * share_seen:.0f} % of its image only; elsewhere its lens is a guess.",
                "Show it the board up to the corners.",
            )
        share = std / camera.focal[0]
        if not share < RULES.focal[0]:
            yield Finding(
                "board-focal-uncertain",
                _grade(not std < RULES.focal[1] * camera.focal[0]),
                name,
                f"the focal length of camera {name} is only known to {100 * share:.1f} %.",
                "Show it the board tilted, near and far.",
            )
        # Sensors have square pixels; a board printed 1 % longer along one side looks like pixels that are not.
        oblong = abs(camera.focal[1] / camera.focal[0] - 1.0)
        if 0 < RULES.certain * share < oblong and oblong > RULES.oblong:
            yield Finding(
                "board-pixels-not-square",
                Severity.WARNING,
                name,
                f"camera {name} has pixels {100 * oblong:.1f} % from square by this board, as few cameras do.",
                "Measure whether the board is printed to scale along both sides.",
            )
        if std > 0 and one.different < RULES.different_views:
            yield Finding(
                "board-few-views",
                Severity.WARNING,
                name,
                f"camera {name} has only {one.different} different views of the board.",
                "Show it more.",
            )
        if not camera.error < RULES.rms:
            yield Finding(
                "board-large-error",
                Severity.ERROR,
                name,
                f"camera {name} misses the board by {camera.error:.1f} px.",
                "Check that the board is flat, its size right, and the video in step.",
            )
