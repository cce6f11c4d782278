"""Blobs of some frames, a rig and a body in; by how much the cameras contradict each other, and which of them do not fit, out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector, vector_from_rotation
from asterism.recording import Floats, Ints
from asterism.views._fit_kernels import project_linear
from asterism.views.frame import BlobLabels, FrameLabeller
from asterism.views.scene import cameras_with_blobs

_STEP = 2.0**0.5
"""Ratio of one noise that is tried to the next. Steps of 2 lose two nats of 40 blobs; finer ones cost time and gain nothing."""
_MOST = 24.0
"""The most noise that is tried, as a multiple of the usual one: 19 px, 16 cm at the person before the cameras of the paper."""
_TURNS = 8
"""Rounds in which cameras are turned and the body is fitted anew: each takes up half or more of what is left."""
_LEAST_TO_TURN = 20
"""Labelled blobs by which a camera is turned: fewer would turn it by their noise."""
_FAR_OFF = 6.0
"""Noise, as a multiple of the usual one, with which a body is sought that the usual one does not explain: half way up."""


@dataclass(frozen=True, eq=False)
class CameraAgreement:
    """How well cameras agree about a body.

    noise     px, standard deviation of blobs about where the body and the other cameras have their markers
    left_out  cameras without which the others explain their blobs better than all explain all
    gain      nats, of the frames that were looked at, against no body at all
    found     frame -> its labels, found without a start at this noise
    turned    (C, 3) rad, axis times angle: by which each camera is turned against the rig, so that the cameras contradict each other less
    mirrored  cameras whose images are mirrored: so the body is found with the usual noise, and explains more
    """

    noise: float
    left_out: Ints
    gain: float
    found: dict[int, BlobLabels]
    turned: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    mirrored: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def fit_rig(labeller: FrameLabeller, frames: Ints) -> CameraAgreement:
    """How far the cameras of a labeller's rig contradict each other, by frames that are labelled without a start.

    The noise is the one with which the frames are most probable: a rig that is a little off has lines of sight that miss each other, and
    labels are then as certain as that allows. A camera is left out where the gain of the others alone, with their own noise, is greater
    than that of all: what it contradicts costs more than it gains. At least two cameras are left. Where the cameras disagree, all images
    and each of them are tried mirrored, too. O(frames cameras) labellings where the cameras disagree, else O(frames).
    """
    known = dict[tuple[float, int], BlobLabels]()
    best, left_out = _noise_of(labeller, frames, known), list[int]()
    if _in_doubt(labeller, best) and len(_seeing(labeller, left_out)) > 2:
        few = frames[::2]
        all_of = _noise_of(labeller, few, known)
        while len(rest := _seeing(labeller, left_out)) > 2:
            # Each camera in turn: what it says is left out, and so is what it misses.
            others = [_noise_of(_without(labeller, [*left_out, c]), few) for c in rest]
            worst = int(np.argmax([other.gain for other in others]))
            if others[worst].gain <= all_of.gain:
                break
            all_of = others[worst]
            left_out.append(rest[worst])
        best = _noise_of(_without(labeller, left_out), frames) if left_out else best
    best = replace(best, left_out=np.array(left_out, dtype=np.int64))
    if left_out or best.noise > labeller.rules.noise:
        # Mirrored images must explain more than the cameras do when they are turned, which is the likelier fault.
        turned = best if left_out else _turned_back(labeller, best)
        mirrored = _mirrored(labeller, turned)
        best = replace(best, mirrored=mirrored) if len(mirrored) else turned
    return best


def turned_rig(rig: Rig, turned: Floats) -> Rig:
    """The rig with each camera turned about its own place by (C, 3) rad in its own axes."""
    cameras = []
    for camera, vector in zip(rig, turned, strict=True):
        rotation = rotation_from_vector(vector) @ camera.rotation
        cameras.append(replace(camera, rotation=rotation, translation=-rotation @ camera.position))
    return Rig(tuple(cameras), vertical=rig.vertical)


def _turned_back(labeller: FrameLabeller, fit: CameraAgreement) -> CameraAgreement:
    """The agreement of the cameras as they are turned, where that explains the frames better than the rig does with more noise."""
    scene, best, found = labeller.scene, fit, fit.found
    turned = np.zeros((len(scene.rig), 3))
    for _ in range(_TURNS):
        here = replace(labeller, scene=scene.before(turned_rig(scene.rig, turned)))
        found = {t: _at(here, fit.noise).again(t, each) for t, each in found.items()}
        turned = np.array(
            [
                vector_from_rotation(rotation_from_vector(more) @ rotation_from_vector(old))
                for more, old in zip(_turns(here, found), turned, strict=True)
            ]
        )
    here = replace(labeller, scene=scene.before(turned_rig(scene.rig, turned)))
    other = _most_probable(here, found)
    # Three numbers more for each camera explain some of any noise, half a nat each.
    if other.gain > best.gain + 1.5 * len(turned):
        best = replace(fit, noise=other.noise, gain=other.gain, turned=turned, found=_found(_at(here, other.noise), np.array(list(found))))
    return best


def _turns(labeller: FrameLabeller, found: dict[int, BlobLabels]) -> Floats:
    """(C, 3) rad by which each camera must be turned for the labelled blobs to lie where the body has their markers; least squares."""
    cameras, markers = labeller.scene.cameras, len(labeller.body.markers)
    uv, slopes = np.empty((len(cameras.eyes), markers, 2)), np.empty((len(cameras.eyes), markers, 2, 3))
    rows: list[list[Floats]] = [[] for _ in cameras.eyes]
    for t, each in found.items():
        xy, offsets = labeller.scene.frame(t)
        project_linear(cameras, labeller.placed(each), uv, slopes)
        for c, of in enumerate(rows):
            some = np.nonzero(each.labels[offsets[c] : offsets[c + 1]] >= 0)[0] + offsets[c]
            flat = uv[c, each.labels[some]] / cameras.focals[c]
            of.append(np.column_stack([flat, xy[some] / cameras.focals[c] - flat]))
    out = np.zeros((len(rows), 3))
    for c, of in enumerate(rows):
        x, y, off_x, off_y = np.concatenate(of).T
        if len(x) < _LEAST_TO_TURN:
            continue
        # How a point of the normalized plane moves as its camera turns about its own axes x, y and z.
        by = np.concatenate([np.column_stack([-x * y, 1 + x * x, -y]), np.column_stack([-(1 + y * y), x * y, x])])
        out[c] = np.linalg.lstsq(by, np.concatenate([off_x, off_y]), rcond=None)[0]
    return out


def _mirrored(labeller: FrameLabeller, fit: CameraAgreement) -> Ints:
    """The cameras whose images are mirrored, all of them or one; empty where none is."""
    frames, seeing = np.array(list(fit.found), dtype=np.int64)[::2], _seeing(labeller, [])
    most, which = sum(max(fit.found[t].gain, 0.0) for t in frames.tolist()), list[int]()
    # Mirrored back, the cameras must agree as well as those of a right rig do: noise would explain anything.
    for cameras in (seeing, *([c] for c in seeing)):
        back = replace(labeller, scene=labeller.scene.mirrored(cameras))
        found = _found(back, frames)
        gain = sum(max(each.gain, 0.0) for each in found.values())
        shown, expected = _sightings(back, found)
        # One camera more gains a little by chance; one that is mirrored back shows the body.
        if gain > most and (shown >= labeller.rules.least_shown * expected)[cameras].all():
            most, which = gain, cameras
    return np.array(which, dtype=np.int64)


def _seeing(labeller: FrameLabeller, left_out: list[int]) -> list[int]:
    """The cameras that have blobs and are not left out."""
    return [c for c in np.nonzero(labeller.scene.blobs.counts.sum(axis=0))[0].tolist() if c not in left_out]


def _without(labeller: FrameLabeller, cameras: list[int]) -> FrameLabeller:
    return replace(labeller, scene=labeller.scene.without(np.array(cameras, dtype=np.int64))) if cameras else labeller


def _in_doubt(labeller: FrameLabeller, fit: CameraAgreement) -> bool:
    """Whether the cameras contradict each other, or one of them hardly shows the body that the others show."""
    shown, expected = _sightings(labeller, fit.found)
    return bool(fit.noise > labeller.rules.noise or (shown < labeller.rules.least_shown * expected).any())


def _sightings(labeller: FrameLabeller, found: dict[int, BlobLabels]) -> tuple[Floats, Floats]:
    """(C,) how many labelled blobs each camera has in these frames, and how many the body lets expect."""
    expected, shown = np.zeros(len(labeller.scene.rig)), np.zeros(len(labeller.scene.rig))
    for t, each in found.items():
        camera = np.repeat(np.arange(len(expected)), np.diff(labeller.scene.frame(t)[1]))
        shown += np.bincount(camera[each.labels >= 0], minlength=len(expected))
        expected += np.where(each.counts > 0, labeller.expected(each).sum(axis=1), 0.0)
    return shown, expected


def _noise_of(labeller: FrameLabeller, frames: Ints, known: dict[tuple[float, int], BlobLabels] | None = None) -> CameraAgreement:
    """The noise with which the frames are most probable, and what is found with it; known: see `_found`."""
    usual, known = labeller.rules.noise, {} if known is None else known
    best = _most_probable(labeller, _found(labeller, frames, known))
    explained = [labeller.explained(each) for each in best.found.values()]
    # A body that is sought with too little noise may not be found at all.
    if best.noise > usual or not explained or np.median(explained) < labeller.rules.enough_gain:
        wide = _at(labeller, max(best.noise, _FAR_OFF * usual))
        other = _most_probable(labeller, _found(wide, frames, known))
        best = other if other.gain > best.gain else best
    # With its own noise the body is found best.
    return replace(best, found=_found(_at(labeller, best.noise), frames, known)) if best.noise > usual else best


def _at(labeller: FrameLabeller, noise: float) -> FrameLabeller:
    return replace(labeller, rules=labeller.rules.at_noise(noise))


def _found(labeller: FrameLabeller, frames: Ints, known: dict[tuple[float, int], BlobLabels] | None = None) -> dict[int, BlobLabels]:
    """The frames labelled without a start; those in which two cameras have blobs.

    known: (noise, frame) -> what this labeller has found before; what is found now is added.
    """
    out, known = dict[int, BlobLabels](), {} if known is None else known
    for t in frames.tolist():
        if cameras_with_blobs(labeller.scene.frame(t)[1]).sum() < 2:
            continue
        try:
            found = known.get((labeller.rules.noise, t)) or labeller.from_nothing(t)
        except AsterismError:
            # All cameras that have blobs here look along one line.
            continue
        out[t] = known[labeller.rules.noise, t] = found
    return out


def _most_probable(labeller: FrameLabeller, found: dict[int, BlobLabels]) -> CameraAgreement:
    """The noise with which labels that were found gain most."""
    usual = labeller.rules.noise
    best = CameraAgreement(usual, np.empty(0, dtype=np.int64), -np.inf, found)
    noise = usual
    while noise <= _MOST * usual:
        here = _at(labeller, noise)
        # A frame that shows no body says nothing, and no body gains nothing.
        gain = sum(max(here.again(t, each).gain, 0.0) for t, each in found.items())
        if gain > best.gain:
            best = replace(best, noise=noise, gain=gain)
        noise *= _STEP
    return best
