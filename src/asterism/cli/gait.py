"""`asterism gait`: labelled walks in; events, gait parameters and angles over the cycle, as tables and a page, out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _clinical, _console
from asterism.cli._command import takes
from asterism.cli._filling import Fill, Filter, cleaned, fill_limit, filled, filled_text, filter_choice, filter_values
from asterism.cli._options import Files, Hip, Json, LowerBodyChoice, Measure, Overwrite, Report, Static, Vertical

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.gait import Band, GaitAnalysis
    from asterism.recording import Recording


@dataclass(frozen=True)
class GaitOptions:
    """What `asterism gait` is asked to do."""

    files: Files
    static: Static = None
    measure: Measure = field(default_factory=list)
    lower_body: LowerBodyChoice = None
    hip: Hip = None
    sloped_foot: Annotated[
        bool, typer.Option("--sloped-foot", help="With --static: heel and toe marker count as high as they are, not as equally high.")
    ] = False
    level_head: Annotated[
        bool, typer.Option("--level-head", help="With --static: the person looks straight ahead; the head's tilt is taken off.")
    ] = False
    table: Annotated[
        Path | None,
        typer.Option(
            "--table",
            metavar="FILE",
            help="Write all numbers, with their uncertainty and frames: events, parameters, curves, extremes; CSV or .parquet.",
            show_default=False,
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Of this table, write the parameters alone.", show_default=False),
    ] = None
    curves: Annotated[
        Path | None,
        typer.Option(
            "--curves", metavar="FILE", help="Of this table, write angles, moments and powers from 0 to 100 % alone.", show_default=False
        ),
    ] = None
    c3d: Annotated[
        Path | None,
        typer.Option(
            "--c3d",
            metavar="FOLDER",
            help="Write copies of the walks with angles, moments, powers, events and parameters as gait programs read them.",
            show_default=False,
        ),
    ] = None
    band: Annotated[
        Path | None,
        typer.Option(
            "--band", metavar="FILE", help="A band of controls, which --save-band wrote: scores, and the page's grey.", show_default=False
        ),
    ] = None
    save_band: Annotated[
        Path | None,
        typer.Option(
            "--save-band", metavar="FILE", help="Write the band of these walks, of people without complaints.", show_default=False
        ),
    ] = None
    emg: Annotated[
        list[str],
        typer.Option("--emg", metavar="CHANNEL=MUSCLE", help="The muscle of an EMG channel, and its side: EMG1=LRF.", show_default=False),
    ] = field(default_factory=list)
    compare: Annotated[
        list[Path],
        typer.Option(
            "--compare", metavar="FILES", help="Walks of a second session; all files that follow belong to it.", show_default=False
        ),
    ] = field(default_factory=list)
    compare_measure: Annotated[
        list[str],
        typer.Option(
            "--compare-measure", metavar="NAME=VALUE", help="As --measure, of the second session, where it differs.", show_default=False
        ),
    ] = field(default_factory=list)
    compare_static: Annotated[
        Path | None,
        typer.Option("--compare-static", metavar="FILE", help="The standing trial of the second session.", show_default=False),
    ] = None
    fill: Fill = "none"
    filter: Filter = "none"
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    pdf: Annotated[
        Path | None,
        typer.Option("--pdf", metavar="FILE", help="Print the report on A4, by Chromium, Chrome or Edge.", show_default=False),
    ] = None
    json: Json = None


@takes(GaitOptions)
def gait(options: GaitOptions) -> None:
    """Find gait events, and give parameters and angles.

    Strikes and offs come from the markers of feet and pelvis, and from force plates that one foot alone stands on. Cadence, speed, lengths
    and times of steps have an uncertainty. Angles of legs, trunk, head and arms are those of Plug-in-Gait, from the measures of the
    file, of --static and of --measure. Several walks of one person go into one report. A foot
    that is alone on a force plate gives moments and powers of its joints, per kg of the body's mass. --c3d writes all of it into copies of
    the walks.
    --fill fills gaps of markers first, with what other files of the person show, named or beside; events and angles that depend on filled
    samples are as much less certain, and flagged. --filter smooths markers; by default nothing is filtered: angles and events need it not.
    --compare sets a second session of the person beside the first, before and after a treatment.
    """
    from asterism.cli._folders import copies_of, trials
    from asterism.files.tables import check_table
    from asterism.gait import Band, muscles_by_channel

    tables = [options.table, options.output, options.curves]
    inputs = [options.static, options.compare_static, options.band, *_clinical.measure_files(options.measure)]
    outputs = [options.report, options.json, *tables, options.save_band, options.pdf]
    _console.check_outputs(outputs, [*options.files, *options.compare, *inputs], options.overwrite)
    for given in tables:
        if given is not None:
            check_table(given)
    _check_sessions(options)
    muscles_by_channel(options.emg)
    # what is wrong with the options is told before any file is read
    _clinical.given_measures([*options.measure, *options.compare_measure])
    fill_limit(options.fill)
    filter_choice(options.filter)
    band = None if options.band is None else Band.load(options.band)
    batch = _console.Batch("analysed")
    # a standing trial that a folder holds beside the walks is none of them
    standing = {_console.real_path(path) for path in (options.static, options.compare_static) if path is not None}
    found = trials([*options.files, *options.compare], batch, without=options.c3d)
    walks = [trial for trial in found if trial.folder is None or _console.real_path(trial.path) not in standing]
    copies = {} if options.c3d is None else copies_of(walks, options.c3d, inputs, "--c3d")
    later = _paths_below(options.compare)
    results = analysed(options, [walk.path for walk in walks if _console.real_path(walk.path) not in later], batch, copies)
    second = replace(options, static=options.compare_static, measure=[*options.measure, *options.compare_measure])
    compared = analysed(second, [walk.path for walk in walks if _console.real_path(walk.path) in later], batch, copies)
    if results:
        write_results(options, results, band, batch, copies, compared)
    raise typer.Exit(batch.close())


def _check_sessions(options: GaitOptions) -> None:
    """Raise AsterismError where the sessions share a file, or a standing trial of one would serve the other, or no browser prints."""
    from asterism.errors import AsterismError

    shared = _paths_below(options.files) & _paths_below(options.compare)
    if shared:
        raise AsterismError(f"{min(shared)} is in both sessions; name the walks of the first one before --compare, the others behind it.")
    if options.compare and options.static is not None and options.compare_static is None:
        raise AsterismError(
            f"{options.static} is of the first session: markers are put on anew in the second. Give its own with --compare-static, or the "
            "same file where nothing was moved."
        )
    if options.compare_static is not None and not options.compare:
        raise AsterismError("--compare-static is of a second session, whose walks are missing; name them behind --compare.")
    if options.pdf is not None:
        from asterism.report.pdf import find_browser

        find_browser()


def _paths_below(given: Sequence[Path]) -> set[Path]:
    """The real paths of files, and of all files in folders."""
    return {_console.real_path(file) for path in given for file in (path.rglob("*") if path.is_dir() else [path])}


def analysed(
    options: GaitOptions, files: Sequence[Path], batch: _console.Batch, copies: Mapping[Path, Path]
) -> list[tuple[Path, GaitAnalysis]]:
    """The analyses of the files that can be analysed, whose copies are written; what is found on them goes to the batch."""
    from asterism.cli._folders import check_output
    from asterism.formats import force_plates
    from asterism.gait import analyse_gait, muscles_by_channel, named_channels, write_gait_c3d
    from asterism.motion.clinical import StaticRules
    from asterism.motion.clinical.gathered import other_person
    from asterism.session import trials_of

    limit, choice = fill_limit(options.fill), filter_choice(options.filter)
    static = None if options.static is None else _read(options.static, options, batch)
    rules = StaticRules(flat_foot=not options.sloped_foot, level_head=options.level_head)
    muscles = muscles_by_channel(options.emg)
    results: list[tuple[Path, GaitAnalysis]] = []
    trials = list(files) if options.static is None else [options.static, *files]
    for path in files:
        with batch.file(path):
            if path in copies:
                check_output(path, copies[path], options.overwrite, "--c3d")
            recording = _read(path, options, batch)
            plates, found = force_plates(recording)
            if limit is not None:
                fill = filled(recording, limit, trials_of(path, trials), options.vertical)
                recording, found = fill.recording, (*found, *fill.findings)
                if options.json != "-" and (fill.gaps or fill.findings):
                    _console.result(f"{path}: {filled_text(fill)}.")
            clean = cleaned(recording, choice)
            recording, found = clean.recording, (*found, *clean.findings)
            measures, doubtful = _clinical.measures_of(recording, static, options.measure, options.hip, rules)
            found = (*found, *doubtful)
            # a band is of several persons
            if results and options.save_band is None:
                found = (*found, *other_person(recording, results[0][1].recording))
            analysis = analyse_gait(recording, plates, measures, static=static, model=options.lower_body)
            # the page says what was found before the analysis as well: plates, fills, spikes, measures
            found = tuple(dict.fromkeys((*found, *analysis.findings)))
            analysis = replace(analysis, emg=named_channels(analysis.emg, muscles), findings=found)
            for finding in found:
                batch.found(finding)
            if path in copies:
                copies[path].parent.mkdir(parents=True, exist_ok=True)
                for told in write_gait_c3d(copies[path], analysis):
                    _console.notice(f"{copies[path]}: {told}.")
            results.append((path, analysis))
            if options.json != "-":
                show(path, analysis)
    return results


def write_results(
    options: GaitOptions,
    results: list[tuple[Path, GaitAnalysis]],
    band: Band | None,
    batch: _console.Batch,
    copies: Mapping[Path, Path] | None = None,
    compared: Sequence[tuple[Path, GaitAnalysis]] = (),
) -> None:
    """Write what the options ask for of at least one analysis, and of those of a second session that are compared with it."""
    from asterism.findings import Finding, Severity
    from asterism.gait import band_of, profile_scores
    from asterism.gait.bands import other_models
    from asterism.recording import subject_of

    analyses = [analysis for _, analysis in results]
    scores = [] if band is None else profile_scores(analyses, band, sigmas=True)
    if band is not None and (told := other_models(analyses, band)):
        mend = "Give a band of controls with these markers, or leave the scores out."
        where = str(options.band or "the band of controls")
        batch.found(Finding("gait-band-model", Severity.WARNING, where, f"{where}: {told}", mend))
    for score in scores if options.json != "-" else ():
        side = "left" if score.side == "L" else "right"
        off = ["" if one is None else f" ± {one:.{digits}f}" for one, digits in ((_in_degrees(score.gps_sigma), 1), (score.gdi_sigma, 0))]
        index = "" if score.gdi is None else f" Gait Deviation Index by this score: {score.gdi:.0f}{off[1]}."
        _console.result(f"Gait Profile Score, {side}: {math.degrees(score.gps):.1f}{off[0]}° from the mean of the band.{index}")
    if options.save_band is not None:
        people = [subject_of(analysis.recording) or str(path.parent) for path, analysis in results]
        band_of(analyses, people).save(options.save_band)
    _write_tables(options, [*results, *compared])
    changes = _changes(results, compared)
    if compared and options.json != "-":
        _show_changes(changes)
    if options.report is not None or options.pdf is not None:
        _write_pages(options, results, compared, band, batch)
    # bands, and curves as lists, are a third of the time of a run without JSON
    if options.json is None:
        return
    content = {
        "command": "gait",
        "files": [{"file": path, "c3d": (copies or {}).get(path), **as_dict(analysis)} for path, analysis in results],
        "scores": [
            {
                "side": score.side,
                "gps_deg": math.degrees(score.gps),
                "gps_sigma_deg": _in_degrees(score.gps_sigma),
                "gdi": score.gdi,
                "gdi_sigma": score.gdi_sigma,
                "variables_deg": {name: math.degrees(value) for name, value in score.variables.items()},
                "variables_sigma_deg": {name: math.degrees(value) for name, value in score.sigmas.items()},
            }
            for score in scores
        ],
        "compared": [{"file": path, "c3d": (copies or {}).get(path), **as_dict(analysis)} for path, analysis in compared],
        "changes": changes,
        "failed": batch.failed,
        "findings": [finding.to_dict() for finding in batch.findings],
    }
    _console.write_json(options.json, content)


def _in_degrees(angle: float | None) -> float | None:
    return None if angle is None else math.degrees(angle)


def _changes(results: list[tuple[Path, GaitAnalysis]], compared: Sequence[tuple[Path, GaitAnalysis]]) -> list[dict[str, Any]]:
    """How parameters of the second session differ from those of the first, as JSON has it."""
    from asterism.gait import PARAMETERS, compare_sessions

    of = [[parameter for _, analysis in session for parameter in analysis.parameters] for session in (results, compared)]
    return [
        {
            "parameter": change.name,
            "side": change.side,
            "unit": PARAMETERS[change.name],
            "first": change.first.mean,
            "second": change.second.mean,
            "difference": change.difference,
            "interval_95": change.interval,
            "exceeds": change.exceeds,
        }
        for change in compare_sessions(*of)
    ]


def _show_changes(changes: Sequence[Mapping[str, Any]]) -> None:
    """Print them as a table."""
    rows = [
        [
            change["parameter"],
            change["side"],
            change["unit"],
            *(f"{change[name]:.3f}" for name in ("first", "second")),
            f"{change['difference']:+.3f} ± {change['interval_95']:.3f}",
            "yes" if change["exceeds"] else "no",
        ]
        for change in changes
    ]
    head = ["parameter", "side", "unit", "first", "second", "difference (95 %)", "exceeds it"]
    _console.table("Two sessions", head, rows)


def _write_pages(
    options: GaitOptions,
    results: list[tuple[Path, GaitAnalysis]],
    compared: Sequence[tuple[Path, GaitAnalysis]],
    band: Band | None,
    batch: _console.Batch,
) -> None:
    """The report, as a page and on paper."""
    from tempfile import TemporaryDirectory

    from asterism.recording.display import short_names
    from asterism.report.gait import gait_report
    from asterism.report.pdf import print_page

    several = _several_people([analysis for _, analysis in [*results, *compared]])
    if several is not None:
        batch.found(several)
    names = short_names([path for path, _ in [*results, *compared]])
    named = [(name, analysis) for name, (_, analysis) in zip(names, [*results, *compared], strict=True)]
    folders = [{path.absolute().parent.name for path, _ in session} for session in (results, compared)]
    # Folders name the sessions where each has one of its own.
    told = [min(folder) for folder in folders] if all(len(folder) == 1 for folder in folders) and folders[0] != folders[1] else None
    sessions = (told[0], told[1]) if told else ("first session", "second session")
    with TemporaryDirectory(prefix="asterism-") as folder:
        page = options.report or Path(folder) / "gait.html"
        gait_report(page, named[: len(results)], band=band, compare=named[len(results) :], sessions=sessions)
        if options.pdf is not None:
            print_page(page, options.pdf)


def _several_people(analyses: Sequence[GaitAnalysis]) -> Finding | None:
    """Whether the files of one report name several people."""
    from asterism.findings import Finding, Severity

    people = sorted({str(name) for one in analyses if (name := one.recording.metadata.get("subject"))})
    if len(people) < 2:
        return None
    sentence = f"the files of the report name several people: {', '.join(people)}. Its means and curves are of all of them."
    return Finding("gait-several-people", Severity.WARNING, "report", sentence, "Give the walks of one person.")


def _write_tables(options: GaitOptions, results: list[tuple[Path, GaitAnalysis]]) -> None:
    """The table of all numbers, and its parts, as far as they are asked for."""
    from asterism.gait import gait_table

    parts = {options.output: ("parameter", "mean", "symmetry"), options.curves: ("curve", "maximum", "minimum"), options.table: ()}
    asked = {given: kinds for given, kinds in parts.items() if given is not None}
    if asked:
        everything = gait_table([(str(path), one) for path, one in results], curves=set(asked) != {options.output})
        for given, kinds in asked.items():
            (everything.of(*kinds) if kinds else everything).write(given)


def _read(path: Path, options: GaitOptions, batch: _console.Batch) -> Recording:
    """A file's recording; its warnings are told."""
    from asterism.cli._recordings import one_person, report_warnings
    from asterism.formats import read

    recording = read(path, vertical=options.vertical)
    report_warnings(recording, batch)
    return one_person(recording, batch)


