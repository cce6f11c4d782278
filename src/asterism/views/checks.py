"""A labelling of blobs in; what speaks against it, and which cameras do not fit the others, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import Floats, Ints, canonical
from asterism.skeleton.body import ArticulatedBody
from asterism.views.result import ViewsLabelling
from asterism.views.rig_fit import CameraAgreement
from asterism.views.rules import RULES

_MANY_LOST = 0.05
"""Share of the frames without the body from which a person is told."""
_NOT_WORN = 0.3
"""A marker with fewer of its expected blobs than this is probably not worn."""
_OTHER_BODY = 0.25
"""Share of the body's markers that are hardly seen from which the body is another."""
_MANY_LEFT = 0.5
"""Blobs without a label per blob with one, from which a person is told. Two strays in an image of ten markers are 0.2."""
_MISFIT = 3.75
"""The median distance of a camera's blobs from where the other cameras have their markers, as a multiple of the recording's noise, above
which it does not fit them: 3 px at the usual noise. By noise alone the median is 1.2 to 1.7, by how many cameras there are."""
_INEXACT = 1.9
"""Noise, as a multiple of the usual one, from which a person is told: twice, but for rounding. Below, labels are as right as ever."""
_LOSES = 0.85
"""Share of what is usual below which a camera loses so many blobs that a person is told. At 0.9 labels are as right as ever, before two
cameras at 0.75 five of a hundred are lost; chance of some hundred sightings is 0.03."""
_HARDLY_SEEN = 0.4
"""A camera that shows fewer of the sightings that the body lets expect does not fit either."""
_JUDGED_FRAMES = 60


def refuse_mirrored(body: ArticulatedBody) -> None:
    """Raise AsterismError where most left markers of a body are right of their partners: x is ahead, y left, z up."""
    places = {canonical(marker.name): marker.place[1] for marker in body.markers}
    # One exchanged pair may be a slip of one name; most of them are a mirrored body.
    pairs = body.marker_set.pairs
    wrong = sum(places[canonical(left)] < places[canonical(right)] for left, right in pairs)
    if len(pairs) >= 2 and 2 * wrong > len(pairs):
        raise AsterismError(
            f"body {body.title}: {wrong} of {len(pairs)} left markers are on its right side; it is mirrored, or its names are exchanged. "
            "Make it anew with `asterism body fit`, from a recording with x, y and z right-handed."
        )


def is_other_body(result: ViewsLabelling) -> bool:
    """Whether so many of the body's markers are hardly seen where the cameras should show them that others are worn."""
    return len(_absent(result, result.candidates)) > _OTHER_BODY * len(result.body.markers)


def _absent(result: ViewsLabelling, labels: Ints) -> list[str]:
    """Markers with fewer blobs, by labels (P,), than `_NOT_WORN` of those that the cameras should show."""
    there = np.isfinite(result.poses[:, 0])
    # An image without blobs shows that its camera was off, not that a marker is not worn.
    expected = (result.expected * (result.blobs.counts > 0)[:, :, None])[there].sum(axis=(0, 1))
    seen = np.bincount(labels[labels >= 0], minlength=len(expected))
    # Ten sightings that should be there and are not: fewer could be chance.
    return [name for name, wanted, got in zip(result.body.labels, expected, seen, strict=True) if wanted > 10 and got < _NOT_WORN * wanted]


def _others(names: Sequence[str], c: int) -> str:
    """The other cameras, in words."""
    return f"camera {names[1 - c]}" if len(names) == 2 else "the others"


def is_contradicted(result: ViewsLabelling, left_out: Ints) -> bool:
    """Whether as many cameras show a body elsewhere as show the labelled one: then nobody knows which of them the rig is wrong about."""
    there, counts = np.isfinite(result.poses[:, 0]), result.blobs.counts
    expected, shown = result.expected[there].sum(axis=(0, 2)), counts[there].sum(axis=0)
    # A camera with hardly a blob contradicts nobody: it looks elsewhere, or its lights were off.
    against = (shown[left_out] >= RULES.least_shown * expected[left_out]).sum()
    return bool(against > 0 and 2 * against >= (counts.sum(axis=0) > 0).sum() - (len(left_out) - against))


