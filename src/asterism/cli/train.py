"""`asterism train`: labelled files in, a model out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._options import (
    Features,
    Files,
    HitRate,
    Json,
    Markers,
    MinerOption,
    Overwrite,
    Seed,
    Vertical,
    check_hit_rate,
    feature_names,
)
from asterism.cli.audit import as_numbered
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.recording import MarkerSet, Recording


def train(
    files: Files,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The model to write.", show_default=False)],
    markers: Markers = None,
    target_hit_rate: HitRate = 0.999,
    miner: MinerOption = None,
    features: Features = None,
    seed: Seed = 0,
    leave_out_damaged: Annotated[
        bool, typer.Option("--leave-out-damaged", help="Look through the files first, and leave out what cannot be right.")
    ] = False,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Learn a marker set from files whose points are labelled.

    Recordings of several people make a model that holds for people it has not seen. A file that lacks a marker of the set stops
    the training before it starts, and is named.
    """
    check_hit_rate(target_hit_rate)
    chosen = feature_names(features)
    _console.check_new(output, overwrite)
    _console.check_new(json, overwrite)
    from asterism.cli._recordings import marker_set_of, say_left_out

    marker_set = marker_set_of(markers)
    recordings = _read(files, marker_set, vertical)
    from asterism.labelling import SolverEnsemble, TrainingRules

    left_out: list[Any] = []
    if leave_out_damaged:
        recordings, left_out = _without_damage(files, recordings, marker_set, seed)
    started = time.perf_counter()
    with _console.progress("training") as progress:
        ensemble = SolverEnsemble.fit(
            recordings,
            seed=seed,
            target_hit_rate=target_hit_rate,
            miner=None if miner is None else miner.value,
            marker_set=marker_set,
            training=TrainingRules(features=chosen),
            progress=progress,
        )
    seconds = time.perf_counter() - started
    ensemble.save(output)
    names, about = ensemble.marker_set.names, ensemble.about
    say_left_out(len(names), about["left_out_markers"])
    if json != "-":
        _print(output, len(names), len(recordings), about, seconds)
    _console.write_json(
        json,
        {
            "command": "train",
            "model": output,
            "markers": names,
            "files": files,
            **about,
            "left_out": [asdict(finding) for finding in left_out],
            "seconds": seconds,
        },
    )


def _read(files: Sequence[Path], marker_set: MarkerSet | None, vertical: str | None) -> list[Recording]:
    """The files' recordings: with the set's markers, else each with all its named ones. Raises AsterismError where one cannot be used."""
    from asterism.cli._recordings import read_labelled, read_some

    batch = _console.Batch("read")
    if marker_set is None:
        recordings = read_some(files, None, vertical, batch)
    else:
        recordings = read_labelled(files, marker_set, vertical, batch, complete=True)
    if batch.failed:
        raise AsterismError(f"{len(batch.failed)} of {len(files)} files cannot be used, named above; mend them or leave them out.")
    return recordings


def _without_damage(
    files: Sequence[Path], recordings: Sequence[Recording], marker_set: MarkerSet | None, seed: int
) -> tuple[list[Recording], list[Any]]:
    """The recordings without the samples that cannot be right, and these as findings, each said on the console."""
    from asterism.labelling import audit, without
    from asterism.labelling.training.learning import common_marker_set

    names = (marker_set or common_marker_set(recordings)[0]).names
    audited = [recording.select(names) for recording in recordings]
    with _console.progress("auditing") as progress:
        findings = [finding for finding in audit(audited, seed=seed, progress=progress) if finding.damage]
    numbered = [as_numbered(finding, audited) for finding in findings]
    for finding in numbered:
        span = f"frames {finding.first_frame} to {finding.last_frame}"
        _console.error(f"{files[finding.recording]}, {span}: left out, {finding.description}.")
    return without(audited, findings), numbered


def _print(output: Path, markers: int, recordings: int, about: dict[str, Any], seconds: float) -> None:
    people = len(about["subjects"])
    _console.result(
        f"{output}: {markers} markers, from {recordings} recording{'s' if recordings > 1 else ''} of {people} "
        f"subject{'s' if people > 1 else ''} ({about['frames']:,} frames) in {seconds:.0f} s"
    )
    if people == 1:
        _console.result(
            "advice: one person tells little of others, and nothing of postures not shown, where labels can be wrong at a confidence "
            "near 1: look at what it labels first, and let it learn. Recordings of several people need a folder for each."
        )
