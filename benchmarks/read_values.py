"""The folders of recordings in; a hash of the values that the readers give of every file in each, kept in `read.json`, out.

A row that only reads its recordings measures what was read, and not the code that read it: a sentence of an error or a guard in a reader
makes no figure stale, another coordinate does. Reading everything takes a minute, so hashes are kept for as long as neither the readers nor
the files have changed.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.labelling.training.people import prefixes_of_people
from asterism.progress import Progress
from asterism.recording import Recording
from benchmarks.data import GAIT_BODY
from benchmarks.sources import Folder, Sources, index_of

KEPT = Path(__file__).with_name("read.json")

DIVIDED = ("cameras",)
"""Folders of which each folder in them is kept for itself; of the others each whole."""

SETS = (None, "helen-hayes", list(GAIT_BODY))
"""The marker sets with which recordings are read."""

DIGITS = 7
"""Significant digits of the numbers of rigs and boards: some lenses are fitted, and the fit's last digits differ from run to run."""

FRAMES = 10
"""Images of each source that are hashed, evenly spread; of a video the first."""


@dataclass(frozen=True)
class KeptFolder:
    """A folder of recordings: the hash of its index, of the sources of all readers, and of the values that they gave."""

    folder: str
    index: str
    readers: str
    values: str


def load(path: Path | None = None) -> dict[str, KeptFolder]:
    """The kept hashes by folder; none where the file does not exist."""
    path = path or KEPT
    if not path.exists():
        return {}
    return {entry["folder"]: KeptFolder(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))}


def contents(sources: Sources, recordings: Path | None, progress: Progress = lambda share, what: None) -> dict[str, Folder]:
    """What each folder of recordings holds: kept where it is of these files and readers, else read anew and kept.

    Without recordings the kept hashes are taken as they are.
    """
    kept = load()
    if recordings is not None:
        readers = sources.hash_of_readers()
        folders = list(_folders(recordings))
        now = {folder: index_of(recordings, [folder]) for folder in folders}
        new = [folder for folder in folders if folder not in kept or (kept[folder].index, kept[folder].readers) != (now[folder], readers)]
        for number, folder in enumerate(new):
            progress(number / len(new), folder)
            kept[folder] = KeptFolder(folder, now[folder], readers, values_of(recordings, folder))
        kept = {folder: kept[folder] for folder in folders}
        if new:
            progress(1.0, "")
            _save(kept)
    return {folder: Folder(own.index, own.values) for folder, own in kept.items()}


def values_of(recordings: Path, folder: str) -> str:
    """The hash of what every reader gives of every file in a folder of the recordings, and of the folders that are rigs."""
    digest = hashlib.sha256()
    for path in sorted((recordings / folder).rglob("*")):
        for name, reader in _readers_of(path):
            digest.update(f"{path.relative_to(recordings).as_posix()} {name}\n".encode())
            try:
                _add(digest.update, reader(path))
            except Exception:  # what a reader refuses, by whatever exception, no row has read
                digest.update(b"refused")
    return digest.hexdigest()


def _rounded(value: Any) -> Any:
    """Numbers to seven significant digits, all else as it is."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return [_rounded(inner) for inner in value.ravel().tolist()]
    if isinstance(value, float):
        return f"{value:.{DIGITS - 1}e}"
    return tuple(_rounded(inner) for inner in value) if isinstance(value, tuple) else value


def _save(kept: Mapping[str, KeptFolder]) -> None:
    text = ",\n".join(" " + json.dumps(asdict(kept[folder])) for folder in sorted(kept))
    temporary = KEPT.with_name(f"{KEPT.name}.{os.getpid()}.part")
    temporary.write_text(f"[\n{text}\n]\n", encoding="utf-8")
    os.replace(temporary, KEPT)


def _folders(recordings: Path) -> Iterator[str]:
    for folder in sorted(path for path in recordings.iterdir() if path.is_dir()):
        inside = sorted(path for path in folder.iterdir() if path.is_dir()) if folder.name in DIVIDED else [folder]
        yield from (path.relative_to(recordings).as_posix() for path in inside)


def _readers_of(path: Path) -> Iterator[tuple[str, Callable[[Path], Any]]]:
    """The readers that a file's name suits, or a folder's content, each with a name."""
    from asterism.calibration.boards import Board
    from asterism.cameras.files import is_rig_file, read_rig
    from asterism.detection.sources import IMAGES
    from asterism.detection.times import read_times
    from asterism.formats import is_recording_file, read, read_blobs, read_table

    suffix = path.suffix.casefold()
    if is_rig_file(path):
        yield "rig", read_rig
    if path.is_dir():
        return
    if is_recording_file(path):
        for number, markers in enumerate(SETS):
            yield f"recording {number}", partial(read, markers=markers)
    if suffix == ".csv":
        yield from (("blobs", read_blobs), ("times", read_times))
    if suffix in (".csv", ".mot", ".sto"):
        yield "table", read_table
    if suffix == ".toml":
        yield "board", Board.from_toml
    if suffix in (*IMAGES, ".mp4") or suffix[1:].isdigit():
        yield "images", _images


def _images(path: Path) -> list[Any]:
    """A source without its path, and some of its images."""
    from asterism.detection.sources import images, open_source, some_images

    source = open_source(path)
    if source.kind != "video":
        return [source.numbers, source.rate, *some_images(source, FRAMES)]
    return [source.numbers, source.rate, *(image for _, image in zip(range(FRAMES), images(source), strict=False))]


def _add(update: Callable[[bytes], None], value: Any) -> None:
    """Add a value to a hash: arrays by kind, shape and bits, records by their fields, without paths and what was found out about a file."""
    if isinstance(value, Recording):
        value = {
            **{name: getattr(value, name) for name in ("positions", "labels", "rate", "vertical", "events", "first_frame")},
            "subject": value.metadata.get("subject"),
            **({"people": people} if (people := prefixes_of_people(value.labels)) else {}),
        }
    if isinstance(value, Rig | Camera):
        value = {part.name: getattr(value, part.name) for part in fields(value) if part.name not in ("metadata", "lacks")}
        value = {name: _rounded(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray):
        update(f"{value.dtype.str}{value.shape}".encode())
        update(np.where(np.isnan(value), np.nan, value).tobytes() if value.dtype.kind == "f" else np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        for part in fields(value):
            if part.name not in ("path", "metadata", "lacks"):
                update(part.name.encode())
                _add(update, getattr(value, part.name))
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            update(str(key).encode())
            _add(update, inner)
    elif isinstance(value, list | tuple):
        update(f"{len(value)}".encode())
        for inner in value:
            _add(update, inner)
    else:
        update(f"{type(value).__name__} {value!r};".encode())
