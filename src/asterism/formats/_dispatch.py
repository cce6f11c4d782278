"""Files of all formats: content and suffix choose the reader, the suffix chooses the writer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError, NoMarkers, guarded_reading
from asterism.files.text import decoded, lines_of
from asterism.findings import Finding
from asterism.formats._columns import Points, recording_of
from asterism.formats._confidence import LabelConfidence
from asterism.formats._describe import described
from asterism.formats._writing import all_points
from asterism.formats.c3d.analog import AnalogChannel
from asterism.recording import Clouds, Evidence, Ints, Labelling, MarkerSet, Recording, as_vertical, label_states

_READERS = {
    "TRC": "trc.read_trc",
    "Motive CSV": "csv_motive.read_motive",
    "OptiTrack CSV": "csv_optitrack.read_optitrack",
    "Nexus CSV": "csv_nexus.read_nexus",
    "CSV long": "csv_long.read_long",
    "CSV": "csv_wide.read_wide",
    "QTM TSV": "tsv.read_tsv",
    "QTM MAT": "mat.read_mat",
    "storage": "storage.read_marker_table",
    "NPZ": "npz.read_npz",
    "XDF": "xdf.read_xdf",
}
"""The function that reads each kind of file, and its module, which is imported when a file needs it."""
_WRITERS = {
    ".trc": "trc.write_trc",
    ".csv": "csv_wide.write_wide",
    ".tsv": "tsv.write_tsv",
    ".mat": "mat.write_mat",
    ".mot": "storage.write_marker_table",
    ".sto": "storage.write_marker_table",
    ".npz": "npz.write_npz",
}
_TABLES = (".mot", ".sto", ".csv")
_FORMS_NOT_WRITTEN = ("Motive CSV", "OptiTrack CSV", "Nexus CSV")
"""Other programs' CSV files that are read; a CSV that is written has Asterism's own columns."""
_WITH_CONFIDENCE = (".csv", ".npz")
"""Suffixes of text and NPZ files that have a place for the confidence of labels."""
_KNOWN = "C3D, TRC, CSV, TSV, MAT, MOT, STO, NPZ and XDF"


def read(path: str | Path, markers: Any = None, vertical: ArrayLike | str | None = None, stream: str | None = None) -> Recording:
    """A recording from a file: C3D, TRC, CSV (wide, long, Motive's, Nexus'), QTM's TSV and MAT, MOT, STO or NPZ.

    markers   None: every physical point, under its label in the file; else a marker set (its name, a TOML file, a
              list of names, a `MarkerSet`): its columns in its order, NaN where the file lacks one
    vertical  None: what the file declares or its format defines, else what the data show; or "z", "-y", a vector
    stream    of an XDF with several streams of motion capture the name, or the number, of one; None: that with the most markers

    Positions are metres. Raises AsterismError, naming the file, where it cannot be read, has no marker of the set, has one of
    them twice, or the vertical is not determined.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> lost = write("walk.c3d", walk)
    >>> read("walk.c3d", markers=["LKNE", "RKNE"])
    Recording(file: walk.c3d, frames: 20 at 100 Hz (0.2 s), labels: LKNE, RKNE)
    """
    from asterism.formats.c3d._reader import read_c3d

    # Arguments are checked before the file is opened: their message must not name the file.
    path = Path(path)
    wanted = None if markers is None else MarkerSet.load(markers)
    up = None if vertical is None else as_vertical(vertical)
    with guarded_reading(path):
        kind = _kind_of(path)
        if stream is not None and kind != "XDF":
            raise AsterismError(f"{path} is no XDF, which alone has streams; leave --stream out.")
        if kind == "C3D":
            return read_c3d(path, wanted, up)
        if kind == "skeleton":
            raise NoMarkers(f"{path} holds the bones of a skeleton and no markers; give the recording of which it was made.")
        # Points of cameras are no markers: a folder may hold both, and goes on with the next file.
        if kind == "2D CSV":
            raise NoMarkers(
                f"{path} holds 2D points of cameras and no markers in space; reconstruct them with `asterism reconstruct` first."
            )
        chosen = {} if stream is None else {"wanted": stream}
        return recording_of(path, _function(_READERS[kind])(path, **chosen), wanted, up)


def read_clouds(path: str | Path, vertical: ArrayLike | str | None = None) -> Clouds:
    """The anonymous points of a file, frame by frame: of an NPZ or long CSV of clouds, or of any recording without its labels.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> lost = write("walk.trc", walk)
    >>> read_clouds("walk.trc").counts[:3]
    array([15, 15, 15])
    """
    from asterism.formats import npz

    path = Path(path)
    with guarded_reading(path):
        if _kind_of(path) == "NPZ":
            clouds = npz.read_npz_clouds(path)
            if clouds is not None:
                return replace(clouds, vertical=read(path, vertical=vertical).vertical)
        # Anything else is read as a recording, and loses its labels.
        return read(path, vertical=vertical).clouds()


def write(
    path: str | Path,
    recording: Recording | Clouds,
    *,
    labelling: Labelling | None = None,
    clouds: Clouds | None = None,
    analog: Sequence[AnalogChannel] = (),
) -> list[str]:
    """Write a recording in the format of the suffix; clouds as .npz or .csv. An existing file is replaced completely or not at all.

    A .csv has a row per frame, a .long.csv a row per sample (frame, time, marker, x, y, z).

    labelling  what gave the recording its labels, by `Recording.with_labelling`: its confidence is written, too, in C3D, CSV and NPZ;
               `read_confidence` reads it
    clouds     the clouds that were labelled, by default the recording's own without its labels
    analog     channels of a new C3D file, all with as many samples in each frame

    Returns what the format cannot carry, a phrase each; an empty list where it carries everything. A recording that was read
    from C3D and is written as C3D keeps everything else unchanged.

    Raises AsterismError where the suffix is unknown or the file cannot be written.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> write("walk.c3d", walk)
    []
    >>> write("walk.trc", walk)  # what TRC cannot carry
    ['the vertical: TRC readers take Y as up or determine it from the data']
    """
    from asterism.formats import csv_long, npz
    from asterism.formats.c3d._writer import write_c3d

    path = Path(path)
    suffix = path.suffix.casefold()
    confidence = None if labelling is None else LabelConfidence.of_labelling(labelling)
    if isinstance(recording, Clouds):
        if suffix == ".npz":
            return npz.write_npz_clouds(path, recording)
        if suffix == ".csv":
            return csv_long.write_clouds(path, recording)
        raise AsterismError(f"{path}: anonymous clouds are written as .npz or .csv; choose one of them.")
    # The form of another program's file cannot be written: its header says what only that program knows.
    own_form = str(recording.metadata.get("format", ""))
    if suffix == ".csv" and own_form in _FORMS_NOT_WRITTEN:
        lost = write(path, replace(recording, metadata={**recording.metadata, "format": "CSV"}), labelling=labelling, clouds=clouds)
        return [f"the form of {'an' if own_form[0] in 'AEIOU' else 'a'} {own_form}, and is a CSV of Asterism's instead", *lost]
    if path.name.casefold().endswith(".long.csv"):
        return csv_long.write_long(path, recording, confidence)
    if suffix == ".c3d":
        states = None if labelling is None else label_states(labelling, recording.clouds() if clouds is None else clouds)
        return write_c3d(path, _with_computed(recording), confidence, states, analog)
    check_suffix(path)
    # What a format cannot hold is said, never dropped in silence.
    left = ["the analog channels"] if analog else []
    if confidence is None:
        return [*_function(_WRITERS[suffix])(path, recording), *left]
    if suffix in _WITH_CONFIDENCE:
        return [*_function(_WRITERS[suffix])(path, recording, confidence), *left]
    return [*_function(_WRITERS[suffix])(path, recording), "the confidence of the labels", *left]


def read_confidence(path: str | Path, *, opened: Any = None) -> LabelConfidence | None:
    """The confidence of the labels in a C3D, CSV or NPZ file; None where it has none. Raises AsterismError where it cannot be read.

    opened  the `source` of a recording that was read from the file: a C3D file is not read again
    """
    from asterism.formats import csv_long, csv_wide, npz
    from asterism.formats.c3d._confidence import confidence_of
    from asterism.formats.c3d._file import C3DFile, open_c3d

    path = Path(path)
    if isinstance(opened, C3DFile) and opened.path == str(path):
        return confidence_of(opened)
    kind = _kind_of(path)
    if kind == "C3D":
        return confidence_of(open_c3d(path))
    readers = {"NPZ": npz.read_npz_confidence, "CSV": csv_wide.read_wide_confidence, "CSV long": csv_long.read_long_confidence}
    return readers[kind](path) if kind in readers else None


def read_evidence(path: str | Path) -> Evidence | None:
    """The evidence of the points of an NPZ file of clouds, as `write_points` wrote it; None where the file has none.

    Raises AsterismError where the file cannot be read.
    """
    from asterism.formats import npz

    path = Path(path)
    with guarded_reading(path):
        return npz.read_npz_evidence(path) if _kind_of(path) == "NPZ" else None


def is_recording_file(path: str | Path) -> bool:
    """Whether a name's suffix is that of a recording; nothing is read.

    >>> is_recording_file("walk.C3D"), is_recording_file("notes.txt")
    (True, False)
    """
    return Path(path).suffix.casefold() in (".c3d", ".xdf", *_WRITERS)


def check_suffix(path: str | Path) -> None:
    """Raise AsterismError where points cannot be written in a format with this suffix."""
    if Path(path).suffix.casefold() in (".bvh", ".glb", ".gltf"):
        raise AsterismError(
            f"{path}: this format holds bones and no markers; fit a skeleton to them, as `asterism convert` does, and write that."
        )
    if Path(path).suffix.casefold() == ".xdf":
        raise AsterismError(f"{path}: XDF is read and not written; write .c3d, {', '.join(_WRITERS)}.")
    if not is_recording_file(path):
        raise AsterismError(f"{path}: no format has the suffix {Path(path).suffix or '(none)'}; write .c3d, {', '.join(_WRITERS)}.")


def write_points(path: str | Path, clouds: Clouds, evidence: Evidence, columns: Ints) -> list[str]:
    """Write reconstructed points in the format of the suffix: .npz and .csv as clouds, others as unlabelled columns *1, *2, ...

    columns  (P,) int: the column of each point, for formats with columns; each column has at most one point of a frame

    NPZ keeps all of the evidence, C3D residuals up to 2.55 mm and the first seven cameras. Returns what the format cannot carry, a
    phrase each.
    Raises AsterismError where the suffix is unknown or the file cannot be written.
    """
    from asterism.formats import npz
    from asterism.formats.c3d._writer import write_c3d_points

    path = Path(path)
    suffix = path.suffix.casefold()
    if suffix == ".npz":
        return npz.write_npz_clouds(path, clouds, evidence)
    omitted = ["the evidence of each point (residual, covariance, cameras)"]
    if suffix == ".csv":
        return write(path, clouds) + omitted
    # Formats with columns need one for each track.
    frames, many = clouds.frame_of, int(columns.max(initial=-1)) + 1
    positions = np.full((len(clouds), many, 3), np.nan)
    positions[frames, columns] = clouds.xyz
    recording = Recording(positions, tuple(f"*{i + 1}" for i in range(many)), clouds.rate, clouds.vertical)
    if suffix != ".c3d":
        return write(path, recording) + omitted
    residual, cameras = np.zeros((len(clouds), many)), np.zeros((len(clouds), many, len(evidence.camera_names)), dtype=np.bool_)
    # C3D has one number for the distance from a ray, so that the depth is folded into it.
    residual[frames, columns] = evidence.residual * evidence.depth_scale
    cameras[frames, columns] = evidence.cameras
    write_c3d_points(path, recording, residual, cameras)
    beyond = evidence.camera_names[7:]
    return [
        "the points' covariances",
        *([f"which points {', '.join(beyond)} saw, because C3D has room for seven cameras"] if beyond else []),
    ]


def _with_computed(recording: Recording) -> Recording:
    """A recording from a text file with the computed points of that file as columns; any other as it is."""
    if not isinstance(recording.source, Points):
        return recording
    positions, labels, _ = all_points(recording, "C3D", events=True)
    # Without its source it is written as a new file, with all points as markers of their own.
    return replace(recording, positions=positions, labels=labels, source=None, origin=None, taken=())


def describe(path: str | Path) -> dict[str, Any]:
    """What a file holds, as plain values: format, frames, rate, units, vertical, points, gaps, events; as `findings` a tuple of `Finding`.

    Raises AsterismError where the file cannot be read.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> lost = write("walk.trc", walk)
    >>> holds = describe("walk.trc")
    >>> holds["format"], holds["frames"], holds["rate"]
    ('TRC', 20, 100.0)
    """
    path = Path(path)
    with guarded_reading(path):
        return _described(path)


def _described(path: Path) -> dict[str, Any]:
    kind = _kind_of(path)
    if kind == "C3D":
        from asterism.formats.c3d._describe import describe_c3d

        return describe_c3d(path)
    if kind == "skeleton":
        from asterism.formats import skeletons

        return skeletons.describe_skeleton(path)
    if kind == "2D CSV":
        from asterism.formats import csv_blobs

        return csv_blobs.describe_blobs(path)
    from asterism.formats import npz, storage

    if kind == "NPZ":
        clouds = npz.read_npz_clouds(path)
        if clouds is not None:
            return npz.described_clouds(path, clouds)
    if kind == "storage":
        table = storage.read_table(path)
        if not storage.holds_markers(table):
            return storage.described_table(path, table)
    # A table of values is a CSV, too: only when no markers are in it, it is read as one.
    try:
        points = _function(_READERS[kind])(path)
    except AsterismError:
        if kind != "CSV":
            raise
        values = storage.table_or_none(path)
        # positions that cannot be read are a recording with a fault, and no table of values
        if values is None or storage.holds_markers(values, strictly=False):
            raise
        return storage.described_table(path, values)
    return described(path, points)


def convert(source: str | Path, target: str | Path, vertical: ArrayLike | str | None = None) -> list[str]:
    """Read one file and write another, a recording or a table of values (joint angles in MOT, STO, CSV).

    Returns what the target could not carry, as `write` does. Raises AsterismError as `read` and `write` do.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> lost = write("walk.npz", walk)
    >>> convert("walk.npz", "walk.trc")
    ['the vertical: TRC readers take Y as up or determine it from the data']
    """
    return convert_and_tell(source, target, vertical)[1]


def convert_and_tell(source: str | Path, target: str | Path, vertical: ArrayLike | str | None = None) -> tuple[list[Finding], list[str]]:
    """`convert`, with what reading the source found, and what the target could not carry."""
    from asterism.formats import npz, storage

    source, target = Path(source), Path(target)
    with guarded_reading(source):
        kind = _kind_of(source)
    if kind == "skeleton":
        from asterism.formats import skeletons

        found = skeletons.read_skeleton(source, vertical=vertical)
        return list(found.findings), skeletons.write_skeleton(target, found.motion)
    # A CSV may be either: angles are recognised by having no groups of x, y and z.
    if kind in ("storage", "CSV"):
        table = storage.table_or_none(source)
        if table is not None and not storage.holds_markers(table, strictly=kind == "storage"):
            if target.suffix.casefold() not in _TABLES:
                raise AsterismError(
                    f"{source} holds a table of values and no marker positions; write it as {', '.join(_TABLES)}, not as {target.name}."
                )
            return [], storage.write_table(target, table)
    if kind == "NPZ":
        with guarded_reading(source):
            clouds = npz.read_npz_clouds(source)
        if clouds is not None and target.suffix.casefold() in (".npz", ".csv"):
            return [], write(target, clouds)
    recording = read(source, vertical=vertical)
    return list(recording.warnings), write(target, recording)


def _function(name: str) -> Callable[..., Any]:
    """The function of a name as in `_READERS`."""
    module, _, function = name.partition(".")
    return cast("Callable[..., Any]", getattr(import_module(f"{__package__}.{module}"), function))


def _kind_of(path: Path) -> str:
    """Which reader a file needs: by its content, or by its suffix where the content leaves it open."""
    suffix = path.suffix.casefold()
    # Content decides before the suffix: files are renamed more often than rewritten.
    with guarded_reading(path), path.open("rb") as file:
        head = file.read(8192)
    if not head.strip(b"\x00 \t\r\n"):
        raise AsterismError(f"{path} is empty; export it again.")
    if suffix in (".bvh", ".glb", ".gltf") or head[:4] == b"glTF":
        return "skeleton"
    if head[:4] == b"PK\x03\x04":
        return "NPZ"
    if head[:4] == b"XDF:":
        return "XDF"
    if head.startswith(b"MATLAB ") or head[1:4] == b"HDF" or suffix == ".mat":
        return "QTM MAT"
    if suffix == ".npz":
        raise AsterismError(f"{path} is not an NPZ file; it was damaged or has the wrong suffix.")
    # UTF-16 is text with zeros in it, which its mark gives away.
    text_like = b"\x00" not in head or head[:2] in (b"\xff\xfe", b"\xfe\xff")
    by_content = _text_kind(path, head) if text_like else None
    if by_content is not None:
        return by_content
    # The second byte of every C3D file is 80; other binary files seldom begin so.
    if suffix == ".c3d" or (not text_like and len(head) > 1 and head[1] == 0x50):
        return "C3D"
    by_suffix = {".trc": "TRC", ".csv": "CSV", ".txt": "CSV", ".tsv": "QTM TSV", ".mot": "storage", ".sto": "storage"}.get(suffix)
    if by_suffix is None:
        raise AsterismError(f"{path}: Asterism does not read this format (it reads {_KNOWN}); export it in one of them.")
    return by_suffix


def _text_kind(path: Path, head: bytes) -> str | None:
    """The format by the first lines of a file, or None."""
    from asterism.formats import csv_blobs, csv_long, csv_nexus, csv_optitrack

    # Ever weaker signs, the most telling first.
    lines = lines_of(decoded(path, head))
    # A line `sep=;`, by which Excel reads, may stand above.
    first = next((line for line in lines if line.strip()), "").strip().strip('"').casefold()
    if first == "hierarchy":
        return "skeleton"
    if first.startswith("format version"):
        return "Motive CSV"
    if first.startswith("pathfiletype") or any(
        line.casefold().startswith("datarate") and "nummarkers" in line.casefold() for line in lines[:4]
    ):
        return "TRC"
    if any(line.startswith(("NO_OF_FRAMES", "MARKER_NAMES")) for line in lines[:16]):
        return "QTM TSV"
    # An endheader stands far down where a header lists many columns.
    if any(line.strip(" ,;\t").casefold() == "endheader" for line in lines[:200]):
        return "storage"
    if csv_optitrack.is_optitrack(lines):
        return "OptiTrack CSV"
    if csv_nexus.is_nexus(lines):
        return "Nexus CSV"
    if csv_blobs.is_blobs(lines):
        return "2D CSV"
    if csv_long.is_long(lines):
        return "CSV long"
    return None
