"""Plug-in-Gait's angles by other programs and by ours, against those that the vendor's program left in the files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import asterism
from asterism.motion.clinical import SubjectMeasures, clinical_angles, gathered_measures
from asterism.motion.clinical.measures import all_computed_by_the_file
from asterism.recording import Floats, Recording
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

JOINTS = ("Hip", "Knee", "Ankle")
PLACES = {"RHip": 3, "LHip": 6, "RKnee": 9, "LKnee": 12, "RAnkle": 15, "LAnkle": 18}
"""Columns of pyCGM's result, three angles each."""
EACH = 5
"""Frames from one to the next that are compared: pyCGM takes 10 ms for each."""
RADIUS = 7.0
"""mm: the radius of the markers that pyCGM has built in."""


def angles(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """RMS by curve: hips, knees and ankles, three angles of each, of walks whose measures the files hold; the package pyCGM beside ours."""
    try:
        from pyCGM_Single import pycgmCalc
    except ImportError:
        pycgmCalc = None
        benchmark.report("pyCGM is not installed (pip install pyCGM): ours alone")
    apart: dict[tuple[str, str], list[float]] = {}
    for path in sorted((folder() / "gait-events" / "plates").glob("*/*.c3d"))[: 2 if benchmark.quick else None]:
        recording = asterism.read(path)
        measures, _ = gathered_measures(recording)
        names = [f"{side}{joint}Angles" for side in "LR" for joint in JOINTS]
        theirs = all_computed_by_the_file(recording, names)
        found = {"Asterism": {name: np.degrees(values) for name, values in clinical_angles(recording, measures=measures).outputs.items()}}
        if pycgmCalc is not None:
            found["pyCGM 1.0"] = _by_pycgm(pycgmCalc, recording, measures, path)
        for who, curves in found.items():
            for name, values in theirs.items():
                off = ((curves[name] - values + 180.0) % 360.0 - 180.0)[::EACH]
                known = off[np.isfinite(off).all(axis=1)]
                apart.setdefault((who, name[1:].removesuffix("Angles")), []).extend(np.sqrt((known**2).mean(axis=0)).tolist())
    for (who, joint), values in apart.items():
        yield Figure(
            f"angles by {who} against the vendor's, {joint.lower()}: median RMS", "none", float(np.median(values)), "degrees", len(values)
        )


def _by_pycgm(calculate: Any, recording: Recording, measures: SubjectMeasures, path: Path) -> Mapping[str, Floats]:
    """Its angles, degrees; NaN where it gives none. It gets ours' measures, with widths that make up for another marker's size."""
    processing = {name: float(values[0]) for name in recording.source.parameters.groups["PROCESSING"]
                  if len(values := recording.source.parameters.values("PROCESSING", name))}  # fmt: skip
    own: dict[str, Any] = {"GCS": np.eye(3).tolist(), "Bodymass": measures.mass, "HeadOffset": processing.get("HEADOFFSET", 0.0)}
    own["MeanLegLength"] = np.mean([processing[f"{side}LEGLENGTH"] for side in "LR"])
    own["InterAsisDistance"] = processing["INTERASISDISTANCE"]
    thicker = 2.0 * (1000.0 * measures.marker_radius - RADIUS)
    for letter, side in (("L", "Left"), ("R", "Right")):
        own[f"{letter}_AsisToTrocanterMeasure"] = processing[f"{letter}ASISTROCANTERDISTANCE"]
        own |= {f"{side}{name}": processing[letter + name.upper()] for name in ("StaticRotOff", "StaticPlantFlex")}
        own |= {f"{side}{name}": processing[letter + name.upper()] + thicker for name in ("KneeWidth", "AnkleWidth")}
        own |= {
            f"{side}{name}": processing[letter + name.upper()] for name in ("ShoulderOffset", "ElbowWidth", "WristWidth", "HandThickness")
        }
        own[f"{side}TibialTorsion"] = np.degrees(processing[f"{letter}TIBIALTORSION"])
    found = {f"{name}Angles": np.full((len(recording), 3), np.nan) for name in PLACES}
    for frame in range(0, len(recording), EACH):
        places = zip(recording.labels, 1000.0 * recording.positions[frame], strict=True)
        try:
            given, _ = calculate.calcFrames([{label: place for label, place in places if np.isfinite(place).all()}], own)
        except KeyError:  # a marker of the whole body is hidden
            continue
        for name, place in PLACES.items():
            found[f"{name}Angles"][frame] = given[0][place : place + 3]
    return found