def show(path: Path, analysis: GaitAnalysis) -> None:
    """Print the parameters of one recording: mean, uncertainty and standard deviation of each side."""
    from asterism.gait import PARAMETERS, summarise, symmetries
    from asterism.motion.filters import last_filter

    differ = {one.name: f"{one.value:+.1f} ± {one.sigma:.1f}" for one in symmetries(analysis.parameters)}
    summaries = {(one.name, one.side): one for one in summarise(analysis.parameters)}
    rows = []
    for name, unit in PARAMETERS.items():
        own = [summaries.get((name, side)) for side in "LR"]
        if any(own):
            rows.append(
                [name, unit, *(f"{one.mean:.3f} ± {one.sigma:.3f} ({one.count})" if one else "–" for one in own), differ.get(name, "")]
            )
    where = "treadmill" if analysis.walking.treadmill else "floor"
    sides = [sum(cycle.side == side for cycle in analysis.cycles) for side in "LR"]
    turning = sum(cycle.turns for cycle in analysis.cycles)
    turns = f" ({turning} of turns{', in no mean' if turning < sum(sides) else ''})" if turning else ""
    plates = sum(event.source.startswith("plate") for event in analysis.walking.events)
    model = None if analysis.clinical is None else analysis.clinical.model
    angles = "no angles" if model is None else f"angles by {model.title(analysis.recording)}, hip centres by {model.hip}"
    _console.result(
        f"{path}: {sides[0]} left and {sides[1]} right cycles{turns}, on a {where}; {len(analysis.walking.events)} events, "
        f"{plates} of them by force plates; {last_filter(analysis.recording)}; {angles}."
    )
    if rows:
        _console.table(f"{path}: gait parameters (cycles)", ["parameter", "unit", "left", "right", "left more, %"], rows)


