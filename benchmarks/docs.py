"""The newest release's figures in; docs/figures.md and the table of README.md out. No number is typed by hand."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks.figures import asked_text, measured_text, reached
from benchmarks.key import KEY, README, Shown

ROOT = Path(__file__).parents[1]
PAGE, FIRST_PAGE, RELEASES = ROOT / "docs" / "figures.md", ROOT / "README.md", ROOT / "docs" / "figures"
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"

Release = Mapping[str, Any]
"""What a release's file holds, see `release.release_of`."""

INTRODUCTION = """# Figures

{measured}

Written by `python -m benchmarks docs`; do not edit. `python -m benchmarks release` measures all of these at one commit. What is asked was written down
before it was measured; **no** marks a figure that misses it. Speeds belong to the machine: the row *reference* is a fixed piece of work
on the same one. Each figure belongs to its release. Between releases the canaries (`pytest -m canary`) fail where one falls by
more than its own noise.

- **right**: visible markers with their own point. **wrong**: labels on another point, of the labels given.
- *People not seen*: each person is left out in turn, and labelled by a model of all others.
- *k hidden*: k markers are in a gap of 0.1 to 1 s at every moment, and come back under a new track number. *Ghosts* are tracks of 0.05
  to 0.5 s that move with a marker at a fixed offset of up to 150 mm, so many at every moment. *Flickering*: points beside markers for one frame.
- *n*: different samples: frames, points, labels, files. Frames of one walk resemble each other; an interval over people is wider than n suggests.
- *Six other laboratories*: cmu41, pig39, clinical-lower, qtm-fullbody (a person left out), lab51-multiactivity, rizzoli24 (a movement left out).
- *Standing*: of a whole body that is labelled turned round every label is wrong; *sure* is a confidence of 0.99 or more.
"""

NONE_YET = """No release has been measured yet. `python -m benchmarks release` measures the key figures of one commit, and this page is written from its file."""

FOUND = """## What was found

Facts that earlier measurements showed, once; nothing measures them again.

- **Deliberate faults** (25 November 2026, 313 single changes of labelling, reconstruction, cameras and formats): the tests noticed 282, 90.1 % (95 % interval
  86.3 to 92.9 %); 30 survived, 1 was undecided. Of the survivors 26 change nothing that could be noticed: without them 98.3 % of 287 (96.0 to 99.3 %). Before
  tests were written for what had survived, 86.6 % were noticed. [CONTRIBUTING](https://github.com/asterism-mocap/asterism/blob/main/CONTRIBUTING.md#the-tests) says how to try others.
- **What a part contributes** to the labels of whole recordings: [recordings](recordings.md#what-each-part-contributes).
- **Peers** on the same walks, 3 hidden: an optimal assignment to key poses 96.7 % right and 2.5 % wrong, with 3 ghosts 93.7 and 9.9 %
  (`python -m benchmarks recordings baselines`).
- **Against aniposelib** on the same simulated wand (8 cameras, 2,000 frames, 0.2 px), which needs a start and got one 1 % off: points that neither had seen
  are off by 0.59 mm with ours, which starts from nothing.

Thesis: J. L. Jiménez Bascones, "Cloud Point Labelling in Optical Motion Capture Systems", 2019, chapters 4 and 5. Recordings (their
licences lie beside them; none is part of this repository): the sample study of biomechZoo (11 children, Vicon, 100 Hz); CMU Graphics Lab (mocap.cs.cmu.edu),
auto-marker-label, nimblephysics, pyCGM, biobuddy, pyorerun, C3D-parser, OIST mouse motion capture, rewrite_lowerbodyc3d_with_IK,
kineticstoolkit; the c3d.org samples, OpenSim, pyomeca, hmv-s16, diabolo-juggling; caliscope, OpenCV, OpenPTV and rtosim for cameras.
"""


def newest(folder: Path = RELEASES) -> Release | None:
    """The file of the highest version, or None where there is none."""
    found = sorted(folder.glob("*.json"), key=lambda path: [int(part) for part in re.findall(r"\d+", path.stem)])
    return json.loads(found[-1].read_text(encoding="utf-8")) if found else None