def misfits(result: ViewsLabelling, fit: CameraAgreement) -> Ints:
    """The cameras whose blobs are not where the other cameras have their markers, worst first; judged by up to 60 frames.

    fit: the noise that is usual in the recording, and the cameras that were left out before. Where two cameras alone have blobs
    nothing is known. O(frames C M).
    """
    blobs, rig = result.blobs, result.rig
    frames = np.nonzero(np.isfinite(result.poses[:, 0]))[0]
    # Frames over the whole recording, so that a camera that was moved half-way shows, too.
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _JUDGED_FRAMES)).round().astype(np.int64))]
    count, markers = len(rig), len(result.body.markers)
    xy = np.full((len(frames), count, markers, 2), np.nan)
    row_of = np.full(len(blobs), -1, dtype=np.int64)
    row_of[frames] = np.arange(len(frames))
    row = row_of[blobs.frame_of]
    # Also labels that are not sure enough to be given: cameras that contradict each other are what makes them so.
    named = (result.candidates >= 0) & (row >= 0)
    xy[row[named], blobs.camera_of[named], result.candidates[named]] = blobs.xy[named]
    rays = np.stack([camera.rays(xy[:, c]) for c, camera in enumerate(rig)], axis=1)
    eyes = np.stack([camera.position for camera in rig])
    # No image can show more markers than it has blobs.
    expected = np.minimum(result.expected[frames].sum(axis=2), blobs.counts[frames]).sum(axis=0)
    there = np.bincount(blobs.camera_of[named], minlength=count)
    used = [c for c in range(count) if c not in fit.left_out]
    # A camera may look past the body altogether: it has blobs, but not those that the body lets expect.
    out = [c for c in used if expected[c] > 20 and there[c] < _HARDLY_SEEN * expected[c]]
    # The worst one is taken out first and the others judged again without it, because it pulls their points with it.
    while len(used) - len(out) > 2:
        off = _medians(result, xy, rays, eyes, [c for c in used if c not in out])
        worst = int(np.nanargmax(off)) if np.isfinite(off).any() else -1
        if worst < 0 or off[worst] <= _MISFIT * fit.noise:
            break
        out.append(worst)
    return np.array(out, dtype=np.int64)


def _medians(result: ViewsLabelling, xy: Floats, rays: Floats, eyes: Floats, used: list[int]) -> Floats:
    """(C,) px: the median distance of each camera's blobs from the points of two or more of the other cameras."""
    off = np.full(len(result.rig), np.nan)
    for c in used:
        others = [o for o in used if o != c]
        # The point nearest to the rays of the other cameras: the sum over rays of the projector across the ray, solved.
        along = rays[:, others]
        shown = np.isfinite(along[..., 0])
        across = np.where(shown[..., None, None], np.eye(3) - along[..., :, None] * along[..., None, :], 0.0)
        total, right = across.sum(axis=1), np.einsum("tomij,oj->tmi", across, eyes[others])
        enough = (shown.sum(axis=1) >= 2) & np.isfinite(xy[:, c, :, 0])
        # A median of fewer distances says little about a camera.
        if enough.sum() < 20:
            continue
        points = np.linalg.solve(total[enough], right[enough][..., None])[..., 0]
        off[c] = float(np.nanmedian(np.linalg.norm(result.rig.cameras[c].project(points) - xy[:, c][enough], axis=1)))
    return off


def failed_frames(why: Mapping[int, str], first_frame: int) -> list[Finding]:
    """The finding on frames whose labelling failed, with the reason of the first; empty where there are none."""
    if not why:
        return []
    few = [str(t + first_frame) for t in sorted(why)]
    which = f"frame {few[0]}" if len(few) == 1 else f"{len(few)} frames ({', '.join(few[:8])}{', ...' if len(few) > 8 else ''})"
    sentence = f"{which} could not be labelled ({why[min(why)].rstrip('.')})."
    mend = "Look at the blobs there; please report the fault with the file."
    return [Finding("views-frame-failed", Severity.WARNING, which, sentence, mend)]


