"""The recordings of a session in; its persons, each with the trials, the standing trial and what a folder's settings say, out.

A laboratory has a folder for each person, or for each visit of a person: the recordings of one folder are one person's. Where standing
trials of one folder have names of several beginnings (ann-static, bob-static), so have its persons.
"""

from __future__ import annotations

import difflib
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from asterism.errors import AsterismError
from asterism.files.toml import read_toml
from asterism.recording import MarkerSet, shipped_marker_sets
from asterism.session.standing import is_standing_name, person_prefix

SETTINGS = "session.toml"
"""The file in a folder that says how its recordings are processed, and those of the folders below it."""


@dataclass(frozen=True)
class FolderSettings:
    """What the files `session.toml` of a folder and of those above it say; the nearer one counts.

    person     what reports call the person; by default the folder's path below the session
    model      that labels
    markers    without a model, the marker set worn
    static     the standing trial of the person
    vertical   what points up
    known_labels what the names are worth that points have: keep, check or ignore
    fill       as --fill of `asterism convert`
    leave_out  patterns of files that are no trials: "wand*", "test/*.c3d"
    measures   of the person by Plug-in-Gait's names, mm, degrees and kg
    files      that were read
    said       the file that says each of these, by its key
    """

    person: str = ""
    model: Path | None = None
    markers: str | None = None
    static: Path | None = None
    vertical: str | None = None
    known_labels: str | None = None
    fill: str | None = None
    leave_out: tuple[str, ...] = ()
    measures: Mapping[str, float] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    said: Mapping[str, Path] = field(default_factory=dict)

    def leaves_out(self, path: Path) -> bool:
        """Whether a recording is none of the trials."""
        return any(fnmatch.fnmatch(path.name, pattern) or path.match(pattern) for pattern in self.leave_out)


_TEXTS, _PATHS = ("person", "markers", "vertical", "known_labels", "fill"), ("model", "static")


def settings_of(folder: Path, root: Path) -> FolderSettings:
    """What holds in a folder: the settings of `root`, of the folders between, and its own, each over the one before.

    Raises AsterismError where a file is no TOML, has a key that is none, or a value of another kind, or names a marker set or a file
    that does not exist.
    """
    between = [folder, *folder.parents]
    chain = between[: between.index(root) + 1] if root in between else [folder]
    settings = FolderSettings()
    for one in reversed(chain):
        path = one / SETTINGS
        # what a folder calls its person is not what those below it are called
        settings = replace(settings, person="")
        if path.is_file():
            settings = _over(settings, path)
    return settings


def _over(settings: FolderSettings, path: Path) -> FolderSettings:
    read = read_toml(path)
    found: dict[str, Any] = {"files": (*settings.files, path), "said": {**settings.said, **dict.fromkeys(read, path)}}
    for key, value in read.items():
        if isinstance(value, str) and key in _TEXTS + _PATHS and not value.strip():
            raise AsterismError(f"{path}: {key} is empty; give it a value, or take the line out.")
        if key in _TEXTS and isinstance(value, str):
            found[key] = _marker_set(path, value) if key == "markers" else value
        elif key in _PATHS and isinstance(value, str):
            found[key] = path.parent / value
            if not found[key].is_file():
                what = "is a folder" if found[key].is_dir() else "does not exist"
                raise AsterismError(f"{path}: {key} names {found[key]}, which {what}; name a file.")
        elif key == "leave_out" and isinstance(value, list) and all(isinstance(one, str) for one in value):
            found[key] = (*settings.leave_out, *value)
        elif key == "measures" and isinstance(value, dict) and all(type(one) in (int, float) for one in value.values()):
            # capitals do not tell measures apart
            own = {name.casefold() for name in value}
            if len(own) < len(value):
                raise AsterismError(f"{path}: a measure is given twice, with other capitals; take one out.")
            above = {name: one for name, one in settings.measures.items() if name.casefold() not in own}
            found[key] = above | {name: float(one) for name, one in value.items()}
        else:
            raise AsterismError(f"{path}: {_wrong(key)}")
    return replace(settings, **found)


def _marker_set(path: Path, name: str) -> str:
    """The marker set that a file of settings names: shipped, or a file beside the settings, as a model is."""
    beside = path.parent / name
    name = str(beside) if name not in shipped_marker_sets() and beside.is_file() else name
    try:
        MarkerSet.load(name)
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from None
    return name


def _wrong(key: str) -> str:
    kinds = dict.fromkeys(_TEXTS, "a text") | dict.fromkeys(_PATHS, "the name of a file")
    kinds |= {"leave_out": "a list of patterns", "measures": "a table of numbers"}
    if key in kinds:
        return f"{key} must be {kinds[key]}."
    near = difflib.get_close_matches(key, kinds, 1)
    return f"{key} is no setting; {f'did you mean {near[0]}' if near else 'there are ' + ', '.join(kinds)}?"


@dataclass(frozen=True)
class PlannedTrial:
    """A recording, where its outputs go below their folders, and whether its name says that the person stands."""

    path: Path
    place: Path
    stands: bool


@dataclass(frozen=True)
class PlannedPerson:
    """A person of a session: what reports call them, their trials, and the settings of the folder."""

    name: str
    trials: tuple[PlannedTrial, ...]
    settings: FolderSettings

    @property
    def standing(self) -> Path | None:
        """The standing trial that the settings or names tell; None where it is told by what trials show."""
        named = [trial.path for trial in self.trials if trial.stands]
        return self.settings.static or (named[-1] if named else None)


def plan_session(recordings: Sequence[tuple[Path, Path]], roots: Sequence[Path]) -> list[PlannedPerson]:
    """The persons of a session, by their folders' order.

    recordings  each a file and where its outputs go; a file that a folder's settings leave out is none of them
    roots       the folders of the session, above which no settings are looked for

    Raises AsterismError where settings cannot be used, or two folders call their persons alike. Nothing but settings is read.
    """
    by_folder: dict[Path, list[PlannedTrial]] = {}
    for path, place in recordings:
        by_folder.setdefault(path.parent, []).append(PlannedTrial(path, place, is_standing_name(path)))
    persons, called = list[PlannedPerson](), dict[str, Path]()
    for folder, trials in by_folder.items():
        root = next((one for one in roots if one in (folder, *folder.parents)), folder)
        settings = settings_of(folder, root)
        kept = [trial for trial in trials if not settings.leaves_out(trial.path)]
        for prefix, own in _by_person(kept).items():
            below = own[0].place.parent.as_posix()
            name = settings.person or (folder.name if below == "." else below)
            name = f"{name} {prefix}" if prefix else name
            if name in called:
                raise AsterismError(f"{folder} and {called[name]} are both of {name}; give each a `person` of its own in {SETTINGS}.")
            called[name] = folder
            persons.append(PlannedPerson(name, tuple(own), settings))
    return persons


def _by_person(trials: Sequence[PlannedTrial]) -> dict[str, list[PlannedTrial]]:
    """The trials of a folder by the beginning of the names of standing trials, "" where there is one person."""
    beginnings = {person_prefix(trial.path) for trial in trials if trial.stands} - {""}
    if len(beginnings) < 2:
        return {"": list(trials)} if trials else {}
    found: dict[str, list[PlannedTrial]] = {}
    for trial in trials:
        stem = trial.path.stem.casefold()
        fitting = [one for one in beginnings if stem.startswith(one)]
        found.setdefault(max(fitting, key=len, default=""), []).append(trial)
    return found
