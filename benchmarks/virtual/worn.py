"""A marker set in; the real recordings that wear it, and their anonymous points with the truth about them, out."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from asterism.recording import Clouds, Ints, MarkerSet, Recording
from asterism.simulation import simulate_gaps_and_ghosts
from benchmarks.data import PEOPLE, folder, true_names, with_columns

TUNE, JUDGE = "tune", "judge"
"""The split: constants are chosen on `movement` without its clinics; all else judges only."""
SPINES = ("LPSI", "RPSI")
"""Their middle stands for a sacral marker that a file lacks."""


@dataclass(frozen=True)
class Worn:
    """A recording that wears a marker set.

    markers  the shipped set
    kind     what it shows, or "own" where the set is one row
    person   who wears it
    names    spellings of this file that the set does not know: label -> marker
    """

    markers: str
    kind: str
    person: str
    path: Path
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def split(self) -> str:
        """`TUNE` or `JUDGE`."""
        place = self.path.relative_to(folder()).parts
        return TUNE if place[0] == "movement" and place[1] != "clinical-lower" else JUDGE

    @property
    def file(self) -> str:
        """The path below the folder of recordings."""
        return str(self.path.relative_to(folder()))

    def everything(self) -> Recording:
        """All points of the file but computed ones, with the true names in the set's spelling where `names` tells it."""
        whole = true_names(self.path)
        return replace(whole, labels=tuple(self.names.get(label, label) for label in whole.labels))


def recordings_of(markers: str, split: str | None = None, kind: str | None = None) -> list[Worn]:
    """The recordings that wear a set: of one split, and of one kind, where these are given."""
    return [
        worn
        for worn in _all()
        if worn.markers == markers and split in (None, worn.split) and kind in (None, worn.kind) and worn.path.exists()
    ]


def sets() -> list[str]:
    """The shipped sets that some recording wears."""
    return list(dict.fromkeys(worn.markers for worn in _all()))


@cache
def _all() -> tuple[Worn, ...]:
    return tuple(_listed())


def _listed() -> Iterator[Worn]:
    table = tomllib.loads(Path(__file__).with_name("worn.toml").read_text(encoding="utf-8"))
    for entry in table["worn"]:
        for pattern in entry["files"]:
            for path in sorted(folder().glob(pattern)):
                yield Worn(entry["set"], entry["kind"], person_of(path), path, entry.get("names", {}))


def person_of(path: Path) -> str:
    """Who is recorded: known people of a set; or else the folder, where it holds one person; or else the file."""
    place = path.relative_to(folder())
    for label, people in PEOPLE.items():
        for person, files in people.items():
            if any(place == Path("movement") / file for file in files):
                return f"{label} {person}"
    alone = place.parts[0] in ("movement", "gait") or place.parts[1] in ("plates", "opensim")
    return str(place.parent.relative_to(place.parts[0])) if alone else place.stem


def middle(recording: Recording, longest: int) -> Recording:
    """At most so many frames, from the middle of the recording."""
    spare = max(0, len(recording) - longest) // 2
    return recording.frames(slice(spare, spare + longest))


def markers_only(worn: Worn, longest: int) -> Recording:
    """The markers of the set, and nothing else that the file has."""
    whole, markers = worn.everything(), MarkerSet.load(worn.markers)
    own = with_columns(whole, markers)
    if "SACR" in own.labels and not own.visible[:, own.labels.index("SACR")].any() and set(SPINES) <= set(whole.labels):
        positions = own.positions.copy()
        positions[:, own.labels.index("SACR")] = whole.positions[:, [whole.labels.index(name) for name in SPINES]].mean(axis=1)
        own = replace(own, positions=positions)
    return middle(own, longest)


def with_extra_points(worn: Worn, longest: int) -> Recording:
    """The markers of the set first, then every other point of the file, as recorded."""
    whole, markers = worn.everything(), MarkerSet.load(worn.markers)
    own, used = with_columns(whole, markers), set(markers.columns_of(whole.labels).tolist())
    rest = [column for column in range(len(whole.labels)) if column not in used]
    labels = (*own.labels, *(f"*{column}" for column in rest))
    return middle(Recording(np.concatenate([own.positions, whole.positions[:, rest]], axis=1), labels, whole.rate, whole.vertical), longest)


def anonymous(worn: Worn, hidden: int = 0, *, raw: bool = False, longest: int = 300, seed: int = 0) -> tuple[Clouds, Ints]:
    """The points in random order without names, and each marker's place among them (T, M), -1 where it is not there.

    hidden  markers in a gap at every moment; gaps last 0.1 to 1 s
    raw     the file's other points are left in
    """
    trial = with_extra_points(worn, longest) if raw else markers_only(worn, longest)
    clouds, truth = simulate_gaps_and_ghosts(trial, min(hidden, len(trial.labels)), 0, seed=seed)
    return clouds, np.ascontiguousarray(truth[:, : len(MarkerSet.load(worn.markers))])
