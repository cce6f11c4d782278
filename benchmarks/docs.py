"""The kept figures in; `docs/figures.md`, and the tables in `docs/recordings.md`, out: none is ever typed by hand."""

from __future__ import annotations

import os
import re
from pathlib import Path

from benchmarks.figures import Entry, load, reached

PAGE = Path(__file__).parents[1] / "docs" / "figures.md"
RECORDINGS = PAGE.with_name("recordings.md")

INTRODUCTION = """# Figures

Written by `python -m benchmarks docs` from `benchmarks/figures.json`; do not edit. Measure again with `python -m benchmarks` (all),
`python -m benchmarks recordings` (one chapter), `--rows gaps` (some rows), `--quick` (a look, nothing is kept). The recordings are found
through `ASTERISM_DATA`.

- **FA**, false assignments: wrong labels among the labels given. **FO**, false occlusions: visible markers among the nulls given.
  **missed**: visible markers without a label, among the visible ones. **right**: visible markers with their own point. All are fractions.
- *Subjects seen*: trained on even blocks of ten frames of each recording, tested on the odd ones. *Not seen*: one subject left out,
  trained on the ten others. In the first chapter exactly k visible markers of each frame are hidden, anew in each, a ghost lies within
  150 mm of a marker, and every frame is labelled by itself.
- Whole recordings, *k hidden*: k markers are in a gap of 0.1 to 1 s at every moment and come back under a new track number; *ghosts* are
  tracks of 0.05 to 0.5 s that ride on a marker at a fixed offset of up to 150 mm, so many at every moment. Each walk is hidden three times.
  *Frame by frame* is the first chapter's labelling of the same clouds. *Backwards in time* are the same clouds in reverse order.
- *Tracking*: `benchmarks/tracking.py`, the true places of all markers in the first frame, then the given tracks; new tracks by constant
  velocity and optimal assignment.
- *Peer*, *key poses*: `benchmarks/peer.py`, sixteen key poses from eight headings by ICP, optimal assignment, 200 mm limit; some frames
  of the same clouds.
- *From one trial to all subjects*: `benchmarks/recordings/loop.py`. A walk of one subject is labelled, or its own tracks are named once;
  then label all trials, accept those in which `review` flags nothing, or settle what it flags in those least in doubt,
  learn, and go on. *Touched*: samples whose label an
  answer changed; *looked at*: samples of the pieces flagged, right or not; *given by name*: samples of the tracks named.
- *As recorded*: with all points that nobody labelled. Some of them may be the very marker that is missing: FA is an upper bound there.
- Gaps and ghosts are simulated; only vicon53, clouthier62, optitrack-wheelchair and mouse-qtm have real gaps besides, and rows
  "as recorded" real ghosts. Rows "dirt" hide nothing: hand labels found again, from one half of a trial to the other.

Thesis: J. L. Jiménez Bascones, "Cloud Point Labelling in Optical Motion Capture Systems", 2019, chapters 4 and 5.
Recordings (their licences lie beside them; none is part of this repository):

- gait: the sample study of biomechZoo, 11 children, Plug-in-Gait and Oxford foot markers, Vicon, 100 Hz;
- movement: CMU Graphics Lab (mocap.cs.cmu.edu), auto-marker-label (Clouthier), nimblephysics, pyCGM, biobuddy, pyorerun,
  C3D-parser (University of Auckland), OIST mouse motion capture, rewrite_lowerbodyc3d_with_IK, kineticstoolkit;
- conformance: the c3d.org samples, OpenSim, pyomeca, hmv-s16 and the diabolo-juggling recordings for Motive.
"""

_METHOD = "(?P<column>(?:whole recording|frame by frame|tracking|key poses): \\w+)"

SECTIONS = (
    ("Walks with gaps, subjects not seen", "gaps, ", rf"gaps, (?P<line>.*?), {_METHOD}"),
    ("Without track numbers, and backwards in time", "change, ", r"change, (?P<line>.*): (?P<column>.*)"),
    ("Calibration of the confidence", "calibration error", None),
    ("What carries it", "ablation, ", r"ablation, (?P<line>.*?), (?P<column>\d hidden.*: .*)"),
    ("Swapped columns", "swap", None),
    ("Links by motion", "links by motion", None),
    ("Two people in one volume", ("two people", "one person"), None),
    ("Streaming", "stream", None),
    (
        "Features of motion: the thesis' rules by pool, three subjects not seen",
        "features, ",
        r"features, (?P<column>single frames|\+ [a-z ]+), (?P<line>.*)",
    ),
    ("Features of motion: solvers by pool", "feature pool", None),
    ("Speed", "speed, ", None),
    ("Real gaps and ghosts", "dirt, ", None),
    ("From one trial to all subjects", "loop, ", r"loop, (?P<column>.*?, one trial \w+): (?P<line>.*)"),
    ("All physical markers", "59 markers, ", None),
    ("Subjects not seen", "subjects not seen", None),
    ("The peer on the same clouds", "peer, ", None),
    ("Subjects seen", "subjects seen", None),
    ("Solvers, speed and training", ("strong classifier", "full solver", "ensemble,", "training,", "full body"), None),
    ("Files", ("conformance", "physical markers"), None),
    (
        "Other people, laboratories and movements",
        "movement,",
        r"movement, (?P<line>.*?(?: not seen|own other \w+)), "
        r"(?P<column>(?:.* as recorded|\d occlusions|\d hidden(?:, frame by frame)?): \w+)",
    ),
    ("Table 5.4: FA by occlusions and target hit rate", "table 5.4", r"table 5.4, subjects seen, (?P<line>.*), (?P<column>target .*): FA"),
    ("Table 5.5: FO by occlusions and target hit rate", "table 5.5", r"table 5.5, subjects seen, (?P<line>.*), (?P<column>target .*): FO"),
    ("Table 5.3: marker by marker, 4 occlusions, target 99.99 %", "table 5.3", r"table 5.3, .* %, (?P<line>.*): (?P<column>.*)"),
    ("Each subject when left out", "subject ", r"subject (?P<line>\w+) not seen, (?P<column>.*)"),
)
"""Title, how its rows begin, and for a table in two directions what names the line and what the column."""

