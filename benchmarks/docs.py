"""The kept figures in; docs/figures.md, docs/figures-all.md and the tables in docs/recordings.md out. No figure is typed by hand."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

from benchmarks import runs, schedule
from benchmarks.data import CHOOSING, CHOOSING_SETS
from benchmarks.figures import UNLABELLED_MOST, UNLABELLED_SHOWN, Entry, Judged, judged, load
from benchmarks.peer import LIMIT
from benchmarks.stale import StaleRow, command_of

PAGE = Path(__file__).parents[1] / "docs" / "figures-all.md"
KEY_PAGE = PAGE.with_name("figures.md")
RECORDINGS = PAGE.with_name("recordings.md")
CONFIDENCE = PAGE.with_name("confidence.md")
CAMERAS = PAGE.with_name("cameras.md")
README = PAGE.parent.with_name("README.md")

DEFINITIONS = """- **right**: visible markers with their own point. **missed**: visible markers without a label. **FA**, false assignments:
  wrong labels among the labels given. **FO**, false occlusions: visible markers among the nulls given. All are shares.
- *Subjects not seen*: each subject is left out in turn, and labelled by a model of all others. *Subjects seen*: trained on even blocks
  of ten frames of each recording, tested on the odd ones.
- *k hidden*: k markers are in a gap of 0.1 to 1 s at every moment and come back under a new track number. *Ghosts* are tracks of 0.05
  to 0.5 s that move with a marker at a fixed offset of up to 150 mm, so many at every moment. Each walk is used with three sets of
  gaps.
- *k occlusions*: k markers of each frame are hidden, others in each frame; each frame is labelled by itself.
"""

INTRODUCTION = f"""# Figures

The figures that matter most. [All figures](figures-all.md) has the rest, with how each is measured. Both pages are written by
`python -m benchmarks docs` from `benchmarks/figures.json`, which `python -m benchmarks` measures; do not edit them. **no** marks a figure
that misses what was asked. *Stale* ones were measured by other code than that of today, and count as neither.

{DEFINITIONS}"""

INTRODUCTION_OF_ALL = f"""# All figures

Written by `python -m benchmarks docs` from `benchmarks/figures.json`; do not edit. [The most important ones](figures.md) have a page
with plots. To measure: `python -m benchmarks` (all that this code has not measured yet), `python -m benchmarks recordings` (one chapter),
`--rows gaps` (some rows), `--quick` (a short run that keeps nothing). `python -m benchmarks stale` lists what has changed since the figures
were measured. The environment variable `ASTERISM_DATA` names the folder of the recordings.

{DEFINITIONS}- *Stale*: since it was measured, the modules that the row imports, its own functions, the names and sizes of its
  recordings, or the values that are read of them have changed. What reads them does not count, save in rows about files.
- *n*: different samples (frames, points, files), with the number of random draws behind it where each was hidden several times. Frames of
  one walk resemble each other, and so do draws: an interval over people is wider than n suggests.
- *(ours)*: a bound that we set ourselves; all others are asked for in an issue, or printed by the thesis or a peer.
- Beside a share of wrong labels stands which share of the markers in view got no label at all, from {UNLABELLED_SHOWN:.0%} on. From
  {UNLABELLED_MOST:.0%} on, no bound on wrong labels counts as reached.
- A ghost lies within 150 mm of a marker.
- *Frame by frame* labels the same clouds without the neighbouring frames. *Backwards in time* are the same clouds in reverse order.
- *Tracking*: `benchmarks/tracking.py` knows the true places of all markers in the first frame and the given tracks; it continues tracks
  by constant velocity and optimal assignment.
- *Peer*, *key poses*: `benchmarks/peer.py` uses sixteen key poses from eight headings, ICP, optimal assignment and a limit of
  {1000 * LIMIT:.0f} mm, the best on the children chosen on, on some frames of the same clouds.
- *From one trial to all subjects*: `benchmarks/recordings/loop.py`. One walk of one subject is labelled, or its tracks are named once.
  Then, repeatedly: label all trials; accept those in which `review` finds nothing, or settle what it finds in the trials that need the
  least; learn. *Touched*: samples whose label an answer changed. *Looked at*: samples of the pieces found, right or wrong. *Given by
  name*: samples of the tracks that were named.
