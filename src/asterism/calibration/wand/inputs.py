"""What a wand calibration was given in; the lenses and sizes that it begins from, or in words what is wrong with it, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from asterism.calibration.wand.frames import shared_frames, shown
from asterism.calibration.wand.identify import Wand
from asterism.calibration.wand.two_view import FEWEST
from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Ints

_FEWEST_SHOW = {1: 0.1, 2: 0.1, 3: 0.05}
"""Share of the images with enough blobs that must show a wand of so many markers."""
PERSPECTIVE = 0.045
"""By how much the share at which images show the inner marker may differ from the wand's, all directions together."""


def lenses_of(
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


def check_distance(names: Sequence[str], distance: tuple[str, str, float]) -> None:
    """Raise AsterismError where a distance between two cameras (their names, and m) names strangers or makes no sense."""
    for name in distance[:2]:
        if name not in names:
            raise AsterismError(f"a distance to camera {name} is given, but the cameras are {', '.join(names)}.")
    if distance[0] == distance[1] or not 0.01 < distance[2] < 1000.0:
        raise AsterismError(
            f"the distance of {distance[2]:g} m from camera {distance[0]} to {distance[1]} cannot be; give metres between two."
        )


def check_found(blobs: Blobs, chosen: Ints, wand: Wand, lights: Ints) -> None:
    """Raise AsterismError where hardly an image shows the wand, saying what the images show instead; lights (C,) that never moved."""
    images = int(shown(chosen).sum())
    enough = int((np.asarray(blobs.counts) >= len(wand.lengths)).sum())
    if images >= max(2 * FEWEST, _FEWEST_SHOW[len(wand.lengths)] * enough):
        return
    if lights.sum() >= len(wand.lengths) and enough < 2 * FEWEST:
        raise AsterismError("nearly all that the cameras see never moves; is it the recording in which the wand was waved?")
    told = instead(blobs, wand) or ": is it the right recording, and has the wand that many markers?"
    raise AsterismError(f"only {images} images show {_what(wand)}{told}")


def _what(wand: Wand) -> str:
    markers = len(wand.lengths)
    return f"the {markers} markers of the wand" if markers > 1 else "the one marker alone"


def instead(blobs: Blobs, wand: Wand) -> str:
    """The end of a sentence: what most images show, where that is not the wand as it was given; else empty."""
    share, given = shares(blobs, wand)
    if abs(share - given) > PERSPECTIVE:
        return (
            f"; in most, the inner of three markers sits at {share:.2f} of the length, by the wand's lengths it should at {given:.2f}: "
            "are the lengths right?"
        )
    counts = np.asarray(blobs.counts)
    usual = int(np.bincount(counts[counts > 0]).argmax()) if (counts > 0).any() else 0
    if usual == len(wand.lengths):
        return ""
    many = usual > len(wand.lengths)
    mend = "wave it alone, without other markers and lights, or give all of its lengths" if many else "has the wand that many?"
    return f"; most show {usual} blob{'s' if usual != 1 else ''}: {mend}"


def shares(blobs: Blobs, wand: Wand) -> tuple[float, float]:
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


def why_no_start(blobs: Blobs, chosen: Ints, wand: Wand) -> str:
    """In a sentence, why no two cameras could be posed."""
    shared = shared_frames(chosen)
    np.fill_diagonal(shared, 0)
    if shared.max(initial=0) < FEWEST:
        told = instead(blobs, wand)
        if told:
            return f"no two cameras show the wand for certain in {FEWEST} frames{told}"
        a, b = np.unravel_index(int(np.argmax(shared)), shared.shape)
        return (
            f"no two cameras show the wand together in {FEWEST} frames (at most {int(shared.max())}, {blobs.cameras[a]} and "
            f"{blobs.cameras[b]}); wave it where cameras overlap, and check that they ran at the same time."
        )
    return "the cameras' images of the wand contradict each other; were they recorded together, with these image sizes and this wand?"


def why_not(blobs: Blobs, chosen: Ints, wand: Wand, cameras: Sequence[Camera | None], camera: int, known: bool) -> str:
    """Why a camera could not be posed; known: whether its lens was given."""
    whole = shown(chosen)
    own = whole[:, camera]
    posed = [c for c, other in enumerate(cameras) if other is not None]
    needed = 2 if len(wand.lengths) == 1 else 1
    with_others = int((own & (whole[:, posed].sum(axis=1) >= needed)).sum())
    if not blobs.counts[:, camera].any():
        return "it saw nothing; is it switched on, and its lens cap off?"
    if own.sum() < FEWEST:
        return f"it shows the wand in {int(own.sum()) or 'no'} frame{'' if own.sum() < 2 else 's'}; wave it before this camera, too"
    if with_others < FEWEST:
        others = "a camera" if needed == 1 else "two cameras"
        return f"it shares only {with_others} frames with {others} of the rig; wave the wand where their views overlap"
    if known:
        return (
            "its images contradict those of the others; is its lens that of the rig given, and was it in step, not mirrored, and not moved?"
        )
    return "its images contradict those of the others; is it mirrored, out of step by seconds, or was it moved while recording?"
