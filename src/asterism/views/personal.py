"""A body model and some frames of a person's blobs in; the person's own body out: sizes, and where the markers really sit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints
from asterism.skeleton.body import ArticulatedBody, as_point
from asterism.skeleton.body_fit import PosedFrames, rest_places
from asterism.skeleton.pose_kernels import PLACE
from asterism.views.frame import BlobLabels, FrameLabeller
from asterism.views.scene import cameras_with_blobs


@dataclass(frozen=True)
class PersonalRules:
    """How a person's own body is learned from the blobs. Chosen on simulated walks, on none of the recordings.

    frames        frames that are labelled for it, evenly spread
    least_frames  frames with a marker in two cameras that are needed to move it; twice as many frames with the body are needed in all
    least_found   a marker with fewer of its expected blobs is thought to sit elsewhere, and sought within
    astray        m of its place
    least_spread  m, of a marker's place on its own person, beside what is seen of it
    quality       nats per sighting, of frames that count
    """

    frames: int = 24
    least_frames: int = 4
    least_found: float = 0.85
    astray: float = 0.04
    least_spread: float = 0.005
    quality: float = 3.0


PERSONAL = PersonalRules()


def personal_body(
    labeller: FrameLabeller, rules: PersonalRules = PERSONAL, *, known: Mapping[int, BlobLabels] | None = None
) -> ArticulatedBody:
    """The body of the person whose blobs these are: the model where nothing is learned. O(frames) labellings.

    Places of the markers that two cameras show are medians over frames, in the axes of their bones. A marker that is hardly found where the
    model has it is sought in a wider surrounding first: wands and clusters sit elsewhere on other people. The person's body is taken only
    if what every second frame gives explains the other frames better than the model does, both ways round.

    known: frames that were labelled without a start before, as this labeller would.
    """
    general = labeller.body
    frames = spread_frames(labeller, rules.frames)
    found = _labelled(labeller, frames, known or {})
    good = [t for t, each in found.items() if quality_of(labeller, each) >= rules.quality]
    # Learned from few frames, a body would be that of the blobs' noise.
    if len(good) < 2 * rules.least_frames:
        return general
    astray = _astray(labeller, found, good, rules)
    if astray.any():
        body = labeller.body
        wider = tuple(
            replace(marker, spread=max(marker.spread, rules.astray)) if away else marker
            for marker, away in zip(body.markers, astray, strict=True)
        )
        labeller = replace(labeller, body=replace(body, markers=wider))
        # With room for the astray markers the labels are found again, so that their true blobs can take part.
        found = {t: labeller.turned(t, labeller.again(t, found[t])) for t in good}
    # Cross-validation both ways: what half of the frames teaches has to explain the other half better.
    for learned, unused in ((good[::2], good[1::2]), (good[1::2], good[::2])):
        if not _is_better(labeller, _learned(labeller, found, learned, rules), [found[t] for t in unused], unused):
            return general
    return _learned(labeller, found, good, rules)


def _learned(labeller: FrameLabeller, found: dict[int, BlobLabels], frames: list[int], rules: PersonalRules) -> ArticulatedBody:
    return _with_own_places(labeller.body, [found[t] for t in frames], [_views(labeller, found[t]) for t in frames], rules)


def _is_better(labeller: FrameLabeller, own: ArticulatedBody, found: list[BlobLabels], frames: list[int]) -> bool:
    """Whether a person's body explains frames that were not used for it better than the model does."""
    personal = replace(labeller, body=own, size=None)
    gain = 0.0
    for t, each in zip(frames, found, strict=True):
        pose = each.pose.copy()
        # The person's own body has the person's size, so its scales start at 1.
        pose[:PLACE] = 1.0
        gain += personal.from_start(t, pose, each.rotation).gain - each.gain
    return gain > 0.0


def quality_of(labeller: FrameLabeller, found: BlobLabels) -> float:
    """nats of gain per blob that the body lets expect; 0 where fewer of them have a label than `ViewsRules.least_shown`."""
    expected = max(labeller.expected_blobs(found), 1.0)
    shown = int((found.labels >= 0).sum())
    return found.gain / expected if shown >= labeller.rules.least_shown * expected else 0.0


