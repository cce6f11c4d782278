"""The places of all shipped marker sets in; one model of a body that wears all their markers at once, out.

It is to find which set is worn, not to label: one body in any posture explains the points, whatever set they belong to, and then each
set is held against them in this one body.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from asterism.files.cache import cache_folder
from asterism.recording import Floats, Ints, MarkerSet, Place

PEOPLE, FRAMES = 60, 60
"""Virtual people, and frames of each. Not tuned: half as many know fewer postures; twice as many take twice as long, 4 s on one core."""

LATENTS = 48
"""Directions in which bodies differ, posture and person together. Not tuned: they leave 2 cm (median of all places)."""

TEMPLATES = 240
"""Postures from which a fit starts, far from each other. Not tuned: twice as many take twice as long."""

COARSE = 400
"""Of all places on the body, those by which a posture is sought: 3 to 4 cm from each other. Not tuned; all take longer."""

FLOOR = 0.0156
"""m, standard deviation by which any marker differs besides: hands place a marker 6 to 21 mm off (Della Croce et al. 1999)."""


@dataclass(frozen=True, eq=False)
class BodyShapes:
    """A body that wears the markers of several sets at once: U markers, K latents, T templates.

    mean       (U, 3) m, facing +x, the pelvis above the origin, z up from the floor
    basis      (U, 3, K) m: a body is mean + basis @ u, u ~ N(0, I)
    variance   (U,) m2 per coordinate, of what the latents leave
    templates  (T, K) latents of postures
    coarse     (C,) markers that lie apart from each other on the body, the farthest first
    columns    for each set the columns of its markers: sets share the places that they have in common
    """

    mean: Floats
    basis: Floats
    variance: Floats
    templates: Floats
    coarse: Ints
    columns: Mapping[str, Ints]


def body_shapes(marker_sets: Mapping[str, MarkerSet], seed: int = 0) -> BodyShapes:
    """The shapes of these sets, each of which says where its markers sit. Made in seconds, and kept in the cache folder by hash."""
    together, columns = _together(marker_sets)
    path = cache_folder() / "models" / f"shapes-{_key(marker_sets, seed)}.npz"
    kept = _kept(path, len(together))
    if kept is None:
        kept = _learned(together, seed)
        _keep(path, kept)
    mean, basis, variance, templates = (part.astype(np.float64) for part in kept)
    return BodyShapes(mean, basis, variance, templates, farthest(mean, COARSE), columns)


def _together(marker_sets: Mapping[str, MarkerSet]) -> tuple[MarkerSet, dict[str, Ints]]:
    """One set with the places of all, each of them once; and for each set the places of its markers."""
    places, pairs, columns = dict[Place, str](), list[tuple[str, str]](), dict[str, Ints]()
    for name, marker_set in marker_sets.items():
        # plates of two sets are two plates, whatever they are called
        own = {marker: replace(place, plate=place.plate and f"{place.plate} of {name}") for marker, place in marker_set.places.items()}
        called = {marker: places.setdefault(own[marker], f"{name}/{marker}") for marker in marker_set.names}
        pairs += [(called[left], called[right]) for left, right in marker_set.pairs]
        columns[name] = np.array([list(places.values()).index(called[marker]) for marker in marker_set.names], dtype=np.int64)
    names = tuple(places.values())
    worn = {name: place for place, name in places.items()}
    return MarkerSet(names, "all shipped sets", pairs=tuple(_once(pairs)), places=worn), columns


def _once(pairs: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """The pairs without those of which a place has a partner already: sets may pair one place with two that lie millimetres apart."""
    taken = set[str]()
    for left, right in pairs:
        if left != right and not taken & {left, right}:
            taken |= {left, right}
            yield left, right


def _learned(together: MarkerSet, seed: int) -> tuple[Floats, ...]:
    from asterism.skeleton import virtual_people

    recordings = virtual_people(together, people=PEOPLE, frames=FRAMES, seed=seed)
    frames = np.concatenate([recording.positions for recording in recordings])
    # postures follow each other slowly: every second frame tells as much
    frames = _facing_ahead(frames[::2], together)
    mean = frames.mean(axis=0)
    rest = (frames - mean).reshape(len(frames), -1)
    # the smaller of the two products: there are more coordinates than frames
    values, vectors = np.linalg.eigh(rest @ rest.T / len(rest))
    order = np.argsort(values)[::-1][:LATENTS]
    scale = np.sqrt(np.maximum(values[order], 1e-12))
    basis = (rest.T @ vectors[:, order]) / np.sqrt(len(rest))
    latents = vectors[:, order] * np.sqrt(len(rest))
    left = rest - latents @ basis.T
    variance = np.mean(left.reshape(len(frames), -1, 3) ** 2, axis=(0, 2)) + FLOOR**2
    assert scale.shape == (LATENTS,)
    chosen = farthest(latents * scale, TEMPLATES)
    return (
        mean.astype(np.float32),
        basis.reshape(*mean.shape, LATENTS).astype(np.float32),
        variance.astype(np.float32),
        latents[chosen].astype(np.float32),
    )


def _facing_ahead(frames: Floats, together: MarkerSet) -> Floats:
    """Bodies (N, U, 3) turned about the vertical so that the pelvis faces +x, and moved so that it is above the origin."""
    pelvis = np.array([together.places[name].segment == "pelvis" for name in together.names])
    left = np.array([together.places[name].at[1] > 0.03 for name in together.names])
    right = np.array([together.places[name].at[1] < -0.03 for name in together.names])
    across = frames[:, pelvis & left].mean(axis=1) - frames[:, pelvis & right].mean(axis=1)
    angle = np.arctan2(-across[:, 0], across[:, 1])
    cos, sin = np.cos(angle), np.sin(angle)
    middle = frames[:, pelvis].mean(axis=1)
    x, y = frames[:, :, 0] - middle[:, None, 0], frames[:, :, 1] - middle[:, None, 1]
    return np.stack([cos[:, None] * x + sin[:, None] * y, cos[:, None] * y - sin[:, None] * x, frames[:, :, 2]], axis=2)


def farthest(points: Floats, count: int) -> Ints:
    """Points that lie far from each other: each next one the farthest from those chosen. O(count N)."""
    chosen, distance = [0], np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)


def _key(marker_sets: Mapping[str, MarkerSet], seed: int) -> str:
    from importlib import resources

    digest = hashlib.sha256(Path(__file__).read_bytes())
    for entry in sorted(resources.files("asterism").joinpath("skeleton").iterdir(), key=lambda entry: entry.name):
        if entry.is_file() and not entry.name.endswith((".pyc", ".nbi", ".nbc")):
            digest.update(entry.read_bytes())
    places = {name: {marker: asdict(place) for marker, place in one.places.items()} for name, one in marker_sets.items()}
    pairs = {name: one.pairs for name, one in marker_sets.items()}
    digest.update(json.dumps([places, pairs, seed, np.__version__], sort_keys=True).encode())
    return digest.hexdigest()[:32]


_PARTS = ("mean", "basis", "variance", "templates")


def _kept(path: Path, markers: int) -> tuple[Floats, ...] | None:
    """The parts of the shapes in this file; None where there is none, or it is damaged."""
    import zipfile

    try:
        with np.load(path, allow_pickle=False) as file:
            parts = tuple(file[name] for name in _PARTS)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = parts[0].shape == (markers, 3) and parts[1].shape == (markers, 3, LATENTS) and parts[3].shape[1:] == (LATENTS,)
    return parts if whole and all(np.isfinite(part).all() for part in parts) else None


def _keep(path: Path, parts: tuple[Floats, ...]) -> None:
    """Keep the parts; where the folder cannot be written, they are made again the next time."""
    import io

    from asterism.files.atomic import write_atomically

    buffer = io.BytesIO()
    mean, basis, variance, templates = parts
    np.savez(buffer, mean=mean, basis=basis, variance=variance, templates=templates)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, buffer.getvalue())
    except OSError:
        return