- *Sampled*, so that all rows can be measured in hours: key poses label 8 frames of each cloud (24 in "subjects not seen"); models of all 59
  markers leave out two of the eleven subjects, features of motion two, the ablation every second one with a standing trial, two people
  every third pair; the loop starts from all eleven with ghosts where the trial is labelled, else from one; numbers are halved and doubled
  for one subject; the thesis' rules label 8,192 draws a cell; of a movement recording 400 frames are labelled one by one, 1,000 at most
  as a whole, 500 by strangers. What that costs: where none of n independent frames is wrong, up to 3 / n may be (95 %), but people count
  more than frames. Of two people without a fault, up to 78 % of all may have one, of five 45 %, of eleven 24 %.
- *As recorded*: with all points that nobody labelled. Some of them may be the marker that is missing, so FA is an upper bound there.
- Gaps and ghosts are simulated. Real gaps are only in vicon53, clouthier62, optitrack-wheelchair and mouse-qtm; real ghosts only in
  rows "as recorded". Rows "dirt" hide nothing: labels made by hand are found again, from one half of a trial to the other.
- *Chosen on*: from the issue about dirt on, constants are chosen on simulated walks, on the children {", ".join(CHOOSING)}
  of gait, and on the sets {", ".join(CHOOSING_SETS)} of movement (not on
  sprintbasket, which is one of optitrack-wheelchair). What is asked there is asked of the other five children and the other sets; the rows
  "chosen on" stand beside them. Older constants were chosen on all eleven children, each left out in turn.
- Rows "clutter": each subject left out in turn, 15 markers, two sets of gaps and clutter for each walk. *Flickering* points are there
  for one frame; how many begin in a frame is Poisson distributed. *80 mm*, *30 mm*: standard deviation along each axis of their offset
  from a random marker in view. *In the volume*: uniform in the box that the markers pass. *Riding*: ghosts as above. *Displaced*: one
  marker of each person is worn 2 to 10 cm aside along its segment, all trial long. *Wrong*: of the labels given. *Without numbers*: the
  whole recording without track numbers. Peers get one set of clutter for each walk, the thesis' rules a third of the usual search.
- Rows "guarantee": cells of a grid (0 to 30 points per frame; there for 1, 2, 3, 10, 50 or all frames; beside markers, at rest, crossing;
  0 to 5 hidden; with and without track numbers; 15, 41 and 59 markers), drawn as a Latin hypercube with a fixed seed, each of one of the
  five children.

Thesis: J. L. Jiménez Bascones, "Cloud Point Labelling in Optical Motion Capture Systems", 2019, chapters 4 and 5. Recordings (their
licences lie beside them; none is part of this repository):

- gait: the sample study of biomechZoo, 11 children, Plug-in-Gait and Oxford foot markers, Vicon, 100 Hz;
- movement: CMU Graphics Lab (mocap.cs.cmu.edu), auto-marker-label (Clouthier), nimblephysics, pyCGM, biobuddy, pyorerun, C3D-parser
  (University of Auckland), OIST mouse motion capture, rewrite_lowerbodyc3d_with_IK, kineticstoolkit;