def measured_with(release: Release) -> str:
    """'Measured with 0.2.0, 27 November 2026, two cores'."""
    day, cores = date.fromisoformat(release["date"]), release["machine"]["cores"]
    words = {1: "one core", 2: "two cores", 4: "four cores", 8: "eight cores"}
    return f"Measured with {release['version']}, {day.day} {day:%B %Y}, {words.get(cores, f'{cores} cores')}"


def page_of(release: Release | None) -> str:
    """The page of all key figures."""
    if release is None:
        return INTRODUCTION.format(measured=NONE_YET) + "\n" + FOUND
    entries = {entry["row"]: entry for entry in release["rows"]}
    verdicts = [reached(entry["asked"], entry["measured"]) for entry in release["rows"]]
    machine, simulated = release["machine"], "" if release["recordings"] == "real" else " Its recordings of people are simulated ones."
    first = (
        f"{measured_with(release)} ({machine['processor']}, {machine['system']}, Python {machine['python']}; commit `{release['commit'][:12]}`)."
        f"{simulated} {verdicts.count(True)} of {verdicts.count(True) + verdicts.count(False)} figures reach what is asked."
    )
    parts = [INTRODUCTION.format(measured=first)]
    for title in dict.fromkeys(group.title for group in KEY):
        parts += [f"## {title}\n", "| row | asked | measured | reached | n |", "|---|---|---|---|---|"]
        for group in KEY:
            if group.title == title:
                parts += [_line(row, entries.get(row), group.name, release["failed"]) for row in group.rows]
        parts.append("")
    return "\n".join([*parts, FOUND])


def _line(row: str, entry: Mapping[str, Any] | None, script: str, failed: Mapping[str, str]) -> str:
    if entry is None:
        return f"| {row} | | not measured{': `' + script + '` failed' if script in failed else ''} | **no** | |"
    verdict = {True: "yes", False: "**no**", None: ""}[reached(entry["asked"], entry["measured"])]
    measured = measured_text(entry["measured"], entry["unit"])
    return f"| {row} | {asked_text(entry['asked'], entry['unit'])} | {measured} | {verdict} | {entry['n']:,} |"


def table_of(release: Release | None) -> str:
    """The README's table, without its marks."""
    if release is None:
        return "(No release has been measured yet: `python -m benchmarks release`.)\n"
    entries = {entry["row"]: entry for entry in release["rows"]}
    lines = [f"| {measured_with(release)} | | n |", "|---|---|---|"]
    lines += [_shown(line, entries) for line in README]
    return "\n".join(lines) + "\n"


def _shown(line: Shown, entries: Mapping[str, Mapping[str, Any]]) -> str:
    cells, counts = [], []
    for row, word in line.rows:
        entry = entries.get(row)
        if entry is None:
            return f"| {line.text} | not measured | |"
        value = f"{100 * entry['measured']:.2f} %" if entry["unit"] == "fraction" else measured_text(entry["measured"], entry["unit"])
        missed = f" (asked {asked_text(entry['asked'], entry['unit'])})" if reached(entry["asked"], entry["measured"]) is False else ""
        cells.append(f"{value} {word}{missed}")
        counts.append(entry["n"])
    return f"| {line.text} | {', '.join(cells)} | {max(counts):,} |"


def with_table(page: str, release: Release | None) -> str:
    """A page with the table between its marks written anew. Raises ValueError where it has not both marks once."""
    if page.count(BEGIN) != 1 or page.count(END) != 1:
        raise ValueError(f"the page needs the marks {BEGIN} and {END} once each, around the table")
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n{table_of(release)}{END}{rest.split(END)[1]}"


def main() -> int:
    """Write the pages, each under a temporary name first."""
    release = newest()
    for path, content in ((PAGE, page_of(release)), (FIRST_PAGE, with_table(FIRST_PAGE.read_text(encoding="utf-8"), release))):
        temporary = path.with_name(path.name + ".part")
        temporary.write_text(content, encoding="utf-8")
        os.replace(temporary, path)
    return 0
