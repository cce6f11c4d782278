"""Files and folders as a command line names them in; the recordings among them, and a place for the output of each, out."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from asterism.cli import _console
from asterism.errors import AsterismError


@dataclass(frozen=True)
class Trial:
    """A recording of a run.

    path    the file
    place   where an output of it goes below the folder for outputs
    folder  the folder by which it was given, or None for a file that was named itself
    """

    path: Path
    place: Path
    folder: Path | None = None


def trials(given: Sequence[Path], batch: _console.Batch, *, without: Path | None = None) -> list[Trial]:
    """The recordings that files and folders name, each once, in order; those of a folder by their paths.

    Of a folder, all files count whose suffix is that of a recording, at any depth. Names that begin with a dot are left out, and so is
    the folder `without`, where the outputs go. `batch` learns which files were found in folders, and which folders cannot be opened.

    A file that was named itself goes to the top of the folder for outputs; what was found in a single folder keeps its path below that
    folder. With several folders, or where two files would go to one place, all keep their path below the folder that they share.
    A folder without a recording counts as a file that failed. Raises AsterismError where it is all that was given, or two files still would
    go to one place (on a system that does not distinguish capital letters).
    """
    found: dict[Path, tuple[Path, Path | None]] = {}
    for path in given:
        if path.is_dir():
            inside = list(_recordings_in(path, without, batch))
            # a folder among others costs itself alone
            if not inside:
                nothing = AsterismError(f"{path} holds no recording (C3D, TRC, CSV, TSV, MAT, MOT, STO, NPZ or XDF); name another folder.")
                if len(given) == 1:
                    raise nothing
                with batch.file(path):
                    raise nothing
            for file in inside:
                # a file that is named twice, or by two links, is one file
                found.setdefault(_console.real_path(file), (file, path))
        else:
            found.setdefault(_console.real_path(path), (path, None))
    # only what was found may be passed over; what was named must be told
    batch.in_folders |= frozenset(file for file, folder in found.values() if folder is not None)
    files = list(found.values())
    several = sum(path.is_dir() for path in given) > 1 or len({path.is_dir() for path in given}) > 1
    places = [Path(file.name) if folder is None else file.relative_to(folder) for file, folder in files]
    if several or _clash(places) is not None:
        # as they were given, links and all: the outputs should look like the inputs
        absolute = [Path(os.path.abspath(file)) for file, _ in files]
        shared = os.path.commonpath([str(file.parent) for file in absolute])
        places = [file.relative_to(shared) for file in absolute]
    clash = _clash(places)
    if clash is not None:
        first, second = (files[at][0] for at in clash)
        raise AsterismError(f"{first} and {second} would both become {places[clash[1]]}; give them one after the other.")
    return [Trial(file, place, folder) for (file, folder), place in zip(files, places, strict=True)]


def recordings_of(given: Sequence[Path], batch: _console.Batch) -> list[Path]:
    """The files that a command reads: those named, and those in the folders named; see `trials`."""
    return [trial.path for trial in trials(given, batch)]


def outputs_of(found: Sequence[Trial], folder: Path, option: str = "-o") -> list[Path]:
    """Where the outputs of the recordings go, below `folder`. Raises AsterismError where it cannot be a folder, or not be written to."""
    check_folder(folder, option)
    return [folder / trial.place for trial in found]


def copies_of(found: Sequence[Trial], folder: Path, others: Sequence[Path | None], option: str = "-o") -> dict[Path, Path]:
    """Where the copy of each recording goes, as C3D, below `folder`; `others` are read, too.

    Raises AsterismError where it would be an input, or two recordings would have the same.
    """
    targets = {trial.path: target.with_suffix(".c3d") for trial, target in zip(found, outputs_of(found, folder, option), strict=True)}
    inputs = {_console.real_path(path): path for path in (*targets, *others) if path is not None}
    taken: dict[str, Path] = {}
    for path, target in targets.items():
        if (one := inputs.get(_console.real_path(target))) is not None:
            raise AsterismError(f"the copy of {path} would replace {one}, which is an input; name another folder with {option}.")
        # walk.trc and walk.c3d have one copy between them
        if (other := taken.setdefault(str(target).casefold(), path)) != path:
            raise AsterismError(f"{other} and {path} would both become {target}; give them one after the other.")
    return targets


def check_folder(folder: Path, option: str = "-o") -> None:
    """Raise AsterismError where a folder for outputs is a file, or cannot be made or written to. Nothing is made."""
    from tempfile import TemporaryFile

    if folder.exists() and not folder.is_dir():
        raise AsterismError(f"{folder} is a file; {option} takes the folder for the outputs.")
    # what is not there yet is made below the innermost folder that is
    above = next((one for one in (folder, *folder.absolute().parents) if os.path.lexists(one)), folder)
    try:
        # asking for permissions says less than trying
        with TemporaryFile(dir=above):
            pass
    except OSError as problem:
        where = "" if above == folder else f", because nothing can be written to {above}"
        raise AsterismError(
            f"the folder {folder} cannot be used for the outputs{where} ({(problem.strerror or 'it fails').lower()}); "
            f"name another with {option}."
        ) from None


def check_output(path: Path, target: Path, overwrite: bool, option: str = "-o") -> None:
    """Raise AsterismError where the output of a file is there already and must not be replaced."""
    if target.exists() and not overwrite:
        what = "is the input itself" if target.samefile(path) else "exists"
        raise AsterismError(f"{path}: {target} {what}; choose another folder with {option}, or replace it with --overwrite.")


def _clash(places: Sequence[Path]) -> tuple[int, int] | None:
    """Two of the places that are one where capital letters do not count."""
    taken: dict[str, int] = {}
    for at, place in enumerate(places):
        other = taken.setdefault(place.as_posix().casefold(), at)
        if other != at:
            return other, at
    return None


def _recordings_in(folder: Path, without: Path | None, batch: _console.Batch) -> Iterator[Path]:
    """The files of a folder and those below it that have a recording's suffix. Links are followed; each folder is entered once."""
    from asterism import formats

    seen = set() if without is None else {_console.real_path(without)}

    def cannot_open(problem: OSError) -> None:
        with batch.file(Path(str(problem.filename))):
            raise problem

    for at, folders, files in os.walk(folder, onerror=cannot_open, followlinks=True):
        real = _console.real_path(Path(at))
        # a link to a folder above would be walked for ever
        if real in seen:
            folders.clear()
            continue
        seen.add(real)
        # in place: this is how `os.walk` learns where not to go
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(files):
            if not name.startswith(".") and formats.is_recording_file(name):
                yield Path(at) / name
