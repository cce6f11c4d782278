"""`asterism train`: labelled files in, a model out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import (
    Files,
    HitRate,
    Json,
    Markers,
    Miner,
    MinerOption,
    Overwrite,
    Seed,
    Vertical,
    check_hit_rate,
)

if TYPE_CHECKING:
    from asterism.recording import Recording


def train(
    files: Files,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The model to write.", show_default=False)],
    markers: Markers = None,
    target_hit_rate: HitRate = 0.9999,
    miner: MinerOption = Miner.BOTTOM_UP,
    seed: Seed = 0,
    vertical: Vertical = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Learn a marker set from files whose points are labelled.

    Recordings of several people make a model that holds for people it has not seen. A file that lacks a marker of the set stops
    the training before it starts, and is named.
    """
    from asterism.cli._recordings import read_labelled, subject_of

    check_hit_rate(target_hit_rate)
    _console.check_new(output, overwrite)
    recordings = read_labelled(files, markers, vertical)
    from asterism.labelling import SolverEnsemble

    started = time.perf_counter()
    with _console.progress("training") as progress:
        ensemble = SolverEnsemble.fit(recordings, seed=seed, target_hit_rate=target_hit_rate, miner=miner.value, progress=progress)
    seconds = time.perf_counter() - started
    ensemble.save(output)
    if json != "-":
        _console.say(_line(output, recordings, len(ensemble.marker_set), seconds))
    _console.write_json(
        json,
        {
            "command": "train",
            "model": output,
            "markers": ensemble.marker_set.names,
            "files": files,
            "subjects": sorted({subject_of(recording) for recording in recordings}),
            "frames": sum(map(len, recordings)),
            "target_hit_rate": target_hit_rate,
            "miner": miner.value,
            "seed": seed,
            "seconds": seconds,
        },
    )


def _line(output: Path, recordings: list[Recording], markers: int, seconds: float) -> str:
    from asterism.cli._recordings import subject_of

    people = len({subject_of(recording) for recording in recordings})
    frames = sum(map(len, recordings))
    return f"{output}: {markers} markers, from {len(recordings)} recordings of {people} subjects ({frames:,} frames) in {seconds:.0f} s"
