"""Real recordings in; body models of the people in them out. `python -m benchmarks.views.bodies` writes the shipped ones anew."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from asterism.recording import MarkerSet, Recording
from asterism.skeleton.body import ArticulatedBody
from asterism.skeleton.body_file import save_body
from asterism.skeleton.body_fit import fit_body
from benchmarks import data

HELEN_HAYES = MarkerSet.load("helen-hayes").names
WHOLE_BODY = (*HELEN_HAYES, "C7", *(side + name for name in ("SHO", "ELB", "WRA", "WRB", "FIN") for side in "LR"))
"""26 markers: the paper gives their number and a picture, not their names."""
_HEAD_AND_TRUNK = "LFHD RFHD LBHD RBHD C7 T10 RBAK CLAV STRN LASI RASI SACR"
PLUG_IN_GAIT = (
    *_HEAD_AND_TRUNK.split(),
    *(side + name for side in "LR" for name in ("SHO", "ELB", "WRA", "WRB", "FIN", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")),
)
SETS = {"gait15": HELEN_HAYES, "body26": WHOLE_BODY, "plug-in-gait": PLUG_IN_GAIT}
TITLES = {
    "gait15": "Gait, 15 markers (Helen Hayes)",
    "body26": "Whole body, 26 markers",
    "plug-in-gait": "Plug-in Gait with a sacral marker, 34 markers",
}


@cache
def trials() -> dict[str, tuple[Recording, ...]]:
    """All trials of each gait subject with all physical markers."""
    return data.gait(data.GAIT_BODY)


def is_standing(recording: Recording) -> bool:
    """Whether a trial is the person's standing one."""
    return data.file_of(recording).stem == "static"


@cache
def body_of_others(left_out: str, kind: str = "gait15") -> ArticulatedBody:
    """The body of all gait subjects but one ("" for none): rest pose from the standing trials, joints and spreads from the walks."""
    pairs = [(person, trial) for person, own in trials().items() if person != left_out for trial in own]
    standing = [(person, trial) for person, trial in pairs if is_standing(trial)]
    moving = [(person, trial) for person, trial in pairs if not is_standing(trial)]
    people = [person for person, _ in (*standing, *moving)]
    return fit_body([t for _, t in standing], [t for _, t in moving], markers=marker_set(kind), people=people, title=TITLES[kind])


def marker_set(kind: str) -> MarkerSet:
    """The markers of a shipped body with the spellings that the shipped marker sets know."""
    known = (MarkerSet.load("plug-in-gait"), MarkerSet.load("helen-hayes"))
    spelled: dict[str, tuple[str, ...]] = {}
    for name in SETS[kind]:
        found = next((each.aliases[name] for each in known[::-1] if name in each.aliases), ())
        spelled[name] = tuple(found)
    return MarkerSet(SETS[kind], TITLES[kind], spelled)


def main() -> None:
    """Write the shipped bodies: means over all gait subjects."""
    folder = Path(__file__).parents[2] / "src" / "asterism" / "bodies"
    for kind in SETS:
        save_body(body_of_others("", kind), folder / f"{kind}.toml")


if __name__ == "__main__":
    main()
