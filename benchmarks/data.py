"""The folder of real recordings in; trials by person, splits and folds out, as the data's own notes define them."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.formats import read
from asterism.recording import MarkerSet, Recording
from asterism.simulation import simulate_standing, simulate_walks, simulated_markers

_MIDDLE = "LFHD RFHD LBHD RBHD C7 T2 T6 T10 T12 RBAK CLAV STRN LASI RASI SACR"
_SIDES = "SHO ELB WRA WRB FIN THI KNE TIB ANK HEE TOE HFB TUB SHN CPG LCA STL NAV P1M P5M D5M HLX"
GAIT_BODY = (*_MIDDLE.split(), *(side + name for side in "LR" for name in _SIDES.split()))
"""The physical markers that all gait subjects wear."""

CHOOSING = ("HC002", "HC003", "HC030", "HC031", "HC033", "HC039")
"""The gait subjects that constants are chosen on, from the issue about dirt on; the figures asked there are about the other five."""

CHOOSING_SETS = ("running42", "vicon53", "clinical-lower", "cmu41", "pig39", "optitrack-lower", "optitrack-wheelchair")
"""The sets of movement that constants are chosen on; those of sprintbasket, which is one of optitrack-wheelchair, are not."""


OURS = Path(__file__).with_name("exchanged.toml")
"""Wrong names that were found here, with the evidence."""


@dataclass(frozen=True)
class Test:
    """Frames of a file of the movement recordings that training has not seen; `recording` has all frames, the markers of the set only."""

    file: str
    recording: Recording
    frames: NDArray[np.int64]


@dataclass(frozen=True)
class Fold:
    """One training and what it is tested on: `label` names the set, `person` who is tested, `unseen` that training knew nobody of them."""

    label: str
    person: str
    unseen: bool
    train: tuple[Recording, ...]
    train_people: tuple[str, ...]
    test: tuple[Test, ...]


def folder() -> Path:
    """Where the real recordings are. Raises AsterismError where `ASTERISM_DATA` does not name a folder."""
    if not has_recordings():
        raise AsterismError("this needs real recordings: set ASTERISM_DATA to the folder that holds gait, movement and conformance.")
    return Path(os.environ["ASTERISM_DATA"])


def has_recordings() -> bool:
    """Whether `ASTERISM_DATA` names a folder."""
    return Path(os.environ.get("ASTERISM_DATA") or "?").is_dir()


@cache
def gait(markers: str | tuple[str, ...] = "helen-hayes") -> dict[str, tuple[Recording, ...]]:
    """All trials of each gait subject, with the markers of a set; simulated people where there are no recordings."""
    if not has_recordings():
        return _simulated(markers)
    wanted = markers if isinstance(markers, str) else list(markers)
    return {
        subject.name: tuple(true_names(path, wanted) for path in sorted(subject.glob("*.c3d")))
        for subject in sorted((folder() / "gait").iterdir())
        if subject.is_dir()
    }


def _simulated(markers: str | tuple[str, ...]) -> dict[str, tuple[Recording, ...]]:
    """A standing trial, a straight walk and a turn of each of eleven simulated people, with those of the markers that can be simulated."""
    chosen = markers if isinstance(markers, str) else [name for name in markers if name in simulated_markers()]
    walks, standing = simulate_walks(11, 300, markers=chosen, trials=2), simulate_standing(11, 100, markers=chosen)
    people: dict[str, tuple[Recording, ...]] = {}
    for number, still in enumerate(standing):
        named = zip(("static", "straight", "turn"), (still, *walks[2 * number : 2 * number + 2]), strict=True)
        person = f"S{number + 1:02d}"
        people[person] = tuple(replace(trial, metadata={**trial.metadata, "file": f"{person}/{name}.c3d"}) for name, trial in named)
    return people


def true_names(path: Path, markers: str | list[str] | None = None) -> Recording:
    """A recording with its markers as they are named in truth: names that `corrections` tells are put right."""
    found = [names for named, names in corrections() if _lies_in(path, named)]
    if not found:
        return read(path, markers=markers)
    names = {label: marker for some in found for label, marker in some.items()}
    recording = read(path)
    recording = replace(recording, labels=tuple(names.get(label, label) for label in recording.labels))
    return recording if markers is None else with_columns(recording, MarkerSet.load(markers))


@cache
def corrections() -> tuple[tuple[str, dict[str, str]], ...]:
    """File or folder, and the marker that each wrong label there is: `corrections.json` with the recordings, and `OURS`."""
    ours = tomllib.loads(OURS.read_text(encoding="utf-8"))["exchanged"]
    path = folder() / "corrections.json"
    theirs = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    pairs = [
        (re.sub(r" \(.*\)$", "", named), {name: other for pair in entry["exchange"] for name, other in (pair, pair[::-1])})
        for named, entry in theirs.items()
        if isinstance(entry, dict)
    ]
    return (*pairs, *((entry["file"], entry["names"]) for entry in ours))


def _lies_in(path: Path, named: str) -> bool:
    place = folder() / named
    return path == place or place in path.parents


def file_of(recording: Recording) -> Path:
    """The file that a recording was read from."""
    return Path(recording.metadata["file"])


def people_and_trials(trials: dict[str, tuple[Recording, ...]], leave_out: str | None = None) -> tuple[list[str], list[Recording]]:
    """One name per recording, and the recordings, of everyone but `leave_out`."""
    pairs = [(person, recording) for person, recordings in trials.items() if person != leave_out for recording in recordings]
    return [person for person, _ in pairs], [recording for _, recording in pairs]


def blocks(recording: Recording, odd: bool) -> Recording:
    """The odd or the even blocks of ten frames."""
    return recording.frames(np.nonzero(_in_odd_block(recording) == odd)[0])


def _in_odd_block(recording: Recording) -> NDArray[np.bool_]:
    return np.arange(len(recording)) // 10 % 2 == 1


def evenly(recording: Recording, most: int) -> Recording:
    """At most so many frames, evenly spread."""
    return recording if len(recording) <= most else recording.frames(spread(len(recording), most))


def spread(frames: int, most: int) -> NDArray[np.int64]:
    """At most so many frame numbers below `frames`, evenly spread."""
    return np.unique(np.linspace(0, frames - 1, min(frames, most)).round().astype(np.int64))


PEOPLE: dict[str, dict[str, tuple[str, ...]]] = {
    "cmu41": {
        "01 and 06": ("cmu41/01_01_climb.c3d", "cmu41/06_xx_dribble_shoot.c3d"),
        "02": ("cmu41/02_01_walk.c3d", "cmu41/02_05_punch.c3d"),
        "85": ("cmu41/85_02.c3d", "cmu41/85_12.c3d"),
    },
    "pig39": {"rom": ("pig39/rom_static.c3d",), "test": ("pig39/test_static.c3d", "pig39/test_movement.c3d")},
    "clinical-lower": {
        "Sydney": ("clinical-lower/sydney_static.c3d", "clinical-lower/sydney_gait03.c3d", "clinical-lower/sydney_gait06.c3d"),
        "AUC": ("clinical-lower/auc_static.c3d", "clinical-lower/auc_dynamic.c3d"),
        "FMC": ("clinical-lower/fmc_static.c3d", "clinical-lower/fmc_dynamic15.c3d"),
    },
    "qtm-fullbody": {
        "ech": ("qtm-fullbody/ech_anat_pose.c3d", "qtm-fullbody/ech_right_knee.c3d"),
        "lem": ("qtm-fullbody/lem_static.c3d",),
        "U": ("qtm-fullbody/static_lower_body_U.c3d",),
    },
}
"""Sets that several people share: train on the others, with the markers that all of them wear (not in every trial)."""

OWN_TRIALS: dict[str, tuple[tuple[str, ...], ...]] = {
    "clouthier62": (("clouthier62/labelled/KneeltoProne01.c3d",), ("clouthier62/labelled/PronetoRun01.c3d",)),
    "sprint53": (("sprint53/run0700cms.trc",), ("sprint53/static.trc",)),
    "lab51-multiactivity": (
        ("lab51-multiactivity/DJ1.trc", "lab51-multiactivity/walking1.trc"),
        ("lab51-multiactivity/DJAsym1.trc", "lab51-multiactivity/walkingTO1.trc", "lab51-multiactivity/static1.trc"),
        ("lab51-multiactivity/squats1.trc", "lab51-multiactivity/walkingTS1.trc"),
    ),
    "running42": (("running42/run200.trc",), ("running42/run300.trc",)),
    "fullbody61": (("fullbody61/markers.trc",), ("fullbody61/markers_Squat2.trc",), ("fullbody61/markers_StairUp3.trc",)),
    "optitrack-lower/rizzoli24": tuple((f"optitrack-lower/rizzoli24/{name}_001.c3d",) for name in ("jog", "jumping_jacks", "walk")),
    "optitrack-lower/skeleton20": tuple((f"optitrack-lower/skeleton20/{name}_001.c3d",) for name in ("jog", "jumping_jacks", "walk_slow")),
    "qtm-fullbody/ech73": (("qtm-fullbody/ech_anat_pose.c3d",), ("qtm-fullbody/ech_right_knee.c3d",)),
}
"""Sets of one person with several trials: train on the other groups of trials."""

DIRTY = (
    "vicon53/nick_freeform_001",
    "optitrack-wheelchair/racing_full",
    "optitrack-wheelchair/sprintbasket",
    "optitrack-wheelchair/walkingOptiTrack",
    "clouthier62",
    "mouse-qtm/MOS1aD_S2_M5_MC2",
)
"""Labels of the sets with real gaps, and real ghosts in the last."""

ONE_TRIAL = (
    "vicon53/nick_freeform_001.c3d",
    "athlete-barbell70/athlete_barbell.c3d",
    "mouse-qtm/MOS1aD_S2_M5_MC2_T2_TRM_5MMIN_E.mat",
    "optitrack-wheelchair/racing_full.c3d",
    "optitrack-wheelchair/sprintbasket.c3d",
    "optitrack-wheelchair/walkingOptiTrack.c3d",
    "qtm-fullbody/running_0002.c3d",
)
"""One person, one trial: train on even blocks of ten frames and test on odd ones, or on one half and test on the other."""


def movement_folds(chosen: Sequence[str] | None = None, halves: bool = False) -> Iterator[Fold]:
    """Every labelled set of the movement recordings, split by person where there are several; `chosen` keeps some sets.

    A set of one trial is split into blocks of ten frames; with `halves` into its first and its second half, each tested with the other.
    """
    for label, people in PEOPLE.items():
        if chosen is None or label in chosen:
            owners = [(person, file) for person, files in people.items() for file in files]
            yield from _leave_one_out(label, owners, unseen=True)
    for label, groups in OWN_TRIALS.items():
        if chosen is None or label in chosen:
            owners = [(f"part {number + 1}", file) for number, files in enumerate(groups) for file in files]
            yield from _leave_one_out(label, owners, unseen=False)
    for file in ONE_TRIAL:
        label = f"{file.split('/')[0]}/{Path(file).stem.split('_T2')[0]}"
        if chosen is None or label in chosen:
            trial = _named(everything(file))
            if halves:
                yield from _halves(label, file, trial)
                continue
            test = Test(file, trial, np.nonzero(_in_odd_block(trial))[0])
            yield Fold(label, "own other frames", False, (blocks(trial, odd=False),), (label,), (test,))


def _halves(label: str, file: str, trial: Recording) -> Iterator[Fold]:
    parts = np.array_split(np.arange(len(trial)), 2)
    for train, test in (parts, parts[::-1]):
        yield Fold(label, "own other half", False, (trial.frames(train),), (label,), (Test(file, trial, test),))


def _leave_one_out(label: str, owners: list[tuple[str, str]], unseen: bool) -> Iterator[Fold]:
    named = [(owner, _named(everything(file))) for owner, file in owners]
    worn = [{label for who, trial in named if who == owner for label in trial.labels} for owner in dict.fromkeys(who for who, _ in named)]
    common = [
        label for label in dict.fromkeys(label for _, trial in named for label in trial.labels) if all(label in some for some in worn)
    ]
    trials = [with_columns(trial, MarkerSet(tuple(common))) for _, trial in named]
    for left_out in dict.fromkeys(owner for owner, _ in owners):
        train = [(owner, trial) for (owner, _), trial in zip(owners, trials, strict=True) if owner != left_out]
        test = [Test(file, trial, np.arange(len(trial))) for (owner, file), trial in zip(owners, trials, strict=True) if owner == left_out]
        person = left_out if unseen else "own other trials"
        people = tuple(owner if unseen else label for owner, _ in train)
        yield Fold(label, person, unseen, tuple(trial for _, trial in train), people, tuple(test))


@cache
def everything(file: str) -> Recording:
    """All points of a file of the movement recordings that the reader does not take for computed ones."""
    return true_names(folder() / "movement" / file)


def _named(recording: Recording) -> Recording:
    seen = recording.visible.any(axis=0)
    return recording.select(
        [
            label
            for label, there in zip(recording.labels, seen, strict=True)
            if there and not is_unnamed(label) and recording.labels.count(label) == 1
        ]
    )


def with_columns(recording: Recording, markers: MarkerSet) -> Recording:
    """The markers of a set only; one that the trial lacks is missing in all its frames."""
    columns = markers.columns_of(recording.labels)
    positions = np.where((columns >= 0)[None, :, None], recording.positions[:, columns], np.nan)
    return Recording(positions, markers.names, recording.rate, recording.vertical, metadata=recording.metadata)


def is_unnamed(label: str) -> bool:
    """Whether a label only says that the point has none, as vendors write it."""
    plain = label.strip().casefold()
    return (
        plain == "" or plain.startswith(("*", "unlabel", "unidentified", "uname", "unknown")) or (plain[0] in "ux" and plain[1:].isdigit())
    )
