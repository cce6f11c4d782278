"""Wand calibration from nothing: blobs, image sizes and wand lengths in; a rig, what it was made of and whether to trust it out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras.bundle import Adjustment, Sightings, adjust, free_parameters, locate
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.cameras.wand.clock import common_clock, lags, shifted
from asterism.cameras.wand.identify import Agreed, Wand, agree, identify, wand_of
from asterism.cameras.wand.start import FEWEST, adjust_some, cold_start, priors, shared_frames, shown, spread_frames
from asterism.cameras.wand.verdict import Finding, judge
from asterism.cameras.wand.world import upright
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

Progress = Callable[[float, str], None]

_FINAL_FRAMES = 3000
"""More frames than these tell little more: they are spread over the recording."""
_WIDE, _REACH, _NARROW = 0.012, 6.0, 4.5
_LATE, _ROUNDS = 0.35, 4
_PERSPECTIVE = 0.045
"""By how much the share at which images show the inner marker may differ from the wand's, all directions together."""
_GROUPS = ("pose", "focal", "aspect", "centre", "k1", "k2", "tangential")


@dataclass(frozen=True)
class WandCalibration:
    """A rig from a waved wand, and what speaks for and against it.

    rig           the cameras that could be calibrated; its world is level by the cameras' own sense of up until a floor is given
    wand          what was waved
    frames        how many the recording has
    sightings     the wand's markers in the images that were used: frames are those of the recording (of the common clock, where
                  cameras were not triggered together), cameras are places in the rig
    residuals     (n, 2) px, seen minus projected, per sighting
    positions     (m, K, 3) m, the markers of the wand in `used`, each triangulated by itself, without knowing the wand; NaN where only
                  one camera saw it
    used          (m,) the frames that were used
    sigma         (C, 15) standard deviation of each camera's parameters, see `bundle.PARAMETERS`
    place_sigma   (C,) m, of where it stands, relative to all cameras
    noise         px, standard deviation of one coordinate of a blob
    late          (C,) by how many frames each camera started late; its images were moved by as many
    lost          (C,) share of each camera's images of the wand that did not fit those of the others and were left out
    inner         m, where the inner one of three markers sits by all images that show it, used or not; NaN for other wands
    left_out      cameras that could not be calibrated, with the reason
    findings      what to know before using the rig, gravest first
    seconds       of the final adjustment
    """

    rig: Rig
    wand: Wand
    frames: int
    sightings: Sightings
    residuals: Floats
    positions: Floats
    used: Ints
    sigma: Floats
    place_sigma: Floats
    noise: float
    late: Ints
    lost: Floats
    inner: float
    left_out: Mapping[str, str]
    findings: tuple[Finding, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against using the rig."""
        return not any(finding.grave for finding in self.findings)

    @property
    def lengths(self) -> Floats:
        """(m,) m, the whole wand as measured in each frame without knowing it; NaN where an end was seen by fewer than two cameras."""
        return np.asarray(np.linalg.norm(self.positions[:, -1] - self.positions[:, 0], axis=1), dtype=np.float64)

    @property
    def rejected(self) -> float:
        """The mean share of the wand's images that did not fit and were left out."""
        return float(self.lost.mean())

    @property
    def rms(self) -> float:
        """px, the reprojection error: root of the mean squared distance."""
        return float(np.sqrt(np.square(self.residuals).sum(axis=1).mean()))

    def moved(self, rig: Rig, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> WandCalibration:
        """The same in another world frame, of which `rig` is the rig: X becomes scale rotation X + translation (3,) m."""
        positions = scale * self.positions @ np.asarray(rotation).T + np.asarray(translation)
        findings = tuple(finding for finding in self.findings if scale == 1.0 or not finding.of_scale)
        return replace(self, rig=rig, positions=positions, place_sigma=scale * self.place_sigma, findings=findings)


def calibrate_wand(
    blobs: Blobs,
    lengths: ArrayLike,
    *,
    sizes: Mapping[str, tuple[int, int]] | tuple[int, int] | None = None,
    known: Rig | None = None,
    distance: tuple[str, str, float] | None = None,
    progress: Progress | None = None,
) -> WandCalibration:
    """Calibrate cameras by a waved wand (thesis 3.3, eq. 3.10), from nothing but image sizes and its lengths.

    blobs     what the cameras saw of the wand, strays among it; `blobs.times` where they are not triggered together
    lengths   m, the places of three or two markers along the wand; one number for a single moved marker
    sizes     (width, height) px of the images, one for all or by camera name; not needed where `known` has them
    known     a rig whose lenses are known, more or less: they are where it begins; poses are not used
    distance  two cameras' names and the metres between them: the scale, where a single marker was moved

    Returns a `WandCalibration`; ask its `usable` and `findings` before using its rig. Deterministic. Raises AsterismError where lengths or
    sizes make no sense, and where no two cameras can be posed at all.
    """
    wand = wand_of(lengths)
    told = progress or (lambda fraction, doing: None)
    lenses, extents = _lenses(blobs, sizes, known)
    if len(blobs.cameras) < 2:
        raise AsterismError("a wand is seen by one camera only; calibration needs two that look at the same place.")
    if len(wand.lengths) == 1 and distance is not None:
        _check_distance(blobs.cameras, distance)
    told(0.0, "looking for the wand")
    chosen = identify(blobs, wand)
    _check_found(blobs, chosen, wand)
    frames = len(blobs)
    blobs, chosen = common_clock(blobs, chosen)
    told(0.1, "posing cameras")
    start = cold_start(blobs, chosen, wand, extents, lenses, progress)
    if start is None:
        raise AsterismError(_why_no_start(blobs, chosen))
    cameras = list(start.cameras)
    told(0.6, "comparing clocks")
    blobs, chosen, cameras, late = _in_step(blobs, chosen, wand, cameras, lenses)
    told(0.7, "adjusting")
    result, sightings, used, offered = _adjusted(blobs, chosen, wand, cameras, lenses, start.noise)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    told(0.9, "measuring the wand")
    positions = locate(result.cameras, sightings, len(used), len(wand.lengths))
    left_out = {blobs.cameras[c]: _why_not(blobs, chosen, cameras, c) for c in range(len(cameras)) if c not in posed}
    made = WandCalibration(
        Rig(result.cameras), wand, frames, replace(sightings, frame=used[sightings.frame]), result.residuals, positions, used,
        result.sigma, result.place_sigma, result.noise, late[posed], _lost(chosen[offered][:, posed], sightings),
        _inner(blobs, chosen[used][:, posed], wand, result.cameras, positions), left_out,
    )  # fmt: skip
    if len(wand.lengths) == 1 and distance is not None:
        here = np.linalg.norm(made.rig[distance[0]].position - made.rig[distance[1]].position)
        scale = distance[2] / float(here)
        made = made.moved(made.rig.moved(np.eye(3), np.zeros(3), scale), np.eye(3), np.zeros(3), scale)
    turn, shift = upright(made.rig, made.positions)
    made = made.moved(made.rig.moved(turn, shift), turn, shift)
    made = replace(made, findings=judge(made, blobs, lags(made.sightings, made.residuals, len(posed)), scaled=distance is not None))
    told(1.0, "done")
    return replace(made, rig=replace(made.rig, metadata=_about(made)))


def _adjusted(
    blobs: Blobs, chosen: Ints, wand: Wand, cameras: list[Camera | None], lenses: Sequence[Camera | None], noise: float
) -> tuple[Adjustment, Sightings, Ints, Ints]:
    """The final adjustment: everything freed, blobs that do not fit left out by what fits.

    Returns it, its sightings with frames counted without holes, the frames (m,) that these numbers stand for, and those it chose from.
    """
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    width = max((camera.size or (1280, 0))[0] for camera in cameras if camera is not None)
    place = np.full(len(cameras), -1)
    place[posed] = np.arange(len(posed))
    known = [lenses[c] for c in posed]
    result: Adjustment | None = None
    for gate in (_WIDE * width * 0.3, None):
        agreed = agree(blobs, chosen, wand, cameras, max(_REACH * noise, 1.5) if gate is None else max(gate, _REACH * noise))
        if gate is not None:
            wide = adjust_some(blobs, agreed, wand, cameras, lenses, _GROUPS, max(2.0 * noise, 0.2), 60)
            if wide is not None:
                for c, camera in zip(posed, wide.cameras, strict=True):
                    cameras[c] = camera
                noise = max(float(np.nanmedian(np.abs(wide.residuals))) / 0.6745, 0.01)
    offered = spread_frames(shown(chosen), _FINAL_FRAMES)
    sightings, used = agreed.sightings(blobs, offered).compact()
    if len(used) < FEWEST:
        share, given = _shares(blobs, wand)
        if abs(share - given) > _PERSPECTIVE:
            raise AsterismError(
                f"only {len(used)} frames fit the wand: images show the inner marker at {share:.2f} of its length, not {given:.2f}; "
                "are the lengths right?"
            )
        raise AsterismError(f"only {len(used)} frames show the wand to two cameras that agree on it; wave it longer where cameras overlap.")
    sightings = replace(sightings, camera=place[sightings.camera])
    own = [camera for camera in cameras if camera is not None]
    rotations, translations = (part[used] for part in agreed.placements())
    groups: tuple[str, ...] = _GROUPS
    for gated in (False, True):
        free = free_parameters(len(own), *groups)
        prior = priors(own, known, noise)
        result = adjust(
            own, wand.template, sightings, rotations, translations, free=free, prior=prior,
            scale=3.0 * noise, tolerance=1e-5 if not gated else 1e-7, covariance=gated,
        )  # fmt: skip
        own, rotations, translations = list(result.cameras), result.rotations, result.translations
        if gated:
            break
        noise = max(float(np.nanmedian(np.abs(result.residuals))) / 0.6745, 1e-3)
        good = np.linalg.norm(result.residuals, axis=1) < _NARROW * noise
        kept = _determined(sightings.select(good), len(wand.lengths))
        sightings, rows = kept.compact()
        used, rotations, translations = used[rows], rotations[rows], translations[rows]
        groups = _GROUPS if not _wants_k3(own, wand, sightings, rotations, translations, known, noise) else (*_GROUPS, "k3")
    assert result is not None
    return result, sightings, used, offered


def _lost(chosen: Ints, used: Sightings) -> Floats:
    """(C,) the share of the blobs that single images (m, C, K) took for the wand, where two cameras did, that was not used."""
    own = shown(chosen)
    told = chosen.shape[2] * own[own.sum(axis=1) >= 2].sum(axis=0)
    kept = np.bincount(used.camera, minlength=len(told))
    return np.asarray(np.maximum(1.0 - kept / np.maximum(told, 1), 0.0))


def _inner(blobs: Blobs, chosen: Ints, wand: Wand, cameras: Sequence[Camera], positions: Floats) -> float:
    """Where single images (m, C, K) put the inner marker, m from the first: the median of where their rays pass the measured wand's line.

    Of wands that look alike from both ends, where images usually show it, where that is far from what was given; NaN otherwise.
    """
    if len(wand.lengths) < 3:
        return float("nan")
    if wand.either:
        share, given = _shares(blobs, wand)
        return share * float(wand.lengths[2]) if abs(share - given) > _PERSPECTIVE else float("nan")
    start, along = positions[:, 0], positions[:, 2] - positions[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    places = []
    for c, camera in enumerate(cameras):
        rows = np.nonzero((chosen[:, c] >= 0).all(axis=1) & np.isfinite(along[:, 0]))[0]
        ray, line = camera.rays(blobs.xy[chosen[rows, c, 1]]), along[rows]
        to = camera.position - start[rows]
        across = (ray * line).sum(axis=1)
        place = ((to * line).sum(axis=1) - across * (to * ray).sum(axis=1)) / (1.0 - across**2)
        places.append(place[np.isfinite(place) & (across**2 < 0.9)])
    every = np.concatenate(places)
    return float(np.median(every)) if len(every) else float("nan")


def _wants_k3(
    cameras: list[Camera],
    wand: Wand,
    sightings: Sightings,
    rotations: Floats,
    translations: Floats,
    known: Sequence[Camera | None],
    noise: float,
) -> bool:
    """Whether a third radial coefficient explains more than noise would let it explain, on a part of the frames."""
    some = sightings.frame % max(1, len(rotations) // 400) == 0
    part, rows = sightings.select(some).compact()
    costs = [
        adjust(
            cameras, wand.template, part, rotations[rows], translations[rows], free=free_parameters(len(cameras), *groups),
            prior=priors(cameras, known, noise), scale=3.0 * noise, tolerance=1e-5, steps=10, covariance=False,
        ).cost
        for groups in (_GROUPS, (*_GROUPS, "k3"))
    ]  # fmt: skip
    n = len(cameras)
    return bool(2.0 * (costs[0] - costs[1]) / noise**2 > n + 4.0 * np.sqrt(2.0 * n))


def _determined(sightings: Sightings, markers: int) -> Sightings:
    """Those of frames that two cameras see, with more coordinates than a wand has freedoms."""
    frames = int(sightings.frame.max(initial=-1)) + 1
    count = np.bincount(sightings.frame, minlength=frames)
    cameras = np.bincount(np.unique(sightings.frame * 1024 + sightings.camera) // 1024, minlength=frames)
    points = np.bincount(np.unique(sightings.frame * 8 + sightings.point) // 8, minlength=frames)
    good = (cameras >= 2) & (2 * count > (3 if markers == 1 else 5)) & (points >= min(2, markers))
    return sightings.select(good[sightings.frame])


def _in_step(
    blobs: Blobs, chosen: Ints, wand: Wand, cameras: list[Camera | None], lenses: Sequence[Camera | None]
) -> tuple[Blobs, Ints, list[Camera | None], Ints]:
    """Move the images of cameras that run some frames late or early, the latest first, until all look at the same wand."""
    late = np.zeros(len(cameras), dtype=np.int64)
    posed = [c for c, camera in enumerate(cameras) if camera is not None]
    place = np.full(len(cameras), -1)
    place[posed] = np.arange(len(posed))
    for _ in range(_ROUNDS * len(posed)):
        width = max((camera.size or (1280, 0))[0] for camera in cameras if camera is not None)
        agreed = agree(blobs, chosen, wand, cameras, _WIDE * width)
        result = adjust_some(blobs, agreed, wand, cameras, lenses, ("pose", "focal", "k1", "k2"), 2.0, 60)
        if result is None:
            break
        found = list(cameras)
        for c, camera in zip(posed, result.cameras, strict=True):
            found[c] = camera
        seen, residuals = _missed(blobs, agree(blobs, chosen, wand, found, _WIDE * width), wand, list(result.cameras), place)
        by, spread = lags(seen, residuals, len(posed))
        by = by - np.nanmedian(by) if np.isfinite(by).any() else by
        sure = np.isfinite(by) & (np.abs(by) > _LATE) & (np.abs(by) > 5.0 * spread)
        if not sure.any():
            break
        cameras = found
        worst = int(np.nanargmax(np.where(sure, np.abs(by), np.nan)))
        move = np.zeros(len(cameras), dtype=np.int64)
        move[posed[worst]] = int(np.rint(by[worst])) or int(np.sign(by[worst]))
        late += move
        blobs, chosen = shifted(blobs, chosen, move)
    return blobs, chosen, cameras, late


def _missed(blobs: Blobs, agreed: Agreed, wand: Wand, cameras: Sequence[Camera], place: Ints) -> tuple[Sightings, Floats]:
    """All sightings and how far the wand, where the cameras agree on it, is from them."""
    seen = agreed.sightings(blobs)
    world = agreed.starts[seen.frame] + wand.lengths[seen.point][:, None] * agreed.directions[seen.frame]
    seen = replace(seen, camera=place[seen.camera])
    projected = np.full((len(seen), 2), np.nan)
    for c, camera in enumerate(cameras):
        own = seen.camera == c
        projected[own] = camera.project(world[own])
    return seen, seen.xy - projected


def _lenses(
    blobs: Blobs, sizes: Mapping[str, tuple[int, int]] | tuple[int, int] | None, known: Rig | None
) -> tuple[list[Camera | None], list[tuple[int, int]]]:
    """The known lens and the image size of each camera."""
    lenses: list[Camera | None] = [None] * len(blobs.cameras)
    extents = []
    for c, name in enumerate(blobs.cameras):
        if known is not None and name in known.names:
            lenses[c] = replace(known[name], rotation=np.eye(3), translation=np.zeros(3), posed=False)
        said = (sizes.get(name) if isinstance(sizes, Mapping) else sizes) or None
        lens = lenses[c]
        if lens is not None and lens.size is not None and said is not None and tuple(said) != lens.size:
            raise AsterismError(
                f"camera {name}: its images are said to be {said[0]} x {said[1]}, but the rig says {lens.size[0]} x {lens.size[1]}; "
                "a lens is known for one image size only, so give the right rig or none."
            )
        size = said or (lens.size if lens is not None else None)
        if size is None:
            raise AsterismError(f"camera {name}: the size of its images is not known; give it, such as --image-size 1280x1024.")
        if min(size) < 16:
            raise AsterismError(f"camera {name}: an image of {size[0]} x {size[1]} px is none; give width x height.")
        own = blobs.xy[blobs.camera_of == c]
        if len(own):
            low, high = own.min(axis=0), own.max(axis=0)
            if low.min() < -0.02 * size[0] - 1 or high[0] > 1.02 * size[0] + 1 or high[1] > 1.02 * size[1] + 1:
                raise AsterismError(
                    f"camera {name}: blobs lie between ({low[0]:.0f}, {low[1]:.0f}) and ({high[0]:.0f}, {high[1]:.0f}), outside "
                    f"its image of {size[0]} x {size[1]} px; give the size of the images that they were found in."
                )
        if lens is not None and lens.size is None:
            lenses[c] = replace(lens, size=(int(size[0]), int(size[1])))
        extents.append((int(size[0]), int(size[1])))
    return lenses, extents


def _check_distance(names: Sequence[str], distance: tuple[str, str, float]) -> None:
    for name in distance[:2]:
        if name not in names:
            raise AsterismError(f"a distance to camera {name} is given, but the cameras are {', '.join(names)}.")
    if distance[0] == distance[1] or not 0.01 < distance[2] < 1000.0:
        raise AsterismError(
            f"the distance of {distance[2]:g} m from camera {distance[0]} to {distance[1]} cannot be; give metres between two."
        )


def _check_found(blobs: Blobs, chosen: Ints, wand: Wand) -> None:
    """Raise AsterismError where hardly an image shows the wand, saying what the images show instead."""
    images = int(shown(chosen).sum())
    counts = np.asarray(blobs.counts)
    enough = int((counts >= len(wand.lengths)).sum())
    if images >= max(2 * FEWEST, 0.05 * enough):
        return
    markers = len(wand.lengths)
    usual = int(np.bincount(counts[counts > 0]).argmax()) if (counts > 0).any() else 0
    if markers == 3 and usual >= 3:
        share, given = _shares(blobs, wand)
        if np.isfinite(share):
            raise AsterismError(
                f"only {images} images show three blobs as the wand's should be: the inner one sits at {share:.2f} of the length, by the "
                f"wand's lengths it should at {given:.2f}; are the lengths right?"
            )
    raise AsterismError(
        f"only {images} images show the {markers} markers of the wand; most show {usual} blob{'s' if usual != 1 else ''}: "
        "is it the right recording, and has the wand that many markers?"
    )


def _shares(blobs: Blobs, wand: Wand) -> tuple[float, float]:
    """Where the inner one of three blobs in line usually sits, as a share of the length from the nearer end, and where the wand has it.

    NaN where few images show just three blobs in line, or the wand has no three.
    """
    three = np.nonzero(np.diff(blobs.offsets) == 3)[0]
    if len(wand.lengths) < 3 or len(three) < 20:
        return float("nan"), float("nan")
    given = float(min(wand.lengths[1], wand.lengths[2] - wand.lengths[1]) / wand.lengths[2])
    triples = blobs.xy[blobs.offsets[three, None] + np.arange(3)]
    distance = np.linalg.norm(triples[:, [0, 1, 2]] - triples[:, [1, 2, 0]], axis=2)
    order = np.sort(distance, axis=1)
    lined = order[:, 0] + order[:, 1] < 1.01 * order[:, 2]
    return (float(np.median(order[lined, 0] / order[lined, 2])), given) if lined.sum() >= 20 else (float("nan"), given)


def _why_no_start(blobs: Blobs, chosen: Ints) -> str:
    shared = shared_frames(chosen)
    np.fill_diagonal(shared, 0)
    if shared.max(initial=0) < FEWEST:
        a, b = np.unravel_index(int(np.argmax(shared)), shared.shape)
        return (
            f"no two cameras show the wand together in {FEWEST} frames (at most {int(shared.max())}, {blobs.cameras[a]} and "
            f"{blobs.cameras[b]}); wave it where cameras overlap, and check that they ran at the same time."
        )
    return "the cameras' images of the wand contradict each other; were they recorded together, with these image sizes and this wand?"


def _why_not(blobs: Blobs, chosen: Ints, cameras: Sequence[Camera | None], camera: int) -> str:
    """Why a camera could not be posed."""
    whole = shown(chosen)
    own = whole[:, camera]
    posed = [c for c, other in enumerate(cameras) if other is not None]
    with_others = int((own & (whole[:, posed].sum(axis=1) >= 2)).sum())
    if not blobs.counts[:, camera].any():
        return "it saw nothing; is it switched on, and its lens cap off?"
    if own.sum() < FEWEST:
        return f"it shows the wand in {int(own.sum())} frames only; wave it before this camera, too"
    if with_others < FEWEST:
        return f"it shares only {with_others} frames with two cameras of the rig; wave the wand where their views overlap"
    return "its images contradict those of the others; is it mirrored, out of step by seconds, or was it moved while recording?"


def _about(made: WandCalibration) -> dict[str, object]:
    finite = made.lengths[np.isfinite(made.lengths)]
    return {
        "calibrated_by": "wand",
        "wand_m": [float(length) for length in made.wand.lengths],
        "frames": made.frames,
        "frames_used": len(made.used),
        "reprojection_rms_px": round(made.rms, 4),
        "noise_px": round(made.noise, 4),
        "wand_length_mean_m": round(float(finite.mean()), 6) if len(finite) else None,
        "wand_length_std_m": round(float(finite.std()), 6) if len(finite) else None,
        "usable": made.usable,
        "world": "level by the cameras' own sense of up, origin below the middle of the waved volume",
    }
