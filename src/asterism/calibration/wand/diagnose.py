"""A recording that could not be used in; the reason in words out: what the images show instead, or why a camera has no pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.recording import WandRecording
from asterism.calibration.wand.two_view import RULES as TWO_VIEW
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Blobs, Ints


@dataclass(frozen=True)
class DiagnosisRules:
    """When images show something else than the wand that was given.

    least_showing  share of the images with enough blobs that must show a wand of one, two, three markers
    perspective    by how much the share at which images show the inner marker may differ from the wand's, all directions together
    least_triples  images with just three blobs in line that it takes to say where the inner one sits
    in_line        the two shorter distances of three blobs in line sum up to less than this times the longest

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    least_showing: tuple[float, float, float] = (0.1, 0.1, 0.05)
    perspective: float = 0.045
    least_triples: int = 20
    in_line: float = 1.01


RULES = DiagnosisRules()


def check_detections(recording: WandRecording, static_lights: Ints) -> None:
    """Raise AsterismError where hardly an image shows the wand, saying what the images show instead.

    static_lights  (C,) how many lights of each camera never moved
    """
    blobs, wand = recording.blobs, recording.wand
    images = int(recording.shows_wand.sum())
    enough = int((np.asarray(blobs.counts) >= len(wand)).sum())
    if images >= max(2 * TWO_VIEW.least_frames, RULES.least_showing[len(wand) - 1] * enough):
        return
    # What stood still was left out before; if hardly anything remains, this is the wrong recording rather than a wrong wand.
    if static_lights.sum() >= len(wand) and enough < 2 * TWO_VIEW.least_frames:
        raise AsterismError("nearly all that the cameras see never moves; give the recording in which the wand was waved.")
    reason = diagnose_detection(blobs, wand) or ": is it the right recording, and has the wand that many markers?"
    shown = f"the {len(wand)} markers of the wand" if len(wand) > 1 else "the one marker alone"
    raise AsterismError(f"only {images} images show {shown}{reason}")


def diagnose_detection(blobs: Blobs, wand: Wand) -> str:
    """The end of a sentence: what most images show, where that is not the wand as it was given; else empty."""
    share, given = inner_marker_shares(blobs, wand)
    # The inner marker is asked about first: wrong lengths are the commonest mistake, and explain wrong counts as well.
    if abs(share - given) > RULES.perspective:
        return (
            f"; in most, the inner of three markers sits at {share:.2f} of the length, by the wand's lengths it should at {given:.2f}: "
            "are the lengths right?"
        )
    counts = np.asarray(blobs.counts)
    usual = int(np.bincount(counts[counts > 0]).argmax()) if (counts > 0).any() else 0
    if usual == len(wand):
        return ""
    many = usual > len(wand)
    mend = "wave it alone, without other markers and lights, or give all of its lengths" if many else "has the wand that many?"
    return f"; most show {usual} blob{'s' if usual != 1 else ''}: {mend}"


def inner_marker_shares(blobs: Blobs, wand: Wand) -> tuple[float, float]:
    """Where the inner one of three blobs in line usually sits, as a share of the length from the nearer end, and where the wand has it.

    NaN where few images show just three blobs in line, or the wand does not have three markers.
    """
    three = np.nonzero(np.diff(blobs.offsets) == 3)[0]
    if len(wand) < 3 or len(three) < RULES.least_triples:
        return float("nan"), float("nan")
    given = float(min(wand.lengths[1], wand.lengths[2] - wand.lengths[1]) / wand.lengths[2])
    triples = blobs.xy[blobs.offsets[three, None] + np.arange(3)]
    distance = np.linalg.norm(triples[:, [0, 1, 2]] - triples[:, [1, 2, 0]], axis=2)
    order = np.sort(distance, axis=1)
    in_line = order[:, 0] + order[:, 1] < RULES.in_line * order[:, 2]
    enough = in_line.sum() >= RULES.least_triples
    return (float(np.median(order[in_line, 0] / order[in_line, 2])) if enough else float("nan")), given


def diagnose_no_start(recording: WandRecording) -> str:
    """In a sentence, why no two cameras could be posed."""
    blobs, shared = recording.blobs, recording.shared_frames
    np.fill_diagonal(shared, 0)
    if shared.max(initial=0) < TWO_VIEW.least_frames:
        reason = diagnose_detection(blobs, recording.wand)
        if reason:
            return f"no two cameras show the wand for certain in {TWO_VIEW.least_frames} frames{reason}"
        a, b = np.unravel_index(int(np.argmax(shared)), shared.shape)
        return (
            f"no two cameras show the wand together in {TWO_VIEW.least_frames} frames (at most {int(shared.max())}, {blobs.cameras[a]} and "
            f"{blobs.cameras[b]}); wave it where cameras overlap, and check that they ran at the same time."
        )
    return "the cameras' images of the wand contradict each other; were they recorded together, with these image sizes and this wand?"


def diagnose_camera(recording: WandRecording, cameras: Sequence[Camera | None], camera: int) -> tuple[str, str]:
    """Why a camera could not be posed, and what to do about it."""
    whole = recording.shows_wand
    own = whole[:, camera]
    posed = [c for c, other in enumerate(cameras) if other is not None]
    needed = 2 if len(recording.wand) == 1 else 1
    with_others = int((own & (whole[:, posed].sum(axis=1) >= needed)).sum())
    if not recording.blobs.counts[:, camera].any():
        return "it saw nothing", "Check that it is switched on, and that its lens cap is off."
    if own.sum() < TWO_VIEW.least_frames:
        return (
            f"it shows the wand in {int(own.sum()) or 'no'} frame{'' if own.sum() < 2 else 's'}",
            "Wave the wand before this camera, too.",
        )
    if with_others < TWO_VIEW.least_frames:
        others = "a camera" if needed == 1 else "two cameras"
        return f"it shares only {with_others} frames with {others} of the rig", "Wave the wand where their views overlap."
    if recording.lenses[camera] is not None:
        return (
            "its images contradict those of the others",
            "Check that its lens is that of the rig given, and that it was in step, not mirrored, and not moved.",
        )
    return (
        "its images contradict those of the others",
        "Check whether it is mirrored, out of step by seconds, or was moved while recording.",
    )