- conformance: the c3d.org samples, OpenSim, pyomeca, hmv-s16 and the diabolo-juggling recordings for Motive.
"""

_WAND = "wand, 8 cameras, 2,000 frames, 0.2 px, cold start: "
_COLD = "wand, cold starts of 200 random rigs of 3 to 12 cameras, 5 % outliers: "
_WALK = "vicon-rig-walk, 0.3 px, body, strays: "

KEY_SECTIONS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    (
        "Labels of walks, subjects not seen",
        "![Right and wrong labels by hidden markers, for four methods](figures/occlusions.svg)",
        (
            "gaps, 3 hidden, whole recording: right",
            "gaps, 5 hidden, whole recording: right",
            "gaps, 5 hidden, whole recording: FA",
            "gaps, 3 hidden + 3 ghosts, whole recording: right",
            "gaps, 3 hidden + 3 ghosts, whole recording: FA",
            "clutter, 6 riding, 5 hidden, whole recording: wrong",
            "clutter, 3 flickering, 30 mm, 3 hidden, whole recording: right",
            "59 markers, 3 hidden, whole recording: right",
            "59 markers, 3 hidden, whole recording: FA",
            "two people, one model twice, 3 hidden of each: right",
            "stream, 15 markers, 3 hidden + 3 ghosts, delay 10: right",
            "loop, 3 hidden + 3 ghosts, one trial labelled: labels touched by hand",
        ),
    ),
    (
        "Other people, laboratories and movements",
        "![Right, missing and wrong labels for each set of recordings](figures/movements.svg)",
        (
            "dirt, clouthier62: hand labels found again",
            "dirt, mouse-qtm/MOS1aD_S2_M5_MC2: hand labels found again",
            "dirt, optitrack-wheelchair/sprintbasket: hand labels found again",
        ),
    ),
    (
        "Speed",
        "![Frames per second on one core](figures/speed.svg)",
        (
            "speed, 15 markers, 3 hidden, whole recording, one core",
            "speed, 15 markers, 3 hidden + 3 ghosts, whole recording, one core",
            "composition + merging, 8 cameras 50 markers, one core, global choice",
        ),
    ),
    (
        "Calibration of cameras",
        "![Focal length, 3D error and time against a peer](figures/wand.svg)",
        (
            f"{_WAND}focal length, RMS",
            f"{_WAND}3D of unseen points, their blobs with noise, RMS",
            f"{_COLD}converge to the right rig",
            "chessboard-stereo, the pair, RMS",
        ),
    ),
    (
        "Points from cameras",
        "![Markers found near their true place; ghosts](figures/points.svg)",
        (
            "particles-4cam, blobs against the peer's targets, the peer's thresholds: recall",
            "ghosts, 8 cameras 50 markers 0.3 px, all seen, global choice",
            f"{_WALK}the same, smoothed along paths",
        ),
    ),
)
"""Title, plot and rows of each section of docs/figures.md."""

HOUSE = "A house that others can carry on"

_METHOD = "(?P<column>(?:whole recording|frame by frame|tracking|key poses): \\w+)"

_CLUTTER = "(?P<line>.*), (?P<column>(?:whole recording|without numbers|frame by frame|tracking|key poses|thesis): \\w+)"

SECTIONS = (
    ("Lead in clutter", "clutter, lead", None),
    ("Clutter, subjects chosen on", "clutter, subjects chosen on, ", f"clutter, subjects chosen on, {_CLUTTER}"),
    ("Clutter, peers", "clutter, peers, ", f"clutter, peers, {_CLUTTER}"),
    ("Clutter", "clutter, ", f"clutter, {_CLUTTER}"),
    ("The whole against its frames, over a grid of clutter", "guarantee, ", None),
    ("Speed in clutter", "speed in clutter, ", r"speed in clutter, (?P<line>.*): (?P<column>.*)"),
    ("Cost of clutter", ("worst speed in clutter", "median speed in clutter", "time in clutter"), None),
    ("Streaming in clutter", "stream in clutter, ", r"stream in clutter, (?P<line>.*): (?P<column>.*)"),
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
    (
        "Ten tuned numbers at half and double, 3 hidden + 3 ghosts",
        "sensitivity, ",
        r"sensitivity, (?P<line>.*), (?P<column>(?:once|half|double): .*)",
    ),
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
    (
        "Table 5.4: FA by occlusions and target hit rate",
        "table 5.4",
        r"table 5.4, (?P<line>.*), (?P<column>target .*): FA(?: \(printed .*\))?",
    ),
    (
        "Table 5.5: FO by occlusions and target hit rate",
        "table 5.5",
        r"table 5.5, (?P<line>.*), (?P<column>target .*): FO(?: \(printed .*\))?",
    ),
    (
        "Table 5.3: marker by marker, 4 occlusions, target 99.99 %",
        "table 5.3",
        r"table 5.3, (?:(?P<rules>[\w-]+ rules), )?.* %, (?P<line>.*): (?P<column>.*)",
    ),
    ("Each subject when left out", "subject ", r"subject (?P<line>\w+) not seen, (?P<column>.*)"),
)
"""Title, how its rows begin, and for a table in two directions what names the line and what the column."""

RELIABILITY = {
    "stated at 0.99 to 0.999": "0.99: stated",
    "right at 0.99 to 0.999": "right",
    "log score": "log score",
    "log score less that of the best constant": "less that of the best constant",
    "labels that can be given at 99.9 % right": "share at 99.9 %",
}
"""The columns of the table in `docs/confidence.md`: how a figure's row ends, and the column's name."""

ABLATIONS = {
    "ablation, ": "Walks of people not seen. Partial solvers label frame by frame, without features of motion and with them; three people "
    "are left out there, nine in the other lines, each of which has all that those above it have. *right*: markers in view with their own "
    "point; *FA*: wrong labels among those given.\n",
    "features, ": "Features over neighbouring frames, velocities and accelerations, added to the pool of the thesis' rules, which label "
    "frame by frame:\n",
    "feature pool": "The solvers that were mined from these pools:\n",
}
"""The sections that stand in `docs/recordings.md`, too: how their rows begin, and what is said before them."""

_RESULTS_BEGIN, _RESULTS_END = "<!-- results: written by `python -m benchmarks docs`, do not edit -->", "<!-- end of results -->"
_RELIABILITY_BEGIN, _RELIABILITY_END = (
    "<!-- reliability: written by `python -m benchmarks docs`, do not edit -->",
    "<!-- end of reliability -->",
)
_NUMBER_MARK = re.compile(r"<!-- row: (?P<row>.+?) -->.*?<!-- end -->")
_BEGINS, _ENDS = "<!-- ablation: written by `python -m benchmarks docs`, do not edit -->", "<!-- end of ablation -->"


Stale = Collection[str]
"""Commands whose figures are not of the code as it is."""


def key_text(entries: list[Entry], stale: Stale = ()) -> str:
    """The page of the figures that matter most."""
    by_row = {entry.row: one for entry, one in zip(entries, judged(entries, stale), strict=True)}
    parts = [INTRODUCTION]
    for title, plot, rows in KEY_SECTIONS:
        some = [by_row[row] for row in rows if row in by_row]
        if some:
            note = "The plot shows stale figures.\n" if any(one.stale for one in some) else ""
            parts += [f"## {title}\n", f"{plot}\n", *((note,) if note else ()), _table(some)]
    house = [one for one in judged(entries, stale) if one.entry.issue.startswith(HOUSE)]
    if house:
        parts += ["## The code\n", _table(house)]
    return "\n".join(parts)


def text(entries: list[Entry], stale: Stale = (), durations: Sequence[runs.Run] = (), never: Sequence[str] = ()) -> str:
    """The page of all figures; `never`: the commands of rows that have none."""
    parts = [INTRODUCTION_OF_ALL]
    everything = judged(entries, stale)
    verdicts = [one.reached for one in everything if not one.stale]
    parts.append(f"{verdicts.count(True)} of {verdicts.count(True) + verdicts.count(False)} figures asked for are reached.\n")
    parts += [_named_stale(everything), _named_never(never), _durations(durations)]
    for issue in dict.fromkeys(entry.issue for entry in entries):
        of_issue = [one for one in everything if one.entry.issue == issue]
        parts.append(f"## {issue}\n")
        missed = [one for one in of_issue if one.reached is False and not one.stale]
        if missed:
            parts += ["### Not reached\n", _table(missed)]
        for title, starts, pattern in SECTIONS:
            some = [one for one in of_issue if one.entry.row.startswith(starts)]
            if some:
                parts += [f"### {title}\n", _crossed(some, pattern) if pattern else _table(some)]
            of_issue = [one for one in of_issue if one not in some]
        if of_issue:
            parts += ["### Others\n", _table(of_issue)]
    return "\n".join(part for part in parts if part)


def stale_in(page: str) -> list[str]:
    """The commands that a page of all figures names as stale."""
    return re.findall(r"^- `(python -m benchmarks [^`]*)`, \d+ figures$", page, re.MULTILINE)


def never_in(page: str) -> list[str]:
    """The commands that a page of all figures names as those of rows without any figure."""
    return re.findall(r"^- `(python -m benchmarks [^`]*)`$", page, re.MULTILINE)


def _named_never(never: Sequence[str]) -> str:
    return "\n".join(("Never measured:\n", *(f"- `{command}`" for command in never))) + "\n" if never else ""


def _named_stale(everything: Sequence[Judged]) -> str:
    counts = {command: sum(one.entry.command == command for one in everything) for command in _commands(everything)}
    if not counts:
        return ""
    lines = [f"- `{command}`, {count} figures" for command, count in counts.items()]
    return "\n".join(("Stale, to be measured again:\n", *lines)) + "\n"


def _commands(everything: Sequence[Judged]) -> list[str]:
    return list(dict.fromkeys(one.entry.command for one in everything if one.stale))


def _durations(durations: Sequence[runs.Run]) -> str:
    """How long the rows took, the longest first."""
    if not durations:
        return ""
    shown = sorted(durations, key=lambda run: -run.seconds)
    lines = [f"| {run.chapter} {run.row} | {run.seconds:,.0f} s | {run.cpu_seconds:,.0f} s | {run.jobs} | {run.date} |" for run in shown]
    wall, processor = (sum(getattr(run, name) for run in durations) / 3600 for name in ("seconds", "cpu_seconds"))
    whole = schedule.expected_seconds(durations, 2) / 3600
    total = (
        f"{len(shown)} rows: {wall:.1f} hours one after the other, {processor:.1f} hours of processor time on all cores together.\n"
        f"By these, a whole run on two cores takes {whole:.1f} hours (asked: less than 3): timings alone, other rows side by side.\n"
    )
    head = ("## How long the rows take\n", total, "| row | time | processor | processes | measured on |", "|---|---|---|---|---|")
    return "\n".join((*head, *lines)) + "\n"


def with_ablation(page: str, entries: list[Entry], stale: Stale = ()) -> str:
    """The page about whole recordings with its tables as measured; nothing stands there as long as nothing was measured."""
    tables = []
    for starts, words in ABLATIONS.items():
        some = [one for one in judged(entries, stale) if one.entry.row.startswith(starts)]
        if some:
            pattern = next(pattern for _, start, pattern in SECTIONS if start == starts)
            tables += [words, _crossed(some, pattern)] if pattern else [words, _table(some)]
    before, rest = page.split(_BEGINS)
    _, after = rest.split(_ENDS)
    return before + _BEGINS + "\n" + "".join(f"{part}\n" for part in tables) + _ENDS + after


def with_reliability(page: str, entries: list[Entry], stale: Stale = ()) -> str:
    """The page about confidence with its table as measured: a line for each model and way to label."""
    lines: dict[str, dict[str, str]] = {}
    for one in judged(entries, stale):
        model, _, what = one.entry.row.removeprefix("reliability, ").rpartition(": ")
        if one.entry.row.startswith("reliability, ") and what in RELIABILITY:
            lines.setdefault(model, {})[what] = _number(one.entry) + " (stale)" * one.stale
    head = [f"| people, how labelled | {' | '.join(RELIABILITY.values())} |", "|---" * (len(RELIABILITY) + 1) + "|"]
    rows = [f"| {model} | {' | '.join(found.get(what, '') for what in RELIABILITY)} |" for model, found in lines.items()]
    shown = "\n".join((*head, *rows)) if rows else "(`python -m benchmarks dirt --rows reliability` has not been run to its end yet.)"
    before, rest = page.split(_RELIABILITY_BEGIN)
    _, after = rest.split(_RELIABILITY_END)
    return f"{before}{_RELIABILITY_BEGIN}\n{shown}\n{_RELIABILITY_END}{after}"


def with_numbers(page: str, entries: list[Entry], stale: Stale = ()) -> str:
    """A page with the numbers in its sentences as measured: each stands between marks that name its row.

    Raises ValueError where a mark names no kept row.
    """
    values = {one.entry.row: one for one in judged(entries, stale)}

    def number(match: re.Match[str]) -> str:
        one = values.get(match["row"])
        if one is None:
            raise ValueError(f"no figure is kept of the row {match['row']!r}, which a page names")
        return f"<!-- row: {match['row']} -->{_number(one.entry)}{' (stale)' * one.stale}<!-- end -->"

    return _NUMBER_MARK.sub(number, page)


def with_results(page: str, entries: list[Entry], stale: Stale = ()) -> str:
    """The README with its table of results as measured."""
    values = {one.entry.row: one for one in judged(entries, stale)}
    lines = ["| hidden, of 15 markers | right | wrong | a peer: right | wrong |", "|---|---|---|---|---|"]
    used = []
    for condition in ("1 hidden", "3 hidden", "5 hidden", "3 hidden + 3 ghosts"):
        rows = [f"gaps, {condition}, {method}: {what}" for method in ("whole recording", "key poses") for what in ("right", "FA")]
        if all(row in values for row in rows):
            used += [values[row] for row in rows]
            cells = [f"{100 * values[row].entry.measured:.2f} %{' (stale)' * values[row].stale}" for row in rows]
            lines.append(f"| {condition.replace(' hidden', '')} | {' | '.join(cells)} |")
    if any(one.stale for one in used):
        lines += ["", "*Stale*: measured before the code changed last."]
    before, rest = page.split(_RESULTS_BEGIN)
    _, after = rest.split(_RESULTS_END)
    return before + _RESULTS_BEGIN + "\n" + "\n".join(lines) + "\n" + _RESULTS_END + after


def write(stale: Sequence[StaleRow]) -> None:
    """Write the pages and their plots from the kept figures; each page under a temporary name first."""
    from benchmarks import plots

    entries, commands = load(), {command_of(row.chapter, row.row) for row in stale}
    never = [command_of(row.chapter, row.row) for row in stale if not row.figures]
    plots.write(entries)
    pages = {
        PAGE: text(entries, commands, list(runs.load().values()), never),
        KEY_PAGE: key_text(entries, commands),
        RECORDINGS: with_ablation(RECORDINGS.read_text(encoding="utf-8"), entries, commands),
        README: with_results(README.read_text(encoding="utf-8"), entries, commands),
        CONFIDENCE: with_reliability(CONFIDENCE.read_text(encoding="utf-8"), entries, commands),
        CAMERAS: with_numbers(CAMERAS.read_text(encoding="utf-8"), entries, commands),
    }
    for page, content in pages.items():
        temporary = page.with_name(page.name + ".part")
        temporary.write_text(content, encoding="utf-8")
        os.replace(temporary, page)


def _table(some: Sequence[Judged]) -> str:
    lines = ["| row | asked | measured | reached | n | measured on |", "|---|---|---|---|---|---|"]
    for one in some:
        entry = one.entry
        asked = "" if entry.asked == "none" else _asked(entry)
        lines.append(f"| {entry.row} | {asked} | {_number(entry)} | {_verdict(one)} | {_samples(entry)} | {entry.date} |")
    return "\n".join(lines) + "\n"


def _verdict(one: Judged) -> str:
    beside = f", {one.unlabelled:.3g} % without a label" if one.unlabelled is not None else ""
    if one.stale:
        return f"stale{beside}"
    return {True: "yes", False: "**no**", None: ""}[one.reached] + (beside if one.reached is not None else beside.removeprefix(", "))


def _samples(entry: Entry) -> str:
    return f"{entry.n:,}, {entry.draws:,} draws" if entry.draws else f"{entry.n:,}"


def _crossed(some: Sequence[Judged], pattern: str) -> str:
    """Lines and columns by the two names in each row; a cell shows what was measured and, where something was asked, that."""
    cells: dict[str, dict[str, str]] = {}
    for one in some:
        entry = one.entry
        names = re.fullmatch(pattern, entry.row)
        if not names:
            raise ValueError(f"the row {entry.row!r} does not fit into its table in two directions")
        notes = [*((f"asked {_asked(entry)}",) if entry.asked != "none" else ())]
        notes += [*((f"{one.unlabelled:.3g} % without a label",) if one.unlabelled is not None else ()), *(("stale",) if one.stale else ())]
        shown = _number(entry) + (f" ({', '.join(notes)})" if notes else "")
        missed = one.reached is False and not one.stale
        column = ": ".join(filter(None, (names.groupdict().get("rules"), names["column"])))
        cells.setdefault(names["line"], {})[column] = f"**{shown}**" if missed else shown
    columns = list(dict.fromkeys(column for line in cells.values() for column in line))
    lines = [f"| | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {line} | {' | '.join(found.get(column, '') for column in columns)} |" for line, found in cells.items()]
    smallest, largest = (which(one.entry.n for one in some) for which in (min, max))
    draws = max(one.entry.draws for one in some)
    drawn = f", each hidden at random in up to {draws:,} draws in all" if draws else ""
    return "\n".join(lines) + f"\n\nFrames per cell: {smallest:,} to {largest:,}{drawn}. Bold: not reached.\n"


def _asked(entry: Entry) -> str:
    sign, bound = entry.asked.split()
    shown = f"{sign} {float(bound) * 100:.6g} %" if entry.unit == "fraction" else entry.asked
    return f"{shown} (ours)" if entry.ours else shown


def _number(entry: Entry) -> str:
    if entry.unit == "fraction":
        digits = 6 if entry.measured > 0.99 else 4
        return f"{entry.measured * 100:.{digits}g} %"
    return f"{entry.measured:,.5g} {entry.unit}" if entry.measured < 1000 else f"{entry.measured:,.0f} {entry.unit}"