def spread_frames(labeller: FrameLabeller, most: int) -> Ints:
    """Frames in which two cameras have blobs, evenly spread."""
    total = len(labeller.scene.blobs)
    some = [t for t in range(total) if cameras_with_blobs(labeller.scene.frame(t)[1]).sum() >= 2]
    return np.array(some, dtype=np.int64)[np.unique(np.linspace(0, len(some) - 1, min(most, len(some))).round().astype(np.int64))]


def _labelled(labeller: FrameLabeller, frames: Ints, labelled: Mapping[int, BlobLabels]) -> dict[int, BlobLabels]:
    """These frames labelled, each from nothing, and then from the poses of its neighbours where those explain it better.

    No frame depends on one start: a wrong one is a minority, and its neighbours mend it. Where the body is in none of every third frame,
    the others are not tried.
    """
    out = dict[int, BlobLabels]()
    # A third of the frames first: where the body is in none of them, the rest would be searched in vain.
    for part in (frames[::3], frames[1::3], frames[2::3]):
        for t in part.tolist():
            try:
                out[t] = labelled[t] if t in labelled else labeller.from_nothing(t)
            except AsterismError:
                continue
        if not any(quality_of(labeller, each) >= labeller.rules.lost for each in out.values()):
            return out
    known = sorted(out)
    for order in (known, known[::-1]):
        # Good poses spread to their neighbours, forwards and then backwards.
        for before, t in pairwise(order):
            other = labeller.from_start(t, out[before].pose, out[before].rotation)
            if other.gain > out[t].gain + 1.0:
                out[t] = labeller.turned(t, other)
    return out


def _astray(labeller: FrameLabeller, found: dict[int, BlobLabels], good: list[int], rules: PersonalRules) -> np.ndarray:
    markers = len(labeller.body.markers)
    expected, seen = np.zeros(markers), np.zeros(markers)
    for t in good:
        expected += labeller.expected(found[t]).sum(axis=0)
        seen += np.bincount(found[t].labels[found[t].labels >= 0], minlength=markers)
    # Markers that no camera should see cannot be missed.
    return np.asarray((seen < rules.least_found * expected) & (expected > 1.0))


def _views(labeller: FrameLabeller, found: BlobLabels) -> Ints:
    """(M,) how many cameras show each marker."""
    return np.bincount(found.labels[found.labels >= 0], minlength=len(labeller.body.markers))


def _with_own_places(body: ArticulatedBody, found: list[BlobLabels], views: list[Ints], rules: PersonalRules) -> ArticulatedBody:
    poses = np.array([each.pose for each in found])
    scale: Floats = np.median(poses[:, :PLACE], axis=0)
    # A marker that one camera shows lies somewhere on a ray, so its place comes from the model and teaches nothing.
    positions = np.array([np.where(seen[:, None] >= 2, each.points, np.nan) for each, seen in zip(found, views, strict=True)])
    rest = rest_places(body, PosedFrames(poses, np.array([each.rotation for each in found]), np.zeros(len(found))), positions)
    root = np.array(body.bones[0].pivot)
    markers = []
    for m, marker in enumerate(body.markers):
        own = rest[np.isfinite(rest[:, m, 0]), m]
        if len(own) < rules.least_frames:
            markers.append(marker)
            continue
        middle = np.median(own, axis=0)
        # 1.4826 times the median deviation is a normal distribution's standard deviation, and outliers do not count.
        scatter = 1.4826 * float(np.sqrt(np.mean(np.median(np.abs(own - middle), axis=0) ** 2)))
        markers.append(replace(marker, place=as_point(middle + root), spread=min(marker.spread, max(scatter, rules.least_spread))))
    return _scaled(replace(body, markers=tuple(markers)), scale)


def _scaled(body: ArticulatedBody, scale: Floats) -> ArticulatedBody:
    """The body with the person's scales in it, which then hardly vary."""

    def grown(place: tuple[float, float, float]) -> tuple[float, float, float]:
        return as_point(np.array(place) * scale)

    # Capsules are round, so their radii grow with the mean of the three scales.
    girth = float(scale.mean())
    return replace(
        body,
        height=body.height * float(scale[2]),
        bones=tuple(replace(bone, pivot=grown(bone.pivot)) for bone in body.bones),
        markers=tuple(replace(marker, place=grown(marker.place)) for marker in body.markers),
        capsules=tuple(
            replace(part, start=grown(part.start), end=grown(part.end), radii=(girth * part.radii[0], girth * part.radii[1]))
            for part in body.capsules
        ),
        scale_spread=(0.015, 0.01),
    )
