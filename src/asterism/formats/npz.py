"""NPZ, Asterism's own container without pickle: recordings and clouds in, the same out, bit for bit."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, NoMarkers, cause_of
from asterism.files.atomic import write_atomically
from asterism.files.npz import arrays_of_npz, most_unpacked
from asterism.files.text import read_bytes
from asterism.formats._columns import Points, recording_of
from asterism.formats._confidence import LabelConfidence
from asterism.formats._writing import all_points
from asterism.recording import Clouds, Event, Evidence, Recording, as_vertical, log_as_text, log_from_text
from asterism.recording.arrays import nan_median

VERSION = 1


def read_npz(path: Path) -> Points:
    """The points of an NPZ file of Asterism: of a recording, or of clouds with the n-th point of each frame as *n.

    Raises AsterismError, naming the file, where it is damaged, of a later version, or not of Asterism.
    """
    # The kind decides which arrays there must be.
    clouds = read_npz_clouds(path)
    if clouds is not None:
        return _points_of_clouds(clouds)
    stored = _arrays(path)
    try:
        notes = json.loads(str(stored["notes"]))
        positions = np.array(stored["positions"], dtype=np.float64)
        labels = tuple(str(label) for label in stored["labels"])
        events = tuple(Event(str(e[0]), float(e[1]), str(e[2])) for e in notes.get("events", []))
        if positions.ndim != 3 or positions.shape[1:] != (len(labels), 3) or np.isinf(positions).any():
            raise ValueError(f"positions {positions.shape} do not fit {len(labels)} labels, or are infinite")
        # A sample is there in all coordinates or not at all.
        positions[np.isnan(positions).any(axis=2)] = np.nan
        rate = float(stored["rate"])
        if not np.isfinite(rate) or rate <= 0:
            raise ValueError(f"frame rate {rate}")
        first_time = notes.get("first_time")
        return Points(
            positions,
            labels,
            rate,
            "NPZ",
            units="m",
            kinds=tuple(str(kind) for kind in notes["kinds"]) if len(notes.get("kinds", [])) == len(labels) else None,
            declared=as_vertical(stored["vertical"]),
            first_frame=int(notes.get("first_frame", 1)),
            first_time=None if first_time is None else float(first_time),
            events=events,
            subject=str(notes.get("subject", "")),
            log=log_from_text(str(notes.get("log", "[]"))),
        )
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, AttributeError, AsterismError) as problem:
        raise AsterismError(f"{path} is not a recording or clouds of Asterism, or is damaged ({problem}); write it again.") from problem


def read_npz_clouds(path: Path) -> Clouds | None:
    """The clouds in an NPZ file, or None where it holds a recording. Raises AsterismError where it is damaged or not of Asterism."""
    stored = _arrays(path, only_kind=True)
    if str(stored.get("kind")) != "clouds":
        return None
    stored = _arrays(path)
    try:
        xyz, offsets = np.array(stored["xyz"], dtype=np.float64), np.array(stored["offsets"], dtype=np.int64)
        columns = np.array(stored["columns"], dtype=np.int64)
        # Offsets are followed blindly later, so that they are checked here once.
        fits = xyz.ndim == 2 and xyz.shape[1] == 3 and offsets.ndim == 1 and len(offsets) > 0 and columns.shape == (len(xyz),)
        if not fits or offsets[0] != 0 or offsets[-1] != len(xyz) or (np.diff(offsets) < 0).any() or not np.isfinite(xyz).all():
            raise ValueError("its points and frames do not fit together")
        rate = float(stored["rate"])
        if not np.isfinite(rate) or rate <= 0:
            raise ValueError(f"frame rate {rate}")
        tracks = np.array(stored["tracks"], dtype=np.int64) if "tracks" in stored else None
        if tracks is not None and tracks.shape != (len(xyz),):
            raise ValueError("its points and tracks do not fit together")
        return Clouds(xyz, offsets, rate, as_vertical(stored["vertical"]), columns, tracks)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, AsterismError) as problem:
        raise AsterismError(f"{path} is damaged ({problem}); write it again.") from problem


def write_npz(path: Path, recording: Recording, confidence: LabelConfidence | None = None) -> list[str]:
    """Write positions, labels, rate, vertical, events and the confidence of labels as they are. Returns what the format cannot carry."""
    positions, labels, omitted = all_points(recording, "NPZ", events=True)
    # Points that the file had computed must not become markers on the way.
    kinds = list[str]()
    if isinstance(recording.source, Points) and len(labels) > len(recording.labels):
        kinds = ["marker"] * len(recording.labels) + ["computed"] * (len(labels) - len(recording.labels))
    notes = {
        "events": [[event.label, event.time, event.context] for event in recording.events],
        "first_frame": recording.first_frame,
        "subject": str(recording.metadata.get("subject", "")),
        "kinds": kinds,
        "log": log_as_text(recording.log),
    }
    start = recording.metadata.get("first_time")
    if isinstance(start, int | float):
        notes["first_time"] = float(start)
    certain: dict[str, Any] = {}
    if confidence is not None:
        certain = {"confidence": confidence.values, "confidence_labels": np.array(confidence.names, dtype=str)}
    _save(
        path,
        kind="recording",
        **certain,
        positions=positions,
        labels=np.array(labels, dtype=str).reshape(len(labels)),
        rate=recording.rate,
        vertical=recording.vertical,
        notes=json.dumps(notes),
    )
    return omitted


def read_npz_confidence(path: Path) -> LabelConfidence | None:
    """The confidence of labels in an NPZ file, or None where it has none. Raises AsterismError where it is damaged."""
    stored = _arrays(path)
    if "confidence" not in stored:
        return None
    try:
        names = tuple(str(name) for name in stored["confidence_labels"])
        values = np.array(stored["confidence"], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as problem:
        raise AsterismError(f"{path} is damaged ({problem}); write it again.") from problem
    if values.ndim != 2 or values.shape[1] != len(names) or not ((values >= 0) & (values <= 1)).all():
        raise AsterismError(f"{path} is damaged (its labels and their confidence do not fit together); write it again.")
    return LabelConfidence(names, values)


def read_npz_evidence(path: Path) -> Evidence | None:
    """The evidence of the points of clouds in an NPZ file, or None where it has none. Raises AsterismError where it is damaged."""
    clouds = read_npz_clouds(path)
    if clouds is None:
        return None
    stored = _arrays(path)
    if "residual" not in stored:
        return None
    try:
        evidence = Evidence(
            np.array(stored["residual"], dtype=np.float64),
            np.array(stored["covariance"], dtype=np.float64),
            np.array(stored["cameras"], dtype=np.bool_),
            tuple(str(name) for name in stored["camera_names"]),
            np.array(stored["depth_scale"], dtype=np.float64),
        )
    except (KeyError, TypeError, ValueError) as problem:
        raise AsterismError(f"{path} is damaged ({problem}); write it again.") from problem
    points, cameras = len(clouds.xyz), len(evidence.camera_names)
    # Every point needs every kind of evidence.
    shapes = (evidence.residual.shape, evidence.covariance.shape, evidence.cameras.shape, evidence.depth_scale.shape)
    if shapes != ((points,), (points, 3, 3), (points, cameras), (points,)):
        raise AsterismError(f"{path} is damaged (its points and their evidence do not fit together); write it again.")
    return evidence


def write_npz_clouds(path: Path, clouds: Clouds, evidence: Evidence | None = None) -> list[str]:
    """Write clouds, and the evidence of their points, unchanged and completely."""
    stored: dict[str, Any] = {"xyz": clouds.xyz, "offsets": clouds.offsets, "columns": clouds.columns, "vertical": clouds.vertical}
    if clouds.tracks is not None:
        stored["tracks"] = clouds.tracks
    if evidence is not None:
        stored |= {
            "residual": evidence.residual,
            "covariance": evidence.covariance,
            "cameras": evidence.cameras,
            "camera_names": np.array(evidence.camera_names, dtype=str),
            "depth_scale": evidence.depth_scale,
        }
    _save(path, kind="clouds", rate=clouds.rate, **stored)
    return []


def described_clouds(path: Path, clouds: Clouds) -> dict[str, Any]:
    """What a file of clouds holds, as plain values."""
    counts, read = clouds.counts, recording_of(path, _points_of_clouds(clouds))
    return {
        "file": str(path),
        "format": "NPZ clouds",
        "frames": len(clouds),
        "rate": clouds.rate,
        "duration": len(clouds) / clouds.rate,
        "units": "m",
        "vertical": [float(v) for v in read.vertical],
        "vertical_from": read.metadata["vertical_from"],
        "points_per_frame": {
            "fewest": int(counts.min()) if len(counts) else 0,
            "median": float(nan_median(np.asarray(counts, dtype=np.float64), axis=0)) if len(counts) else 0.0,
            "most": int(counts.max()) if len(counts) else 0,
        },
        "findings": read.metadata.get("findings", ()),
    }


def _save(path: Path, **arrays: Any) -> None:
    buffer = io.BytesIO()
    stored: dict[str, Any] = {"asterism": VERSION, **arrays}
    np.savez_compressed(buffer, **stored)
    # A file that packs very well would be refused as one that claims too much.
    if sum(np.asarray(array).nbytes for array in stored.values()) > most_unpacked(len(buffer.getvalue())) // 2:
        buffer = io.BytesIO()
        np.savez(buffer, **stored)  # packed so far, it could not be told from a file that claims too much
    write_atomically(path, buffer.getvalue())


def _arrays(path: Path, only_kind: bool = False) -> dict[str, NDArray[Any]]:
    """The arrays of a file, refused before they are loaded where they claim more than they can hold."""
    data = read_bytes(path)
    try:
        stored = arrays_of_npz(data, ("asterism", "kind") if only_kind else None)
    except Exception as problem:  # a damaged archive raises anything from zlib.error to SyntaxError
        raise AsterismError(f"{path} is damaged ({cause_of(problem)}); write it again.") from problem
    version = stored.get("asterism")
    if version is None or version.shape != () or version.dtype.kind not in "iu":
        raise NoMarkers(f"{path} is an NPZ file, but none that Asterism wrote; write it with asterism.write.")
    if int(version) > VERSION:
        raise AsterismError(f"{path} has format version {int(version)}, this Asterism reads up to {VERSION}; install a later one.")
    return stored


def _points_of_clouds(clouds: Clouds) -> Points:
    counts = clouds.counts
    most = int(counts.max()) if len(counts) else 0
    positions = np.full((len(clouds), most, 3), np.nan)
    # The n-th point of each frame goes into column n.
    place = np.arange(len(clouds.xyz)) - clouds.offsets[clouds.frame_of]
    positions[clouds.frame_of, place] = clouds.xyz
    return Points(positions, tuple(f"*{i + 1}" for i in range(most)), clouds.rate, "NPZ", declared=clouds.vertical)
