"""The kept figures in; `docs/figures.md` out, whose tables are never typed by hand."""

from __future__ import annotations

import os
from pathlib import Path

from benchmarks.figures import Entry, load, reached

PAGE = Path(__file__).parents[1] / "docs" / "figures.md"

INTRODUCTION = """# Figures

Written by `python -m benchmarks docs` from `benchmarks/figures.json`; do not edit. Measure again with `python -m benchmarks labelling`
(all rows), `--rows unseen` (some), `--quick` (a look, nothing is kept). The recordings are found through `ASTERISM_DATA`.

- **FA**, false assignments: wrong labels among the labels given. **FO**, false occlusions: visible markers among the nulls given.
  **missed**: visible markers without a label, among the visible ones. **right**: visible markers with their own point. All are fractions.
- *Subjects seen*: trained on even blocks of ten frames of each recording, tested on the odd ones. *Not seen*: one subject left out,
  trained on the ten others. Exactly k visible markers of each frame are hidden; a ghost lies within 150 mm of a marker. Every frame
  is labelled by itself.
- *Peer*: `benchmarks/peer.py`, sixteen key poses from eight headings by ICP, optimal assignment, 200 mm limit; some of the same clouds.
- *As recorded*: with all points that nobody labelled. Some of them may be the very marker that is missing: FA is an upper bound there.
- Gaps and ghosts are simulated; only vicon53, clouthier62, optitrack-wheelchair and mouse-qtm have real gaps besides, and rows
  "as recorded" real ghosts.

Thesis: J. L. Jiménez Bascones, "Cloud Point Labelling in Optical Motion Capture Systems", 2019, chapters 4 and 5.
Recordings (their licences lie beside them; none is part of this repository):

- gait: the sample study of biomechZoo, 11 children, Plug-in-Gait and Oxford foot markers, Vicon, 100 Hz;
- movement: CMU Graphics Lab (mocap.cs.cmu.edu), auto-marker-label (Clouthier), nimblephysics, pyCGM, biobuddy, pyorerun,
  C3D-parser (University of Auckland), OIST mouse motion capture, rewrite_lowerbodyc3d_with_IK, kineticstoolkit;
- conformance: the c3d.org samples, OpenSim, pyomeca, hmv-s16 and the diabolo-juggling recordings for Motive.
"""

SECTIONS = (
    ("Subjects not seen", ("subjects not seen",)),
    ("The peer on the same clouds", ("peer, ",)),
    ("Subjects seen, and speed", ("subjects seen", "strong classifier", "full solver", "ensemble,", "training,", "full body")),
    ("Other people, laboratories and movements", ("movement,",)),
    ("Files", ("conformance", "physical markers")),
    ("Table 5.4: FA by occlusions and target hit rate", ("table 5.4",)),
    ("Table 5.5: FO by occlusions and target hit rate", ("table 5.5",)),
    ("Table 5.3: marker by marker", ("table 5.3",)),
    ("Each subject when left out", ("subject ",)),
)


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
        for title, starts in SECTIONS:
            some = [entry for entry in of_issue if entry.row.startswith(starts)]
            if some:
                parts += [f"### {title}\n", _table(some)]
        rest = [entry for entry in of_issue if not entry.row.startswith(tuple(start for _, starts in SECTIONS for start in starts))]
        if rest:
            parts += ["### Others\n", _table(rest)]
    return "\n".join(parts)


def write() -> None:
    """Write the page from the kept figures, under a temporary name first."""
    temporary = PAGE.with_name(PAGE.name + ".part")
    temporary.write_text(text(load()), encoding="utf-8")
    os.replace(temporary, PAGE)


def _table(entries: list[Entry]) -> str:
    lines = ["| row | asked | measured | reached | n | measured on |", "|---|---|---|---|---|---|"]
    for entry in entries:
        verdict = {True: "yes", False: "**no**", None: ""}[reached(entry.asked, entry.measured)]
        asked = "" if entry.asked == "none" else entry.asked
        lines.append(f"| {entry.row} | {asked} | {_number(entry)} | {verdict} | {entry.n:,} | {entry.date} |")
    return "\n".join(lines) + "\n"


def _number(entry: Entry) -> str:
    if entry.unit == "fraction":
        return f"{entry.measured * 100:.4g} %"
    return f"{entry.measured:,.5g} {entry.unit}" if entry.measured < 1000 else f"{entry.measured:,.0f} {entry.unit}"