def as_dict(analysis: GaitAnalysis) -> dict[str, Any]:
    """The analysis as JSON has it: seconds from the first frame, degrees; loads in N m/kg, W/kg and N/kg, or N m, W and N."""
    import dataclasses

    import numpy as np

    from asterism.gait import midstances, symmetries
    from asterism.motion.filters import last_filter
    from asterism.recording import filled_samples

    deviation = filled_samples(analysis.recording)
    return {
        "treadmill": analysis.walking.treadmill,
        "events": [dataclasses.asdict(event) for event in analysis.walking.events],
        "cycles": [
            {
                "side": cycle.side,
                "strike": cycle.strike.time,
                "off": cycle.off.time,
                "next_strike": cycle.next_strike.time,
                "turns": cycle.turns,
            }
            for cycle in analysis.cycles
        ],
        "midstances": [dataclasses.asdict(event) for event in midstances(analysis.walking)],
        "parameters": [dataclasses.asdict(one) for one in analysis.parameters],
        "filter": filter_values(last_filter(analysis.recording)),
        "symmetry_percent": [dataclasses.asdict(one) for one in symmetries(analysis.parameters)],
        "filled": {
            analysis.recording.labels[column]: {
                "samples": int(np.isfinite(deviation[:, column]).sum()),
                "largest_deviation_m": float(np.nanmax(deviation[:, column])),
            }
            for column in np.flatnonzero(np.isfinite(deviation).any(axis=0))
        },
        "fill_sigmas_deg": {name: np.round(np.degrees(sigmas), 3) for name, sigmas in analysis.fill_sigmas.items() if np.any(sigmas > 0.0)},
        "bands_deg": {
            name: {
                "low": np.round(np.degrees(band.low), 3),
                "high": np.round(np.degrees(band.high), 3),
                "same_placement": dict(zip(("low", "high"), np.round(np.degrees(band.same_placement), 3), strict=True)),
                "standard": {source: np.round(np.degrees(part), 3) for source, part in band.standard.items()},
            }
            for name, band in analysis.bands.items()
        },
        "curves_deg": {name: np.round(np.degrees(curves), 3) for name, curves in analysis.curves.items()},
        "loads": {name: np.round(curves, 4) for name, curves in analysis.loads.items()},
        # places in "cycles": of some cycles it is not known what acts on the foot
        "load_cycles": {name: [analysis.cycles.index(cycle) for cycle in own] for name, own in analysis.loaded.items()},
        "load_sigmas": {name: np.round(sigmas, 4) for name, sigmas in analysis.load_sigmas.items()},
        "loads_per_kg": analysis.kinetics is not None and analysis.kinetics.per_kg,
        "emg": [
            {
                **dataclasses.asdict(channel),
                "cycles": {
                    side: [[float(f"{value:.4g}") for value in curve] for curve in curves] for side, curves in channel.cycles.items()
                },
            }
            for channel in analysis.emg
        ],
        "lower_body": None if analysis.clinical is None else {"model": analysis.clinical.model.name, "hip": analysis.clinical.model.hip},
        "measures": {} if analysis.clinical is None else dataclasses.asdict(analysis.clinical.subject),
    }
