"""`asterism train`: labelled files in, a model out."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

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
    from asterism.cli._recordings import marker_set_of, read_labelled

    check_hit_rate(target_hit_rate)
    chosen = feature_names(features)
    _console.check_new(output, overwrite)
    _console.check_new(json, overwrite)
    marker_set = marker_set_of(markers)
    batch = _console.Batch("read")
    recordings = read_labelled(files, marker_set, vertical, batch, complete=True)
    if batch.failed:
        raise AsterismError(f"{len(batch.failed)} of {len(files)} files cannot be used, named above; mend them or leave them out.")
    from asterism.labelling import SolverEnsemble, audit, remove_errors

    left_out = []
    if leave_out_damaged:
        with _console.progress("auditing") as progress:
            errors = [error for error in audit(recordings, seed=seed, progress=progress) if error.damage]
        left_out = [as_numbered(error, recordings) for error in errors]
        for error in left_out:
            _console.report(error.finding)
        recordings = remove_errors(recordings, errors)
    started = time.perf_counter()
    with _console.progress("training") as progress:
        ensemble = SolverEnsemble.fit(
            recordings,
            seed=seed,
            target_hit_rate=target_hit_rate,
            miner=None if miner is None else miner.value,
            features=chosen,
            marker_set=marker_set,
            progress=progress,
        )
    seconds = time.perf_counter() - started
    ensemble.save(output)
    names, about = ensemble.marker_set.names, ensemble.about
    if json != "-":
        people = len(about["subjects"])
        _console.result(
            f"{output}: {len(names)} markers, from {len(recordings)} recording{'s' if len(recordings) > 1 else ''} of {people} "
            f"subject{'s' if people > 1 else ''} ({about['frames']:,} frames) in {seconds:.0f} s"
        )
        if people == 1:
            _console.result(
                "advice: one person tells little of others, and nothing of postures not shown, where labels can be wrong at a confidence "
                "near 1: look at what it labels first, and let it learn. Recordings of several people need a folder for each."
            )
    _console.write_json(
        json,
        {
            "command": "train",
            "model": output,
            "markers": names,
            "files": files,
            **about,
            "left_out": [asdict(error) for error in left_out],
            "findings": [_console.as_json(error.finding) for error in left_out],
            "seconds": seconds,
        },
    )