def findings(result: ViewsLabelling, fit: CameraAgreement, late: Floats) -> list[Finding]:
    """What a person should know before using the labels; fit: how the cameras agree; late (C,) frames, see `late_by`."""
    blobs, body = result.blobs, result.body
    counts = blobs.counts
    there = np.isfinite(result.poses[:, 0])
    worth_a_try = counts.sum(axis=1) > 0
    # Frames in which no camera has a blob cannot show the body, and are not held against it.
    found = list[Finding]()
    for c in np.nonzero(counts.sum(axis=0) == 0)[0]:
        name = blobs.cameras[c]
        sentence = f"camera {name} has no blob in the whole recording."
        found.append(
            Finding("views-empty-camera", Severity.WARNING, name, sentence, "Check that it recorded, and that its blobs are in the file.")
        )
    for k in np.nonzero(np.abs(np.nan_to_num(late)) > 0)[0].tolist():
        name, frames = blobs.cameras[k], abs(float(late[k]))
        way = "late" if late[k] > 0 else "early"
        whole = "; its blobs count in the frames that they show" if result.late[k] else ""
        sentence = f"camera {name} is about {frames:.1f} frames {way} against {_others(blobs.cameras, k)}{whole}."
        mend = "Check how the cameras are triggered, or renumber the frames of this camera in the file; then label again."
        found.append(Finding("views-camera-late", Severity.WARNING, name, sentence, mend))
    losing = [c for c in np.nonzero(result.detected < _LOSES)[0].tolist() if c not in fit.left_out]
    if losing:
        some = ", ".join(f"{blobs.cameras[c]} {100 * (1.0 - result.detected[c]):.0f} %" for c in losing)
        sentence = f"cameras lose blobs of markers in their view for single frames: {some}; labels are less certain for it."
        mend = "Lower the threshold of detection, or give more light or a longer exposure."
        found.append(Finding("views-blobs-missing", Severity.WARNING, ", ".join(blobs.cameras[c] for c in losing), sentence, mend))
    if len(fit.turned):
        off = np.degrees(np.linalg.norm(fit.turned, axis=1))
        some = ", ".join(f"{name} by {angle:.1f}" for name, angle in zip(blobs.cameras, off, strict=True))
        sentence = f"the cameras contradict each other unless they are turned against the rig: {some} degrees; they were labelled so."
        mend = "Give the rig of this recording, or refine it (`asterism calibrate refine`): places are not more exact than it is."
        found.append(Finding("views-rig-inexact", Severity.WARNING, "", sentence, mend))
    if fit.noise >= _INEXACT * RULES.noise:
        names = [name for c, name in enumerate(blobs.cameras) if counts[:, c].sum() and c not in fit.left_out]
        who = " and ".join(names) if len(names) == 2 else "the cameras"
        sentence = (
            f"{who} contradict each other: blobs are off by {fit.noise:.1f} px from where the others have their markers, "
            f"instead of {RULES.noise:g} px; labels are less certain for it."
        )
        mend = "Give the rig of this recording; find moved cameras with `asterism calibrate refine`."
        found.append(Finding("views-rig-inexact", Severity.WARNING, "", sentence, mend))
    if len(fit.mirrored):
        which = ", ".join(blobs.cameras[c] for c in fit.mirrored)
        got = "no label was given" if len(np.setdiff1d(fit.mirrored, fit.left_out)) else "they got no labels"
        sentence = f"the images of {which} are mirrored: with left and right exchanged they show the body as the rig lets expect; {got}."
        mend = "Save them unmirrored, or count x from the other side, and label again."
        found.append(Finding("views-images-mirrored", Severity.ERROR, which, sentence, mend))
    for c in np.setdiff1d(fit.left_out, fit.mirrored).tolist():
        name = blobs.cameras[c]
        sentence = f"camera {name} does not fit the others: its blobs are not where they have the markers; it got no labels."
        mend = "Give the rig of this recording; find moved cameras with `asterism calibrate refine`."
        found.append(Finding("views-camera-misfit", Severity.ERROR, name, sentence, mend))
    if not there.any():
        sentence = f"the blobs do not show the body {body.title} through these cameras; no label was given."
        mend = "Check that the rig is of this recording, that the body has the markers that were worn, and that two cameras see the person."
        return [*found, Finding("views-no-body", Severity.ERROR, "", sentence, mend)]
    lost = worth_a_try & ~there
    if lost.mean() > _MANY_LOST:
        sentence = f"the body {body.title} was not found in {lost.sum()} of {len(lost)} frames; they have no labels."
        mend = "Look whether the person was out of the cameras' view in them; if not, check the rig and the body."
        found.append(Finding("views-lost", Severity.WARNING, "", sentence, mend))
    given = result.labels >= 0
    absent = _absent(result, result.candidates)
    doubtful = [name for name in _absent(result, result.labels) if name not in absent]
    if doubtful:
        sentence = f"the cameras show {', '.join(doubtful)}, but which blob is which could not be told in most frames; few have a label."
        mend = "Give a body of this person (`asterism body fit` on a standing trial), or lower --least-confidence and look at them."
        found.append(Finding("views-markers-in-doubt", Severity.WARNING, ", ".join(doubtful), sentence, mend))
    if absent:
        sentence = f"the cameras should show {', '.join(absent)}, and hardly do."
        mend = "If they are not worn, give a body without them (`asterism body fit --markers`)."
        # Blobs of frames without the body are told as lost frames, and not a second time as unlabelled.
        found.append(Finding("views-markers-absent", Severity.WARNING, ", ".join(absent), sentence, mend))
    left = float((~given[there[blobs.frame_of]]).sum()) / max(float(given.sum()), 1.0)
    if left > _MANY_LEFT:
        sentence = f"for every 100 blobs that got a label, {100 * left:.0f} got none."
        mend = "Cover reflections; if more markers are worn than the body has, give a body with them."
        found.append(Finding("views-many-unlabelled", Severity.WARNING, "", sentence, mend))
    return found