ABLATIONS = {
    "ablation, ": "Walks of people not seen, each line with all that the lines above it have. *right*: markers in view with their own "
    "point; *FA*: wrong labels among those given.\n",
    "features, ": "Features over neighbouring frames, velocities and accelerations, added to the pool of the thesis' rules, which label "
    "frame by frame:\n",
    "feature pool": "The solvers that were mined from these pools:\n",
}
"""The sections that stand in `docs/recordings.md`, too: how their rows begin, and what is said before them."""

_BEGINS, _ENDS = "<!-- ablation: written by `python -m benchmarks docs`, do not edit -->", "<!-- end of ablation -->"


def text(entries: list[Entry]) -> str:
    """The whole page."""
    parts = [INTRODUCTION]
    asked = [reached(entry.asked, entry.measured) for entry in entries]
    parts.append(f"{asked.count(True)} of {asked.count(True) + asked.count(False)} figures asked for are reached.\n")
    for issue in dict.fromkeys(entry.issue for entry in entries):
        of_issue = [entry for entry in entries if entry.issue == issue]
        parts.append(f"## {issue}\n")
        missed = [entry for entry in of_issue if reached(entry.asked, entry.measured) is False]
        if missed:
            parts += ["### Not reached\n", _table(missed)]
        for title, starts, pattern in SECTIONS:
            some = [entry for entry in of_issue if entry.row.startswith(starts)]
            if some:
                parts += [f"### {title}\n", _crossed(some, pattern) if pattern else _table(some)]
            of_issue = [entry for entry in of_issue if entry not in some]
        if of_issue:
            parts += ["### Others\n", _table(of_issue)]
    return "\n".join(parts)


def with_ablation(page: str, entries: list[Entry]) -> str:
    """The page about whole recordings with its tables as measured; nothing stands there as long as nothing was measured."""
    tables = []
    for starts, words in ABLATIONS.items():
        some = [entry for entry in entries if entry.row.startswith(starts)]
        if some:
            pattern = next(pattern for _, start, pattern in SECTIONS if start == starts)
            tables += [words, _crossed(some, pattern)] if pattern else [words, _table(some)]
    before, rest = page.split(_BEGINS)
    _, after = rest.split(_ENDS)
    return before + _BEGINS + "\n" + "".join(f"{part}\n" for part in tables) + _ENDS + after


def write() -> None:
    """Write the pages from the kept figures, each under a temporary name first."""
    entries = load()
    for page, content in ((PAGE, text(entries)), (RECORDINGS, with_ablation(RECORDINGS.read_text(encoding="utf-8"), entries))):
        temporary = page.with_name(page.name + ".part")
        temporary.write_text(content, encoding="utf-8")
        os.replace(temporary, page)


def _table(entries: list[Entry]) -> str:
    lines = ["| row | asked | measured | reached | n | measured on |", "|---|---|---|---|---|---|"]
    for entry in entries:
        verdict = {True: "yes", False: "**no**", None: ""}[reached(entry.asked, entry.measured)]
        asked = "" if entry.asked == "none" else _asked(entry)
        lines.append(f"| {entry.row} | {asked} | {_number(entry)} | {verdict} | {entry.n:,} | {entry.date} |")
    return "\n".join(lines) + "\n"


def _crossed(entries: list[Entry], pattern: str) -> str:
    """Lines and columns by the two names in each row; a cell shows what was measured and, where something was asked, that."""
    cells: dict[str, dict[str, str]] = {}
    for entry in entries:
        names = re.fullmatch(pattern, entry.row)
        if not names:
            raise ValueError(f"the row {entry.row!r} does not fit into its table in two directions")
        shown = _number(entry) if entry.asked == "none" else f"{_number(entry)} (asked {_asked(entry)})"
        missed = reached(entry.asked, entry.measured) is False
        cells.setdefault(names["line"], {})[names["column"]] = f"**{shown}**" if missed else shown
    columns = list(dict.fromkeys(column for line in cells.values() for column in line))
    lines = [f"| | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {line} | {' | '.join(found.get(column, '') for column in columns)} |" for line, found in cells.items()]
    smallest, largest = min(entry.n for entry in entries), max(entry.n for entry in entries)
    return "\n".join(lines) + f"\n\nFrames per cell: {smallest:,} to {largest:,}. Bold: not reached.\n"


def _asked(entry: Entry) -> str:
    sign, bound = entry.asked.split()
    return f"{sign} {float(bound) * 100:.6g} %" if entry.unit == "fraction" else entry.asked


def _number(entry: Entry) -> str:
    if entry.unit == "fraction":
        digits = 6 if entry.measured > 0.99 else 4
        return f"{entry.measured * 100:.{digits}g} %"
    return f"{entry.measured:,.5g} {entry.unit}" if entry.measured < 1000 else f"{entry.measured:,.0f} {entry.unit}"
